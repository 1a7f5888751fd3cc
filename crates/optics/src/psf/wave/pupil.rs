//! The pupil as a sensor point sees it: path, étendue and apertures over the stop, and the coordinates `τ` in which a kernel is their Fourier transform.

use std::sync::Arc;

use glam::{DMat2, DVec2};
use ndarray::Array2;
use rustfft::num_complex::Complex;

use super::super::fit::{Of, Parity, apply, terms};
use super::super::sensor_map::SensorMap;
use super::super::splat::Raster;
use super::super::stop::{Part, StopNodes};
use super::super::table::beam::{self, Bases, Beam};
use super::cell::open;
use super::transform::{Grid, into_kernel};
use crate::lens::Lens;
use crate::trace::aim::SensorView;
use isoplanat_base::error::Result;
use isoplanat_base::math::fft::good_size;
use isoplanat_base::math::memory::product;

/// Degrees of the polynomials that are tried in turn, until paths are told to [`PATH`].
const DEGREES: [usize; 6] = [9, 12, 15, 18, 22, HIGHEST];
const HIGHEST: usize = 26;
/// Root mean square residual of a path that is enough, wavelengths: 1e-3 made errors of 8e-3 of a phone lens's peak, which is a tenth of a perfect lens's.
const PATH: f64 = 1e-4;
/// Steps of Newton's method at most, and how near it comes, of the pupil's size.
const STEPS: u32 = 30;
const NEAR: f64 = 1e-12;
/// How far beyond the unit stop, in its radii, cells are looked at: those farther out have nothing of it.
const BEYOND: f64 = 1.5;
/// Samples across the pupil, at least and at most.
const ACROSS: [f64; 2] = [64.0, 1024.0];
/// Cells nearer to an edge than this, in their sides, are looked at in so many parts each way.
const CLEAR: f64 = 1.0;
const PARTS: u32 = 3;
/// Margin of the period around the window and around the blur, in λ/NA, each side.
const MARGIN: f64 = 8.0;

/// What all pupils of a lens share.
#[derive(Clone, Debug)]
pub(super) struct Rays {
    /// By [`DEGREES`].
    bases: Vec<Bases>,
    /// Part of the stop's radius that the unit disk stands for.
    pupil: f64,
}

impl Rays {
    pub(super) fn new(lens: &Lens, views: &[SensorView]) -> Result<Self> {
        let bases: Vec<Bases> = DEGREES.iter().map(|d| Bases::new(*d)).collect();
        let pupil = beam::pupil(views, &bases[0]).map_err(|f| super::super::table::failed(lens, 0.0, f))?;
        Ok(Self { bases, pupil })
    }
}

/// The pupil of one sensor point, wavelength and object distance.
#[derive(Clone, Debug)]
pub struct Pupil {
    /// Wavelength, mm.
    pub wavelength_mm: f64,
    /// Root mean square residual of the path's polynomial, wavelengths.
    pub residual_waves: f64,
    degree: usize,
    part: Part,
    terms: [Vec<(usize, usize)>; 2],
    /// Coefficients of `τ`, across the meridian (odd) and along it (even).
    tau: [Vec<f64>; 2],
    /// Of the path less the central ray's, mm, of the étendue over the unit stop, and of what is positive within each aperture (even).
    path: Vec<f64>,
    light: Vec<f64>,
    clips: Vec<Vec<f64>>,
    /// `τ` of the centre, and how the stop's point changes with it about there.
    centre: DVec2,
    per_tau: DMat2,
    /// Half the sides of the box around the pupil's `τ` and its middle, and the largest displacement of a ray, mm.
    half: DVec2,
    middle: DVec2,
    reach_mm: f64,
    /// Largest `τ`: nearly the largest sine of an angle at the image.
    pub(super) steepest: f64,
}

/// An edge about a point of the stop: what is positive inside, and how it changes.
struct Edge {
    inside: f64,
    slope: DVec2,
}

impl Edge {
    /// Its normal and distance in cells with sides along these steps of the stop.
    fn cells(&self, across: DVec2, down: DVec2) -> (DVec2, f64) {
        let slope = DVec2::new(self.slope.dot(across), self.slope.dot(down));
        let size = slope.length().max(f64::MIN_POSITIVE);
        (slope / size, self.inside / size)
    }
}

