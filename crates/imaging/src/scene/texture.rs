//! Fine texture: patches of gratings, checkers, weaves, dots, zone plates, wood, grass and coloured noise.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, Rgb, luminance, mix, scaled};
use super::noise_tile::NoiseTile;
use super::palette::{Palette, between};

const TAU: f32 = std::f32::consts::TAU;

/// A texture between two colours; pitches in pixels.
#[derive(Clone, Copy)]
enum Weave {
    Sine {
        pitch: f32,
    },
    Bars {
        pitch: f32,
        duty: f32,
    },
    Checker {
        pitch: f32,
    },
    /// Threads over and under, each rounded.
    Cloth {
        pitch: f32,
        over: f32,
    },
    /// Stepped diagonals, as in jeans.
    Twill {
        pitch: f32,
    },
    Dots {
        pitch: f32,
        radius: f32,
    },
    /// Rings whose frequency grows outwards to `1 / finest`.
    ZonePlate {
        reach: f32,
        finest: f32,
    },
    Wood {
        pitch: f32,
    },
    Grass {
        stretch: f32,
    },
    Grain {
        scale: f32,
    },
    /// Cells like stones or skin.
    Cells {
        pitch: f32,
    },
}

impl Weave {
    fn draw(rng: &mut Rng) -> Self {
        // Log-uniform pitches; the finest lie at the pixel's limit.
        let pitch = 2.2 * 14f32.powf(rng.f32());
        match rng.u8(..15) {
            0 => Self::Sine { pitch },
            1 => Self::Bars { pitch, duty: between(rng, 0.25, 0.75) },
            2 => Self::Checker { pitch: pitch.max(3.0) },
            3..=5 => Self::Cloth { pitch: pitch.max(3.5), over: f32::from(rng.u8(1..4)) },
            6 => Self::Twill { pitch: pitch.max(3.0) },
            7 => Self::Dots { pitch: pitch.max(3.5), radius: between(rng, 0.2, 0.48) },
            8 => Self::ZonePlate { reach: between(rng, 80.0, 250.0), finest: between(rng, 2.2, 4.0) },
            9 => Self::Wood { pitch: pitch.max(4.0) },
            10 | 11 => Self::Grass { stretch: between(rng, 5.0, 20.0) },
            12 | 13 => Self::Grain { scale: between(rng, 0.15, 1.0) },
            _ => Self::Cells { pitch: pitch.max(5.0) },
        }
    }

    /// Position between the two colours (0 to 1) and a factor of shading.
    fn at(self, [u, v]: [f32; 2], tile: &NoiseTile) -> (f32, f32) {
        let wave = |x: f32| 0.5 + 0.5 * (TAU * x).sin();
        let even = |x: f32| (x.floor() as i64) & 1 == 0;
        match self {
            Self::Sine { pitch } => (wave(u / pitch), 1.0),
            Self::Bars { pitch, duty } => (f32::from(u8::from((u / pitch).rem_euclid(1.0) < duty)), 1.0),
            Self::Checker { pitch } => (f32::from(u8::from(even(u / pitch) == even(v / pitch))), 1.0),
            Self::Cloth { pitch, over } => {
                let (a, b) = (u / pitch, v / pitch);
                let warp_on_top = even((a.floor() + b.floor()) / over);
                let across = if warp_on_top { a } else { b }.rem_euclid(1.0) - 0.5;
                let along = if warp_on_top { b } else { a }.rem_euclid(1.0) - 0.5;
                let round = (1.0 - 3.2 * across * across) * (1.0 - 0.9 * along * along);
                (f32::from(u8::from(warp_on_top)), (0.15 + 0.85 * round).max(0.05))
            }
            Self::Twill { pitch } => {
                let step = (u / pitch).floor() + (v / pitch).floor() * 2.0;
                let across = (u / pitch).rem_euclid(1.0) - 0.5;
                (f32::from(u8::from(step.rem_euclid(4.0) < 2.0)), 1.0 - 1.6 * across * across)
            }
            Self::Dots { pitch, radius } => {
                let row = (v / pitch).floor();
                let (a, b) = ((u / pitch + 0.5 * row.rem_euclid(2.0)).rem_euclid(1.0) - 0.5, v / pitch - row - 0.5);
                (f32::from(u8::from(a.hypot(b) < radius)), 1.0)
            }
            Self::ZonePlate { reach, finest } => {
                let r = u.hypot(v).min(1.2 * reach);
                (wave(r * r / (2.0 * reach * finest)), 1.0)
            }
            Self::Wood { pitch } => {
                let bend = 14.0 * tile.at(0.03 * u, 0.15 * v);
                (wave((v + bend) / pitch), 1.0 + 0.12 * tile.at(0.08 * u, v))
            }
            Self::Grass { stretch } => {
                let n = tile.at(u, v / stretch) + 0.6 * tile.at(u + 0.4 * v, 71.0 + v / stretch);
                ((0.5 + 0.35 * n).clamp(0.0, 1.0), (1.0 + 0.4 * n).max(0.1))
            }
            Self::Grain { scale } => ((0.5 + 0.3 * tile.at(u * scale, v * scale)).clamp(0.0, 1.0), 1.0),
            Self::Cells { pitch } => {
                // Nearest and second nearest of jittered points: the difference vanishes on the walls.
                let (a, b) = (u / pitch, v / pitch);
                let (mut first, mut second) = (9.0f32, 9.0f32);
                for i in -1..=1 {
                    for j in -1..=1 {
                        let (x, y) = (a.floor() + i as f32, b.floor() + j as f32);
                        let jitter = [tile.at(7.0 * x, 7.0 * y + 3.0), tile.at(7.0 * x + 120.0, 7.0 * y)];
                        let d = (x + 0.5 + 0.25 * jitter[0] - a).hypot(y + 0.5 + 0.25 * jitter[1] - b);
                        second = second.min(d.max(first));
                        first = first.min(d);
                    }
                }
                ((3.0 * (second - first)).min(1.0), 1.1 - 0.4 * first)
            }
        }
    }
}

