//! Which entries of a folder are a result's own: those on the list that was written with it, and those of names that its kind has.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Replace, fault, name, of_schema, read_text};
use crate::error::{Error, Result};

/// The file in each published folder that lists what was published in it: paths from the folder, `/` between names, other than UTF-8 and
/// `%` as `%` and two hexadecimal digits.
pub const MANIFEST: &str = ".isoplanat-entries";

/// The form's number.
const SCHEMA: u32 = 1;
/// Bytes of the largest list that is read: some 500,000 entries.
const LARGEST: u64 = 64 << 20;
/// Foreign entries that a refusal names.
const NAMED: usize = 3;
/// What file managers leave in any folder.
const DESKTOP: [&str; 3] = [".DS_Store", "Thumbs.db", "desktop.ini"];

/// A kind of folder: what makes it one, and what else belongs to it.
#[derive(Debug, Clone, Copy)]
pub struct FolderKind<'a> {
    /// The file that makes a folder one of this kind.
    marker: &'a str,
    /// Names of entries; none: the list alone, and without a list (older versions) everything.
    entries: Option<&'a [&'a str]>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    schema: u32,
    entries: BTreeSet<String>,
}

impl<'a> FolderKind<'a> {
    /// The kind of folders with the file `marker` whose entries are those on the list that was published with them; without a list, as
    /// older versions wrote them, all entries.
    pub const fn listed(marker: &'a str) -> Self {
        Self { marker, entries: None }
    }

    /// The kind of folders with the file `marker` that also hold `entries`, which came later or before there were lists: paths from the
    /// folder, in which `*` stands for any part of a name and a last `/**` for all that is in a folder.
    pub const fn new(marker: &'a str, entries: &'a [&'a str]) -> Self {
        Self { marker, entries: Some(entries) }
    }

    /// Whether a folder of this kind may be put at `target`, which `folder` leads to: nothing stands there, or a folder without entries, or
    /// what `replace` lets give way.
    ///
    /// # Errors
    /// [`Error::Exists`]; entries that are not of this kind.
    pub(super) fn allows(&self, folder: &Path, target: &Path, replace: Replace) -> Result<()> {
        if target.symlink_metadata().is_err() {
            return Ok(());
        }
        if is_empty(target) {
            // Whoever stands in it would stand in a folder that is gone.
            let here = std::env::current_dir().and_then(|here| here.canonicalize());
            if here.is_ok_and(|here| target.canonicalize().is_ok_and(|t| t == here)) {
                let found = "the folder that the program was started in";
                return Err(Error::bad(
                    folder.display().to_string(),
                    "output",
                    found,
                    "a folder inside it, or another name",
                ));
            }
            return Ok(());
        }
        if replace == Replace::Never {
            return Err(Error::Exists(folder.to_owned()));
        }
        if !target.join(self.marker).is_file() {
            let found = format!("a folder without {}: of another kind, and not replaced", self.marker);
            return Err(Error::bad(folder.display().to_string(), "output", found, "another name"));
        }
        let foreign = self.foreign(target)?;
        if foreign.is_empty() {
            return Ok(());
        }
        let more = foreign.len().saturating_sub(NAMED);
        let named: Vec<String> = foreign.iter().take(NAMED).map(|e| e.escape_debug().to_string()).collect();
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let found = format!("{}{more}: not of the result that would be replaced", named.join(", "));
        let allowed = "a folder with nothing else in it; move them away or name another output";
        Err(Error::bad(folder.display().to_string(), "entries", found, allowed))
    }

    /// The entries that are not of this kind.
    fn foreign(&self, target: &Path) -> Result<Vec<String>> {
        let listed = list(target)?;
        let patterns = match (self.entries, &listed) {
            (None, None) => return Ok(Vec::new()),
            (entries, _) => entries.unwrap_or_default(),
        };
        let listed = listed.unwrap_or_default();
        let ours = |path: &str| {
            path == self.marker || path == MANIFEST || listed.contains(path) || patterns.iter().any(|p| fits(p, path))
        };
        let mut foreign = Vec::new();
        let tree = Tree::of(target, &|path| patterns.iter().any(|p| p.ends_with("/**") && fits(p, path)))?;
        for (path, _) in tree.files.iter().chain(&tree.empty) {
            // What a killed writer within the folder has left is of its making, too.
            let passing = |n: &str| DESKTOP.contains(&n) || name::is_temporary(OsStr::new(n));
            if !path.split('/').any(passing) && !ours(path) {
                foreign.push(path.clone());
            }
        }
        foreign.sort_unstable();
        Ok(foreign)
    }
}

/// Whether `target` is a folder without any entry: whoever made it for a result loses nothing by it.
pub(super) fn is_empty(target: &Path) -> bool {
    fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_none())
}

/// Writes the list of what is in `folder` into it, and tells what has to reach the disk: files, and folders from the top. What a writer within it could not take
/// away behind itself is no part of the result: it is removed, and not listed where that fails again.
pub(super) fn record(folder: &Path) -> Result<(Vec<PathBuf>, Vec<PathBuf>)> {
    let mut tree = Tree::of(folder, &|_| false)?;
    tree.files.retain(|(_, path)| {
        let left = path.file_name().is_some_and(name::is_temporary);
        if left {
            let _ = fs::remove_file(path);
        }
        !left
    });
    let keys = tree.files.iter().chain(&tree.empty).map(|(path, _)| path.clone());
    let entries = keys.filter(|path| path != MANIFEST).collect();
    let text = toml::to_string(&List { schema: SCHEMA, entries }).map_err(|e| Error::Internal(e.to_string()))?;
    let path = folder.join(MANIFEST);
    let written = fault::at("list").and_then(|()| File::create(&path)?.write_all(text.as_bytes()));
    written.map_err(|e| Error::writing(&path, e))?;
    let regular = |p: &PathBuf| p.symlink_metadata().is_ok_and(|m| m.is_file());
    let mut files: Vec<PathBuf> = tree.files.into_iter().map(|(_, p)| p).filter(regular).collect();
    if !files.contains(&path) {
        files.push(path);
    }
    Ok((files, tree.folders))
}

