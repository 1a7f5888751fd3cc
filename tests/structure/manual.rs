//! The pages of the manual.

use std::path::{Path, PathBuf};

/// README, the pages of the manual, and the decisions.
pub(crate) fn pages(root: &Path) -> Vec<PathBuf> {
    let listed = |folder: &str| std::fs::read_dir(root.join(folder)).expect("a manual").flatten().map(|e| e.path());
    let manual = ["docs", "docs/decisions"].into_iter().flat_map(listed);
    let mut pages: Vec<PathBuf> = manual.filter(|p| p.extension().is_some_and(|e| e == "md")).collect();
    pages.sort();
    pages.insert(0, root.join("README.md"));
    pages
}

/// What stands on one.
pub(crate) fn text(page: &Path) -> String {
    std::fs::read_to_string(page).expect("readable")
}
