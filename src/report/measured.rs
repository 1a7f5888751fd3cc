//! The MTF loop closed: what rays predict of a lens, what a slanted edge shows in the reference renderer's capture, and what it shows in the
//! reconstruction of that capture.
//!
//! At every place of the field two edges are photographed, one after the other: their normals lie [`TILT_DEG`] off the meridian (tangential MTF) and off
//! its perpendicular (sagittal MTF). Green pixels of the mosaic, without noise and over the relative illumination, are measured by
//! [`mod@isoplanat_imaging::metrics::slanted_edge`]; a network sees the capture with the sensor's noise, and the green of what it makes is measured in the same way. The prediction is the modulus of the mean of `exp(−2πi f·p)` over
//! rays along the measured normal, wavelengths by the green channel's density, times the MTF of a square pixel. The scene's own texels
//! (areas of the step between which it runs evenly; 8 a pixel, down to 2 where a wide blur asks for large patches) are divided out of what is measured:
//! half a cycle a pixel by 2 % with eight, by a quarter with two.
//!
//! What this does not see: blur that changes within the patch, skirts wider than it (the largest patch holds spots to 17 pixels rms), and the fine core
//! of a spot within wide skirts, whose edge the estimator follows by knots as wide as the skirts ask for.
//!
//! Neither way knows diffraction. They share the lens and the trace, and nothing else: rays from the object through an aimed stop on one side, rays from the sensor
//! through a random aperture on the other.

mod curves;
mod edge;
#[cfg(feature = "deploy")]
pub mod kit;
mod target;

use std::time::Instant;

use serde::Serialize;
use serde_json::{Value, json};

use super::field::FieldLine;
use super::plot::{Mark, Plot, Series};
use super::table::{Table, significant};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::metrics::slanted_edge::EdgeMeasurement;
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::reference::{self, Channels, Sampling};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;
use target::{Light, SIDE, Target};

pub use curves::Curves;
pub use edge::{Camera, Edge, Seen, curve};
pub use target::{LARGEST, TILT_DEG};

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

/// One place of the field.
#[derive(Clone, Debug)]
pub struct EdgePlace {
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
    pub places: Vec<EdgePlace>,
    /// Places that could not be photographed, and why.
    pub failed: Vec<String>,
    /// Settings.
    pub settings: Settings,
    /// Pixel pitch, mm.
    pub pitch_mm: f64,
    /// What reconstructs, a sentence or two for people; empty where nothing does, or where a run's own network does.
    pub by: String,
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

/// The loop for `lens` in front of `sensor` and its `frame`, seen by `camera`; `progress` gets the share done.
///
/// # Errors
/// Settings out of range; a lens without symmetry or light on the axis, or whose light the sensor does not see. A place that cannot be
/// photographed is among [`Measured::failed`].
pub fn close(
    lens: &Lens,
    sensor: &Sensor,
    frame: &Frame,
    settings: Settings,
    camera: Camera<'_>,
    progress: &mut dyn FnMut(f64),
) -> Result<Measured> {
    if !(1..=PLOTS.len()).contains(&settings.places) {
        return Err(Error::bad("", "places", settings.places.to_string(), format!("1 to {}", PLOTS.len())));
    }
    let begun = Instant::now();
    SpectralDensity::new(sensor).require(lens)?;
    let line = FieldLine::new(lens, lens.object_vergence, settings.places)?;
    let end = line.radius_mm.last().copied().unwrap_or(0.0);
    #[expect(clippy::cast_precision_loss, reason = "a patch")]
    let light = Light::new(lens, sensor, (end + SIDE[1] as f64 * frame.pitch_mm).min(frame.max_radius_mm()))?;
    let (mut places, mut failed, mut last) = (Vec::new(), Vec::new(), None);
    for (k, radius) in line.radius_mm.iter().enumerate() {
        let mut place = || -> Result<Option<EdgePlace>> {
            let target = Target::new(lens, frame, &light, *radius)?;
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
            Ok(Some(EdgePlace { height_mm: target.radius, side: target.region.rows, texels: target.texels, edges }))
        };
        match place() {
            Ok(place) => places.extend(place),
            Err(e) => {
                failed.push(format!("slanted edges {} mm from the axis: {}", significant(*radius, 4), e.without_file()))
            }
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    Ok(Measured { places, failed, settings, pitch_mm: frame.pitch_mm, by: String::new(), seconds })
}

/// The value of a curve at half its last frequency.
fn middle<const N: usize>(points: &[[f64; N]]) -> f64 {
    points.get(points.len() / 2).map_or(f64::NAN, |p| p[1])
}

/// The loop over the field, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    rays_per_pixel: usize,
    seed: u64,
    worst_capture_less_design: Option<f64>,
    reconstruction_by: Option<&'a str>,
    places: Vec<PlaceRow<'a>>,
    failed: &'a [String],
    seconds: f64,
}

/// What one picture of an edge shows, for machines; or why it shows nothing.
#[derive(Serialize)]
#[serde(untagged)]
enum EdgeRow<'a> {
    Measured {
        mtf50_cy_per_px: Option<f64>,
        edge_normal_deg: f64,
        warnings: &'a [String],
        mtf_cy_per_mm_value_uncertainty: Vec<[f64; 3]>,
    },
    Refused {
        error: &'a str,
    },
}

/// One direction at one place.
#[derive(Serialize)]
struct DirectionRow<'a> {
    direction: &'static str,
    design_cy_per_mm_value: &'a [[f64; 2]],
    capture: EdgeRow<'a>,
    reconstruction: Option<EdgeRow<'a>>,
}

