//! Pictures. All readers agree on what is a picture and on its size; every sample is a number, and light written as an array comes back bit by bit.

use isoplanat::imaging::files::{Annotation, Depth, Encoding, picture_size, read_planes, read_stored, write_annotated};
use ndarray::{Array3, Axis};

use super::{again, file, place, read};

/// Pixels of a picture that is read whole.
const MOST: usize = 1 << 18;

pub(super) fn png(bytes: &[u8]) {
    picture("a.png", bytes);
}

pub(super) fn jpeg(bytes: &[u8]) {
    picture("a.jpg", bytes);
}

pub(super) fn tiff(bytes: &[u8]) {
    picture("a.tif", bytes);
}

pub(super) fn npy(bytes: &[u8]) {
    picture("a.npy", bytes);
}

fn picture(name: &str, bytes: &[u8]) {
    let path = file(name, bytes);
    let size = read(name, picture_size(&path));
    if size.is_some_and(|[rows, columns]| rows.saturating_mul(columns) > MOST) {
        return;
    }
    let (stored, planes) = (read(name, read_stored(&path, None)), read(name, read_planes(&path, None)));
    assert_eq!(stored.is_some(), planes.is_some(), "one reader takes what the other refuses");
    let (Some(stored), Some(planes)) = (stored, planes) else { return };
    let (channels, rows, columns) = stored.image.dim();
    assert_eq!((channels, Some([rows, columns])), (3, size));
    assert!(matches!(planes.values.dim().0, 1 | 3) && planes.values.len_of(Axis(0)) > 0);
    assert!(stored.image.iter().all(|v| v.is_finite()) && planes.values.iter().all(|v| v.is_finite()), "no number");
    assert!((1..=8).contains(&stored.orientation));
    let array = place("light.npy");
    again(write_annotated(&array, &stored.image, Encoding::Linear, Depth::Float, &Annotation::default()), "");
    assert_eq!(again(read_stored(&array, Some(Encoding::Linear)), "").image, stored.image);
}

/// What the program writes: a few colours, grey, one pixel.
fn written(endings: &[(&str, Depth)]) -> Vec<Vec<u8>> {
    let colour = |k: usize, r: usize, c: usize| ((k * 50 + r * 7 + c) % 97) as f32 / 97.0;
    let pictures = [
        Array3::from_shape_fn((3, 5, 7), |(k, r, c)| colour(k, r, c)),
        Array3::from_shape_fn((1, 16, 9), |(k, r, c)| colour(k, r, c)),
        Array3::from_elem((3, 1, 1), 0.5),
    ];
    let mut all = Vec::new();
    for (ending, depth) in endings {
        for picture in &pictures {
            let path = place(&format!("start.{ending}"));
            write_annotated(&path, picture, Encoding::Srgb, *depth, &Annotation::default()).expect("writes");
            all.push(std::fs::read(&path).expect("reads"));
        }
    }
    all
}

pub(super) fn png_starts() -> Vec<Vec<u8>> {
    written(&[("png", Depth::Eight), ("png", Depth::Sixteen)])
}

pub(super) fn jpeg_starts() -> Vec<Vec<u8>> {
    written(&[("jpg", Depth::Eight)])
}

pub(super) fn tiff_starts() -> Vec<Vec<u8>> {
    written(&[("tif", Depth::Sixteen), ("tif", Depth::Float)])
}

pub(super) fn npy_starts() -> Vec<Vec<u8>> {
    written(&[("npy", Depth::Float)])
}
