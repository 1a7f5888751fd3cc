//! Kernels by diffraction: error against run time of the pupil's sampling and of wavelengths.

use std::hint::black_box;

use isoplanat::psf::Quadrature;
use isoplanat::psf::splat::Raster;
use isoplanat::report::plot::{Mark, Plot, Scale, Series};

use super::cases::{Case, colours, errors, milliseconds, one, short};

/// Lens, f-number (its own where none is given), farthest sensor radius and pixel pitch, mm.
const LENSES: [(&str, Option<f64>, f64, f64); 6] = [
    ("biotar", None, 18.0, 4e-3),
    ("double_gauss", None, 7.0, 4e-3),
    ("double_gauss", Some(8.0), 7.0, 4e-3),
    ("double_gauss", Some(16.0), 7.0, 4e-3),
    ("cooke_triplet", Some(8.0), 17.0, 4e-3),
    ("phone", None, 2.6, 1.1e-3),
];
/// Shares of the farthest radius.
const PLACES: [f64; 3] = [0.0, 0.5, 0.9];
/// Periods over the one that kernels take, and the one they are held against.
const PERIODS: [f64; 7] = [0.5, 0.71, 0.84, 1.0, 1.41, 2.0, 2.83];
const FINE_PERIOD: f64 = 4.0;
/// Numbers of wavelengths, and the one they are held against.
const WAVELENGTHS: [usize; 6] = [3, 4, 5, 7, 9, 12];
const MANY: usize = 36;

pub(crate) fn print() {
    periods();
    wavelengths();
}

/// How a lens at a stop is named.
pub(crate) fn named(name: &str, f_number: Option<f64>) -> String {
    f_number.map_or_else(|| format!("{name}, own"), |n| format!("{name}, f/{n}"))
}

/// Writes a plot beside the tables.
pub(crate) fn write(file: &str, plot: &Plot) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results");
    std::fs::write(folder.join(file), plot.to_svg()).expect("writes");
}

fn periods() {
    println!("\n### Sampling of the pupil\n");
    println!("| lens | place | samples across at 1 | {} |", PERIODS.map(|p| p.to_string()).join(" | "));
    println!("|---|---|---|{}", "---|".repeat(PERIODS.len()));
    let mut series = Vec::new();
    for (name, f_number, radius_mm, pitch_mm) in LENSES {
        let case = Case::new(name, f_number, radius_mm, one(550.0)).expect("traces");
        let mut points = [[0.0f64; 2]; PERIODS.len()];
        for share in PLACES {
            let point = case.point(share);
            let Some(pupil) = case.waves.pupil(0, 0, point) else { continue };
            let size = case.window(point, pitch_mm);
            let (raster, window_mm) = (Raster { size, samples: 1 }, size as f64 * pitch_mm);
            let made = |times: f64, out: &mut Vec<f64>| {
                out.resize(raster.len(), 0.0);
                pupil.kernel_of_period(times, point.outward(), (raster, pitch_mm), out)
            };
            let mut exact = Vec::new();
            made(FINE_PERIOD, &mut exact);
            let cells = PERIODS.iter().zip(&mut points).map(|(times, to)| {
                let mut found = Vec::new();
                let ms = milliseconds(|| {
                    black_box(made(*times, &mut found));
                });
                let [peak, _] = errors(&found, &exact);
                *to = [to[0] + ms / PLACES.len() as f64, to[1].max(peak)];
                format!("{} / {ms:.2}", short(peak))
            });
            let cells: Vec<String> = cells.collect();
            let across = pupil.samples_across(window_mm);
            println!("| {} | {share} | {across:.0} | {} |", named(name, f_number), cells.join(" | "));
        }
        series.push(Series { name: named(name, f_number), points: points.to_vec(), mark: Mark::Both });
    }
    let plot = Plot {
        title: "Sampling of the pupil: error against run time".into(),
        x_label: "ms a kernel of one wavelength".into(),
        y_label: "largest error, of the peak".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
        keys: Vec::new(),
    };
    write("diffraction_sampling.svg", &plot);
}

fn wavelengths() {
    println!("\n### Wavelengths\n");
    println!("| lens | place | {} |", WAVELENGTHS.map(|p| p.to_string()).join(" | "));
    println!("|---|---|{}", "---|".repeat(WAVELENGTHS.len()));
    let mut series = Vec::new();
    for (name, f_number, radius_mm, pitch_mm) in LENSES {
        let many = Case::new(name, f_number, radius_mm, colours(MANY)).expect("traces");
        let mut points = [[0.0f64; 2]; WAVELENGTHS.len()];
        let cases = WAVELENGTHS.map(|n| {
            let quadrature: Quadrature = colours(n);
            Case::new(name, f_number, radius_mm, quadrature).expect("traces")
        });
        for share in PLACES {
            let point = many.point(share);
            let size = many.window(point, pitch_mm);
            let made = |case: &Case, out: &mut Vec<f64>| {
                let form = case.rays.form(3000, size, 1, pitch_mm);
                out.resize(form.channels() * form.raster.len(), 0.0);
                case.waves.kernels(&form, 0, point, out);
            };
            let mut exact = Vec::new();
            made(&many, &mut exact);
            let len = exact.len() / 3;
            let cells = cases.iter().zip(&mut points).map(|(case, to)| {
                let mut found = Vec::new();
                let ms = milliseconds(|| made(case, &mut found));
                // The worst of three channels.
                let of = |c: usize| errors(&found[c * len..][..len], &exact[c * len..][..len])[0];
                let peak = (0..3).map(of).fold(0.0, f64::max);
                *to = [to[0] + ms / PLACES.len() as f64, to[1].max(peak)];
                format!("{} / {ms:.1}", short(peak))
            });
            let cells: Vec<String> = cells.collect();
            println!("| {} | {share} | {} |", named(name, f_number), cells.join(" | "));
        }
        series.push(Series { name: named(name, f_number), points: points.to_vec(), mark: Mark::Both });
    }
    let plot = Plot {
        title: "Wavelengths of a channel's kernel: error against run time".into(),
        x_label: "ms a kernel of three channels".into(),
        y_label: "largest error, of the peak".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
        keys: Vec::new(),
    };
    write("diffraction_wavelengths.svg", &plot);
}
