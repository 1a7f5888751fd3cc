//! NumPy arrays as pictures: `[row, col]`, `[row, col, 1]` or `[row, col, 3]`, with alpha `[row, col, 4]`; linear light where they are floating point.

use std::path::Path;

use ndarray::{Array2, Array3, ArrayViewD, Axis};
use ndarray_npy::{ReadableElement, ViewElement, ViewNpyError, ViewNpyExt, WriteNpyError, WriteNpyExt};

use super::content::{Alpha, Content, Samples, finite};
use super::room::Room;
use isoplanat_base::atomic::{Target, read_bounded, write_atomic};
use isoplanat_base::error::{Error, Result};

/// The first bytes of a file.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// Alignment that views ask for at most.
const ALIGNMENT: usize = 8;

fn bad(path: &Path, found: impl Into<String>, allowed: &str) -> Error {
    Error::bad(path.display().to_string(), "array", found, allowed)
}

/// Rows, columns and stored channels of an array's shape.
fn shape(path: &Path, shape: &[usize]) -> Result<[usize; 3]> {
    match *shape {
        [rows, cols] if rows > 0 && cols > 0 => Ok([rows, cols, 1]),
        [rows, cols, channels @ (1 | 3 | 4)] if rows > 0 && cols > 0 => Ok([rows, cols, channels]),
        _ => Err(bad(
            path,
            format!("of the shape {shape:?}"),
            "[row, col], or [row, col, channel] with 1, 3 or 4 channels",
        )),
    }
}

/// Bytes of an array at most.
const LARGEST: u64 = 4 << 30;

/// Rows and columns.
pub(super) fn size(path: &Path) -> Result<[usize; 2]> {
    read(path, None).map(|content| [content.rows, content.cols])
}

/// Whether a file is as long as its array's header says that this is (NumPy's format, versions 1 to 3): its reader makes room for a header before it reads it.
fn has_header(file: &[u8]) -> bool {
    let length = match file {
        [_, _, _, _, _, _, 1, _, a, b, ..] => u64::from(u16::from_le_bytes([*a, *b])),
        [_, _, _, _, _, _, _, _, a, b, c, d, ..] => u64::from(u32::from_le_bytes([*a, *b, *c, *d])),
        _ => return false,
    };
    length <= file.len() as u64
}

/// The array of a file; refused where there is no room for it.
pub(super) fn read(path: &Path, room: Option<Room>) -> Result<Content> {
    if let Some(room) = room {
        // Two copies while it is put on its boundaries.
        let bytes = std::fs::metadata(path).map_err(|e| Error::reading(path, e))?.len();
        room.allow_bytes(path, bytes.saturating_mul(2))?;
    }
    let file = read_bounded(path, LARGEST)?;
    if file.starts_with(MAGIC) && !has_header(&file) {
        return Err(bad(path, "cut off within its header", "a whole NumPy array (.npy)"));
    }
    // A view never makes room for what a header promises and the file has not; it asks for numbers on their boundaries.
    let mut aligned = vec![0u8; file.len() + ALIGNMENT];
    let start = aligned.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
    aligned[start..start + file.len()].copy_from_slice(&file);
    let bytes = &aligned[start..start + file.len()];
    drop(file);
    // With what is opaque, and the bytes that a sample takes at most.
    let tried = [
        view::<f32>(path, (bytes, room), (1.0, 4), Samples::F32),
        view::<f64>(path, (bytes, room), (1.0, 8), Samples::F64),
        view::<u8>(path, (bytes, room), (u8::MAX, 1), Samples::U8),
        view::<u16>(path, (bytes, room), (u16::MAX, 2), Samples::U16),
        view::<u32>(path, (bytes, room), (u32::MAX, 4 + 8), |v| {
            Samples::Whole(v.into_iter().map(|v| f64::from(v) / f64::from(u32::MAX)).collect(), 32)
        }),
    ];
    for content in tried {
        if let Some(content) = content? {
            return finite(path, content);
        }
    }
    Err(bad(path, "numbers of another kind", "little-endian float32, float64, uint8, uint16 or uint32"))
}

/// The array if its numbers are `S`.
fn view<S: Copy + PartialOrd + ViewElement + ReadableElement>(
    path: &Path,
    (bytes, room): (&[u8], Option<Room>),
    (top, kept): (S, usize),
    samples: impl Fn(Vec<S>) -> Samples,
) -> Result<Option<Content>> {
    let array = match ArrayViewD::<S>::view_npy(bytes) {
        Ok(array) => array,
        Err(ViewNpyError::WrongDescriptor(_) | ViewNpyError::NonNativeEndian) => return Ok(None),
        Err(e) => return Err(bad(path, e.to_string(), "a whole NumPy array (.npy)")),
    };
    let [rows, cols, stored] = shape(path, array.shape())?;
    let channels = if stored == 1 { 1 } else { 3 };
    if let Some(room) = room {
        room.allow(path, [rows, cols], bytes.len() as u64, (channels, kept))?;
    }
    let mut array = array;
    let mut alpha = None;
    if stored == 4 {
        alpha = array.index_axis(Axis(2), 3).iter().any(|v| *v < top).then_some(Alpha::Apart);
        array.slice_axis_inplace(Axis(2), ndarray::Slice::from(0..3));
    }
    // In the order of rows, whatever the file's.
    let samples = samples(array.iter().copied().collect());
    Ok(Some(Content { rows, cols, channels, samples, orientation: 1, alpha, told: None }))
}

