//! A planar scene, and parts of a frame.
//!
//! A scene is continuous: its texels carry a bilinear reconstruction, in every renderer alike; beyond its border the
//! nearest texel continues.

use ndarray::{Array3, ArrayView3, Axis, s};
use rayon::prelude::*;

use crate::frame::Frame;

pub use isoplanat_base::math::raster::mirrored;

/// A flat, self-luminous texture facing the lens.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Linear radiance `[channel, row, col]`, upright.
    pub texture: Array3<f32>,
    /// Texels per unit of object slope (object height over distance).
    pub texels_per_slope: f64,
    /// Texel coordinates `[column, row]` of the point on the optical axis (texel centres at +½).
    pub axis_texel: [f64; 2],
    /// 1/distance before the first vertex, 1/mm; 0 is infinity.
    pub vergence: f64,
}

impl Plane {
    /// Texel coordinates of the object slope `[right, up]`.
    pub fn texel_from_slope(&self, slope: [f64; 2]) -> [f64; 2] {
        [self.axis_texel[0] + slope[0] * self.texels_per_slope, self.axis_texel[1] - slope[1] * self.texels_per_slope]
    }

    /// The same scene with the mean of `n × n` texels in the place of each such block; at the last row and column of those that are left.
    #[must_use]
    pub(crate) fn averaged(&self, n: usize) -> Self {
        let (channels, rows, cols) = self.texture.dim();
        let mut texture = Array3::zeros((channels, rows.div_ceil(n), cols.div_ceil(n)));
        texture.axis_iter_mut(Axis(1)).into_par_iter().enumerate().for_each(|(i, mut row)| {
            for ((channel, j), v) in row.indexed_iter_mut() {
                let block = s![channel, i * n..rows.min((i + 1) * n), j * n..cols.min((j + 1) * n)];
                let block = self.texture.slice(block);
                let sum: f64 = block.iter().map(|v| f64::from(*v)).sum();
                *v = (sum / block.len() as f64) as f32;
            }
        });
        let scale = n as f64;
        Self {
            texture,
            texels_per_slope: self.texels_per_slope / scale,
            axis_texel: self.axis_texel.map(|v| v / scale),
            vergence: self.vergence,
        }
    }

    /// Bilinear radiance of `channel` at texel coordinates, and its derivatives with respect to them.
    ///
    /// ```
    /// use isoplanat_imaging::plane::Plane;
    /// use ndarray::array;
    ///
    /// let texture = array![[[0.0, 1.0]]];
    /// let scene = Plane { texture, texels_per_slope: 1.0, axis_texel: [1.0, 0.5], vergence: 0.0 };
    /// // Half way between the two texels' centres; the slope is one a texel.
    /// assert_eq!(scene.sample(0, [1.0, 0.5]), (0.5, [1.0, 0.0]));
    /// ```
    #[inline]
    pub fn sample(&self, channel: usize, texel: [f64; 2]) -> (f64, [f64; 2]) {
        bilinear(self.texture.index_axis(Axis(0), channel), texel)
    }
}

#[inline]
fn bilinear(t: ndarray::ArrayView2<'_, f32>, texel: [f64; 2]) -> (f64, [f64; 2]) {
    let (rows, cols) = t.dim();
    let axis = |x: f64, n: usize| -> (usize, usize, f64, f64) {
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let limit = n as f64 - 1.0;
        let x = x - 0.5;
        if !(x > 0.0 && x < limit) {
            let end = if x >= limit { n - 1 } else { 0 };
            return (end, end, 0.0, 0.0);
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside 0..limit")]
        let i = x as usize;
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let f = x - i as f64;
        (i, i + 1, f, 1.0)
    };
    let (c0, c1, fx, gx) = axis(texel[0], cols);
    let (r0, r1, fy, gy) = axis(texel[1], rows);
    let at = |r: usize, c: usize| f64::from(t[[r, c]]);
    let (a, b, c, d) = (at(r0, c0), at(r0, c1), at(r1, c0), at(r1, c1));
    let top = a + fx * (b - a);
    let bottom = c + fx * (d - c);
    let dx = (b - a) + fy * ((d - c) - (b - a));
    (top + fy * (bottom - top), [gx * dx, gy * (bottom - top)])
}

/// Channels `[channel, row, col]` with rows mirrored, columns mirrored, then rows and columns exchanged, as `turns` say; pictures that are
/// not square are not exchanged.
pub fn turned(mut channels: ArrayView3<'_, f32>, turns: [bool; 3]) -> Array3<f32> {
    let square = channels.dim().1 == channels.dim().2;
    if turns[0] {
        channels.invert_axis(Axis(1));
    }
    if turns[1] {
        channels.invert_axis(Axis(2));
    }
    if turns[2] && square {
        channels.swap_axes(1, 2);
    }
    channels.as_standard_layout().into_owned()
}

/// A rectangle of pixels in a frame (it may reach beyond it).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First row.
    pub row: isize,
    /// First column.
    pub col: isize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
}

