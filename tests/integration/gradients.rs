//! The fast renderer's gradient against the reference renderer's, which shares only the lens and the trace with it.
//!
//! Both pull the same cotangent, that of `Σ (picture − target)²` at the reference's clean picture, back to the lens. Pictures
//! are relative to white on the axis, and the fast renderer differentiates that white with the rest. The reference's pulled
//! gradient holds it; its derivative is added here: `−Σ_c (Σ bar · picture)_c ∂ln white_c`, with white's closed form on the
//! axis differenced over the channel's wavelengths. The stop has a size of its own, so that what stands before it does not
//! move its edge: there the reference's interior term is whole (and white does not move: what is added is zero).
//! Behind the stop the interior term lacks the moving edge of the beam, with white's derivative or without;
//! there the judge is the central difference of the reference itself, white anew on both sides, the same random numbers.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::gradient::render_vjp;
use isoplanat::imaging::reference::{Channels, Sampling, Settings, render};
use isoplanat::imaging::render::node_grid::NodeGrid;
use isoplanat::imaging::render::{Renderer, Settings as Fineness};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Kind;
use isoplanat::lens::variables::Variables;
use isoplanat::lens::{Aperture, Lens, builtin, paraxial};
use isoplanat::testing::central_difference;
use ndarray::{Array3, Axis};

use crate::white_axis::on_axis;

const REGION: Region = Region { row: 70, col: 120, rows: 12, cols: 12 };

/// The two-element lens with its stop's size held.
fn two_element() -> Lens {
    let lens = builtin::lens("two_element").expect("shipped");
    let stop = paraxial::stop_semi_diameter(&lens);
    lens.changed(|l| l.aperture = Aperture::StopSemiDiameter(stop)).expect("a lens")
}

/// Waves of tens of pixels' period; eight texels a pixel, so that the bilinear kinks are small.
fn smooth_scene() -> Plane {
    let wave = |c: usize, i: usize, j: usize| {
        let (x, y, k) = (j as f64 / 8.0, i as f64 / 8.0, c as f64 + 1.0);
        0.5 + 0.2 * (0.31 * x * k.sqrt() + 0.2 * y).sin() + 0.2 * (0.17 * x - 0.43 * y / k).cos()
    };
    Plane {
        texture: Array3::from_shape_fn((3, 1200, 1200), |(c, i, j)| wave(c, i, j) as f32),
        texels_per_slope: 16_000.0,
        axis_texel: [-300.0, -100.0],
        vergence: 1e-3,
    }
}

struct Task {
    lens: Lens,
    scene: Plane,
    density: SpectralDensity,
    frame: Frame,
    /// Cotangent of the picture.
    bar: Array3<f64>,
    /// `Σ bar · picture` of every channel, the picture the reference's.
    weighed: [f64; 3],
}

impl Task {
    fn new() -> Self {
        let (lens, scene) = (two_element(), smooth_scene());
        let density = SpectralDensity::new(&Sensor::generic());
        let frame = Frame::centred(320, 220, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let how = Settings { samples: 4096, seed: 7, channels: Channels::All, sampling: Sampling::Bounded };
        let clean = render(&lens, &scene, &density, &frame, REGION, how, None).expect("renders").mean;
        let bar = clean.mapv(|v| 2.0 * (f64::from(v) - 0.45));
        let clean = clean.mapv(f64::from);
        let weighed = std::array::from_fn(|c| (&clean * &bar).index_axis(Axis(0), c).sum());
        Self { lens, scene, density, frame, bar, weighed }
    }

    /// The fast renderer's, with nodes where its plan puts them or so many pixels apart.
    fn fast(&self, variables: &Variables, spacing: Option<usize>) -> Vec<f64> {
        let mut plan =
            Renderer::planned(&self.lens, &self.frame, &self.density, &[1e-3], Fineness::FINE).expect("plans").plan;
        if let Some(spacing) = spacing {
            let whole = Region { row: 0, col: 0, rows: self.frame.rows, cols: self.frame.columns };
            plan.depths[0].grid = NodeGrid::uniform(whole, spacing);
        }
        let renderer = Renderer::new(&self.lens, &plan).expect("traces");
        let rendered = renderer.record::<f64>(&self.scene, 0, REGION);
        let zero = Array3::zeros(self.bar.dim());
        let bar = renderer.vjp(&self.scene, &rendered, self.bar.view(), zero.view(), zero.view());
        variables.gradient(&renderer.lens_gradient(&self.lens, &bar))
    }

    /// What the white on the axis adds to the gradient of a picture that holds it, along one scaled variable.
    fn white(&self, variables: &Variables, k: usize) -> f64 {
        let x = variables.values(&self.lens);
        let rule = self.density.quadrature(24);
        let level = |h: f64, c: usize| {
            let mut moved = x.clone();
            moved[k] += h;
            let lens = variables.lens(&self.lens, &moved).expect("a lens");
            let parts = rule.wavelength_nm.iter().zip(&rule.weight[c]);
            parts.map(|(nm, w)| w * on_axis(&lens, *nm)).sum::<f64>()
        };
        let by = |c: usize| central_difference(|h| level(h, c).ln(), 1e-3);
        -(0..3).map(|c| self.weighed[c] * by(c)).sum::<f64>()
    }

    /// Central differences of the reference along one scaled variable: mean over seeds, standard error.
    fn difference(&self, variables: &Variables, k: usize, samples: usize) -> (f64, f64) {
        const SEEDS: u64 = 6;
        const STEP: f64 = 2e-3;
        let x = variables.values(&self.lens);
        let value = |h: f64, seed: u64| {
            let mut moved = x.clone();
            moved[k] += h;
            let lens = variables.lens(&self.lens, &moved).expect("a lens");
            // Plain: its directions move with the lens, where those of the ellipses jump.
            let how = Settings { samples, seed, channels: Channels::All, sampling: Sampling::RearAperture };
            let image = render(&lens, &self.scene, &self.density, &self.frame, REGION, how, None).expect("renders");
            image.mean.iter().zip(&self.bar).map(|(m, b)| f64::from(*m) * b).sum::<f64>()
        };
        let each: Vec<f64> = (0..SEEDS).map(|s| (value(STEP, s) - value(-STEP, s)) / (2.0 * STEP)).collect();
        let n = SEEDS as f64;
        let mean = each.iter().sum::<f64>() / n;
        let variance = each.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean, (variance / n).sqrt())
    }
}