/// Writes linear channels, `[channel, row, col]`, as float32: `[row, col, 3]`, or `[row, col]` for one channel.
pub(super) fn write(to: Target<'_>, image: &Array3<f32>) -> Result<()> {
    let path = to.path;
    write_atomic(to, |out| {
        let written = if image.dim().0 == 1 {
            let plane: Array2<f32> = image.index_axis(Axis(0), 0).as_standard_layout().into_owned();
            plane.write_npy(out)
        } else {
            let turned: Array3<f32> = image.view().permuted_axes([1, 2, 0]).as_standard_layout().into_owned();
            turned.write_npy(out)
        };
        written.map_err(|e| match e {
            WriteNpyError::Io(e) => Error::writing(path, e),
            e => bad(path, e.to_string(), "an array that the format can hold"),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::{Encoding, read_picture, read_planes};

    /// A file as NumPy 2 writes it (format version 1).
    fn file(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
        header = format!("{header:<width$}\n", width = length - 1);
        let mut bytes = [MAGIC, &[1, 0], &(length as u16).to_le_bytes(), header.as_bytes()].concat();
        bytes.extend(data);
        bytes
    }

    #[test]
    fn arrays_are_pictures_of_their_shape_and_kind() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.npy");
        let put = |bytes: &[u8]| std::fs::write(&path, bytes).expect("writes");
        let floats: Vec<u8> = [0.0f32, 0.5, 1.0, 2.0, -0.5, 0.25].iter().flat_map(|v| v.to_le_bytes()).collect();
        put(&file("<f4", "False", "(2, 3)", &floats));
        let planes = read_planes(&path, None).expect("reads");
        assert_eq!((planes.values.dim(), planes.values[[0, 1, 0]], planes.bits), ((1, 2, 3), 2.0, None));
        put(&file("<f4", "True", "(2, 3)", &floats));
        assert_eq!(read_planes(&path, None).expect("reads").values[[0, 0, 1]], 1.0, "column after column");
        put(&file("<f4", "False", "(1, 2, 3)", &floats));
        let rgb = read_picture(&path, Encoding::Srgb).expect("reads");
        assert_eq!((rgb.dim(), rgb[[2, 0, 0]], rgb[[0, 0, 1]]), ((3, 1, 2), 1.0, 2.0));
        put(&file("|u1", "False", "(1, 1, 4)", &[255, 51, 0, 9]));
        let rgb = read_picture(&path, Encoding::Linear).expect("reads");
        assert_eq!((rgb.dim(), rgb[[1, 0, 0]]), ((3, 1, 1), 0.2));
        for (bytes, words) in [
            (file("<f4", "False", "(2, 3)", &floats[..20]), "a.npy"),
            (file("<f4", "False", "(4000000000, 4000000000)", &floats), "a.npy"),
            (file("<f4", "False", "(6,)", &floats), "[6]"),
            (file("<f4", "False", "(1, 3, 2)", &floats), "[1, 3, 2]"),
            (file("<f4", "False", "(0, 3)", &[]), "[0, 3]"),
            (file(">f4", "False", "(2, 3)", &floats), "little-endian"),
            (file("<i4", "False", "(2, 3)", &floats), "another kind"),
            (file("<f4", "False", "(1, 1)", &f32::NAN.to_le_bytes()), "finite"),
            // A number of 64 bits that 32 do not hold would be read as infinite light.
            (file("<f8", "False", "(1, 1)", &1e39f64.to_le_bytes()), "finite numbers of 32 bits"),
            (b"\x93NUMPY\x01".to_vec(), "a.npy"),
            // Found by fuzzing: room for a header of 3.6 GB, asked for before it was read.
            (b"\x93NUMPY\x03\0\x8a\xff\x84\xd8{'descr': '<f4', }".to_vec(), "within its header"),
            (b"no array".to_vec(), "a.npy"),
            (Vec::new(), "a.npy"),
        ] {
            put(&bytes);
            let error = read_picture(&path, Encoding::Linear).expect_err(words);
            assert!(error.to_string().contains(words) && error.exit_code() == 2, "{words}: {error}");
        }
    }
}
