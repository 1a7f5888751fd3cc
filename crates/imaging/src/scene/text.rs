//! Printed matter: panels of paper, card and paint with lines of text, headings, rules and bars.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, Rgb, mix, scaled};
use super::font;
use super::noise_tile::NoiseTile;
use super::palette::{between, of_luminance};

/// A rectangle in pixels: left, top, width, height.
pub(super) type Panel = [f32; 4];

/// Cuts a rectangle into panels by straight cuts until they are small enough or chance stops it.
pub(super) fn cut(rng: &mut Rng, panel: Panel, smallest: f32, out: &mut Vec<Panel>) {
    let [x, y, w, h] = panel;
    let long = w.max(h);
    if long < 2.0 * smallest || (long < 5.0 * smallest && rng.u8(..4) == 0) {
        out.push(panel);
        return;
    }
    let at = between(rng, 0.3, 0.7);
    if w > h {
        cut(rng, [x, y, w * at, h], smallest, out);
        cut(rng, [x + w * at, y, w * (1.0 - at), h], smallest, out);
    } else {
        cut(rng, [x, y, w, h * at], smallest, out);
        cut(rng, [x, y + h * at, w, h * (1.0 - at)], smallest, out);
    }
}

/// A pronounceable word, sometimes a number, sometimes in capitals.
fn word(rng: &mut Rng) -> String {
    if rng.u8(..9) == 0 {
        let digits = 1 + rng.usize(..5);
        return (0..digits).map(|_| char::from(b'0' + rng.u8(..10))).collect();
    }
    let consonants = b"tnshrdlcmwfgypbvkxjqz";
    let vowels = b"eaoiueaoieae";
    // Squaring favours the front of the list, where the frequent letters are.
    let consonant = |rng: &mut Rng| consonants[((rng.f32() * rng.f32()) * consonants.len() as f32) as usize];
    let mut letters = String::new();
    for _ in 0..1 + rng.usize(..4) {
        if rng.u8(..5) > 0 {
            letters.push(char::from(consonant(rng)));
        }
        letters.push(char::from(vowels[rng.usize(..vowels.len())]));
        if rng.u8(..3) == 0 {
            letters.push(char::from(consonant(rng)));
        }
    }
    match rng.u8(..10) {
        0 => letters.to_ascii_uppercase(),
        1 | 2 => letters[..1].to_ascii_uppercase() + &letters[1..],
        _ => letters,
    }
}

/// The look of a run of text.
struct Type {
    /// Height of a capital, pixels.
    height: f32,
    /// Stroke width over height.
    weight: f32,
    slant: f32,
    ink: Rgb,
}

/// Writes one line from local position `(u, v)` (baseline) to at most `right`; returns where it ended.
fn write_line(canvas: &mut Canvas, frame: &Frame, face: &Type, text: &str, start: [f32; 2], right: f32) -> f32 {
    let unit = face.height / 6.0;
    let gap = unit * (1.6 + 6.0 * face.weight);
    let mut u = start[0];
    for character in text.chars() {
        let (low, high) = font::extent(character);
        if u + (high - low) * unit > right {
            break;
        }
        let place = |x: f32, y: f32| {
            let (x, y) = ((x - low) * unit + face.slant * (y - 2.0) * unit, (y - 2.0) * unit);
            frame.place(u + x, start[1] - y)
        };
        for [x0, y0, x1, y1] in font::segments(character) {
            canvas.line(place(x0, y0), place(x1, y1), face.weight * face.height, face.ink);
        }
        u += (high - low) * unit + gap;
    }
    u
}

