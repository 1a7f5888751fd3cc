//! How a run goes on: step by step, with checkpoints, until it is over, cannot go on, or somebody asks for an end. Designs and trainings go this way.

use std::time::Instant;

use isoplanat_base::error::{Error, Result};

/// Steps in a row without a finite loss and gradient after which a run stops.
const MOST_SKIPPED: u64 = 20;

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stepped {
    /// It moved something.
    Moved,
    /// It moved nothing: the loss or its gradient was not finite.
    Skipped,
    /// It went back to the last checkpoint.
    Returned,
}

/// A run's work, one step after the other, in a folder that holds its last checkpoint.
pub(super) trait Work {
    /// One step, with all that is logged and shown of it; nothing when the run is over.
    ///
    /// # Errors
    /// Where it cannot go on.
    fn step(&mut self) -> Result<Option<Stepped>>;

    /// Steps done.
    fn steps(&self) -> u64;

    /// Whether what it has now is worth keeping.
    fn sound(&self) -> bool {
        true
    }

    /// Writes a checkpoint.
    ///
    /// # Errors
    /// What the disk says.
    fn checkpoint(&mut self) -> Result<()>;

    /// What is said where it cannot go on; the folder holds its last good state.
    fn stopped(&mut self, why: &str) -> Error;
}

/// Takes `work` to its end, with a checkpoint every `seconds` and at the end. `watch` sees it after every step; where it returns `false` a
/// checkpoint is written, if there is anything sound, and the run ends with [`Error::Interrupted`].
///
/// # Errors
/// What a step or the disk says; [`Work::stopped`] where too many steps in a row, or all of them, moved nothing.
pub(super) fn run_to_end<W: Work>(work: &mut W, seconds: f64, watch: &mut dyn FnMut(&mut W) -> bool) -> Result<()> {
    let mut saved = Instant::now();
    let mut skipped = 0;
    while let Some(stepped) = work.step()? {
        match stepped {
            Stepped::Moved => skipped = 0,
            Stepped::Skipped => skipped += 1,
            Stepped::Returned => {
                (skipped, saved) = (0, Instant::now());
                continue;
            }
        }
        if skipped >= MOST_SKIPPED {
            return Err(work.stopped(&format!("the loss or its gradient was not finite {MOST_SKIPPED} times in a row")));
        }
        if !watch(work) {
            if work.sound() {
                work.checkpoint()?;
            }
            return Err(Error::Interrupted);
        }
        if saved.elapsed().as_secs_f64() >= seconds && work.sound() {
            work.checkpoint()?;
            saved = Instant::now();
        }
    }
    if skipped > 0 && skipped == work.steps() {
        return Err(work.stopped("the loss or its gradient was finite in none of its steps"));
    }
    work.checkpoint()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps that were written down beforehand, and what was made of them.
    #[derive(Default)]
    struct Told {
        steps: Vec<Stepped>,
        done: usize,
        kept: Vec<usize>,
        unsound: bool,
    }

    impl Work for Told {
        fn step(&mut self) -> Result<Option<Stepped>> {
            let step = self.steps.get(self.done).copied();
            self.done += usize::from(step.is_some());
            Ok(step)
        }
        fn steps(&self) -> u64 {
            self.done as u64
        }
        fn sound(&self) -> bool {
            !self.unsound
        }
        fn checkpoint(&mut self) -> Result<()> {
            self.kept.push(self.done);
            Ok(())
        }
        fn stopped(&mut self, why: &str) -> Error {
            Error::Stopped(why.into())
        }
    }

    /// The work after its end, and that end; somebody asks for one after step `until`.
    fn done(work: Told, seconds: f64, until: usize) -> (Told, std::result::Result<(), String>) {
        let mut work = work;
        let end = run_to_end(&mut work, seconds, &mut |w| w.done < until).map_err(|e| e.to_string());
        (work, end)
    }

    #[test]
    fn a_run_keeps_what_is_sound_and_says_when_nothing_moves() {
        let of = |steps: &[(Stepped, usize)]| {
            let steps = steps.iter().flat_map(|(step, n)| std::iter::repeat_n(*step, *n)).collect();
            Told { steps, ..Told::default() }
        };
        let (moved, skipped) = (Stepped::Moved, Stepped::Skipped);
        let (work, end) = done(of(&[(moved, 5)]), 1e9, 99);
        assert_eq!((work.kept, end), (vec![5], Ok(())));
        assert_eq!(done(of(&[(moved, 3)]), 0.0, 99).0.kept, [1, 2, 3, 3]);
        // An end that is asked for is kept, unless nothing is sound.
        let (work, end) = done(of(&[(moved, 5)]), 1e9, 2);
        assert_eq!((work.kept, end), (vec![2], Err(Error::Interrupted.to_string())));
        let (work, end) = done(Told { unsound: true, ..of(&[(moved, 5)]) }, 0.0, 2);
        assert!(work.kept.is_empty() && end.is_err());
        // Twenty in a row, not twenty in all; a return begins anew; nothing is kept of what went wrong.
        assert_eq!(done(of(&[(moved, 1), (skipped, 19), (moved, 1), (skipped, 19)]), 1e9, 99).1, Ok(()));
        let back = [(moved, 1), (skipped, 19), (Stepped::Returned, 1), (skipped, 19), (moved, 1)];
        assert_eq!(done(of(&back), 1e9, 99).1, Ok(()));
        let (work, end) = done(of(&[(moved, 1), (skipped, 30)]), 1e9, 99);
        assert!(end.is_err_and(|e| e.contains("20 times in a row")) && work.done == 21 && work.kept.is_empty());
        // A run too short for that.
        let (work, end) = done(of(&[(skipped, 3)]), 1e9, 99);
        assert!(end.is_err_and(|e| e.contains("none of its steps")) && work.kept.is_empty());
        assert_eq!(done(of(&[(skipped, 2), (moved, 1)]), 1e9, 99).1, Ok(()));
    }
}
