//! Progress bars on stderr: what runs, how far, how much longer.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over shares from 0 to 1.
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// A bar named `what`; hidden where stderr is not a terminal, which then gets one line at start and end.
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::new(1000);
        let style = ProgressStyle::with_template("{prefix:28} {bar:30} {percent:>3}% {elapsed} left {eta} {msg}")
            .expect("a constant template");
        bar.set_style(style);
        bar.set_prefix(what.to_owned());
        if bar.is_hidden() {
            crate::tell!("{what} …");
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
            crate::tell!("{} done in {:.1} s {message}", self.0.prefix(), self.0.elapsed().as_secs_f64());
        }
        self.0.finish_with_message(message);
    }
}
