//! The kernels of one sensor point, and their pull-back.
//!
//! A kernel belongs to the place on the sensor where light arrives. The ray from there through the stop point `s` meets the
//! object at the slope `u(s)`; the raster that the scene is warped to shows that at `D(u)` ([`SensorMap`]), so the ray moves
//! light by `x − D(u)`. Its share is `W · Π share_a`, the étendue times a C² ramp at every clipping aperture, over
//! their sum; a wavelength's share of a channel is its irradiance there, whose edges are hard ([`super::illumination`]).
//! So a channel's kernel sums to one, less what falls outside the window, and what varies over the field in brightness is
//! kept beside it.
//!
//! The ramp is `t = g/(|∇g| w)` over `−½ < t < ½`, with `g = 1 − r²/a²` and the edge's width `w` of 1.5 spacings of the
//! dense points (four fifths of the rise within one spacing), counted in the stop: the error of a cut beam's area is least
//! there, a narrower edge counts points, a wider one blunts the edge.

use super::fit::{Of, apply, apply_transposed};
use super::illumination::Illumination;
use super::sensor_map::SensorMap;
use super::splat::Raster;
use super::stop::{StopNodes, StopPoints};
use super::table::{Row, RowBar, Table, Taps};

/// Width of the edge in spacings of the dense points.
const WIDTH: f64 = 1.5;
/// Wavelengths with a smaller share of every channel are left out.
const NEGLIGIBLE: f64 = 1e-6;

/// A place on the sensor: distance from the axis and the direction in which it grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Unit vector `(column, row)`.
    pub outward: [f64; 2],
}

impl Place {
    /// The point `[column, row]` mm from the axis.
    pub fn at(offset_mm: [f64; 2]) -> Self {
        let length = offset_mm[0].hypot(offset_mm[1]);
        let outward = if length > 0.0 { offset_mm.map(|v| v / length) } else { [1.0, 0.0] };
        Self { radius_mm: length, outward }
    }
}

/// How kernels are made.
#[derive(Clone, Debug)]
pub struct KernelForm {
    /// Dense points of the stop.
    pub points: StopPoints,
    /// Weight of every wavelength of the table in every channel, `[channel][wavelength]`; each channel sums to one.
    pub weight: Vec<Vec<f64>>,
    /// Size and samples a cell.
    pub raster: Raster,
    /// Side of a cell, mm: the pixel pitch, or a multiple of it for a coarser image.
    pub cell_mm: f64,
}

/// Dense rays of the half `x > 0` of the stop at one place and wavelength.
#[derive(Clone, Debug, Default)]
pub struct Rays {
    /// Displacements across the meridian (of the other half: the negatives), mm.
    pub x: Vec<f64>,
    /// Displacements along the meridian, mm.
    pub y: Vec<f64>,
    /// Shares; those of both halves sum to one.
    pub share: Vec<f64>,
    /// `Σ W · Π share_a` of both halves.
    sum: f64,
    /// By clipping aperture that does clip: its number, `g`, `∂g/∂x`, `∂g/∂y`.
    edges: Vec<(usize, [Vec<f64>; 3])>,
}

/// The light that arrives at one radius, which all kernels of that radius are made of.
#[derive(Clone, Debug)]
pub struct Pencil {
    /// Radius, mm, with light.
    radius_mm: f64,
    /// Knots of the table; none where light was measured.
    taps: Option<Taps>,
    /// Share of each wavelength in each channel's light, `[channel][wavelength]`.
    shares: Vec<Vec<f64>>,
    /// Irradiance of each channel.
    levels: Vec<f64>,
    /// By wavelength; none that no channel sees.
    colours: Vec<Option<Colour>>,
}

/// One wavelength of a pencil.
#[derive(Clone, Debug)]
struct Colour {
    /// Channels that it feeds, with its share of each.
    fed: Vec<(usize, f64)>,
    /// What the rays are made of; none where light was measured.
    row: Option<Row>,
    rays: Rays,
}

