//! Spots: centroid, rms radius, best focus, encircled energy and the geometric MTF of rays on a plane.
//!
//! Sums run over landings by their weights. A spot of several colours is that of all their landings together, each colour's weights times its
//! share of the light ([`joined`]). `y` is the tangential direction where the object lies in the meridian of y.

use std::f64::consts::TAU;

use glam::{DVec2, DVec4};

use super::beam::Landing;

/// Figures of one spot, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Mean place.
    pub centroid: DVec2,
    /// Root mean square distance from the centroid.
    pub rms: f64,
    /// Its parts along x and y.
    pub rms_along: DVec2,
    /// Largest distance from the centroid.
    pub radius: f64,
}

/// Landings of several colours as one spot: `(landings, share of the light)`.
pub fn joined<'a>(colours: impl IntoIterator<Item = (&'a [Landing], f64)>) -> Vec<Landing> {
    let scaled = |(landings, share): (&'a [Landing], f64)| {
        landings.iter().map(move |l| Landing { weight: share * l.weight, ..*l }).filter(|l| l.weight > 0.0)
    };
    colours.into_iter().flat_map(scaled).collect()
}

/// `Σ w v / Σ w`; none without light.
fn mean<const N: usize>(landings: &[Landing], value: impl Fn(&Landing) -> [f64; N]) -> Option<[f64; N]> {
    let (mut sum, mut light) = ([0.0; N], 0.0);
    for l in landings {
        light += l.weight;
        sum.iter_mut().zip(value(l)).for_each(|(s, v)| *s += l.weight * v);
    }
    (light > 0.0).then(|| sum.map(|s| s / light))
}

/// The spot `dz` mm behind the image plane; none without light.
pub fn spot(landings: &[Landing], dz: f64) -> Option<Spot> {
    let centroid = DVec2::from(mean(landings, |l| l.at_focus(dz).to_array())?);
    let square = mean(landings, |l| {
        let d = l.at_focus(dz) - centroid;
        (d * d).to_array()
    })?;
    let radius = landings.iter().map(|l| l.at_focus(dz).distance(centroid)).fold(0.0, f64::max);
    Some(Spot { centroid, rms: (square[0] + square[1]).sqrt(), rms_along: DVec2::from(square.map(f64::sqrt)), radius })
}

/// Slopes are parallel where they differ by less than this, rms.
const PARALLEL: f64 = 1e-11;

/// Shifts of the image plane (mm along the light) at which the rms along x, along y and of both is least: the plane's distance from
/// the sagittal, the tangential and the medial focus of all rays. None where all rays are parallel.
pub fn best_focus(landings: &[Landing]) -> Option<[f64; 3]> {
    let m = mean(landings, |l| [l.at.x, l.at.y, l.slope.x, l.slope.y])?;
    let m = DVec4::from_array(m);
    let c = mean(landings, |l| {
        let (p, s) = (l.at - DVec2::new(m.x, m.y), l.slope - DVec2::new(m.z, m.w));
        [p.x * s.x, p.y * s.y, s.x * s.x, s.y * s.y]
    })?;
    // Slopes that differ by rounding alone are parallel.
    if c[2].min(c[3]) < PARALLEL * PARALLEL {
        return None;
    }
    let shifts = [-c[0] / c[2], -c[1] / c[3], -(c[0] + c[1]) / (c[2] + c[3])];
    shifts.iter().all(|s| s.is_finite()).then_some(shifts)
}

/// Modulus of the mean of `exp(−2πi f·p)`: the geometric MTF at `cycles_per_mm` along the unit vector `along`, `dz` mm behind the image
/// plane. 0 without light.
pub fn geometric_mtf(landings: &[Landing], along: DVec2, cycles_per_mm: f64, dz: f64) -> f64 {
    // From the first landing: phases of places far off the axis would lose digits.
    let Some(from) = landings.first().map(|l| l.at_focus(dz)) else { return 0.0 };
    let wave = mean(landings, |l| {
        let phase = TAU * cycles_per_mm * (l.at_focus(dz) - from).dot(along);
        [phase.cos(), phase.sin()]
    });
    wave.map_or(0.0, |[c, s]| c.hypot(s))
}

/// [`geometric_mtf`] at `count` frequencies, the multiples of `step` (cycles/mm) from 0 on. The phase of each is that of the one before and once more the first: a turn in
/// place of a sine and a cosine.
pub(crate) fn geometric_mtf_multiples(
    landings: &[Landing],
    along: DVec2,
    step: f64,
    count: usize,
    dz: f64,
) -> Vec<f64> {
    let Some(from) = landings.first().map(|l| l.at_focus(dz)) else { return vec![0.0; count] };
    let (mut sums, mut light) = (vec![DVec2::ZERO; count], 0.0);
    for l in landings {
        light += l.weight;
        let turn = DVec2::from_angle(TAU * step * (l.at_focus(dz) - from).dot(along));
        let mut wave = DVec2::new(l.weight, 0.0);
        for sum in &mut sums {
            *sum += wave;
            wave = turn.rotate(wave);
        }
    }
    sums.iter().map(|sum| if light > 0.0 { sum.length() / light } else { 0.0 }).collect()
}

