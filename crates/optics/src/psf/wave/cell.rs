//! The share of a cell of the pupil's raster that edges leave open, and its pull-back.
//!
//! An edge is a function that is positive inside, given on the raster. About a cell it is taken as a quadratic through the cell's neighbours; smaller cells of a
//! third of the side are cut by straight lines. Where edges cross in one, their shares are multiplied.

use glam::DVec2;
use ndarray::{Array2, Axis, Slice};

/// Cells farther from an edge than this, in their sides, are open or closed as a whole.
const CLEAR: f64 = 1.0;
/// Smaller cells each way of those that an edge is near to.
const PARTS: u32 = 3;

/// Area of the unit square around the origin where `g · p + c ≥ 0`.
fn half_plane(g: DVec2, c: f64) -> f64 {
    let [a, b, side] = [g.x.abs(), g.y.abs(), c.abs()];
    let (small, large) = (a.min(b), a.max(b));
    // By the corner that the edge leaves last, distance along the normal from the lowest corner; all times the slope's length.
    let half = 0.5 * (small + large);
    let area = if side >= half {
        1.0
    } else if side <= 0.5 * (large - small) {
        0.5 + side / large
    } else {
        1.0 - (half - side).powi(2) / (2.0 * small * large)
    };
    if c >= 0.0 { area } else { 1.0 - area }
}

/// [`half_plane`], and its derivatives over `c` and `g`: those of what the line's chord sweeps.
fn half_plane_slopes(g: DVec2, c: f64) -> (f64, f64, DVec2) {
    let area = half_plane(g, c);
    let size = g.length().max(f64::MIN_POSITIVE);
    if c.abs() >= 0.5 * (g.x.abs() + g.y.abs()) {
        return (area, 0.0, DVec2::ZERO);
    }
    let (n, t) = (g / size, c / size);
    let (foot, along) = (-t * n, DVec2::new(-n.y, n.x));
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for (p, d) in [(foot.x, along.x), (foot.y, along.y)] {
        if d == 0.0 {
            if p.abs() > 0.5 {
                return (area, 0.0, DVec2::ZERO);
            }
            continue;
        }
        let ends = [(-0.5 - p) / d, (0.5 - p) / d];
        from = from.max(ends[0].min(ends[1]));
        to = to.min(ends[0].max(ends[1]));
    }
    let length = (to - from).max(0.0) / size;
    (area, length, length * (foot + 0.5 * (from + to) * along))
}

/// Slopes at a cell, by cells along columns (x) and rows (y).
fn slope(f: &Array2<f64>, i: usize, j: usize) -> DVec2 {
    0.5 * DVec2::new(f[[i, j + 1]] - f[[i, j - 1]], f[[i + 1, j]] - f[[i - 1, j]])
}

/// A function about a cell: value, slopes and second derivatives by cells along columns (x) and rows (y).
#[derive(Clone, Copy)]
struct Quadratic {
    value: f64,
    slope: DVec2,
    xx: f64,
    yy: f64,
    xy: f64,
}

impl Quadratic {
    fn about(f: &Array2<f64>, i: usize, j: usize) -> Self {
        let at = |di: usize, dj: usize| f[[i + di - 1, j + dj - 1]];
        let value = at(1, 1);
        Self {
            value,
            slope: slope(f, i, j),
            xx: at(1, 2) - 2.0 * value + at(1, 0),
            yy: at(2, 1) - 2.0 * value + at(0, 1),
            xy: 0.25 * (at(2, 2) - at(2, 0) - at(0, 2) + at(0, 0)),
        }
    }

    fn at(&self, p: DVec2) -> (f64, DVec2) {
        let slope = self.slope + DVec2::new(self.xx * p.x + self.xy * p.y, self.yy * p.y + self.xy * p.x);
        (self.value + 0.5 * (self.slope + slope).dot(p), slope)
    }

    /// Adds cotangents on [`Self::at`].
    fn at_vjp(&mut self, p: DVec2, value: f64, slope: DVec2) {
        self.value += value;
        self.slope += value * p + slope;
        self.xx += 0.5 * value * p.x * p.x + slope.x * p.x;
        self.yy += 0.5 * value * p.y * p.y + slope.y * p.y;
        self.xy += value * p.x * p.y + slope.x * p.y + slope.y * p.x;
    }

    /// Adds the pull-back of [`Self::about`], of cotangents in the form of one.
    fn about_vjp(&self, i: usize, j: usize, to: &mut Array2<f64>) {
        let mut add = |di: usize, dj: usize, v: f64| to[[i + di - 1, j + dj - 1]] += v;
        add(1, 1, self.value - 2.0 * (self.xx + self.yy));
        add(1, 2, 0.5 * self.slope.x + self.xx);
        add(1, 0, -0.5 * self.slope.x + self.xx);
        add(2, 1, 0.5 * self.slope.y + self.yy);
        add(0, 1, -0.5 * self.slope.y + self.yy);
        let corner = 0.25 * self.xy;
        add(2, 2, corner);
        add(2, 0, -corner);
        add(0, 2, -corner);
        add(0, 0, corner);
    }

