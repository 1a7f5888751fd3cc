//! The page of one lens, or of two side by side: what `isoplanat report` writes.
//!
//! One [`LensReport`] holds the numbers; `LensReport::plots` are its curves under their names. The page, the JSON form and the table of
//! comma-separated values show the same plots, so that a value under the pointer is one of the JSON's, to six digits. The MTF at the
//! other steps of the focus slider is in the page alone.

pub mod analysis;
pub mod arrays;
mod bars;
mod curves;
mod grid;
mod page;
mod spots;
mod waves;

use std::collections::BTreeMap;
use std::time::Instant;

use ndarray::Array4;
use serde::Serialize;
use serde_json::{Value, json};

use super::atlas::{KernelRequest, KernelSet, colour_kernels};
use super::columns::{Column, table};
use super::field::FieldLine;
use super::health::HealthReport;
use super::listing::Listing;
use super::measured::Measured;
use super::plot::{Plot, Series};
use super::table::{Table, numbered, significant};
use isoplanat_base::error::Result;
use isoplanat_base::math::memory::Limit;
use isoplanat_optics::analysis::diffraction::Mtf;
use isoplanat_optics::analysis::overview::{Field, Overview, Settings};
use isoplanat_optics::analysis::wavefront::{Figures, Map};
use isoplanat_optics::analysis::zernike::Fit;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::{Optics, Quadrature, SensorPoint};
use isoplanat_optics::trace::Cause;

pub use page::html;

/// What to look at.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Rays of a spot and wavelength.
    pub rays: usize,
    /// Field angles, degrees, rising; none: the file's own where it states three to twelve that end where sensor and light do, or five from the axis to the largest.
    pub fields_deg: Vec<f64>,
    /// Largest field angle, degrees; `None` takes where sensor, field or light end.
    pub max_angle_deg: Option<f64>,
    /// Highest frequency of the MTF, cycles/mm; `None` takes the sensor's Nyquist frequency.
    pub cycles_per_mm: Option<f64>,
    /// Frequencies beside the even ones up to that, which then go as far as the highest of them.
    pub asked_cycles_per_mm: Vec<f64>,
    /// Largest shift of the image plane, mm; `None` takes what the foci ask for.
    pub shift_mm: Option<f64>,
    /// Shifts of the image plane to each side.
    pub shifts: u32,
    /// Whether there are spots, fans and MTF: without, curves over the field alone.
    pub spots: bool,
    /// Whether all of it is made: without, neither kernels nor what waves do.
    pub whole: bool,
    /// Whether Strehl ratio and encircled energy are made by diffraction, too.
    pub energy: bool,
    /// Whether kernels are drawn in the colours of the generic sensor: where its band is covered by the lens's media.
    pub colour: bool,
    /// Object distances at which kernels are drawn, mm, a row each; empty: the lens's own.
    pub psf_depths_mm: Vec<f64>,
    /// What kernels may take.
    pub memory: Limit,
}

/// Usual number of shifts of the image plane to each side.
pub const SHIFTS: u32 = 6;
/// Numbers of stated fields that a page shows.
const OWN_FIELDS: std::ops::RangeInclusive<usize> = 3..=12;
/// Part of the largest angle within which stated fields end where sensor and light do.
const FIELD_ENDS: f64 = 0.01;
/// Rays of a kernel.
const KERNEL_RAYS: usize = 8192;
/// What may be left open of paths without a word, wavelengths: a percent of a Strehl ratio.
const TOLD: f64 = 0.016;
/// What may be missing of the light somewhere without a word.
const LOST: f64 = 0.01;
/// Radii at which the irradiance is computed, less one.
const ILLUMINATIONS: u32 = 64;

/// Kernels of the fields, as drawn.
#[derive(Clone, Debug)]
struct Atlas {
    /// `[depth and field, channel, row, col]`.
    kernels: Array4<f32>,
    /// Object distances, mm.
    depths_mm: Vec<f64>,
    /// Field angles at the first of them, degrees.
    angles_deg: Vec<f64>,
    /// Share of the light outside the window, at most.
    outside: f64,
    /// Pixels of a side.
    size: usize,
}

