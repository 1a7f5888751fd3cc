//! The rays of a sensor point behind a lens with rotational symmetry: from polynomials over the stop, which a [`Table`] interpolates to the point's radius, to dense rays,
//! and back.
//!
//! The sensor point lies on the meridian, +y, and the half `x > 0` of the stop stands for both. What comes out is [`Rays`], which know nothing of a table.
//!
//! A clipping aperture's share of a ray is the ramp `t = g/(|∇g| w)` over `−½ < t < ½`, with `g = 1 − r²/a²` and the edge's width `w` of 1.5 spacings of the
//! dense points (four fifths of the rise within one spacing), counted in the stop: the error of a cut beam's area is least
//! there, a narrower edge counts points, a wider one blunts the edge.

use super::fit::{Of, apply, apply_transposed};
use super::point::SensorPoint;
use super::rays::{Rays, RaysBar};
use super::sensor_map::SensorMap;
use super::stop::{StopNodes, StopPoints};
use super::table::{Row, RowBar, Table, TableBar, Taps};

/// Width of the edge in spacings of the dense points.
const WIDTH: f64 = 1.5;

/// What the light of one sensor radius is made of.
#[derive(Clone, Debug)]
pub(super) struct Meridian {
    /// A point of the radius, with light.
    point: SensorPoint,
    /// Knots of the table.
    taps: Taps,
    /// By wavelength; none that no channel sees.
    rows: Vec<Option<Row>>,
}

/// Cotangents of a [`Meridian`].
#[derive(Clone, Debug)]
pub(super) struct MeridianBar {
    /// A point of the radius.
    pub(super) point: SensorPoint,
    taps: Taps,
    rows: Vec<(usize, RowBar)>,
}

impl MeridianBar {
    /// Adds what belongs to the table's polynomials.
    pub(super) fn add_to(&self, table: &Table, bar: &mut TableBar) {
        for (l, row) in &self.rows {
            table.row_vjp(*l, &self.taps, &row.0, bar);
        }
    }
}

impl Meridian {
    /// At a point's radius, of the wavelengths that `seen` tells.
    pub(super) fn at(table: &Table, point: SensorPoint, seen: impl Fn(usize) -> bool) -> Self {
        let taps = table.taps(point.radius_mm());
        let rows = (0..table.spec.wavelength_nm.len()).map(|l| seen(l).then(|| table.row(l, &taps))).collect();
        Self { point, taps, rows }
    }

    /// The dense rays of every wavelength.
    pub(super) fn rays(&self, points: &StopPoints, table: &Table, map: &SensorMap) -> Vec<Option<Rays>> {
        let dense = Dense { points, table, map, radius_mm: self.point.radius_mm() };
        self.rows.iter().map(|row| row.as_ref().map(|row| dense.rays(row))).collect()
    }

    /// Pulls cotangents on [`Self::rays`] back: to the table, and to the map's coefficients (added).
    pub(super) fn rays_vjp<'a>(
        &self,
        points: &StopPoints,
        table: &Table,
        map: &SensorMap,
        of: impl Fn(usize) -> Option<(&'a Rays, &'a RaysBar)>,
        map_bar: &mut [f64],
    ) -> MeridianBar {
        let dense = Dense { points, table, map, radius_mm: self.point.radius_mm() };
        let mut rows = Vec::new();
        for (l, row) in self.rows.iter().enumerate() {
            let (Some(row), Some((rays, bar))) = (row, of(l)) else { continue };
            let mut row_bar = RowBar::zeros(table);
            dense.rays_vjp(row, (rays, bar), &mut row_bar, map_bar);
            rows.push((l, row_bar));
        }
        MeridianBar { point: self.point, taps: self.taps.clone(), rows }
    }
}

/// C² ramp from 0 to 1 over `−½..½`, and its derivative.
fn ramp(t: f64) -> (f64, f64) {
    if t <= -0.5 {
        return (0.0, 0.0);
    }
    if t >= 0.5 {
        return (1.0, 0.0);
    }
    let s = t + 0.5;
    (s * s * s * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s * s * (1.0 - s) * (1.0 - s))
}

/// An aperture's share of a ray and its derivatives with respect to `g`, `∂g/∂x`, `∂g/∂y`.
fn share(g: f64, gx: f64, gy: f64, width: f64) -> (f64, [f64; 3]) {
    let size = (gx * gx + gy * gy).sqrt();
    let t = g / (size * width);
    if !t.is_finite() {
        return (f64::from(u8::from(g > 0.0)), [0.0; 3]);
    }
    let (value, slope) = ramp(t);
    let by_size = -slope * t / (size * size);
    (value, [slope / (size * width), by_size * gx, by_size * gy])
}

/// Dense points of the stop, seen from a sensor radius.
pub(super) struct Dense<'a> {
    pub(super) points: &'a StopPoints,
    pub(super) table: &'a Table,
    pub(super) map: &'a SensorMap,
    pub(super) radius_mm: f64,
}

