//! Measured MTF: the slanted-edge method of ISO 12233 (e-SFR), by regression instead of bins.
//!
//! The pixels about a straight edge that is not parallel to their rows or columns lie at all distances from it. A cubic spline
//! over that distance is the edge spread function, fitted together with the edge's place, angle and (where it is bent) curvature;
//! its slope is the line spread function, the Fourier transform of that the MTF along the edge's normal, pixel aperture
//! included. Distances are along the normal, so there is no cosine to correct; nothing is binned and nothing is differenced,
//! so there is no bin width, no derivative and no window to correct either. Noise is taken from what the spline leaves.
//!
//! Sources: ISO 12233:2023; P. D. Burns, "Slanted-edge MTF for digital camera and scanner analysis", PICS 2000. Accuracy on
//! edges in closed form: MTF50 within 0.2 %, the curve within 0.002 up to Nyquist (`tests`). Of the 95 % intervals of MTF50
//! and MTF10 90 to 98 % hold the truth, over twelve kinds of noisy edges. Light that changes over the region is
//! fitted with the edge where the samples tell it (`shade`). Not covered: light that bends (a lamp or a lens that is darker in its corners): by 10 % over the region it moves MTF50 by 2 %, and the intervals do not hold that (a
//! warning from 1 % of the contrast on), edges with a corner.
//!
//! Angles: at 0° and 90° every row has the same distances, and nothing is learnt between them: an error, as for any edge that
//! moves by less than a pixel over the region. At 45° (distances repeat every 0.71 px) the MTF is known up to 0.71 cycles a
//! pixel, at 26.6° (0.45 px) up to 1.1; the curve ends there, with a warning where that is below 1.

mod find;
mod line;
mod quantum;
mod refine;
mod samples;
mod shade;
mod spread;
mod step;
mod transfer;
mod trim;

use ndarray::ArrayView2;

use isoplanat_base::error::{Error, Result};
use line::Line;
use refine::Fitted;
use samples::Sample;
use shade::{Blend, Shade};
use transfer::Transfer;

pub use find::find_region;
pub use samples::{Rectangle, Sites};
pub use transfer::{Crossing, MtfPoint};

/// Highest frequency of a curve, cycles a pixel.
pub(crate) const HIGHEST: f64 = 1.0;
/// Least side of a region, pixels.
const LEAST_SIDE: usize = 8;
/// Least number of samples.
const LEAST_SAMPLES: usize = 150;
/// Samples that starts are sought with.
const THINNED: usize = 12_000;
/// How far an edge may bend away from its first line, pixels.
const FAR: f64 = 40.0;
/// Modulation below Nyquist that no sharpening of an edge reaches.
const MOST_SHARPENED: f64 = 2.5;
/// How often a large picture's edge is looked at more closely.
const NEARER: usize = 4;
/// How often foreign parts at an edge's ends are looked for.
const TRIMS: usize = 4;
/// How often the light's slopes and the edge are fitted in turn.
const LIGHTS: usize = 4;
/// Standard errors from which a slope across the edge is the light's.
const CERTAIN_LIGHT: f64 = 4.0;
/// Change of a side's level, of the contrast, that is told.
const TOLD_LIGHT: f64 = 0.02;
/// Distance of neighbouring samples along the normal from which nothing is measured, pixels.
const WIDEST_GAP: f64 = 0.75;

/// Which samples count, and what they may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeOptions {
    /// Where the edge is; [`find_region`] where not given.
    pub region: Option<Rectangle>,
    /// Which pixels count: all, or one colour of a mosaic.
    pub sites: Sites,
    /// Levels at which values are cut off; `None` for values that are not.
    pub range: Option<[f64; 2]>,
}

impl Default for EdgeOptions {
    fn default() -> Self {
        Self { region: None, sites: Sites::ALL, range: None }
    }
}

