//! What commands write: nothing is overwritten without `--force`, nothing appears half-written.

use std::io::Write;
use std::path::Path;

use isoplanat::{Error, Result};

/// Whether a result may be put at `path`; asked before the work starts.
///
/// # Errors
/// [`Error::Exists`] without `force`; a folder that is not there, or a folder in the file's place.
pub(crate) fn check_writable(path: &Path, force: bool) -> Result<()> {
    let refuse = |kind: std::io::ErrorKind, text: &str| Err(Error::writing(path, std::io::Error::new(kind, text)));
    if path.is_dir() {
        return refuse(std::io::ErrorKind::IsADirectory, "a folder stands there; name a file");
    }
    if path.symlink_metadata().is_ok() && !force {
        return Err(Error::Exists(path.to_owned()));
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            refuse(std::io::ErrorKind::NotFound, &format!("there is no folder {}", folder.display()))
        }
        _ => Ok(()),
    }
}

/// [`check_writable`] of every output that is asked for, each a file of its own.
///
/// # Errors
/// As there; a file named twice.
pub(crate) fn check_all(paths: &[Option<&Path>], force: bool) -> Result<()> {
    let asked: Vec<&Path> = paths.iter().copied().flatten().collect();
    for (k, path) in asked.iter().enumerate() {
        check_writable(path, force)?;
        if asked[..k].contains(path) {
            let file = path.display().to_string();
            return Err(Error::bad(file, "output", "named for two outputs", "a file of its own for each"));
        }
    }
    Ok(())
}

/// Prints `text` to `out`, or puts it into the file at `path`, whole or not at all.
pub(crate) fn put(text: &str, path: Option<&Path>, out: &mut dyn Write) -> anyhow::Result<()> {
    match path {
        Some(path) => Ok(isoplanat::imaging::files::write_bytes(path, text.as_bytes())?),
        None => Ok(out.write_all(text.as_bytes())?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
