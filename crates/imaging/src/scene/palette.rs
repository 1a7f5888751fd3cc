//! Colours as they occur outdoors: mostly muted, warm or cool rather than green or magenta, dark more often than bright.
//!
//! Reflectances are log-normal; red over green and blue over green vary together (the daylight axis) far more than
//! apart. One colour in eight is saturated, as flowers, clothes and paint are.

use fastrand::Rng;

use super::canvas::{Rgb, luminance};

/// A standard normal draw (sum of twelve uniforms; tails end at 6, which colours never need).
pub(super) fn normal(rng: &mut Rng) -> f32 {
    (0..12).map(|_| rng.f32()).sum::<f32>() - 6.0
}

/// Uniform draw in `[a, b)`.
pub(super) fn between(rng: &mut Rng, a: f32, b: f32) -> f32 {
    a + (b - a) * rng.f32()
}

/// A saturated or muted hue of luminance 1.
fn chroma(rng: &mut Rng) -> Rgb {
    let warmth = normal(rng);
    let (red, blue) = if rng.u8(..8) == 0 {
        (0.1 + 0.7 * normal(rng), -0.4 + 0.8 * normal(rng))
    } else {
        (0.02 + 0.2 * warmth + 0.12 * normal(rng), -0.3 - 0.34 * warmth + 0.12 * normal(rng))
    };
    let c = [red.exp(), 1.0, blue.exp()];
    c.map(|v| v / luminance(c))
}

/// A colour of any lightness.
pub(super) fn natural(rng: &mut Rng) -> Rgb {
    let light = (-1.9 + 0.85 * normal(rng)).exp().min(1.2);
    chroma(rng).map(|v| v * light)
}

/// A colour of the given luminance.
pub(super) fn of_luminance(rng: &mut Rng, light: f32) -> Rgb {
    chroma(rng).map(|v| (v * light).min(1.5))
}

/// A few colours that belong together, and draws near them.
pub(super) struct Palette(Vec<Rgb>);

impl Palette {
    /// Draws `n` base colours.
    pub(super) fn new(rng: &mut Rng, n: usize) -> Self {
        Self((0..n.max(1)).map(|_| natural(rng)).collect())
    }

    /// A colour near one of the palette's.
    pub(super) fn pick(&self, rng: &mut Rng) -> Rgb {
        let base = self.0[rng.usize(..self.0.len())];
        let light = (0.35 * normal(rng)).exp();
        base.map(|v| v * light * (0.06 * normal(rng)).exp())
    }
}
