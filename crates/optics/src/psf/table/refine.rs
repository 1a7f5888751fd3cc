//! How many knots a table needs: even intervals are halved until what lies between them is told by the others.

use rayon::prelude::*;

use super::super::fit::Of;
use super::super::sensor_map::SensorMap;
use super::super::stop::StopPoints;
use super::tracing::Tracing;
use super::{Row, Table, TableSpec, views};
use crate::lens::Lens;
use crate::trace::aim::SensorView;
use isoplanat_base::error::Result;
use isoplanat_base::figures::significant;

/// Crossings of surfaces, a wavelength, of a table from which on no other is tried: some seconds.
const MOST_CROSSINGS: usize = 110_000;
/// Knots at which degrees are tried, at most.
const LOOKED_AT: usize = 13;
/// Degrees over the stop that are tried where one does not tell rays.
const DEGREES: [usize; 4] = [9, 12, 15, 18];
/// Intervals at first, and at most.
const INTERVALS: [u32; 2] = [6, 96];
/// Halving the intervals makes the error of six-point interpolation so many times smaller, at least.
const GAIN: f64 = 16.0;

/// Part of the radius over which growth is looked at, and the least growth of the object's height, of its mean.
const STEP: f64 = 1e-3;
const FOLDS: f64 = 0.3;

/// Points of the stop that tell how much light is not known.
const POINTS: usize = 400;

/// What the edge of the light is found to, of its radius.
const EDGE: f64 = 1e-5;

/// Places between the last knot with light and the edge at which the map is tried.
const TRIES: u32 = 6;

/// What the error of a table may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Root mean square error of rays at the sensor's scale, mm.
    pub landing_mm: f64,
    /// Error of the étendue: mean of the differences over the mean.
    pub weight: f64,
}

/// Pixels that rays may be off by without a word.
const TOLD_PX: f64 = 0.1;

impl Tolerance {
    /// A sentence where rays are told worse than to a tenth of a pixel of `pitch_mm` somewhere: polynomials over the stop do not follow light that runs next to rays that fail.
    pub fn untold(&self, pitch_mm: f64) -> Option<String> {
        let px = self.landing_mm / pitch_mm;
        (px > TOLD_PX).then(|| {
            let px = significant(px, 2);
            format!(
                "where the field is worst, rays are told to {px} pixel only (rms of a beam): kernels and pictures are off there by more than is predicted; \
                 rays from the sensor are not (`isoplanat render --method monte-carlo`)"
            )
        })
    }
}

/// A table of even knots from the axis to a radius that hold a tolerance.
#[derive(Clone, Debug)]
pub struct Adapted {
    /// The table.
    pub table: Table,
    /// Its knots, mm, and where light ends before the radius does, that radius too.
    pub radii_mm: Vec<f64>,
    /// Its errors (in the tolerance's own terms): what every second knot misses at the others, over what halving wins; what polynomials over the stop miss of rays with light.
    pub errors: Tolerance,
}

impl Adapted {
    /// Of `lens` for objects at `vergence`. Knots are chosen by the ends of the spectrum; what was traced to choose them serves the table. Where polynomials of `degree` over the
    /// whole stop do not tell rays within the tolerance, they are told over its lit part, then by higher degrees.
    ///
    /// # Errors
    /// As [`Table::compute`]; a picture that is folded from the axis on.
    pub fn compute(
        lens: &Lens,
        vergence: f64,
        wavelength_nm: &[f64],
        degree: usize,
        radius_mm: f64,
        tolerance: Tolerance,
    ) -> Result<Self> {
        let (first, untold) = Self::at(lens, vergence, wavelength_nm, (degree, false), radius_mm, tolerance)?;
        // What lies between knots is not told by higher degrees; a table that took long already is left as it is, and its errors say so.
        let crossings = first.table.rays * lens.surfaces.len() / wavelength_nm.len().max(1);
        if untold <= tolerance.landing_mm || crossings > MOST_CROSSINGS {
            return Ok(first);
        }
        let few = first.table.spec.radii_mm.len().div_ceil(LOOKED_AT);
        let mut radii_mm: Vec<f64> = first.table.spec.radii_mm.iter().rev().step_by(few).rev().copied().collect();
        if radii_mm.first() != Some(&0.0) {
            radii_mm.insert(0, 0.0);
        }
        let ends = ends(wavelength_nm);
        let mut found: Option<(f64, usize)> = None;
        for degree in [degree].into_iter().chain(DEGREES.into_iter().filter(|d| *d > degree)) {
            let spec = TableSpec { radii_mm: radii_mm.clone(), wavelength_nm: ends.clone(), degree, lit: true };
            // What fails as it becomes finer leaves what there is.
            let Ok(table) = Table::compute(lens, &spec) else { break };
            let views = views(lens, &ends);
            let left = table.untold(&views.iter().collect::<Vec<_>>(), vergence);
            if found.is_none_or(|(least, _)| left < least) {
                found = Some((left, degree));
            }
            if left <= tolerance.landing_mm {
                break;
            }
        }
        let finer = found
            .and_then(|(_, degree)| Self::at(lens, vergence, wavelength_nm, (degree, true), radius_mm, tolerance).ok());
        let better = finer.filter(|(tried, _)| tried.errors.landing_mm < first.errors.landing_mm);
        Ok(better.map_or(first, |(tried, _)| tried))
    }

