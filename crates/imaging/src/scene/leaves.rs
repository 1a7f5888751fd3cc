//! Dead leaves: shapes of radius density r⁻³ that hide one another, painted front to back until nothing is open.

use fastrand::Rng;

use super::canvas::{Canvas, Frame, Rgb, luminance, mix, scaled};
use super::noise_tile::NoiseTile;
use super::palette::{Palette, between, normal};

/// The outline of a leaf; lengths in units of its radius.
#[derive(Clone, Copy)]
enum Outline {
    Ellipse {
        aspect: f32,
    },
    /// Where two discs overlap: pointed at both ends.
    Lens {
        offset: f32,
    },
    Box {
        aspect: f32,
        round: f32,
    },
    /// A regular polygon.
    Polygon {
        sides: f32,
    },
    /// A disc with a wavy rim.
    Blob {
        waves: f32,
        depth: f32,
        phase: f32,
    },
}

impl Outline {
    fn draw(rng: &mut Rng) -> Self {
        match rng.u8(..10) {
            0..=2 => Self::Ellipse { aspect: 1.0 },
            3 | 4 => Self::Ellipse { aspect: between(rng, 0.3, 1.0) },
            5 | 6 => Self::Lens { offset: between(rng, 0.3, 0.8) },
            7 => Self::Box { aspect: between(rng, 0.15, 1.0), round: between(rng, 0.0, 0.3) },
            8 => Self::Polygon { sides: f32::from(rng.u8(3..7)) },
            _ => Self::Blob { waves: f32::from(rng.u8(2..7)), depth: between(rng, 0.05, 0.25), phase: 6.3 * rng.f32() },
        }
    }

    /// Signed distance of a local position; exact for discs, boxes and lenses, a close bound for the others.
    fn distance(self, p: [f32; 2], radius: f32) -> f32 {
        let [u, v] = p;
        match self {
            Self::Ellipse { aspect: 1.0 } => u.hypot(v) - radius,
            Self::Ellipse { aspect } => {
                let (w, minor) = (v / aspect, radius * aspect);
                let length = u.hypot(w);
                // First-order distance: value over gradient.
                (length - radius) * length / u.hypot(w / aspect).max(1e-6 * minor).max(1e-6)
            }
            Self::Lens { offset } => {
                let size = radius * (1.0 + offset * offset).sqrt();
                u.hypot(v.abs() + offset * radius) - size
            }
            Self::Box { aspect, round } => {
                let corner = round * radius * aspect;
                let d = [u.abs() - 0.9 * radius + corner, v.abs() - 0.9 * radius * aspect + corner];
                d[0].max(0.0).hypot(d[1].max(0.0)) + d[0].max(d[1]).min(0.0) - corner
            }
            Self::Polygon { sides } => {
                let sector = std::f32::consts::TAU / sides;
                let angle = v.atan2(u).rem_euclid(sector) - 0.5 * sector;
                u.hypot(v) * angle.cos() - radius * (0.5 * sector).cos()
            }
            Self::Blob { waves, depth, phase } => {
                let rim = radius * (1.0 - depth + depth * (waves * v.atan2(u) + phase).sin());
                (u.hypot(v) - rim) * 0.85
            }
        }
    }
}

/// How a leaf's colour varies over it.
#[derive(Clone, Copy)]
enum Skin {
    Plain,
    Grain {
        contrast: f32,
        scale: f32,
    },
    /// Noise drawn out along one direction: wood, hair, grass.
    Fibre {
        contrast: f32,
        scale: f32,
        stretch: f32,
    },
    Stripes {
        contrast: f32,
        pitch: f32,
    },
    /// A midrib with veins.
    Veins {
        contrast: f32,
        pitch: f32,
    },
}

impl Skin {
    fn draw(rng: &mut Rng) -> Self {
        let contrast = between(rng, 0.1, 0.5);
        match rng.u8(..10) {
            0..=2 => Self::Plain,
            3..=5 => Self::Grain { contrast, scale: between(rng, 0.2, 1.0) },
            6 | 7 => Self::Fibre { contrast, scale: between(rng, 0.3, 1.0), stretch: between(rng, 4.0, 14.0) },
            8 => Self::Stripes { contrast, pitch: between(rng, 2.5, 20.0) },
            _ => Self::Veins { contrast: 0.7 * contrast, pitch: between(rng, 4.0, 20.0) },
        }
    }

