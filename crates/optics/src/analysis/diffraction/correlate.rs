//! The overlap integral of a pupil and its displaced copy.
//!
//! `T(f) = ∫ P(q + λf u) P*(q) d²q`, `P = A e^{2πi V/λ}` (J. W. Goodman, *Introduction to Fourier Optics*, §6.3, in direction
//! cosines): chord by chord along `u`, Gauss–Legendre between the exact edges of the open parts, and over the chords by
//! `η = m + h sin θ`, which takes the roots at both ends, apart between corners of the pupil. The sizes of both rules follow from the
//! landings `r = −∂V/∂q`: the phase difference of the copies turns by at most `min(spread/λ, f |∂r/∂q|)` for each unit of `q`.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;
use rustfft::num_complex::Complex;

use super::chords::{Chords, common, open};
use super::fit::{Surface, chebyshev, value};
use super::gauss::Rules;
use super::pupil::Oriented;

/// Points of a rule for a smooth integrand, and for each turn of its phase: along a chord, across the chords.
const ALONG: [f64; 2] = [10.0, 1.7];
const ACROSS: [f64; 2] = [18.0, 2.2];

/// One displacement of one pupil.
pub(super) struct Overlap {
    /// By focus, not normalised; `None` where the phase turns too often to be followed.
    pub(super) transfer: Vec<Option<Complex<f64>>>,
    /// With the same amplitude and no aberration.
    pub(super) limit: f64,
}

/// Points that the rules need, along a chord of length `extent` (optical cosines) and across the box, for one focus.
fn sizes(pupil: &Oriented, frequency: f64, focus: f64, extent: f64) -> [f64; 2] {
    let (blur, steepest) = pupil.blur(focus);
    let turns = (blur / pupil.wavelength).min(frequency * steepest) * DVec2::new(extent, 2.0 * pupil.half.y);
    // The phase at the chords' ends turns with their length.
    [ALONG[0] + ALONG[1] * turns.x, ACROSS[0] + ACROSS[1] * (turns.x + turns.y)]
}

/// The largest rule that the focus needs over all frequencies.
pub(super) fn largest(pupil: &Oriented, frequencies: &[f64], foci: &[f64]) -> f64 {
    let most = frequencies.iter().copied().fold(0.0, f64::max);
    let of = |focus: &f64| sizes(pupil, most, *focus, 2.0 * pupil.half.x).into_iter().fold(0.0, f64::max);
    foci.iter().map(of).fold(64.0, f64::max).min(Rules::MOST)
}

