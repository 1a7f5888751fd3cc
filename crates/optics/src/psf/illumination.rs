//! Irradiance of a white scene over the sensor: the étendue of the open part of the stop, hard edges.
//!
//! `E(R) = ∫ W ds` over the part of the unit stop where every clear aperture's `g = 1 − r²/a²` is positive; a Lambertian
//! scene of radiance 1 at any distance gives this irradiance. Along chords of constant `x` the open intervals end at roots
//! of polynomials in `y`, and `W` is integrated exactly between them; the chords themselves are spaced so that the whole
//! disk converges spectrally and a cut one as the square of their number (128: about 1e-5). The adjoint differentiates both: the étendue inside,
//! and the ends of the intervals by the implicit function theorem.

use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, PI};

use rayon::prelude::*;

use super::fit::{Parity, chebyshev, dot, terms};
use super::point::SensorPoint;
use super::stop::Part;
use super::table::{Row, RowBar, Table, TableBar, Taps, taps};
use isoplanat_base::stop::look;

/// Chords of the half `x > 0`.
const CHORDS: u32 = 128;
/// Samples of a chord between which an aperture's edge is looked for.
const SAMPLES: u32 = 12;
/// Points of the rim's half that decide whether an aperture clips at all.
const RIM: u32 = 64;
/// Knots that one interpolation over the radius reads.
const TAPS: usize = 4;
/// Kernels of places with less than this share of the axis's light are those of the last place with more: too few points of the
/// stop see through.
const DIM: f64 = 1e-2;
/// Gauss–Legendre, six points: exact to degree 11.
const GAUSS: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_36),
];

/// Irradiance over the sensor radius, by wavelength.
#[derive(Clone, Debug)]
pub struct Illumination {
    /// Sensor radii, mm, growing, the first 0.
    pub radii_mm: Vec<f64>,
    /// `[wavelength][radius]`, sr (for a sensor in air).
    pub irradiance: Vec<Vec<f64>>,
    /// `[radius]`: what is open between knots' own parts of the stop and what they have in common ([`Row::part`]), by the light at the border, of
    /// the light there; the largest of all wavelengths.
    pub lost: Vec<f64>,
    edge_mm: f64,
    /// Out to here every wavelength has [`DIM`] of its light on the axis.
    lit_mm: f64,
    quadrature: Quadrature,
}

/// Cotangents on [`Illumination::irradiance`].
pub(crate) type IlluminationBar = Vec<Vec<f64>>;

impl Illumination {
    /// At `count + 1` even radii from the axis to `radius_mm`.
    pub fn compute(table: &Table, radius_mm: f64, count: u32) -> Self {
        let radius_mm = radius_mm.min(table.edge_mm);
        let radii_mm: Vec<f64> = (0..=count).map(|i| radius_mm * f64::from(i) / f64::from(count.max(1))).collect();
        let quadrature = Quadrature::new(table.spec.degree);
        let at = |l: usize, r: f64| {
            look();
            if r > table.edge_mm { [0.0; 2] } else { quadrature.integrate(table, &table.row(l, &table.taps(r))) }
        };
        let light: Vec<Vec<[f64; 2]>> = (0..table.spec.wavelength_nm.len())
            .into_par_iter()
            .map(|l| radii_mm.par_iter().map(|r| at(l, *r)).collect())
            .collect();
        let share = |[light, lost]: [f64; 2]| if light > 0.0 { lost / light } else { 0.0 };
        let lost = (0..radii_mm.len()).map(|k| light.iter().map(|of| share(of[k])).fold(0.0, f64::max)).collect();
        let irradiance: Vec<Vec<f64>> =
            light.into_iter().map(|of| of.into_iter().map(|[light, _]| light).collect()).collect();
        let dim = |k: &usize| irradiance.iter().any(|of| of[*k] < DIM * of[0]);
        let lit = (1..radii_mm.len()).find(dim).map_or(f64::INFINITY, |k| radii_mm[k - 1]);
        Self { lit_mm: table.held(lit), radii_mm, irradiance, lost, edge_mm: table.edge_mm, quadrature }
    }

