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
