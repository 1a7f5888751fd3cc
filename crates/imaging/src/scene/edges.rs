//! Chart-like scenes: slanted squares as in ISO 12233, stars, wedges of lines, discs and grey patches.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, Rgb, mix, scaled};
use super::noise_tile::NoiseTile;
use super::palette::{between, of_luminance};

/// Two colours of clearly different luminance; grey two times in three.
fn pair(rng: &mut Rng) -> [Rgb; 2] {
    let dark = between(rng, 0.01, 0.25);
    let bright = (dark * between(rng, 1.6, 12.0)).min(1.0);
    let mut colours = [[dark; 3], [bright; 3]];
    if rng.u8(..3) == 0 {
        colours = [of_luminance(rng, dark), of_luminance(rng, bright)];
    }
    if rng.bool() {
        colours.swap(0, 1);
    }
    colours
}

/// Paints one target of half side `half` at `centre`.
fn target(rng: &mut Rng, canvas: &mut Canvas, centre: [f32; 2], half: f32) {
    let [ink, ground] = pair(rng);
    let angle = between(rng, 0.035, 0.26) * if rng.bool() { 1.0 } else { -1.0 };
    let frame = Frame::new(centre, angle);
    let reach = [1.5 * half; 2];
    let square = |side: f32| {
        move |x: f32, y: f32| {
            let [u, v] = frame.local(x, y);
            u.abs().max(v.abs()) - side
        }
    };
    match rng.u8(..9) {
        // A slanted square on a straight ground.
        0..=3 => {
            canvas.over(
                centre,
                [half; 2],
                |x, y| (x - centre[0]).abs().max((y - centre[1]).abs()) - half,
                |_, _| ground,
            );
            canvas.over(centre, reach, square(between(rng, 0.4, 0.65) * half), |_, _| ink);
        }
        // A star; the spokes' edges are straight through the centre.
        4 | 5 => {
            let spokes = f32::from(rng.u8(6..37));
            canvas.over(centre, reach, |x, y| (x - centre[0]).hypot(y - centre[1]) - half, |_, _| ground);
            canvas.over(
                centre,
                reach,
                |x, y| {
                    let [u, v] = frame.local(x, y);
                    let (r, step) = (u.hypot(v), std::f32::consts::TAU / spokes);
                    let off = (v.atan2(u).rem_euclid(step) - 0.5 * step).abs() - 0.25 * step;
                    // Inside a few pixels the spokes merge to grey.
                    (r * off.sin()).max(r - half).max(-0.5 + 0.2 * (3.0 - r).max(0.0))
                },
                |_, _| ink,
            );
        }
        // A wedge of lines that narrows from left to right.
        6 | 7 => {
            let lines = 4.0 + (half / 6.0).floor();
            canvas.over(centre, reach, square(half), |_, _| ground);
            canvas.over(
                centre,
                reach,
                |x, y| {
                    let [u, v] = frame.local(x, y);
                    let spread = 0.9 * half * (0.62 - 0.38 * u / half).max(0.1);
                    let phase = (v / spread * 0.5 + 0.5) * lines;
                    let pitch = 2.0 * spread / lines;
                    let inside = (u.abs() - 0.92 * half).max(v.abs() - spread);
                    ((phase.rem_euclid(1.0) - 0.5).abs() - 0.25).max(inside / pitch) * pitch
                },
                |_, _| ink,
            );
        }
        // Grey steps around a disc.
        _ => {
            let steps = f32::from(rng.u8(4..10));
            canvas.over(centre, reach, square(half), |x, y| {
                let [u, _] = frame.local(x, y);
                let step = ((u / half * 0.5 + 0.5) * steps).floor() / (steps - 1.0);
                mix(ink, ground, step.clamp(0.0, 1.0).powf(2.2))
            });
            canvas.over(centre, reach, |x, y| (x - centre[0]).hypot(y - centre[1]) - 0.45 * half, |_, _| ink);
        }
    }
}

/// Paints a chart of targets of several sizes on a large slanted ground.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let tile = NoiseTile::new(rng, 1.0);
    let (width, height) = (cols as f32, rows as f32);
    // Two or three large fields of different grey, divided by slanted lines.
    let fields = [pair(rng), pair(rng)];
    let cuts: [Frame; 2] =
        std::array::from_fn(|_| Frame::new([width * rng.f32(), height * rng.f32()], std::f32::consts::TAU * rng.f32()));
    let grain = if rng.bool() { between(rng, 0.0, 0.06) } else { 0.0 };
    let fall = between(rng, 0.0, 0.35);
    let mut canvas = Canvas::filled(rows, cols, |x, y| {
        let side = |f: &Frame| (0.5 + f.local(x, y)[0]).clamp(0.0, 1.0);
        let c = mix(fields[0][0], mix(fields[0][1], fields[1][0], side(&cuts[1])), side(&cuts[0]));
        let r = ((x - 0.5 * width) / width).hypot((y - 0.5 * height) / height);
        scaled(c, (1.0 - fall * r) * (1.0 + grain * tile.at(x, y)).max(0.1))
    });
    // Targets on a jittered raster whose cells differ in size.
    let mut panels = Vec::new();
    let smallest = between(rng, 40.0, 110.0).min(0.5 * width.min(height)).max(6.0);
    super::text::cut(rng, [0.0, 0.0, width, height], smallest, &mut panels);
    for [x, y, w, h] in panels {
        let half = 0.5 * w.min(h) * between(rng, 0.6, 0.95);
        let centre =
            [x + between(rng, half, (w - half).max(half + 0.1)), y + between(rng, half, (h - half).max(half + 0.1))];
        target(rng, &mut canvas, centre, half);
    }
    canvas
}
