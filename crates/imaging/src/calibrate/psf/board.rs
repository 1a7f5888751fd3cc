//! The board as a lens without blur would show it.

use std::collections::HashSet;

use glam::{DVec2, DVec3};
use ndarray::Array2;

use crate::calibrate::View;
use crate::calibrate::model::{Pinhole, Pose};

/// Cells along a pixel's side of the board's picture.
const FINE: usize = 8;
/// Part of a square around a corner within which pixels are looked at: what blurs into them comes from the four squares about the corner.
pub(super) const NEAR: f64 = 0.5;

/// Farthest that pixels are looked at from a corner along columns and rows.
fn largest_px(reach_px: f64) -> f64 {
    8.0 + 3.0 * reach_px
}

/// Bytes of the picture of the board about a corner, at most.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded")]
pub(super) fn picture_bytes(reach_px: f64) -> usize {
    let side = (2.0 * (largest_px(reach_px) + reach_px + 4.0)).ceil() as usize * FINE;
    side * side * size_of::<f64>()
}

/// Where a picture's pixels lie on the board.
#[derive(Clone, Debug)]
pub(super) struct Board {
    camera: Pinhole,
    max_slope: f64,
    /// Board from camera.
    turn: glam::DMat3,
    origin: DVec3,
    corners: HashSet<[i64; 2]>,
    list: Vec<Corner>,
    /// Columns and rows `[low, high]` of the picture that its corners and a square around them span.
    pub(super) span: [[f64; 2]; 2],
}

/// A corner of the board.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    /// Its place on the board.
    pub(super) place: [i64; 2],
    /// 0 or 1, as on the squares of a board.
    pub(super) parity: usize,
    /// Where it lands.
    pub(super) at: DVec2,
    /// Smaller and larger side of a square about it, pixels.
    pub(super) side_px: [f64; 2],
}

impl Corner {
    /// How far from it pixels are looked at along columns and rows: those nearest to it (sheared squares reach farther than half a side), of large
    /// squares a part.
    pub(super) fn around_px(&self, reach_px: f64) -> f64 {
        (1.5 * NEAR * self.side_px[1]).min(largest_px(reach_px))
    }

    /// Whether some of those lie between two radii about `centre`.
    pub(super) fn meets(&self, ring: [f64; 2], centre: DVec2, reach_px: f64) -> bool {
        let (radius, far) = (self.at.distance(centre), 1.5 * self.around_px(reach_px));
        radius + far >= ring[0] && radius - far <= ring[1]
    }
}

/// Nearest corner, and the way there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) corner: [i64; 2],
    /// From the corner, squares.
    pub(super) off: DVec2,
    /// Which of the two colours.
    pub(super) even: bool,
}

