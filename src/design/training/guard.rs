//! When a training has lost itself: its loss has jumped far above what it was, and stays there.
//!
//! Adam at a rate that is too large for a network may run well for a thousand steps, then throw its weights in a few; clipping
//! gradients does not help, for every step is as long as the rate. What it had is the last checkpoint.

use std::collections::VecDeque;

/// Losses that say what is usual, and the fewest of them.
const SPAN: usize = 101;
const KNOWN: usize = 30;
/// A loss is lost above so many times the usual one: of batches of one patch, losses differ by three times and more.
const LOST: f64 = 8.0;
/// … when so many in a row are.
const ROW: usize = 5;
/// A checkpoint is worth keeping below so many times the usual loss.
const SOUND: f64 = 4.0;

/// Losses of the last steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Guard {
    usual: VecDeque<f64>,
    last: f64,
    above: usize,
}

impl Guard {
    /// Takes a step's loss; whether the training is lost.
    pub(super) fn lost(&mut self, loss: f64) -> bool {
        self.last = loss;
        if self.exceeds(LOST) {
            self.above += 1;
            return self.above >= ROW;
        }
        self.above = 0;
        if loss.is_finite() {
            self.usual.push_back(loss);
            self.usual.drain(..self.usual.len().saturating_sub(SPAN));
        }
        false
    }

    /// Whether weights now are worth going back to.
    pub(super) fn sound(&self) -> bool {
        self.above == 0 && !self.exceeds(SOUND)
    }

    fn exceeds(&self, times: f64) -> bool {
        let mut sorted: Vec<f64> = self.usual.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        // What is not finite is skipped elsewhere.
        sorted.len() >= KNOWN && self.last > times * sorted[sorted.len() / 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches that differ by seven times are usual, one bad patch is none, a jump that stays is found in five steps, and one
    /// right at the beginning is not known to be one.
    #[test]
    fn a_jump_that_stays_is_found() {
        let mut guard = Guard::default();
        assert!((0..20).all(|_| !guard.lost(1e3)));
        let mut guard = Guard::default();
        for k in 0..300 {
            assert!(!guard.lost([0.02, 0.05, 0.14][k % 3]), "{k}");
        }
        assert!(guard.sound());
        assert!(!guard.lost(5.0) && !guard.sound());
        assert!(!guard.lost(0.05) && guard.sound());
        assert!(!guard.lost(0.3) && !guard.sound(), "not lost, and nothing to keep");
        let found: Vec<bool> = (0..5).map(|k| guard.lost(3.0 * 2f64.powi(k))).collect();
        assert_eq!(found, [false, false, false, false, true]);
    }
}
