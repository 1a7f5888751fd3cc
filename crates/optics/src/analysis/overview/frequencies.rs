//! The frequencies of an MTF: even ones from 0, and those that were asked for among them.

use glam::DVec2;

use crate::analysis::beam::Landing;
use crate::analysis::spot::{geometric_mtf, geometric_mtf_multiples};

/// Frequencies, rising.
pub(super) struct Frequencies {
    /// Each, cycles/mm, and its number among the even ones; none of one that was asked for and is not among them.
    all: Vec<(f64, Option<usize>)>,
    step: f64,
    count: usize,
}

impl Frequencies {
    /// `count` even ones from 0 to `highest`, or to the highest of `asked` where that is higher; and `asked`.
    pub(super) fn new(count: u32, highest: f64, asked: &[f64]) -> Self {
        let highest = asked.iter().copied().fold(highest, f64::max);
        let even = even(count, 0.0, highest);
        let mut all: Vec<_> = even.iter().enumerate().map(|(k, f)| (*f, Some(k))).collect();
        all.extend(asked.iter().filter(|f| !even.contains(f)).map(|f| (*f, None)));
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.dedup();
        Self { all, step: even[1], count: even.len() }
    }

    /// All of them, cycles/mm.
    pub(super) fn cycles_per_mm(&self) -> Vec<f64> {
        self.all.iter().map(|(f, _)| *f).collect()
    }

    /// Tangential and sagittal geometric MTF `dz` mm behind the image plane; not numbers without light.
    pub(super) fn mtf(&self, rays: &[Landing], dz: f64) -> Vec<[f64; 2]> {
        if rays.is_empty() {
            return vec![[f64::NAN; 2]; self.all.len()];
        }
        let even = [DVec2::Y, DVec2::X].map(|along| geometric_mtf_multiples(rays, along, self.step, self.count, dz));
        let at = |(f, number): &(f64, Option<usize>)| match number {
            Some(k) => [even[0][*k], even[1][*k]],
            None => [DVec2::Y, DVec2::X].map(|along| geometric_mtf(rays, along, *f, dz)),
        };
        self.all.iter().map(at).collect()
    }
}

/// `count` even values from `low` to `high`.
pub(super) fn even(count: u32, low: f64, high: f64) -> Vec<f64> {
    (0..count.max(2)).map(|k| low + (high - low) * f64::from(k) / f64::from(count.max(2) - 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is asked for stands among the even ones, once, and the even ones reach as far.
    #[test]
    fn asked_frequencies_stand_among_the_even_ones() {
        let of = |asked: &[f64]| Frequencies::new(5, 40.0, asked).cycles_per_mm();
        assert_eq!(of(&[]), [0.0, 10.0, 20.0, 30.0, 40.0]);
        assert_eq!(of(&[25.0, 20.0, 7.5]), [0.0, 7.5, 10.0, 20.0, 25.0, 30.0, 40.0]);
        assert_eq!(of(&[80.0, 25.0]), [0.0, 20.0, 25.0, 40.0, 60.0, 80.0]);
    }
}