impl Region {
    /// All of `frame`.
    pub fn whole(frame: &Frame) -> Self {
        Self { row: 0, col: 0, rows: frame.rows, cols: frame.columns }
    }

    /// The region with `margin` more pixels on every side.
    ///
    /// ```
    /// use isoplanat_imaging::plane::Region;
    ///
    /// let region = Region { row: 10, col: 0, rows: 4, cols: 8 };
    /// assert_eq!(region.grown(2), Region { row: 8, col: -2, rows: 8, cols: 12 });
    /// assert_eq!(region.grown(2).common(region), region);
    /// ```
    #[must_use]
    pub fn grown(self, margin: usize) -> Self {
        Self {
            row: self.row - margin.cast_signed(),
            col: self.col - margin.cast_signed(),
            rows: self.rows + 2 * margin,
            cols: self.cols + 2 * margin,
        }
    }

    /// The smallest region that holds both.
    #[must_use]
    pub fn around(self, other: Self) -> Self {
        let along = |a: isize, n: usize, b: isize, m: usize| {
            let (from, to) = (a.min(b), (a + n.cast_signed()).max(b + m.cast_signed()));
            (from, (to - from).unsigned_abs())
        };
        let ((row, rows), (col, cols)) =
            (along(self.row, self.rows, other.row, other.rows), along(self.col, self.cols, other.col, other.cols));
        Self { row, col, rows, cols }
    }

    /// The part inside `other`; without rows or columns where there is none.
    #[must_use]
    pub fn common(self, other: Self) -> Self {
        let along = |a: isize, n: usize, b: isize, m: usize| {
            let (from, to) = (a.max(b), (a + n.cast_signed()).min(b + m.cast_signed()));
            (from, (to - from).max(0).unsigned_abs())
        };
        let ((row, rows), (col, cols)) =
            (along(self.row, self.rows, other.row, other.rows), along(self.col, self.cols, other.col, other.cols));
        Self { row, col, rows, cols }
    }

    /// Smallest and largest distance from the axis, mm, of the region less `inset` pixels on every side: 0 for all of its
    /// points, ½ for its pixels' centres.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub(crate) fn radii_mm(self, frame: &Frame, inset: f64) -> [f64; 2] {
        let ends = |first: isize, count: usize, axis: f64| {
            let (a, b) = (first as f64 + inset - axis, (first + count.cast_signed()) as f64 - inset - axis);
            let nearest = if a <= 0.0 && b >= 0.0 { 0.0 } else { a.abs().min(b.abs()) };
            [nearest, a.abs().max(b.abs())]
        };
        let x = ends(self.col, self.cols, frame.axis_px[0]);
        let y = ends(self.row, self.rows, frame.axis_px[1]);
        [0, 1].map(|k| x[k].hypot(y[k]) * frame.pitch_mm)
    }

    /// Offset `[column, row]` in pixels from the frame's axis of the centre of the region's pixel `(i, j)`.
    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn offset(self, frame: &Frame, i: usize, j: usize) -> [f64; 2] {
        [
            (self.col + j.cast_signed()) as f64 + 0.5 - frame.axis_px[0],
            (self.row + i.cast_signed()) as f64 + 0.5 - frame.axis_px[1],
        ]
    }
}
