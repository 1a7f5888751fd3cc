//! The MTF loop closed: what rays predict of a lens, what a slanted edge shows in the reference renderer's capture, and what it shows in the
//! reconstruction of that capture.
//!
//! At every place of the field two edges are photographed, one after the other: their normals lie [`TILT_DEG`] off the meridian (tangential MTF) and off
//! its perpendicular (sagittal MTF). Green pixels of the mosaic, without noise and over the relative illumination, are measured by
//! [`mod@crate::imaging::metrics::slanted_edge`]; a network sees the capture with the sensor's noise, and the green of what it makes is measured in the same way. The prediction is the modulus of the mean of `exp(−2πi f·p)` over
//! rays along the measured normal, wavelengths by the green channel's density, times the MTF of a square pixel. The scene's own texels
//! (areas of the step between which it runs evenly; 8 a pixel, down to 2 where a wide blur asks for large patches) are divided out of what is measured:
//! half a cycle a pixel by 2 % with eight, by a quarter with two.
//!
//! What this does not see: blur that changes within the patch, skirts wider than it (the largest patch holds spots to 17 pixels rms), and the fine core
//! of a spot within wide skirts, whose edge the estimator follows by knots as wide as the skirts ask for.
//!
//! Neither way knows diffraction. They share the lens and the trace, and nothing else: rays from the object through an aimed stop on one side, rays from the sensor
//! through a random aperture on the other.

use std::time::Instant;

use glam::{DVec2, DVec3};
use ndarray::{Array2, Array3};
use serde_json::{Value, json};

use super::field::FieldLine;
use super::plot::{Mark, Plot, Series};
use super::table::{Table, significant};
use crate::analysis::beam::{Beam, Landing, stop_points};
use crate::analysis::spot::{geometric_mtf, joined, spot};
use crate::error::{Error, Result};
use crate::imaging::frame::Frame;
use crate::imaging::metrics::slanted_edge::{EdgeMeasurement, EdgeOptions, Sites, measure};
use crate::imaging::plane::{Plane, Region};
use crate::imaging::reference::{self, Channels, Sampling};
use crate::imaging::render::frame_of;
use crate::imaging::sensor::Sensor;
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::psf::table::chief_slopes;
use crate::psf::{Optics, OpticsSpec, Quadrature};
use crate::trace::{ObjectPoint, System};

/// Angle between an edge's normal and the direction that it stands for, degrees.
pub const TILT_DEG: f64 = 5.0;
/// Texels a pixel, at least and at most, and of a patch's side where there is room.
const TEXELS: [usize; 3] = [2, 8, 512];
/// Radiance of the dark and the bright side; white is 1.
const LEVELS: [f32; 2] = [0.1, 0.7];
/// Side of a patch: at least so many pixels, so many times the spot's rms radius more, at most so many.
const SIDE: [usize; 2] = [48, 256];
const SPOTS: f64 = 12.0;
/// Rows and columns of a patch start at multiples of this: a mosaic's cell, and what a network halves.
const STEP: usize = 4;
/// Rays of the prediction a wavelength, and wavelengths.
const RAYS: usize = 1600;
const WAVELENGTHS: usize = 12;
/// Least side of a patch, pixels.
const LEAST: usize = 24;
/// Largest part of the scene along the radius over that across which a patch is photographed: three sides of it are drawn.
const STRETCHED: f64 = 2.5;
/// Radii of the relative illumination, less one.
const ILLUMINATIONS: u32 = 64;
/// Names of the two directions.
const NAMES: [&str; 2] = ["T", "S"];
/// Names of the plots by place.
const PLOTS: [&str; 6] =
    ["mtf_measured_0", "mtf_measured_1", "mtf_measured_2", "mtf_measured_3", "mtf_measured_4", "mtf_measured_5"];

/// How it is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Places from the axis to the end of the field, 1 to 6.
    pub places: usize,
    /// Rays a pixel of the captures.
    pub rays: usize,
    /// Seed of rays and noise.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { places: 4, rays: 1024, seed: 1 }
    }
}