/// One place of the field.
#[derive(Serialize)]
struct PlaceRow<'a> {
    height_mm: f64,
    side_px: usize,
    edges: Vec<DirectionRow<'a>>,
}

impl<'a> EdgeRow<'a> {
    fn new(p: &EdgePlace, found: &'a Result<EdgeMeasurement, String>, pitch_mm: f64) -> Self {
        match found {
            Ok(e) => Self::Measured {
                mtf50_cy_per_px: e.mtf50.map(|c| c.frequency),
                edge_normal_deg: e.normal_deg,
                warnings: &e.warnings,
                mtf_cy_per_mm_value_uncertainty: curve(e, p.texels, pitch_mm),
            },
            Err(error) => Self::Refused { error },
        }
    }
}

impl<'a> PlaceRow<'a> {
    fn new(p: &'a EdgePlace, pitch_mm: f64) -> Self {
        let edge = |(k, e): (usize, &'a Edge)| DirectionRow {
            direction: NAMES[k],
            design_cy_per_mm_value: &e.design,
            capture: EdgeRow::new(p, &e.capture, pitch_mm),
            reconstruction: e.reconstruction.as_ref().map(|r| EdgeRow::new(p, r, pitch_mm)),
        };
        Self { height_mm: p.height_mm, side_px: p.side, edges: p.edges.iter().enumerate().map(edge).collect() }
    }
}

impl Measured {
    /// Largest difference between the capture's MTF and the prediction of any edge up to half a cycle a pixel; nothing where no edge was
    /// measured.
    pub(crate) fn worst(&self) -> Option<f64> {
        let edges = self.places.iter().flat_map(|p| p.edges.iter().map(move |e| (p, e)));
        let off = edges.filter_map(|(p, e)| {
            let found = curve(e.capture.as_ref().ok()?, p.texels, self.pitch_mm);
            Some(found.iter().zip(&e.design).map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f64::max))
        });
        off.reduce(f64::max)
    }

    /// One plot over the field, and one of each place.
    pub(crate) fn plots(&self) -> Vec<(&'static str, Plot)> {
        let name = |of: &str, k: usize| format!("{} {of}", NAMES[k]);
        let mut series = Vec::new();
        for k in 0..2 {
            let over = |value: &dyn Fn(&EdgePlace, &Edge) -> f64| -> Vec<[f64; 2]> {
                self.places.iter().map(|p| [p.height_mm, value(p, &p.edges[k])]).collect()
            };
            series.push(Series { name: name("design", k), points: over(&|_, e| middle(&e.design)), mark: Mark::Line });
            for (of, mark) in [("capture", Mark::Dashed), ("reconstruction", Mark::Both)] {
                let value = |p: &EdgePlace, e: &Edge| {
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
        json!(Figures {
            rays_per_pixel: self.settings.rays,
            seed: self.settings.seed,
            worst_capture_less_design: self.worst(),
            reconstruction_by: (!self.by.is_empty()).then_some(&self.by),
            places: self.places.iter().map(|p| PlaceRow::new(p, self.pitch_mm)).collect(),
            failed: &self.failed,
            seconds: self.seconds,
        })
    }
}

#[cfg(test)]
mod tests;
