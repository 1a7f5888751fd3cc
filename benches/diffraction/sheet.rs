//! A street in the corner at f/16: by rays, by diffraction, and a patch of it by wavelets of rays traced one by one.

use std::time::Instant;

use isoplanat::imaging::files::write_png8;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::metrics::psnr_linear;
use isoplanat::imaging::plane::Plane;
use isoplanat::imaging::render::{Diffraction, PlanOptions, Request, ScenePlan, Settings, plan};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Aperture, Lens, builtin};
use ndarray::{Array3, s};
use rayon::prelude::*;

use super::wavelets::{Grid, Wavelets};

/// Columns and rows of the frame, and how many pixels its first column and row lie from the axis.
const SIZE: [usize; 2] = [160, 120];
const FROM_AXIS: [f64; 2] = [880.0, 560.0];
const PITCH_MM: f64 = 6e-3;
const F_NUMBER: f64 = 16.0;
/// The patch: first row, first column, side.
const PATCH: [usize; 3] = [44, 64, 32];
const WAVELENGTHS: usize = 7;
/// Rays of a wavelength: the square of it.
const RAYS: u32 = 48;
/// Half-width of the oracle's kernel, pixels.
const HALF: usize = 24;
const SAMPLES: usize = 4;
/// Texels a pixel.
const TEXELS: f64 = 2.0;
/// How large pixels are drawn: of the pictures, of the patches.
const LARGE: [usize; 2] = [3, 10];

struct Corner {
    lens: Lens,
    frame: Frame,
    scene: Plane,
    density: SpectralDensity,
}

impl Corner {
    fn new() -> Self {
        let lens = builtin::lens("double_gauss").expect("shipped");
        let lens = lens.changed(|l| l.aperture = Aperture::FNumber(F_NUMBER)).expect("closes");
        let frame = Frame::centred(SIZE[0], SIZE[1], PITCH_MM).and_then(|f| f.with_axis(FROM_AXIS.map(|v| -v)));
        let frame = frame.expect("valid");
        // The street goes on beside the frame.
        let [columns, rows] = SIZE.map(|n| (n + 100) * TEXELS as usize);
        let texture = generate(SceneKind::Facades, 3, rows, columns);
        let scene = Placement::centred([rows, columns], &frame, Scale::There(TEXELS)).before(&lens, &frame, texture);
        Self { lens, frame, scene: scene.expect("light"), density: SpectralDensity::new(&Sensor::generic()) }
    }

    fn plan(&self, diffraction: Diffraction) -> ScenePlan {
        let settings = Settings {
            wavelengths: WAVELENGTHS,
            samples: SAMPLES,
            diffraction: diffraction.stated(),
            ..Settings::FINE
        };
        let options = PlanOptions { explain: false, diffraction };
        let (scenes, request) = (std::slice::from_ref(&self.scene), Request::Settings(settings));
        plan(&self.lens, scenes, &self.frame, &self.density, request, options).expect("plans")
    }