/// Values of a function over the stop at a point.
struct At {
    value: f64,
    slope: DVec2,
}

impl Pupil {
    /// Of rays that are traced for it; nothing where none comes through.
    pub(super) fn trace(
        view: &SensorView,
        rays: &Rays,
        map: &SensorMap,
        radius_mm: f64,
        wavelength_mm: f64,
    ) -> Option<Self> {
        let mut best: Option<Self> = None;
        for bases in &rays.bases {
            let Ok(beam) = Beam::trace(view, bases, radius_mm, rays.pupil, None) else { break };
            let basis = bases.of(beam.part);
            let found = Self::of(view, &Arc::new(beam), &basis, map, (radius_mm, wavelength_mm))?;
            let enough = found.residual_waves <= PATH;
            if best.as_ref().is_none_or(|b| found.residual_waves < b.residual_waves) {
                best = Some(found);
            }
            if enough {
                break;
            }
        }
        best
    }

    fn of(
        view: &SensorView,
        beam: &Arc<Beam>,
        basis: &StopNodes,
        map: &SensorMap,
        (radius_mm, wavelength_mm): (f64, f64),
    ) -> Option<Self> {
        let [even, odd] = &basis.coefficients;
        let image = view.system.image();
        let index = view.system.surfaces[image].index_after;
        // The object that the point's own coordinates show, and how its slopes change with them.
        let (ratio, growth) = (map.ratio(radius_mm), map.derivative(radius_mm));
        let (u, v) = (DVec2::new(0.0, map.slope(radius_mm)), map.vergence);
        let outside: Vec<(f64, DVec2)> = beam.nodes.iter().map(|n| beyond(u, v, n.ray.entrance)).collect();
        let paths: Vec<f64> =
            beam.paths(view)?.iter().zip(&outside).map(|(inside, (far, _))| inside + index * far).collect();
        let of_tau = |k: usize, scale: f64| outside.iter().map(|(_, t)| index * scale * t[k]).collect::<Vec<f64>>();
        let tau = [apply(odd, &of_tau(0, ratio)), apply(even, &of_tau(1, growth))];
        let mut path = apply(even, &paths);
        let fitted = basis.at_nodes[0].at(Of::Value, &path);
        let square: f64 = fitted.iter().zip(&paths).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / paths.len() as f64;
        let light = apply(even, &beam.etendue(view, basis));
        let clips = beam::near_apertures(&[view], &[vec![Arc::clone(beam)]]);
        let clips = clips.iter().map(|surface| {
            let k = image - surface;
            let square = view.system.surfaces[k].semi_diameter.powi(2);
            apply(even, &beam.nodes.iter().map(|n| 1.0 - n.heights[k].length_squared() / square).collect::<Vec<f64>>())
        });
        let clips = clips.collect();
        let mut pupil = Self {
            wavelength_mm,
            residual_waves: square.sqrt() / wavelength_mm,
            degree: basis.degree,
            part: beam.part,
            terms: [Parity::Even, Parity::Odd].map(|parity| terms(basis.degree, parity)),
            tau,
            path: Vec::new(),
            light,
            clips,
            centre: DVec2::ZERO,
            per_tau: DMat2::ZERO,
            half: DVec2::ZERO,
            middle: DVec2::ZERO,
            reach_mm: 0.0,
            steepest: 0.0,
        };
        let (centre, jacobian) = pupil.tau_at(DVec2::ZERO);
        (pupil.centre, pupil.per_tau) = (centre, jacobian.inverse());
        path[0] -= pupil.value(&path, DVec2::ZERO);
        pupil.path = path;
        if !pupil.per_tau.is_finite() {
            return None;
        }
        // The box around the nodes, the rim among them, on both sides of the meridian; displacements where the path is stationary.
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for s in &basis.nodes {
            let (tau, jacobian) = pupil.tau_at(*s);
            for t in [tau, DVec2::new(-tau.x, tau.y)] {
                (low, high) = (low.min(t), high.max(t));
            }
            pupil.steepest = pupil.steepest.max(tau.length());
            let along = pupil.at(&pupil.path, *s).slope;
            let moved = jacobian.transpose().inverse() * along;
            if moved.is_finite() {
                pupil.reach_mm = pupil.reach_mm.max(moved.length());
            }
        }
        (pupil.half, pupil.middle) = (0.5 * (high - low), 0.5 * (high + low));
        Some(pupil)
    }

