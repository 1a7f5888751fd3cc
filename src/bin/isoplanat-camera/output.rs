//! Which file a capture's picture goes to, and writing it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use isoplanat::imaging::files::{self, Encoding};
use isoplanat::{Error, Result};
use ndarray::Array3;

/// Quality of JPEG pictures, of 100.
const JPEG_QUALITY: u8 = 95;

/// Output paths for `captures`: beside the working folder's other files, the file or the folder `out`.
///
/// # Errors
/// Two captures with one output, an ending that is no picture format (or too shallow for `linear`), an output that exists
/// (unless `force`) or that is a capture itself.
pub(crate) fn plan(captures: &[PathBuf], out: Option<&Path>, linear: bool, force: bool) -> Result<Vec<PathBuf>> {
    let into_folder = out.is_some_and(|o| captures.len() > 1 || o.is_dir() || ends_with_separator(o));
    let mut planned = Vec::new();
    let mut taken: HashMap<PathBuf, &Path> = HashMap::new();
    for capture in captures {
        let stem = capture.file_stem().unwrap_or(capture.as_os_str());
        let mut name = stem.to_owned();
        name.push(".png");
        let path = match out {
            Some(out) if into_folder => out.join(name),
            Some(out) => out.to_owned(),
            None => PathBuf::from(name),
        };
        check(&path, captures, linear, force)?;
        if let Some(other) = taken.insert(path.clone(), capture) {
            let found =
                format!("{} and {} would both be written to {}", other.display(), capture.display(), path.display());
            return Err(Error::bad("captures", "output", found, "captures with different names"));
        }
        planned.push(path);
    }
    Ok(planned)
}

/// Makes the folder for several captures.
pub(crate) fn make_folder(path: &Path) -> Result<()> {
    match path.parent().filter(|p| !p.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).map_err(|e| Error::writing(folder, e)),
        None => Ok(()),
    }
}

fn check(path: &Path, captures: &[PathBuf], linear: bool, force: bool) -> Result<()> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if !["png", "tif", "tiff", "jpg", "jpeg"].contains(&ending.as_str()) {
        let found = if ending.is_empty() { "no ending".into() } else { format!("`.{ending}`") };
        return Err(Error::bad(path.display().to_string(), "-o", found, ".png, .tif, .tiff, .jpg or .jpeg"));
    }
    if linear && ending.starts_with('j') {
        return Err(Error::bad(path.display().to_string(), "--linear", "JPEG has 8 bits", ".tif or .png"));
    }
    let same = |a: &Path, b: &Path| a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b);
    if captures.iter().any(|c| same(c, path)) {
        return Err(Error::bad(path.display().to_string(), "-o", "is a capture", "another file"));
    }
    if path.is_dir() {
        return Err(Error::bad(path.display().to_string(), "-o", "is a folder", "a file"));
    }
    if path.exists() && !force {
        return Err(Error::Exists(path.to_owned()));
    }
    Ok(())
}

fn ends_with_separator(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}

/// Writes a linear picture in the format its name asks for: PNG with 8 bits (16 if `linear`), TIFF with 16, JPEG.
pub(crate) fn write(path: &Path, image: &Array3<f32>, linear: bool, force: bool) -> Result<()> {
    if path.exists() && !force {
        // It was not there when the program started.
        return Err(Error::Exists(path.to_owned()));
    }
    let encoding = if linear { Encoding::Linear } else { Encoding::Srgb };
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "tif" | "tiff" => files::write_tiff16(path, image, encoding),
        "jpg" | "jpeg" => files::write_jpeg(path, image, JPEG_QUALITY),
        _ if linear => files::write_png16(path, image, encoding),
        _ => files::write_png8(path, image),
    }
}
