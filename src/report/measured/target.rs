//! A patch with a slanted edge at a place of the field, and the light in which green pixels see it.

use glam::{DVec2, DVec3};
use ndarray::Array3;

use super::edge::{Camera, Edge, sinc};
use crate::report::table::significant;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::metrics::slanted_edge::{EdgeOptions, Rectangle, Sites, measure};
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::analysis::beam::{Beam, Landing, stop_points};
use isoplanat_optics::analysis::spot::{geometric_mtf, joined, spot};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::table::chief_slopes;
use isoplanat_optics::psf::{Optics, Quadrature, SensorPoint};
use isoplanat_optics::trace::{ObjectPoint, System};

/// Angle between an edge's normal and the direction that it stands for, degrees.
pub const TILT_DEG: f64 = 5.0;
/// Texels a pixel, at least and at most, and of a patch's side where there is room.
const TEXELS: [usize; 3] = [2, 8, 512];
/// Radiance of the dark and the bright side; white is 1.
const LEVELS: [f32; 2] = [0.1, 0.7];
/// Side of a patch: at least so many pixels, so many times the spot's rms radius more, at most so many.
pub(super) const SIDE: [usize; 2] = [48, LARGEST];
/// The larger of them.
pub const LARGEST: usize = 256;
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

/// The lens in the light that green pixels see.
pub(super) struct Light {
    systems: Vec<System>,
    shares: Vec<f64>,
    /// For its relative illumination.
    optics: Optics,
}

impl Light {
    /// Out to `radius` mm from the axis.
    pub(super) fn new(lens: &Lens, sensor: &Sensor, radius: f64) -> Result<Self> {
        let spectrum = SpectralDensity::new(sensor).quadrature(WAVELENGTHS);
        let systems = spectrum.wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let [_, shares, _] = spectrum.weight;
        let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: vec![shares.clone()] };
        let optics = Optics::even(lens, radius.max(1e-3), vec![lens.object_vergence], quadrature, ILLUMINATIONS)?;
        Ok(Self { systems, shares, optics })
    }

    /// Irradiance of white at a distance from the axis, mm, over that on it.
    fn white(&self, radius: f64) -> f64 {
        self.optics.relative_illumination(SensorPoint::along([0.0, 1.0], radius))[0]
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
pub(super) struct Target<'a> {
    frame: &'a Frame,
    vergence: f64,
    pub(super) region: Region,
    /// Of its middle: distance from the axis, mm; direction outwards in pixels, columns and rows; object slope.
    pub(super) radius: f64,
    outwards: DVec2,
    slope: f64,
    /// Object slope per mm of the sensor about the patch.
    ratio: f64,
    /// Texels a pixel.
    pub(super) texels: usize,
    rays: Vec<Landing>,
}

impl<'a> Target<'a> {
    pub(super) fn new(lens: &Lens, frame: &'a Frame, light: &Light, radius: f64) -> Result<Self> {
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

    pub(super) fn edge(&self, direction: usize, sensor: &Sensor, light: &Light, camera: Camera<'_>) -> Result<Edge> {
        let mut seen = camera(&self.scene(direction), self.region)?;
        // A flat field, as a camera's development has one; where it is dark nothing is measured.
        #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "raster sizes, f32 pictures")]
        seen.mosaic.indexed_iter_mut().for_each(|((row, col), v)| {
            let at = [self.region.col as f64 + col as f64 + 0.5, self.region.row as f64 + row as f64 + 0.5];
            let white = light.white(self.frame.radius_mm(at[0], at[1]));
            *v = if white > 0.0 { (f64::from(*v) / white) as f32 } else { 0.0 };
        });
        let green = EdgeOptions { region: None, sites: Sites::from_cfa(sensor.cfa, 1), range: None };
        let whole = |options: EdgeOptions, plane: ndarray::ArrayView2<'_, f32>| {
            let all = Rectangle::whole(plane.dim());
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
