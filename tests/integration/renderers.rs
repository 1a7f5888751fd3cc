//! The fast renderer against the reference renderer, which shares neither kernels nor convolution with it.

use std::time::Instant;

use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::plane::Region;
use isoplanat::imaging::reference::halves::{energy_against_halves, psnr_against_halves};
use isoplanat::imaging::reference::{Channels, Sampling, Settings as Rays, render_halves};
use isoplanat::imaging::render::{Renderer, Settings, frame_of};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::builtin;
use isoplanat::testing::shared;
use ndarray::Array3;

/// Large-field lens on the paper's 4096 × 512 frame of 6 µm: ≥ 40 dB and energy within 1e-3 at two fields.
fn compare(texture: &Array3<f32>, what: &str) {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = frame_of(&lens).expect("valid");
    let density = SpectralDensity::new(&Sensor::generic());
    let clock = Instant::now();
    let renderer = Renderer::planned(&lens, &frame, &density, &[lens.object_vergence], Settings::FINE).expect("plans");
    let map = &renderer.optics.maps[0];
    let seconds_plan = clock.elapsed().as_secs_f64();
    for (row, col) in [(200, 300), (200, 2600)] {
        let region = Region { row, col, rows: 96, cols: 96 };
        // The photograph's middle at the region's middle, a texel a pixel.
        let (_, rows, cols) = texture.dim();
        let (texel, pixel) = ([cols as f64 / 2.0, rows as f64 / 2.0], [col as f64 + 48.0, row as f64 + 48.0]);
        let scene = Placement { texel, pixel, scale: Scale::OnAxis(1.0) }.by(map, &frame, texture.clone());
        let clock = Instant::now();
        let fast = renderer.record::<f32>(&scene, 0, region).image;
        let seconds_fast = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let how = Rays { samples: 512, seed: 3, channels: Channels::All, sampling: Sampling::Bounded };
        let halves = render_halves(&lens, &scene, &density, &frame, region, how, None).expect("renders");
        let seconds_reference = clock.elapsed().as_secs_f64();
        let agreement = psnr_against_halves(fast.view(), &halves);
        let energy = energy_against_halves(fast.view(), &halves);
        let [low, high] = energy.interval.map(|e| e - 1.0);
        let off = energy.ratio - 1.0;
        eprintln!(
            "{what}, column {col}: {:.1} dB [{:.1}, {:.1}], energy {off:+.1e} [{low:+.1e}, {high:+.1e}], kernels {}² of {} px, fast {seconds_fast:.2} s \
             (plan {seconds_plan:.2} s), reference {seconds_reference:.2} s",
            agreement.psnr_db,
            agreement.psnr_db_interval[0],
            agreement.psnr_db_interval[1],
            renderer.plan.depths[0].size(),
            renderer.plan.depths[0].bin
        );
        assert!(agreement.psnr_db >= 40.0, "{what}: {agreement:?}");
        assert!(off.abs() < 1e-3, "{what}: {energy:?}");
    }
}

#[test]
fn fast_and_reference_agree_on_a_photograph() {
    let Some(path) = shared("data/photos/eval/05.png") else { return };
    compare(&read_linear(&path).expect("a photograph"), "photograph 05");
}

#[test]
fn fast_and_reference_agree_on_a_built_in_scene() {
    compare(&generate(SceneKind::Facades, 3, 512, 768), "street");
}
