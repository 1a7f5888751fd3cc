//! Where the patches of a design stand: stratified over the field, by number.
//!
//! Every possible place of the frame stands in order of its distance from the axis. Patch `n` takes the place at the share
//! `frac(u + nφ)` of their weights, `φ` the golden ratio's fraction: any run of patches is spread over the whole field, and a patch depends
//! on its number alone.

use serde::{Deserialize, Serialize};

use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Region;
use isoplanat_imaging::sensor::noise::mixed;

/// How patches are spread over the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Spread {
    /// Every pixel counts the same.
    #[default]
    Area,
    /// Every step of image height counts the same.
    Height,
}

/// Places at most along a side of the frame.
const ALONG: usize = 256;

/// Patches that settings are chosen by, and their side at most, pixels: converged kernels of large ones take much memory.
pub(in crate::design) const JUDGED: (usize, usize) = (6, 96);

/// The places of patches of one size on a frame.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    size: usize,
    /// First row and column, from the axis outwards.
    starts: Vec<[usize; 2]>,
    /// Share of the weight up to and with each place.
    shares: Vec<f64>,
}

impl Places {
    /// Places of `size × size` patches; rows and columns start at multiples of 4, so that mosaic and pooling meet the picture as in the
    /// camera. A patch may be larger than the frame: it starts at its first row or column then.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub(crate) fn new(frame: &Frame, size: usize, spread: Spread) -> Self {
        let along = |n: usize| {
            let last = n.saturating_sub(size) / 4;
            let step = last.div_ceil(ALONG).max(1);
            (0..=last).step_by(step).map(|k| 4 * k).collect::<Vec<_>>()
        };
        let (rows, cols) = (along(frame.rows), along(frame.columns));
        let half = size as f64 / 2.0;
        let mut places: Vec<(f64, [usize; 2])> = Vec::with_capacity(rows.len() * cols.len());
        for row in &rows {
            for col in &cols {
                places.push((frame.radius_mm(*col as f64 + half, *row as f64 + half), [*row, *col]));
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (first, last) = (places[0].0, places[places.len() - 1].0);
        // Of equal steps of height each has as much weight as the others, shared by the places in it.
        const STEPS: usize = 64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of steps")]
        let step =
            |height: f64| (((height - first) / (last - first).max(1e-12) * STEPS as f64) as usize).min(STEPS - 1);
        let mut counts = [0usize; STEPS];
        places.iter().for_each(|p| counts[step(p.0)] += 1);
        let weight = |height: f64| match spread {
            Spread::Area => 1.0,
            Spread::Height => 1.0 / counts[step(height)] as f64,
        };
        let mut sum = 0.0;
        let mut shares: Vec<f64> = places
            .iter()
            .map(|p| {
                sum += weight(p.0);
                sum
            })
            .collect();
        shares.iter_mut().for_each(|s| *s /= sum);
        Self { size, starts: places.into_iter().map(|p| p.1).collect(), shares }
    }

    /// Place `number` of the draws of `seed`.
    #[expect(clippy::cast_precision_loss, reason = "53 bits of a hash, and fractions")]
    pub(crate) fn at(&self, seed: u64, number: u64) -> Region {
        const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
        // In fixed point, so that large numbers lose nothing.
        let turned = mixed(seed, 0).wrapping_add(number.wrapping_mul(GOLDEN));
        let share = (turned >> 11) as f64 / (1u64 << 53) as f64;
        let k = self.shares.partition_point(|s| *s <= share).min(self.starts.len() - 1);
        let [row, col] = self.starts[k];
        Region { row: row.cast_signed(), col: col.cast_signed(), rows: self.size, cols: self.size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heights(spread: Spread, count: u64) -> (Frame, Vec<f64>) {
        let frame = Frame::centred(960, 640, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let places = Places::new(&frame, 128, spread);
        let height = |n| {
            let r = places.at(7, n);
            assert!(r.row >= 0 && r.col >= 0 && r.row as usize + 128 <= 640 && r.col as usize + 128 <= 960);
            assert!(r.row % 4 == 0 && r.col % 4 == 0);
            frame.radius_mm(r.col as f64 + 64.0, r.row as f64 + 64.0)
        };
        let all = (0..count).map(height).collect();
        (frame, all)
    }

    /// Any twenty patches in a row have one in nearly every twentieth of the field's weight: stratified, not merely random.
    #[test]
    fn patches_are_spread_over_the_field() {
        let (_, all) = heights(Spread::Height, 2000);
        let (low, high) = all.iter().fold((f64::MAX, 0.0f64), |(a, b), h| (a.min(*h), b.max(*h)));
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        assert!((mean - 0.5 * (low + high)).abs() < 0.03 * (high - low), "{mean} of {low} to {high}");
        for run in all.chunks(20) {
            let mut sorted = run.to_vec();
            sorted.sort_by(f64::total_cmp);
            let gap = sorted.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
            assert!(gap < 0.2 * (high - low), "{gap}");
        }
        // Over the area outer fields have more.
        let (_, area) = heights(Spread::Area, 2000);
        assert!(area.iter().sum::<f64>() / area.len() as f64 > mean + 0.02 * (high - low));
    }

    #[test]
    fn a_patch_depends_on_its_number_alone() {
        let frame = Frame::centred(100, 60, 0.02).expect("valid");
        let places = Places::new(&frame, 64, Spread::Area);
        assert_eq!(places.at(3, 1 << 60), places.at(3, 1 << 60));
        assert_ne!((0..9).map(|n| places.at(3, n).col).collect::<Vec<_>>(), vec![0; 9]);
        // Larger than the frame.
        let places = Places::new(&frame, 192, Spread::Height);
        assert_eq!(places.at(3, 5), Region { row: 0, col: 0, rows: 192, cols: 192 });
    }
}
