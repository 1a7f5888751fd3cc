//! Archives of arrays (NumPy's `.npz`) that come from others: what they promise is looked at before anybody makes room for it.

use std::io::{Cursor, Read};

use zip::{CompressionMethod, ZipArchive};

/// Bytes of an array's header at most.
const HEADER: usize = 1 << 16;

/// Refuses an archive whose arrays promise more numbers than it has bytes, or that is compressed (this program's are not): the place, and what stands there.
///
/// # Errors
/// As said; an archive that cannot be read.
pub fn check(bytes: &[u8]) -> Result<(), (String, String)> {
    let whole = |e: &dyn std::fmt::Display| ("file".to_owned(), e.to_string());
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| whole(&e))?;
    for i in 0..archive.len() {
        let mut entry = archive.by_index(i).map_err(|e| whole(&e))?;
        let name = entry.name().trim_end_matches(".npy").to_owned();
        let failed = |what: String| (name.clone(), what);
        if entry.compression() != CompressionMethod::Stored {
            return Err(failed("a compressed array".into()));
        }
        let header = header(&mut entry).map_err(|e| failed(e.to_string()))?;
        let shape = shape(&header).ok_or_else(|| failed(format!("no array's header: {header}")))?;
        let numbers = shape.iter().try_fold(1usize, |n, side| n.checked_mul(*side));
        if numbers.is_none_or(|n| n > bytes.len()) {
            return Err(failed(format!("{shape:?} numbers in a file of {} bytes", bytes.len())));
        }
    }
    Ok(())
}

/// The text of an array's header (NumPy's format, versions 1 to 3).
fn header(entry: &mut impl Read) -> std::io::Result<String> {
    let mut start = [0; 8];
    entry.read_exact(&mut start)?;
    let mut length = [0; 4];
    let wide = start[6] > 1;
    entry.read_exact(&mut length[..if wide { 4 } else { 2 }])?;
    let length = (u32::from_le_bytes(length) as usize).min(HEADER);
    let mut text = vec![0; length];
    entry.read_exact(&mut text)?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// The sides in `'shape': (3, 4), `.
fn shape(header: &str) -> Option<Vec<usize>> {
    let (_, rest) = header.split_once("'shape'")?;
    let (_, rest) = rest.split_once('(')?;
    let (inside, _) = rest.split_once(')')?;
    let sides = inside.split(',').map(str::trim).filter(|s| !s.is_empty());
    sides.map(|s| s.trim_end_matches('L').parse().ok()).collect()
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
        let text = "'shape': (70,)";
        let at = bytes.windows(text.len()).position(|w| w == text.as_bytes()).expect("a header");
        // The padding behind it has room for more digits.
        let mut huge = bytes.clone();
        let more = b"'shape': (35184372088832,), }";
        huge[at..at + more.len()].copy_from_slice(more);
        let (place, found) = check(&huge).expect_err("huge");
        assert!(place == "line" && found.contains("35184372088832"), "{place}: {found}");
        let rng = &mut fastrand::Rng::with_seed(4);
        for _ in 0..2000 {
            let mut changed = bytes.clone();
            changed[rng.usize(0..bytes.len())] = rng.u8(..);
            let _ = check(&changed);
            let _ = check(&changed[..rng.usize(0..bytes.len())]);
        }
    }
}
