//! Archives of arrays (NumPy's `.npz`): of those that come from others, what they promise is looked at before anybody makes room for it.

mod write;

use std::io::{Cursor, Read, Seek};
use std::path::Path;

use ndarray::{Ix0, OwnedRepr};
use ndarray_npy::NpzReader;
use zip::{CompressionMethod, ZipArchive};

use crate::error::{Error, Result};
pub use write::{Archive, Held, write};

/// Bytes of an array's header at most; NumPy's own take 128.
const HEADER: usize = 1 << 10;

/// Refuses an archive whose arrays promise more numbers than they have bytes, whose headers are not those that NumPy and this program write, or that is compressed
/// (this program's are not): the place, and what stands there.
///
/// # Errors
/// As said; an archive that cannot be read.
pub fn check(bytes: &[u8]) -> std::result::Result<(), (String, String)> {
    let whole = |e: &dyn std::fmt::Display| ("file".to_owned(), e.to_string());
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| whole(&e))?;
    for i in 0..archive.len() {
        let mut entry = archive.by_index(i).map_err(|e| whole(&e))?;
        let name = entry.name().trim_end_matches(".npy").to_owned();
        let failed = |what: String| (name.clone(), what);
        if entry.compression() != CompressionMethod::Stored {
            return Err(failed("a compressed array".into()));
        }
        let size = entry.size().min(entry.compressed_size()).min(bytes.len() as u64);
        let header = header(&mut entry).map_err(|e| failed(e.to_string()))?;
        let shape = shape(&header).ok_or_else(|| failed(format!("no array's header: {}", header.escape_debug())))?;
        // A side of 0 does not let others be endless.
        let mut sides = shape.iter().filter(|side| **side > 0);
        let numbers = sides.try_fold(1u64, |n, side| n.checked_mul(*side as u64));
        if numbers.is_none_or(|n| n > size.max(1)) {
            return Err(failed(format!("{shape:?} numbers in {size} bytes")));
        }
    }
    Ok(())
}

/// Refuses, by its number, an archive of a `schema` that is newer than `known`; one that states none is of the first. `path` names the file.
///
/// # Errors
/// As said; a `schema` that is no whole number above 0.
#[doc(hidden)]
pub fn require_schema<R: Read + Seek>(npz: &mut NpzReader<R>, known: i64, path: &Path) -> Result<()> {
    let bad = |found: String, allowed: String| Err(Error::bad(path.display().to_string(), "schema", found, allowed));
    let names = npz.names().unwrap_or_default();
    if !names.iter().any(|n| n.trim_end_matches(".npy") == "schema") {
        return Ok(());
    }
    match npz.by_name::<OwnedRepr<i64>, Ix0>("schema").map(|s| *s.first().unwrap_or(&0)) {
        Ok(schema) if (1..=known).contains(&schema) => Ok(()),
        Ok(newer) if newer > known => {
            bad(newer.to_string(), format!("up to {known}, which this version reads; a newer one reads this file"))
        }
        other => bad(other.map_or_else(|e| e.to_string(), |s| s.to_string()), format!("schema 1 to {known}")),
    }
}

/// The text of an array's header (NumPy's format, versions 1 to 3).
fn header(entry: &mut impl Read) -> std::io::Result<String> {
    let mut start = [0; 8];
    entry.read_exact(&mut start)?;
    let mut length = [0; 4];
    let wide = start[6] > 1;
    entry.read_exact(&mut length[..if wide { 4 } else { 2 }])?;
    let length = u32::from_le_bytes(length) as usize;
    if length > HEADER {
        return Err(std::io::Error::other(format!("an array's header of {length} bytes")));
    }
    let mut text = vec![0; length];
    entry.read_exact(&mut text)?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// The sides in `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`, and nothing else beside it.
fn shape(header: &str) -> Option<Vec<usize>> {
    let rest = header.trim_end().strip_prefix("{'descr': '")?;
    let (descr, rest) = rest.split_once("', 'fortran_order': ")?;
    let (order, rest) = rest.split_once(", 'shape': (")?;
    let (inside, end) = rest.split_once(')')?;
    let plain = descr.chars().all(|c| c.is_ascii_alphanumeric() || "<>|=".contains(c));
    if !plain || !matches!(order, "False" | "True") || !matches!(end, ", }" | "}" | ",}") {
        return None;
    }
    let sides = inside.split(',').map(str::trim).filter(|s| !s.is_empty());
    sides.map(|s| s.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use ndarray::{Array1, arr0, arr2};
    use ndarray_npy::NpzWriter;

    use super::*;

    /// Archives of ours pass; one whose header promises more than there is does not, wherever a byte of it is another.
    #[test]
    fn promises_are_kept_or_refused() {
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add_array("alone", &arr0(1.5f64)).expect("writes");
        npz.add_array("line", &Array1::<i64>::zeros(70)).expect("writes");
        npz.add_array("plane", &arr2(&[[1i16, 2, 3], [4, 5, 6]])).expect("writes");
        npz.add_array("none", &Array1::<f32>::zeros(0)).expect("writes");
        let bytes = npz.finish().expect("writes").into_inner();
        assert_eq!(check(&bytes), Ok(()));
        // Other headers of the same length in place of the line's, whose padding has room for them.
        let start = bytes.windows(16).position(|w| w == b"{'descr': '<i8',").expect("a header");
        let with = |header: &str| {
            let mut changed = bytes.clone();
            changed[start..start + header.len()].copy_from_slice(header.as_bytes());
            check(&changed)
        };
        let kept = "{'descr': '<i8', 'fortran_order': False, 'shape': (70,), }                      ";
        assert_eq!(with(kept), Ok(()));
        for header in [
            "{'descr': '<i8', 'fortran_order': False, 'shape': (35184372088832,), }",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (0, 1099511627776, 1099511627776), }",
            "{'shape': (1,), 'descr': '<i8', 'fortran_order': False, 'shape': (1099511627776,), }",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (1,), 'shape': (1099511627776,), }",
            "{'descr': [[[[[[[[[[[[[[[[[[[[[['<i8']]]]]]]]]]]]]]]]]]]]]], 'shape': (1,), }",
        ] {
            assert_eq!(with(header).expect_err(header).0, "line", "{header}");
        }
        let mut long = bytes.clone();
        long[start - 2..start].copy_from_slice(&[0xff, 0xff]);
        assert!(check(&long).expect_err("a long header").1.contains("65535"));
        let rng = &mut fastrand::Rng::with_seed(4);
        for _ in 0..2000 {
            let mut changed = bytes.clone();
            changed[rng.usize(0..bytes.len())] = rng.u8(..);
            let _ = check(&changed);
            let _ = check(&changed[..rng.usize(0..bytes.len())]);
        }
    }
}
