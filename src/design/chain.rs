//! One patch: scene → distortion, PSFs, blur, illumination, mosaic, noise → developed picture and its truth; and back.
//!
//! Everything that depends on the lens is inside, the refitted distortion and the re-warped truth included, so the
//! gradient is that of the deterministic loss a step sees. The lens is traced once for all patches of a step; what comes back
//! from them adds up in the optics' cotangent.

use ndarray::{Array3, ArrayView3};

use isoplanat_base::error::Result;
use isoplanat_base::math::real::Real;
use isoplanat_imaging::develop::simulate::{Electronics, SimulateRecord, simulate, simulate_vjp};
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::render::{Rendered, Renderer};
use isoplanat_imaging::sensor::noise::standard_normal;
use isoplanat_optics::psf::OpticsBar;

/// One patch of one scene.
#[derive(Clone, Debug)]
pub struct Patch {
    /// The scene, placed.
    pub scene: Plane,
    /// The pixels that are rendered.
    pub region: Region,
    /// Those of them that the network sees: the others are what its filters look at around it.
    pub part: Region,
    /// Seed of its noise draw.
    pub noise_seed: u64,
}

impl Patch {
    /// A patch of which the network sees all that is rendered.
    pub fn whole(scene: Plane, region: Region, noise_seed: u64) -> Self {
        Self { scene, region, part: region, noise_seed }
    }
}

/// The forward pass of one patch.
pub struct PatchForward<T: Real> {
    /// Developed picture: the network's input, `[channel, row, col]`.
    pub developed: Array3<T>,
    /// The ideal picture: the network's target.
    pub truth: Array3<T>,
    rendered: Rendered<T>,
    simulated: SimulateRecord<T>,
}

/// Scene → developed picture, through the lens that `renderer` holds.
///
/// # Errors
/// An object distance that the renderer was not made for.
pub fn forward<T: Real>(renderer: &Renderer, electronics: &Electronics, patch: &Patch) -> Result<PatchForward<T>> {
    let depth = renderer.plan.depth(patch.scene.vergence)?;
    let rendered = renderer.record(&patch.scene, depth, patch.region);
    Ok(developed(electronics, patch, rendered))
}

/// [`forward`] of an image from elsewhere: irradiance over the patch's region `[3, row, col]`, of which a pixel's own colour counts.
pub(super) fn forward_of(
    renderer: &Renderer,
    electronics: &Electronics,
    patch: &Patch,
    image: Array3<f32>,
) -> Result<PatchForward<f32>> {
    let depth = renderer.plan.depth(patch.scene.vergence)?;
    let mut rendered = renderer.record(&patch.scene, depth, patch.region);
    rendered.image = image;
    Ok(developed(electronics, patch, rendered))
}

fn developed<T: Real>(electronics: &Electronics, patch: &Patch, rendered: Rendered<T>) -> PatchForward<T> {
    let eps = standard_normal(patch.noise_seed, (patch.region.rows, patch.region.cols));
    let (developed, simulated) =
        simulate(&electronics.at(patch.region), rendered.image.view(), rendered.illumination.view(), eps);
    let truth = rendered.truth.clone();
    PatchForward { developed, truth, rendered, simulated }
}

