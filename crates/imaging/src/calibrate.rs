//! Real cameras: the distortion of a lens from photographs of a chessboard (paper §4.1), its relative illumination and the sensor's levels and noise from
//! flat and dark frames; each as one file.
//!
//! [`chart`] finds the corners, [`solve`] fits the lens and where it stood before every picture, [`doubt`] says whether corners lie where it lands
//! them, [`mod@file`] keeps the result. [`transfer`] measures the
//! sensor, [`shading`] the lens's falling light, [`psf`] its point spread functions; [`lens`] is all of a lens as image formation reads it.
//! All in pixels of the pictures; pixel (row `i`, column `j`) has its centre at `(j + ½, i + ½)`, as in [`crate::frame`].

#[cfg(feature = "calibrate")]
pub mod chart;
pub mod doubt;
pub mod file;
pub mod lens;
pub mod model;
pub mod psf;
pub mod shading;
pub mod solve;
mod start;
pub mod transfer;

use glam::DVec2;

/// The corners that one picture shows.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Place on the board, in squares (from any corner of it).
    pub board: Vec<DVec2>,
    /// Place in the picture, `(column, row)` in pixels.
    pub seen: Vec<DVec2>,
}

impl View {
    /// How far the pictures of the board's lines are from straight: root mean square distance of their corners, at `at`, from the best
    /// straight line through each row and column of four and more, in the unit of `at`.
    pub fn bend(&self, at: &[DVec2]) -> f64 {
        let (mut square, mut count) = (0.0, 0.0);
        for axis in 0..2 {
            let mut lines: std::collections::BTreeMap<i64, Vec<DVec2>> = std::collections::BTreeMap::new();
            for (b, p) in self.board.iter().zip(at) {
                lines.entry(b[axis].round() as i64).or_default().push(*p);
            }
            for points in lines.values().filter(|l| l.len() >= 4) {
                let n = points.len() as f64;
                let mean = points.iter().sum::<DVec2>() / n;
                let [xx, xy, yy] = points
                    .iter()
                    .map(|p| *p - mean)
                    .fold([0.0; 3], |[a, b, c], d| [a + d.x * d.x, b + d.x * d.y, c + d.y * d.y]);
                // The smaller moment is the sum of squares across the line.
                let half = 0.5 * (xx - yy);
                square += 0.5 * (xx + yy) - half.hypot(xy);
                count += n;
            }
        }
        if count > 0.0 { (square.max(0.0) / count).sqrt() } else { 0.0 }
    }
}
