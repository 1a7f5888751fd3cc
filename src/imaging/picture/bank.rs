//! Kernels at any place of the frame, from a table of traced fields.
//!
//! A kernel here carries its light: `Σ_λ w_cλ K_λ · J / E_c`, with the étendue-weighted `K_λ` of [`crate::psf`], the
//! area Jacobian `J` of the place (design §4) and `E_c` the irradiance of white on the axis. So it sums to the relative
//! illumination, less what falls outside the window.

use ndarray::ArrayViewMut4;

use crate::error::Result;
use crate::imaging::cfa::Real;
use crate::imaging::distortion::Distortion;
use crate::imaging::field_map::{failed, field_at};
use crate::imaging::frame::Frame;
use crate::imaging::warp::Region;
use crate::imaging::white::on_axis;
use crate::lens::Lens;
use crate::psf::field_table::{FieldTable, Landings, TableTolerance};
use crate::psf::fine::{phase_of, splat_fine};
use crate::psf::pupil::PupilSampling;

/// Largest error of the field table's landings, pixels.
const LANDING_ERROR_PX: f64 = 0.02;
/// Largest error of the field table's weights, relative.
const WEIGHT_ERROR: f64 = 2e-3;

/// A quadrature over wavelength: nodes and, by channel, weights that sum to one.
#[derive(Clone, Debug)]
pub struct Rule {
    /// Wavelengths, nm.
    pub nm: Vec<f64>,
    /// Weight of each wavelength in each channel.
    pub weight: Vec<Vec<f64>>,
}

/// What kernels are made of.
pub struct Bank {
    /// Traced fields.
    pub table: FieldTable,
    /// Wavelengths.
    pub rule: Rule,
    /// Sensor radii, mm, that were traced; kernels nearer and farther are held.
    pub radii_mm: [f64; 2],
    distortion: Distortion,
    frame: Frame,
    /// Irradiance of white on the axis at the wavelengths.
    white: Vec<f64>,
    /// `1/E_c`.
    scale: Vec<f64>,
}

/// Scratch of one thread.
#[derive(Default)]
pub struct Scratch {
    landings: Landings,
    mono: Vec<f64>,
    mixed: Vec<Vec<f64>>,
}

/// A place on the frame: distance from the axis and the direction in which it grows.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Unit vector `(column, row)`.
    pub outward: [f64; 2],
}

impl Place {
    /// The centre of pixel `(row, col)`.
    pub fn pixel(frame: &Frame, row: isize, col: isize) -> Self {
        let [dx, dy] = Region { row, col, rows: 1, cols: 1 }.offset(frame, 0, 0);
        Self::offset(frame, [dx, dy])
    }

    /// The point `[column, row]` pixels from the axis.
    pub fn offset(frame: &Frame, [dx, dy]: [f64; 2]) -> Self {
        let length = dx.hypot(dy);
        let outward = if length > 0.0 { [dx / length, dy / length] } else { [1.0, 0.0] };
        Self { radius_mm: length * frame.pitch_mm, outward }
    }
}

impl Bank {
    /// Traces `lens` over the sensor radii `radii_mm`.
    ///
    /// # Errors
    /// A field none of whose rays reaches the sensor.
    pub fn new(
        lens: &Lens,
        vergence: f64,
        distortion: &Distortion,
        frame: &Frame,
        sampling: &PupilSampling,
        rule: Rule,
        radii_mm: [f64; 2],
    ) -> Result<Self> {
        let tolerance = TableTolerance { landing_mm: LANDING_ERROR_PX * frame.pitch_mm, weight: WEIGHT_ERROR };
        // The margin around the frame may lie beyond the lens's image: then the frame itself must do.
        let edge = frame.max_radius_mm();
        let trace = |radii: [f64; 2]| {
            let range = radii.map(|r| field_at(distortion, r).slope);
            FieldTable::compute(lens, vergence, sampling, &rule.nm, range, tolerance)
        };
        let (table, radii_mm) = match trace(radii_mm) {
            Ok(table) => (table, radii_mm),
            Err(f) if radii_mm[1] <= edge => return Err(failed(lens, "PSF grid", f)),
            Err(_) => {
                let radii = radii_mm.map(|r| r.min(edge));
                (trace(radii).map_err(|f| failed(lens, "PSF grid", f))?, radii)
            }
        };
        let white: Vec<f64> = rule.nm.iter().map(|nm| on_axis(lens, *nm)).collect();
        let scale = rule
            .weight
            .iter()
            .map(|w| {
                let level: f64 = w.iter().zip(&white).map(|(w, e)| w * e).sum();
                if level > 0.0 { level.recip() } else { 0.0 }
            })
            .collect();
        Ok(Self { table, rule, radii_mm, distortion: distortion.clone(), frame: frame.clone(), white, scale })
    }

    /// Irradiance of white on the axis at the rule's wavelengths.
    pub fn white(&self) -> &[f64] {
        &self.white
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.rule.weight.len()
    }

    /// Wavelength `l`'s light at `place` on a fine raster of cells `cell` pixels wide; returns what fell outside.
    fn splat(&self, l: usize, place: Place, size: usize, m: usize, cell: f64, scratch: &mut Scratch) -> f64 {
        let radius_mm = place.radius_mm.clamp(self.radii_mm[0], self.radii_mm[1]);
        let slope = field_at(&self.distortion, radius_mm).slope;
        self.table.interpolate(slope, l, &mut scratch.landings);
        scratch.mono.clear();
        scratch.mono.resize((m * size) * (m * size), 0.0);
        let [c, r] = place.outward;
        let per_px = (self.frame.pitch_mm * cell).recip();
        let Landings { x, y, weight } = &scratch.landings;
        let mut missed = 0.0;
        for ((x, y), w) in x.iter().zip(y).zip(weight) {
            if *w > 0.0 {
                let (x, y) = (x * per_px, (y - radius_mm) * per_px);
                missed += splat_fine(&mut scratch.mono, size, m, [y * c - x * r, y * r + x * c], *w);
            }
        }
        missed
    }

