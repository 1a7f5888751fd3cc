//! The optics of a design step: eight patches of 256² pixels at random fields and four depths, forward and lens gradient; and of steps of two small patches by the three models
//! of a kernel.

use std::path::Path;
use std::time::Instant;

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::gradient_error::{CONVERGED, Patches, cheapest};
use isoplanat::imaging::render::{RenderPlan, Renderer, Settings};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::paraxial::first_order;
use isoplanat::lens::{Aperture, Lens, builtin};
use isoplanat::psf::{Model, OpticsBar};
use ndarray::Array3;

/// Patches of a step, and their side, pixels.
const PATCHES: usize = 8;
const SIDE: usize = 256;
/// The same of steps by the three models.
const SMALL: [usize; 2] = [2, 64];
/// Object distances, mm.
const DEPTHS_MM: [f64; 4] = [500.0, 700.0, 1000.0, 1500.0];

/// A lens, its plan, and the patches of one step.
pub(crate) struct Step {
    pub(crate) name: String,
    lens: Lens,
    density: SpectralDensity,
    plan: RenderPlan,
    /// Seconds the plan took.
    planning: f64,
    patches: Vec<(Plane, Region)>,
}

/// Seconds of the parts of a step.
#[derive(Clone, Copy, Default)]
struct Parts {
    trace: f64,
    forward: f64,
    back: f64,
    lens: f64,
}

impl Step {
    /// Two_element at 20 and 6 µm, and the least-squares lens where it is there.
    pub(crate) fn all() -> Vec<Self> {
        let two = || builtin::lens("two_element").expect("shipped");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/lenses/least_squares/two_element.toml");
        let mut all = vec![Self::new("two_element, 20 um", two(), 20.0), Self::new("two_element, 6 um", two(), 6.0)];
        if path.exists() {
            let lens = isoplanat::lens::prescription::load(&path).expect("a lens");
            all.push(Self::new("least squares, 20 um", lens.clone(), 20.0));
            all.push(Self::new("least squares, 6 um", lens, 6.0));
        }
        all
    }

    /// The quadrant of 19.2 × 12.8 mm at a pitch.
    fn new(name: &str, lens: Lens, pitch_um: f64) -> Self {
        let [columns, rows] = [19_200.0, 12_800.0].map(|side: f64| (side / pitch_um).round() as usize);
        let frame =
            Frame::centred(columns, rows, pitch_um * 1e-3).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        Self::of(name.to_owned(), lens, &frame, &DEPTHS_MM.map(f64::recip), Settings::DESIGN, [PATCHES, SIDE])
    }

    /// So many patches of a side, pixels, of `frame`, objects at `vergences` in turn.
    fn of(
        name: String,
        lens: Lens,
        frame: &Frame,
        vergences: &[f64],
        settings: Settings,
        [count, side]: [usize; 2],
    ) -> Self {
        let density = SpectralDensity::new(&Sensor::generic());
        let clock = Instant::now();
        let plan = Renderer::planned(&lens, frame, &density, vergences, settings).expect("plans").plan;
        let planning = clock.elapsed().as_secs_f64();
        let focal_mm = first_order(&lens, lens.wavelengths.primary_nm).effective_focal_length;
        let rng = &mut fastrand::Rng::with_seed(5);
        let texture = generate(SceneKind::DeadLeaves, 1, 1024, 1536);
        let patch = |k: usize| {
            let mut place = |n: usize| rng.usize(..=n - side);
            let (row, col) = (place(frame.rows), place(frame.columns));
            let region = Region { row: row.cast_signed(), col: col.cast_signed(), rows: side, cols: side };
            // The texture's middle about there, about a texel a pixel.
            let axis = |texels: usize, first: usize| 0.5 * (texels - side) as f64 - first as f64;
            let scene = Plane {
                texture: texture.clone(),
                texels_per_slope: focal_mm / frame.pitch_mm,
                axis_texel: [axis(1536, col), axis(1024, row)],
                vergence: vergences[k % vergences.len()],
            };
            (scene, region)
        };
        let patches = (0..count).map(patch).collect();
        Self { name, lens, density, plan, planning, patches }
    }

    /// `name` at an f-number (its own where none is given) and a pitch, on a quadrant of `radius_mm` a side, by a model.
    fn bent(name: &str, f_number: Option<f64>, pitch_mm: f64, radius_mm: f64, model: Model) -> Self {
        let lens = builtin::lens(name).expect("shipped");
        let lens = match f_number {
            Some(n) => lens.changed(|l| l.aperture = Aperture::FNumber(n)).expect("closes"),
            None => lens,
        };
        let side = (radius_mm / pitch_mm).round() as usize;
        let frame = Frame::centred(side, side, pitch_mm).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let settings = Settings { diffraction: model, ..Settings::DESIGN };
        let vergences = [lens.object_vergence];
        Self::of(name.to_owned(), lens, &frame, &vergences, settings, SMALL)
    }

    pub(crate) fn pixels(&self) -> u64 {
        self.patches.iter().map(|(_, region)| (region.rows * region.cols) as u64).sum()
    }

    pub(crate) fn renderer(&self) -> Renderer {
        Renderer::new(&self.lens, &self.plan).expect("traces")
    }

    /// From the lens to all patches.
    pub(crate) fn forward(&self) -> f32 {
        let renderer = self.renderer();
        let of = |(k, (scene, region)): (usize, &(Plane, Region))| {
            renderer.record::<f32>(scene, k % self.plan.depths.len(), *region).image.sum()
        };
        self.patches.iter().enumerate().map(of).sum()
    }

