//! Which file a capture's picture goes to, and writing it.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use isoplanat::deploy::raw::has_raw_name;
use isoplanat::deploy::reconstruct::Picture;
use isoplanat::imaging::exif::{Directory, Value, tags};
use isoplanat::imaging::files::{self, Annotation, Encoding, extension};
use isoplanat::imaging::sensor::dng::{DngInfo, write_linear_dng};
use isoplanat::{Error, Result};

use crate::command::{Arguments, Format};

/// Captures named, and those in folders named, by name; files of other kinds in a folder are left alone.
///
/// # Errors
/// A folder that cannot be read, or has no capture.
pub(crate) fn captures(named: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).map_err(|e| Error::reading(path, e))?;
        let mut within: Vec<PathBuf> =
            entries.flatten().map(|e| e.path()).filter(|p| p.is_file() && is_capture(p)).collect();
        within.sort();
        if within.is_empty() {
            return Err(Error::bad(
                path.display().to_string(),
                "captures",
                "no RAW file in it",
                "a folder of captures",
            ));
        }
        all.append(&mut within);
    }
    Ok(all)
}

/// Whether a file of a folder is taken for a capture: named as RAW files are, and not hidden (macOS puts `._NAME` beside them).
pub(crate) fn is_capture(path: &Path) -> bool {
    has_raw_name(path) && !path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'))
}

/// A capture's name without its ending.
pub(crate) fn stem(capture: &Path) -> OsString {
    capture.file_stem().unwrap_or(capture.as_os_str()).to_owned()
}

/// What the picture of a capture is called.
pub(crate) fn named(stem: impl AsRef<OsStr>, format: Option<Format>) -> OsString {
    let mut name = stem.as_ref().to_owned();
    name.push(".");
    name.push(format.unwrap_or(Format::Png).ending());
    name
}

/// Output paths for `captures`: beside the working folder's other files, the file or the folder `out`.
///
/// # Errors
/// Two captures with one output, an ending that is no picture format (or too shallow for linear light), an output that exists
/// (unless forced) or that is a capture itself.
pub(crate) fn plan(captures: &[PathBuf], arguments: &Arguments) -> Result<Vec<PathBuf>> {
    let out = arguments.out.as_deref();
    let folders = arguments.captures.iter().any(|c| c.is_dir());
    let into_folder = out.is_some_and(|o| captures.len() > 1 || folders || o.is_dir() || ends_with_separator(o));
    if let Some(out) = out.filter(|o| folders && !o.is_dir() && is_picture(o) && !ends_with_separator(o)) {
        let found = "the name of one picture, for a folder of captures";
        return Err(Error::bad(
            out.display().to_string(),
            "-o",
            found,
            "a folder; --format says what is written into it",
        ));
    }
    let mut planned = Vec::new();
    let mut taken: HashMap<PathBuf, &Path> = HashMap::new();
    for capture in captures {
        let name = named(stem(capture), arguments.format);
        let path = match out {
            Some(out) if into_folder => out.join(name),
            Some(out) => {
                if let Some(format) = arguments.format.filter(|f| !f.endings().contains(&extension(out).as_str())) {
                    let found = format!("`{}` where -o names the file", format.ending());
                    return Err(Error::bad(out.display().to_string(), "--format", found, "one of both"));
                }
                out.to_owned()
            }
            None => PathBuf::from(name),
        };
        check(&path, captures, arguments)?;
        if let Some(other) = taken.insert(path.clone(), capture) {
            return Err(both(other, capture, &path));
        }
        planned.push(path);
    }
    Ok(planned)
}

/// What is said of two captures with one picture.
pub(crate) fn both(one: &Path, other: &Path, picture: &Path) -> Error {
    let found = format!("{} and {} would both be written to {}", one.display(), other.display(), picture.display());
    Error::bad("captures", "output", found, "captures with different names")
}

/// Whether a name is that of a DNG.
pub(crate) fn is_dng(path: &Path) -> bool {
    extension(path) == "dng"
}

/// Whether a name is that of a picture.
fn is_picture(path: &Path) -> bool {
    let ending = extension(path);
    Format::ALL.iter().any(|f| f.endings().contains(&ending.as_str()))
}

/// Whether a picture of this name can be what is asked for.
pub(crate) fn check_format(path: &Path, arguments: &Arguments) -> Result<()> {
    let refuse =
        |place: &str, found: String, allowed: &str| Err(Error::bad(path.display().to_string(), place, found, allowed));
    let ending = extension(path);
    if !is_picture(path) {
        let found = if ending.is_empty() { "no ending".into() } else { format!("`.{ending}`") };
        return refuse("-o", found, ".png, .tif, .tiff, .jpg, .jpeg or .dng");
    }
    match ending.as_str() {
        "jpg" | "jpeg" if arguments.linear => refuse("--linear", "JPEG has 8 bits".into(), ".tif or .png"),
        "dng" if arguments.linear => {
            refuse("--linear", "a DNG is linear already".into(), "no --linear, or .tif or .png")
        }
        _ => Ok(()),
    }
}

/// Makes the folder for several captures.
pub(crate) fn make_folder(path: &Path) -> Result<()> {
    match path.parent().filter(|p| !p.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).map_err(|e| Error::writing(folder, e)),
        None => Ok(()),
    }
}

/// Whether a picture may be written to a path.
///
/// # Errors
/// As [`plan`].
pub(crate) fn check(path: &Path, captures: &[PathBuf], arguments: &Arguments) -> Result<()> {
    check_format(path, arguments)?;
    let same = |a: &Path, b: &Path| a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b);
    if captures.iter().any(|c| same(c, path)) {
        return Err(Error::bad(path.display().to_string(), "-o", "is a capture", "another file"));
    }
    if path.is_dir() {
        return Err(Error::bad(path.display().to_string(), "-o", "is a folder", "a file"));
    }
    if path.exists() && !arguments.force {
        return Err(Error::Exists(path.to_owned()));
    }
    Ok(())
}

fn ends_with_separator(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}

/// Writes a picture in the format its name asks for: PNG with 8 bits (16 if linear), TIFF and DNG with 16, JPEG; colours and the exposure's facts beside
/// the pixels.
pub(crate) fn write(path: &Path, picture: &Picture, arguments: &Arguments) -> Result<()> {
    if path.exists() && !arguments.force {
        // It was not there when the program started.
        return Err(Error::Exists(path.to_owned()));
    }
    let software = format!("isoplanat-camera {}", env!("CARGO_PKG_VERSION"));
    let mut exif = picture.exif.clone();
    exif.set(Directory::Picture, tags::SOFTWARE, Value::Text(software.clone()));
    if is_dng(path) {
        let model = picture.camera.clone();
        let info = DngInfo { software, description: String::new(), lens: String::new(), model };
        return write_linear_dng(path, &picture.image, &picture.colour, &info, &exif);
    }
    let encoding = if arguments.linear { Encoding::Linear } else { Encoding::Srgb };
    let beside = Annotation { gamut: Some(arguments.rendering().gamut), exif };
    files::write_annotated(path, &picture.image, encoding, arguments.linear, &beside)
}