    /// Irradiance at a point by wavelength; held beyond the last radius, 0 where no light comes.
    pub fn at(&self, point: SensorPoint) -> Vec<f64> {
        let radius_mm = point.radius_mm();
        if radius_mm > self.edge_mm {
            return vec![0.0; self.irradiance.len()];
        }
        let taps = taps(&self.radii_mm, radius_mm, TAPS, TAPS);
        let of = |e: &Vec<f64>| taps.iter().map(|t| t.weight * e[t.knot]).sum::<f64>().max(0.0);
        self.irradiance.iter().map(of).collect()
    }

    /// The point whose kernel stands for that of `point`: beyond the last place with light, that place.
    pub(crate) fn held(&self, point: SensorPoint) -> SensorPoint {
        if point.radius_mm() > self.lit_mm { SensorPoint::along(point.outward(), self.lit_mm) } else { point }
    }

    /// Distance from the axis of the last place with light, mm; infinite where all have.
    pub(crate) fn lit_mm(&self) -> f64 {
        self.lit_mm
    }

    /// Adds the pull-back of cotangents on [`Self::at`].
    pub fn at_vjp(&self, point: SensorPoint, bars: &[f64], irradiance_bar: &mut IlluminationBar) {
        let radius_mm = point.radius_mm();
        if radius_mm > self.edge_mm {
            return;
        }
        let taps = taps(&self.radii_mm, radius_mm, TAPS, TAPS);
        for ((e, bar), to) in self.irradiance.iter().zip(bars).zip(irradiance_bar) {
            if taps.iter().map(|t| t.weight * e[t.knot]).sum::<f64>() > 0.0 {
                taps.iter().for_each(|t| to[t.knot] += t.weight * bar);
            }
        }
    }

    /// A zero cotangent.
    pub(crate) fn no_bar(&self) -> IlluminationBar {
        vec![vec![0.0; self.radii_mm.len()]; self.irradiance.len()]
    }

    /// Pulls cotangents back to the table (added to `bar`).
    pub fn vjp(&self, table: &Table, irradiance_bar: &IlluminationBar, bar: &mut TableBar) {
        let places: Vec<(usize, usize)> = (0..irradiance_bar.len())
            .flat_map(|l| (0..self.radii_mm.len()).map(move |k| (l, k)))
            .filter(|(l, k)| irradiance_bar[*l][*k] != 0.0 && self.radii_mm[*k] <= self.edge_mm)
            .collect();
        let parts: Vec<(Taps, RowBar)> = places
            .par_iter()
            .map(|(l, k)| {
                let taps = table.taps(self.radii_mm[*k]);
                let mut row_bar = RowBar::zeros(table);
                self.quadrature.integrate_vjp(table, &table.row(*l, &taps), irradiance_bar[*l][*k], &mut row_bar);
                (taps, row_bar)
            })
            .collect();
        for ((l, _), (taps, row_bar)) in places.iter().zip(&parts) {
            table.row_vjp(*l, taps, &row_bar.0, bar);
        }
    }
}

/// The rule over the half disk.
#[derive(Clone, Debug)]
struct Quadrature {
    terms: Vec<(usize, usize)>,
    degree: usize,
    /// `∫ T_p T_q` over the whole disk.
    disk: Vec<f64>,
    /// Basis at points of the rim, `[point][term]`.
    rim: Vec<Vec<f64>>,
    /// The chords of the whole disk.
    chords: Vec<Chord>,
}

/// One chord: polynomials in y.
#[derive(Clone, Debug)]
struct Chord {
    /// `T_p` at its x.
    across: Vec<f64>,
    /// Its x, the part of it that is looked at, and what it stands for (both halves of the disk).
    x: f64,
    ends: [f64; 2],
    weight: f64,
}

/// An open interval, and which aperture ends it below and above.
struct Open {
    ends: [f64; 2],
    by: [Option<usize>; 2],
}

impl Quadrature {
    fn new(degree: usize) -> Self {
        let terms = terms(degree, Parity::Even);
        let value = |x: f64, y: f64| -> Vec<f64> {
            let (tx, ty) = (chebyshev(x, degree).0, chebyshev(y, degree).0);
            terms.iter().map(|(p, q)| tx[*p] * ty[*q]).collect()
        };
        let rim = (0..=RIM)
            .map(|k| {
                let (x, y) = (PI * f64::from(k) / f64::from(RIM)).sin_cos();
                value(x, y)
            })
            .collect();
        let mut rule = Self { disk: vec![0.0; terms.len()], degree, rim, terms, chords: Vec::new() };
        rule.chords = rule.chords_of(Part::WHOLE);
        for chord in &rule.chords {
            let whole = Open { ends: chord.ends, by: [None; 2] };
            for (y, w) in gauss(&whole) {
                let along = chebyshev(y, degree).0;
                for (d, (p, q)) in rule.disk.iter_mut().zip(&rule.terms) {
                    *d += chord.weight * w * chord.across[*p] * along[*q];
                }
            }
        }
        rule
    }