    /// From the lens to all patches and back.
    pub(crate) fn gradient(&self) -> f64 {
        self.parts().1
    }

    fn patches(&self) -> Patches<'_> {
        let parts = self.patches.iter().map(|(scene, region)| (scene, *region)).collect();
        Patches { lens: &self.lens, frame: &self.plan.frame, density: &self.density, parts }
    }

    fn parts(&self) -> (Parts, f64) {
        let (mut parts, mut clock) = (Parts::default(), Instant::now());
        let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
        let renderer = self.renderer();
        parts.trace = lap();
        let mut sum = OpticsBar::zeros(&renderer.optics);
        for (k, (scene, region)) in self.patches.iter().enumerate() {
            let zero = Array3::<f32>::zeros((3, region.rows, region.cols));
            let rendered = renderer.record::<f32>(scene, k % self.plan.depths.len(), *region);
            parts.forward += lap();
            sum.add(&renderer.vjp(scene, &rendered, rendered.image.view(), zero.view(), zero.view()));
            parts.back += lap();
        }
        let gradient = renderer.lens_gradient(&self.lens, &sum);
        parts.lens = lap();
        (parts, gradient.surfaces[0].shape.curvature)
    }
}

/// The parts of every step, the fastest of three, ms.
pub(crate) fn table() -> String {
    let mut out = String::from(
        "| lens | kernels, cells (pixels a cell), by depth | nodes | plan | trace | forward | back | lens gradient | one patch after \
         the other | patches side by side | gradient off by | noise of the patches |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for step in Step::all() {
        let total = |p: &Parts| p.trace + p.forward + p.back + p.lens;
        let runs = (0..3).map(|_| step.parts().0);
        let best = runs.min_by(|a, b| total(a).total_cmp(&total(b))).expect("three");
        let list = |f: &dyn Fn(&isoplanat::imaging::render::plan::DepthPlan) -> String| {
            step.plan.depths.iter().map(f).collect::<Vec<String>>().join(", ")
        };
        let ms = |s: f64| format!("{:.0}", 1e3 * s);
        let patches = step.patches();
        let converged = patches.measure(CONVERGED).expect("renders");
        let measured: Vec<_> = (0..3).map(|_| patches.measure(step.plan.settings).expect("renders")).collect();
        let together = measured.iter().map(|m| m.seconds).fold(f64::INFINITY, f64::min);
        out += &format!(
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.3} | {:.2} |\n",
            step.name,
            list(&|d| format!("{}² ({})", d.size(), d.bin)),
            list(&|d| d.grid.len().to_string()),
            ms(step.planning),
            ms(best.trace),
            ms(best.forward),
            ms(best.back),
            ms(best.lens),
            ms(total(&best)),
            ms(together),
            measured[0].error(&converged),
            converged.noise(),
        );
    }
    out
}

/// Steps by rays, by rays convolved with the open pupil's diffraction, and by waves, at the same settings; the fastest of three.
pub(crate) fn models() -> String {
    let mut out = String::from(
        "| lens | f-number | pitch µm | model | kernels, cells | nodes | trace, ms | forward, ms | back, ms | lens gradient, ms | all, times rays |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let cases = [
        ("two_element", Some(8.0), 4e-3, 8.0),
        ("two_element", Some(8.0), 6e-3, 8.0),
        ("double_gauss", Some(8.0), 4e-3, 7.0),
        ("phone", None, 1.4e-3, 2.6),
    ];
    for (name, f_number, pitch_mm, radius_mm) in cases {
        let mut of_rays = f64::NAN;
        for (model, words) in [(Model::Rays, "rays"), (Model::Approximate, "approximate"), (Model::Waves, "waves")] {
            let step = Step::bent(name, f_number, pitch_mm, radius_mm, model);
            let total = |p: &Parts| p.trace + p.forward + p.back + p.lens;
            let runs = (0..3).map(|_| step.parts().0);
            let best = runs.min_by(|a, b| total(a).total_cmp(&total(b))).expect("three");
            if model == Model::Rays {
                of_rays = total(&best);
            }
            let d = &step.plan.depths[0];
            let ms = |s: f64| format!("{:.0}", 1e3 * s);
            let stop = f_number.map_or_else(|| "own".to_owned(), |n| n.to_string());
            out += &format!(
                "| {name} | {stop} | {} | {words} | {}² ({}) | {} | {} | {} | {} | {} | {:.1} |\n",
                1e3 * pitch_mm,
                d.size(),
                d.bin,
                d.grid.len(),
                ms(best.trace),
                ms(best.forward),
                ms(best.back),
                ms(best.lens),
                total(&best) / of_rays,
            );
        }
    }
    out
}

/// What [`cheapest`] chooses for the patches.
pub(crate) fn choices() -> String {
    let mut out = String::from(
        "\n| lens | wavelengths | stop points | field nodes within | cells at most | gradient off by | below the limits | a step, ms |\n|---|---|---|---|---|---|---|---|\n",
    );
    for step in Step::all() {
        let patches = step.patches();
        let chosen = cheapest(&patches).expect("renders");
        let s = chosen.settings;
        let seconds = (0..3).map(|_| patches.measure(s).expect("renders").seconds).fold(f64::INFINITY, f64::min);
        out += &format!(
            "| {} | {} | {} | {} | {} | {:.3} | {} | {:.0} |\n",
            step.name,
            s.wavelengths,
            s.dense,
            s.node_error,
            s.cells,
            chosen.error,
            if chosen.holds { "yes" } else { "no" },
            1e3 * seconds
        );
    }
    out
}
