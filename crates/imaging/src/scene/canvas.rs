//! A picture being painted, with antialiased shapes, and its exposure.
//!
//! Shapes are signed distances in pixels (negative inside); coverage is `½ − distance`, cut off to `[0, 1]`, which is the
//! area of the pixel under a straight edge to a few percent. `x` runs along columns, `y` along rows, pixel centres at ½.

use ndarray::Array3;

/// Linear RGB.
pub(super) type Rgb = [f32; 3];

/// Luminance of linear sRGB.
pub(super) fn luminance(c: Rgb) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

/// `a` for `t = 0`, `b` for `t = 1`.
pub(super) fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

/// `c` times a factor.
pub(super) fn scaled(c: Rgb, gain: f32) -> Rgb {
    c.map(|v| v * gain)
}

/// Share of a pixel inside an edge at signed distance `d` pixels.
pub(super) fn coverage(d: f32) -> f32 {
    (0.5 - d).clamp(0.0, 1.0)
}

/// 0 below `a`, 1 above `b`, smooth between.
pub(super) fn smoothstep(a: f32, b: f32, v: f32) -> f32 {
    let t = ((v - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Distance of a point from the segment `a`–`b`.
pub(super) fn segment_distance(p: [f32; 2], a: [f32; 2], b: [f32; 2]) -> f32 {
    let (d, q) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = d[0] * d[0] + d[1] * d[1];
    let t = if length > 0.0 { ((q[0] * d[0] + q[1] * d[1]) / length).clamp(0.0, 1.0) } else { 0.0 };
    (q[0] - t * d[0]).hypot(q[1] - t * d[1])
}

/// A rotated frame: local coordinates of pixel positions.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    /// Position of the local origin.
    pub(super) origin: [f32; 2],
    cos: f32,
    sin: f32,
}

impl Frame {
    /// A frame at `origin`, turned by `angle` radians.
    pub(super) fn new(origin: [f32; 2], angle: f32) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { origin, cos, sin }
    }

    /// Local coordinates of a position.
    pub(super) fn local(&self, x: f32, y: f32) -> [f32; 2] {
        let (dx, dy) = (x - self.origin[0], y - self.origin[1]);
        [self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx]
    }

    /// The position of local coordinates.
    pub(super) fn place(&self, u: f32, v: f32) -> [f32; 2] {
        [self.origin[0] + self.cos * u - self.sin * v, self.origin[1] + self.sin * u + self.cos * v]
    }
}

/// A picture of interleaved pixels. `open` is the share of a pixel nothing has covered yet, for painting front to back.
pub(super) struct Canvas {
    pub(super) rows: usize,
    pub(super) cols: usize,
    pub(super) pixels: Vec<Rgb>,
    open: Vec<f32>,
}

impl Canvas {
    /// A black canvas, all open.
    pub(super) fn new(rows: usize, cols: usize) -> Self {
        Self { rows, cols, pixels: vec![[0.0; 3]; rows * cols], open: vec![1.0; rows * cols] }
    }

    /// A canvas painted everywhere; nothing stays open.
    pub(super) fn filled(rows: usize, cols: usize, mut colour: impl FnMut(f32, f32) -> Rgb) -> Self {
        let mut pixels = Vec::with_capacity(rows * cols);
        for r in 0..rows {
            pixels.extend((0..cols).map(|c| colour(c as f32 + 0.5, r as f32 + 0.5)));
        }
        Self { rows, cols, pixels, open: Vec::new() }
    }

    /// Rows and columns a square of half side `reach` about `centre` touches.
    fn bounds(&self, centre: [f32; 2], reach: [f32; 2]) -> [std::ops::Range<usize>; 2] {
        let span = |middle: f32, reach: f32, n: usize| {
            let low = (middle - reach - 1.0).floor().max(0.0) as usize;
            let high = (middle + reach + 2.0).ceil().max(0.0) as usize;
            low.min(n)..high.min(n)
        };
        [span(centre[1], reach[1], self.rows), span(centre[0], reach[0], self.cols)]
    }

    /// Paints a shape behind all that was painted before; returns the area it newly covered, in pixels.
    ///
    /// `distance` is the shape's signed distance, which reaches at most `reach` from `centre`.
    pub(super) fn behind(
        &mut self,
        centre: [f32; 2],
        reach: f32,
        distance: impl Fn(f32, f32) -> f32,
        colour: impl Fn(f32, f32) -> Rgb,
    ) -> f32 {
        let [rows, cols] = self.bounds(centre, [reach; 2]);
        let mut covered = 0.0;
        for r in rows {
            for c in cols.clone() {
                let i = r * self.cols + c;
                if self.open[i] == 0.0 {
                    continue;
                }
                let (x, y) = (c as f32 + 0.5, r as f32 + 0.5);
                let share = coverage(distance(x, y)) * self.open[i];
                if share > 0.0 {
                    let paint = colour(x, y);
                    (0..3).for_each(|k| self.pixels[i][k] += share * paint[k]);
                    self.open[i] = if self.open[i] - share < 1e-3 { 0.0 } else { self.open[i] - share };
                    covered += share;
                }
            }
        }
        covered
    }

    /// Paints what is still open.
    pub(super) fn fill_open(&mut self, colour: impl Fn(f32, f32) -> Rgb) {
        for i in 0..self.open.len() {
            if self.open[i] > 0.0 {
                let paint = colour((i % self.cols) as f32 + 0.5, (i / self.cols) as f32 + 0.5);
                (0..3).for_each(|k| self.pixels[i][k] += self.open[i] * paint[k]);
                self.open[i] = 0.0;
            }
        }
    }

    /// Paints a shape over all that was painted before.
    pub(super) fn over(
        &mut self,
        centre: [f32; 2],
        reach: [f32; 2],
        distance: impl Fn(f32, f32) -> f32,
        colour: impl Fn(f32, f32) -> Rgb,
    ) {
        let [rows, cols] = self.bounds(centre, reach);
        for r in rows {
            for c in cols.clone() {
                let (x, y) = (c as f32 + 0.5, r as f32 + 0.5);
                let share = coverage(distance(x, y));
                if share > 0.0 {
                    let pixel = &mut self.pixels[r * self.cols + c];
                    *pixel = mix(*pixel, colour(x, y), share);
                }
            }
        }
    }

    /// Paints a line of the given width over the picture.
    pub(super) fn line(&mut self, a: [f32; 2], b: [f32; 2], width: f32, colour: Rgb) {
        let centre = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let reach = [0.5 * ((b[0] - a[0]).abs() + width), 0.5 * ((b[1] - a[1]).abs() + width)];
        // A line thinner than a pixel covers at most its width.
        let (half, opacity) = (0.5 * width.max(1.0), width.min(1.0));
        let [rows, cols] = self.bounds(centre, reach);
        for r in rows {
            for c in cols.clone() {
                let d = segment_distance([c as f32 + 0.5, r as f32 + 0.5], a, b) - half;
                let share = coverage(d) * opacity;
                if share > 0.0 {
                    let pixel = &mut self.pixels[r * self.cols + c];
                    *pixel = mix(*pixel, colour, share);
                }
            }
        }
    }

    /// The picture with the exposure that gives the mean luminance `target`, cut off at 1 as a photograph is.
    ///
    /// A picture without lights, which would stay dull, is exposed for its brightest parts instead, up to a mean of 0.38.
    pub(super) fn exposed(&self, target: f32) -> Array3<f32> {
        // Cutting off lowers the mean, so the gain is found by iteration on a subset of pixels.
        let step = (self.pixels.len() / 20_000).max(1);
        let some: Vec<Rgb> = self.pixels.iter().step_by(step).copied().collect();
        let gain_of_mean = |target: f32| {
            let mut gain = 1.0;
            for _ in 0..12 {
                let sum: f32 = some.iter().map(|c| luminance(c.map(|v| (v * gain).clamp(0.0, 1.0)))).sum();
                let mean = sum / some.len().max(1) as f32;
                gain = (gain * (target / mean.max(1e-6)).clamp(0.5, 2.0)).clamp(1e-3, 1e3);
            }
            gain
        };
        let mut tops: Vec<f32> = some.iter().map(|c| c[0].max(c[1]).max(c[2])).collect();
        tops.sort_by(f32::total_cmp);
        let bright = tops.get(tops.len() * 98 / 100).copied().unwrap_or(1.0).max(1e-6);
        self.times(gain_of_mean(target).max((0.85 / bright).min(gain_of_mean(0.38))))
    }

    /// The picture with a fixed exposure, cut off at 1.
    pub(super) fn times(&self, gain: f32) -> Array3<f32> {
        let mut image = Array3::zeros((3, self.rows, self.cols));
        let planes = image.as_slice_mut().expect("just allocated");
        let n = self.pixels.len();
        for (i, pixel) in self.pixels.iter().enumerate() {
            (0..3).for_each(|k| planes[k * n + i] = (pixel[k] * gain).clamp(0.0, 1.0));
        }
        image
    }
}