    /// Chords of a part of the disk.
    fn chords_of(&self, part: Part) -> Vec<Chord> {
        let (step, radius) = (FRAC_PI_2 / f64::from(CHORDS), part.radius);
        let chord = |i: u32| {
            let (sin, cos) = ((f64::from(i) + 0.5) * step).sin_cos();
            let x = radius * sin;
            Chord { across: chebyshev(x, self.degree).0, x, ends: part.chord(x), weight: 2.0 * radius * cos * step }
        };
        (0..CHORDS).map(chord).collect()
    }

    /// The same; those of the whole disk are at hand.
    fn chords(&self, part: Part) -> Cow<'_, [Chord]> {
        if part.is_whole() { Cow::Borrowed(&self.chords) } else { Cow::Owned(self.chords_of(part)) }
    }

    /// Coefficients in y along a chord of the even function `c`.
    fn along(&self, c: &[f64], chord: &Chord) -> Vec<f64> {
        let mut out = vec![0.0; self.degree + 1];
        for (c, (p, q)) in c.iter().zip(&self.terms) {
            out[*q] += c * chord.across[*p];
        }
        out
    }

    /// Apertures that may cut something of the part that is known: of the whole disk, those that cut its rim.
    fn cutting(&self, table: &Table, row: &Row) -> Vec<usize> {
        let cuts = |k: &usize| self.rim.iter().any(|at| dot(at, row.clip(table, *k)) <= 0.0);
        (0..table.clips.len()).filter(|k| !row.part.is_whole() || cuts(k)).collect()
    }

    /// The light of the part that is known, and what may be open beyond it.
    fn integrate(&self, table: &Table, row: &Row) -> [f64; 2] {
        let cutting = self.cutting(table, row);
        if row.part.is_whole() && cutting.is_empty() {
            return [dot(&self.disk, row.weight(table)), 0.0];
        }
        let chords = self.chords(row.part);
        let sums = chords.iter().map(|chord| {
            let weight = self.along(row.weight(table), chord);
            let open = self.intervals((table, row), &cutting, chord);
            let light = open.iter().flat_map(|o| weighed(&weight, gauss(o))).sum::<f64>();
            let known = row.known.chord(chord.x);
            let beyond = |o: &Open, side: usize| {
                let farther = (o.ends[side] - known[side]).abs();
                if o.by[side].is_none() { farther * series(&weight, o.ends[side]).0.max(0.0) } else { 0.0 }
            };
            let lost = open.iter().map(|o| beyond(o, 0) + beyond(o, 1)).sum::<f64>();
            [chord.weight * light, chord.weight * lost]
        });
        sums.fold([0.0; 2], |[a, b], [light, lost]| [a + light, b + lost])
    }

    fn integrate_vjp(&self, table: &Table, row: &Row, bar: f64, row_bar: &mut RowBar) {
        let cutting = self.cutting(table, row);
        if row.part.is_whole() && cutting.is_empty() {
            row_bar.weight(table).iter_mut().zip(&self.disk).for_each(|(a, d)| *a += bar * d);
            return;
        }
        for chord in self.chords(row.part).iter() {
            let weight = self.along(row.weight(table), chord);
            for open in self.intervals((table, row), &cutting, chord) {
                for (y, w) in gauss(&open) {
                    self.scatter(chord, y, bar * chord.weight * w, row_bar.weight(table));
                }
                for side in 0..2 {
                    let Some(k) = open.by[side] else { continue };
                    // δy = −δg/g_y; the upper end adds W δy, the lower takes it away.
                    let y = open.ends[side];
                    let slope = series(&self.along(row.clip(table, k), chord), y).1;
                    let sign = if side == 1 { -1.0 } else { 1.0 };
                    let by = sign * bar * chord.weight * series(&weight, y).0 / slope;
                    if by.is_finite() {
                        self.scatter(chord, y, by, row_bar.clip(table, k));
                    }
                }
            }
        }
    }

    /// Adds `bar` times the basis at `(x, y)`.
    fn scatter(&self, chord: &Chord, y: f64, bar: f64, out: &mut [f64]) {
        let along = chebyshev(y, self.degree).0;
        for (o, (p, q)) in out.iter_mut().zip(&self.terms) {
            *o += bar * chord.across[*p] * along[*q];
        }
    }

    /// Parts of a chord where no aperture cuts.
    fn intervals(&self, (table, row): (&Table, &Row), cutting: &[usize], chord: &Chord) -> Vec<Open> {
        if chord.ends[0] >= chord.ends[1] {
            return Vec::new();
        }
        let mut clips: Vec<Vec<f64>> = Vec::new();
        let mut cuts: Vec<(f64, Option<usize>)> = chord.ends.map(|y| (y, None)).to_vec();
        for k in cutting {
            let clip = self.along(row.clip(table, *k), chord);
            let near = NearParabola::of(&clip);
            match near.one_sign(chord.ends) {
                Some(true) => continue,
                Some(false) => return Vec::new(),
                None => {}
            }
            cuts.extend(roots(&clip, &near, chord.ends).into_iter().map(|y| (y, Some(*k))));
            clips.push(clip);
        }
        cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let open = |pair: &&[(f64, Option<usize>)]| {
            let middle = 0.5 * (pair[0].0 + pair[1].0);
            pair[1].0 > pair[0].0 && clips.iter().all(|c| series(c, middle).0 > 0.0)
        };
        let parts = cuts.windows(2).filter(open);
        parts.map(|pair| Open { ends: [pair[0].0, pair[1].0], by: [pair[0].1, pair[1].1] }).collect()
    }
}

