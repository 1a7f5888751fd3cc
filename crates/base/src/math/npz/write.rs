//! Archives that this program writes: an error of the disk is told once, as the disk's.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};

use ndarray_npy::{NpzWriter, WriteNpzError};

use crate::atomic::{Target, write_atomic};
use crate::error::{Error, Result};

/// An archive that is being written.
pub type Archive<'a> = NpzWriter<Held<'a>>;

/// A file that holds its first error back, and takes what comes after it as written: an archive ends itself when it is dropped, and would
/// print what it meets then.
#[derive(Debug)]
pub struct Held<'a> {
    inner: &'a mut BufWriter<File>,
    error: &'a RefCell<Option<io::Error>>,
    at: u64,
    end: u64,
}

impl Held<'_> {
    fn hold(&mut self, step: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) {
        let mut error = self.error.borrow_mut();
        if error.is_none() {
            *error = step(self.inner).err();
        }
    }
}

impl Write for Held<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.hold(|inner| inner.write_all(bytes));
        self.at += bytes.len() as u64;
        self.end = self.end.max(self.at);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.hold(Write::flush);
        Ok(())
    }
}

impl Seek for Held<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
        };
        self.at = at.ok_or(ErrorKind::InvalidInput)?;
        let at = self.at;
        self.hold(|inner| inner.seek(SeekFrom::Start(at)).map(drop));
        Ok(at)
    }
}

/// Writes an archive of arrays that `fill` puts in, whole or not at all.
///
/// # Errors
/// The disk's, or what of the arrays the format cannot hold.
pub fn write<'a>(
    to: impl Into<Target<'a>>,
    fill: impl FnOnce(&mut Archive<'_>) -> std::result::Result<(), WriteNpzError>,
) -> Result<()> {
    let to = to.into();
    write_atomic(to, |file| {
        let error = RefCell::new(None);
        let mut archive = NpzWriter::new(Held { inner: file, error: &error, at: 0, end: 0 });
        // On its way out of here an archive that was not finished ends itself.
        let done = fill(&mut archive).and_then(|()| archive.finish().map(drop));
        match error.take() {
            Some(e) => Err(Error::writing(to.path, e)),
            None => done.map_err(|e| Error::writing(to.path, io::Error::other(e))),
        }
    })
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use ndarray_npy::NpzReader;

    use super::*;
    use crate::atomic::Replace;

    #[test]
    fn what_is_written_is_read_and_nothing_replaced() {
        let place = tempfile::tempdir().expect("a temporary folder");
        let path = place.path().join("a.npz");
        let array = Array2::from_shape_fn((300, 70), |(i, j)| i as f64 - 0.5 * j as f64);
        let put = |archive: &mut Archive<'_>| archive.add_array("a", &array);
        write(Target::new(&path, Replace::Never), put).expect("writes");
        let mut read = NpzReader::new(File::open(&path).expect("opens")).expect("an archive");
        assert_eq!(read.by_name::<ndarray::OwnedRepr<f64>, ndarray::Ix2>("a").expect("there"), array);
        assert!(matches!(write(Target::new(&path, Replace::Never), put), Err(Error::Exists(_))));
    }

    /// The system's own words for a full disk, wherever it comes.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_told_as_one() {
        let array = Array2::<f64>::ones((300, 70));
        let error = RefCell::new(None);
        let mut full = BufWriter::new(File::options().write(true).open("/dev/full").expect("opens"));
        let mut archive = NpzWriter::new(Held { inner: &mut full, error: &error, at: 0, end: 0 });
        archive.add_array("a", &array).expect("held back");
        drop(archive);
        assert_eq!(error.take().map(|e| e.kind()), Some(ErrorKind::StorageFull));
        let _ = full.into_parts();
    }
}