impl Dense<'_> {
    /// The rays that a row stands for.
    pub(super) fn rays(&self, row: &Row) -> Rays {
        let Self { table, .. } = *self;
        let [even, odd] = &self.points.at;
        let [cx, cy] = self.displacement(row);
        let mut light: Vec<f64> = even.at(Of::Value, row.weight(table));
        light.iter_mut().for_each(|w| *w = w.max(0.0));
        let width = WIDTH * self.points.spacing;
        if !row.part.is_whole() {
            let at = |p: &glam::DVec2| ramp(row.part.depth(*p) / width).0;
            light.iter_mut().zip(&self.points.points).for_each(|(w, p)| *w *= at(p));
        }
        let mut edges = Vec::new();
        for k in 0..table.clips.len() {
            let c = row.clip(table, k);
            let value = even.at(Of::Value, c);
            // Nowhere near an edge: every share is one.
            let far = 0.5 * width * even.steepest(c) * (1.0 + 1e-9);
            if value.iter().all(|g| *g > far) {
                continue;
            }
            let g = [value, even.at(Of::X, c), even.at(Of::Y, c)];
            let mut clips = false;
            for (q, w) in light.iter_mut().enumerate() {
                let s = share(g[0][q], g[1][q], g[2][q], width).0;
                if s < 1.0 {
                    clips = true;
                    *w *= s;
                }
            }
            if clips {
                edges.push((k, g));
            }
        }
        let sum = 2.0 * light.iter().sum::<f64>();
        let scale = if sum > 0.0 { sum.recip() } else { 0.0 };
        let share = light.iter().map(|w| w * scale).collect();
        Rays { x: odd.at(Of::Value, &cx), y: even.at(Of::Value, &cy), share, mirrored: true, sum, edges }
    }

    /// Coefficients of the displacement `x − D(u)`, across the meridian (odd) and along it (even), mm.
    fn displacement(&self, row: &Row) -> [Vec<f64>; 2] {
        let Self { table, map, radius_mm, .. } = *self;
        let nodes = table.nodes(row.part);
        let [even, odd] = nodes.coefficients();
        let (mut x, mut y) = self.slopes(&nodes, row);
        for (x, y) in x.iter_mut().zip(&mut y) {
            let ([px, py], _) = map.point([*x, *y], radius_mm);
            (*x, *y) = (-px, radius_mm - py);
        }
        [apply(odd, &x), apply(even, &y)]
    }

    /// Object slopes at the nodes.
    fn slopes(&self, nodes: &StopNodes, row: &Row) -> (Vec<f64>, Vec<f64>) {
        let [even, odd] = nodes.at_nodes();
        let [sx, sy] = row.slope(self.table, self.map.vergence);
        (odd.at(Of::Value, &sx), even.at(Of::Value, &sy))
    }

    /// Pulls cotangents on [`Self::rays`] back to the row and to the map's coefficients (added).
    fn rays_vjp(&self, row: &Row, (rays, bar): (&Rays, &RaysBar), row_bar: &mut RowBar, map_bar: &mut [f64]) {
        let Self { table, map, radius_mm, .. } = *self;
        if rays.sum <= 0.0 {
            return;
        }
        let [even, odd] = &self.points.at;
        // share = light / Σ light, both halves.
        let mean: f64 = rays.share.iter().zip(&bar.share).map(|(s, b)| s * b).sum();
        let light_bar: Vec<f64> = bar.share.iter().map(|b| (b - 2.0 * mean) / rays.sum).collect();
        let width = WIDTH * self.points.spacing;
        let edges: Vec<Vec<(f64, [f64; 3])>> = rays
            .edges
            .iter()
            .map(|(_, g)| (0..light_bar.len()).map(|q| share(g[0][q], g[1][q], g[2][q], width)).collect())
            .collect();
        let whole: Vec<f64> = even.at(Of::Value, row.weight(table)).into_iter().map(|w| w.max(0.0)).collect();
        let kept: Vec<f64> = self
            .points
            .points
            .iter()
            .map(|p| if row.part.is_whole() { 1.0 } else { ramp(row.part.depth(*p) / width).0 })
            .collect();
        let shared = |q: usize, but: usize| {
            let others = edges.iter().enumerate().filter(|(k, _)| *k != but);
            kept[q] * others.map(|(_, e)| e[q].0).product::<f64>()
        };
        let weight_bar: Vec<f64> = light_bar
            .iter()
            .enumerate()
            .map(|(q, b)| if whole[q] > 0.0 { b * shared(q, usize::MAX) } else { 0.0 })
            .collect();
        even.pull(Of::Value, &weight_bar, row_bar.weight(table));
        for (k, (clip, _)) in rays.edges.iter().enumerate() {
            let mut parts: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; light_bar.len()]);
            for (q, b) in light_bar.iter().enumerate() {
                let by = b * whole[q] * shared(q, k);
                parts.iter_mut().zip(edges[k][q].1).for_each(|(p, d)| p[q] = by * d);
            }
            let to = row_bar.clip(table, *clip);
            for (of, part) in [Of::Value, Of::X, Of::Y].into_iter().zip(&parts) {
                even.pull(of, part, to);
            }
        }
        // Displacements: to coefficients, to nodes, through the map, to slopes.
        let nodes = table.nodes(row.part);
        let [from_even, from_odd] = nodes.coefficients();
        let mut c_bar = [vec![0.0; from_odd.nrows()], vec![0.0; from_even.nrows()]];
        odd.pull(Of::Value, &bar.x, &mut c_bar[0]);
        even.pull(Of::Value, &bar.y, &mut c_bar[1]);
        let (mut x_bar, mut y_bar) = (apply_transposed(from_odd, &c_bar[0]), apply_transposed(from_even, &c_bar[1]));
        let (ux, uy) = self.slopes(&nodes, row);
        for j in 0..ux.len() {
            let u = [ux[j], uy[j]];
            let radius = map.point(u, radius_mm).1;
            [x_bar[j], y_bar[j]] = map.point_vjp(u, radius, [-x_bar[j], -y_bar[j]], map_bar);
        }
        let [at_even, at_odd] = nodes.at_nodes();
        let mut s_bar = [vec![0.0; from_odd.nrows()], vec![0.0; from_even.nrows()]];
        at_odd.pull(Of::Value, &x_bar, &mut s_bar[0]);
        at_even.pull(Of::Value, &y_bar, &mut s_bar[1]);
        row_bar.add_slope(table, map.vergence, [&s_bar[0], &s_bar[1]]);
    }
}