/// What a camera makes of a region of the frame.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Irradiance in each pixel's own colour, without noise, `[row, col]`.
    pub mosaic: Array2<f32>,
    /// The developed capture, with noise, and its reconstruction, both `[3, row, col]`; none without a network.
    pub developed: Option<[Array3<f32>; 2]>,
}

/// A camera: what it makes of a region in front of a scene.
pub type Camera<'a> = &'a dyn Fn(&Plane, Region) -> Result<Seen>;

/// One edge at one place.
#[derive(Clone, Debug)]
pub struct Edge {
    /// Cycles/mm and the modulation that rays predict along the capture's measured normal, or along the ideal one.
    pub design: Vec<[f64; 2]>,
    /// The edge in the capture's green pixels; why there is none.
    pub capture: Result<EdgeMeasurement, String>,
    /// The edge in the reconstruction's green; nothing without a network.
    pub reconstruction: Option<Result<EdgeMeasurement, String>>,
    /// Developed capture and reconstruction, `[3, row, col]`.
    pub pictures: Option<[Array3<f32>; 2]>,
}

/// One place of the field.
#[derive(Clone, Debug)]
pub struct Place {
    /// Distance of the patch's middle from the axis on the sensor, mm.
    pub height_mm: f64,
    /// Side of the patch, pixels.
    pub side: usize,
    /// Texels a pixel of the scene.
    pub texels: usize,
    /// Tangential and sagittal.
    pub edges: [Edge; 2],
}

/// The loop over the field.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Places, from the axis.
    pub places: Vec<Place>,
    /// Places that could not be photographed, and why.
    pub failed: Vec<String>,
    /// Settings.
    pub settings: Settings,
    /// Pixel pitch, mm.
    pub pitch_mm: f64,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// A camera without a network: the reference renderer's mosaic.
///
/// # Errors
/// As [`reference::render`].
pub fn by_rays(
    lens: &Lens,
    sensor: &Sensor,
    frame: &Frame,
    settings: Settings,
) -> impl Fn(&Plane, Region) -> Result<Seen> + use<> {
    let (lens, frame, density) = (lens.clone(), frame.clone(), SpectralDensity::new(sensor));
    let how = reference::Settings {
        samples: settings.rays,
        seed: settings.seed,
        channels: Channels::Bayer(sensor.cfa),
        sampling: Sampling::Bounded,
    };
    move |scene, region| {
        let rendered = reference::render(&lens, scene, &density, &frame, region, how, None)?;
        Ok(Seen { mosaic: rendered.mosaic(), developed: None })
    }
}

