//! How a capture is turned to stand upright: the eight orientations of Exif tag 0x0112.

use isoplanat_imaging::exif::Turn;
use ndarray::Array3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows of the upright picture that are filled together.
const STRIP: usize = 16;

/// Where the stored picture's first row and column belong; `1` is upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Orientation(u8);

impl Default for Orientation {
    fn default() -> Self {
        Self::UPRIGHT
    }
}

impl Orientation {
    /// Stored as it is looked at.
    pub(crate) const UPRIGHT: Self = Self(1);

    /// From the Exif value; anything outside 1 to 8 counts as upright, as in other viewers.
    pub(crate) fn from_exif(value: u16) -> Self {
        Self(u8::try_from(value).ok().filter(|v| (1..=8).contains(v)).unwrap_or(1))
    }

    /// The Exif value, 1 to 8.
    pub fn exif(self) -> u8 {
        self.0
    }

    /// The picture turned upright, `[channel, row, col]`.
    pub(crate) fn apply(self, image: Array3<f32>) -> Array3<f32> {
        let Some(Turn { transpose, flip_rows, flip_columns }) = Turn::from_exif(self.0) else { return image };
        let (channels, rows, columns) = image.dim();
        let mut samples = if image.is_standard_layout() {
            image.into_raw_vec_and_offset().0
        } else {
            image.as_standard_layout().into_owned().into_raw_vec_and_offset().0
        };
        let (height, width) = if transpose { (columns, rows) } else { (rows, columns) };
        // Plane by plane in place: three planes are large enough.
        for plane in samples.chunks_exact_mut((rows * columns).max(1)) {
            let stored = plane.to_vec();
            plane.par_chunks_mut(STRIP * width.max(1)).enumerate().for_each(|(strip, lines)| {
                let turned = |flip: bool, k: usize, n: usize| if flip { n - 1 - k } else { k };
                for c in 0..width {
                    let col = turned(flip_columns, c, width);
                    for (k, line) in lines.chunks_exact_mut(width).enumerate() {
                        let row = turned(flip_rows, strip * STRIP + k, height);
                        line[c] = stored[if transpose { col * columns + row } else { row * columns + col }];
                    }
                }
            });
        }
        Array3::from_shape_vec((channels, height, width), samples).expect("as many samples as before")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_eight_orientations_follow_exif() {
        // The Exif standard names the side of the scene where row 0 and column 0 of the file lie.
        let file = Array3::from_shape_vec((1, 2, 3), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).expect("six values");
        let cases: [(u16, (usize, usize), [f32; 6]); 8] = [
            (1, (2, 3), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), // top, left
            (2, (2, 3), [3.0, 2.0, 1.0, 6.0, 5.0, 4.0]), // top, right
            (3, (2, 3), [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]), // bottom, right
            (4, (2, 3), [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]), // bottom, left
            (5, (3, 2), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]), // left, top
            (6, (3, 2), [4.0, 1.0, 5.0, 2.0, 6.0, 3.0]), // right, top
            (7, (3, 2), [6.0, 3.0, 5.0, 2.0, 4.0, 1.0]), // right, bottom
            (8, (3, 2), [3.0, 6.0, 2.0, 5.0, 1.0, 4.0]), // left, bottom
        ];
        for (exif, (rows, columns), expected) in cases {
            let upright = Orientation::from_exif(exif).apply(file.clone());
            assert_eq!(upright.dim(), (1, rows, columns), "{exif}");
            assert_eq!(upright.into_raw_vec_and_offset().0, expected, "{exif}");
        }
        assert_eq!(Orientation::from_exif(0), Orientation::UPRIGHT);
        // A larger picture, whose strips are not whole: four quarter turns, and each mirroring twice, are the picture itself.
        let picture = Array3::from_shape_fn((3, 37, 50), |(c, i, j)| (c * 10_000 + i * 100 + j) as f32);
        let turned = |by: u16, image: Array3<f32>| Orientation::from_exif(by).apply(image);
        let quarter = turned(6, picture.clone());
        assert!(quarter.indexed_iter().all(|((c, i, j), v)| *v == picture[[c, 36 - j, i]]));
        assert_eq!(turned(6, turned(6, turned(6, quarter.clone()))), picture);
        assert_eq!(turned(8, quarter.clone()), picture);
        assert_eq!(turned(6, quarter), turned(3, picture.clone()));
        for mirror in [2, 4, 5, 7] {
            assert_eq!(turned(mirror, turned(mirror, picture.clone())), picture, "{mirror}");
        }
        assert_eq!(Orientation::from_exif(9), Orientation::UPRIGHT);
    }
}
