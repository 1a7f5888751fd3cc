//! What every point of the sensor sees through the lens: rays traced once at a few sensor radii and wavelengths, kept as
//! polynomials over the stop, interpolated to any radius; one differentiable value.
//!
//! A [`Table`] holds, by sensor radius `R` (on +y) and wavelength, over the unit stop `s`: where the ray from the sensor
//! point through `s` crosses the first vertex plane (`e`) and with what slopes (`g`), its étendue
//! `W = n'² |∂(L, M)/∂s|`, and `1 − r²/a²` at every clear aperture `a` that it comes near. An object at vergence `v` is met
//! at the slope `g − v e`, so the table serves every depth. Sensor radii between the knots are interpolated by polynomials
//! through the nearest six; the axis counts as a point of symmetry. Cotangents add up in a [`TableBar`] and go back to the
//! lens once, [`Table::vjp`].
//!
//! Where rays of the outer stop fail, a part of it whose nodes all survive is kept ([`Row::part`]): less at the ends along the meridian, since one end
//! of the beam fails first, or a smaller disk, if that is more. What is open beyond it is lost ([`super::illumination::Illumination::lost`] says how
//! much). Light ends at the first knot where no part survives ([`Table::edge_mm`]).

pub(super) mod beam;
mod radii;
mod refine;
mod tracing;

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::stop::{Part, StopNodes};
use crate::lens::{Lens, LensGradient};
use crate::trace::aim::SensorView;
use crate::trace::{Failure, System, SystemGradient};
use beam::{Bases, Beam, Chief};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::stop;
pub(super) use radii::taps;
use radii::{Tap, signs};
pub use refine::{Adapted, Tolerance};
use tracing::Tracing;

/// Knots that one interpolation reads.
const TAPS: usize = 6;
/// Steepest chief ray that counts as light, as an object slope (89.05°): at 90° a plane ends, rays beside a chief ray, which differ
/// from it by its blur, must not meet the pole, and a plane that fills a picture to 80° has its last degree beyond ten times its size.
pub const STEEPEST: f64 = 60.0;
/// Steepest ray beside a chief ray.
const STEEPEST_RAY: f64 = 1000.0;
/// Slope of the last chief ray (60°) from which the pole at 90° is looked for.
const WIDE: f64 = 1.732;

/// Where a table is traced.
#[derive(Clone, Debug, PartialEq)]
pub struct TableSpec {
    /// Sensor radii, mm, growing, the first 0.
    pub radii_mm: Vec<f64>,
    /// Wavelengths, nm.
    pub wavelength_nm: Vec<f64>,
    /// Degree of the polynomials over the stop.
    pub degree: usize,
    /// Whether they are told over the part of the stop alone through which light gets: beyond it rays of a fast lens may run wild.
    pub lit: bool,
}

/// Places of the quantities in a row of coefficients.
#[derive(Clone, Debug, PartialEq)]
struct Layout {
    even: usize,
    odd: usize,
    clips: usize,
}

impl Layout {
    fn entrance(&self) -> [Range<usize>; 2] {
        [0..self.odd, self.odd..self.odd + self.even]
    }
    fn slope(&self) -> [Range<usize>; 2] {
        let from = self.odd + self.even;
        [from..from + self.odd, from + self.odd..2 * from]
    }
    fn weight(&self) -> Range<usize> {
        let from = 2 * (self.odd + self.even);
        from..from + self.even
    }
    fn clip(&self, k: usize) -> Range<usize> {
        let from = self.weight().end + k * self.even;
        from..from + self.even
    }
    fn len(&self) -> usize {
        self.clip(self.clips).start
    }
}

/// Polynomials over the stop at one sensor radius and wavelength.
#[derive(Clone, Debug)]
pub struct Row {
    coefficients: Vec<f64>,
    /// Part of the unit stop over which the polynomials stand for rays.
    pub part: Part,
    /// What the next knot inwards knows: beyond it rays fail.
    pub known: Part,
}

/// Knots and weights of one sensor radius.
#[derive(Clone, Debug)]
pub struct Taps {
    all: Vec<Tap>,
    /// The last knot that lies no farther out.
    inner: usize,
    /// What interpolated crossings and slopes are divided by ([`Table::horizon`]).
    below: f64,
}

