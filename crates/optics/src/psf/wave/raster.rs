//! The pupil's amplitudes on a raster of `τ` along the sensor's rows and columns, and their pull-back to the polynomials.
//!
//! Polynomials of a degree on a box are known by their values at that many places more one along each side: they are evaluated there, and go to the raster by two
//! matrices, one a side.

use std::f64::consts::{PI, TAU};

use glam::DVec2;
use ndarray::Array2;
use rustfft::num_complex::Complex;

use super::super::fit::{apply, apply_transposed, chebyshev};
use super::super::hull::Hull;
use super::cell::{shares, shares_vjp, sharpened};
use super::fitted::Bars;
use super::functions::{CLIPS, COSINE, ODD_COSINE, ODD_STOP, PATH, PupilFunctions, STOP};

/// Room around the nodes within which cells are looked at, in half the sides of the box around them: what the chords between nodes on the rim leave of it, in squares of the
/// nodes' half turn, and what the outermost rows of a part of the stop leave at its ends.
const ROOM: [f64; 2] = [1.0, 0.015];

/// Cells around the box: sharpened edges have some light as far as four of them, and the outermost are closed.
const MARGIN: usize = 5;

/// Where the pupil's raster lies.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sampling {
    /// The kernel repeats with it, mm.
    pub(super) period: f64,
    /// Step of `τ`: a wavelength over the period.
    pub(super) step: f64,
    /// The sensor point's outward direction, and the box around the pupil in directions of columns and rows.
    outward: [f64; 2],
    middle: DVec2,
    cells: [usize; 2],
}

/// Directions of columns and rows from those across and along the meridian.
fn turned([c, r]: [f64; 2], p: DVec2) -> DVec2 {
    DVec2::new(p.y * c - p.x * r, p.y * r + p.x * c)
}

/// The other way.
fn back([c, r]: [f64; 2], p: DVec2) -> DVec2 {
    DVec2::new(p.y * c - p.x * r, p.x * c + p.y * r)
}

impl Sampling {
    pub(super) fn new(pupil: &PupilFunctions, outward: [f64; 2], period: f64) -> Self {
        let step = pupil.wavelength_mm / period;
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for t in pupil.tau.iter().copied() {
            for t in [t, DVec2::new(-t.x, t.y)] {
                let p = turned(outward, t);
                (low, high) = (low.min(p), high.max(p));
            }
        }
        // Nodes stand between the ends of the box, so many to a half-turn of the rim; then the margin.
        let turn = pupil.half_turn();
        let half = 0.5 * (1.01 + 0.6 * turn * turn) * (high - low);
        // A raster that stands still while the pupil moves a little over it: its own error does not enter derivatives.
        let middle = (0.5 * (low + high) / step).round() * step;
        let cells = [half.x, half.y].map(|half| 2 * ((half / step).ceil() as usize + MARGIN) + 1);
        Self { period, step, outward, middle, cells }
    }

    /// Half the sides of the raster from middle to middle of its outermost cells.
    fn extent(&self) -> DVec2 {
        0.5 * self.step * DVec2::new((self.cells[0] - 1) as f64, (self.cells[1] - 1) as f64)
    }

    /// `τ` across and along the meridian at a part of the extent along columns and rows.
    fn tau(&self, at: DVec2) -> DVec2 {
        back(self.outward, self.middle + self.extent() * at)
    }
}

/// From values of a polynomial at Chebyshev's points of a side to its values at `count` even places of it, and their slopes over half the side: `[place, point]`.
fn along(degree: usize, count: usize) -> [Array2<f64>; 2] {
    let points = degree + 1;
    let to_coefficients = Array2::from_shape_fn((points, points), |(k, i)| {
        let scale = if k == 0 { 1.0 } else { 2.0 } / points as f64;
        scale * (PI * k as f64 * (i as f64 + 0.5) / points as f64).cos()
    });
    let [mut values, mut slopes] = [(); 2].map(|()| Array2::zeros((count, points)));
    for c in 0..count {
        let x = 2.0 * c as f64 / (count - 1) as f64 - 1.0;
        let (t, d) = chebyshev(x, degree);
        for k in 0..points {
            (values[[c, k]], slopes[[c, k]]) = (t[k], d[k]);
        }
    }
    [values.dot(&to_coefficients), slopes.dot(&to_coefficients)]
}