/// A lens and everything that the page shows of it.
#[derive(Clone, Debug)]
pub struct LensReport {
    /// The lens.
    pub lens: Lens,
    /// Its rays.
    pub overview: Overview,
    /// Sensor radius (mm) and irradiance of white over that on the axis.
    illumination: Vec<[f64; 2]>,
    atlas: Option<Atlas>,
    /// What slanted edges show, where they were looked at.
    measured: Option<Measured>,
    /// Whether `isoplanat check` passes, and its table.
    check: (bool, Table),
    /// What could not be shown, and why.
    pub missing: Vec<String>,
    /// Part of the work and its seconds.
    pub seconds: Vec<(&'static str, f64)>,
}

/// The fields that the lens's file states, where a page has room for them and they end where sensor and light do; none otherwise.
fn own_fields(lens: &Lens, max_angle_deg: f64) -> Vec<f64> {
    let own = lens.field_points_deg();
    let ends = own.last().is_some_and(|last| (last - max_angle_deg).abs() <= FIELD_ENDS * max_angle_deg);
    if OWN_FIELDS.contains(&own.len()) && ends { own } else { Vec::new() }
}

/// Rays, curves and MTF of `lens`, and what could not be shown of it.
pub fn look(lens: &Lens, options: &Options) -> (Overview, Vec<String>) {
    let mut missing = Vec::new();
    let last = options.fields_deg.last().copied();
    let max_angle = last.or(options.max_angle_deg).unwrap_or_else(|| {
        let mut stated = |why: String| {
            missing.push(format!("fields end at the stated angle, not with sensor or light: {why}"));
            lens.max_field_deg()
        };
        match FieldLine::new(lens, lens.object_vergence, 2) {
            Ok(line) => match line.angle_deg.last().copied().unwrap_or(0.0) {
                angle if angle > 0.0 || lens.max_field_deg() == 0.0 => angle,
                _ => stated(
                    "the sensor's rays see no field beyond the axis, as behind a lens with an upright image".into(),
                ),
            },
            Err(e) => stated(e.without_file().to_string()),
        }
    });
    let usual = Settings::usual(lens, max_angle);
    let chosen = if options.fields_deg.is_empty() && options.max_angle_deg.is_none() && options.spots {
        own_fields(lens, max_angle)
    } else {
        options.fields_deg.clone()
    };
    let stated = (!chosen.is_empty()).then_some(chosen);
    let settings = Settings {
        angles_deg: stated.unwrap_or(usual.angles_deg),
        rays: options.rays,
        drawn: usual.drawn.min(options.rays / 3),
        shifts: options.shifts,
        cycles_per_mm: options.cycles_per_mm.unwrap_or(usual.cycles_per_mm),
        asked_cycles_per_mm: options.asked_cycles_per_mm.clone(),
        shift_mm: options.shift_mm,
        waves: usual.waves.filter(|_| options.whole),
        energy: options.energy,
        spots: options.spots,
        ..usual
    };
    let overview = Overview::new(lens, settings);
    // What no field has is said once.
    let why = |f: &Field| f.diffracted.as_ref().and_then(|d| d.as_ref().err().cloned());
    let same = overview.fields.len() > 1 && overview.fields.windows(2).all(|f| why(&f[0]) == why(&f[1]));
    if let Some(why) = overview.fields.first().and_then(why).filter(|_| same) {
        missing.push(format!("encircled energy by diffraction: {why}"));
    }
    for f in &overview.fields {
        let angle = significant(f.angle_deg, 4);
        if let Some(failure) = f.failure {
            missing.push(if failure.cause == Cause::NotConverged && failure.surface == lens.stop {
                format!("at {angle}° no ray is found through some points of the stop, which count as dark; `isoplanat check` says whether a clear one exists")
            } else {
                let cause = failure.cause.name().replace('_', " ");
                format!("at {angle}° some rays end at surface {}: {cause}", failure.surface)
            });
        }
        match (&f.diffraction, &f.spot) {
            (Some(Err(fault)), Some(_)) => missing.push(format!("MTF by diffraction at {angle}°: {fault}")),
            (Some(Ok(mtf)), _) if mtf.residual_waves > TOLD => {
                let left = significant(mtf.residual_waves, 1);
                missing.push(format!("MTF by diffraction at {angle}°: paths are told to {left} wavelengths only"));
            }
            _ => {}
        }
        match &f.diffracted {
            Some(Err(why)) if f.spot.is_some() && !same => {
                missing.push(format!("encircled energy by diffraction at {angle}°: {why}"));
            }
            Some(Ok(energy)) if energy.residual_waves > TOLD => {
                let left = significant(energy.residual_waves, 1);
                missing.push(format!(
                    "encircled energy by diffraction at {angle}°: paths are told to {left} wavelengths only"
                ));
            }
            _ => {}
        }
        if f.spot.is_none() {
            missing.push(format!("at {angle}° no light reaches the sensor"));
        }
    }
    (overview, missing)
}

/// What one field shows; lengths in mm, nothing where there is no light.
#[derive(Clone, Debug, Serialize)]
pub struct SpotRow {
    angle_deg: f64,
    chief_height_mm: Option<f64>,
    rms_mm: Option<f64>,
    rms_change_mm: Option<f64>,
    rms_along_mm: Option<[f64; 2]>,
    radius_mm: Option<f64>,
    centroid_mm: Option<[f64; 2]>,
    best_focus_mm: Option<[f64; 3]>,
    best_rms_mm: Option<f64>,
    open_part: f64,
    encircled_50_80_95_mm: Option<[f64; 3]>,
    encircled_diffraction_50_80_95_mm: Option<[Option<f64>; 3]>,
    strehl: Option<f64>,
    mtf_change: f64,
    mtf_diffraction_error: Option<f64>,
    mtf_diffraction_residual_waves: Option<f64>,
    wavefront: Option<WavefrontRow>,
}

const SPOTS: [Column<SpotRow>; 11] = [
    Column::shown("field/deg", |s| significant(s.angle_deg, 4)),
    Column::shown("height/mm", |s| s.chief_height_mm.map_or("–".to_owned(), |y| significant(y, 6))),
    Column::shown("rms/µm", |s| um(s.rms_mm)),
    Column::shown("in x/µm", |s| um(s.rms_along_mm.map(|r| r[0]))),
    Column::shown("in y/µm", |s| um(s.rms_along_mm.map(|r| r[1]))),
    Column::shown("radius/µm", |s| um(s.radius_mm)),
    Column::shown("50 %/µm", |s| um(s.encircled_50_80_95_mm.map(|e| e[0]))),
    Column::shown("80 %/µm", |s| um(s.encircled_50_80_95_mm.map(|e| e[1]))),
    Column::shown("best focus/µm", |s| um(s.best_focus_mm.map(|z| z[2]))),
    Column::shown("rms there/µm", |s| um(s.best_rms_mm)),
    Column::shown("open", |s| format!("{:.4}", s.open_part)),
];

/// What waves make of it, beside [`SPOTS`].
const WAVES: [Column<SpotRow>; 3] = [
    Column::shown("50 % by diffraction/µm", |s| um(s.encircled_diffraction_50_80_95_mm.and_then(|e| e[0]))),
    Column::shown("80 % by diffraction/µm", |s| um(s.encircled_diffraction_50_80_95_mm.and_then(|e| e[1]))),
    Column::shown("Strehl", |s| s.strehl.map_or("–".to_owned(), |v| significant(v, 3))),
];

fn um(mm: Option<f64>) -> String {
    mm.map_or("–".to_owned(), |v| significant(1e3 * v, 4))
}

/// Spots by field as a table: image height, rms radius and its parts, largest radius, radii that hold 50 and 80 % of the light, the best focus and
/// the rms there, the part of the stop's rays that arrives; radii of 50 and 80 % by diffraction and the Strehl ratio where they were made.
pub fn spot_table(o: &Overview) -> Table {
    let waves = if o.settings.energy { &WAVES[..] } else { &[] };
    table(&[&SPOTS[..], waves].concat(), &spot_rows(o))
}

/// What every field shows.
pub fn spot_rows(o: &Overview) -> Vec<SpotRow> {
    let row = |f: &Field| {
        let waves = f.diffraction.as_ref().and_then(|d| d.as_ref().ok());
        let energy = f.diffracted.as_ref().and_then(|d| d.as_ref().ok());
        SpotRow {
            angle_deg: f.angle_deg,
            chief_height_mm: f.chief.map(|c| c.y),
            rms_mm: f.rms.map(|r| r.value),
            rms_change_mm: f.rms.map(|r| r.change),
            rms_along_mm: f.spot.map(|s| s.rms_along.to_array()),
            radius_mm: f.spot.map(|s| s.radius),
            centroid_mm: f.spot.map(|s| s.centroid.to_array()),
            best_focus_mm: f.best_focus,
            best_rms_mm: f.best_rms,
            open_part: f.open_part,
            encircled_50_80_95_mm: f.energy,
            encircled_diffraction_50_80_95_mm: energy.map(|e| e.radii),
            strehl: energy.map(|e| e.strehl),
            mtf_change: f.mtf_change,
            mtf_diffraction_error: waves.map(sampling_error),
            mtf_diffraction_residual_waves: waves.map(|m| m.residual_waves),
            wavefront: f.map.as_ref().map(WavefrontRow::from),
        }
    };
    o.fields.iter().map(row).collect()
}

/// Largest error of the sampling of a transfer function.
fn sampling_error(mtf: &Mtf) -> f64 {
    mtf.curves.iter().map(|c| c.error).fold(0.0, f64::max)
}

/// A map of path differences and its Zernike terms, for machines.
#[derive(Clone, Debug, Serialize)]
struct WavefrontRow {
    wavelength_nm: f64,
    about_the_chief_ray: Figures,
    about_the_best_point: Figures,
    best_point_mm: [f64; 3],
    open_part: f64,
    zernike: Option<Vec<Zernike>>,
    zernike_residual_rms_waves: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
struct Zernike {
    noll: usize,
    name: Option<String>,
    waves: f64,
}

impl From<&(Map, Option<Fit>)> for WavefrontRow {
    fn from((map, fit): &(Map, Option<Fit>)) -> Self {
        let terms = |fit: &Fit| {
            let term = |(k, waves): (usize, &f64)| Zernike {
                noll: k + 1,
                name: fit.order.term(k + 1).map(|t| t.name()),
                waves: *waves,
            };
            fit.coefficients.iter().enumerate().map(term).collect()
        };
        Self {
            wavelength_nm: map.wavelength_nm,
            about_the_chief_ray: map.figures,
            about_the_best_point: map.best,
            best_point_mm: map.shift.to_array(),
            open_part: map.open,
            zernike: fit.as_ref().map(terms),
            zernike_residual_rms_waves: fit.as_ref().map(|f| f.residual_rms),
        }
    }
}

/// The spots on the sensor as one drawing (SVG).
pub fn spot_svg(o: &Overview) -> String {
    spots::panels(o, 0.0, spots::half_side(o), None)
}

/// Curves of rays alone, under their names: those of `LensReport::plots` but for the illumination.
pub fn plots(o: &Overview) -> Vec<(&'static str, Plot)> {
    curves::all(o, &[])
}

/// A plot, for machines.
#[derive(Serialize)]
struct PlotRow<'a> {
    title: &'a str,
    x: &'a str,
    y: &'a str,
    series: Vec<SeriesRow<'a>>,
}

/// One curve of it; what is not finite is left out.
#[derive(Serialize)]
struct SeriesRow<'a> {
    name: &'a str,
    points: Vec<&'a [f64; 2]>,
}

