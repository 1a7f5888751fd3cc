//! The fast renderer against the reference renderer, which shares neither PSF grid nor convolution with it.

use std::time::Instant;

use isoplanat::imaging::field_map::slope_at_height;
use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::monte_carlo::halves::{energy_against_halves, psnr_against_halves};
use isoplanat::imaging::monte_carlo::{Channels, Sampling, Settings, render_halves};
use isoplanat::imaging::patches::NodeRaster;
use isoplanat::imaging::plan::{Quality, frame_of, plan};
use isoplanat::imaging::render::{Optics, render_region};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::spectrum::SpectralDensity;
use isoplanat::imaging::warp::{Plane, Region};
use isoplanat::lens::builtin;
use isoplanat::testing::shared;
use ndarray::Array3;

/// Large-field lens on the paper's 4096 × 512 frame of 6 µm: ≥ 40 dB and energy within 1e-3 at two fields.
fn compare(texture: &Array3<f32>, what: &str) {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = frame_of(&lens).expect("valid");
    let density = SpectralDensity::new(&Sensor::generic());
    let max_slope = slope_at_height(&lens, lens.object_vergence, 1.02 * frame.max_radius_mm()).expect("reaches");
    let plan = plan(&lens, lens.object_vergence, &frame, &density, Quality::FINE, Some(max_slope)).expect("plans");
    for (row, col) in [(200, 300), (200, 2600)] {
        let region = Region { row, col, rows: 96, cols: 96 };
        // The photograph's middle at the region's middle, a texel a pixel.
        let scale = 1.0 / (isoplanat::imaging::warp::slope_per_mm(&fit(&lens, max_slope), 0.0) * frame.pitch_mm);
        let (_, rows, cols) = texture.dim();
        let slope = isoplanat::imaging::warp::slope_per_mm(
            &fit(&lens, max_slope),
            frame.radius_mm(col as f64 + 48.0, row as f64 + 48.0),
        ) * frame.pitch_mm;
        let at = [(col as f64 + 48.0) * slope * scale, (row as f64 + 48.0) * slope * scale];
        let scene = Plane {
            texture: texture.clone(),
            texels_per_slope: scale,
            axis_texel: [cols as f64 / 2.0 - at[0], rows as f64 / 2.0 - at[1]],
            vergence: lens.object_vergence,
        };
        let clock = Instant::now();
        let raster = NodeRaster::over(region.grown(plan.margin()), plan.spacing);
        let optics = Optics::compute(&lens, lens.object_vergence, &plan, raster).expect("traces");
        let fast = render_region::<f32>(&optics, &plan, &scene, region).image;
        let seconds_fast = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let how = Settings { samples: 512, seed: 3, channels: Channels::All, sampling: Sampling::Bounded };
        let halves = render_halves(&lens, &scene, &density, &frame, region, how, None).expect("renders");
        let seconds_reference = clock.elapsed().as_secs_f64();
        let agreement = psnr_against_halves(fast.view(), &halves);
        let energy = energy_against_halves(fast.view(), &halves);
        let [low, high] = energy.interval.map(|e| e - 1.0);
        let off = energy.ratio - 1.0;
        eprintln!(
            "{what}, column {col}: {:.1} dB [{:.1}, {:.1}], energy {off:+.1e} [{low:+.1e}, {high:+.1e}], kernels {}², fast {seconds_fast:.2} s, \
             reference {seconds_reference:.2} s",
            agreement.psnr_db, agreement.psnr_db_interval[0], agreement.psnr_db_interval[1], plan.psf.size
        );
        assert!(agreement.psnr_db >= 40.0, "{what}: {agreement:?}");
        assert!(off.abs() < 1e-3, "{what}: {energy:?}");
    }
}

fn fit(lens: &isoplanat::lens::Lens, max_slope: f64) -> isoplanat::imaging::distortion::Distortion {
    isoplanat::imaging::field_map::fit_distortion(lens, lens.object_vergence, max_slope).expect("fits")
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