/// The overlap at `frequency` (cycles/mm), for image planes `foci` mm behind their place, of which those that need more than `most` points are
/// left out; `fineness` scales the rules.
pub(super) fn overlap(
    pupil: &Oriented,
    chords: &Chords,
    rules: &Rules,
    (frequency, foci): (f64, &[f64]),
    most: f64,
    fineness: f64,
) -> Overlap {
    let shift = pupil.wavelength * frequency / pupil.half.x;
    let wanted: Vec<[f64; 2]> =
        foci.iter().map(|z| sizes(pupil, frequency, *z, (chords.longest() - shift).max(0.0) * pupil.half.x)).collect();
    let followed: Vec<usize> = (0..foci.len()).filter(|k| wanted[*k].iter().all(|n| *n <= most)).collect();
    let planes: Vec<f64> = followed.iter().map(|k| foci[*k]).collect();
    let [along, across] =
        followed.iter().fold([ALONG[0], ACROSS[0]], |[a, b], k| [a.max(wanted[*k][0]), b.max(wanted[*k][1])]);
    let even = even_step(&planes);
    let degree = |s: &Surface| s.degree();
    let highest = degree(&pupil.path).max(degree(&pupil.amplitude));
    let mut sums = vec![Complex::new(0.0, 0.0); planes.len()];
    let mut limit = 0.0;
    let (mut at, mut path, mut amplitude) = (Vec::new(), Vec::new(), Vec::new());
    let ranges = chords.ranges(pupil, shift);
    let whole: f64 = ranges.iter().map(|[low, high]| high - low).sum();
    for [low, high] in ranges {
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let share = (high - low) / whole;
        let steps = rules.of(fineness * (ACROSS[0] * share.max(0.7) + (across - ACROSS[0]) * share));
        for (t, weight) in steps {
            let (sine, cosine) = (FRAC_PI_2 * t).sin_cos();
            let eta = middle + half * sine;
            let weight = weight * FRAC_PI_2 * half * cosine;
            let parts = open(pupil, eta);
            let parts = common(&parts, &parts, shift);
            if parts.is_empty() {
                continue;
            }
            chebyshev(eta, highest, &mut at);
            pupil.path.along(&at, &mut path);
            pupil.amplitude.along(&at, &mut amplitude);
            let depth = |xi: f64| pupil.depth(pupil.middle + pupil.half * DVec2::new(xi, eta));
            for [a, b] in parts {
                for (t, w) in rules.of(fineness * along) {
                    let first = 0.5 * (a + b) + 0.5 * (b - a) * t;
                    let second = first + shift;
                    let part = value(&amplitude, first) * value(&amplitude, second) * weight * w * 0.5 * (b - a);
                    limit += part;
                    let phase = TAU * (value(&path, second) - value(&path, first));
                    if let [plane] = planes[..] {
                        let focus = if plane == 0.0 { 0.0 } else { plane * (depth(second) - depth(first)) };
                        sums[0] += Complex::from_polar(part, phase + TAU / pupil.wavelength * focus);
                        continue;
                    }
                    let turn = TAU / pupil.wavelength * (depth(second) - depth(first));
                    match even {
                        Some(step) => {
                            let mut now = Complex::from_polar(part, phase + planes[0] * turn);
                            let next = Complex::cis(step * turn);
                            for sum in &mut sums {
                                *sum += now;
                                now *= next;
                            }
                        }
                        None => {
                            for (sum, plane) in sums.iter_mut().zip(&planes) {
                                *sum += Complex::from_polar(part, phase + plane * turn);
                            }
                        }
                    }
                }
            }
        }
    }
    let area = pupil.half.x * pupil.half.y;
    let mut transfer = vec![None; foci.len()];
    followed.iter().zip(&sums).for_each(|(k, sum)| transfer[*k] = Some(sum * area));
    Overlap { transfer, limit: limit * area }
}

/// The step of evenly spaced planes.
fn even_step(planes: &[f64]) -> Option<f64> {
    let [first, second, ..] = planes else { return None };
    let step = second - first;
    let size = planes.iter().fold(0.0f64, |m, z| m.max(z.abs()));
    planes.windows(2).all(|p| (p[1] - p[0] - step).abs() <= 1e-12 * size).then_some(step)
}

/// The same by counting: the pupil on a raster of `count × count` points of the box, the copy displaced by whole points.
///
/// Plain and slow: the error falls as `1/count`. Displacement in points; the transfer function and its limit, not normalised.
pub(super) fn counted(pupil: &Oriented, count: u32, points: u32, focus: f64) -> (Complex<f64>, f64) {
    let at = |i: u32| (2.0 * f64::from(i) + 1.0) / f64::from(count) - 1.0;
    let (mut sum, mut limit) = (Complex::new(0.0, 0.0), 0.0);
    let scale = 4.0 * pupil.half.x * pupil.half.y / f64::from(count * count);
    for j in 0..count {
        let of = |i: u32| {
            let point = DVec2::new(at(i), at(j));
            let (path, amplitude) = pupil.at(point)?;
            let q = pupil.middle + pupil.half * point;
            Some(Complex::from_polar(amplitude, TAU * (path + focus * pupil.depth(q) / pupil.wavelength)))
        };
        let row: Vec<Option<Complex<f64>>> = (0..count).map(of).collect();
        for (first, second) in row.iter().zip(row.iter().skip(points as usize)) {
            if let (Some(first), Some(second)) = (first, second) {
                sum += second * first.conj() * scale;
                limit += first.norm() * second.norm() * scale;
            }
        }
    }
    (sum, limit)
}