/// Points and weights over an interval.
fn gauss(open: &Open) -> [(f64, f64); 2 * GAUSS.len()] {
    let [a, b] = open.ends;
    let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
    std::array::from_fn(|k| {
        let (x, w) = GAUSS[k / 2];
        (if k % 2 == 0 { middle - half * x } else { middle + half * x }, half * w)
    })
}

/// A Chebyshev series at some points, times their weights.
fn weighed<const N: usize>(c: &[f64], at: [(f64, f64); N]) -> [f64; N] {
    let [mut b1, mut b2] = [[0.0; N]; 2];
    for c in c[1..].iter().rev() {
        for (k, (y, _)) in at.iter().enumerate() {
            (b2[k], b1[k]) = (b1[k], c + 2.0 * y * b1[k] - b2[k]);
        }
    }
    std::array::from_fn(|k| at[k].1 * (c[0] + at[k].0 * b1[k] - b2[k]))
}

/// A Chebyshev series and its derivative, by Clenshaw's recurrence.
fn series(c: &[f64], y: f64) -> (f64, f64) {
    let (mut b1, mut b2, mut d1, mut d2) = (0.0, 0.0, 0.0, 0.0);
    for c in c[1..].iter().rev() {
        (d2, d1) = (d1, 2.0 * b1 + 2.0 * y * d1 - d2);
        (b2, b1) = (b1, c + 2.0 * y * b1 - b2);
    }
    (c[0] + y * b1 - b2, b1 + y * d1 - d2)
}

/// The first three terms of a series as a parabola `a y² + b y + c`, and how far the others can take the series and its derivative from it:
/// apertures are near to parabolas, so most of what is asked of a chord is told by these few numbers.
struct NearParabola {
    at: [f64; 3],
    /// Rounding included.
    off: f64,
    slope_off: f64,
}

impl NearParabola {
    fn of(series: &[f64]) -> Self {
        let term = |k: usize| series.get(k).copied().unwrap_or(0.0);
        let (mut off, mut slope_off, mut square) = (0.0, 0.0, 9.0);
        for (c, odd) in series.iter().skip(3).zip((7..).step_by(2)) {
            off += c.abs();
            slope_off += square * c.abs();
            square += f64::from(odd);
        }
        off += 1e-13 * (0..3).map(|k| term(k).abs()).sum::<f64>();
        Self { at: [2.0 * term(2), term(1), term(0) - term(2)], off, slope_off }
    }