/// Fills a panel with text.
fn set_panel(rng: &mut Rng, canvas: &mut Canvas, panel: Panel, tile: &NoiseTile) {
    let [x, y, w, h] = panel;
    let dark_paper = rng.bool();
    let (paper_light, ink_light) = if dark_paper {
        (between(rng, 0.01, 0.18), between(rng, 0.3, 1.0))
    } else {
        (between(rng, 0.4, 0.95), between(rng, 0.01, 0.2))
    };
    // One panel in six has little contrast.
    let ink_light = if rng.u8(..6) == 0 { ink_light + 0.7 * (paper_light - ink_light) } else { ink_light };
    let paper = mix([paper_light; 3], of_luminance(rng, paper_light), between(rng, 0.1, 1.0));
    let ink = mix([ink_light; 3], of_luminance(rng, ink_light), between(rng, 0.0, 1.0));
    // Lay the paper, with its grain and a slow change of light.
    let centre = [x + 0.5 * w, y + 0.5 * h];
    let turn = if rng.u8(..3) == 0 { 0.0 } else { between(rng, -0.12, 0.12) };
    let frame = Frame::new(centre, turn);
    let (grain, tilt) = (between(rng, 0.01, 0.06), [between(rng, -0.3, 0.3) / w, between(rng, -0.3, 0.3) / h]);
    let shift = 256.0 * rng.f32();
    let reach = [0.55 * w + 0.1 * h + 2.0, 0.55 * h + 0.1 * w + 2.0];
    canvas.over(
        centre,
        reach,
        |px, py| {
            let [u, v] = frame.local(px, py);
            (u.abs() - 0.5 * w).max(v.abs() - 0.5 * h)
        },
        |px, py| {
            let [u, v] = frame.local(px, py);
            scaled(paper, (1.0 + grain * tile.at(px + shift, py) + tilt[0] * u + tilt[1] * v).max(0.2))
        },
    );
    // Set lines of one size, with a heading now and then.
    let body = 5.0 * (8.0f32).powf(rng.f32() * rng.f32());
    let margin = 0.06 * w.min(h) + 0.5 * body;
    let (left, right) = (-0.5 * w + margin, 0.5 * w - margin);
    let leading = between(rng, 1.5, 2.1);
    let slant = if rng.u8(..4) == 0 { 0.2 } else { 0.0 };
    let weight = between(rng, 0.09, 0.2);
    let mut v = -0.5 * h + margin;
    while v < 0.5 * h - margin {
        let heading = rng.u8(..7) == 0;
        let height = if heading { (body * between(rng, 1.6, 5.0)).min(0.4 * h) } else { body };
        v += height;
        if v > 0.5 * h - margin {
            break;
        }
        let face = Type { height, weight: if heading { 1.2 * weight } else { weight }, slant, ink };
        let mut line = word(rng);
        while (line.len() as f32) < (right - left) / (0.55 * height) {
            line.push_str([" ", " ", " ", ", ", ". ", " - "][rng.usize(..6)]);
            line.push_str(&word(rng));
        }
        // Paragraphs end early.
        let end = if rng.u8(..5) == 0 { left + (right - left) * between(rng, 0.2, 0.9) } else { right };
        write_line(canvas, &frame, &face, &line, [left, v], end);
        v += (leading - 1.0) * height;
        if rng.u8(..12) == 0 {
            let thick = between(rng, 0.6, 0.3 * body);
            canvas.line(frame.place(left, v), frame.place(right, v), thick, ink);
            v += 0.6 * body;
        }
    }
}

/// Paints a wall of printed matter.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let tile = NoiseTile::new(rng, 0.8);
    let light = between(rng, 0.05, 0.6);
    let wall = of_luminance(rng, light);
    let mut canvas = Canvas::filled(rows, cols, |x, y| scaled(wall, (1.0 + 0.2 * tile.at(0.7 * x, 0.7 * y)).max(0.1)));
    let mut panels = Vec::new();
    let smallest = between(rng, 90.0, 200.0).min(0.5 * rows.min(cols) as f32).max(8.0);
    cut(rng, [0.0, 0.0, cols as f32, rows as f32], smallest, &mut panels);
    for panel in panels {
        set_panel(rng, &mut canvas, panel, &tile);
    }
    canvas
}