impl<'a> From<&'a Plot> for PlotRow<'a> {
    fn from(p: &'a Plot) -> Self {
        let series = p.series.iter().map(|s| SeriesRow { name: &s.name, points: numbers(s).collect() }).collect();
        Self { title: &p.title, x: &p.x_label, y: &p.y_label, series }
    }
}

/// Curves as JSON: under their names, pairs of numbers by series; what is not finite is left out.
pub fn plots_json<'a>(plots: impl IntoIterator<Item = &'a (&'static str, Plot)>) -> Value {
    json!(plots.into_iter().map(|(name, p)| (*name, p.into())).collect::<BTreeMap<_, PlotRow<'_>>>())
}

/// Points of a curve that are numbers.
fn numbers(series: &Series) -> impl Iterator<Item = &[f64; 2]> {
    series.points.iter().filter(|p| p[0].is_finite() && p[1].is_finite())
}

/// Curves as comma-separated values: plot, series, x, y.
pub fn plots_csv<'a>(plots: impl IntoIterator<Item = &'a (&'static str, Plot)>) -> String {
    let mut table = Table::new(["plot", "series", "x", "y"]);
    for (name, plot) in plots {
        for s in &plot.series {
            for [x, y] in numbers(s) {
                table.row([(*name).to_owned(), s.name.clone(), x.to_string(), y.to_string()]);
            }
        }
    }
    table.csv()
}

/// Everything about a lens, for machines.
#[derive(Serialize)]
struct Everything<'a> {
    lens: Value,
    wavelengths: Vec<Wavelength>,
    rays: usize,
    airy_radius_mm: f64,
    shifts_mm: &'a [f64],
    cycles_per_mm: &'a [f64],
    fields: Vec<SpotRow>,
    plots: Value,
    measured: Option<Value>,
    check_passes: bool,
    missing: &'a [String],
    seconds: Vec<Timed>,
}

