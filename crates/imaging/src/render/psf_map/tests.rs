use ndarray::s;

use super::*;
use crate::plane::Plane;
use crate::render::{Renderer, Settings};
use crate::scene::{SceneKind, generate};
use crate::sensor::Sensor;
use isoplanat_base::testing::assert_abs;
use isoplanat_optics::lens::builtin;
use isoplanat_optics::psf::table::chief_slopes;

fn density() -> SpectralDensity {
    SpectralDensity::new(&Sensor::generic())
}

fn lens(name: &str) -> Lens {
    builtin::lens(name).expect("shipped")
}

/// Filters and multipliers, put together as a plain sum over pixels, are the renderer's picture.
#[test]
fn filters_and_multipliers_are_the_renderers_picture() {
    // Parts of the field where the blur varies.
    for (name, pitch_mm, vergence, axis_px) in
        [("cooke_triplet", 0.04, 0.0, [-90.0, 20.0]), ("double_gauss", 0.05, 1e-3, [40.0, 100.0])]
    {
        let lens = lens(name);
        let frame = Frame::centred(72, 54, pitch_mm).and_then(|f| f.with_axis(axis_px)).expect("a frame");
        let places = PsfPlaces::Nodes(0.005);
        let request = PsfMapRequest { rays: 1000, vergence, wavelengths: 5, ..PsfMapRequest::new(&lens, places) };
        let map = PsfMap::compute(&lens, &frame, &density(), &request).expect("traces");
        let settings = Settings {
            samples: 1,
            wavelengths: 5,
            degree: DEGREE,
            dense: 1000,
            node_error: 0.005,
            outside: LOST,
            cells: LARGEST,
            diffraction: Model::Rays,
        };
        let renderer = Renderer::planned(&lens, &frame, &density(), &[vergence], settings).expect("traces");
        assert_eq!(map.grid.as_ref(), Some(&renderer.plan.depths[0].grid));
        let texture = generate(SceneKind::Mixed, 3, 80, 100);
        let zoom = 1.4;
        let texels_per_slope = zoom / pitch_mm * lens_focal(&lens);
        let scene = Plane { texture, texels_per_slope, axis_texel: axis_px.map(|v| zoom * v), vergence };
        let whole = Region::whole(&frame);
        let (picture, _) =
            renderer.picture::<f64>(&scene, 0, whole, &crate::render::Channels::from_scene(&scene), &|_| ());
        let (multipliers, size) = (map.multipliers().expect("on pixels"), map.kernels.dim().2);
        let half = size / 2;
        // The scene around the frame, too: its light reaches the first pixels.
        let x: Array3<f64> = renderer.truth(&scene, 0, whole.grown(half), &crate::render::Channels::from_scene(&scene));
        let mut largest = 0.0f64;
        for c in 0..3 {
            for (i, j) in (0..frame.rows).step_by(3).flat_map(|i| (0..frame.columns).step_by(5).map(move |j| (i, j))) {
                let mut y = 0.0;
                for k in 0..map.kernels.dim().0 {
                    let h = map.kernels.slice(s![k, c, ..;-1, ..;-1]);
                    let seen = x.slice(s![c, i..i + size, j..j + size]);
                    let sum: f64 = h.iter().zip(seen).map(|(h, x)| f64::from(*h) * x).sum();
                    y += f64::from(multipliers[[k, c, i, j]]) * sum;
                }
                largest = largest.max((y - picture[[c, i, j]]).abs());
            }
        }
        assert!(largest < 1e-5, "{name}: {largest:e}");
        assert!(map.kernels.dim().0 > 1, "{name}: the blur varies");
    }
}

fn lens_focal(lens: &Lens) -> f64 {
    isoplanat_optics::lens::paraxial::first_order(lens, lens.wavelengths.primary_nm).effective_focal_length
}