    /// Half the pupil's smaller side, as a sine: light bends by a wavelength over it.
    pub(super) fn narrowest(&self) -> f64 {
        self.half.min_element()
    }

    /// A lens without aberrations but `waves` of defocus at the rim, numerical aperture `na`.
    #[cfg(test)]
    pub(super) fn perfect(wavelength_mm: f64, na: f64, waves: f64) -> Self {
        let [even, odd] = [Parity::Even, Parity::Odd].map(|parity| terms(2, parity));
        let of = |terms: &[(usize, usize)], at: &[((usize, usize), f64)]| {
            terms.iter().map(|t| at.iter().find(|(k, _)| k == t).map_or(0.0, |(_, v)| *v)).collect::<Vec<f64>>()
        };
        // ρ² = (T₂(x) + T₂(y))/2 + 1.
        let bent = 0.5 * waves * wavelength_mm;
        Self {
            wavelength_mm,
            residual_waves: 0.0,
            degree: 2,
            part: Part::WHOLE,
            tau: [of(&odd, &[((1, 0), na)]), of(&even, &[((0, 1), na)])],
            path: of(&even, &[((2, 0), bent), ((0, 2), bent)]),
            light: of(&even, &[((0, 0), na * na)]),
            terms: [even, odd],
            clips: Vec::new(),
            centre: DVec2::ZERO,
            per_tau: DMat2::from_diagonal(DVec2::splat(1.0 / na)),
            half: DVec2::splat(na),
            middle: DVec2::ZERO,
            reach_mm: 2.0 * waves * wavelength_mm / na,
            steepest: na,
        }
    }

    /// Half the pupil's larger side, as a sine.
    pub(super) fn aperture_half(&self) -> f64 {
        self.half.max_element()
    }

    fn basis(&self, s: DVec2) -> Basis {
        Basis { x: Line::at(s.x, self.degree), y: Line::at(s.y, self.degree) }
    }

    fn at(&self, even: &[f64], s: DVec2) -> At {
        sum(&self.terms[0], even, &self.basis(s))
    }

    fn value(&self, even: &[f64], s: DVec2) -> f64 {
        self.at(even, s).value
    }

    /// `τ` at a point of the stop, and its Jacobian.
    pub(super) fn tau_at(&self, s: DVec2) -> (DVec2, DMat2) {
        let basis = self.basis(s);
        let (x, y) = (sum(&self.terms[1], &self.tau[0], &basis), sum(&self.terms[0], &self.tau[1], &basis));
        (DVec2::new(x.value, y.value), DMat2::from_cols(x.slope, y.slope).transpose())
    }

    /// Displacement of the ray through a point of the stop, mm: where the path is stationary.
    #[cfg(test)]
    pub(super) fn displacement(&self, s: DVec2) -> DVec2 {
        self.tau_at(s).1.transpose().inverse() * self.at(&self.path, s).slope
    }

    /// The point of the stop whose `τ` is asked for, and the Jacobian there; nothing where it is far outside.
    fn stop_point(&self, tau: DVec2, start: DVec2) -> Option<(DVec2, DMat2)> {
        let near = NEAR * self.half.max_element();
        let mut s = start;
        for _ in 0..STEPS {
            if s.length_squared() > BEYOND * BEYOND || !s.is_finite() {
                return None;
            }
            let (here, jacobian) = self.tau_at(s);
            let off = tau - here;
            let step = jacobian.inverse() * off;
            if off.length() <= near {
                return Some((s, jacobian));
            }
            s += step;
        }
        None
    }