    /// The patch by the oracle: kernels of the patch's middle, the scene of `plan`'s map, white of its light; what falls outside the window is put back evenly, as pictures do.
    fn by_wavelets(&self, plan: &ScenePlan) -> Array3<f64> {
        let optics = &plan.renderer.optics;
        let (map, quadrature) = (&optics.maps[0], &optics.spec.quadrature);
        let [first_row, first_column, n] = PATCH;
        let middle = |first: usize| (first + n / 2) as f64;
        let point = self.frame.point(middle(first_column), middle(first_row));
        let size = 2 * HALF + 1;
        let grid = Grid { side: size * SAMPLES, samples: SAMPLES, fine_mm: PITCH_MM / SAMPLES as f64, parts: 2 };
        let len = grid.side * grid.side;
        let mut kernels = vec![vec![0.0; len]; 3];
        let all: Vec<Wavelets> =
            quadrature.nm.iter().map(|nm| Wavelets::trace(&self.lens, map, point.radius_mm(), *nm, RAYS)).collect();
        for (l, wavelets) in all.iter().enumerate() {
            let mut kernel = vec![0.0; len];
            wavelets.add_kernel(map, point, grid, &mut kernel);
            for (to, weight) in kernels.iter_mut().zip(&quadrature.weight) {
                let whole: f64 = weight.iter().zip(&all).map(|(w, a)| w * a.light).sum();
                let share = weight[l] * wavelets.light / whole;
                to.iter_mut().zip(&kernel).for_each(|(t, k)| *t += share * k);
            }
        }
        for kernel in &mut kernels {
            let missed = 1.0 - kernel.iter().sum::<f64>();
            println!("light outside the oracle's window: {missed:.1e}");
            kernel.iter_mut().for_each(|k| *k += missed / len as f64);
        }
        // Samples of the scene that pixels of the patch see, the first pixel's first one at `−reach`.
        let side = (n + 2 * HALF) * SAMPLES;
        let sampled: Vec<f64> = (0..3 * side * side)
            .into_par_iter()
            .map(|q| {
                let (c, i, j) = (q / (side * side), q / side % side, q % side);
                let at = |first: usize, k: usize, axis: f64| {
                    (first as f64 - HALF as f64 + (k as f64 + 0.5) / SAMPLES as f64 - axis) * PITCH_MM
                };
                let mm = [at(first_column, j, self.frame.axis_px[0]), at(first_row, i, self.frame.axis_px[1])];
                let [x, y] = map.slopes(mm, self.scene.texels_per_slope);
                let [a, b] = self.scene.axis_texel;
                self.scene.sample(c, [a + x, b + y]).0
            })
            .collect();
        let value = |c: usize, i: usize, j: usize| {
            let kernel = &kernels[c];
            // Entry `t` of a pixel's kernel meets the sample `far − t` of those that the pixel sees.
            let far = size * SAMPLES - 1;
            let row = |t: usize| {
                let line = &sampled[c * side * side + (i * SAMPLES + far - t) * side + j * SAMPLES..][..=far];
                line.iter().rev().zip(&kernel[t * grid.side..]).map(|(s, k)| s * k).sum::<f64>()
            };
            let blurred: f64 = (0..grid.side).map(row).sum();
            let point = self.frame.point((first_column + j) as f64 + 0.5, (first_row + i) as f64 + 0.5);
            blurred * optics.relative_illumination(point)[c]
        };
        let values: Vec<f64> = (0..3 * n * n).into_par_iter().map(|q| value(q / (n * n), q / n % n, q % n)).collect();
        Array3::from_shape_vec((3, n, n), values).expect("a value a pixel")
    }
}

/// `picture` with each pixel as a square of `n`, at `[row, column]` of `sheet`.
fn draw(sheet: &mut Array3<f32>, picture: &Array3<f32>, n: usize, at: [usize; 2]) {
    for ((c, i, j), v) in picture.indexed_iter() {
        sheet.slice_mut(s![c, at[0] + i * n..at[0] + (i + 1) * n, at[1] + j * n..at[1] + (j + 1) * n]).fill(*v);
    }
}

/// Prints how far the patches are apart and writes `benches/results/diffraction.png`: above, by rays and by diffraction; below, the patch by rays, by diffraction, by wavelets.
pub(crate) fn print() {
    println!("\n### A street at f/16\n");
    let corner = Corner::new();
    let [rays, waves] = [Diffraction::Off, Diffraction::On].map(|how| corner.plan(how));
    let picture = |plan: &ScenePlan| plan.picture::<f32>(&corner.scene, &|_| ()).expect("renders").0;
    let pictures = [picture(&rays), picture(&waves)];
    let clock = Instant::now();
    let oracle = corner.by_wavelets(&waves).mapv(|v| v as f32);
    println!("the oracle took {:.0} s", clock.elapsed().as_secs_f64());
    let [row, column, n] = PATCH;
    let patches = pictures.each_ref().map(|p| p.slice(s![.., row..row + n, column..column + n]).to_owned());
    println!("| patch | against wavelets, dB | largest difference |\n|---|---|---|");
    for (name, patch) in ["rays", "diffraction"].into_iter().zip(&patches) {
        let worst = patch.iter().zip(&oracle).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        println!("| {name} | {:.1} | {worst:.1e} |", psnr_linear(patch.view(), oracle.view()));
    }
    println!("whole pictures, rays against diffraction: {:.1} dB", psnr_linear(pictures[0].view(), pictures[1].view()));
    let width = SIZE[0] * LARGE[0] * 2;
    let below = SIZE[1] * LARGE[0] + 4;
    let mut sheet = Array3::from_elem((3, below + n * LARGE[1], width + 8), 1.0);
    for (k, picture) in pictures.iter().enumerate() {
        draw(&mut sheet, picture, LARGE[0], [0, k * (SIZE[0] * LARGE[0] + 8)]);
    }
    for (k, patch) in patches.iter().chain([&oracle]).enumerate() {
        draw(&mut sheet, patch, LARGE[1], [below, k * (n * LARGE[1] + 4)]);
    }
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results");
    write_png8(&folder.join("diffraction.png"), &sheet).expect("writes");
}