/// Traced rays of a lens over sensor radius and wavelength.
#[derive(Clone, Debug)]
pub struct Table {
    /// Where it was traced: knots without light are left out.
    pub spec: TableSpec,
    /// Surfaces (from 0) whose clear apertures come near some beam; all others clip nothing and were left out.
    pub clips: Vec<usize>,
    /// Beyond this sensor radius no ray comes through, mm; infinite where all knots have light.
    pub edge_mm: f64,
    /// Part of the stop's radius that the unit disk stands for: below 1 where rays of the outer stop fail everywhere.
    pub pupil: f64,
    /// `1/R²`, 1/mm², of the sensor radius whose chief ray stands at 90°, where slopes have a pole; 0 where none is near. Crossings
    /// and slopes are kept times `1 − R² · horizon`, which is smooth. It is held in derivatives: any near value serves.
    pub horizon: f64,
    /// Largest residual of the slopes' polynomials, relative to their range.
    pub residual: f64,
    /// Rays traced.
    pub rays: usize,
    layout: Layout,
    signs: Vec<f64>,
    bases: Bases,
    /// `[knot][wavelength]`.
    beams: Vec<Vec<Arc<Beam>>>,
    rows: Vec<Vec<Row>>,
    chiefs: Vec<Chief>,
}

/// Cotangents of a [`Table`]: of its coefficients, and of the chief rays' crossings and slopes.
#[derive(Clone, Debug)]
pub struct TableBar {
    /// `[knot][wavelength][coefficient]`.
    rows: Vec<Vec<Vec<f64>>>,
    chiefs: Vec<[f64; 2]>,
}

impl TableBar {
    /// All zero, in the form of `table`.
    pub fn zeros(table: &Table) -> Self {
        let (knots, colours) = (table.rows.len(), table.spec.wavelength_nm.len());
        Self { rows: vec![vec![vec![0.0; table.layout.len()]; colours]; knots], chiefs: vec![[0.0; 2]; knots] }
    }

    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        for (a, b) in self.rows.iter_mut().flatten().zip(other.rows.iter().flatten()) {
            a.iter_mut().zip(b).for_each(|(x, y)| *x += y);
        }
        for (a, b) in self.chiefs.iter_mut().zip(&other.chiefs) {
            a.iter_mut().zip(b).for_each(|(x, y)| *x += y);
        }
    }
}

/// A ray failure as the error a user sees.
pub(super) fn failed(lens: &Lens, radius_mm: f64, f: Failure) -> Error {
    Error::bad(
        lens.file(),
        format!("rays from the sensor, {radius_mm:.3} mm from the axis"),
        format!("no ray gets through: {} at surface {} counted from the sensor", f.cause.words(), f.surface),
        "a lens whose stop the sensor sees",
    )
}

impl Table {
    /// Traces `lens`.
    ///
    /// # Errors
    /// A lens without rotational symmetry; wavelengths at which its indices are not known; a sensor without light on the axis.
    pub fn compute(lens: &Lens, spec: &TableSpec) -> Result<Self> {
        let mut tracing = Tracing::new(lens, &spec.wavelength_nm, (spec.degree, spec.lit))?;
        let colours = tracing.colours();
        Self::of(&mut tracing, &spec.radii_mm, &colours)
    }

    /// The table of the rays that `tracing` finds at `radii_mm`, of the wavelengths numbered `colours`.
    fn of(tracing: &mut Tracing<'_>, radii_mm: &[f64], colours: &[usize]) -> Result<Self> {
        tracing.trace(radii_mm, colours);
        let mut spec = tracing.spec(radii_mm, colours);
        let (mut beams, mut chiefs, mut edge_mm) = (Vec::new(), Vec::new(), f64::INFINITY);
        for (k, radius) in radii_mm.iter().enumerate() {
            match tracing.seen(*radius, colours) {
                Ok((beam, chief)) => {
                    beams.push(beam);
                    chiefs.push(chief);
                }
                Err(f) if k == 0 => return Err(failed(tracing.lens, *radius, f)),
                Err(_) => {
                    edge_mm = radii_mm[k - 1];
                    spec.radii_mm.truncate(k);
                    break;
                }
            }
        }
        let views: Vec<&SensorView> = colours.iter().map(|l| &tracing.views[*l]).collect();
        let (bases, pupil) = (tracing.bases.clone(), tracing.pupil);
        let clips = beam::near_apertures(&views, &beams);
        let [even, odd] = StopNodes::terms(spec.degree);
        let layout = Layout { even, odd, clips: clips.len() };
        let mut rows: Vec<Vec<Row>> = beams
            .par_iter()
            .map(|beams| beams.iter().zip(&views).map(|(b, v)| b.row(v, &bases, &layout, &clips)).collect())
            .collect();
        let residual = beams.par_iter().zip(&rows).map(|(b, r)| beam::residual(&b[0], &r[0], &bases, &layout));
        let residual = residual.reduce(|| 0.0, f64::max);
        let horizon = horizon(&spec.radii_mm, &chiefs);
        if horizon > 0.0 {
            for (rows, r) in rows.iter_mut().zip(&spec.radii_mm) {
                let below = 1.0 - r * r * horizon;
                rows.iter_mut()
                    .flat_map(|row| &mut row.coefficients[..layout.weight().start])
                    .for_each(|c| *c *= below);
            }
        }
        Ok(Self {
            horizon,
            residual,
            rays: beams.iter().flat_map(|b| b.iter()).map(|b| b.nodes.len()).sum::<usize>() + chiefs.len(),
            signs: signs(&layout, spec.degree),
            spec,
            clips,
            edge_mm,
            pupil,
            layout,
            bases,
            beams,
            rows,
            chiefs,
        })
    }

