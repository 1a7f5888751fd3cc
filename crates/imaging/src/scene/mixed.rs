//! Several kinds in one picture: pieces of text, texture and chart lie on and under dead leaves.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, luminance};
use super::palette::between;
use super::{edges, leaves, text, texture};

/// Paints a mixed scene.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let mut canvas = leaves::paint(rng, rows, cols);
    let other = match rng.u8(..4) {
        0 | 1 => texture::paint(rng, rows, cols),
        2 => text::paint(rng, rows, cols),
        _ => edges::paint(rng, rows, cols),
    };
    // The pieces get the leaves' mean light.
    let mean = |c: &Canvas| c.pixels.iter().step_by(7).map(|p| luminance(*p)).sum::<f32>().max(1e-3);
    let gain = (mean(&canvas) / mean(&other)).clamp(0.1, 10.0);
    let side = rows.min(cols) as f32;
    for _ in 0..4 + rng.usize(..6) {
        let centre = [rng.f32() * cols as f32, rng.f32() * rows as f32];
        let frame = Frame::new(centre, 6.3 * rng.f32());
        let (a, b) = (side * between(rng, 0.08, 0.35), side * between(rng, 0.08, 0.3));
        let disc = rng.bool();
        let reach = a.hypot(b);
        canvas.over(
            centre,
            [reach; 2],
            |x, y| {
                let [u, v] = frame.local(x, y);
                if disc { u.hypot(v) - a } else { (u.abs() - a).max(v.abs() - b) }
            },
            |x, y| {
                let (r, c) = ((y as usize).min(rows - 1), (x as usize).min(cols - 1));
                other.pixels[r * cols + c].map(|v| v * gain)
            },
        );
    }
    canvas
}