/// A wavelength and its share of the light.
#[derive(Serialize)]
struct Wavelength {
    nm: f64,
    share: f64,
}

/// A part of the work, and how long it took.
#[derive(Serialize)]
struct Timed {
    part: &'static str,
    seconds: f64,
}

impl LensReport {
    /// Looks at `lens`.
    ///
    /// What a lens does not have (light off the axis, symmetry for curves over the field) is listed as missing; nothing fails.
    pub fn new(lens: Lens, options: &Options) -> Self {
        let start = Instant::now();
        let (overview, missing) = look(&lens, options);
        let end = start.elapsed().as_secs_f64() - overview.seconds.iter().sum::<f64>();
        let [spots, waves, curves] = overview.seconds;
        let seconds = vec![
            ("end of the field", end),
            ("spots, fans, geometric MTF", spots),
            ("wavefronts, MTF and energy by diffraction", waves),
            ("curves over field and zones", curves),
        ];
        let start = Instant::now();
        let health = HealthReport::new(&lens);
        let check = (health.health().passes(), health.table());
        let mut report =
            Self { lens, overview, illumination: Vec::new(), atlas: None, measured: None, check, missing, seconds };
        report.seconds.push(("numerical check", start.elapsed().as_secs_f64()));
        let start = Instant::now();
        match report.white() {
            Ok((white, lost)) => {
                report.illumination = white;
                if lost > LOST {
                    let lost = significant(100.0 * lost, 2);
                    let cause = "rays of a part of the stop fail there, and not everywhere beside it";
                    report.missing.push(format!("up to {lost} % of the light near the end of the field: {cause}"));
                }
            }
            Err(e) => report.missing.push(format!("relative illumination: {}", e.without_file())),
        }
        report.seconds.push(("relative illumination", start.elapsed().as_secs_f64()));
        if options.whole {
            let start = Instant::now();
            match report.kernels(options) {
                Ok(atlas) => report.atlas = Some(atlas),
                Err(e) => report.missing.push(format!("point spread functions: {}", e.without_file())),
            }
            report.seconds.push(("point spread functions", start.elapsed().as_secs_f64()));
        }
        report
    }

