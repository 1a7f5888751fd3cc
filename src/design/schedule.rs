//! The learning rate over a training: constant, then linearly to zero.
//!
//! A length in time is turned into one in steps once, when the constant part is over: its steps are counted, and the rest gets
//! as many as its share asks for. From then on everything repeats.

/// Learning rate over the steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// The constant rate.
    pub rate: f64,
    /// Share of the length at the constant rate, 0 to 1.
    pub share: f64,
    /// How long.
    pub length: Length,
    /// Steps of the constant part, once it is over and the length is one in time.
    pub constant: Option<u64>,
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
    /// Ends the constant part of a length in time when its time has come; `true` at that moment.
    pub fn settle(&mut self, step: u64, seconds: f64) -> bool {
        let Length::Seconds(all) = self.length else { return false };
        let over = self.constant.is_none() && seconds >= self.share * all && step > 0;
        if over {
            self.constant = Some(step);
        }
        over
    }

    /// Steps at the constant rate, and in all; unknown while the constant part of a length in time runs.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "steps are below 1e13")]
    fn steps(&self) -> Option<(f64, u64)> {
        match (self.length, self.constant) {
            (Length::Steps(n), _) => Some((self.share * n as f64, n)),
            (Length::Seconds(all), Some(constant)) => {
                // Without a constant part one step stands for its pace.
                let share = if self.share > 0.0 { self.share } else { 1.0 / all.max(1.0) };
                Some((constant as f64, (constant as f64 / share).ceil() as u64))
            }
            (Length::Seconds(_), None) => None,
        }
    }

    /// The rate of step `step` (counted from 0), `seconds` after the beginning; `None` when the training is over.
    pub fn at(&self, step: u64, seconds: f64) -> Option<f64> {
        match self.steps() {
            Some((_, all)) if step >= all => None,
            Some((constant, all)) => {
                let fallen = (step as f64 - constant) / (all as f64 - constant).max(1.0);
                Some(self.rate * (1.0 - fallen.clamp(0.0, 1.0)))
            }
            None => {
                debug_assert!(seconds >= 0.0);
                Some(self.rate)
            }
        }
    }

    /// Share done, 0 to 1.
    pub fn done(&self, step: u64, seconds: f64) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_in_time_becomes_one_in_steps() {
        let mut s = Schedule { rate: 1.0, share: 1.0 / 3.0, length: Length::Seconds(90.0), constant: None };
        assert_eq!((s.at(1000, 29.0), s.total()), (Some(1.0), None));
        assert!(!s.settle(10, 29.0));
        assert!((s.done(10, 29.0) - 29.0 / 90.0).abs() < 1e-12);
        assert!(s.settle(12, 30.5) && !s.settle(13, 33.0));
        assert_eq!(s.total(), Some(36));
        assert_eq!(s.at(12, 1e9), Some(1.0));
        assert_eq!(s.at(24, 0.0), Some(0.5));
        assert_eq!(s.at(36, 0.0), None);
        assert!((s.done(18, 0.0) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn the_rate_falls_to_zero_and_never_below() {
        for share in [0.0, 1.0 / 3.0, 0.9, 1.0] {
            let s = Schedule { rate: 2.0, share, length: Length::Steps(30), constant: None };
            let rates: Vec<f64> = (0..30).map(|k| s.at(k, 0.0).expect("not over")).collect();
            assert_eq!(rates[0], 2.0);
            assert!(rates.windows(2).all(|w| w[1] <= w[0]) && rates[29] > 0.0, "{share}: {rates:?}");
            assert_eq!(s.at(30, 0.0), None);
        }
    }
}