    /// The pupil's amplitudes on a raster of `τ` turned to `outward`, with step `h`, and what of the light is whole and lost at edges, `∫a² dτ`.
    pub(super) fn raster(&self, outward: [f64; 2], h: f64) -> Grid {
        // Columns and rows of the sensor from across and along the meridian, and back.
        let [c, r] = outward;
        let turned = |p: DVec2| DVec2::new(p.y * c - p.x * r, p.y * r + p.x * c);
        let back = |p: DVec2| DVec2::new(p.y * c - p.x * r, p.x * c + p.y * r);
        let corner = DVec2::new(
            (self.half.y * c).abs() + (self.half.x * r).abs(),
            (self.half.y * r).abs() + (self.half.x * c).abs(),
        );
        let middle = turned(self.middle);
        let [cols, rows] = [corner.x, corner.y].map(|half| 2 * ((half / h).ceil() as usize + 1) + 1);
        let mut cells = Vec::with_capacity(rows * cols);
        let mut shares = Array2::<f64>::zeros((rows, cols));
        let none = Array2::from_elem((rows, cols), Complex::new(0.0, 0.0));
        let mut grid = Grid { amplitude: none, light: 0.0, lost: 0.0 };
        let wave = std::f64::consts::TAU / self.wavelength_mm;
        for i in 0..rows {
            let mut last: Option<(DVec2, DVec2)> = None;
            for j in 0..cols {
                let step = DVec2::new(j as f64 - (cols / 2) as f64, i as f64 - (rows / 2) as f64);
                let tau = back(middle + h * step);
                let guess = match last {
                    Some((before, s)) => s + self.per_tau * (tau - before),
                    None => self.per_tau * (tau - self.centre),
                };
                let found = self.stop_point(tau, guess);
                last = found.map(|(s, _)| (tau, s));
                let Some((s, jacobian)) = found else { continue };
                shares[[i, j]] = self.open(s, jacobian, h, back);
                cells.push(([i, j], s, jacobian.determinant().abs()));
            }
        }
        for ([i, j], s, size) in cells {
            let (share, amplitude) = (shares[[i, j]], sharpened(&shares, i, j));
            if amplitude == 0.0 {
                continue;
            }
            let density = self.value(&self.light, s).max(0.0) / size;
            let light = density * h * h;
            grid.light += light * share;
            grid.lost += light * (share - amplitude * amplitude);
            let phase = wave * self.value(&self.path, s);
            grid.amplitude[[i, j]] = Complex::from_polar(density.sqrt(), phase) * amplitude;
        }
        grid
    }

    /// The share of a cell that is open: where an edge is near, the mean over smaller ones.
    fn open(&self, s: DVec2, jacobian: DMat2, h: f64, back: impl Fn(DVec2) -> DVec2) -> f64 {
        let per_tau = jacobian.inverse();
        // Steps in the stop along the cell's sides.
        let (across, down) = (per_tau * back(DVec2::X) * h, per_tau * back(DVec2::Y) * h);
        let nearest = self.edges(s).map(|e| e.cells(across, down)).map(|(_, t)| t).fold(f64::INFINITY, f64::min);
        if nearest.abs() > CLEAR {
            return f64::from(u8::from(nearest > 0.0));
        }
        let n = f64::from(PARTS);
        let mut sum = 0.0;
        for (i, j) in (0..PARTS).flat_map(|i| (0..PARTS).map(move |j| (i, j))) {
            let [x, y] = [j, i].map(|k| (f64::from(k) + 0.5) / n - 0.5);
            let edges = self.edges(s + x * across + y * down).map(|e| e.cells(across / n, down / n));
            sum += edges.map(|(normal, t)| open(normal, t)).product::<f64>();
        }
        sum / (n * n)
    }