/// Cotangents of one wavelength's rays.
#[derive(Clone, Debug)]
struct RaysBar {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Of the shares, both halves together.
    share: Vec<f64>,
}

/// Cotangents of a pencil, added up over its kernels.
#[derive(Clone, Debug)]
pub(crate) struct PencilBar {
    /// By wavelength; empty where the pencil has none.
    rays: Vec<RaysBar>,
    /// `[channel][wavelength]`.
    shares: Vec<Vec<f64>>,
}

impl PencilBar {
    /// All zero, in the form of `pencil`.
    pub(crate) fn zeros(pencil: &Pencil) -> Self {
        let none = |count: usize| RaysBar { x: vec![0.0; count], y: vec![0.0; count], share: vec![0.0; count] };
        Self {
            rays: pencil.colours.iter().map(|c| none(c.as_ref().map_or(0, |c| c.rays.x.len()))).collect(),
            shares: pencil.shares.iter().map(|s| vec![0.0; s.len()]).collect(),
        }
    }
}

/// Cotangents that leave `KernelForm::pencil_vjp`.
#[derive(Clone, Debug)]
pub struct KernelBar {
    /// Of the pencil, mm.
    pub(super) radius_mm: f64,
    /// By wavelength: of the table's polynomials.
    pub(super) rows: Vec<(usize, RowBar)>,
    pub(super) taps: Taps,
    /// By wavelength: of the irradiance.
    pub(super) irradiance: Vec<f64>,
    /// Of the sensor map's coefficients.
    pub(super) map: Vec<f64>,
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

impl KernelForm {
    /// Channels.
    pub fn channels(&self) -> usize {
        self.weight.len()
    }

    /// The dense rays of wavelength `l` at `radius_mm`.
    pub fn rays(&self, table: &Table, map: &SensorMap, l: usize, radius_mm: f64) -> Rays {
        let radius_mm = table.held(radius_mm);
        let row = table.row(l, &table.taps(radius_mm));
        self.rays_of(table, map, &row, radius_mm)
    }

    fn rays_of(&self, table: &Table, map: &SensorMap, row: &Row, radius_mm: f64) -> Rays {
        let [even, odd] = &self.points.at;
        let [cx, cy] = self.displacement(table, map, row, radius_mm);
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
        Rays { x: odd.at(Of::Value, &cx), y: even.at(Of::Value, &cy), share, sum, edges }
    }

    /// Coefficients of the displacement `x − D(u)`, across the meridian (odd) and along it (even), mm.
    fn displacement(&self, table: &Table, map: &SensorMap, row: &Row, radius_mm: f64) -> [Vec<f64>; 2] {
        let nodes = table.nodes(row.part);
        let [even, odd] = &nodes.coefficients;
        let (mut x, mut y) = Self::slopes(&nodes, table, map, row);
        for (x, y) in x.iter_mut().zip(&mut y) {
            let ([px, py], _) = map.point([*x, *y], radius_mm);
            (*x, *y) = (-px, radius_mm - py);
        }
        [apply(odd, &x), apply(even, &y)]
    }

    /// Object slopes at the nodes.
    fn slopes(nodes: &StopNodes, table: &Table, map: &SensorMap, row: &Row) -> (Vec<f64>, Vec<f64>) {
        let [even, odd] = &nodes.at_nodes;
        let [sx, sy] = row.slope(table, map.vergence);
        (odd.at(Of::Value, &sx), even.at(Of::Value, &sy))
    }

    /// Each channel's shares of the wavelengths at a radius, and the channel's irradiance.
    fn shares(&self, illumination: &Illumination, radius_mm: f64) -> (Vec<Vec<f64>>, Vec<f64>) {
        let light = illumination.at(radius_mm);
        let mut levels = Vec::with_capacity(self.channels());
        let shares = self
            .weight
            .iter()
            .map(|w| {
                let parts: Vec<f64> = w.iter().zip(&light).map(|(w, e)| w * e).collect();
                let level: f64 = parts.iter().sum();
                levels.push(level);
                parts.iter().map(|p| if level > 0.0 { p / level } else { 0.0 }).collect()
            })
            .collect();
        (shares, levels)
    }

