//! What is shown now, and the news that it is another.

use std::sync::Arc;

use tokio::sync::watch;

/// What keeps the page up to date in a browser.
pub(super) const LIVE: &str = include_str!("live.js");

/// What the server shows.
#[derive(Debug)]
pub(super) struct Shown {
    /// Counts all changes.
    pub(super) version: u64,
    /// The page with what keeps it up to date, as it is sent.
    pub(super) page: Arc<[u8]>,
    /// The version that brought the page.
    pub(super) page_version: u64,
    /// Why the file as it is now is not shown.
    pub(super) error: Option<String>,
}

/// The shown page; whoever follows it learns that it is another.
#[derive(Debug)]
pub(super) struct Board(watch::Sender<Shown>);

impl Board {
    /// A board that shows `page`.
    pub(super) fn new(page: &str) -> Self {
        let first = Shown { version: 1, page: live(page, 1), page_version: 1, error: None };
        Self(watch::Sender::new(first))
    }

    /// Shows a page, or why there is none; `after` a version only while that is shown still. The new version, if it was changed: the same reason again is
    /// no change.
    pub(super) fn put(&self, made: Result<&str, &str>, after: Option<u64>) -> Option<u64> {
        let mut new = None;
        self.0.send_if_modified(|shown| {
            let late = after.is_some_and(|version| version != shown.version);
            if late || made.is_err_and(|reason| shown.error.as_deref() == Some(reason)) {
                return false;
            }
            shown.version += 1;
            new = Some(shown.version);
            match made {
                Ok(page) => {
                    (shown.page, shown.page_version) = (live(page, shown.version), shown.version);
                    shown.error = None;
                }
                Err(reason) => shown.error = Some(reason.to_owned()),
            }
            true
        });
        new
    }

    /// Whether `version` is still shown.
    pub(super) fn shows(&self, version: u64) -> bool {
        self.0.borrow().version == version
    }

    /// The page as it is sent.
    pub(super) fn page(&self) -> Arc<[u8]> {
        Arc::clone(&self.0.borrow().page)
    }

    /// What is shown, and the wait for another.
    pub(super) fn follow(&self) -> watch::Receiver<Shown> {
        self.0.subscribe()
    }
}

/// The page with what keeps it up to date, and which page it is.
fn live(page: &str, version: u64) -> Arc<[u8]> {
    let head = format!("<meta name=\"isoplanat-page\" content=\"{version}\">\n<script>{LIVE}</script>\n</head>");
    page.replacen("</head>", &head, 1).into_bytes().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_counts_once_and_never_after_a_newer_one() {
        let board = Board::new("<head></head>one");
        let news = board.follow();
        assert_eq!(board.put(Ok("<head></head>two"), Some(7)), None, "not what is shown");
        assert_eq!(board.put(Err("no lens"), None), Some(2));
        assert_eq!(board.put(Err("no lens"), None), None, "said already");
        let text = |board: &Board| String::from_utf8(board.page().to_vec()).expect("UTF-8");
        assert!(text(&board).ends_with("one") && text(&board).contains("content=\"1\""), "the last good page");
        assert_eq!(board.put(Ok("<head></head>two"), Some(2)), Some(3));
        assert!(text(&board).ends_with("two") && text(&board).contains("content=\"3\"") && board.shows(3));
        assert!(news.has_changed().expect("open") && news.borrow().error.is_none());
    }
}