/// Whether the file `path` is on the list that was published with `folder`; both without links.
pub(super) fn published(folder: &Path, path: &Path) -> Result<bool> {
    let Ok(within) = path.strip_prefix(folder) else { return Ok(false) };
    let names: Vec<String> = within.iter().map(|name| escaped(name.as_encoded_bytes())).collect();
    Ok(list(folder)?.is_some_and(|listed| listed.contains(&names.join("/"))))
}

/// The list of a published folder; `None`: it has none.
fn list(folder: &Path) -> Result<Option<BTreeSet<String>>> {
    let path = folder.join(MANIFEST);
    if path.symlink_metadata().is_err() {
        return Ok(None);
    }
    let list: List = of_schema(&read_text(&path, LARGEST)?, &path.display().to_string(), SCHEMA, "schema, entries")?;
    Ok(Some(list.entries))
}

/// What is in a folder at all depths; links are entries and not followed.
#[derive(Default)]
struct Tree {
    /// All but folders: path as the list has it, path on the disk.
    files: Vec<(String, PathBuf)>,
    /// Folders with nothing in them.
    empty: Vec<(String, PathBuf)>,
    /// All folders, each before those in it; the first is the folder itself.
    folders: Vec<PathBuf>,
}

impl Tree {
    /// The tree of `top` without folders for which `skipped` holds.
    fn of(top: &Path, skipped: &dyn Fn(&str) -> bool) -> Result<Self> {
        let mut tree = Self::default();
        let mut open = vec![(String::new(), top.to_owned())];
        while let Some((above, folder)) = open.pop() {
            let failed = |e| Error::reading(&folder, e);
            let mut any = false;
            for entry in fs::read_dir(&folder).map_err(failed)? {
                let entry = entry.map_err(failed)?;
                any = true;
                let key = format!("{above}{}", escaped(entry.file_name().as_encoded_bytes()));
                if !entry.file_type().map_err(failed)?.is_dir() {
                    tree.files.push((key, entry.path()));
                } else if !skipped(&key) {
                    open.push((key + "/", entry.path()));
                }
            }
            if !any && !above.is_empty() {
                tree.empty.push((above.trim_end_matches('/').to_owned(), folder.clone()));
            }
            tree.folders.push(folder);
        }
        Ok(tree)
    }
}

/// A name as text from which it can be had again.
fn escaped(name: &[u8]) -> String {
    let mut text = String::with_capacity(name.len());
    for chunk in name.utf8_chunks() {
        text += &chunk.valid().replace('%', "%25");
        chunk.invalid().iter().for_each(|byte| text += &format!("%{byte:02X}"));
    }
    text
}

/// Whether `path` fits `pattern`, name by name.
fn fits(pattern: &str, path: &str) -> bool {
    if let Some(folder) = pattern.strip_suffix("/**") {
        let depth = folder.split('/').count();
        let mut names = path.split('/');
        return folder.split('/').all(|p| names.next().is_some_and(|n| name_fits(p, n))) && depth > 0;
    }
    let (patterns, names) = (pattern.split('/'), path.split('/'));
    patterns.clone().count() == names.clone().count() && patterns.zip(names).all(|(p, n)| name_fits(p, n))
}

/// Whether a name fits a pattern in which `*` stands for any part.
fn name_fits(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return pattern == name };
    let Some(name) = name.strip_prefix(first) else { return false };
    let (between, last) = rest.rsplit_once('*').unwrap_or(("", rest));
    let Some(mut name) = name.strip_suffix(last) else { return false };
    between.split('*').filter(|p| !p.is_empty()).all(|part| match name.split_once(part) {
        Some((_, after)) => {
            name = after;
            true
        }
        None => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_go_name_by_name() {
        let cases = [
            ("a.csv", "a.csv", true),
            ("a.csv", "b/a.csv", false),
            ("*.csv", "a.csv", true),
            ("*.csv", "b/a.csv", false),
            ("zone-*-*.png", "zone-1-20.png", true),
            ("zone-*-*.png", "zone-1.png", false),
            ("a*a", "a", false),
            ("*ab*ab", "xabab", true),
            ("*ab*ab", "xab", false),
            ("checkpoints/**", "checkpoints", true),
            ("checkpoints/**", "checkpoints/a/b", true),
            ("checkpoints/**", "checkpoints2", false),
            ("stage-*/**", "stage-1/x", true),
            ("stage-*/**", "stages/x", false),
            ("stage-*/lens.toml", "stage-1/lens.toml", true),
            ("*", "notes.txt", true),
        ];
        for (pattern, path, wanted) in cases {
            assert_eq!(fits(pattern, path), wanted, "{pattern} {path}");
        }
    }

    #[test]
    fn names_of_any_bytes_stay_apart() {
        assert_eq!(escaped(b"a\xff%.png"), "a%FF%25.png");
        assert_ne!(escaped(b"a\xff"), escaped(b"a\xfe"));
        assert_ne!(escaped(b"a%FF"), escaped(b"a\xff"));
    }
}