/// What was measured at one edge, in one colour.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeMeasurement {
    /// Where it was measured.
    pub region: Rectangle,
    /// Angle of the edge from vertical, degrees in (−90, 90]; positive leans to the right at the top.
    pub angle_deg: f64,
    /// Its standard uncertainty, degrees.
    pub angle_uncertainty_deg: f64,
    /// Direction of the normal towards the bright side, degrees from the right, clockwise as seen.
    pub normal_deg: f64,
    /// The point of the edge nearest the region's centre, `[x, y]` in pixels whose centres are whole numbers.
    pub position: [f64; 2],
    /// How far the edge bends over its length in the region, pixels; 0 for a straight one.
    pub sagitta: f64,
    /// Levels of the dark and of the bright side.
    pub levels: [f64; 2],
    /// Standard deviation of one sample about the edge spread function.
    pub noise: f64,
    /// 10 to 90 % width of the edge spread function, pixels.
    pub rise: f64,
    /// Samples in the fit.
    pub samples: usize,
    /// Knots of the spline a pixel.
    pub knots_per_px: f64,
    /// Distance from the edge, pixels; edge spread function from 0 to 1; line spread function, 1/px.
    pub spread: Vec<[f64; 3]>,
    /// The MTF in steps of 0.01 cycles a pixel.
    pub mtf: Vec<MtfPoint>,
    /// Half of a 95 % interval over the standard uncertainty: Student's factor for the rows that the edge crosses.
    pub coverage: f64,
    /// Where the MTF first falls below one half.
    pub mtf50: Option<Crossing>,
    /// Where it first falls below one tenth.
    pub mtf10: Option<Crossing>,
    /// What is doubtful about it, one sentence each.
    pub warnings: Vec<String>,
}

impl EdgeMeasurement {
    /// Michelson contrast of the two levels; NaN where they add up to nothing.
    pub fn michelson(&self) -> f64 {
        (self.levels[1] - self.levels[0]) / (self.levels[1] + self.levels[0])
    }

    /// How far this edge lies from `other` along `other`'s normal at its position, pixels; positive towards larger x for an
    /// edge nearer the vertical, towards larger y for any other.
    pub fn shift_from(&self, other: &Self) -> f64 {
        let (sin, cos) = other.normal_deg.to_radians().sin_cos();
        let d = (self.position[0] - other.position[0]) * cos + (self.position[1] - other.position[1]) * sin;
        let main = if cos.abs() >= sin.abs() { cos } else { sin };
        d * main.signum()
    }
}