/// What takes polynomials to a raster.
struct Way {
    /// Terms of either parity at Chebyshev's points of the raster, `[term, point]`.
    at: [Array2<f64>; 2],
    /// Along columns (x) and rows (y): values and slopes over `τ`.
    x: [Array2<f64>; 2],
    y: [Array2<f64>; 2],
}

/// A value, or a slope along columns or rows.
#[derive(Clone, Copy)]
enum Along {
    Value,
    X,
    Y,
}

impl Way {
    fn new(pupil: &PupilFunctions, sampling: &Sampling) -> Self {
        let points = pupil.fitted.degree + 1;
        let place = |i: usize| (PI * (i as f64 + 0.5) / points as f64).cos();
        let all = (0..points).flat_map(|i| (0..points).map(move |j| DVec2::new(place(j), place(i))));
        let at = pupil.fitted.terms(all.map(|p| sampling.tau(p)));
        let extent = sampling.extent();
        let of = |count: usize, half: f64| {
            let [values, slopes] = along(pupil.fitted.degree, count);
            [values, slopes / half]
        };
        Self { at, x: of(sampling.cells[0], extent.x), y: of(sampling.cells[1], extent.y) }
    }

    fn sides(&self, of: Along) -> (&Array2<f64>, &Array2<f64>) {
        match of {
            Along::Value => (&self.y[0], &self.x[0]),
            Along::X => (&self.y[0], &self.x[1]),
            Along::Y => (&self.y[1], &self.x[0]),
        }
    }

    fn raster(&self, (parity, coefficients): (usize, &[f64]), of: Along) -> Array2<f64> {
        let points = self.x[0].ncols();
        let values = apply_transposed(&self.at[parity], coefficients);
        let values = Array2::from_shape_vec((points, points), values).expect("a value a point");
        let (y, x) = self.sides(of);
        y.dot(&values).dot(&x.t())
    }

    /// Adds the pull-back of a cotangent on [`Self::raster`].
    fn raster_vjp(&self, parity: usize, of: Along, bar: &Array2<f64>, to: &mut [f64]) {
        let (y, x) = self.sides(of);
        let values = y.t().dot(bar).dot(x);
        let values = values.as_standard_layout();
        let pulled = apply(&self.at[parity], values.as_slice().expect("standard layout"));
        to.iter_mut().zip(pulled).for_each(|(t, p)| *t += p);
    }
}

/// Amplitudes with their phases, `[row, column]` of the part of the raster that is open, and what they were made of.
pub(super) struct Field {
    pub(super) amplitude: Array2<Complex<f64>>,
    /// `∫a² dτ` of the open part, and what the squares of sharpened shares lack of it.
    pub(super) light: f64,
    pub(super) lost: f64,
    way: Way,
    corner: [usize; 2],
    /// On the whole raster: slopes of the cosines, étendue over `τ` (its sign), places in the stop, edges, whether a cell is looked at, shares.
    slopes: [Array2<f64>; 4],
    density: Array2<f64>,
    sign: f64,
    stop: [Array2<f64>; 2],
    edges: Vec<Array2<f64>>,
    inside: Array2<bool>,
    shares: Array2<f64>,
    sharp: Array2<f64>,
}

impl PupilFunctions {
    fn even(&self, k: usize) -> (usize, &[f64]) {
        (0, &self.fitted.halves[0].coefficients[k])
    }

    fn odd(&self, k: usize) -> (usize, &[f64]) {
        (1, &self.fitted.halves[1].coefficients[k])
    }

    /// Half the angle between nodes on the rim.
    fn half_turn(&self) -> f64 {
        PI / (2.0 * (self.fitted.degree + 2) as f64)
    }

    /// The cells of a raster that lie where rays are, and a little beyond: farther out polynomials say nothing, and may be open where no light is.
    fn looked_at(&self, sampling: &Sampling) -> Array2<bool> {
        let turn = self.half_turn();
        let mirrored = self.tau.iter().flat_map(|t| [*t, DVec2::new(-t.x, t.y)]);
        let places: Vec<DVec2> = mirrored.map(|t| (t - self.fitted.middle) / self.fitted.half).collect();
        let hull = Hull::around(&places, ROOM[0] * turn * turn + ROOM[1]);
        // In half sides of the box, by cells along columns and rows.
        let at = |x: f64, y: f64| (sampling.tau(DVec2::new(x, y)) - self.fitted.middle) / self.fitted.half;
        let [columns, rows] = sampling.cells;
        let [first, last_column, last_row] = [at(-1.0, -1.0), at(1.0, -1.0), at(-1.0, 1.0)];
        let [column, row] =
            [(last_column, columns), (last_row, rows)].map(|(last, count)| (last - first) / (count - 1) as f64);
        let mut inside = Array2::from_elem((rows, columns), false);
        for (i, mut line) in inside.outer_iter_mut().enumerate() {
            let Some([low, high]) = hull.cut(first + i as f64 * row, column) else { continue };
            line.iter_mut().enumerate().for_each(|(j, v)| *v = (low..=high).contains(&(j as f64)));
        }
        inside
    }