impl Board {
    pub(super) fn new(camera: &Pinhole, max_slope: f64, view: &View, pose: &Pose) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "whole numbers")]
        let corners: HashSet<[i64; 2]> = view.board.iter().map(|b| [b.x.round() as i64, b.y.round() as i64]).collect();
        let turn = pose.turn.transpose();
        let mut board = Self {
            camera: *camera,
            max_slope,
            turn,
            origin: turn * pose.at,
            corners,
            list: Vec::new(),
            span: [[f64::INFINITY, f64::NEG_INFINITY]; 2],
        };
        let land = |b: DVec2| camera.project(b, pose).map(|p| p.0);
        let side = |b: DVec2, along: DVec2| match (land(b - 0.5 * along), land(b + 0.5 * along)) {
            (Some(from), Some(to)) => from.distance(to),
            _ => 0.0,
        };
        let corner = |b: &DVec2| {
            let [x, y] = [side(*b, DVec2::X), side(*b, DVec2::Y)];
            #[expect(clippy::cast_possible_truncation, reason = "whole numbers")]
            let place = [b.x.round() as i64, b.y.round() as i64];
            let parity = usize::from((place[0] + place[1]) % 2 != 0);
            Some(Corner { place, parity, at: land(*b)?, side_px: [x.min(y), x.max(y)] })
        };
        board.list = view.board.iter().filter_map(corner).collect();
        for corner in &view.board {
            for at in around(*corner) {
                let Some((landed, _)) = camera.project(at, pose) else { continue };
                for (range, v) in board.span.iter_mut().zip(landed.to_array()) {
                    *range = [range[0].min(v), range[1].max(v)];
                }
            }
        }
        board
    }

    /// Board coordinates of a point of the picture, squares.
    fn place(&self, at: DVec2) -> DVec2 {
        let along = self.turn * self.camera.slope(at, self.max_slope).extend(1.0);
        (self.origin.z / along.z * along - self.origin).truncate()
    }

    /// What lies at a place of the board, if it is near a corner that was found.
    fn spot_of(&self, place: DVec2) -> Option<Spot> {
        if place.abs().max_element().is_nan() || place.abs().max_element() > 1e6 {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "bounded")]
        let corner = [place.x.round() as i64, place.y.round() as i64];
        if !self.corners.contains(&corner) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "bounded")]
        let square = [place.x.floor() as i64, place.y.floor() as i64];
        Some(Spot { corner, off: place - place.round(), even: (square[0] + square[1]) % 2 == 0 })
    }

    /// How far a point of the picture is from the board's next lines, pixels; `None` where no corner is near.
    pub(super) fn clear_px(&self, at: DVec2) -> Option<(Spot, f64)> {
        let place = self.place(at);
        let spot = self.spot_of(place)?;
        let [x, y] = [self.place(at + DVec2::X) - place, self.place(at + DVec2::Y) - place];
        let across = |off: f64, by: DVec2| off.abs() / by.length();
        let clear = across(spot.off.x, DVec2::new(x.x, y.x)).min(across(spot.off.y, DVec2::new(x.y, y.y)));
        Some((spot, clear))
    }

    /// Its corners.
    pub(super) fn corners(&self) -> impl Iterator<Item = &Corner> {
        self.list.iter()
    }

    /// The picture of the board over `columns` and `rows` pixels from the pixel `from` `[column, row]`: 1 where squares are even, 0 where they are odd.
    #[expect(clippy::cast_precision_loss, reason = "places in a picture")]
    pub(super) fn picture(&self, from: [isize; 2], [columns, rows]: [usize; 2]) -> Ideal {
        let first = DVec2::new(from[0] as f64, from[1] as f64);
        // At the pixels' corners; between them the camera is straight.
        let nodes =
            Array2::from_shape_fn((rows + 1, columns + 1), |(r, c)| self.place(first + DVec2::new(c as f64, r as f64)));
        let mut sums = Array2::<f64>::zeros((rows * FINE + 1, columns * FINE + 1));
        let cell = (FINE as f64).recip();
        for i in 0..rows * FINE {
            let (r, y) = (i / FINE, ((i % FINE) as f64 + 0.5) * cell);
            let mut row = 0.0;
            for j in 0..columns * FINE {
                let (c, x) = (j / FINE, ((j % FINE) as f64 + 0.5) * cell);
                let corners = [nodes[[r, c]], nodes[[r, c + 1]], nodes[[r + 1, c]], nodes[[r + 1, c + 1]]];
                let (top, bottom) = (corners[0].lerp(corners[1], x), corners[2].lerp(corners[3], x));
                let at = top.lerp(bottom, y);
                let by = [corners[1] - corners[0], corners[2] - corners[0]];
                row += covered(at, by, cell);
                sums[[i + 1, j + 1]] = sums[[i, j + 1]] + row;
            }
        }
        Ideal { from: first, sums }
    }
}

/// A square around a corner.
fn around(corner: DVec2) -> [DVec2; 4] {
    [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]].map(|o| corner + DVec2::from(o))
}