/// Measures the edge in `plane`, whose values are proportional to light.
///
/// # Shapes
/// `plane`: `[row, column]`.
///
/// # Errors
/// A value that is no number, a region outside the plane or too small, no edge in it, an edge too near the region's border or
/// along rows or columns.
pub fn measure<T: Copy + Into<f64> + Sync>(plane: ArrayView2<'_, T>, options: &EdgeOptions) -> Result<EdgeMeasurement> {
    Rectangle::whole(plane.dim()).check(plane.dim(), LEAST_SIDE)?;
    let region = match options.region {
        Some(region) => region,
        None => find_region(plane, options.sites)?,
    };
    region.check(plane.dim(), LEAST_SIDE)?;
    let samples = samples::collect(plane, options.sites, region)?;
    let bad = |found: String, allowed: &str| Error::bad("", named(region), found, allowed);
    if samples.len() < LEAST_SAMPLES {
        return Err(bad(format!("{} samples", samples.len()), &format!("at least {LEAST_SAMPLES}")));
    }
    let Edge { fitted, share, light } = edge(&samples, region, options.sites)?;
    let [low, high] = fitted.spread.levels();
    let noise = fitted.spread.variance().sqrt();
    if high - low < 2.0 * noise || high <= low {
        return Err(bad(
            format!("contrast {:.3e} in noise of {noise:.3e}", high - low),
            "one edge whose contrast is at least twice the noise of a pixel",
        ));
    }
    let gap = gap(&fitted);
    let angle = folded_degrees(fitted.line.angle);
    if gap > WIDEST_GAP {
        return Err(bad(
            format!(
                "an edge at {angle:.2}° from vertical, whose pixels leave {gap:.2} px between their distances from it"
            ),
            "an edge that crosses at least one column (or row) within the region; not 0° or 90°, best 2° to 40°",
        ));
    }
    let highest = (0.5 / gap).min(HIGHEST);
    let rounding = quantum::rounding(&fitted.spread, &fitted.points);
    let beside = light.as_ref().and_then(|l| l.beside(&fitted.spread, &fitted.points));
    let transfer = Transfer::new(&fitted.spread, &fitted.points, highest, rounding, beside.as_ref());
    let highest_value = transfer.curve.iter().filter(|p| p.frequency <= 0.5).map(|p| p.value - 3.0 * p.uncertainty);
    let rise = highest_value.fold(0.0, f64::max);
    if rise > MOST_SHARPENED {
        return Err(bad(
            format!("a modulation that rises to {rise:.1}"),
            "one edge between two even areas; a line, a corner or a pattern is none",
        ));
    }
    let [first, last] = fitted.ends();
    let length = last - first;
    let mut warnings = warnings(&fitted, options, [low, high], noise);
    let change = light.as_ref().map_or(0.0, |l| l.change(&fitted.points, high - low));
    if change > TOLD_LIGHT {
        warnings.push(format!(
            "a side's level changes by {:.0} % of the contrast over the region: taken for uneven light, and taken off",
            100.0 * change
        ));
    }
    if share < 1.0 {
        warnings.push(format!(
            "{:.0} % of the region is left out: the edge ends there, or something else begins",
            100.0 * (1.0 - share)
        ));
    }
    if highest < HIGHEST {
        warnings.push(format!(
            "at {angle:.2}° the pixels' distances from the edge lie up to {gap:.2} px apart: the MTF is known up to {highest:.2} cycles/px"
        ));
    }
    Ok(EdgeMeasurement {
        region,
        angle_deg: angle,
        angle_uncertainty_deg: fitted.angle_error.to_degrees(),
        normal_deg: fitted.line.angle.to_degrees().rem_euclid(360.0),
        position: fitted.line.point(0.0),
        sagitta: fitted.line.curvature * length * length / 8.0,
        levels: [low, high],
        noise,
        rise: fitted.spread.crossing(0.9) - fitted.spread.crossing(0.1),
        samples: fitted.points.len(),
        knots_per_px: 1.0 / fitted.spread.knots.step,
        spread: transfer::drawn(&fitted.spread),
        mtf: transfer.curve.iter().step_by(4).copied().collect(),
        coverage: transfer.coverage,
        mtf50: transfer.crossing(0.5),
        mtf10: transfer.crossing(0.1),
        warnings,
    })
}

/// The region's name in errors.
fn named(region: Rectangle) -> String {
    let Rectangle { x, y, width, height } = region;
    format!("region x {x}, y {y}, {width} x {height} pixels")
}

/// An edge with what was found about it.
struct Edge {
    fitted: Fitted,
    /// Share of the samples along the edge that belongs to it.
    share: f64,
    /// Slopes of the light, where samples are told better with them.
    light: Option<Shade>,
}

/// The edge under even light, or under light with slopes along it, or across it too, where that tells the samples better (Akaike's criterion, a sample). A slope across has to be
/// certain besides: the tails of a spread function look much alike.
fn edge(samples: &[Sample], region: Rectangle, sites: Sites) -> Result<Edge> {
    let (even, share) = fitted(samples, region, sites)?;
    let score = |e: &Edge| {
        let (spread, more) = (&e.fitted.spread, e.light.as_ref().map_or(0, Shade::numbers) as f64);
        let n = spread.samples;
        (spread.residual / n).max(f64::MIN_POSITIVE).ln() + 2.0 * (spread.freedom() + more) / n
    };
    let uneven = |even: &Fitted, across: bool| {
        let (spread, points) = refine::narrow(samples, &even.line, even.width)?;
        let blend = Blend::Logistic(even.width);
        let mut light = Shade::none(even.line, blend, &spread, across).improved(&spread, &points)?;
        let mut last = None;
        for _ in 0..LIGHTS {
            let (fitted, share) = fitted(&light.taken_off(samples), region, sites).ok()?;
            light = light.improved(&fitted.spread, &fitted.points)?.about(fitted.line, &fitted.spread);
            last = Some((fitted, share));
        }
        last.map(|(fitted, share)| Edge { fitted, share, light: Some(light) })
    };
    let certain = |e: &Edge| {
        e.light.as_ref().is_some_and(|l| l.certainty_across(&e.fitted.spread, &e.fitted.points) > CERTAIN_LIGHT)
    };
    let [along, both] = [false, true].map(|across| uneven(&even, across));
    let mut best = Edge { fitted: even, share, light: None };
    for other in along.into_iter().chain(both.filter(certain)) {
        if score(&other) < score(&best) {
            best = other;
        }
    }
    Ok(best)
}