/// The loop for `lens` in front of `sensor`, seen by `camera`; `progress` gets the share done.
///
/// # Errors
/// Settings out of range; a lens without symmetry or light on the axis, or whose light the sensor does not see. A place that cannot be
/// photographed is among [`Measured::failed`].
pub fn close(
    lens: &Lens,
    sensor: &Sensor,
    settings: Settings,
    camera: Camera<'_>,
    progress: &mut dyn FnMut(f64),
) -> Result<Measured> {
    if !(1..=PLOTS.len()).contains(&settings.places) {
        return Err(Error::bad("", "places", settings.places.to_string(), format!("1 to {}", PLOTS.len())));
    }
    let begun = Instant::now();
    SpectralDensity::new(sensor).require(lens)?;
    let frame = frame_of(lens)?;
    let line = FieldLine::new(lens, lens.object_vergence, settings.places)?;
    let end = line.radius_mm.last().copied().unwrap_or(0.0);
    #[expect(clippy::cast_precision_loss, reason = "a patch")]
    let light = Light::new(lens, sensor, (end + SIDE[1] as f64 * frame.pitch_mm).min(frame.max_radius_mm()))?;
    let (mut places, mut failed, mut last) = (Vec::new(), Vec::new(), None);
    for (k, radius) in line.radius_mm.iter().enumerate() {
        let mut place = || -> Result<Option<Place>> {
            let target = Target::new(lens, &frame, &light, *radius)?;
            // Of a frame that is little larger than a patch all places are one.
            if last.replace(target.region) == Some(target.region) {
                return Ok(None);
            }
            let mut edge = |direction: usize| -> Result<Edge> {
                let edge = target.edge(direction, sensor, &light, camera)?;
                #[expect(clippy::cast_precision_loss, reason = "a few places")]
                progress((2 * k + direction + 1) as f64 / (2 * line.radius_mm.len()) as f64);
                Ok(edge)
            };
            let edges = [edge(0)?, edge(1)?];
            Ok(Some(Place { height_mm: target.radius, side: target.region.rows, texels: target.texels, edges }))
        };
        match place() {
            Ok(place) => places.extend(place),
            Err(e) => failed.push(format!("slanted edges {} mm from the axis: {e}", significant(*radius, 4))),
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    Ok(Measured { places, failed, settings, pitch_mm: frame.pitch_mm, seconds })
}

/// The lens in the light that green pixels see.
struct Light {
    systems: Vec<System>,
    shares: Vec<f64>,
    /// For its relative illumination.
    optics: Optics,
}

impl Light {
    /// Out to `radius` mm from the axis.
    fn new(lens: &Lens, sensor: &Sensor, radius: f64) -> Result<Self> {
        let spectrum = SpectralDensity::new(sensor).quadrature(WAVELENGTHS);
        let systems = spectrum.wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let [_, shares, _] = spectrum.weight;
        let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: vec![shares.clone()] };
        let spec = OpticsSpec::even(radius.max(1e-3), vec![lens.object_vergence], quadrature);
        Ok(Self { systems, shares, optics: Optics::compute(lens, &spec)?.illuminated(ILLUMINATIONS) })
    }

    /// Irradiance of white at a distance from the axis, mm, over that on it.
    fn white(&self, radius: f64) -> f64 {
        self.optics.relative_illumination(radius)[0]
    }

    /// Rays of the object at a slope, meridian of y.
    fn rays(&self, slope: f64, vergence: f64) -> Vec<Landing> {
        let to = DVec3::new(0.0, slope, 1.0);
        let object = if vergence == 0.0 { ObjectPoint::infinite(to) } else { ObjectPoint::finite(-to / vergence) };
        let points = stop_points(RAYS);
        let beams: Vec<Beam> = self.systems.iter().map(|s| Beam::new(s, object, &points)).collect();
        joined(beams.iter().zip(&self.shares).map(|(b, share)| (&b.landings[..], *share)))
    }
}

/// A patch at a place of the field.
struct Target<'a> {
    frame: &'a Frame,
    vergence: f64,
    region: Region,
    /// Of its middle: distance from the axis, mm; direction outwards in pixels, columns and rows; object slope.
    radius: f64,
    outwards: DVec2,
    slope: f64,
    /// Object slope per mm of the sensor about the patch.
    ratio: f64,
    /// Texels a pixel.
    texels: usize,
    rays: Vec<Landing>,
}

