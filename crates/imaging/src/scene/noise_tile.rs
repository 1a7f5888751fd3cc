//! A tile of 1/f noise that repeats without a seam: random phases under an amplitude falling as 1/f.

use fastrand::Rng;
use rustfft::{FftPlanner, num_complex::Complex};

/// Side of the tile, pixels; a power of two.
const SIDE: usize = 256;

/// Noise of mean 0 and variance 1.
pub(super) struct NoiseTile {
    values: Vec<f32>,
}

impl NoiseTile {
    /// Noise with amplitude `f^−exponent`: 1 looks like nature, 0 is white, 2 is clouds.
    pub(super) fn new(rng: &mut Rng, exponent: f32) -> Self {
        let signed = |k: usize| if k > SIDE / 2 { k as f32 - SIDE as f32 } else { k as f32 };
        let mut field: Vec<Complex<f32>> = (0..SIDE * SIDE)
            .map(|i| {
                let f = signed(i / SIDE).hypot(signed(i % SIDE));
                let amplitude = if i == 0 { 0.0 } else { f.powf(-exponent) };
                Complex::from_polar(amplitude, std::f32::consts::TAU * rng.f32())
            })
            .collect();
        // Random phases without symmetry: the real part is as good a noise as the imaginary one.
        let fft = FftPlanner::new().plan_fft_inverse(SIDE);
        fft.process(&mut field);
        let mut turned = vec![Complex::default(); field.len()];
        for (i, v) in field.iter().enumerate() {
            turned[(i % SIDE) * SIDE + i / SIDE] = *v;
        }
        fft.process(&mut turned);
        let variance: f32 = turned.iter().map(|v| v.re * v.re).sum::<f32>() / (SIDE * SIDE) as f32;
        let scale = 1.0 / variance.sqrt().max(1e-20);
        Self { values: turned.iter().map(|v| v.re * scale).collect() }
    }

    /// The noise at a position, bilinear, repeated for ever.
    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let (fx, fy) = (x.floor(), y.floor());
        let (tx, ty) = (x - fx, y - fy);
        let wrap = |v: f32| (v as i64 as usize) & (SIDE - 1);
        let (c0, r0) = (wrap(fx), wrap(fy));
        let (c1, r1) = ((c0 + 1) & (SIDE - 1), (r0 + 1) & (SIDE - 1));
        let v = |r: usize, c: usize| self.values[r * SIDE + c];
        let (top, bottom) = (v(r0, c0) + tx * (v(r0, c1) - v(r0, c0)), v(r1, c0) + tx * (v(r1, c1) - v(r1, c0)));
        top + ty * (bottom - top)
    }
}
