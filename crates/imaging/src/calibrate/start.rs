//! Where a fit begins: homographies of the pictures, and from them a focal length and poses (Zhang, IEEE TPAMI 22(11), 2000).

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, Matrix3};

use super::View;
use super::model::Pose;

/// The homography from board to picture by the direct linear transform, both sides normalised (Hartley); `None` where corners do not
/// tell one.
pub(super) fn homography(view: &View) -> Option<DMat3> {
    let normal = |points: &[DVec2]| {
        let n = points.len() as f64;
        let mean = points.iter().sum::<DVec2>() / n;
        let size = (points.iter().map(|p| (*p - mean).length_squared()).sum::<f64>() / (2.0 * n)).sqrt();
        (mean, size)
    };
    let ((from, size), (to, reach)) = (normal(&view.board), normal(&view.seen));
    if view.board.len() < 4 || !(size > 0.0 && reach > 0.0) {
        return None;
    }
    let mut moments = DMatrix::<f64>::zeros(9, 9);
    for (b, s) in view.board.iter().zip(&view.seen) {
        let (b, s) = ((*b - from) / size, (*s - to) / reach);
        for (row, value) in [(0, s.x), (1, s.y)] {
            let mut line = [0.0; 9];
            for (k, v) in [b.x, b.y, 1.0].into_iter().enumerate() {
                line[3 * row + k] = v;
                line[6 + k] = -value * v;
            }
            for (i, a) in line.iter().enumerate() {
                line.iter().enumerate().for_each(|(j, b)| moments[(i, j)] += a * b);
            }
        }
    }
    let eigen = moments.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(least);
    let between = DMat3::from_cols_array(&[h[0], h[3], h[6], h[1], h[4], h[7], h[2], h[5], h[8]]);
    let before =
        DMat3::from_cols_array(&[1.0 / size, 0.0, 0.0, 0.0, 1.0 / size, 0.0, -from.x / size, -from.y / size, 1.0]);
    let after = DMat3::from_cols_array(&[reach, 0.0, 0.0, 0.0, reach, 0.0, to.x, to.y, 1.0]);
    let found = after * between * before;
    found.is_finite().then_some(found)
}

/// The focal length, pixels, that makes the homographies views of a plane by square pixels; `None` where they do not tell it.
pub(super) fn focal_px(homographies: &[DMat3], centre_px: DVec2) -> Option<f64> {
    // With w = 1/f²: (a · b)₁₂ w + a₃ b₃ = 0 for the first two columns, and equal lengths of both; by least squares.
    let (mut top, mut bottom) = (0.0, 0.0);
    for h in homographies {
        let shift = DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -centre_px.x, -centre_px.y, 1.0]);
        let h = shift * *h;
        let (a, b) = (h.x_axis, h.y_axis);
        let size = a.truncate().length() * b.truncate().length();
        let flat = |u: DVec3, v: DVec3| u.truncate().dot(v.truncate()) / size;
        for (across, along) in
            [(flat(a, b), a.z * b.z / size), (flat(a, a) - flat(b, b), (a.z * a.z - b.z * b.z) / size)]
        {
            top -= across * along;
            bottom += across * across;
        }
    }
    let focal = (bottom / top).sqrt();
    (focal.is_finite() && focal > 0.0).then_some(focal)
}

/// The pose that a homography stands for.
pub(super) fn pose(homography: &DMat3, focal_px: f64, centre_px: DVec2) -> Option<Pose> {
    let inverse = DMat3::from_cols_array(&[
        1.0 / focal_px,
        0.0,
        0.0,
        0.0,
        1.0 / focal_px,
        0.0,
        -centre_px.x / focal_px,
        -centre_px.y / focal_px,
        1.0,
    ]);
    let h = inverse * *homography;
    let mut scale = 2.0 / (h.x_axis.length() + h.y_axis.length());
    // The board stands before the camera.
    if h.z_axis.z < 0.0 {
        scale = -scale;
    }
    let (a, b, at) = (h.x_axis * scale, h.y_axis * scale, h.z_axis * scale);
    let c = a.cross(b);
    let rough = Matrix3::from_columns(&[a, b, c].map(|v| nalgebra::Vector3::new(v.x, v.y, v.z)));
    let svd = rough.svd(true, true);
    let turn = svd.u? * svd.v_t?;
    let columns = [0, 1, 2].map(|k| DVec3::new(turn[(0, k)], turn[(1, k)], turn[(2, k)]));
    let turn = DMat3::from_cols(columns[0], columns[1], columns[2]);
    (turn.is_finite() && at.is_finite() && turn.determinant() > 0.0).then_some(Pose { turn, at })
}