impl<'a> Target<'a> {
    fn new(lens: &Lens, frame: &'a Frame, light: &Light, radius: f64) -> Result<Self> {
        let slope_at = |radius: f64| -> Result<f64> { Ok(chief_slopes(lens, lens.object_vergence, &[radius])?[0]) };
        let blur =
            spot(&light.rays(slope_at(radius)?, lens.object_vergence), 0.0).map_or(0.0, |s| s.rms / frame.pitch_mm);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited")]
        let side = (SIDE[0] + (SPOTS * blur).min(1e4) as usize).min(SIDE[1]).next_multiple_of(STEP);
        // What the frame has room for: the edge itself tells whether that is enough.
        let side = side.min(frame.rows.min(frame.columns) / STEP * STEP);
        if side < LEAST {
            let found = format!("{} × {} pixels", frame.columns, frame.rows);
            return Err(Error::bad("", "frame", found, format!("at least {LEAST} × {LEAST} for a slanted edge")));
        }
        // Towards the farthest corner, as far as the patch stays inside.
        let corner = [0, 1].map(|k| {
            #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
            let all = [frame.columns, frame.rows][k] as f64;
            (if all - frame.axis_px[k] >= frame.axis_px[k] { all } else { 0.0 }) - frame.axis_px[k]
        });
        let towards = DVec2::from(corner).normalize_or(DVec2::X);
        let start = [0, 1].map(|k| {
            let all = [frame.columns, frame.rows][k];
            #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
            let (half, last) = (0.5 * side as f64, (all - side) as f64);
            let first = frame.axis_px[k] + radius / frame.pitch_mm * towards[k] - half;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the frame")]
            let first = first.clamp(0.0, last) as usize;
            first / STEP * STEP
        });
        let region = Region { row: start[1].cast_signed(), col: start[0].cast_signed(), rows: side, cols: side };
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let middle = [0, 1].map(|k| start[k] as f64 + 0.5 * side as f64 - frame.axis_px[k]);
        let from_axis = DVec2::from(middle);
        let radius = from_axis.length() * frame.pitch_mm;
        let near = radius.max(1e-3 * frame.max_radius_mm());
        let (ratio, slope) = (slope_at(near)? / near, slope_at(radius)?);
        #[expect(clippy::cast_precision_loss, reason = "a patch")]
        let reach = 0.25 * side as f64 * frame.pitch_mm;
        let inner = (radius - reach).max(0.0);
        // Where light ends there, as far as the middle.
        let (outer, end) = slope_at(radius + reach).map_or((radius, slope), |end| (radius + reach, end));
        let radial = if outer > inner { (end - slope_at(inner)?) / (outer - inner) } else { ratio };
        if radial.abs() > STRETCHED * ratio.abs() {
            let found =
                format!("{} times as much of the scene along the radius as across", significant(radial / ratio, 3));
            return Err(Error::bad("", "distortion", found, format!("at most {STRETCHED} times")));
        }
        let texels = (TEXELS[2] / side).clamp(TEXELS[0], TEXELS[1]);
        let rays = light.rays(slope, lens.object_vergence);
        let outwards = if from_axis.length() > 0.5 * STEP as f64 { from_axis.normalize() } else { towards };
        Ok(Self { frame, vergence: lens.object_vergence, region, radius, outwards, slope, ratio, texels, rays })
    }

    /// Direction of an edge's normal, columns and rows.
    fn normal(&self, direction: usize) -> DVec2 {
        let along = if direction == 0 { self.outwards } else { self.outwards.perp() };
        let tilted = |sign: f64| along.rotate(DVec2::from_angle(sign * TILT_DEG.to_radians()));
        // Away from rows, columns and diagonals, along which green pixels stand in few distances from an edge.
        let clear = |n: DVec2| {
            let angle = n.to_angle().to_degrees().rem_euclid(45.0);
            angle.min(45.0 - angle)
        };
        if clear(tilted(1.0)) >= clear(tilted(-1.0)) { tilted(1.0) } else { tilted(-1.0) }
    }

