//! Models of a kernel against diffraction, over stops and pixel pitches.

use isoplanat::lens::paraxial::first_order;
use isoplanat::psf::{KernelForm, SensorPoint};
use isoplanat::report::plot::{Mark, Plot, Scale, Series};

use super::cases::{Case, colours, errors, milliseconds, short};
use super::error::write;

/// How a model makes the kernels of a point.
type Model = fn(&Case, &KernelForm, SensorPoint, &mut [f64]);

/// Every model with its name: each makes the kernels of all channels of a form.
const MODELS: [(&str, Model); 3] = [
    ("rays", |case, form, point, out| {
        case.rays.kernels(form, 0, point, out);
    }),
    ("approximate", |case, form, point, out| {
        case.approximate.kernels(form, 0, point, out);
    }),
    ("waves", |case, form, point, out| {
        case.waves.kernels(form, 0, point, out);
    }),
];

/// Lenses and how far from the axis they are looked at, mm.
const LENSES: [(&str, f64); 3] = [("biotar", 18.0), ("double_gauss", 7.0), ("phone", 2.6)];
/// Stops; the first is the lens's own, those that are wider than it are left out.
const STOPS: [Option<f64>; 9] =
    [None, Some(2.0), Some(2.8), Some(4.0), Some(5.6), Some(8.0), Some(11.0), Some(16.0), Some(22.0)];
/// Pixel pitches, µm.
const PITCHES: [f64; 4] = [1.0, 2.0, 5.0, 10.0];
/// Shares of the farthest radius.
const PLACES: [f64; 2] = [0.0, 0.7];
/// The lens whose errors are plotted over time as well.
const TIMED: &str = "double_gauss";
const WAVELENGTHS: usize = 7;
const GREEN: usize = 1;
/// Dense points of rays.
const DENSE: usize = 3000;
/// Period of the kernels that models are held against, over that of kernels by diffraction.
const FINE_PERIOD: f64 = 2.0;

/// The green kernel by diffraction of a finer pupil; a wavelength's that a raster does not tell is of rays there too. How many those are.
fn exact(case: &Case, form: &KernelForm, point: SensorPoint) -> (Vec<f64>, usize) {
    let len = form.raster.len();
    let mut by_waves = vec![0.0; form.channels() * len];
    let geometric = case.waves.kernels_told(form, 0, point, &mut by_waves).1.geometric;
    if geometric > 0 {
        return (by_waves[GREEN * len..][..len].to_vec(), geometric);
    }
    let light = case.rays.illumination().at(point);
    let parts: Vec<f64> = form.weight[GREEN].iter().zip(&light).map(|(w, e)| w * e).collect();
    let whole: f64 = parts.iter().sum();
    let (mut sum, mut kernel) = (vec![0.0; len], vec![0.0; len]);
    for (l, part) in parts.iter().enumerate() {
        let Some(pupil) = case.waves.pupil(l, 0, point) else { continue };
        pupil.kernel_of_period(FINE_PERIOD, point.outward(), (form.raster, form.cell_mm), &mut kernel);
        sum.iter_mut().zip(&kernel).for_each(|(s, k)| *s += part / whole * k);
    }
    (sum, 0)
}

/// What stops show.
type Line = Vec<(f64, Seen)>;

/// Errors of the peak and of all, and milliseconds, of a model at a pitch: the worst place and the mean time.
#[derive(Clone, Copy)]
struct Seen {
    errors: [f64; 2],
    ms: f64,
    /// Whether what it is held against has wavelengths by rays.
    geometric: bool,
}

impl Seen {
    fn words(self) -> String {
        let [peak, all] = self.errors.map(short);
        let mark = if self.geometric { " *" } else { "" };
        format!("{peak} / {all} / {:.1}{mark}", self.ms)
    }
}

