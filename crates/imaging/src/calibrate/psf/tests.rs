//! Kernels that are known come back from pictures that are counted point by point.

use glam::{DMat3, DVec3};
use ndarray::Array2;

use super::*;
use crate::calibrate::model::{Pinhole, Pose};
use crate::sensor::cfa::Cfa;
use isoplanat_optics::psf::splat::Raster;

const SIZE: [usize; 2] = [300, 220];
const CENTRE: DVec2 = DVec2::new(146.0, 113.0);
const FOCAL: f64 = 420.0;

fn poses() -> Vec<Pose> {
    let turns = [[0.25, -0.1, 0.1], [-0.2, 0.2, -0.2], [0.1, 0.25, 0.4], [-0.15, -0.25, 0.9]];
    turns
        .iter()
        .map(|[y, x, z]| {
            let turn = DMat3::from_rotation_y(*y) * DMat3::from_rotation_x(*x) * DMat3::from_rotation_z(*z);
            Pose { turn, at: DVec3::new(0.0, 0.0, 19.0) - turn * DVec3::new(6.0, 4.5, 0.0) }
        })
        .collect()
}

/// Corners of a board of 12 × 9 that land within the picture.
fn view(camera: &Pinhole, pose: &Pose) -> View {
    let mut view = View { board: Vec::new(), seen: Vec::new() };
    for i in 0..108 {
        let board = DVec2::new(f64::from(i % 12), f64::from(i / 12));
        let seen = camera.project(board, pose).expect("before it").0;
        if seen.min_element() > 2.0 && seen.x < SIZE[0] as f64 - 2.0 && seen.y < SIZE[1] as f64 - 2.0 {
            view.board.push(board);
            view.seen.push(seen);
        }
    }
    view
}

/// The moves that a lens makes at a part of the field, along and across: an ellipse that grows along the meridian and moves outwards.
fn truth(field: f64, channel: usize) -> Vec<[f64; 2]> {
    let [along, across, shift] = [1.0 + 1.8 * field, 0.8 + 0.3 * channel as f64, 0.7 * field];
    let points = (0..48).map(|i| {
        let (radius, angle) = (((f64::from(i) + 0.5) / 48.0).sqrt(), 2.399_963 * f64::from(i));
        [shift + along * radius * angle.cos(), across * radius * angle.sin()]
    });
    // Mirror images too.
    points.flat_map(|[a, b]| [[a, b], [a, -b]]).collect()
}

fn turned([along, across]: [f64; 2], outward: DVec2) -> DVec2 {
    along * outward + across * DVec2::new(-outward.y, outward.x)
}

/// Mosaics of the board, light falling off to one side, noise of a two-hundredth of the contrast.
fn mosaic(pose: &Pose, seed: u64) -> Array2<f64> {
    let far = CENTRE.length();
    let back = pose.turn.transpose();
    let origin = back * pose.at;
    let even = |at: DVec2| {
        let along = back * ((at - CENTRE) / FOCAL).extend(1.0);
        let place = (origin.z / along.z * along - origin).truncate().floor();
        f64::from(u8::from((place.x + place.y).rem_euclid(2.0) == 0.0))
    };
    let moves: Vec<Vec<Vec<[f64; 2]>>> =
        (0..3).map(|c| (0..=64).map(|k| truth(f64::from(k) / 64.0, c)).collect()).collect();
    let row = |r: usize| {
        let rng = &mut fastrand::Rng::with_seed(seed * 1000 + r as u64);
        (0..SIZE[0])
            .map(|c| {
                let at = DVec2::new(c as f64 + 0.5, r as f64 + 0.5);
                let out = at - CENTRE;
                let channel = Cfa::RGGB.channel(r, c);
                let here = &moves[channel][(64.0 * out.length() / far).round().min(64.0) as usize];
                let outward = if out.length() > 0.0 { out / out.length() } else { DVec2::X };
                let mut sum = 0.0;
                for d in here {
                    for k in 0..9 {
                        let within = DVec2::new(f64::from(k % 3) - 1.0, f64::from(k / 3) - 1.0) / 3.0;
                        sum += even(at - turned(*d, outward) + within);
                    }
                }
                let light = 0.7 + 0.1 * channel as f64 - 4e-4 * at.x;
                let noise = (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
                light * (0.05 + 0.8 * sum / (9.0 * here.len() as f64) + 0.004 * noise)
            })
            .collect::<Vec<_>>()
    };
    let rows: Vec<f64> = (0..SIZE[1]).into_par_iter().flat_map_iter(row).collect();
    Array2::from_shape_vec((SIZE[1], SIZE[0]), rows).expect("its size")
}

#[test]
fn known_kernels_come_back_from_mosaics() {
    let camera = Pinhole { focal_px: DVec2::splat(FOCAL), centre_px: CENTRE, k: [0.0; 3] };
    let poses = poses();
    let views: Vec<View> = poses.iter().map(|p| view(&camera, p)).collect();
    let mosaics: Vec<_> = poses.iter().enumerate().map(|(k, p)| mosaic(p, k as u64)).collect();
    let fit = Fit { camera, errors: camera, poses: poses.clone(), residuals: Vec::new(), max_slope: 0.5 };
    let settings = Settings { reach_px: Some(5.0), knots: 5, ..Settings::default() };
    let mut edges = Edges::new(&views, &fit, SIZE, &settings).expect("corners");
    for (k, mosaic) in mosaics.iter().enumerate() {
        let channels = (0..3).map(|c| (mosaic.view(), Sites::from_cfa(Cfa::RGGB, c))).collect();
        edges.add(k, &Pixels { channels, range: Some([f64::NEG_INFINITY, 2.0]) }).expect("levels");
    }
    let measured = edges.fit(&|_| ()).expect("fits");
    let far = CENTRE.length();
    let mut worst = 0.0f64;
    for (channel, quality) in measured.quality.iter().enumerate() {
        // Noise is told, and the fit is as good as it.
        assert!((quality.noise / 0.005 - 1.0).abs() < 0.2, "{}", quality.noise);
        assert!(quality.rms < 1.3 * quality.noise && quality.held_out_rms < 1.5 * quality.noise, "{quality:?}");
        assert!(quality.sum_error < 0.02, "{}", quality.sum_error);
        for share in [0.1, 0.3, 0.5, 0.7, 0.85] {
            for outward in [DVec2::X, DVec2::new(0.6, -0.8)] {
                let raster = Raster { size: 15, samples: 1 };
                let mut expected = vec![0.0; raster.len()];
                let moves = truth(share, channel);
                let each = (moves.len() as f64).recip();
                let moved = moves.iter().map(|m| (turned(*m, outward).to_array(), each));
                raster.splat(&mut expected, &[(0, 1.0)], moved);
                let found = measured.psf.kernel(share * far, channel, outward.to_array(), 15);
                let off: f64 = found.iter().zip(&expected).map(|(a, b)| (a - b).powi(2)).sum();
                let all: f64 = expected.iter().map(|v| v * v).sum();
                worst = worst.max((off / all).sqrt());
            }
        }
        // The halves' own error is of the size of the true one.
        let told = quality.half_difference.iter().copied().fold(0.0, f64::max);
        assert!((0.001..0.1).contains(&told), "{told}");
    }
    assert!(worst < 0.05, "kernels off by {worst}, L2");
}