    fn value(&self, y: f64) -> f64 {
        let [a, b, c] = self.at;
        c + y * (b + a * y)
    }

    fn vertex(&self) -> f64 {
        -0.5 * self.at[1] / self.at[0]
    }

    /// Whether the series is positive, or negative, all along between two ends; nothing where that cannot be told.
    fn one_sign(&self, [from, to]: [f64; 2]) -> Option<bool> {
        let vertex = self.vertex();
        let places = [from, to, if vertex > from && vertex < to { vertex } else { from }];
        let [low, high] =
            [f64::min, f64::max].map(|of| places.map(|y| self.value(y)).into_iter().reduce(of).unwrap_or(f64::NAN));
        if low > self.off {
            Some(true)
        } else if high < -self.off {
            Some(false)
        } else {
            None
        }
    }

    /// Where its one root on either side of the vertex can only be; nothing where there may be none or several.
    fn bands(&self) -> Option<[[f64; 2]; 2]> {
        let (vertex, steep) = (self.vertex(), self.at[0].abs());
        let depth = -self.value(vertex) * self.at[0].signum();
        let [near, far] = [depth - self.off, depth + self.off].map(|d| (d / steep).sqrt());
        // Farther out the difference of vertex and root is rounding.
        let told = vertex.abs() < 100.0 && depth > self.off && 2.0 * steep * near > self.slope_off && far.is_finite();
        told.then_some([[vertex - far, vertex - near], [vertex + near, vertex + far]])
    }
}

/// Sign changes of a series between two ends.
fn roots(c: &[f64], near: &NearParabola, [from, to]: [f64; 2]) -> Vec<f64> {
    let Some(bands) = near.bands() else { return sampled_roots(c, [from, to]) };
    let within = bands.map(|[low, high]| [low.max(from), high.min(to)]);
    let found = within.into_iter().filter(|[low, high]| low < high).filter_map(|band| {
        let values = band.map(|y| series(c, y).0);
        ((values[0] > 0.0) != (values[1] > 0.0)).then(|| root(c, band, values))
    });
    found.collect()
}

/// The same of any series: between [`SAMPLES`] samples, and pairs of them inside one interval.
fn sampled_roots(c: &[f64], [from, to]: [f64; 2]) -> Vec<f64> {
    let at = |i: u32| 0.5 * (from + to) + 0.5 * (to - from) * (2.0 * f64::from(i) / f64::from(SAMPLES) - 1.0);
    let values: Vec<(f64, f64)> = (0..=SAMPLES).map(|i| series(c, at(i))).collect();
    let mut out = Vec::new();
    for (i, pair) in (0..SAMPLES).zip(values.windows(2)) {
        let (a, b) = (at(i), at(i + 1));
        if (pair[0].0 > 0.0) != (pair[1].0 > 0.0) {
            out.push(root(c, [a, b], [pair[0].0, pair[1].0]));
        } else if let Some((y, v)) = across(c, [a, b], [pair[0], pair[1]]) {
            out.push(root(c, [a, y], [pair[0].0, v]));
            out.push(root(c, [y, b], [v, pair[1].0]));
        }
    }
    out
}

/// A point between `a` and `b`, whose values have one sign, where the series has the other one: its extremum there, where the
/// tangents of both ends cross zero before they meet.
fn across(c: &[f64], [mut a, mut b]: [f64; 2], [(va, mut da), (vb, mut db)]: [(f64, f64); 2]) -> Option<(f64, f64)> {
    let sign = if va > 0.0 { 1.0 } else { -1.0 };
    if sign * da >= 0.0 || sign * db <= 0.0 {
        return None;
    }
    let meet = (vb - va + da * a - db * b) / (da - db);
    if sign * (va + da * (meet - a)) > 0.0 {
        return None;
    }
    for _ in 0..30 {
        let y = (a - da * (b - a) / (db - da)).clamp(a, b);
        let (v, d) = series(c, y);
        if !(v.is_finite() && d.is_finite()) {
            return None;
        }
        if (v > 0.0) != (va > 0.0) {
            return Some((y, v));
        }
        if sign * d < 0.0 {
            (a, da) = (y, d);
        } else {
            (b, db) = (y, d);
        }
    }
    None
}

