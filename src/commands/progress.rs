//! Progress bars on stderr: what runs, how far, how much longer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use isoplanat_program::is_quiet;

/// A bar, and what is left of it at its end.
const UNDER_WAY: &str = "{prefix:28} {bar:30} {percent:>3}% {elapsed} left {eta} {msg}";
const OVER: &str = "{prefix:28} {bar:30} {percent:>3}% {elapsed} {msg}";

/// A bar over shares from 0 to 1.
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// A bar named `what`; hidden where stderr is not a terminal, which then gets one line at start and end.
    pub(crate) fn new(what: &str) -> Self {
        let bar = if is_quiet() { ProgressBar::hidden() } else { ProgressBar::new(1000) };
        bar.set_style(ProgressStyle::with_template(UNDER_WAY).expect("a constant template"));
        bar.set_prefix(what.to_owned());
        if bar.is_hidden() {
            crate::aside!("{what} …");
        }
        Self(bar)
    }

    /// Sets the share done and a short message.
    pub(crate) fn set(&self, share: f64, message: String) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..1000")]
        self.0.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
        self.0.set_message(message);
    }

    /// Ends the bar with a message.
    pub(crate) fn done(self, message: String) {
        if self.0.is_hidden() {
            crate::aside!("{} done in {:.1} s {message}", self.0.prefix(), self.0.elapsed().as_secs_f64());
        }
        self.0.set_style(ProgressStyle::with_template(OVER).expect("a constant template"));
        self.0.finish_with_message(message);
    }
}

/// What runs and for how long, of work that cannot say how far it is: shown on a terminal alone, once it takes more than a moment, and gone at its end.
pub(crate) struct Waiting {
    bar: ProgressBar,
    ended: Arc<AtomicBool>,
}

/// A moment.
const MOMENT: Duration = Duration::from_secs(1);
/// Between two looks at the clock.
const TICK: Duration = Duration::from_millis(200);

impl Waiting {
    /// For work named `what`.
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        bar.set_style(ProgressStyle::with_template("{prefix:28} {spinner} {elapsed}").expect("a constant template"));
        bar.set_prefix(what.to_owned());
        let ended = Arc::new(AtomicBool::new(false));
        let (shown, over) = (bar.clone(), Arc::clone(&ended));
        // Where the system lets no thread be started the work goes on unseen.
        let _ = isoplanat::threads::start(move || {
            std::thread::sleep(MOMENT);
            if !over.load(Ordering::SeqCst) && !is_quiet() {
                shown.set_draw_target(ProgressDrawTarget::stderr());
            }
            while !over.load(Ordering::SeqCst) {
                shown.tick();
                std::thread::sleep(TICK);
            }
            shown.finish_and_clear();
        });
        Self { bar, ended }
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        self.bar.finish_and_clear();
    }
}