/// How much of a cell (a part `cell` of a pixel) about a board point lies on even squares; `by` is how the board moves with column and row.
fn covered(at: DVec2, by: [DVec2; 2], cell: f64) -> f64 {
    // A square wave along each axis, its edges as wide as the cell; even squares are where both have one sign.
    let wave = |v: f64, across: f64| {
        let off = v - v.round();
        let sign = if (v.round() as i64).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
        sign * (2.0 * off / (cell * across)).clamp(-1.0, 1.0)
    };
    let (x, y) = (wave(at.x, by[0].x.hypot(by[1].x)), wave(at.y, by[0].y.hypot(by[1].y)));
    0.5 * (1.0 + x * y)
}

/// A picture of the board, added up from its first cell.
pub(super) struct Ideal {
    from: DVec2,
    sums: Array2<f64>,
}

impl Ideal {
    /// The mean over a pixel centred at a point.
    #[inline]
    pub(super) fn pixel(&self, at: DVec2) -> f64 {
        let low = (at - self.from - 0.5) * FINE as f64;
        let high = low + FINE as f64;
        let sum = |x: f64, y: f64| self.sum(x, y);
        (sum(high.x, high.y) - sum(low.x, high.y) - sum(high.x, low.y) + sum(low.x, low.y)) / (FINE * FINE) as f64
    }

    #[inline]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss, reason = "clamped")]
    fn sum(&self, x: f64, y: f64) -> f64 {
        let (rows, columns) = self.sums.dim();
        let split = |v: f64, n: usize| {
            let v = v.clamp(0.0, (n - 1) as f64);
            let i = (v as usize).min(n - 2);
            (i, v - i as f64)
        };
        let ((c, x), (r, y)) = (split(x, columns), split(y, rows));
        let s = &self.sums;
        let (top, bottom) =
            (s[[r, c]] * (1.0 - x) + s[[r, c + 1]] * x, s[[r + 1, c]] * (1.0 - x) + s[[r + 1, c + 1]] * x);
        top * (1.0 - y) + bottom * y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    /// Pixels of a tilted board agree with the board counted at many points of each; points come back from where they land.
    #[test]
    fn pictures_are_the_boards() {
        let camera = Pinhole { focal_px: DVec2::splat(300.0), centre_px: DVec2::new(60.0, 50.0), k: [-0.2, 0.05, 0.0] };
        let turn = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(-0.2) * DMat3::from_rotation_z(0.15);
        let pose = Pose { turn, at: DVec3::new(-1.5, -1.2, 14.0) };
        let board: Vec<DVec2> = (0..16).map(|i| DVec2::new(f64::from(i % 4), f64::from(i / 4))).collect();
        let seen = board.iter().map(|b| camera.project(*b, &pose).expect("before it").0).collect();
        let view = View { board, seen };
        let model = Board::new(&camera, 0.5, &view, &pose);
        for (b, s) in view.board.iter().zip(&view.seen) {
            assert!(model.place(*s).distance(*b) < 1e-9);
            let (spot, clear) = model.clear_px(*s + 0.01).expect("near");
            assert_eq!([spot.corner[0] as f64, spot.corner[1] as f64], b.to_array());
            assert!(clear < 0.011, "{clear}");
        }
        assert!(model.clear_px(DVec2::new(-60.0, 40.0)).is_none());
        let ideal = model.picture([20, 20], [60, 50]);
        let (mut worst, mut square) = (0.0f64, 0.0);
        for r in 0..50 {
            for c in 0..60 {
                // Off the grid of cells.
                let at = DVec2::new(20.37 + f64::from(c).min(58.0), 20.81 + f64::from(r).min(48.0)) + 0.5;
                let mut even = 0;
                for k in 0..400 {
                    let p = at + DVec2::new(f64::from(k % 20) + 0.5, f64::from(k / 20) + 0.5) / 20.0 - 0.5;
                    let place = model.place(p);
                    even += i32::from((place.x.floor() + place.y.floor()).rem_euclid(2.0) == 0.0);
                }
                let off = ideal.pixel(at) - f64::from(even) / 400.0;
                worst = worst.max(off.abs());
                square += off * off;
            }
        }
        let rms = (square / 3000.0).sqrt();
        // The count itself is good to some thousandths.
        assert!(worst < 0.04 && rms < 4e-3, "{worst} {rms}");
    }
}