    /// The field on a raster.
    pub(super) fn field(&self, sampling: &Sampling) -> Field {
        self.field_of(sampling, true)
    }

    /// The field on a raster as it would be without path differences.
    pub(super) fn open_field(&self, sampling: &Sampling) -> Field {
        self.field_of(sampling, false)
    }

    fn field_of(&self, sampling: &Sampling, aberrated: bool) -> Field {
        let way = Way::new(self, sampling);
        let [lx, ly] = [Along::X, Along::Y].map(|of| way.raster(self.odd(ODD_COSINE), of));
        let [mx, my] = [Along::X, Along::Y].map(|of| way.raster(self.even(COSINE), of));
        let stop = [way.raster(self.odd(ODD_STOP), Along::Value), way.raster(self.even(STOP), Along::Value)];
        let inside = self.looked_at(sampling);
        let edges = self.edges(&way, &stop);
        let shares = shares(&edges, &inside);
        let sharp = sharpened(&shares);
        let slopes = [lx, ly, mx, my];
        let [lx, ly, mx, my] = &slopes;
        let mut density = lx * my - ly * mx;
        let sign = if (&density * &shares).sum() < 0.0 { -1.0 } else { 1.0 };
        density.mapv_inplace(|v| (sign * v).max(0.0));
        let area = sampling.step * sampling.step;
        let light = (&density * &shares).sum() * area;
        let lost = (&density * &(&shares - &(&sharp * &sharp))).sum() * area;
        // The open part alone.
        let (mut rows, mut cols) = ((usize::MAX, 0), (usize::MAX, 0));
        for ((i, j), _) in sharp.indexed_iter().filter(|(_, v)| **v != 0.0) {
            rows = (rows.0.min(i), rows.1.max(i + 1));
            cols = (cols.0.min(j), cols.1.max(j + 1));
        }
        let (rows, cols) = (rows.0.min(rows.1)..rows.1, cols.0.min(cols.1)..cols.1);
        let wave = TAU / self.wavelength_mm;
        let path = aberrated.then(|| way.raster(self.even(PATH), Along::Value));
        let mut amplitude = Array2::from_elem((rows.len(), cols.len()), Complex::new(0.0, 0.0));
        for ((i, j), a) in amplitude.indexed_iter_mut() {
            let at = [i + rows.start, j + cols.start];
            if sharp[at] != 0.0 {
                let phase = path.as_ref().map_or(0.0, |path| wave * path[at]);
                *a = Complex::from_polar(density[at].sqrt(), phase) * sharp[at];
            }
        }
        let corner = [rows.start, cols.start];
        Field { amplitude, light, lost, way, corner, slopes, density, sign, stop, edges, inside, shares, sharp }
    }

    /// Mean of the path's slopes along columns and rows, by light: how far rays move light, mm.
    pub(super) fn mean_slope(&self, field: &Field) -> DVec2 {
        let light = &field.density * &field.shares;
        let all = light.sum();
        let mean = |of| (&field.way.raster(self.even(PATH), of) * &light).sum() / all;
        DVec2::new(mean(Along::X), mean(Along::Y))
    }

    /// What is positive inside every edge: the rim, the border of what is known, clear apertures by the height over their radius in place of its square, whose edges
    /// are nearer to straight.
    fn edges(&self, way: &Way, [sx, sy]: &[Array2<f64>; 2]) -> Vec<Array2<f64>> {
        let at = |f: &dyn Fn(DVec2) -> f64| ndarray::Zip::from(sx).and(sy).map_collect(|x, y| f(DVec2::new(*x, *y)));
        let mut edges = vec![at(&|s| 1.0 - s.length())];
        if !self.part.is_whole() {
            edges.push(at(&|s| self.border(s)));
        }
        for k in CLIPS..self.fitted.halves[0].coefficients.len() {
            let clip = way.raster(self.even(k), Along::Value);
            edges.push(clip.mapv_into(|v| 1.0 - height(v)));
        }
        edges
    }

