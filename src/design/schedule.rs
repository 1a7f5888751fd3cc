//! The learning rate over a training: a rise where asked for, constant, then linearly to zero.
//!
//! A length in time is turned into one in steps once, when the constant part is over: the rest gets as many steps as its time
//! holds at the pace of the last ones. From then on everything repeats.

/// Learning rate over the steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// The constant rate.
    pub rate: f64,
    /// Steps in which it rises to the constant rate.
    pub rise: u64,
    /// Share of the length at the constant rate, the rise included, 0 to 1.
    pub share: f64,
    /// How long.
    pub length: Length,
    /// Steps of the constant part and in all, once it is over and the length is one in time.
    pub settled: Option<[u64; 2]>,
}

/// The length of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// In steps.
    Steps(u64),
    /// In seconds.
    Seconds(f64),
}

impl Schedule {
    /// Ends the constant part of a length in time when its time has come; `true` at that moment. `pace`: seconds a step takes.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "steps are below 1e13")]
    pub(crate) fn settle(&mut self, step: u64, seconds: f64, pace: f64) -> bool {
        let Length::Seconds(all) = self.length else { return false };
        let over = self.settled.is_none() && seconds >= self.share * all && step > 0;
        if over {
            let rest = ((all - seconds).max(0.0) / pace.max(1e-6)).round().min(1e12);
            self.settled = Some([step, step + rest as u64]);
        }
        over
    }

    /// Steps at the constant rate, and in all; unknown while the constant part of a length in time runs.
    fn steps(&self) -> Option<(f64, u64)> {
        match (self.length, self.settled) {
            (Length::Steps(n), _) => Some((self.share * n as f64, n)),
            (Length::Seconds(_), Some([constant, all])) => Some((constant as f64, all)),
            (Length::Seconds(_), None) => None,
        }
    }

    /// The rate of step `step` (counted from 0); `None` when the training is over.
    pub fn at(&self, step: u64) -> Option<f64> {
        let risen = ((step + 1) as f64 / (self.rise + 1) as f64).min(1.0);
        match self.steps() {
            Some((_, all)) if step >= all => None,
            Some((constant, all)) => {
                let fallen = (step as f64 - constant) / (all as f64 - constant).max(1.0);
                Some(self.rate * risen * (1.0 - fallen.clamp(0.0, 1.0)))
            }
            None => Some(self.rate * risen),
        }
    }

    /// Share done, 0 to 1.
    pub(crate) fn done(&self, step: u64, seconds: f64) -> f64 {
        match (self.steps(), self.length) {
            (Some((_, all)), _) => step as f64 / all.max(1) as f64,
            (None, Length::Seconds(all)) => seconds / all,
            (None, Length::Steps(_)) => 0.0,
        }
        .clamp(0.0, 1.0)
    }

    /// Steps in all, where known.
    pub fn total(&self) -> Option<u64> {
        self.steps().map(|s| s.1)
    }
}

/// A rise over the first 3 %, while both of Adam's averages are young and the lens must not be thrown, then a half cosine to zero.
pub(in crate::design) fn rise_and_fall(used: f64) -> f64 {
    let rise = ((used + 1e-3) / 0.031).min(1.0);
    rise * 0.5 * (1.0 + (std::f64::consts::PI * used.clamp(0.0, 1.0)).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_in_time_becomes_one_in_steps() {
        let mut s = Schedule { rate: 1.0, rise: 0, share: 1.0 / 3.0, length: Length::Seconds(90.0), settled: None };
        assert_eq!((s.at(1000), s.total()), (Some(1.0), None));
        assert!(!s.settle(10, 29.0, 2.5));
        assert!((s.done(10, 29.0) - 29.0 / 90.0).abs() < 1e-12);
        assert!(s.settle(12, 30.0, 2.5) && !s.settle(13, 33.0, 1.0));
        assert_eq!(s.total(), Some(36));
        assert_eq!(s.at(12), Some(1.0));
        assert_eq!(s.at(24), Some(0.5));
        assert_eq!(s.at(36), None);
        assert!((s.done(18, 0.0) - 0.5).abs() < 1e-12);
        // A first step longer than everything ends it.
        let mut s = Schedule { settled: None, ..s };
        assert!(s.settle(1, 100.0, 100.0));
        assert_eq!((s.total(), s.at(1)), (Some(1), None));
    }

    #[test]
    fn the_rate_falls_to_zero_and_never_below() {
        for share in [0.0, 1.0 / 3.0, 0.9, 1.0] {
            let s = Schedule { rate: 2.0, rise: 0, share, length: Length::Steps(30), settled: None };
            let rates: Vec<f64> = (0..30).map(|k| s.at(k).expect("not over")).collect();
            assert_eq!(rates[0], 2.0);
            assert!(rates.windows(2).all(|w| w[1] <= w[0]) && rates[29] > 0.0, "{share}: {rates:?}");
            assert_eq!(s.at(30), None);
            let s = Schedule { rise: 4, ..s };
            let risen: Vec<f64> = (0..30).map(|k| s.at(k).expect("not over")).collect();
            assert!(
                (0..4).all(|k| (risen[k] - rates[k] * (k + 1) as f64 / 5.0).abs() < 1e-12) && risen[4..] == rates[4..]
            );
        }
    }
}