/// Distances from the centroid, rising, with the share of the light within each, `dz` mm behind the image plane.
pub(crate) fn encircled(landings: &[Landing], dz: f64) -> Vec<[f64; 2]> {
    let Some(spot) = spot(landings, dz) else { return Vec::new() };
    let mut rays: Vec<[f64; 2]> = landings.iter().map(|l| [l.at_focus(dz).distance(spot.centroid), l.weight]).collect();
    rays.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let light: f64 = rays.iter().map(|r| r[1]).sum();
    let mut within = 0.0;
    rays.iter_mut().for_each(|r| {
        within += r[1];
        r[1] = within / light;
    });
    rays
}

/// Distance from the centroid that holds the share `part` (0 to 1) of the light, mm, of [`encircled`].
pub(crate) fn radius_of(encircled: &[[f64; 2]], part: f64) -> Option<f64> {
    encircled.iter().find(|[_, within]| *within >= part - 1e-12).map(|[radius, _]| *radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    /// A cone of light about `(0, 5)` that comes to a point 0.2 mm behind the plane; every ray alike.
    fn cone(rays: u32) -> Vec<Landing> {
        let ray = |k: u32| {
            let (r, t) = (((f64::from(k) + 0.5) / f64::from(rays)).sqrt(), 2.399_963_229_728_653 * f64::from(k));
            let slope = 0.1 * r * DVec2::from_angle(t);
            Landing { stop: slope * 10.0, at: DVec2::new(0.0, 5.0) - 0.2 * slope, slope, weight: 2.0 }
        };
        (0..rays).map(ray).collect()
    }

    /// Of an even disc of radius R: rms R/√2, encircled energy (r/R)², MTF 2 J₁(v)/v with v = 2πfR.
    #[test]
    fn an_even_disc_has_the_figures_of_the_closed_form() {
        let rays = cone(40_000);
        let found = spot(&rays, 0.0).expect("light");
        let radius = 0.02;
        assert_rel(found.rms, radius / 2f64.sqrt(), 1e-4, 0.0, "rms");
        assert_rel(found.radius, radius, 1e-3, 0.0, "radius");
        assert_abs(found.centroid.distance(DVec2::new(0.0, 5.0)), 0.0, 1e-6, "centroid");
        let energy = encircled(&rays, 0.0);
        assert_rel(radius_of(&energy, 0.5).expect("light"), radius / 2f64.sqrt(), 1e-3, 0.0, "half of the light");
        assert_abs(energy.last().expect("rays")[1], 1.0, 1e-12, "all of it");
        // J₁ by its own series.
        let j1 = |x: f64| {
            let (mut term, mut sum) = (0.5 * x, 0.5 * x);
            for k in 1..40 {
                term *= -0.25 * x * x / (f64::from(k) * f64::from(k + 1));
                sum += term;
            }
            sum
        };
        for f in [5.0, 20.0, 30.0, 50.0] {
            let v = TAU * f * radius;
            for along in [DVec2::X, DVec2::Y, DVec2::ONE.normalize()] {
                assert_abs(geometric_mtf(&rays, along, f, 0.0), (2.0 * j1(v) / v).abs(), 2e-4, "MTF of a disc");
            }
        }
    }

    /// Turns of phases are the sines and cosines of their multiples.
    #[test]
    fn multiples_of_a_frequency_are_frequencies() {
        let rays = cone(3_000);
        for (along, dz) in [(DVec2::X, 0.0), (DVec2::Y, 0.3)] {
            let found = geometric_mtf_multiples(&rays, along, 2.5, 81, dz);
            for (k, value) in found.iter().enumerate() {
                assert_abs(*value, geometric_mtf(&rays, along, 2.5 * k as f64, dz), 1e-12, "a multiple");
            }
        }
        assert_eq!(geometric_mtf_multiples(&[], DVec2::X, 1.0, 2, 0.0), [0.0, 0.0]);
    }

    #[test]
    fn a_cone_of_light_has_its_focus_where_it_comes_to_a_point() {
        let rays = cone(200);
        let focus = best_focus(&rays).expect("rays that meet");
        focus.into_iter().for_each(|z| assert_abs(z, 0.2, 1e-12, "focus"));
        assert!(spot(&rays, 0.2).expect("light").rms < 1e-12);
        assert_abs(geometric_mtf(&rays, DVec2::Y, 300.0, 0.2), 1.0, 1e-9, "a point");
    }

    #[test]
    fn colours_count_by_their_light_and_nothing_is_nothing() {
        let (red, blue) =
            (cone(50), cone(50).iter().map(|l| Landing { at: l.at + DVec2::Y, ..*l }).collect::<Vec<_>>());
        let both = joined([(&red[..], 0.25), (&blue[..], 0.75), (&red[..], 0.0)]);
        assert_eq!(both.len(), 100);
        let [a, b] = [spot(&red, 0.0).expect("light"), spot(&both, 0.0).expect("light")];
        assert_abs(b.centroid.y - a.centroid.y, 0.75, 1e-12, "centroid of both");
        assert!(spot(&[], 0.0).is_none() && best_focus(&[]).is_none() && encircled(&[], 0.0).is_empty());
        assert_eq!(geometric_mtf(&[], DVec2::X, 1.0, 0.0), 0.0);
        // Parallel light has no focus.
        let parallel: Vec<Landing> = red.iter().map(|l| Landing { slope: DVec2::ZERO, ..*l }).collect();
        assert!(best_focus(&parallel).is_none());
    }
}