    /// The scene: an even step through the middle of the patch, as wide as the patch and its blur.
    fn scene(&self, direction: usize) -> Plane {
        let texels = self.region.rows * self.texels * 3;
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let middle = 0.5 * texels as f64;
        let n = self.normal(direction);
        // Share of a texel on the bright side: the step over the square, exactly.
        let share = |d: f64| {
            let ([p, q], twice) = ([n.x.abs().max(1e-9), n.y.abs().max(1e-9)], |x: f64| 0.5 * x.max(0.0).powi(2));
            let at = |a: f64, b: f64| twice(d + 0.5 * (a * p + b * q));
            (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (p * q)
        };
        #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "raster sizes, radiance")]
        let texture = Array3::from_shape_fn((3, texels, texels), |(_, i, j)| {
            let at = DVec2::new(j as f64 + 0.5 - middle, i as f64 + 0.5 - middle);
            LEVELS[0] + (LEVELS[1] - LEVELS[0]) * share(n.dot(at)).clamp(0.0, 1.0) as f32
        });
        #[expect(clippy::cast_precision_loss, reason = "a few texels")]
        let texels_per_slope = self.texels as f64 / (self.ratio.abs() * self.frame.pitch_mm);
        // Slopes run right and up, texels right and down.
        let [x, y] = (self.outwards * self.slope * texels_per_slope).to_array();
        Plane { texture, texels_per_slope, axis_texel: [middle - x, middle - y], vergence: self.vergence }
    }

    fn edge(&self, direction: usize, sensor: &Sensor, light: &Light, camera: Camera<'_>) -> Result<Edge> {
        let mut seen = camera(&self.scene(direction), self.region)?;
        // A flat field, as a camera's development has one; where it is dark nothing is measured.
        #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "raster sizes, f32 pictures")]
        seen.mosaic.indexed_iter_mut().for_each(|((row, col), v)| {
            let at = [self.region.col as f64 + col as f64 + 0.5, self.region.row as f64 + row as f64 + 0.5];
            let white = light.white(self.frame.radius_mm(at[0], at[1]));
            *v = if white > 0.0 { (f64::from(*v) / white) as f32 } else { 0.0 };
        });
        let green = EdgeOptions { region: None, sites: Sites::of(sensor.cfa, 1), range: None };
        let whole = |options: EdgeOptions, plane: ndarray::ArrayView2<'_, f32>| {
            let all = crate::imaging::metrics::slanted_edge::Rectangle::whole(plane.dim());
            measure(plane, &EdgeOptions { region: Some(all), ..options }).map_err(|e| e.to_string())
        };
        let capture = whole(green, seen.mosaic.view());
        let reconstruction = seen
            .developed
            .as_ref()
            .map(|[_, restored]| whole(EdgeOptions::default(), restored.index_axis(ndarray::Axis(0), 1)));
        let normal = match &capture {
            Ok(edge) => DVec2::from_angle(edge.normal_deg.to_radians()),
            Err(_) => self.normal(direction),
        };
        let pitch = self.frame.pitch_mm;
        // The field's meridian is that of y.
        let along = DVec2::new(normal.perp_dot(self.outwards), normal.dot(self.outwards));
        let pixel = |f: f64| sinc(f * normal.x) * sinc(f * normal.y);
        let design = (0..=50).map(|k| {
            let f = 0.01 * f64::from(k);
            [f / pitch, geometric_mtf(&self.rays, along, f / pitch, 0.0) * pixel(f)]
        });
        Ok(Edge { design: design.collect(), capture, reconstruction, pictures: seen.developed })
    }
}

fn sinc(x: f64) -> f64 {
    let y = std::f64::consts::PI * x;
    if y.abs() < 1e-9 { 1.0 } else { y.sin() / y }
}

/// The measured curve up to half a cycle a pixel, without the scene's texels: cycles/mm, modulation, its standard uncertainty.
pub fn curve(edge: &EdgeMeasurement, texels: usize, pitch_mm: f64) -> Vec<[f64; 3]> {
    let n = DVec2::from_angle(edge.normal_deg.to_radians());
    #[expect(clippy::cast_precision_loss, reason = "a few texels")]
    let own = |f: f64| {
        let f = f / texels as f64;
        // A texel's own area, and the even run between two of them.
        (sinc(f * n.x) * sinc(f * n.y)).powi(3)
    };
    let below = edge.mtf.iter().take_while(|p| p.frequency <= 0.5 + 1e-9);
    below.map(|p| [p.frequency / pitch_mm, p.value / own(p.frequency), p.uncertainty / own(p.frequency)]).collect()
}

/// The value of a curve at half its last frequency.
fn middle<const N: usize>(points: &[[f64; N]]) -> f64 {
    points.get(points.len() / 2).map_or(f64::NAN, |p| p[1])
}

impl Edge {
    /// What was measured, under its name.
    fn all(&self) -> impl Iterator<Item = (&'static str, &Result<EdgeMeasurement, String>)> {
        [("capture", Some(&self.capture)), ("reconstruction", self.reconstruction.as_ref())]
            .into_iter()
            .filter_map(|(name, found)| Some((name, found?)))
    }
}