    /// Adds the pull-back of cotangents on the field's amplitudes, light and lost light to those of the polynomials.
    pub(super) fn field_vjp(
        &self,
        sampling: &Sampling,
        field: &Field,
        amplitude_bar: &Array2<Complex<f64>>,
        [light, lost]: [f64; 2],
        to: &mut Bars,
    ) {
        let area = sampling.step * sampling.step;
        let Field { shares, sharp, density, way, .. } = field;
        let mut density_bar = area * (&(shares * light) + &((shares - &(sharp * sharp)) * lost));
        let mut shares_bar = density * (area * (light + lost));
        let mut sharp_bar = &(density * sharp) * (-2.0 * area * lost);
        let mut path_bar = Array2::<f64>::zeros(density.dim());
        let wave = TAU / self.wavelength_mm;
        for ((i, j), bar) in amplitude_bar.indexed_iter() {
            let at = [i + field.corner[0], j + field.corner[1]];
            let a = field.amplitude[[i, j]];
            if sharp[at] == 0.0 || density[at] == 0.0 {
                continue;
            }
            let by = bar.conj() * a;
            density_bar[at] += 0.5 * by.re / density[at];
            sharp_bar[at] += by.re / sharp[at];
            path_bar[at] -= wave * by.im;
        }
        way.raster_vjp(0, Along::Value, &path_bar, &mut to[0][PATH]);
        shares_bar += &sharpened(&sharp_bar);
        ndarray::Zip::from(&mut density_bar).and(density).for_each(|b, d| {
            if *d == 0.0 {
                *b = 0.0;
            }
        });
        density_bar *= field.sign;
        let [lx, ly, mx, my] = &field.slopes;
        way.raster_vjp(1, Along::X, &(&density_bar * my), &mut to[1][ODD_COSINE]);
        way.raster_vjp(1, Along::Y, &(&density_bar * mx * -1.0), &mut to[1][ODD_COSINE]);
        way.raster_vjp(0, Along::X, &(&density_bar * ly * -1.0), &mut to[0][COSINE]);
        way.raster_vjp(0, Along::Y, &(&density_bar * lx), &mut to[0][COSINE]);
        let mut bars = vec![Array2::<f64>::zeros(density.dim()); field.edges.len()];
        shares_vjp(&field.edges, &field.inside, &shares_bar, &mut bars);
        let mut bars = bars.into_iter();
        let [mut x, mut y] = [(); 2].map(|()| Array2::<f64>::zeros(density.dim()));
        let rim = bars.next().unwrap_or_default();
        let border = if self.part.is_whole() { None } else { bars.next() };
        for (at, bar) in rim.indexed_iter() {
            let s = DVec2::new(field.stop[0][at], field.stop[1][at]);
            let mut pulled = if s == DVec2::ZERO { DVec2::ZERO } else { s * (-bar / s.length()) };
            if let Some(b) = border.as_ref().map(|b| b[at]).filter(|b| *b != 0.0) {
                pulled += b * self.border_slope(s);
            }
            (x[at], y[at]) = (pulled.x, pulled.y);
        }
        way.raster_vjp(1, Along::Value, &x, &mut to[1][ODD_STOP]);
        way.raster_vjp(0, Along::Value, &y, &mut to[0][STOP]);
        let apertures = &field.edges[field.edges.len() - bars.len()..];
        for ((k, mut bar), edge) in bars.enumerate().zip(apertures) {
            bar.zip_mut_with(edge, |b, e| *b /= 2.0 * (1.0 - e));
            way.raster_vjp(0, Along::Value, &bar, &mut to[0][CLIPS + k]);
        }
    }
}

/// Height over an aperture's radius where `1 − r²/a²` has a value.
fn height(value: f64) -> f64 {
    (1.0 - value).max(1e-12).sqrt()
}

impl Field {
    /// Rows or columns of the open part, whichever are more.
    pub(super) fn across(&self) -> usize {
        self.amplitude.nrows().max(self.amplitude.ncols())
    }

    /// Sum of the amplitudes as they are without path differences.
    pub(super) fn undisturbed(&self) -> f64 {
        self.density.iter().zip(&self.sharp).map(|(d, s)| d.sqrt() * s).sum()
    }
}