    /// With what slanted edges show in captures, and in reconstructions of them.
    #[must_use]
    pub fn with_measured(mut self, measured: Measured) -> Self {
        self.missing.extend(measured.missing());
        self.seconds.push(("slanted edges by rays from the sensor", measured.seconds));
        self.measured = Some(measured);
        self
    }

    /// Irradiance of white over the radius, all wavelengths by their weights; what of it may be missing somewhere, a share.
    fn white(&self) -> Result<(Vec<[f64; 2]>, f64)> {
        let (nm, share): (Vec<f64>, Vec<f64>) = self.overview.colours.iter().copied().unzip();
        let heights: Vec<f64> = self.overview.curve.iter().map(|r| r.height.abs()).collect();
        let radius = heights.iter().copied().fold(0.0, f64::max);
        let (vergence, quadrature) = (self.lens.object_vergence, Quadrature { nm, weight: vec![share] });
        let optics = Optics::even(&self.lens, radius.max(1e-3), vec![vergence], quadrature, ILLUMINATIONS)?;
        let lost = optics.illumination().lost.iter().copied().fold(0.0, f64::max);
        Ok((
            heights
                .into_iter()
                .map(|r| [r, optics.relative_illumination(SensorPoint::along([0.0, 1.0], r))[0]])
                .collect(),
            lost,
        ))
    }

