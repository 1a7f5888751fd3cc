//! Which file a capture's picture goes to, and writing it.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use crate::raw::has_raw_name;
use crate::reconstruct::Picture;
use clap::ValueEnum;
use isoplanat_base::atomic::{self, Target};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::gamut::Gamut;
use isoplanat_imaging::dng::{DngInfo, write_linear_dng};
use isoplanat_imaging::exif::{Directory, Value, tags};
use isoplanat_imaging::files::{self, Annotation, Depth, Encoding, extension};

/// Formats of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    Png,
    Tif,
    Jpg,
    Dng,
    Npy,
}

impl Format {
    pub(crate) const ALL: [Self; 5] = [Self::Png, Self::Tif, Self::Jpg, Self::Dng, Self::Npy];

    /// Endings of its files.
    pub(crate) fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Png => &["png"],
            Self::Tif => &["tif", "tiff"],
            Self::Jpg => &["jpg", "jpeg"],
            Self::Dng => &["dng"],
            Self::Npy => &["npy"],
        }
    }

    /// The ending that its files get here.
    pub(crate) fn ending(self) -> &'static str {
        self.endings()[0]
    }
}

/// Which pictures are to be written, from which captures.
#[derive(Debug)]
pub(crate) struct Pictures {
    /// Files, or folders of them, as named.
    pub(crate) captures: Vec<PathBuf>,
    /// What else is read: files, and the kit.
    pub(crate) read: Vec<PathBuf>,
    /// The kit, which keeps its own files only.
    pub(crate) kit: Option<PathBuf>,
    /// The file or folder to write, where one is named.
    pub(crate) out: Option<PathBuf>,
    /// Format of pictures that are named after their captures.
    pub(crate) format: Option<Format>,
    /// Linear light, 16 bits.
    pub(crate) linear: bool,
    /// Linear light, floating point.
    pub(crate) float: bool,
    /// What the numbers stand for.
    pub(crate) gamut: Gamut,
    /// Overwrite what is there.
    pub(crate) force: bool,
}

impl Pictures {
    /// Output paths for `captures`: beside the working folder's other files, the file or the folder `out`.
    ///
    /// # Errors
    /// Two captures with one output, an ending that is no picture format (or too shallow for linear light), an output that exists
    /// (unless forced) or that is a capture itself.
    pub(crate) fn plan(&self, captures: &[PathBuf]) -> Result<Vec<PathBuf>> {
        let out = self.out.as_deref();
        let folders = self.captures.iter().any(|c| c.is_dir());
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
            let name = named(stem(capture), self.format);
            let path = match out {
                Some(out) if into_folder => out.join(name),
                Some(out) => {
                    if let Some(format) = self.format.filter(|f| !f.endings().contains(&extension(out).as_str())) {
                        let found = format!("`{}` where -o names the file", format.ending());
                        return Err(Error::bad(out.display().to_string(), "--format", found, "one of both"));
                    }
                    out.to_owned()
                }
                None => PathBuf::from(name),
            };
            self.check(&path, captures)?;
            if let Some(other) = taken.insert(path.clone(), capture) {
                return Err(both(other, capture, &path));
            }
            planned.push(path);
        }
        Ok(planned)
    }

    /// Whether a picture of this name can be what is asked for.
    pub(crate) fn check_format(&self, path: &Path) -> Result<()> {
        let refuse = |place: &str, found: String, allowed: &str| {
            Err(Error::bad(path.display().to_string(), place, found, allowed))
        };
        let ending = extension(path);
        if !is_picture(path) {
            let found = if ending.is_empty() { "no ending".into() } else { format!("`.{ending}`") };
            return refuse("-o", found, ".png, .tif, .tiff, .jpg, .jpeg, .dng or .npy");
        }
        match ending.as_str() {
            "png" | "jpg" | "jpeg" | "dng" if self.float => {
                refuse("--float", format!("`.{ending}` has no floating point here"), ".tif or .npy")
            }
            "jpg" | "jpeg" if self.linear => refuse("--linear", "JPEG has 8 bits".into(), ".tif or .png"),
            "dng" if self.linear => {
                refuse("--linear", "a DNG is linear already".into(), "no --linear, or .tif or .png")
            }
            _ => Ok(()),
        }
    }

    /// Whether a picture may be written to a path.
    ///
    /// # Errors
    /// As [`Self::plan`].
    pub(crate) fn check(&self, path: &Path, captures: &[PathBuf]) -> Result<()> {
        self.check_format(path)?;
        let read: Vec<&Path> = captures.iter().chain(&self.read).map(PathBuf::as_path).collect();
        atomic::spares(path, &read)?;
        if let Some(kit) = &self.kit {
            atomic::outside(path, kit)?;
        }
        // A folder that is not there yet is made before pictures are.
        let awaits = path.parent().is_some_and(|folder| !folder.as_os_str().is_empty() && !folder.exists());
        if awaits { Ok(()) } else { atomic::check_target(path, self.force.into()) }
    }

    /// Bytes that a pixel takes at most while its file is put together: its numbers, and as much once more as they are packed.
    pub(crate) fn bytes_a_pixel(&self, path: &Path) -> usize {
        let eight = !self.linear && !self.float && !is_dng(path) && !matches!(extension(path).as_str(), "tif" | "tiff");
        if eight { 6 } else { 12 }
    }

    /// Writes a picture in the format its name asks for: PNG with 8 bits (16 if linear), TIFF and DNG with 16, JPEG, `.npy`; colours and the exposure's facts beside
    /// the pixels.
    pub(crate) fn write(&self, path: &Path, picture: &Picture) -> Result<()> {
        let to = Target::new(path, self.force);
        let software = format!("isoplanat-camera {}", env!("CARGO_PKG_VERSION"));
        let mut exif = picture.exif.clone();
        exif.set(Directory::Picture, tags::SOFTWARE, Value::Text(software.clone()));
        if is_dng(path) {
            let model = picture.camera.clone();
            let info = DngInfo { software, description: String::new(), lens: String::new(), model };
            return write_linear_dng(to, &picture.image, &picture.colour, &info, &exif);
        }
        let encoding = if self.linear || self.float { Encoding::Linear } else { Encoding::Srgb };
        let depth = match (self.float, self.linear) {
            (true, _) => Depth::Float,
            (false, true) => Depth::Sixteen,
            (false, false) => Depth::Eight,
        };
        let beside = Annotation { gamut: self.gamut, exif };
        files::write_annotated(to, &picture.image, encoding, depth, &beside)
    }
}

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

/// Makes the folder for several captures.
pub(crate) fn make_folder(path: &Path) -> Result<()> {
    match path.parent().filter(|p| !p.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).map_err(|e| Error::writing(folder, e)),
        None => Ok(()),
    }
}

fn ends_with_separator(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}