    /// Every edge about a point of the stop: the rim, the border of what is known, clear apertures.
    fn edges(&self, s: DVec2) -> impl Iterator<Item = Edge> + '_ {
        let size = s.length();
        let rim = Edge { inside: 1.0 - size, slope: if size > 0.0 { -s / size } else { DVec2::ZERO } };
        let part = (!self.part.is_whole()).then(|| {
            let (step, at) = (1e-6, |s: DVec2| self.part.depth(DVec2::new(s.x.abs(), s.y)).min(1.0));
            let along = |d: DVec2| (at(s + step * d) - at(s - step * d)) / (2.0 * step);
            Edge { inside: at(s), slope: DVec2::new(along(DVec2::X), along(DVec2::Y)) }
        });
        let clips = self.clips.iter().map(move |clip| {
            let At { value, slope } = self.at(clip, s);
            // By the height over the aperture's radius in place of its square: edges are nearer to straight.
            let height = (1.0 - value).max(1e-12).sqrt();
            Edge { inside: 1.0 - height, slope: slope / (2.0 * height) }
        });
        std::iter::once(rim).chain(part).chain(clips)
    }

    /// Bytes, from above, that a kernel of a window of this side takes while it is made: the raster, turned, twice as wide for its square, and once more.
    pub(super) fn bytes(&self, window_mm: f64) -> u64 {
        let across = 2.0 * self.half.length() * self.period(window_mm) / self.wavelength_mm + 5.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count, from above")]
        let side = good_size(2 * across.ceil() as usize + 1);
        product(&[side, side, 2 * size_of::<Complex<f64>>()])
    }

    /// Writes the kernel on `raster` in cells of `cell_mm`, and returns the share of the light that was spread evenly.
    pub fn kernel(&self, outward: [f64; 2], raster: Raster, cell_mm: f64, out: &mut [f64]) -> f64 {
        let period = self.period(raster.size as f64 * cell_mm);
        let grid = self.raster(outward, self.wavelength_mm / period);
        into_kernel(&grid, period, raster, cell_mm, out)
    }

    /// Whether a raster that is not too large tells the blur: else there are hundreds of waves, and geometry tells it as well.
    pub(super) fn is_told(&self) -> bool {
        let (least, most) = (2.0 * self.reach_mm + self.margin(), self.most());
        least <= most
    }

    /// What is left around a kernel, mm.
    fn margin(&self) -> f64 {
        MARGIN * self.wavelength_mm / self.half.min_element().max(1e-9)
    }

    /// Largest period, mm.
    fn most(&self) -> f64 {
        ACROSS[1] * self.wavelength_mm / (2.0 * self.aperture_half())
    }

    /// The period of a kernel whose window has this side, mm.
    pub(super) fn period(&self, window_mm: f64) -> f64 {
        let wanted = (window_mm + self.margin()).max(2.0 * self.reach_mm + self.margin());
        wanted.clamp(ACROSS[0] / ACROSS[1] * self.most(), self.most())
    }
}

/// A cell's share with what its area took of the edge's sharpness put back, to the fourth order of the cell's side.
fn sharpened(shares: &Array2<f64>, i: usize, j: usize) -> f64 {
    let (rows, cols) = shares.dim();
    let at = |i: usize, j: usize| shares[[i.min(rows - 1), j.min(cols - 1)]];
    let line = |i: usize| at(i, j) - (at(i, j + 1) - 2.0 * at(i, j) + at(i, j.saturating_sub(1))) / 24.0;
    line(i) - (line(i + 1) - 2.0 * line(i) + line(i.saturating_sub(1))) / 24.0
}

/// A sum of `T_p(x) T_q(y)` and its derivatives.
fn sum(terms: &[(usize, usize)], coefficients: &[f64], Basis { x, y }: &Basis) -> At {
    let (mut value, mut slope) = (0.0, DVec2::ZERO);
    for ((p, q), c) in terms.iter().zip(coefficients) {
        value += c * x.values[*p] * y.values[*q];
        slope.x += c * x.slopes[*p] * y.values[*q];
        slope.y += c * x.values[*p] * y.slopes[*q];
    }
    At { value, slope }
}

/// `T_0` to the highest degree at a point, and their derivatives.
struct Line {
    values: [f64; HIGHEST + 1],
    slopes: [f64; HIGHEST + 1],
}

impl Line {
    fn at(t: f64, degree: usize) -> Self {
        let (mut values, mut slopes) = ([0.0; HIGHEST + 1], [0.0; HIGHEST + 1]);
        (values[0], values[1], slopes[1]) = (1.0, t, 1.0);
        for n in 2..=degree.min(HIGHEST) {
            values[n] = 2.0 * t * values[n - 1] - values[n - 2];
            slopes[n] = 2.0 * values[n - 1] + 2.0 * t * slopes[n - 1] - slopes[n - 2];
        }
        Self { values, slopes }
    }
}

/// Both of a point of the stop.
struct Basis {
    x: Line,
    y: Line,
}

/// Path from the crossing `e` of the first vertex plane to the object of slope `u` at vergence `v`, less that from the plane's middle, mm; and how it changes with `u`.
fn beyond(u: DVec2, v: f64, e: DVec2) -> (f64, DVec2) {
    let (far, near) = ((1.0 + (u + v * e).length_squared()).sqrt(), (1.0 + u.length_squared()).sqrt());
    let path = (2.0 * u.dot(e) + v * e.length_squared()) / (far + near);
    (path, e / far - u * (path / (far * near)))
}
