//! What commands write: nothing is overwritten without `--force`, nothing appears half-written.

use std::collections::HashSet;
use std::io::Write;
use std::path::Path;

use isoplanat::Result;
use isoplanat::atomic::{self, Target};

/// What every command has that prints a result and writes files.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct Common {
    /// The result as JSON on stdout
    #[arg(long)]
    pub(crate) json: bool,
    /// Replace outputs that exist
    #[arg(long)]
    pub(crate) force: bool,
}

/// Whether a result may be put at `path`; asked before the work starts.
///
/// # Errors
/// As [`atomic::check_target`].
pub(crate) fn check_writable(path: &Path, force: bool) -> Result<()> {
    atomic::check_target(path, force.into())
}

/// [`check_writable`] of every output that is asked for, each a file of its own.
///
/// # Errors
/// As there; a file named twice.
pub(crate) fn check_all(paths: &[Option<&Path>], force: bool) -> Result<()> {
    let asked: Vec<&Path> = paths.iter().copied().flatten().collect();
    asked.iter().try_for_each(|path| check_writable(path, force))?;
    atomic::distinct(&asked)
}

/// Prints `text` to `out`, or puts it into the file at `path`, whole or not at all and with `force` alone in another's place.
pub(crate) fn put(text: &str, path: Option<&Path>, force: bool, out: &mut dyn Write) -> anyhow::Result<()> {
    match path {
        Some(path) => Ok(atomic::write_bytes(Target::new(path, force), text.as_bytes())?),
        None => Ok(out.write_all(text.as_bytes())?),
    }
}

/// Names of files without their endings, each once: a stem that no other has stays, others get the number of their place before them.
///
/// Capitals do not tell two names apart: not every file system does.
pub(crate) fn distinct_stems(stems: &[String]) -> Vec<String> {
    let folded: Vec<String> = stems.iter().map(|s| s.to_lowercase()).collect();
    let alone = |k: usize| folded.iter().filter(|s| **s == folded[k]).count() == 1;
    let mut taken: HashSet<String> = (0..stems.len()).filter(|k| alone(*k)).map(|k| folded[k].clone()).collect();
    let named = |(k, stem): (usize, &String)| {
        let mut name = stem.clone();
        while !alone(k) && (name == *stem || !taken.insert(name.to_lowercase())) {
            name = format!("{:03}-{name}", k + 1);
        }
        name
    };
    stems.iter().enumerate().map(named).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat::Error;

    /// Whatever the names, there are as many files as scenes.
    #[test]
    fn names_are_told_apart() {
        let names = |stems: &[&str]| distinct_stems(&stems.iter().map(ToString::to_string).collect::<Vec<_>>());
        assert_eq!(names(&["a", "b"]), ["a", "b"]);
        assert_eq!(names(&["a", "a", "b"]), ["001-a", "002-a", "b"]);
        assert_eq!(names(&["a", "a", "001-a"]), ["001-001-a", "002-a", "001-a"]);
        assert_eq!(
            names(&["a", "A", "002-a", "002-A", "001-A"]),
            ["001-001-a", "002-A", "003-002-a", "004-002-A", "001-A"]
        );
        let rng = &mut fastrand::Rng::with_seed(3);
        for _ in 0..300 {
            let stems: Vec<String> = (0..12)
                .map(|_| ["", "001-", "002-001-", "012-"][rng.usize(..4)].to_owned() + ["a", "A", "b"][rng.usize(..3)])
                .collect();
            let found = distinct_stems(&stems);
            let different: HashSet<String> = found.iter().map(|n| n.to_lowercase()).collect();
            assert_eq!(different.len(), 12, "{stems:?} {found:?}");
            assert!(found.iter().zip(&stems).all(|(n, s)| n.ends_with(s.as_str())));
        }
    }

    #[test]
    fn existing_files_need_force_and_folders_must_exist() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.npz");
        assert!(check_writable(&file, false).is_ok());
        std::fs::write(&file, b"old").expect("writes");
        assert!(matches!(check_writable(&file, false), Err(Error::Exists(_))));
        assert!(check_writable(&file, true).is_ok());
        assert!(check_writable(folder.path(), true).expect_err("a folder").to_string().contains("folder"));
        let nowhere = folder.path().join("none/a.npz");
        assert!(check_writable(&nowhere, true).expect_err("no folder").to_string().contains("none"));
        assert!(check_writable(Path::new("surely-not-there.npz"), false).is_ok());
        let [a, b] = ["surely-not-there.csv", "surely-not-there.svg"].map(|p| Some(Path::new(p)));
        assert!(check_all(&[a, None, b], false).is_ok());
        assert!(check_all(&[a, b, a], true).expect_err("twice").to_string().contains("two outputs"));
    }
}