    /// Channels that wavelength `l` feeds, with its share of each.
    fn fed(shares: &[Vec<f64>], l: usize) -> Vec<(usize, f64)> {
        if shares.iter().all(|s| s[l].abs() < NEGLIGIBLE) {
            return Vec::new();
        }
        shares.iter().enumerate().map(|(c, s)| (c, s[l])).filter(|(_, s)| *s != 0.0).collect()
    }

    fn moves<'a>(&self, outward: [f64; 2], rays: &'a Rays) -> impl Iterator<Item = ([f64; 2], f64)> + 'a {
        let [c, r] = outward.map(|v| v / self.cell_mm);
        let one = move |x: f64, y: f64| [y * c - x * r, y * r + x * c];
        let all = rays.x.iter().zip(&rays.y).zip(&rays.share).filter(|(_, w)| **w != 0.0);
        all.flat_map(move |((x, y), w)| [(one(*x, *y), *w), (one(-*x, *y), *w)])
    }

    /// The light that arrives at `radius_mm` from the axis. Beyond the last radius with light that of the last goes on, so that
    /// what is interpolated towards a place in the dark is right up to the edge.
    pub(crate) fn pencil(&self, table: &Table, illumination: &Illumination, map: &SensorMap, radius_mm: f64) -> Pencil {
        let radius_mm = illumination.held(radius_mm);
        let taps = table.taps(radius_mm);
        let (shares, levels) = self.shares(illumination, radius_mm);
        let of = |l: usize| {
            let fed = Self::fed(&shares, l);
            (!fed.is_empty()).then(|| {
                let row = table.row(l, &taps);
                let rays = self.rays_of(table, map, &row, radius_mm);
                Colour { fed, row: Some(row), rays }
            })
        };
        let colours = (0..table.spec.wavelength_nm.len()).map(of).collect();
        Pencil { radius_mm, taps: Some(taps), shares, levels, colours }
    }

    /// The light of colours that were measured: this form's weights say which channel sees which. It has no pull-back.
    pub(crate) fn pencil_of(&self, radius_mm: f64, colours: Vec<Rays>) -> Pencil {
        let shares = self.weight.clone();
        let of = |(l, rays): (usize, Rays)| {
            let fed = Self::fed(&shares, l);
            (!fed.is_empty()).then_some(Colour { fed, row: None, rays })
        };
        let colours = colours.into_iter().enumerate().map(of).collect();
        Pencil { radius_mm, taps: None, levels: vec![1.0; shares.len()], shares, colours }
    }

    /// Writes the fine kernels of all channels where the radius of `pencil` grows along `outward`, `[channel][row][col]` on the
    /// raster; returns the share of each channel's light that falls outside the window.
    pub fn kernels(&self, pencil: &Pencil, outward: [f64; 2], out: &mut [f64]) -> Vec<f64> {
        out.fill(0.0);
        let mut outside = vec![0.0; self.channels()];
        for Colour { fed, rays, .. } in pencil.colours.iter().flatten() {
            let missed = self.raster.splat(out, fed, self.moves(outward, rays));
            fed.iter().for_each(|(c, s)| outside[*c] += s * missed);
        }
        outside
    }

    /// Adds the pull-back of cotangents on [`Self::kernels`] to that of the pencil.
    pub(crate) fn kernels_vjp(&self, pencil: &Pencil, outward: [f64; 2], bar: &[f64], to: &mut PencilBar) {
        let [c, r] = outward.map(|v| v / self.cell_mm);
        for (l, colour) in pencil.colours.iter().enumerate() {
            let Some(Colour { fed, rays, .. }) = colour else { continue };
            let lit: Vec<usize> = (0..rays.x.len()).filter(|q| rays.share[*q] != 0.0).collect();
            let (out, shares) = (&mut to.rays[l], &mut to.shares);
            self.raster.splat_vjp(bar, fed, self.moves(outward, rays), |k, u_bar, values| {
                let (q, sign) = (lit[k / 2], if k % 2 == 0 { 1.0 } else { -1.0 });
                out.x[q] += sign * (u_bar[1] * c - u_bar[0] * r);
                out.y[q] += u_bar[0] * c + u_bar[1] * r;
                for ((channel, scale), value) in fed.iter().zip(values) {
                    out.share[q] += scale * value;
                    shares[*channel][l] += rays.share[q] * value;
                }
            });
        }
    }

    /// Pulls cotangents on [`Self::pencil`] back.
    ///
    /// # Panics
    /// For a pencil of [`Self::pencil_of`].
    pub(crate) fn pencil_vjp(&self, table: &Table, map: &SensorMap, pencil: &Pencil, bar: &PencilBar) -> KernelBar {
        let mut back = KernelBar {
            radius_mm: pencil.radius_mm,
            rows: Vec::new(),
            irradiance: vec![0.0; pencil.colours.len()],
            map: vec![0.0; map.coefficients.len()],
            taps: pencil.taps.clone().expect("a traced pencil"),
        };
        for (l, colour) in pencil.colours.iter().enumerate() {
            let Some(Colour { row: Some(row), rays, .. }) = colour else { continue };
            let mut row_bar = RowBar::zeros(table);
            self.rays_vjp(table, map, (row, pencil.radius_mm), (rays, &bar.rays[l]), &mut row_bar, &mut back.map);
            back.rows.push((l, row_bar));
        }
        // share = w E / Σ w E.
        for (c, w) in self.weight.iter().enumerate().filter(|(c, _)| pencil.levels[*c] > 0.0) {
            let mean: f64 = pencil.shares[c].iter().zip(&bar.shares[c]).map(|(s, b)| s * b).sum();
            for (to, (w, b)) in back.irradiance.iter_mut().zip(w.iter().zip(&bar.shares[c])) {
                *to += w / pencil.levels[c] * (b - mean);
            }
        }
        back
    }

    fn rays_vjp(
        &self,
        table: &Table,
        map: &SensorMap,
        (row, radius_mm): (&Row, f64),
        (rays, bar): (&Rays, &RaysBar),
        row_bar: &mut RowBar,
        map_bar: &mut [f64],
    ) {
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
        let [from_even, from_odd] = &nodes.coefficients;
        let mut c_bar = [vec![0.0; from_odd.nrows()], vec![0.0; from_even.nrows()]];
        odd.pull(Of::Value, &bar.x, &mut c_bar[0]);
        even.pull(Of::Value, &bar.y, &mut c_bar[1]);
        let (mut x_bar, mut y_bar) = (apply_transposed(from_odd, &c_bar[0]), apply_transposed(from_even, &c_bar[1]));
        let (ux, uy) = Self::slopes(&nodes, table, map, row);
        for j in 0..ux.len() {
            let u = [ux[j], uy[j]];
            let radius = map.point(u, radius_mm).1;
            [x_bar[j], y_bar[j]] = map.point_vjp(u, radius, [-x_bar[j], -y_bar[j]], map_bar);
        }
        let [at_even, at_odd] = &nodes.at_nodes;
        let mut s_bar = [vec![0.0; from_odd.nrows()], vec![0.0; from_even.nrows()]];
        at_odd.pull(Of::Value, &x_bar, &mut s_bar[0]);
        at_even.pull(Of::Value, &y_bar, &mut s_bar[1]);
        row_bar.add_slope(table, map.vergence, [&s_bar[0], &s_bar[1]]);
    }
}