impl Measured {
    /// Largest difference between the capture's MTF and the prediction of any edge up to half a cycle a pixel; nothing where no edge was
    /// measured.
    pub fn worst(&self) -> Option<f64> {
        let edges = self.places.iter().flat_map(|p| p.edges.iter().map(move |e| (p, e)));
        let off = edges.filter_map(|(p, e)| {
            let found = curve(e.capture.as_ref().ok()?, p.texels, self.pitch_mm);
            Some(found.iter().zip(&e.design).map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f64::max))
        });
        off.reduce(f64::max)
    }

    /// One plot over the field, and one of each place.
    pub fn plots(&self) -> Vec<(&'static str, Plot)> {
        let name = |of: &str, k: usize| format!("{} {of}", NAMES[k]);
        let mut series = Vec::new();
        for k in 0..2 {
            let over = |value: &dyn Fn(&Place, &Edge) -> f64| -> Vec<[f64; 2]> {
                self.places.iter().map(|p| [p.height_mm, value(p, &p.edges[k])]).collect()
            };
            series.push(Series { name: name("design", k), points: over(&|_, e| middle(&e.design)), mark: Mark::Line });
            for (of, mark) in [("capture", Mark::Dashed), ("reconstruction", Mark::Both)] {
                let value = |p: &Place, e: &Edge| {
                    let found = e.all().find(|(name, _)| *name == of).and_then(|(_, found)| found.as_ref().ok());
                    found.map_or(f64::NAN, |found| middle(&curve(found, p.texels, self.pitch_mm)))
                };
                let points = over(&value);
                if points.iter().any(|p| p[1].is_finite()) {
                    series.push(Series { name: name(of, k), points, mark });
                }
            }
        }
        let mut plots = vec![(
            "mtf_measured_field",
            Plot {
                title: format!("Designed and measured MTF at {} cycles/mm", significant(0.25 / self.pitch_mm, 3)),
                x_label: "distance from the axis on the sensor, mm".into(),
                y_label: "MTF with the pixel".into(),
                series,
                ..Plot::default()
            },
        )];
        for (place, plot) in self.places.iter().zip(PLOTS) {
            let mut series = Vec::new();
            for (k, edge) in place.edges.iter().enumerate() {
                series.push(Series { name: name("design", k), points: edge.design.clone(), mark: Mark::Line });
                for (of, found) in edge.all() {
                    let Ok(found) = found else { continue };
                    let points = curve(found, place.texels, self.pitch_mm).iter().map(|p| [p[0], p[1]]).collect();
                    let mark = if of == "capture" { Mark::Dashed } else { Mark::Line };
                    series.push(Series { name: name(of, k), points, mark });
                }
            }
            plots.push((
                plot,
                Plot {
                    title: format!("Designed and measured MTF, {} mm from the axis", significant(place.height_mm, 4)),
                    x_label: "cycles/mm".into(),
                    y_label: "MTF with the pixel".into(),
                    series,
                    ..Plot::default()
                },
            ));
        }
        plots
    }

    /// MTF50 by place and direction.
    pub fn table(&self) -> Table {
        let mut table =
            Table::new(["height/mm", "", "design/(cy/px)", "capture/(cy/px)", "reconstruction/(cy/px)", "side/px"]);
        for place in &self.places {
            for (k, edge) in place.edges.iter().enumerate() {
                let half = |found: Option<&Result<EdgeMeasurement, String>>| match found {
                    None => "–".to_owned(),
                    Some(Err(_)) => "no edge".to_owned(),
                    Some(Ok(e)) => e.mtf50.map_or("beyond".to_owned(), |c| format!("{:.4}", c.frequency)),
                };
                let falls = edge.design.windows(2).find(|w| w[0][1] >= 0.5 && w[1][1] < 0.5);
                let design = falls.map_or("beyond 0.5".to_owned(), |w| {
                    let part = (w[0][1] - 0.5) / (w[0][1] - w[1][1]);
                    format!("{:.4}", (w[0][0] + part * (w[1][0] - w[0][0])) * self.pitch_mm)
                });
                table.row([
                    significant(place.height_mm, 4),
                    NAMES[k].to_owned(),
                    design,
                    half(Some(&edge.capture)),
                    half(edge.reconstruction.as_ref()),
                    place.side.to_string(),
                ]);
            }
        }
        table
    }

    /// What could not be measured or is doubtful, a sentence each.
    pub fn missing(&self) -> Vec<String> {
        let mut out = self.failed.clone();
        for place in &self.places {
            for (edge, name) in place.edges.iter().zip(NAMES) {
                for (of, found) in edge.all() {
                    let height = significant(place.height_mm, 4);
                    let said = |what: &str| format!("MTF of the {of} at {height} mm, {name}: {what}");
                    match found {
                        Err(why) => out.push(said(why)),
                        Ok(found) => out.extend(found.warnings.iter().map(|w| said(w))),
                    }
                }
            }
        }
        out
    }

    /// As JSON: by place and direction the design, and what was measured with its uncertainty.
    pub fn json(&self) -> Value {
        let measured = |p: &Place, found: &Result<EdgeMeasurement, String>| match found {
            Ok(e) => json!({
                "mtf50_cy_per_px": e.mtf50.map(|c| c.frequency),
                "edge_normal_deg": e.normal_deg,
                "warnings": e.warnings,
                "mtf_cy_per_mm_value_uncertainty": curve(e, p.texels, self.pitch_mm),
            }),
            Err(why) => json!({ "error": why }),
        };
        let edge = |p: &Place, k: usize, e: &Edge| {
            json!({
                "direction": NAMES[k],
                "design_cy_per_mm_value": e.design,
                "capture": measured(p, &e.capture),
                "reconstruction": e.reconstruction.as_ref().map(|r| measured(p, r)),
            })
        };
        let place = |p: &Place| {
            let edges: Vec<Value> = p.edges.iter().enumerate().map(|(k, e)| edge(p, k, e)).collect();
            json!({ "height_mm": p.height_mm, "side_px": p.side, "edges": edges })
        };
        json!({
            "rays_per_pixel": self.settings.rays,
            "seed": self.settings.seed,
            "worst_capture_less_design": self.worst(),
            "places": self.places.iter().map(place).collect::<Vec<_>>(),
            "failed": self.failed,
            "seconds": self.seconds,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;

    /// Rays from the object through the stop and rays from the sensor through the rear aperture see one MTF: within 0.02 everywhere up to half
    /// a cycle a pixel (what the captures' rays leave), within 0.006 at a tenth. On a frame whose diagonal is at 40° edges stay off the mosaic's.
    #[test]
    fn what_an_edge_shows_is_what_rays_predict() {
        let sensor = Sensor::generic();
        let frames =
            [("cooke_triplet", None), ("double_gauss", None), ("hologon", None), ("cooke_triplet", Some([2448, 2048]))];
        for (name, frame) in frames {
            let mut lens = builtin::lens(name).expect("shipped");
            if let Some([columns, rows]) = frame {
                let axis_px = [0.5 * columns as f64, 0.5 * rows as f64];
                let sensor = |l: &mut crate::lens::Prescription| {
                    l.sensor = crate::lens::SensorRaster { columns, rows, axis_px, ..l.sensor };
                };
                lens = lens.changed(sensor).expect("a lens");
            }
            let frame = frame_of(&lens).expect("a frame");
            let settings = Settings { places: 3, rays: 1024, seed: 3 };
            let camera = by_rays(&lens, &sensor, &frame, settings);
            let found = close(&lens, &sensor, settings, &camera, &mut |_| {}).expect("light");
            assert_eq!((found.places.len(), found.missing()), (3, Vec::<String>::new()));
            for place in &found.places {
                for (k, edge) in place.edges.iter().enumerate() {
                    let capture = edge.capture.as_ref().expect("an edge");
                    let off = curve(capture, place.texels, found.pitch_mm)
                        .iter()
                        .zip(&edge.design)
                        .map(|(a, b)| (a[1] - b[1]).abs())
                        .fold(0.0, f64::max);
                    eprintln!("{name} {:.2} mm {}: {off:.4}, {} px", place.height_mm, NAMES[k], place.side);
                    let low = curve(capture, place.texels, found.pitch_mm)[10][1] - edge.design[10][1];
                    assert!(low.abs() < 0.006, "{name} {:.2} mm {}: {low:.4}", place.height_mm, NAMES[k]);
                }
            }
            assert!(found.worst().expect("edges") < 0.02, "{name}: {:?}", found.worst());
        }
    }
}