    const NONE: Self = Self { value: 0.0, slope: DVec2::ZERO, xx: 0.0, yy: 0.0, xy: 0.0 };
}

/// What the edges leave of one cell.
enum Cell {
    Open,
    Closed,
    /// By these of the edges.
    Cut(Vec<(usize, Quadratic)>),
}

fn look(edges: &[Array2<f64>], i: usize, j: usize) -> Cell {
    let mut cut = Vec::new();
    for (k, f) in edges.iter().enumerate() {
        // Far from every edge, as most cells are, the nearest neighbours alone are looked at.
        let (value, slope) = (f[[i, j]], slope(f, i, j).length_squared());
        let far = value * value > CLEAR * CLEAR * slope;
        if value.is_nan() || slope.is_nan() || far && value < 0.0 {
            return Cell::Closed;
        }
        if !far {
            cut.push((k, Quadratic::about(f, i, j)));
        }
    }
    if cut.is_empty() { Cell::Open } else { Cell::Cut(cut) }
}

/// Middles of the smaller cells.
fn parts() -> impl Iterator<Item = DVec2> {
    let at = |k: u32| (f64::from(k) + 0.5) / f64::from(PARTS) - 0.5;
    (0..PARTS).flat_map(move |i| (0..PARTS).map(move |j| DVec2::new(at(j), at(i))))
}

/// Shares of all cells for which `inside` holds, in the form of the edges; the outermost cells are closed.
pub(super) fn shares(edges: &[Array2<f64>], inside: &Array2<bool>) -> Array2<f64> {
    let (rows, cols) = inside.dim();
    let mut out = Array2::zeros((rows, cols));
    for i in 1..rows - 1 {
        for j in (1..cols - 1).filter(|j| inside[[i, *j]]) {
            out[[i, j]] = match look(edges, i, j) {
                Cell::Open => 1.0,
                Cell::Closed => 0.0,
                Cell::Cut(about) => {
                    let part = |p: DVec2| -> f64 {
                        let one = |q: &Quadratic| {
                            let (value, slope) = q.at(p);
                            half_plane(slope / f64::from(PARTS), value)
                        };
                        about.iter().map(|(_, q)| one(q)).product()
                    };
                    parts().map(part).sum::<f64>() / f64::from(PARTS * PARTS)
                }
            };
        }
    }
    out
}

/// Adds the pull-back of cotangents on [`shares`] to those of the edges.
pub(super) fn shares_vjp(edges: &[Array2<f64>], inside: &Array2<bool>, bar: &Array2<f64>, to: &mut [Array2<f64>]) {
    let (rows, cols) = inside.dim();
    for i in 1..rows - 1 {
        for j in (1..cols - 1).filter(|j| inside[[i, *j]] && bar[[i, *j]] != 0.0) {
            let Cell::Cut(about) = look(edges, i, j) else { continue };
            let mut bars = vec![Quadratic::NONE; about.len()];
            let each = bar[[i, j]] / f64::from(PARTS * PARTS);
            for p in parts() {
                let cuts: Vec<_> = about
                    .iter()
                    .map(|(_, q)| {
                        let (value, slope) = q.at(p);
                        half_plane_slopes(slope / f64::from(PARTS), value)
                    })
                    .collect();
                for (k, bar) in bars.iter_mut().enumerate() {
                    let others: f64 = cuts.iter().enumerate().filter(|(m, _)| *m != k).map(|(_, c)| c.0).product();
                    let (_, by_value, by_slope) = cuts[k];
                    bar.at_vjp(p, each * others * by_value, each * others * by_slope / f64::from(PARTS));
                }
            }
            about.iter().zip(&bars).for_each(|((k, _), bar)| bar.about_vjp(i, j, &mut to[*k]));
        }
    }
}

/// What puts back what a cell's area takes of an edge's sharpness: of a cell and of those one, two, … away along a side. To the fourth order of the cell's side, and to
/// 8e-4 of all that changes by up to 0.36 periods a cell, of which areas leave `sin(πν)/(πν)`.
const SHARPENED: [f64; 5] = [
    1.151_755_854_885_666_6,
    -0.092_948_204_836_924_67,
    0.021_890_757_811_410_76,
    -0.005_835_170_514_532_31,
    0.001_014_690_097_212_861,
];
/// Periods a cell, at most, by which the phase of edges' light is let change: of more, what areas are blind to shows as other light.
pub(super) const TOLD: f64 = 0.3;