    /// Largest distance, over knots and wavelengths, of rays with light from their polynomials over the stop, at the sensor's scale, mm (rms of a beam), for an
    /// object at `vergence`. `views` are those of its wavelengths.
    fn untold(&self, views: &[&SensorView], vergence: f64) -> f64 {
        let (slopes, radii) = (self.chief_slopes(vergence), &self.spec.radii_mm);
        let at = |k: usize| {
            // Of the axis, that of the first knot beside it.
            let (inner, outer) = (k.saturating_sub(1), k.max(1).min(radii.len() - 1));
            let mm_per_slope = (radii[outer] - radii[inner]) / (slopes[outer] - slopes[inner]);
            let of = |(beam, view): (&Arc<Beam>, &&SensorView)| beam::untold(beam, view, &self.bases, vergence);
            self.beams[k].iter().zip(views).map(of).fold(0.0, f64::max) * mm_per_slope.abs()
        };
        if radii.len() < 2 { 0.0 } else { (0..radii.len()).into_par_iter().map(at).reduce(|| 0.0, f64::max) }
    }

    /// The same with every second knot.
    pub(super) fn halved(&self) -> Self {
        let mut half = self.clone();
        fn thin<T: Clone>(all: &mut Vec<T>) {
            *all = all.iter().step_by(2).cloned().collect();
        }
        thin(&mut half.spec.radii_mm);
        thin(&mut half.beams);
        thin(&mut half.rows);
        thin(&mut half.chiefs);
        half
    }

    /// Smallest part of the stop's area that rays are known over at any knot.
    pub fn kept(&self) -> f64 {
        self.pupil.powi(2) * self.rows.iter().flatten().map(|r| r.part.share()).fold(1.0, f64::min)
    }

    /// Whether rays of a part of the stop fail anywhere.
    pub fn is_partial(&self) -> bool {
        self.rows.iter().flatten().any(|r| !r.part.is_whole())
    }

    /// Nodes of a part of the stop.
    pub(super) fn nodes(&self, part: Part) -> Arc<StopNodes> {
        self.bases.of(part)
    }

    /// The radius whose rays stand for those of `radius_mm`: beyond the last knot with light, that knot's.
    pub fn held(&self, radius_mm: f64) -> f64 {
        radius_mm.min(self.spec.radii_mm[self.spec.radii_mm.len() - 1])
    }

    /// Knots and weights at a sensor radius; held beyond the last knot.
    pub fn taps(&self, radius_mm: f64) -> Taps {
        let held = self.held(radius_mm);
        // Knots farther out that see less of the stop than the next one does are not read.
        let after = self.spec.radii_mm.partition_point(|r| *r <= held);
        let farther = self.rows.get(after..(after + TAPS / 2).min(self.rows.len())).unwrap_or_default();
        let all = |of: &[Vec<Row>], l: usize| of.iter().map(|row| row[l].part).fold(Part::WHOLE, Part::common);
        let narrows =
            (0..self.spec.wavelength_nm.len()).any(|l| all(farther, l) != all(farther.get(..1).unwrap_or_default(), l));
        let beyond = if narrows { 1 } else { TAPS / 2 };
        Taps {
            all: taps(&self.spec.radii_mm, radius_mm, TAPS, beyond),
            inner: after.saturating_sub(1),
            below: 1.0 - held * held * self.horizon,
        }
    }

