//! The camera that photographs charts: a pinhole with radial distortion (paper eqs. 10–11), and a pose a picture.
//!
//! A board point `X` (squares, in its plane) stands at `R X + t` before the camera. Its slopes `x` are distorted by
//! `1 + k₁ r² + k₂ r⁴ + k₃ r⁶`, `r = |x|`, and land at `c + f x` in the picture, `f` in pixels, `c` the centre of distortion. Not
//! covered: decentring and tilt (tangential terms).

use glam::{DMat2, DMat3, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};

use crate::develop::distortion::Distortion;

/// Radial terms at most.
pub(crate) const TERMS: usize = 3;
/// Numbers of the camera: two focal lengths, centre, terms.
pub(crate) const INNER: usize = 4 + TERMS;
/// Numbers of a pose: a small turn, a shift.
pub(crate) const OUTER: usize = 6;

/// The camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal length along columns and rows, pixels; equal where pixels are square.
    pub focal_px: DVec2,
    /// Centre of distortion, `(column, row)`.
    pub centre_px: DVec2,
    /// `k₁, k₂, k₃`.
    pub k: [f64; TERMS],
}

/// Where the board stood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Board to camera, a rotation.
    pub turn: DMat3,
    /// The board's origin before the camera, squares.
    pub at: DVec3,
}

/// What the radial polynomial is of: slopes, as in every file, or angles, by which a fisheye is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Projection {
    /// Of the tangent of the field angle.
    Tangent,
    /// Of the field angle itself (equidistant).
    Angle,
}

impl Projection {
    /// A slope in what the polynomial is of, and its derivative.
    pub(crate) fn of(self, slope: DVec2) -> (DVec2, DMat2) {
        if self == Self::Tangent {
            return (slope, DMat2::IDENTITY);
        }
        let square = slope.length_squared();
        // θ/r and its derivative by r², twice; series where differences would be rounded away.
        let (ratio, twice) = if square > 1e-4 {
            let r = square.sqrt();
            let ratio = r.atan() / r;
            (ratio, ((1.0 + square).recip() - ratio) / square)
        } else {
            (1.0 - square / 3.0 + square * square / 5.0, -2.0 / 3.0 + 0.8 * square)
        };
        let outer = DMat2::from_cols(slope * slope.x, slope * slope.y);
        (ratio * slope, DMat2::from_diagonal(DVec2::splat(ratio)) + twice * outer)
    }
}

/// Derivatives of a landing by the numbers of the camera and of the pose, rows column and row.
pub(crate) type Jacobian = (SMatrix<f64, 2, INNER>, SMatrix<f64, 2, OUTER>);

impl Pinhole {
    /// `1 + k₁ r² + k₂ r⁴ + k₃ r⁶` of a squared slope, and its derivative by that.
    fn scale(&self, square: f64) -> (f64, f64) {
        let [a, b, c] = self.k;
        (1.0 + square * (a + square * (b + square * c)), a + square * (2.0 * b + square * 3.0 * c))
    }

    /// Where slopes land.
    pub fn land(&self, slope: DVec2) -> DVec2 {
        self.centre_px + self.focal_px * (self.scale(slope.length_squared()).0 * slope)
    }

    /// Growth of the image's height with the slope, over the focal length; not positive where the picture folds.
    pub fn growth(&self, slope: f64) -> f64 {
        let (scale, by) = self.scale(slope * slope);
        scale + 2.0 * slope * slope * by
    }

    /// The first of 257 slopes from 0 to `most` at which the image's height does not grow.
    pub(crate) fn folds(&self, most: f64) -> Option<f64> {
        let grows = |r: &f64| self.growth(*r).is_finite() && self.growth(*r) > 0.0;
        (0..=256).map(|i| most * f64::from(i) / 256.0).find(|r| !grows(r))
    }

    /// The radial polynomial for a focal length of 1, known up to `max_slope` and continued linearly beyond it.
    pub fn distortion(&self, max_slope: f64) -> Distortion {
        let (r, [a, b, c]) = (max_slope, self.k);
        let coefficients_mm = [r, a * r.powi(3), b * r.powi(5), c * r.powi(7)];
        Distortion { max_slope, coefficients_mm, residual_mm: 0.0 }
    }

    /// Slopes of what lands at a point; beyond `max_slope` the polynomial is continued linearly.
    pub fn slope(&self, at: DVec2, max_slope: f64) -> DVec2 {
        let bent = (at - self.centre_px) / self.focal_px;
        let height = bent.length();
        if height > 0.0 { bent * (self.distortion(max_slope).slope_from_sensor(height) / height) } else { DVec2::ZERO }
    }

    /// Slopes of a board point; `None` where it is not before the camera.
    pub fn slopes(board: DVec2, pose: &Pose) -> Option<DVec2> {
        let at = pose.turn * board.extend(0.0) + pose.at;
        (at.z > 0.0).then(|| at.truncate() / at.z)
    }