fn look(case: &Case, model: Model, pitch_mm: f64) -> Seen {
    let mut seen = Seen { errors: [0.0; 2], ms: 0.0, geometric: false };
    for share in PLACES {
        let point = case.point(share);
        let form =
            KernelForm { keeps_light: false, ..case.rays.form(DENSE, case.window(point, pitch_mm), 1, pitch_mm) };
        let len = form.raster.len();
        let (exact, geometric) = exact(case, &form, point);
        let mut found = vec![0.0; form.channels() * len];
        let ms = milliseconds(|| model(case, &form, point, &mut found));
        let errors = errors(&found[GREEN * len..][..len], &exact);
        seen.errors = [0, 1].map(|k| seen.errors[k].max(errors[k]));
        seen.ms += ms / PLACES.len() as f64;
        seen.geometric |= geometric > 0;
    }
    seen
}

pub(crate) fn print() {
    println!("\n### Models\n");
    let pitches: Vec<String> = PITCHES.iter().map(|p| format!("{p} µm")).collect();
    println!("| lens | f-number | model | {} |", pitches.join(" | "));
    println!("|---|---|---|{}", "---|".repeat(PITCHES.len()));
    for (name, radius_mm) in LENSES {
        let mut own = 0.0;
        let mut lines = vec![[(); PITCHES.len()].map(|()| Vec::new()); MODELS.len()];
        for stop in STOPS {
            if stop.is_some_and(|n| n < 1.1 * own) {
                continue;
            }
            let Some(case) = Case::new(name, stop, radius_mm, colours(WAVELENGTHS)) else { continue };
            let number = stop.unwrap_or_else(|| first_order(&case.lens, case.lens.wavelengths.primary_nm).f_number);
            own = if stop.is_none() { number } else { own };
            for (m, (model, make)) in MODELS.into_iter().enumerate() {
                let seen = PITCHES.map(|pitch| look(&case, make, 1e-3 * pitch));
                for (line, seen) in lines[m].iter_mut().zip(&seen) {
                    line.push((number, *seen));
                }
                let words = seen.map(Seen::words);
                println!("| {name} | {number:.1} | {model} | {} |", words.join(" | "));
            }
        }
        let series = |x: fn(&(f64, Seen)) -> f64| -> Vec<Series> {
            let one = |name: String, line: &Line, mark| {
                // Where both are of rays there is nothing to see.
                let told = line.iter().filter(|(_, seen)| !seen.geometric);
                Series { name, points: told.map(|at| [x(at), at.1.errors[0]]).collect(), mark }
            };
            let [rays, approximate, waves] = &lines[..] else { return Vec::new() };
            // By its colour a pitch is known.
            let of_pitch = |(k, pitch): (usize, f64)| {
                [
                    one(format!("rays, {pitch} µm"), &rays[k], Mark::Both),
                    one(format!("approximate, {pitch} µm"), &approximate[k], Mark::Dashed),
                ]
            };
            let mut all: Vec<Series> = PITCHES.into_iter().enumerate().flat_map(of_pitch).collect();
            all.push(one("waves, the worst pitch".into(), &worst(waves), Mark::Both));
            all
        };
        plot(
            &format!("Models of kernels, {name}"),
            "f-number",
            &format!("diffraction_models_{name}.svg"),
            series(|(number, _)| *number),
        );
        if name == TIMED {
            let title = format!("Models of kernels, {name}: error against run time");
            plot(&title, "ms a kernel of three channels", "diffraction_time.svg", series(|(_, seen)| seen.ms));
        }
    }
}

/// At each stop the pitch with the largest error.
fn worst(lines: &[Line]) -> Line {
    let at = |k: usize| lines.iter().map(|line| line[k]).max_by(|a, b| a.1.errors[0].total_cmp(&b.1.errors[0]));
    (0..lines[0].len()).filter_map(at).collect()
}

fn plot(title: &str, x_label: &str, file: &str, series: Vec<Series>) {
    let plot = Plot {
        title: title.into(),
        x_label: x_label.into(),
        y_label: "largest error, of the peak".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
        keys: Vec::new(),
    };
    write(file, &plot);
}