/// Pulls cotangents on the developed picture and on the truth back to the optics.
pub(crate) fn forward_vjp<T: Real>(
    renderer: &Renderer,
    electronics: &Electronics,
    patch: &Patch,
    done: &PatchForward<T>,
    developed_bar: ArrayView3<'_, T>,
    truth_bar: ArrayView3<'_, T>,
) -> OpticsBar {
    let (image_bar, illumination_bar) = simulate_vjp(&electronics.at(patch.region), &done.simulated, developed_bar);
    renderer.vjp(&patch.scene, &done.rendered, image_bar.view(), truth_bar, illumination_bar.view())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, steady_difference};
    use isoplanat_imaging::frame::Frame;
    use isoplanat_imaging::render::Settings;
    use isoplanat_imaging::sensor::Sensor;
    use isoplanat_imaging::sensor::cfa::Cfa;
    use isoplanat_imaging::sensor::noise::Noise;
    use isoplanat_imaging::sensor::spectrum::SpectralDensity;
    use isoplanat_optics::lens::{Kind, Lens, builtin, variables::Variables};

    fn smooth_scene() -> Plane {
        // Band-limited, so that the loss is smooth on the scale of a difference step.
        let wave = |c: usize, i: usize, j: usize| {
            let (x, y, k) = (j as f64, i as f64, c as f64 + 1.0);
            0.5 + 0.2 * (0.31 * x * k.sqrt() + 0.2 * y).sin() + 0.2 * (0.17 * x - 0.43 * y / k).cos()
        };
        Plane {
            texture: Array3::from_shape_fn((3, 300, 300), |(c, i, j)| wave(c, i, j) as f32),
            texels_per_slope: 2500.0,
            axis_texel: [-80.0, -10.0],
            vergence: 1e-3,
        }
    }

    /// Texels of few bits, which any program makes the same.
    fn plain_texels(side: usize, seed: usize) -> Array3<f32> {
        let of = |(c, i, j): (usize, usize, usize)| (31 * c + 17 * i + 7 * j + i * j + 5 * seed) % 97;
        Array3::from_shape_fn((3, side, side), |at| of(at) as f32 / 128.0)
    }

    /// The gradient of a squared difference on four patches by all numbers of a lens, as a design's step has it, is the recorded one to 1e-12 of its norm; the layer of the Python package is
    /// held to the same record. `ISOPLANAT_RECORD_GRADIENTS=1` records it anew.
    #[test]
    fn the_gradient_is_the_recorded_one() {
        use isoplanat_imaging::scene::placement::{Placement, Scale};
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("python/tests/chain_gradient.json");
        let (side, margin) = (48usize, 24usize);
        let mut found = Vec::new();
        for (name, pitch_um, columns, rows) in [("two_element", 20.0, 320, 220), ("cooke_triplet", 60.0, 600, 400)] {
            let lens = builtin::lens(name).expect("shipped");
            let axis_px = [0.5 * columns as f64 + 3.0, 40.0];
            let frame =
                Frame::centred(columns, rows, 1e-3 * pitch_um).and_then(|f| f.with_axis(axis_px)).expect("valid");
            let density = SpectralDensity::new(&Sensor::generic());
            let renderer = Renderer::planned(&lens, &frame, &density, &[lens.object_vergence], Settings::DESIGN);
            let renderer = renderer.expect("plans");
            let electronics =
                Electronics { noise: Noise { shot: 0.0, read: 0.0 }, ..Electronics::from_sensor(&Sensor::generic()) };
            let places = [[4, 8], [rows - side, columns - side], [rows / 2 - 1, columns / 2 - 4], [0, columns - side]];
            let mut bar = OpticsBar::zeros(&renderer.optics);
            let mut loss = 0.0;
            for (seed, [row, col]) in places.into_iter().enumerate() {
                let region = Region { row: row as isize, col: col as isize, rows: side, cols: side };
                let middle = 0.5 * side as f64;
                let place = Placement {
                    texel: [margin as f64 + middle + 0.5; 2],
                    pixel: [col as f64 + middle, row as f64 + middle],
                    scale: Scale::There(1.0),
                };
                let scene = place.by(&renderer.optics.maps[0], &frame, plain_texels(side + 2 * margin, seed));
                let patch = Patch::whole(scene, region, 0);
                let done = forward::<f64>(&renderer, &electronics, &patch).expect("renders");
                let residual = &done.developed - &done.truth;
                loss += residual.iter().map(|d| d * d).sum::<f64>();
                let residual = residual * 2.0;
                bar.add(&forward_vjp(&renderer, &electronics, &patch, &done, residual.view(), (-&residual).view()));
            }
            let all = Variables::all(&lens).parameters;
            let variables = Variables { scales: vec![1.0; all.len()], parameters: all };
            let gradient = variables.gradient(&renderer.lens_gradient(&lens, &bar));
            let names: Vec<_> = variables.parameters.iter().map(|p| p.name(&lens)).collect();
            found.push(serde_json::json!({
                "lens": name, "pitch_um": pitch_um, "columns": columns, "rows": rows, "axis_px": axis_px, "side": side, "margin": margin,
                "places": places, "loss": loss, "names": names, "gradient": gradient,
            }));
        }
        if std::env::var_os("ISOPLANAT_RECORD_GRADIENTS").is_some() {
            std::fs::write(&path, serde_json::to_string_pretty(&found).expect("numbers") + "\n").expect("writable");
        }
        let text = std::fs::read_to_string(&path).expect("recorded");
        let recorded: Vec<serde_json::Value> = serde_json::from_str(&text).expect("JSON");
        assert_eq!(recorded.len(), found.len());
        for (known, found) in recorded.iter().zip(&found) {
            assert_eq!(known["names"], found["names"]);
            let numbers =
                |v: &serde_json::Value| -> Vec<f64> { serde_json::from_value(v["gradient"].clone()).expect("numbers") };
            let (known, found) = (numbers(known), numbers(found));
            let norm = known.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!(norm > 1.0 && known.iter().filter(|v| **v != 0.0).count() > known.len() / 2);
            for (a, b) in known.iter().zip(&found) {
                assert!((a - b).abs() <= 1e-12 * norm, "{a} {b} of {norm}");
            }
        }
    }

    /// The full chain without the network, f64: 1e-6 relative along 20 random directions, and two of every kind of number.
    #[test]
    fn the_chain_agrees_with_central_differences() {
        let lens = builtin::lens("two_element").expect("shipped");
        let frame = Frame::centred(320, 220, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let settings =
            Settings { dense: 100, wavelengths: 3, node_error: 0.2, outside: 5e-2, cells: 40, ..Settings::DESIGN };
        let density = SpectralDensity::new(&Sensor::generic());
        let plan = Renderer::planned(&lens, &frame, &density, &[1e-3], settings).expect("plans").plan;
        let electronics =
            Electronics { cfa: Cfa::RGGB, noise: Noise { shot: 2e-4, read: 1e-3 }, neutral: [0.55, 1.0, 0.7] };
        let patch = Patch::whole(smooth_scene(), Region { row: 141, col: 210, rows: 32, cols: 40 }, 11);
        // Squared error is smooth; the developed picture and the truth both move with the lens.
        let loss = |lens: &Lens| {
            let renderer = Renderer::new(lens, &plan).expect("traces");
            let f = forward::<f64>(&renderer, &electronics, &patch).expect("renders");
            (&f.developed - &f.truth).mapv(|d| d * d).sum()
        };
        let renderer = Renderer::new(&lens, &plan).expect("traces");
        let done = forward::<f64>(&renderer, &electronics, &patch).expect("renders");
        // The patch sees the scene, not what its border goes on with.
        let values = || done.truth.iter().copied();
        assert!(values().fold(0.0, f64::max) - values().fold(1.0, f64::min) > 0.3);
        let residual = (&done.developed - &done.truth) * 2.0;
        let bar = forward_vjp(&renderer, &electronics, &patch, &done, residual.view(), (-&residual).view());
        let g = renderer.lens_gradient(&lens, &bar);
        let mut worst = 0.0f64;
        // All numbers together, and each kind alone: what is weak hides behind the others.
        for kind in Kind::ALL.into_iter().map(Some).chain([None]) {
            let all = Variables::all(&lens).parameters.into_iter().filter(|p| kind.is_none_or(|k| p.kind == k));
            let vars = Variables::new(&lens, all.collect());
            let (x, gradient) = (vars.values(&lens), vars.gradient(&g));
            let norm = gradient.iter().map(|v| v * v).sum::<f64>().sqrt();
            let directions = if kind.is_some() { 2 } else { 20 };
            for seed in (0..directions).filter(|_| !x.is_empty()) {
                let rng = &mut fastrand::Rng::with_seed(100 + seed);
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
                let at = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    loss(&vars.lens(&lens, &moved).expect("a lens"))
                };
                let steps = (0..12).map(|k| 6e-7 * 1.15f64.powi(k));
                let numeric = steady_difference(|h| (at(h) - at(-h)) / (2.0 * h), steps);
                worst = worst.max((pulled - numeric).abs() / numeric.abs());
                assert_rel(pulled, numeric, 1e-6, 1e-3 * norm, &format!("{kind:?}, direction {seed}"));
            }
        }
        eprintln!("chain gradient: worst relative error {worst:e}");
    }
}