/// A patch: where it is, and what it looks like.
struct Patch {
    frame: Frame,
    /// Anisotropy of the patch's outline.
    squeeze: f32,
    weave: Weave,
    colours: [Rgb; 2],
    wrinkle: f32,
}

/// Paints patches of texture.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let tile = NoiseTile::new(rng, 1.0);
    let folds = NoiseTile::new(rng, 1.9);
    let palette = Palette::new(rng, 10);
    let count = 7 + rng.usize(..10);
    let patches: Vec<Patch> = (0..count)
        .map(|_| {
            let centre = [rng.f32() * cols as f32, rng.f32() * rows as f32];
            let a = palette.pick(rng);
            // The second colour differs in lightness most of all.
            let contrast = (-between(rng, 0.15, 2.5)).exp();
            let hue = palette.pick(rng);
            let b = mix(a, scaled(hue, luminance(a) / luminance(hue).max(1e-4)), 0.7);
            let colours = if rng.bool() { [a, scaled(b, contrast)] } else { [scaled(b, contrast), a] };
            Patch {
                frame: Frame::new(centre, TAU * rng.f32()),
                squeeze: between(rng, 0.5, 1.0),
                weave: Weave::draw(rng),
                colours,
                wrinkle: if rng.bool() { between(rng, 0.0, 8.0) } else { 0.0 },
            }
        })
        .collect();
    let slow = 70.0 / rows.min(cols).max(64) as f32;
    // The patch a position belongs to, and by how many pixels, roughly, it leads over the next.
    let belongs = |x: f32, y: f32, fold: f32| {
        let bend = 25.0 * fold;
        let (mut first, mut second, mut chosen) = (f32::INFINITY, f32::INFINITY, 0);
        for (i, patch) in patches.iter().enumerate() {
            let [u, v] = patch.frame.local(x + bend, y - bend);
            let d = u * u * patch.squeeze + v * v / patch.squeeze;
            if d < first {
                (second, first, chosen) = (first, d, i);
            } else {
                second = second.min(d);
            }
        }
        (chosen, second.sqrt() - first.sqrt())
    };
    let look = |x: f32, y: f32, fold: f32, patch: &Patch| -> Rgb {
        let wrinkle = patch.wrinkle * fold;
        let (t, shade) = patch.weave.at(patch.frame.local(x + wrinkle, y + 0.7 * wrinkle), &tile);
        scaled(mix(patch.colours[0], patch.colours[1], t), shade * (1.0 + 0.28 * fold).max(0.15))
    };
    // Four samples a pixel; only on borders each asks for its own patch. Folds bend the borders and the threads.
    Canvas::filled(rows, cols, |x, y| {
        let fold = folds.at(slow * x, slow * y);
        let (chosen, lead) = belongs(x, y, fold);
        let mut sum = [0.0; 3];
        for (dx, dy) in [(-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)] {
            let (sx, sy) = (x + dx, y + dy);
            let patch = if lead < 3.0 { belongs(sx, sy, fold).0 } else { chosen };
            let c = look(sx, sy, fold, &patches[patch]);
            (0..3).for_each(|k| sum[k] += 0.25 * c[k]);
        }
        sum
    })
}
