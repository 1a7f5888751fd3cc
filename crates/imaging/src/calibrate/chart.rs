//! Corners of a chessboard in a picture (crate `calib-targets-chessboard`): partial boards count.
//!
//! The board is found from corners at the middle of their response, which finds most. Each then goes to the saddle point of the light about it
//! (a quadratic surface, centred anew until it stays), over as many pixels as the squares leave: four times closer than the response.

use std::panic::catch_unwind;

use calib_targets_chessboard::{
    ChessboardDetection, ChessboardDetector, ChessboardParams, GrayImageView, default_chess_config, detect_corners,
};
use calib_targets_core::ImageRefiner;
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

/// Half sides of the saddle's window, pixels: no less tells a saddle from noise, more gains little.
const WINDOW: [i32; 2] = [1, 3];
/// Windows' half sides that fit between neighbouring corners: none sees a corner beside its own.
const BETWEEN: f32 = 3.0;
/// How far a saddle may lie from the middle of the response, pixels; farther it is another corner.
const NEAR: f32 = 1.5;

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
    let found = catch_unwind(|| {
        let view = GrayImageView { width: columns, height: rows, data: &bytes };
        let (count, board) = best(&view);
        (count, board.map(|b| refined(&view, b)))
    });
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

/// The board with its corners at saddle points of the light; a corner without one stays where it is.
fn refined(view: &GrayImageView<'_>, mut board: ChessboardDetection) -> ChessboardDetection {
    let places: Vec<_> = board.corners.iter().map(|c| (c.grid.u, c.grid.v, c.position)).collect();
    // The nearest neighbours along rows and columns.
    let spacing = places.iter().flat_map(|a| {
        let beside = places.iter().filter(|b| (a.0 - b.0).abs() + (a.1 - b.1).abs() == 1);
        beside.map(|b| (a.2.x - b.2.x).hypot(a.2.y - b.2.y))
    });
    let least = spacing.fold(f32::INFINITY, f32::min);
    #[expect(clippy::cast_possible_truncation, reason = "clamped")]
    let radius = ((least / BETWEEN) as i32 - 1).min(WINDOW[1]);
    let mut refiner = ImageRefiner::saddle_point();
    match &mut refiner {
        ImageRefiner::SaddlePoint(settings) if radius >= WINDOW[0] => settings.radius = radius,
        _ => return board,
    }
    let saddles = detect_corners(view, &default_chess_config().with_refiner(refiner));
    for corner in &mut board.corners {
        let off = |p: &calib_targets_chessboard::ChessCorner| {
            (p.position.x - corner.position.x).hypot(p.position.y - corner.position.y)
        };
        if let Some(saddle) = saddles.iter().min_by(|a, b| off(a).total_cmp(&off(b))).filter(|s| off(s) <= NEAR) {
            corner.position = saddle.position;
        }
    }
    board
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::doubt::{judge, noise};
    use crate::calibrate::solve::{Fit, Settings, solve};
    use crate::files::read_sensor_planes;
    use isoplanat_base::testing::shared;

    const PLAIN: Settings =
        Settings { size: [960, 640], terms: 3, centre_px: None, focal_px: None, oblong_pixels: false };

    /// The boards of a folder's pictures, as the sensor has them.
    fn boards(folder: &str) -> Option<Vec<View>> {
        let folder = shared(folder)?;
        let mut paths: Vec<_> =
            std::fs::read_dir(folder).expect("lists").map(|e| e.expect("an entry").path()).collect();
        paths.sort();
        let look = |p: &std::path::PathBuf| {
            let planes = read_sensor_planes(p, None).expect("reads").values;
            find(planes.mean_axis(ndarray::Axis(0)).expect("channels").view()).expect("a board")
        };
        Some(paths.iter().map(look).collect())
    }

    fn judged(views: &[View], fit: &Fit) -> Result<Vec<String>> {
        let names: Vec<String> = (0..views.len()).map(|k| k.to_string()).collect();
        judge(views, &names, &PLAIN, fit)
    }

    /// Pictures by a known camera, pixels 1.1 times as high as wide: corners closer than another program's (0.065 px by 11 × 11 pixels), and
    /// square pixels refused by the ratio.
    #[test]
    fn corners_are_refined_and_oblong_pixels_refused() {
        let Some(views) = boards("cases/anisotropic") else { return };
        let fit = solve(&views, &Settings { oblong_pixels: true, ..PLAIN }).expect("fits");
        assert!(fit.rms_px() < 0.05, "{} px", fit.rms_px());
        let own = noise(&views, &fit.residuals).expect("corners");
        assert!(own > 0.5 * fit.rms_px() && own < 1.5 * fit.rms_px(), "{own} of {}", fit.rms_px());
        for (found, truth, error) in [
            (fit.camera.focal_px.x, 900.0, fit.errors.focal_px.x),
            (fit.camera.focal_px.y, 990.0, fit.errors.focal_px.y),
        ] {
            assert!((found - truth).abs() < 3.0 * error && error < 1.0, "{found} ± {error}, {truth}");
        }
        let error = judged(&views, &solve(&views, &PLAIN).expect("fits")).expect_err("oblong").to_string();
        assert!(error.contains("not square") && error.contains("900") && error.contains("990"), "{error}");
    }

    /// Every second picture says that it is to be turned: the sensor is one.
    #[test]
    fn orientation_is_not_the_sensors() {
        let Some(views) = boards("cases/exif180") else { return };
        let fit = solve(&views, &PLAIN).expect("fits");
        let (focal, centre) = (fit.camera.focal_px.x, fit.camera.centre_px);
        assert!((focal - 900.0).abs() < 3.0 * fit.errors.focal_px.x + 0.1, "{focal} ± {}", fit.errors.focal_px.x);
        let off = (centre - DVec2::new(560.0, 260.0)).abs();
        assert!(off.cmple(3.0 * fit.errors.centre_px + 0.1).all(), "{centre} ± {}", fit.errors.centre_px);
        assert_eq!(judged(&views, &fit).expect("passes"), Vec::<String>::new());
    }
}
