//! A colour chart: 24 patches of published colour on a grey ground.
//!
//! The colours are the sRGB values (8 bit, D65) of the ColorChecker Classic as its maker GretagMacbeth stated them, from D. Pascale,
//! "RGB coordinates of the Macbeth ColorChecker", BabelColor, 2006. The picture keeps them as they are: it is not exposed.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, Rgb};
use super::palette::between;
use crate::develop::color::linear_from_srgb;

/// Patches in a row and in a column.
const COLUMNS: usize = 6;
const ROWS: usize = 4;

/// Row by row: natural colours, mixed ones, primaries, greys from white to black.
const PATCHES: [[u8; 3]; COLUMNS * ROWS] = [
    [115, 82, 68],
    [194, 150, 130],
    [98, 122, 157],
    [87, 108, 67],
    [133, 128, 177],
    [103, 189, 170],
    [214, 126, 44],
    [80, 91, 166],
    [193, 90, 99],
    [94, 60, 108],
    [157, 188, 64],
    [224, 163, 46],
    [56, 61, 150],
    [70, 148, 73],
    [175, 54, 60],
    [231, 199, 31],
    [187, 86, 149],
    [8, 133, 161],
    [243, 243, 242],
    [200, 200, 200],
    [160, 160, 160],
    [122, 122, 121],
    [85, 85, 85],
    [52, 52, 52],
];

/// Side of a patch, of the distance of two.
const PATCH: f32 = 0.84;

/// Reflectance of the chart's board.
const BOARD: Rgb = [0.02; 3];

fn linear(srgb: [u8; 3]) -> Rgb {
    srgb.map(|v| linear_from_srgb(f32::from(v) / 255.0))
}

/// Paints a chart that nearly fills the picture; the seed turns and moves it a little and chooses the ground's grey.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let (width, height) = (cols as f32, rows as f32);
    let ground = [between(rng, 0.25, 0.4); 3];
    let mut canvas = Canvas::filled(rows, cols, |_, _| ground);
    let pitch = (width / COLUMNS as f32).min(height / ROWS as f32) * between(rng, 0.84, 0.9);
    let centre = [width, height].map(|side| side * between(rng, 0.49, 0.51));
    let angle = between(rng, -0.03, 0.03);
    let frame = Frame::new(centre, angle);
    let half = [COLUMNS, ROWS].map(|n| 0.5 * pitch * n as f32);
    let rectangle = |frame: Frame, [a, b]: [f32; 2]| {
        move |x: f32, y: f32| {
            let [u, v] = frame.local(x, y);
            (u.abs() - a).max(v.abs() - b)
        }
    };
    let board = half.map(|h| h + 0.1 * pitch);
    canvas.over(centre, [board[0].hypot(board[1]); 2], rectangle(frame, board), |_, _| BOARD);
    for (i, colour) in PATCHES.into_iter().enumerate() {
        let [u, v] = [i % COLUMNS, i / COLUMNS].map(|k| pitch * (k as f32 + 0.5));
        let own = Frame::new(frame.place(u - half[0], v - half[1]), angle);
        let colour = linear(colour);
        canvas.over(own.origin, [PATCH * pitch; 2], rectangle(own, [0.5 * PATCH * pitch; 2]), |_, _| colour);
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::super::{SceneKind, generate};
    use super::*;

    /// Every patch's colour stands in the picture as published, over about its area.
    #[test]
    fn the_patches_have_their_published_colours() {
        for (seed, rows, cols) in [(1, 240, 360), (2, 300, 300), (3, 200, 640)] {
            let picture = generate(SceneKind::ColorChart, seed, rows, cols);
            let pitch = (cols as f32 / 6.0).min(rows as f32 / 4.0) * 0.84;
            for patch in PATCHES {
                let wanted = linear(patch);
                let found = (0..rows * cols)
                    .filter(|i| (0..3).all(|k| (picture[[k, i / cols, i % cols]] - wanted[k]).abs() < 1e-6))
                    .count();
                assert!(found as f32 > 0.8 * (PATCH * pitch).powi(2), "{patch:?}: {found} pixels, seed {seed}");
            }
        }
    }
}
