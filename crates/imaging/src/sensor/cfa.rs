//! Colour filter array: which channel each pixel of the sensor sees.
//!
//! `mosaic(rgb)[r, c] = rgb[channel(r, c), r, c]`: one sample of three is kept. Its transpose puts each sample back into
//! its channel and zeros elsewhere. Only the four Bayer layouts are covered (one red, one blue, two greens on a diagonal).

use std::fmt;

use isoplanat_base::math::real::Real;
use ndarray::{Array2, Array3, ArrayView2, ArrayView3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A Bayer layout: the channel (0 = R, 1 = G, 2 = B) at `[row parity * 2 + column parity]`.
///
/// In files it is the string `"RGGB"`, `"BGGR"`, `"GRBG"` or `"GBRG"`, read row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cfa(pub [u8; 4]);

impl Cfa {
    /// Red at the first pixel.
    pub const RGGB: Self = Self([0, 1, 1, 2]);
    /// Blue at the first pixel.
    pub const BGGR: Self = Self([2, 1, 1, 0]);
    /// Green at the first pixel, red to its right.
    pub const GRBG: Self = Self([1, 0, 2, 1]);
    /// Green at the first pixel, blue to its right.
    pub(crate) const GBRG: Self = Self([1, 2, 0, 1]);

    /// The layouts there are.
    pub const ALL: [Self; 4] = [Self::RGGB, Self::BGGR, Self::GRBG, Self::GBRG];

    /// The channel of the pixel at `row`, `col`.
    ///
    /// ```
    /// use isoplanat_imaging::sensor::cfa::Cfa;
    ///
    /// assert_eq!([(0, 0), (0, 1), (1, 0), (1, 1)].map(|(r, c)| Cfa::RGGB.channel(r, c)), [0, 1, 1, 2]);
    /// ```
    pub fn channel(self, row: usize, col: usize) -> usize {
        usize::from(self.0[(row & 1) * 2 + (col & 1)])
    }

    /// The layout seen by a crop whose first pixel lies at `row`, `col` of this one.
    #[must_use]
    pub fn shifted(self, row: usize, col: usize) -> Self {
        Self(std::array::from_fn(|i| self.0[((row + i / 2) & 1) * 2 + ((col + i % 2) & 1)]))
    }

    /// Mean of each colour of a mosaic `[row, col]`; 0 where there is none.
    pub(crate) fn means(self, mosaic: ArrayView2<'_, f32>) -> [f64; 3] {
        let (mut sums, mut counts) = ([0.0; 3], [0usize; 3]);
        for (i, row) in mosaic.outer_iter().enumerate() {
            let mut pair = [0.0; 2];
            row.iter().enumerate().for_each(|(j, v)| pair[j & 1] += f64::from(*v));
            for (j, sum) in pair.into_iter().enumerate() {
                let channel = self.channel(i, j);
                sums[channel] += sum;
                counts[channel] += (row.len() + 1 - j) / 2;
            }
        }
        std::array::from_fn(|c| sums[c] / counts[c].max(1) as f64)
    }

    /// The layout named `name`, letter case ignored; `None` for anything but the four Bayer layouts.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|cfa| cfa.name().eq_ignore_ascii_case(name))
    }

    /// The layout's letters row by row, for instance `RGGB`.
    pub fn name(self) -> String {
        self.0.iter().map(|&c| ['R', 'G', 'B'].get(usize::from(c)).copied().unwrap_or('?')).collect()
    }
}

impl fmt::Display for Cfa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name())
    }
}

impl Serialize for Cfa {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name())
    }
}

impl<'de> Deserialize<'de> for Cfa {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::from_name(&name).ok_or_else(|| {
            serde::de::Error::custom(format!("`{name}` is not a Bayer layout; use RGGB, BGGR, GRBG or GBRG"))
        })
    }
}

/// Keeps the sample each pixel sees.
///
/// # Shapes
/// `rgb`: `[3, row, col]`; result `[row, col]`.
///
/// # Panics
/// If `rgb` has not three channels.
pub(crate) fn mosaic<T: Copy>(rgb: ArrayView3<'_, T>, cfa: Cfa) -> Array2<T> {
    let (channels, rows, cols) = rgb.dim();
    assert_eq!(channels, 3, "a mosaic is taken from three channels");
    Array2::from_shape_fn((rows, cols), |(r, c)| rgb[[cfa.channel(r, c), r, c]])
}

/// Pulls a cotangent of `mosaic` back to its image: the exact transpose.
///
/// # Shapes
/// `mosaic_bar`: `[row, col]`; result `[3, row, col]`.
pub fn mosaic_vjp<T: Real>(mosaic_bar: ArrayView2<'_, T>, cfa: Cfa) -> Array3<T> {
    let (rows, cols) = mosaic_bar.dim();
    let mut rgb_bar = Array3::zeros((3, rows, cols));
    for ((r, c), &v) in mosaic_bar.indexed_iter() {
        rgb_bar[[cfa.channel(r, c), r, c]] = v;
    }
    rgb_bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_layouts_and_shifts_agree() {
        for cfa in Cfa::ALL {
            assert_eq!(Cfa::from_name(&cfa.name()), Some(cfa));
            for (r, c) in [(0, 0), (0, 1), (1, 0), (1, 1), (3, 2)] {
                let crop = cfa.shifted(r, c);
                for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    assert_eq!(crop.channel(i, j), cfa.channel(r + i, c + j));
                }
            }
        }
        assert_eq!(Cfa::RGGB.shifted(0, 1), Cfa::GRBG);
        assert_eq!(Cfa::RGGB.shifted(1, 1), Cfa::BGGR);
        assert_eq!(Cfa::from_name("RGBW"), None);
        assert_eq!(Cfa::from_name("gbrg"), Some(Cfa::GBRG));
    }

    #[test]
    fn the_layout_is_a_string_in_files() {
        assert_eq!(serde_json::to_string(&Cfa::GRBG).expect("serialises"), "\"GRBG\"");
        assert_eq!(serde_json::from_str::<Cfa>("\"BGGR\"").expect("parses"), Cfa::BGGR);
        assert!(serde_json::from_str::<Cfa>("\"XTRANS\"").is_err());
    }

    #[test]
    fn mosaic_vjp_is_the_transpose() {
        let rng = &mut fastrand::Rng::with_seed(1);
        for cfa in Cfa::ALL {
            let rgb = Array3::from_shape_fn((3, 5, 8), |_| rng.f64() - 0.5);
            let bar = Array2::from_shape_fn((5, 8), |_| rng.f64() - 0.5);
            let pushed = (&mosaic(rgb.view(), cfa) * &bar).sum();
            let pulled = (&rgb * &mosaic_vjp(bar.view(), cfa)).sum();
            assert!((pushed - pulled).abs() < 1e-13, "{cfa}: {pushed} {pulled}");
        }
        let rgb = Array3::from_shape_fn((3, 2, 2), |(k, _, _)| k);
        assert_eq!(mosaic(rgb.view(), Cfa::GBRG).into_raw_vec_and_offset().0, [1, 2, 0, 1]);
    }
}