/// The sign change between `a` and `b`, by safeguarded Newton.
fn root(c: &[f64], [mut a, mut b]: [f64; 2], values: [f64; 2]) -> f64 {
    let mut y = a + (b - a) * values[0] / (values[0] - values[1]);
    for _ in 0..40 {
        let (v, slope) = series(c, y);
        if (v > 0.0) == (values[0] > 0.0) {
            a = y;
        } else {
            b = y;
        }
        // A step that ends where it began is a step within.
        let next = y - v / slope;
        let next = if next >= a && next <= b { next } else { 0.5 * (a + b) };
        let done = (next - y).abs() <= 1e-14;
        y = next;
        if done {
            break;
        }
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_abs;

    /// Signs and roots that few terms tell are those of the whole series, at every place: random series of any size.
    #[test]
    fn what_parabolas_tell_holds_of_the_series() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let (mut signs, mut bands, mut asked) = ([0; 2], 0, [0; 2]);
        for k in 0..6000usize {
            let tail = [0.5, 1e-2, 1e-4][k % 3];
            let mut c: Vec<f64> =
                (0..k % 9 + 1).map(|j| (rng.f64() * 2.0 - 1.0) * if j < 3 { 1.0 } else { tail }).collect();
            // Some nearly straight.
            if let Some(square) = c.get_mut(2).filter(|_| k % 5 == 0) {
                *square *= 10f64.powf(-16.0 * rng.f64());
            }
            let [a, b] = [rng.f64() * 2.0 - 1.0, rng.f64() * 2.0 - 1.0];
            let ends = [a.min(b), a.max(b)];
            let near = NearParabola::of(&c);
            let at = |i: u32| ends[0] + (ends[1] - ends[0]) * f64::from(i) / 1000.0;
            let values: Vec<f64> = (0..=1000).map(|i| series(&c, at(i)).0).collect();
            let positive = values.iter().filter(|v| **v > 0.0).count();
            asked[0] += usize::from(positive % values.len() == 0);
            if let Some(sign) = near.one_sign(ends) {
                assert_eq!(positive, if sign { values.len() } else { 0 }, "{c:?} {ends:?}");
                signs[usize::from(sign)] += 1;
                continue;
            }
            asked[1] += 1;
            if near.bands().is_some() {
                bands += 1;
                let found = roots(&c, &near, ends);
                // Of values that all have one sign between two roots: as many changes as roots, each where a change is.
                let changes: Vec<u32> =
                    (0..1000).filter(|i| (values[*i as usize] > 0.0) != (values[*i as usize + 1] > 0.0)).collect();
                assert!(found.len() >= changes.len() && found.windows(2).all(|p| p[0] < p[1]), "{c:?} {ends:?}");
                for i in changes {
                    assert!(found.iter().any(|y| *y >= at(i) - 1e-12 && *y <= at(i + 1) + 1e-12), "{c:?} {ends:?}");
                }
                for y in found {
                    let (v, slope) = series(&c, y);
                    assert!((v / slope).abs() < 1e-13, "{c:?} {y}");
                }
            }
        }
        assert!(signs[0] + signs[1] > asked[0] * 3 / 4 && signs[0].min(signs[1]) > 1000, "{signs:?} {asked:?}");
        assert!(bands > asked[1] / 3, "{bands} {asked:?}");
    }

    /// An aperture that leaves less of a chord open than two samples are apart, or closes as little.
    #[test]
    fn narrow_openings_are_seen() {
        for (middle, half) in [(0.07f64, 1e-3f64), (0.07, 0.03), (-0.4, 1e-6), (0.89, 5e-3)] {
            for sign in [1.0, -1.0] {
                // ±(half² − (y − middle)²).
                let c = [half * half - middle * middle - 0.5, 2.0 * middle, -0.5].map(|v| sign * v);
                let found = sampled_roots(&c, [-0.9, 0.9]);
                assert_eq!(found.len(), 2, "{middle} {half}");
                assert_abs(found[0], middle - half, 1e-12 / half, "below");
                assert_abs(found[1], middle + half, 1e-12 / half, "above");
            }
        }
        assert!(sampled_roots(&[-0.5 - 1e-9, 0.0, -0.5], [-0.9, 0.9]).is_empty(), "no more than touches");
    }
}