/// Line and spread function of the samples, straight unless a bend is certain; and the share of the samples along the edge that
/// belongs to it.
fn fitted(samples: &[Sample], region: Rectangle, sites: Sites) -> Result<(Fitted, f64)> {
    let bad = |found: &str, allowed: &str| Error::bad("", named(region), found, allowed);
    let even = || bad("no contrast: all values are equal", "an edge between two levels");
    let (few, side) = samples::thinned(samples, region, THINNED);
    let centre = region.centre();
    let spacing = side as f64 / sites.share().sqrt();
    let start = step::find(&few, centre, spacing).ok_or_else(even)?;
    let line = Line { centre, angle: start.angle, offset: start.offset, curvature: 0.0 };
    let (mut line, mut width) = refine::logistic(&few, line);
    // Cells of several pixels look wider than the edge: single pixels nearer and nearer to it tell its width.
    for _ in 0..if side > 1 { NEARER } else { 0 } {
        let near = samples.iter().filter(|s| line.distance(s)[0].abs() <= 2.0 * width + 10.0);
        let near: Vec<Sample> = near.copied().collect();
        let few: Vec<Sample> = near.iter().step_by(near.len().div_ceil(THINNED).max(1)).copied().collect();
        (line, width) = refine::logistic(&few, line);
    }
    let [dark, bright] = refine::sides(samples, &line);
    let room = dark.min(bright);
    if room < 0.6 * width + 3.0 {
        return Err(bad(
            &format!("an edge {width:.1} px wide with {dark:.0} px on its dark and {bright:.0} px on its bright side"),
            "one edge with at least 3 px and its own width on both sides",
        ));
    }
    let open = || bad("an edge that cannot be fitted", "one straight edge between two even areas");
    // What lies far from the edge says nothing about it.
    let most = refine::most(width) + FAR;
    let mut kept: Vec<Sample> = samples.iter().copied().filter(|s| line.distance(s)[0].abs() <= most).collect();
    let all = kept.len() as f64;
    for _ in 0..TRIMS {
        let straight = refine::refine(&kept, line, width, false).ok_or_else(open)?;
        let bent = refine::refine(&kept, straight.line, straight.width, true);
        // What is no part of the edge is told from a bend by the bent fit.
        if let Some([first, last]) = trim::run(bent.as_ref().unwrap_or(&straight)) {
            (line, width) = (straight.line, straight.width);
            kept.retain(|s| (first..=last).contains(&line.distance(s)[1]));
            continue;
        }
        let share = kept.len() as f64 / all;
        let Some(bent) = bent else { return Ok((straight, share)) };
        // A bend counts where it is certain and moves the edge by a hundredth of a pixel.
        let length = bent.points.iter().fold(0.0f64, |m, p| m.max(p.t.abs()));
        let curvature = bent.line.curvature.abs();
        let certain = bent.curvature_error.is_some_and(|e| curvature > 4.0 * e);
        let counts = certain && 0.5 * curvature * length * length > 0.01;
        return Ok((if counts { bent } else { straight }, share));
    }
    let last = refine::refine(&kept, line, width, false).ok_or_else(open)?;
    Ok((last, kept.len() as f64 / all))
}

/// The largest distance between neighbours among the samples' distances from the edge, where it rises.
fn gap(fitted: &Fitted) -> f64 {
    let near = f64::max(0.5 * fitted.width, 1.5);
    let mut distances: Vec<f64> = fitted.points.iter().map(|p| p.d).filter(|d| d.abs() <= near).collect();
    distances.sort_by(f64::total_cmp);
    let inner = distances.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    let ends = distances.first().zip(distances.last()).map_or(f64::INFINITY, |(a, b)| (a + near).max(near - b));
    inner.max(ends)
}

