//! A folder of photographs as scenes: PNG, JPEG, TIFF and `.npy`, read when asked for, sRGB decoded to linear light.

use std::path::{Path, PathBuf};

use ndarray::Array3;

use crate::files;
use isoplanat_base::error::{Error, Result};

/// The pictures of one folder, sorted by name. Nothing is read before [`Photos::load`].
#[derive(Clone, Debug)]
pub struct Photos {
    paths: Vec<PathBuf>,
}

impl Photos {
    /// Lists the folder's `.png`, `.jpg`, `.jpeg`, `.tif`, `.tiff` and `.npy` files; hidden files and folders in it are left out.
    ///
    /// A folder without any is refused.
    pub fn open(folder: &Path) -> Result<Self> {
        let failed = |e| Error::reading(folder, e);
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
            let picture = files::PICTURES.contains(&files::extension(&path).as_str());
            if picture && !hidden && path.is_file() {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            let (file, allowed) =
                (folder.display().to_string(), "at least one .png, .jpg, .jpeg, .tif, .tiff or .npy file");
            return Err(Error::bad(file, "folder of photographs", "no pictures", allowed));
        }
        paths.sort();
        Ok(Self { paths })
    }

    /// The first `count` of them, at least one.
    #[must_use]
    pub fn first(mut self, count: usize) -> Self {
        self.paths.truncate(count.max(1));
        self
    }

    /// The number of pictures, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a folder without pictures is refused, so it never is")]
    pub fn len(&self) -> usize {
        self.paths.len()
    }

    /// The pictures' files, sorted by name.
    pub fn paths(&self) -> &[PathBuf] {
        &self.paths
    }

    /// Reads picture `index`, linear RGB `[3, row, col]`; a file that is no picture is an error that names it.
    ///
    /// # Panics
    /// If `index` is not below [`Self::len`].
    pub fn load(&self, index: usize) -> Result<Array3<f32>> {
        files::read_linear(&self.paths[index])
    }

    /// Pixels of the largest picture, as the files state them.
    ///
    /// # Errors
    /// A file that cannot be read, or is no picture.
    pub fn largest(&self) -> Result<usize> {
        let mut sizes =
            self.paths.iter().map(|path| files::picture_size(path).map(|[rows, cols]| rows.saturating_mul(cols)));
        sizes.try_fold(0, |most, size| Ok(most.max(size?)))
    }

    /// The pictures one after the other, each read when the iterator reaches it.
    pub fn iter(&self) -> impl Iterator<Item = Result<Array3<f32>>> + '_ {
        self.paths.iter().map(|path| files::read_linear(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_sorted_and_bad_ones_are_named() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        for (name, v) in [("b.png", 0.2), ("a.JPG", 0.6), ("c.tif", 0.9)] {
            let image = Array3::from_elem((3, 8, 8), v);
            files::write_picture(&at(name), &image, files::Encoding::Srgb).expect("writes");
        }
        std::fs::write(at("notes.txt"), "no picture").expect("writes");
        std::fs::write(at(".hidden.png"), "no picture").expect("writes");
        std::fs::write(at("d.png"), "no picture").expect("writes");
        let photos = Photos::open(folder.path()).expect("lists");
        assert_eq!(photos.len(), 4);
        let first = photos.load(0).expect("reads");
        assert!((first[[0, 4, 4]] - 0.6).abs() < 0.02);
        let results: Vec<_> = photos.iter().collect();
        assert!(results[..3].iter().all(Result::is_ok));
        assert!(results[3].as_ref().expect_err("no picture").to_string().contains("d.png"));
    }

    #[test]
    fn empty_and_missing_folders_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let error = Photos::open(folder.path()).expect_err("empty").to_string();
        assert!(error.contains("no pictures") && error.contains(&folder.path().display().to_string()), "{error}");
        assert!(Photos::open(&folder.path().join("none")).is_err());
    }
}
