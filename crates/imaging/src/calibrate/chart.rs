//! Corners of a chessboard in a picture (crate `calib-targets-chessboard`): partial boards count.

use std::panic::catch_unwind;

use calib_targets_chessboard::{
    ChessboardDetection, ChessboardDetector, ChessboardParams, GrayImageView, default_chess_config, detect_corners,
};
use glam::DVec2;
use ndarray::ArrayView2;

use super::View;
use crate::develop::color::srgb_from_linear;
use isoplanat_base::error::{Error, Result};

/// Corners that a picture must show at least, and of how many rows and columns.
const LEAST: usize = 12;
const LEAST_LINES: usize = 3;
/// Pixels of a side at least: of less, no board can be told.
const SIDE: usize = 32;
/// Share of the pixels that may be brighter than white.
const ABOVE_WHITE: f64 = 0.005;

/// The largest chessboard in `grey` (linear light, any scale).
///
/// # Errors
/// A picture that shows fewer than twelve corners of three rows and columns, or has less than 32 pixels a side; its file is not named yet.
pub fn find(grey: ArrayView2<'_, f64>) -> Result<View> {
    let (rows, columns) = grey.dim();
    if rows.min(columns) < SIDE {
        let allowed = format!("{SIDE} a side at least");
        return Err(Error::bad("", "size", format!("{columns} × {rows} pixels"), allowed));
    }
    let white = white(grey);
    let refused = |found: String| {
        let allowed = format!("a chessboard of which {LEAST} inner corners of {LEAST_LINES} rows and columns are seen");
        Error::bad("", "chart", found, allowed)
    };
    if white.is_nan() || white <= 0.0 {
        return Err(refused("a black picture".into()));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rounded to 8 bits")]
    let bytes: Vec<u8> = grey.iter().map(|v| (255.0 * srgb_from_linear((v / white) as f32) + 0.5) as u8).collect();
    // Whatever the finder meets in a picture, the other pictures go on.
    let found = catch_unwind(|| best(&GrayImageView { width: columns, height: rows, data: &bytes }));
    let (count, best) = found.map_err(|_| refused("a picture that the corner finder breaks off at".into()))?;
    let Some(best) = best else { return Err(refused(format!("{count} corners and no board"))) };
    // The crate counts from the centre of the first pixel.
    let view = View {
        board: best.corners.iter().map(|c| DVec2::new(f64::from(c.grid.u), f64::from(c.grid.v))).collect(),
        seen: best
            .corners
            .iter()
            .map(|c| DVec2::new(f64::from(c.position.x) + 0.5, f64::from(c.position.y) + 0.5))
            .collect(),
    };
    let lines = [0, 1].map(|axis| {
        let all: std::collections::BTreeSet<u64> = view.board.iter().map(|b| b[axis].to_bits()).collect();
        all.len()
    });
    if view.seen.len() < LEAST || lines.iter().any(|n| *n < LEAST_LINES) {
        return Err(refused(format!("{} corners of {} × {} lines", view.seen.len(), lines[0], lines[1])));
    }
    Ok(view)
}

/// How many corners there are, and the board with the most of them, strict settings first.
fn best(view: &GrayImageView<'_>) -> (usize, Option<ChessboardDetection>) {
    let corners = detect_corners(view, &default_chess_config());
    let boards = ChessboardParams::sweep_default().into_iter().filter_map(|settings| {
        let detector = ChessboardDetector::new(settings).ok()?;
        detector.detect(&corners)
    });
    (corners.len(), boards.reduce(|a, b| if b.corners.len() > a.corners.len() { b } else { a }))
}

/// The level that few pixels exceed.
fn white(grey: ArrayView2<'_, f64>) -> f64 {
    let mut all: Vec<f64> = grey.iter().copied().filter(|v| v.is_finite()).collect();
    if all.is_empty() {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in the list")]
    let place = ((all.len() as f64 * (1.0 - ABOVE_WHITE)) as usize).min(all.len() - 1);
    *all.select_nth_unstable_by(place, f64::total_cmp).1
}