    /// Where a board point lands, and how that changes.
    pub fn project(&self, board: DVec2, pose: &Pose) -> Option<(DVec2, Jacobian)> {
        self.project_by(Projection::Tangent, board, pose)
    }

    /// As [`Self::project`], the polynomial of what `projection` says.
    pub(crate) fn project_by(&self, projection: Projection, board: DVec2, pose: &Pose) -> Option<(DVec2, Jacobian)> {
        let turned = pose.turn * board.extend(0.0);
        let at = turned + pose.at;
        if at.z.is_nan() || at.z <= 0.0 {
            return None;
        }
        let slope = at.truncate() / at.z;
        let (x, bent) = projection.of(slope);
        let square = x.length_squared();
        let (scale, by) = self.scale(square);
        let landed = self.centre_px + self.focal_px * (scale * x);
        let mut inner = SMatrix::<f64, 2, INNER>::zeros();
        let mut outer = SMatrix::<f64, 2, OUTER>::zeros();
        for row in 0..2 {
            inner[(row, row)] = scale * x[row];
            inner[(row, 2 + row)] = 1.0;
            let mut power = square;
            for term in 0..TERMS {
                inner[(row, 4 + term)] = self.focal_px[row] * x[row] * power;
                power *= square;
            }
            // By the point in space: through slopes, then distortion.
            let by_bent = [0, 1].map(|k| 2.0 * by * x[row] * x[k] + if k == row { scale } else { 0.0 });
            let by_slope = bent.transpose() * DVec2::from(by_bent);
            let by_point = DVec3::new(by_slope.x, by_slope.y, -by_slope.dot(slope)) * self.focal_px[row] / at.z;
            // A small turn δ moves the point by δ × (R X).
            let by_turn = turned.cross(by_point);
            for k in 0..3 {
                outer[(row, k)] = by_turn[k];
                outer[(row, 3 + k)] = by_point[k];
            }
        }
        Some((landed, (inner, outer)))
    }
}

impl Pose {
    /// After a small turn (about the camera's axes) and a shift.
    #[must_use]
    pub(crate) fn moved(&self, step: &SVector<f64, OUTER>) -> Self {
        let turn = DVec3::new(step[0], step[1], step[2]);
        let angle = turn.length();
        let by = if angle > 0.0 { DMat3::from_axis_angle(turn / angle, angle) } else { DMat3::IDENTITY };
        Self { turn: by * self.turn, at: self.at + DVec3::new(step[3], step[4], step[5]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel, between};

    /// Every column against central differences; slopes come back from their landings.
    #[test]
    fn landings_have_their_derivatives() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for _ in 0..20 {
            let camera = Pinhole {
                focal_px: DVec2::new(900.0, 940.0),
                centre_px: DVec2::new(630.0, 350.0),
                k: [between(rng, -0.3, 0.1), between(rng, -0.05, 0.1), between(rng, -0.02, 0.02)],
            };
            let mut step = SVector::<f64, OUTER>::zeros();
            step.iter_mut().for_each(|v| *v = between(rng, -0.6, 0.6));
            let pose = Pose { turn: DMat3::IDENTITY, at: DVec3::new(-3.0, -2.0, 14.0) }.moved(&step);
            let board = DVec2::new(between(rng, 0.0, 8.0), between(rng, 0.0, 5.0));
            let projection = [Projection::Tangent, Projection::Angle][usize::from(rng.bool())];
            let project = |c: &Pinhole, pose: &Pose| c.project_by(projection, board, pose).expect("before the camera");
            let (_, (inner, outer)) = project(&camera, &pose);
            let land = |camera: &Pinhole, pose: &Pose| project(camera, pose).0;
            let moved = |column: usize, h: f64| {
                let mut c = camera;
                match column {
                    0 | 1 => c.focal_px[column] += h,
                    2 | 3 => c.centre_px[column - 2] += h,
                    _ => c.k[column - 4] += h,
                }
                c
            };
            for column in 0..INNER {
                // Landings are linear in each of these.
                let h = 1e-2;
                let d = (land(&moved(column, h), &pose) - land(&moved(column, -h), &pose)) / (2.0 * h);
                (0..2).for_each(|row| assert_rel(inner[(row, column)], d[row], 1e-7, 1e-4, "camera"));
            }
            for column in 0..OUTER {
                let shifted = |h: f64| {
                    let mut by = SVector::<f64, OUTER>::zeros();
                    by[column] = h;
                    land(&camera, &pose.moved(&by))
                };
                // Some hundred pixels a unit; these differences of pixels are rounded by 5e-9.
                let d = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
                (0..2).for_each(|row| assert_rel(outer[(row, column)], d[row], 1e-7, 1.0, "pose"));
            }
            let slope = DVec2::new(between(rng, -0.5, 0.5), between(rng, -0.5, 0.5));
            let back = camera.slope(camera.land(slope), 0.75);
            assert_abs((back - slope).length(), 0.0, 1e-14, "slope");
        }
    }
}