/// Shares with what their cells' areas took of an edge's sharpness put back. It is its own transpose.
pub(super) fn sharpened(shares: &Array2<f64>) -> Array2<f64> {
    let along = |from: &Array2<f64>, axis: Axis| {
        let mut out = from * SHARPENED[0];
        for (by, tap) in SHARPENED.iter().enumerate().skip(1).filter(|(by, _)| *by < from.len_of(axis)) {
            let (first, last) = (Slice::from(by..), Slice::from(..-by.cast_signed()));
            out.slice_axis_mut(axis, first).scaled_add(*tap, &from.slice_axis(axis, last));
            out.slice_axis_mut(axis, last).scaled_add(*tap, &from.slice_axis(axis, first));
        }
        out
    };
    along(&along(shares, Axis(1)), Axis(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// Against counted points, edges of all directions and distances; derivatives against differences.
    #[test]
    fn areas_are_counted_ones() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for k in 0..200 {
            let angle = if k < 8 { f64::from(k) * std::f64::consts::FRAC_PI_4 } else { 7.0 * rng.f64() };
            let (normal, t) = (DVec2::from_angle(angle), 2.0 * rng.f64() - 1.0);
            let n = 400;
            let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n) - 0.5;
            let inside = |i: i32, j: i32| normal.dot(DVec2::new(at(i), at(j))) + t >= 0.0;
            let count = (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| inside(*i, *j)).count();
            let counted = count as f64 / f64::from(n * n);
            let g = (0.3 + rng.f64()) * normal;
            let c = t * g.length();
            let (area, by_c, by_g) = half_plane_slopes(g, c);
            assert!((area - counted).abs() < 4e-3, "{angle} {t}: {area} for {counted}");
            if k >= 8 {
                let area = half_plane;
                assert_rel(by_c, central_difference(|h| area(g, c + h), 1e-6), 1e-5, 1.0, "over c");
                for (axis, found) in [(DVec2::X, by_g.x), (DVec2::Y, by_g.y)] {
                    assert_rel(found, central_difference(|h| area(g + h * axis, c), 1e-6), 1e-5, 1.0, "over g");
                }
            }
        }
        assert_eq!((half_plane(DVec2::X, 0.25), half_plane(DVec2::Y, -0.75)), (0.75, 0.0));
    }

    /// A disk cut by a line: its area, and the pull-back of [`shares`] against differences in every value.
    #[test]
    fn shares_vjp_agrees_with_differences() {
        let n = 15;
        let at = |k: usize| k as f64 - 7.0;
        let disk = Array2::from_shape_fn((n, n), |(i, j)| 5.2 - at(i).hypot(at(j) - 0.3));
        let line = Array2::from_shape_fn((n, n), |(i, j)| 2.1 + 0.6 * at(i) - 0.8 * at(j));
        let inside = Array2::from_elem((n, n), true);
        let edges = vec![disk.clone(), line];
        let whole = shares(&edges[..1], &inside).sum();
        // Straight lines of a third of a cell, at a radius of five cells.
        assert_rel(whole, std::f64::consts::PI * 5.2f64.powi(2), 1e-3, 1.0, "area");
        let rng = &mut fastrand::Rng::with_seed(5);
        let bar = Array2::from_shape_fn((n, n), |_| rng.f64() - 0.5);
        let mut to = vec![Array2::zeros((n, n)); 2];
        shares_vjp(&edges, &inside, &bar, &mut to);
        for (k, i, j) in [(0, 2, 7), (0, 3, 4), (1, 6, 9), (1, 7, 10), (0, 7, 12), (1, 9, 11)] {
            let moved = |h: f64| {
                let mut edges = edges.clone();
                edges[k][[i, j]] += h;
                (&shares(&edges, &inside) * &bar).sum()
            };
            assert_rel(to[k][[i, j]], central_difference(moved, 1e-6), 1e-6, 0.1, &format!("{k} {i} {j}"));
        }
        // What areas leave of a frequency is put back.
        for k in 0..=36 {
            let nu = std::f64::consts::PI * f64::from(k) / 100.0;
            let taps: f64 =
                (1..).zip(&SHARPENED[1..]).map(|(by, tap)| 2.0 * tap * (2.0 * nu * f64::from(by)).cos()).sum();
            let left = (SHARPENED[0] + taps) * if k == 0 { 1.0 } else { nu.sin() / nu };
            assert!((left - 1.0).abs() < if k <= 5 { 3e-5 } else { 8e-4 }, "{k}: {left}");
        }
        let (a, b) = (sharpened(&bar), sharpened(&disk));
        // Zero around: the transpose holds for any values.
        assert_rel((&a * &disk).sum(), (&b * &bar).sum(), 1e-12, 1.0, "transpose");
    }
}
