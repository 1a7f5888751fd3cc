//! Interpolation over the sensor radius, of a lens with rotational symmetry: knots are mirrored at the axis, where a sensor point turns by half a circle. Rows themselves know no
//! mirror.

use super::super::fit::{Parity, terms};
use super::super::stop::Part;
use super::Layout;

/// One knot of an interpolation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tap {
    pub(crate) knot: usize,
    pub(crate) weight: f64,
    /// Whether what the knot sees is turned by half a circle.
    pub(super) mirrored: bool,
}

impl Tap {
    /// Adds the knot's coefficients, or their pull-back, which is the same.
    pub(super) fn add(&self, signs: &[f64], from: &[f64], to: &mut [f64]) {
        let pairs = to.iter_mut().zip(from);
        if self.mirrored {
            pairs.zip(signs).for_each(|((a, b), s)| *a += self.weight * s * b);
        } else {
            pairs.for_each(|(a, b)| *a += self.weight * b);
        }
    }

    /// The part of the stop that is known at the knot, as the point sees it.
    pub(super) fn part(&self, known: Part) -> Part {
        if self.mirrored { known.turned() } else { known }
    }
}

/// Sign of every coefficient under `R → −R`, where the sensor point turns by half a circle: scalars are turned with the
/// stop, vectors change their sign as well.
pub(super) fn signs(layout: &Layout, degree: usize) -> Vec<f64> {
    let of = |parity| terms(degree, parity).into_iter().map(|(p, q)| if (p + q) % 2 == 0 { 1.0 } else { -1.0 });
    let (even, odd): (Vec<f64>, Vec<f64>) = (of(Parity::Even).collect(), of(Parity::Odd).collect());
    let mut all = Vec::with_capacity(layout.len());
    for _ in 0..2 {
        all.extend(odd.iter().chain(&even).map(|s| -s));
    }
    for _ in 0..=layout.clips {
        all.extend(&even);
    }
    all
}

/// Knots and Lagrange weights at `radius_mm`, at most `beyond` of them farther out; radii are mirrored at the axis, held beyond the last.
pub(crate) fn taps(radii: &[f64], radius_mm: f64, most: usize, beyond: usize) -> Vec<Tap> {
    let n = radii.len();
    let radius = radius_mm.min(radii[n - 1]);
    // Signed indices: −k is knot k mirrored. Few knots may have fewer than are asked for, up to the last that may be read.
    let (after, lowest) = (radii.partition_point(|r| *r <= radius).cast_signed(), 1 - n.cast_signed());
    let end = (after + beyond.cast_signed()).min(n.cast_signed());
    let count = most.cast_signed().min(end - lowest);
    let first = (after - count / 2).min(end - count);
    let at = |i: isize| if i < 0 { -radii[i.unsigned_abs()] } else { radii[i.unsigned_abs()] };
    (first..first + count)
        .map(|i| {
            let others = (first..first + count).filter(|j| *j != i);
            let weight = others.map(|j| (radius - at(j)) / (at(i) - at(j))).product();
            Tap { knot: i.unsigned_abs(), weight, mirrored: i < 0 }
        })
        .filter(|t: &Tap| t.weight != 0.0)
        .collect()
}