/// Energy, light and distortion of image heights; the last stands at the corner.
#[test]
fn heights_run_from_the_axis_to_the_corner() {
    for vergence in [0.0, 1.0 / 800.0] {
        let lens = lens("cooke_triplet");
        let frame = Frame::centred(120, 80, 0.2).expect("a frame");
        let request = PsfMapRequest { rays: 2000, vergence, ..PsfMapRequest::new(&lens, PsfPlaces::Heights(9)) };
        let map = PsfMap::compute(&lens, &frame, &density(), &request).expect("traces");
        assert_eq!(map.kernels.shape()[..2], [9, 3]);
        for ((k, c), outside) in map.outside.indexed_iter() {
            let sum: f64 = map.kernels.slice(s![k, c, .., ..]).iter().map(|v| f64::from(*v)).sum();
            assert_abs(sum + outside, 1.0, 1e-5, "energy");
            assert!(*outside < 5e-3, "{k} {c}: {outside}");
        }
        assert_eq!(map.height_mm[0], 0.0);
        assert_abs(map.height_mm[8], frame.max_radius_mm(), 1e-12, "corner");
        assert_eq!(map.illumination.row(0).to_vec(), [1.0; 3]);
        assert!(map.white()[8] < map.white()[4] && map.white()[4] < 1.0);
        // Chief rays, traced by themselves.
        let near = chief_slopes(&lens, vergence, &[1e-3]).expect("traces")[0] / 1e-3;
        for (height, distortion) in map.height_mm.iter().zip(&map.distortion).skip(1) {
            let slope = chief_slopes(&lens, vergence, &[*height]).expect("traces")[0];
            assert_abs(*distortion, height / (slope / near) - 1.0, 2e-5, "distortion");
        }
    }
}

/// Outwards is downwards: the kernel of the corner's height is that of the lowest pixel, and not its mirror image.
#[test]
fn outwards_is_downwards() {
    let lens = lens("cooke_triplet");
    let frame = Frame::centred(1, 65, 0.3).expect("a frame");
    let of = |places| {
        let request = PsfMapRequest { rays: 4000, size: Some(41), ..PsfMapRequest::new(&lens, places) };
        PsfMap::compute(&lens, &frame, &density(), &request).expect("traces")
    };
    let (heights, grid) = (of(PsfPlaces::Heights(2)), of(PsfPlaces::Grid([3, 1])));
    assert_eq!(grid.grid.as_ref().expect("on pixels").row_knots, [0, 32, 64]);
    let (down, below) = (heights.kernels.slice(s![1, 1, .., ..]), grid.kernels.slice(s![2, 1, .., ..]));
    let distance = |a: ndarray::ArrayView2<'_, f32>, b: ndarray::ArrayView2<'_, f32>| {
        let off: f32 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
        (off / b.iter().map(|b| b * b).sum::<f32>()).sqrt()
    };
    let [same, mirrored] = [distance(down, below), distance(down.slice(s![..;-1, ..]), below)];
    assert!(same < 0.05 && mirrored > 5.0 * same, "{same} {mirrored}");
}

#[test]
fn what_is_no_request_is_refused() {
    let lens = lens("cooke_triplet");
    let frame = Frame::centred(96, 64, 0.3).expect("a frame");
    let own = PsfMapRequest::new(&lens, PsfPlaces::Grid([3, 3]));
    let refused = |request: PsfMapRequest, expected: &str| {
        let error = PsfMap::compute(&lens, &frame, &density(), &request).expect_err(expected);
        assert!(error.exit_code() == 2 && error.to_string().contains(expected), "{error}");
    };
    refused(PsfMapRequest { places: PsfPlaces::Grid([0, 3]), ..own.clone() }, "0 × 3");
    refused(PsfMapRequest { places: PsfPlaces::Heights(0), ..own.clone() }, "heights");
    refused(PsfMapRequest { places: PsfPlaces::Nodes(f64::NAN), ..own.clone() }, "node error");
    refused(PsfMapRequest { size: Some(40), ..own.clone() }, "odd");
    refused(PsfMapRequest { vergence: -1e-3, ..own.clone() }, "distance");
    refused(PsfMapRequest { rays: 3, ..own.clone() }, "rays");
    let memory = Limit { bytes: BASE + (1 << 20) };
    refused(PsfMapRequest { size: Some(301), memory, ..own }, "9 kernels of 301 × 301");
}

#[test]
fn places_of_a_grid_are_even() {
    assert_eq!(even(64, 3), [0, 32, 63]);
    assert_eq!(even(65, 5), [0, 16, 32, 48, 64]);
    assert_eq!(even(2, 5), [0, 1], "no pixel twice");
    assert_eq!([even(1, 4), even(9, 1)], [vec![0], vec![4]]);
}