    /// Factor on the colour at a local position.
    fn gain(self, [u, v]: [f32; 2], tile: &NoiseTile, shift: [f32; 2]) -> f32 {
        match self {
            Self::Plain => 1.0,
            Self::Grain { contrast, scale } => 1.0 + contrast * tile.at(u * scale + shift[0], v * scale + shift[1]),
            Self::Fibre { contrast, scale, stretch } => {
                1.0 + contrast * tile.at(u * scale / stretch + shift[0], v * scale + shift[1])
            }
            Self::Stripes { contrast, pitch } => {
                1.0 + contrast * (std::f32::consts::TAU * v / pitch).sin().signum() * 0.7
            }
            Self::Veins { contrast, pitch } => {
                let rib = 1.0 - (v.abs() - 1.0).clamp(0.0, 1.0);
                let veins = ((u + 0.8 * v.abs()) * std::f32::consts::TAU / pitch).cos().powi(8);
                1.0 + contrast * (veins.max(rib) + 0.4 * tile.at(u + shift[0], v + shift[1]))
            }
        }
        .max(0.05)
    }
}

/// Paints dead leaves.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let mut canvas = Canvas::new(rows, cols);
    let tile = NoiseTile::new(rng, 1.0);
    let haze = NoiseTile::new(rng, 1.6);
    let colours = 6 + rng.usize(..8);
    let palette = Palette::new(rng, colours);
    let side = rows.min(cols) as f32;
    // Radii from r_min up: density r⁻³ is r = r_min / √u, cut off at r_max.
    let r_min = 1.3 * 4.5f32.powf(rng.f32());
    let r_max = (side * between(rng, 0.2, 0.5)).max(2.0 * r_min);
    let cut = (r_min / r_max).powi(2);
    // Light from one side; slow changes of light over the scene.
    let light = Frame::new([0.0, 0.0], 6.3 * rng.f32());
    let slow = 90.0 / side.max(64.0);
    let area = (rows * cols) as f32;
    let mut open = area;
    for _ in 0..(rows * cols).max(64) {
        if open < 0.002 * area {
            break;
        }
        let radius = r_min / (cut + (1.0 - cut) * rng.f32()).sqrt();
        let centre = [between(rng, -radius, cols as f32 + radius), between(rng, -radius, rows as f32 + radius)];
        let frame = Frame::new(centre, 6.3 * rng.f32());
        let outline = Outline::draw(rng);
        let skin = if radius > 4.0 { Skin::draw(rng) } else { Skin::Plain };
        let shift = [256.0 * rng.f32(), 256.0 * rng.f32()];
        let (base, second) = (palette.pick(rng), palette.pick(rng));
        // Two hues on one leaf, close to each other; the shading of a bent or rounded surface.
        let second = mix(base, scaled(second, luminance(base) / luminance(second).max(1e-4)), 0.3);
        let (slope, bend) = (0.35 * normal(rng) / radius, between(rng, 0.0, 0.35) / (radius * radius));
        let lit = 1.0 + 0.45 * haze.at(centre[0] * slow + 17.0, centre[1] * slow + 90.0).clamp(-1.5, 1.5);
        let colour = |x: f32, y: f32| -> Rgb {
            let p = frame.local(x, y);
            let [s, _] = light.local(x - centre[0], y - centre[1]);
            let shade = (1.0 + slope * s - bend * (p[0] * p[0] + p[1] * p[1])).max(0.1);
            let tint = (0.5 + 0.5 * p[0] / radius).clamp(0.0, 1.0);
            scaled(mix(base, second, tint), lit * shade * skin.gain(p, &tile, shift))
        };
        let distance = |x: f32, y: f32| outline.distance(frame.local(x, y), radius);
        open -= canvas.behind(centre, radius, distance, colour);
    }
    let last = palette.pick(rng);
    canvas.fill_open(|_, _| last);
    canvas
}