#[test]
fn fast_and_reference_gradients_agree_before_the_stop() {
    before_the_stop(Some(SPACING), MODEL);
}

#[test]
#[ignore = "5.6e-2: the finest plan's 9 nodes hold the picture, not the change of the kernels between them"]
fn fast_and_reference_gradients_agree_with_the_nodes_of_the_plan() {
    before_the_stop(None, 1e-2);
}

fn before_the_stop(spacing: Option<usize>, model: f64) {
    use Kind::{Abbe, Conic, Curvature, Index, Thickness};
    let task = Task::new();
    let parameters = vec![
        Curvature.at(0),
        Conic.at(0),
        Thickness.at(0),
        Index.at(0),
        Abbe.at(0),
        Curvature.at(1),
        Conic.at(1),
        Thickness.at(1),
    ];
    let variables = Variables::new(&task.lens, parameters);
    let fast = task.fast(&variables, spacing);
    let how = Settings { samples: 512, seed: 11, channels: Channels::All, sampling: Sampling::Bounded };
    let reference = render_vjp(&task.lens, &task.scene, &task.density, &task.frame, REGION, how, 16, task.bar.view())
        .expect("pulls");
    let components = reference.components(&variables);
    let norm = components.iter().map(|c| c.mean.abs()).fold(0.0, f64::max);
    eprintln!("parameter                  fast          reference     standard error  (fast − reference)/largest");
    let mut worst = 0.0f64;
    for (k, ((p, fast), c)) in
        variables.parameters.iter().map(|p| p.name(&task.lens)).zip(&fast).zip(&components).enumerate()
    {
        let white = task.white(&variables, k);
        assert!(white.abs() < 1e-6 * norm, "{p}: white moves by {white:e} with what stands before the stop");
        let mean = c.mean + white;
        let off = (fast - mean) / norm;
        eprintln!("{p:24} {fast:13.5e} {mean:13.5e} {:13.1e} {off:+13.1e}", c.standard_error);
        // Beyond the confidence interval: the fast path's model.
        worst = worst.max(((fast - mean).abs() - 1.96 * c.standard_error) / norm);
    }
    eprintln!("beyond the 95 % interval at most {worst:.1e} of the largest");
    assert!(worst < model, "{worst:e}");
}

/// Fast model (polynomials over the stop, 12 wavelengths, kernels between nodes): of the largest component.
const MODEL: f64 = 1e-3;
/// Pixels between nodes.
const SPACING: usize = 16;

#[test]
fn fast_gradient_agrees_with_differences_of_the_reference_behind_the_stop() {
    use Kind::{Conic, Curvature, Index, Thickness};
    let task = Task::new();
    let parameters = vec![
        Thickness.at(2),
        Curvature.at(3),
        Thickness.at(3),
        Index.at(3),
        Curvature.at(4),
        Conic.at(4),
        Thickness.at(4),
        Curvature.at(0),
    ];
    let variables = Variables::new(&task.lens, parameters);
    let fast = task.fast(&variables, Some(SPACING));
    let how = Settings { samples: 512, seed: 11, channels: Channels::All, sampling: Sampling::Bounded };
    let interior = render_vjp(&task.lens, &task.scene, &task.density, &task.frame, REGION, how, 4, task.bar.view())
        .expect("pulls");
    let interior = interior.components(&variables);
    let differences: Vec<(f64, f64)> =
        (0..variables.parameters.len()).map(|k| task.difference(&variables, k, 4096)).collect();
    let norm = differences.iter().map(|d| d.0.abs()).fold(0.0, f64::max);
    eprintln!("parameter                  fast          difference    standard error  interior      standard error");
    let mut worst = 0.0f64;
    let each =
        variables.parameters.iter().map(|p| p.name(&task.lens)).zip(&fast).zip(&differences).zip(&interior).enumerate();
    for (k, (((p, fast), (mean, error)), c)) in each {
        // For comparison: the interior term with white's derivative.
        let with_white = c.mean + task.white(&variables, k);
        eprintln!("{p:24} {fast:13.5e} {mean:13.5e} {error:13.1e} {with_white:13.5e} {:13.1e}", c.standard_error);
        // Student's t of five degrees of freedom, 95 %.
        worst = worst.max(((fast - mean).abs() - 2.57 * error) / norm);
    }
    eprintln!("beyond the 95 % interval at most {worst:.1e} of the largest");
    assert!(worst < MODEL, "{worst:e}");
}