    fn kernels(&self, options: &Options) -> Result<Atlas> {
        let (wavelength_nm, weights) = self.overview.colours.iter().copied().unzip();
        let request = KernelRequest {
            depth_mm: match &options.psf_depths_mm[..] {
                [] => vec![1.0 / self.lens.object_vergence],
                depths => depths.to_vec(),
            },
            wavelength_nm,
            weights,
            fields: self.overview.fields.len().max(1),
            size: None,
            pitch_mm: self.lens.sensor.pitch_mm(),
            rays: KERNEL_RAYS,
            diffraction: false,
            memory: options.memory,
        };
        let set = KernelSet::compute(&self.lens, &request)?;
        let (kernels, outside) = if options.colour {
            let made = colour_kernels(&self.lens, &request)?;
            (made.kernels, made.outside)
        } else {
            let grey = set.polychromatic_kernels();
            let (depths, fields, rows, columns) = grey.dim();
            let grey = grey
                .into_shape_with_order((depths * fields, 1, rows, columns))
                .map_err(|e| isoplanat_base::error::Error::Internal(e.to_string()))?;
            (grey, set.outside.iter().copied().fold(0.0, f64::max))
        };
        let size = kernels.dim().2;
        let angles_deg = set.angle_deg.row(0).to_vec();
        Ok(Atlas { kernels, depths_mm: request.depth_mm, angles_deg, outside, size })
    }

    /// Every curve under its name.
    pub(crate) fn plots(&self) -> Vec<(&'static str, Plot)> {
        let mut plots = curves::all(&self.overview, &self.illumination);
        plots.extend(self.measured.iter().flat_map(Measured::plots));
        plots
    }

    /// Figures with what their sampling leaves open: name, unit, value, largest change (of a transfer function at any of its frequencies)
    /// from a quarter of the rays, by diffraction to 1.4 times as many points each way.
    fn sampled(&self) -> Vec<(String, &'static str, f64, f64)> {
        let (mut rows, o) = (Vec::new(), &self.overview);
        for f in &o.fields {
            let angle = significant(f.angle_deg, 4);
            if let Some(rms) = f.rms {
                rows.push((format!("rms spot radius at {angle}°"), "µm", 1e3 * rms.value, 1e3 * rms.change));
            }
            let middle = f.mtf.len() / 2;
            let at = o.cycles_per_mm.get(middle).map_or(String::new(), |c| significant(*c, 3));
            let mean = |name: &str| format!("{name} at {angle}° and {at} cycles/mm, mean of T and S");
            if let (Some([t, s]), Some(_)) = (f.mtf.get(middle), f.spot) {
                rows.push((mean("geometric MTF"), "", 0.5 * (t + s), f.mtf_change));
            }
            if let Some(Ok(mtf)) = &f.diffraction {
                let on = o.shifts_mm.len() / 2;
                let both: Option<Vec<f64>> = mtf.curves.iter().map(|c| c.modulus(on, middle)).collect();
                if let Some([t, s]) = both.as_deref() {
                    rows.push((mean("MTF by diffraction"), "", 0.5 * (t + s), sampling_error(mtf)));
                }
            }
        }
        rows
    }

    /// Everything as one JSON object: lengths in mm (spots too), curves under their names as pairs.
    pub fn json(&self) -> Value {
        let o = &self.overview;
        numbered(&Everything {
            lens: Listing::new(&self.lens, o.primary_nm).json(),
            wavelengths: o.colours.iter().map(|(nm, share)| Wavelength { nm: *nm, share: *share }).collect(),
            rays: o.settings.rays,
            airy_radius_mm: o.airy_radius,
            shifts_mm: &o.shifts_mm,
            cycles_per_mm: &o.cycles_per_mm,
            fields: spot_rows(o),
            plots: plots_json(&self.plots()),
            measured: self.measured.as_ref().map(Measured::json),
            check_passes: self.check.0,
            missing: &self.missing,
            seconds: self.seconds.iter().map(|(part, seconds)| Timed { part, seconds: *seconds }).collect(),
        })
    }

    /// All curves: plot, series, x, y.
    pub fn csv(&self) -> String {
        plots_csv(&self.plots())
    }
}