    /// The polynomials of wavelength `l` at an interpolated radius.
    pub fn row(&self, l: usize, taps: &Taps) -> Row {
        let mut row = Row { coefficients: vec![0.0; self.layout.len()], part: Part::WHOLE, known: Part::WHOLE };
        let knots = |t: &Tap| &self.rows[t.knot][l];
        for t in &taps.all {
            t.add(&self.signs, &knots(t).coefficients, &mut row.coefficients);
        }
        if self.horizon > 0.0 {
            row.coefficients[..self.layout.weight().start].iter_mut().for_each(|c| *c /= taps.below);
        }
        // Parts have corners: what all knots have that are read.
        row.part = taps.all.iter().map(|t| t.part(knots(t).part)).fold(Part::WHOLE, Part::common);
        row.known = row.part.around(self.rows[taps.inner][l].part);
        row
    }

    /// Adds the cotangent `row_bar` of [`Self::row`] to `bar`.
    pub(crate) fn row_vjp(&self, l: usize, taps: &Taps, row_bar: &[f64], bar: &mut TableBar) {
        let mut row_bar = std::borrow::Cow::Borrowed(row_bar);
        if self.horizon > 0.0 {
            row_bar.to_mut()[..self.layout.weight().start].iter_mut().for_each(|b| *b /= taps.below);
        }
        let row_bar = &*row_bar;
        for t in &taps.all {
            t.add(&self.signs, row_bar, &mut bar.rows[t.knot][l]);
        }
    }

    /// Object slopes of the reference wavelength's chief rays at the knots, for an object at `vergence`.
    pub(crate) fn chief_slopes(&self, vergence: f64) -> Vec<f64> {
        self.chiefs.iter().map(|c| c.slope - vergence * c.entrance).collect()
    }

    /// Adds a cotangent on [`Self::chief_slopes`] to `bar`.
    pub(crate) fn chief_slopes_vjp(&self, vergence: f64, slopes_bar: &[f64], bar: &mut TableBar) {
        for (to, b) in bar.chiefs.iter_mut().zip(slopes_bar) {
            to[0] -= vergence * b;
            to[1] += b;
        }
    }

    /// Pulls cotangents back to the lens.
    pub fn vjp(&self, lens: &Lens, bar: &TableBar) -> LensGradient {
        let views = views(lens, &self.spec.wavelength_nm);
        let reference = SensorView::new(&System::new(lens, lens.wavelengths.primary_nm));
        let colours = views.len();
        let parts: Vec<LensGradient> = (0..self.beams.len() * (colours + 1))
            .into_par_iter()
            .map(|task| {
                stop::look();
                let (k, l) = (task / (colours + 1), task % (colours + 1));
                let view = views.get(l).unwrap_or(&reference);
                let mut out = SystemGradient::zeros(&view.system);
                if l < colours {
                    let beam = &self.beams[k][l];
                    let mut row_bar = std::borrow::Cow::Borrowed(&bar.rows[k][l][..]);
                    if self.horizon > 0.0 {
                        let below = 1.0 - self.spec.radii_mm[k].powi(2) * self.horizon;
                        row_bar.to_mut()[..self.layout.weight().start].iter_mut().for_each(|b| *b *= below);
                    }
                    beam.row_vjp(view, &self.bases, &self.layout, &self.clips, &row_bar, &mut out);
                } else {
                    self.chiefs[k].vjp(&reference, bar.chiefs[k], &mut out);
                }
                let mut gradient = LensGradient::zeros(lens);
                out.reversed().add_to(lens, view.system.wavelength_nm, &mut gradient);
                gradient
            })
            .collect();
        // Summed in the order of knots and wavelengths, whatever the thread count.
        let mut gradient = LensGradient::zeros(lens);
        parts.iter().for_each(|g| gradient.add(g));
        gradient
    }
}