    /// One wavelength's kernel on the fine raster, in units of its own irradiance `J K_λ`.
    pub fn mono<'s>(&self, l: usize, place: Place, size: usize, m: usize, scratch: &'s mut Scratch) -> &'s [f64] {
        self.splat(l, place, size, m, 1.0, scratch);
        let jacobian = field_at(&self.distortion, place.radius_mm).jacobian;
        scratch.mono.iter_mut().for_each(|v| *v *= jacobian);
        &scratch.mono
    }

    /// Irradiance weight of wavelength `l` in channel `c`, to be applied to [`Self::mono`].
    pub fn weight(&self, c: usize, l: usize) -> f64 {
        self.rule.weight[c][l] * self.scale[c]
    }

    /// Fine kernels of all channels at `place`, and the light outside the window by channel.
    pub fn fine<'s>(
        &self,
        place: Place,
        size: usize,
        m: usize,
        scratch: &'s mut Scratch,
    ) -> (&'s [Vec<f64>], Vec<f64>) {
        self.mixed(place, size, m, 1.0, scratch)
    }

    /// Kernels of all channels at `place` on a raster of `size` cells, each `cell` pixels wide.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn coarse<'s>(&self, place: Place, size: usize, cell: usize, scratch: &'s mut Scratch) -> &'s [Vec<f64>] {
        self.mixed(place, size, 1, cell as f64, scratch).0
    }

    fn mixed<'s>(
        &self,
        place: Place,
        size: usize,
        m: usize,
        cell: f64,
        scratch: &'s mut Scratch,
    ) -> (&'s [Vec<f64>], Vec<f64>) {
        let channels = self.channels();
        let mut mixed = std::mem::take(&mut scratch.mixed);
        mixed.resize(channels, Vec::new());
        for plane in &mut mixed {
            plane.clear();
            plane.resize((m * size) * (m * size), 0.0);
        }
        let jacobian = field_at(&self.distortion, place.radius_mm).jacobian;
        let mut outside = vec![0.0; channels];
        for l in 0..self.rule.nm.len() {
            let missed = self.splat(l, place, size, m, cell, scratch);
            for (c, plane) in mixed.iter_mut().enumerate() {
                let w = self.weight(c, l) * jacobian;
                if w == 0.0 {
                    continue;
                }
                outside[c] += w * missed;
                plane.iter_mut().zip(&scratch.mono).for_each(|(a, b)| *a += w * b);
            }
        }
        scratch.mixed = mixed;
        (&scratch.mixed, outside)
    }

    /// Writes the kernels at `place`: `[channel, phase, row, col]`.
    pub fn fill<T: Real>(
        &self,
        place: Place,
        m: usize,
        scratch: &mut Scratch,
        mut out: ArrayViewMut4<'_, T>,
    ) -> Vec<f64> {
        let size = out.dim().2;
        let (fine, outside) = self.fine(place, size, m, scratch);
        for (c, plane) in fine.iter().enumerate() {
            for phase in 0..m * m {
                let view = out.slice_mut(ndarray::s![c, phase, .., ..]);
                phase_of(plane, size, m, [phase / m, phase % m], view, T::real);
            }
        }
        outside
    }

    /// Half-widths in pixels of the square windows that hold all but each of `shares` of every traced field's light, in
    /// every channel; two pixels for box and tent added.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded")]
    pub fn half_widths_px(&self, shares: &[f64]) -> Vec<usize> {
        const FARTHEST: f64 = 1e4;
        let mut widest = vec![0usize; shares.len()];
        for (slope, maps) in self.table.fields() {
            let edge = self.distortion.max_slope;
            let radius = self.distortion.sensor_from_slope(slope.min(edge))
                + (slope - edge).max(0.0) * self.distortion.sensor_from_slope_derivative(edge);
            // Light by wavelength and whole pixels of distance.
            let mut light: Vec<Vec<f64>> = vec![Vec::new(); maps.len()];
            for (map, light) in maps.iter().zip(&mut light) {
                for ((x, y), w) in map.x.iter().zip(&map.y).zip(&map.weight) {
                    let (dx, dy) = (*x, *y - radius);
                    let far = ((dx * dx + dy * dy).sqrt() / self.frame.pitch_mm).min(FARTHEST).ceil() as usize;
                    if far >= light.len() {
                        light.resize(far + 1, 0.0);
                    }
                    light[far] += w;
                }
            }
            let most = light.iter().map(Vec::len).max().unwrap_or(0);
            for weight in &self.rule.weight {
                let at = |k: usize| weight.iter().zip(&light).map(|(w, l)| w * l.get(k).unwrap_or(&0.0)).sum::<f64>();
                let total: f64 = (0..most).map(at).sum();
                for (share, widest) in shares.iter().zip(&mut widest) {
                    let mut sum = 0.0;
                    let passes = |k: &usize| {
                        sum += at(*k);
                        sum > share * total
                    };
                    *widest = (*widest).max((0..most).rev().find(passes).unwrap_or(0));
                }
            }
        }
        widest.into_iter().map(|w| w + 2).collect()
    }
}