/// An angle of the normal as that of the edge from vertical, degrees in (−90, 90].
fn folded_degrees(angle: f64) -> f64 {
    let folded = angle.to_degrees().rem_euclid(180.0);
    if folded > 90.0 { folded - 180.0 } else { folded }
}

/// What is doubtful about a fit.
fn warnings(fitted: &Fitted, options: &EdgeOptions, [low, high]: [f64; 2], noise: f64) -> Vec<String> {
    let mut out = Vec::new();
    let (contrast, spread) = (high - low, &fitted.spread);
    if let Some([black, white]) = options.range {
        let [before, behind] = spread.knots.reach();
        for (name, level, sign, end) in [("dark", black, -1.0, before), ("bright", white, 1.0, behind)] {
            let cut = |v: &&f64| sign * (**v - level) >= 0.0;
            let beside = fitted.points.iter().filter(|p| sign * p.d > end);
            let all: Vec<f64> = beside.map(|p| p.value).collect();
            let share = all.iter().filter(cut).count() as f64 / all.len().max(1) as f64;
            if share > 0.02 {
                out.push(format!(
                    "{:.0} % of the {name} side's pixels stand at {level}, where values are cut off: a clipped edge looks sharper than it is",
                    100.0 * share
                ));
            }
        }
    }
    if fitted.open && tail(spread) > 0.01 * contrast {
        out.push("the edge has not reached its levels where the region ends: frequencies below one over its width are doubtful".into());
    }
    let near = fitted.points.iter().filter(|p| p.d.abs() < 0.5 * fitted.width + 0.5);
    let (count, squares) = near.fold((0.0, 0.0), |(n, s), p| (n + 1.0, s + (p.value - spread.at(p.d)).powi(2)));
    let rough = (squares / f64::max(count, 1.0)).sqrt();
    if rough > 3.0 * noise.max(1e-4 * contrast) && rough > 0.03 * contrast {
        out.push(format!(
            "pixels on the edge scatter by {:.1} % of its contrast: it is not straight, or not alone",
            100.0 * rough / contrast
        ));
    }
    let shade = shading(fitted, noise);
    if shade > 0.01 * contrast {
        out.push(format!(
            "a side of the edge is not even, by {:.1} % of the contrast: shading is taken for spread, low frequencies are doubtful",
            100.0 * shade / contrast
        ));
    }
    if contrast < 5.0 * noise {
        out.push(format!("the contrast is {:.1} times the noise of a pixel only", contrast / noise));
    }
    out
}

/// How far the levels beside the edge change with distance, beyond noise.
fn shading(fitted: &Fitted, noise: f64) -> f64 {
    let [before, behind] = fitted.spread.knots.reach();
    let sides: [Box<dyn Fn(f64) -> f64>; 2] = [Box::new(move |d| -d - before), Box::new(move |d| d - behind)];
    let change = |beyond: &dyn Fn(f64) -> f64| {
        let flat: Vec<[f64; 2]> = fitted.points.iter().map(|p| [beyond(p.d), p.value]).filter(|v| v[0] > 0.0).collect();
        let half = 0.5 * flat.iter().fold(0.0f64, |m, v| m.max(v[0]));
        let [near, far] = [true, false].map(|near| {
            let part = flat.iter().filter(|v| (v[0] < half) == near);
            let (n, s) = part.fold((0.0, 0.0), |(n, s), v| (n + 1.0, s + v[1]));
            (f64::max(n, 1.0), s / f64::max(n, 1.0))
        });
        // Over the whole side, twice what its halves' means differ by.
        let certain = 5.0 * noise * (1.0 / near.0 + 1.0 / far.0).sqrt();
        if near.0 > 20.0 && far.0 > 20.0 { 2.0 * ((near.1 - far.1).abs() - certain).max(0.0) } else { 0.0 }
    };
    sides.iter().map(|s| change(s.as_ref())).fold(0.0, f64::max)
}

/// How far the curve is from its levels one pixel before the spline ends.
fn tail(spread: &spread::Spread) -> f64 {
    let ([low, high], [before, behind]) = (spread.levels(), spread.knots.reach());
    (spread.at(1.0 - before) - low).abs().max((spread.at(behind - 1.0) - high).abs())
}

#[cfg(test)]
mod tests;