    /// By polynomials of one degree, over the lit part of the stop alone where that is asked for; and what they miss of rays with light, mm.
    fn at(
        lens: &Lens,
        vergence: f64,
        wavelength_nm: &[f64],
        (degree, lit): (usize, bool),
        radius_mm: f64,
        tolerance: Tolerance,
    ) -> Result<(Self, f64)> {
        let mut tracing = Tracing::new(lens, wavelength_nm, (degree, lit))?;
        let (radii_mm, errors) = knots(&mut tracing, vergence, degree, radius_mm, tolerance)?;
        let colours = tracing.colours();
        let table = Table::of(&mut tracing, &radii_mm, &colours)?;
        let views: Vec<&SensorView> = tracing.views.iter().collect();
        let untold = table.untold(&views, vergence);
        let landing_mm = errors.landing_mm.max(untold);
        Ok((Self { table, radii_mm, errors: Tolerance { landing_mm, ..errors } }, untold))
    }
}

/// The ends of the spectrum, which tell how fine a table is to be.
fn ends<T: Copy>(all: &[T]) -> Vec<T> {
    match *all {
        [first, .., last] => vec![first, last],
        _ => all.to_vec(),
    }
}

fn knots(
    tracing: &mut Tracing<'_>,
    vergence: f64,
    degree: usize,
    radius_mm: f64,
    tolerance: Tolerance,
) -> Result<(Vec<f64>, Tolerance)> {
    let ends = ends(&tracing.colours());
    let points = StopPoints::new(degree, POINTS);
    if tracing.chief_slope(STEP * radius_mm, vergence).is_some_and(|slope| slope <= 0.0) {
        return Err(SensorMap::folds(tracing.lens, 0.0, vergence));
    }
    // Where light ends before the radius does, knots are spread up to there, and the last one stands in the dark.
    let (frame_mm, radius_mm) = (radius_mm, lit(tracing, &ends, vergence, radius_mm)?);
    let even = |n: u32| (0..=n).map(|i| radius_mm * f64::from(i) / f64::from(n)).collect::<Vec<f64>>();
    let within = |n: u32| even(n).into_iter().chain((radius_mm < frame_mm).then_some(frame_mm)).collect();
    let holds = |t: Tolerance| t.landing_mm <= tolerance.landing_mm && t.weight <= tolerance.weight;
    let mut n = INTERVALS[0];
    loop {
        let fine = Table::of(tracing, &even(2 * n), &ends)?;
        let (coarse, lost) = difference(&fine.halved(), &fine, vergence, &points);
        let all = Tolerance { weight: coarse.weight.max(lost), ..coarse };
        if holds(all) {
            return Ok((within(n), all));
        }
        // The ends of a beam that rays fail at are between knots what both know: half of it at half the distance.
        let weight = (coarse.weight / GAIN).max(0.5 * lost);
        let finer = Tolerance { landing_mm: coarse.landing_mm / GAIN, weight };
        if holds(finer) || 4 * n > INTERVALS[1] {
            return Ok((within(2 * n), finer));
        }
        n *= 2;
    }
}