impl Rays {
    /// Light that moves by `[across the meridian, along it]` mm, with the share that each of a move and its mirror image has.
    pub fn of(moves: impl Iterator<Item = ([f64; 2], f64)>) -> Self {
        let mut rays = Self { sum: 1.0, ..Self::default() };
        for ([x, y], share) in moves {
            rays.x.push(x);
            rays.y.push(y);
            rays.share.push(share);
        }
        rays
    }

    /// Étendue of the beam, edges by their ramps; [`Illumination`] has it with hard edges.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn etendue(&self) -> f64 {
        std::f64::consts::FRAC_PI_2 * self.sum / self.x.len() as f64
    }

    /// Adds the light of both halves by whole cells of distance from the centre, times `scale`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded")]
    pub(crate) fn add_reach(&self, cell_mm: f64, scale: f64, by_distance: &mut Vec<f64>) {
        /// Farther is not told apart.
        const FARTHEST: f64 = 1e4;
        for ((x, y), w) in self.x.iter().zip(&self.y).zip(&self.share) {
            let far = (x.hypot(*y) / cell_mm).min(FARTHEST).ceil() as usize;
            if far >= by_distance.len() {
                by_distance.resize(far + 1, 0.0);
            }
            by_distance[far] += 2.0 * scale * w;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::psf::{Optics, OpticsSpec, Quadrature};
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// Of kernels at one radius and three azimuths, against differences in what a pencil is read from beside the table: every
    /// coefficient of the sensor map, every wavelength's irradiance.
    #[test]
    fn pencil_vjp_agrees_with_differences() {
        let lens = builtin::lens("two_element").expect("shipped");
        let weight = vec![vec![0.1, 0.3, 0.6], vec![0.2, 0.7, 0.1], vec![0.8, 0.2, 0.0]];
        let quadrature = Quadrature { nm: vec![470.0, 540.0, 610.0], weight };
        let o = Optics::compute(&lens, &OpticsSpec::even(20.0, vec![1e-3], quadrature)).expect("traces");
        let form = o.form(120, 31, 1, 0.02);
        let azimuths = [[1.0, 0.0], [0.6, -0.8], [0.0, 1.0]];
        let rng = &mut fastrand::Rng::with_seed(8);
        let bars: Vec<Vec<f64>> =
            azimuths.iter().map(|_| (0..3 * 31 * 31).map(|_| rng.f64() - 0.5).collect()).collect();
        let value = |illumination: &Illumination, map: &SensorMap| {
            let pencil = form.pencil(o.table(), illumination, map, 13.0);
            let mut kernel = vec![0.0; 3 * 31 * 31];
            let one = |(outward, bar): (&[f64; 2], &Vec<f64>)| {
                form.kernels(&pencil, *outward, &mut kernel);
                kernel.iter().zip(bar).map(|(a, b)| a * b).sum::<f64>()
            };
            azimuths.iter().zip(&bars).map(one).sum::<f64>()
        };
        let pencil = form.pencil(o.table(), o.illumination(), &o.maps[0], 13.0);
        let mut bar = PencilBar::zeros(&pencil);
        azimuths.iter().zip(&bars).for_each(|(outward, b)| form.kernels_vjp(&pencil, *outward, b, &mut bar));
        let back = form.pencil_vjp(o.table(), &o.maps[0], &pencil, &bar);
        let largest = back.map.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for (i, pulled) in back.map.iter().enumerate() {
            let moved = |h: f64| {
                let mut map = o.maps[0].clone();
                map.coefficients[i] += h;
                value(o.illumination(), &map)
            };
            // Rays that pass from one cell to the next make kinks of the second order: they err as the step.
            assert_rel(*pulled, central_difference(moved, 1e-10), 1e-6, 1e-2 * largest, &format!("coefficient {i}"));
        }
        for (l, pulled) in back.irradiance.iter().enumerate() {
            let moved = |h: f64| {
                let mut light = o.illumination().clone();
                light.irradiance[l].iter_mut().for_each(|e| *e += h);
                value(&light, &o.maps[0])
            };
            assert_rel(*pulled, central_difference(moved, 1e-5), 1e-7, 0.1, &format!("irradiance {l}"));
        }
    }
}