/// `1/R²` of the radius whose chief ray stands at 90°, from the last few; 0 where it is not near.
fn horizon(radii_mm: &[f64], chiefs: &[Chief]) -> f64 {
    let Some(from) = chiefs.len().checked_sub(4) else { return 0.0 };
    let last = radii_mm[radii_mm.len() - 1];
    if chiefs[chiefs.len() - 1].slope < WIDE {
        return 0.0;
    }
    // R as a polynomial in the angle.
    let angles: Vec<f64> = chiefs[from..].iter().map(|c| c.slope.atan()).collect();
    let at = |i: usize| {
        let others = (0..angles.len()).filter(|j| *j != i);
        others.map(|j| (std::f64::consts::FRAC_PI_2 - angles[j]) / (angles[i] - angles[j])).product::<f64>()
    };
    let radius: f64 = radii_mm[from..].iter().enumerate().map(|(i, r)| r * at(i)).sum();
    if radius > last && radius < 2.0 * last { (radius * radius).recip() } else { 0.0 }
}

/// Object slopes of the chief rays that land at `radii_mm` on the sensor, reference wavelength, object at `vergence`, as far out as
/// the sensor sees light of a plane ([`STEEPEST`]): the list may be shorter.
///
/// ```
/// use isoplanat_optics::{lens::builtin, psf::chief_slopes};
///
/// // Of an object at infinity a slope of 0.1 is seen some 5 mm from the axis of 50 mm.
/// let slopes = chief_slopes(&builtin::lens("cooke_triplet")?, 0.0, &[5.0])?;
/// assert!((slopes[0] - 0.1).abs() < 1e-3);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
///
/// # Errors
/// A lens without rotational symmetry, or without light at the first radius.
pub fn chief_slopes(lens: &Lens, vergence: f64, radii_mm: &[f64]) -> Result<Vec<f64>> {
    lens.require_symmetry("chief rays from the sensor")?;
    let view = SensorView::new(&System::new(lens, lens.wavelengths.primary_nm));
    let mut slopes = Vec::with_capacity(radii_mm.len());
    for radius in radii_mm {
        match Chief::trace(&view, *radius) {
            Ok(c) => slopes.push(c.slope - vergence * c.entrance),
            Err(f) if slopes.is_empty() => return Err(failed(lens, *radius, f)),
            Err(_) => break,
        }
    }
    Ok(slopes)
}

fn views(lens: &Lens, wavelength_nm: &[f64]) -> Vec<SensorView> {
    wavelength_nm.iter().map(|nm| SensorView::new(&System::new(lens, *nm))).collect()
}

impl Row {
    /// Coefficients of the object's slope for `vergence`, across the meridian (odd) and along it (even).
    pub fn slope(&self, table: &Table, vergence: f64) -> [Vec<f64>; 2] {
        let (e, g) = (table.layout.entrance(), table.layout.slope());
        [0, 1].map(|k| {
            let pairs = self.coefficients[g[k].clone()].iter().zip(&self.coefficients[e[k].clone()]);
            pairs.map(|(g, e)| g - vergence * e).collect()
        })
    }

    /// Coefficients of the étendue over the unit stop (even).
    pub fn weight(&self, table: &Table) -> &[f64] {
        &self.coefficients[table.layout.weight()]
    }

    /// Coefficients of `1 − r²/a²` at the table's `k`-th clipping aperture (even).
    pub(crate) fn clip(&self, table: &Table, k: usize) -> &[f64] {
        &self.coefficients[table.layout.clip(k)]
    }
}

/// A cotangent of a [`Row`] under construction.
#[derive(Clone, Debug)]
pub(crate) struct RowBar(pub(super) Vec<f64>);

impl RowBar {
    /// Zero, in the form of `table`.
    pub(crate) fn zeros(table: &Table) -> Self {
        Self(vec![0.0; table.layout.len()])
    }

    /// Adds a cotangent on [`Row::slope`].
    pub(crate) fn add_slope(&mut self, table: &Table, vergence: f64, bar: [&[f64]; 2]) {
        let (e, g) = (table.layout.entrance(), table.layout.slope());
        for k in 0..2 {
            self.0[g[k].clone()].iter_mut().zip(bar[k]).for_each(|(a, b)| *a += b);
            self.0[e[k].clone()].iter_mut().zip(bar[k]).for_each(|(a, b)| *a -= vergence * b);
        }
    }

    /// The part that belongs to the étendue.
    pub(crate) fn weight(&mut self, table: &Table) -> &mut [f64] {
        &mut self.0[table.layout.weight()]
    }

    /// The part that belongs to the `k`-th clipping aperture.
    pub(crate) fn clip(&mut self, table: &Table, k: usize) -> &mut [f64] {
        &mut self.0[table.layout.clip(k)]
    }
}

#[cfg(test)]
mod tests;