/// The largest radius with light, up to `radius_mm`, to [`EDGE`]: where knots of the first look see no more, it is looked
/// for between the last that does and the next. It ends as well where the picture of an object at `vergence` would fold.
fn lit(tracing: &mut Tracing<'_>, colours: &[usize], vergence: f64, radius_mm: f64) -> Result<f64> {
    let even = |n: u32, to: f64| (0..=n).map(|i| to * f64::from(i) / f64::from(n)).collect::<Vec<f64>>();
    let first = Table::of(tracing, &even(INTERVALS[0], radius_mm), colours)?;
    if first.edge_mm == f64::INFINITY {
        return Ok(radius_mm);
    }
    // Chief rays first: they cost the least.
    let grows = |tracing: &mut Tracing<'_>, at: f64| {
        let slopes = [(1.0 - STEP) * at, at].map(|r| tracing.chief_slope(r, vergence));
        matches!(slopes, [Some(near), Some(far)] if far - near > FOLDS * STEP * far) && tracing.is_lit(at, colours)
    };
    let (mut low, mut high) = (first.edge_mm, first.edge_mm + radius_mm / f64::from(INTERVALS[0]));
    while high - low > EDGE * high {
        let middle = 0.5 * (low + high);
        if grows(tracing, middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    // The map that will be fitted has the last word.
    let last = if first.edge_mm > 0.0 { first.edge_mm } else { return Ok(radius_mm) };
    for _ in 0..TRIES {
        if SensorMap::fit(tracing.lens, &Table::of(tracing, &even(2 * INTERVALS[0], low), colours)?, vergence).is_ok() {
            return Ok(low);
        }
        low = last + 0.5 * (low - last);
    }
    Ok(last)
}

/// Largest errors of `table` at the knots of `truth` that both have light at; largest share of the light there that is beyond what `table` knows.
fn difference(table: &Table, truth: &Table, vergence: f64, points: &StopPoints) -> (Tolerance, f64) {
    let slopes = truth.chief_slopes(vergence);
    let radii = &truth.spec.radii_mm;
    let errors = (1..radii.len()).into_par_iter().filter(|k| radii[*k] <= table.edge_mm).map(|k| {
        let mm_per_slope = (radii[k] - radii[k - 1]) / (slopes[k] - slopes[k - 1]);
        let mut worst = [0.0f64; 3];
        for l in 0..truth.spec.wavelength_nm.len() {
            let (here, there) = (table.row(l, &table.taps(radii[k])), &truth.rows[k][l]);
            // Polynomials stand for rays where all that they come from got through.
            let basis = table.bases.of(here.part.common(there.part));
            let values = |of: usize, c: &[f64]| basis.at_nodes()[of].at(Of::Value, c);
            let (a, b) = (here.slope(table, vergence), there.slope(truth, vergence));
            let (mut square, mut count) = (0.0, 0.0);
            for (axis, of) in [(0, 1), (1, 0)] {
                for (p, q) in values(of, &a[axis]).iter().zip(values(of, &b[axis])) {
                    square += (p - q).powi(2);
                    count += 0.5;
                }
            }
            let (w, v) = (values(0, here.weight(table)), values(0, there.weight(truth)));
            let off: f64 = w.iter().zip(&v).map(|(a, b)| (a - b).abs()).sum();
            let all: f64 = v.iter().map(|b| b.abs()).sum();
            worst[0] = worst[0].max((square / count).sqrt() * mm_per_slope.abs());
            worst[1] = worst[1].max(if all > 0.0 { off / all } else { 0.0 });
            worst[2] = worst[2].max(unknown(&here, there, truth, points));
        }
        worst
    });
    let [landing_mm, weight, lost] =
        errors.reduce(|| [0.0; 3], |a, b| [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])]);
    (Tolerance { landing_mm, weight }, lost)
}

/// Share of the light of `there` that comes through a part of the stop over which `here` is not known.
fn unknown(here: &Row, there: &Row, table: &Table, points: &StopPoints) -> f64 {
    if here.part == here.part.around(there.part) {
        return 0.0;
    }
    let [even, _] = &points.at;
    let light = even.at(Of::Value, there.weight(table));
    let clips: Vec<Vec<f64>> = (0..table.clips.len()).map(|k| even.at(Of::Value, there.clip(table, k))).collect();
    let (mut all, mut lost) = (0.0, 0.0);
    for (q, at) in points.points.iter().enumerate() {
        if there.part.depth(*at) > 0.0 && clips.iter().all(|g| g[q] > 0.0) {
            all += light[q].max(0.0);
            lost += if here.part.depth(*at) > 0.0 { 0.0 } else { light[q].max(0.0) };
        }
    }
    if all > 0.0 { lost / all } else { 0.0 }
}
