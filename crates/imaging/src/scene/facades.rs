//! Streets in perspective: brick and plaster houses left, right and ahead, roofs, sky, road, trees, railings, wires.
//!
//! A ray is cast through each pixel at four planes; what it hits is drawn from plan and elevation in metres. Pixels that
//! differ from a neighbour get four more rays. Trees, railings and wires are painted over the result. World axes: x right,
//! y up, z along the street, the camera's foot at the origin.

use fastrand::Rng;

use super::building::{Row, Sun};
use super::canvas::{Canvas, Rgb, luminance, mix, scaled, smoothstep};
use super::foliage;
use super::noise_tile::NoiseTile;
use super::palette::between;
use super::view::{EYE, View};

/// A street and its light.
struct Street {
    half_width: f32,
    pavement: f32,
    end: f32,
    left: Row,
    right: Row,
    ahead: Row,
    sun: Sun,
    sky: [Rgb; 2],
    cloud: f32,
    road: f32,
    tile: NoiseTile,
    clouds: NoiseTile,
}

impl Street {
    fn new(rng: &mut Rng) -> Self {
        let half_width = between(rng, 4.5, 9.0);
        let end = between(rng, 28.0, 70.0);
        let overcast = rng.u8(..3) == 0;
        let blue = if overcast { 0.1 } else { between(rng, 0.6, 1.0) };
        let sky = |zenith: f32| mix([0.9, 0.92, 0.95], [0.16, 0.33, 0.72], blue * zenith);
        Self {
            half_width,
            pavement: between(rng, 1.5, 3.0),
            end,
            left: Row::new(rng, end + 20.0),
            right: Row::new(rng, end + 20.0),
            ahead: Row::new(rng, 60.0),
            sun: Sun { side: if rng.bool() { 1.0 } else { -1.0 }, slope: between(rng, 0.5, 1.3), hard: !overcast },
            sky: [sky(0.25), sky(1.0)],
            cloud: between(rng, 0.0, 0.8),
            road: between(rng, 0.08, 0.2),
            tile: NoiseTile::new(rng, 1.0),
            clouds: NoiseTile::new(rng, 1.7),
        }
    }

    /// Light of the sky in a direction.
    fn sky(&self, d: [f32; 3]) -> Rgb {
        let up = d[1] / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let base = mix(self.sky[0], self.sky[1], (1.6 * up).clamp(0.0, 1.0));
        let height = 60.0 / (up.max(0.0) + 0.12);
        let n = self.clouds.at(d[0] * height, d[2] * height + 40.0);
        mix(base, [0.95; 3], self.cloud * smoothstep(-0.2, 1.3, n))
    }

    /// What a ray from the camera sees; `step` is the angle of a pixel.
    fn see(&self, view: &View, d: [f32; 3], step: f32) -> Rgb {
        let mut nearest = f32::INFINITY;
        let mut hit = 0;
        for (i, distance) in
            [(-self.half_width - view.x) / d[0], (self.half_width - view.x) / d[0], self.end / d[2], -EYE / d[1]]
                .into_iter()
                .enumerate()
        {
            if distance > 0.0 && distance < nearest {
                (nearest, hit) = (distance, i);
            }
        }
        if nearest.is_infinite() {
            return self.sky(d);
        }
        let p = [view.x + nearest * d[0], EYE + nearest * d[1], nearest * d[2]];
        // The pixel's size on the surface, m.
        let footprint = nearest * step;
        let wall = |row: &Row, opposite: &Row, along: f32, facing: f32| {
            // The houses across the street throw their shadow on a wall that faces the sun.
            let lit = facing * self.sun.side > 0.0 && self.sun.hard;
            let shadow = opposite.height(along + 4.0) - 2.0 * self.half_width * self.sun.slope;
            let light = if lit && p[1] > shadow { 1.0 } else { 0.0 };
            row.look(along, p[1], footprint, light, &self.tile)
        };
        let seen = match hit {
            0 => wall(&self.left, &self.right, p[2] + 10.0, 1.0),
            1 => wall(&self.right, &self.left, p[2] + 10.0, -1.0),
            2 => self.ahead.look(p[0] + 30.0, p[1], footprint, if self.sun.hard { 0.6 } else { 0.0 }, &self.tile),
            _ => Some(self.ground(p, footprint)),
        };
        // Air lightens what is far.
        seen.map_or_else(|| self.sky(d), |c| mix(c, self.sky[0], (nearest / 400.0).min(0.4)))
    }

    /// Road, kerb and pavement.
    fn ground(&self, p: [f32; 3], footprint: f32) -> Rgb {
        let from_wall = self.half_width - p[0].abs();
        let fine = (0.02 / footprint.max(1e-3)).min(1.0);
        let grain =
            1.0 + 0.25 * fine * self.tile.at(40.0 * p[0], 40.0 * p[2]) + 0.15 * self.tile.at(2.0 * p[0], 2.0 * p[2]);
        let mut c = if from_wall < self.pavement {
            // Slabs with joints.
            let joint = |v: f32, pitch: f32| (v.rem_euclid(pitch) - 0.5 * pitch).abs() > 0.5 * pitch - 0.012;
            let sharp = (0.05 / footprint.max(1e-3)).min(1.0);
            let line = joint(p[0], 0.6) || joint(p[2] + 0.3 * (p[0] / 0.6).floor(), 0.9);
            [0.3 - 0.15 * sharp * f32::from(u8::from(line)); 3]
        } else if from_wall < self.pavement + 0.15 {
            [0.45, 0.44, 0.42]
        } else {
            let dashes = p[0].abs() < 0.07 && p[2].rem_euclid(6.0) < 3.0;
            if dashes { [0.75; 3] } else { [self.road, self.road, 1.05 * self.road] }
        };
        c = scaled(c, grain.max(0.3));
        // Shadow of the houses on the sunny side's opposite.
        let houses = if self.sun.side > 0.0 { &self.right } else { &self.left };
        let reach = houses.height(p[2] + 14.0) / self.sun.slope;
        let from_sun = self.half_width - self.sun.side * p[0];
        if self.sun.hard && from_sun > reach { scaled(c, 1.9) } else { scaled(c, 0.75) }
    }
}

/// Paints a street.
pub(super) fn paint(rng: &mut Rng, rows: usize, cols: usize) -> Canvas {
    let street = Street::new(rng);
    let view = View::new(rng, rows, cols, street.half_width);
    let step = 1.0 / view.focal;
    let cast = |x: f32, y: f32| street.see(&view, view.ray(x, y), step);
    let mut canvas = Canvas::filled(rows, cols, cast);
    // Cast more rays where neighbours differ.
    let key: Vec<f32> = canvas.pixels.iter().map(|c| luminance(*c).sqrt()).collect();
    for r in 0..rows {
        for c in 0..cols {
            let here = key[r * cols + c];
            let near = [(r, c + 1), (r + 1, c), (r.wrapping_sub(1), c), (r, c.wrapping_sub(1))];
            let differs = near.iter().any(|&(i, j)| i < rows && j < cols && (key[i * cols + j] - here).abs() > 0.025);
            if differs {
                let mut sum = [0.0; 3];
                for (dx, dy) in [(0.375, 0.125), (0.875, 0.375), (0.625, 0.875), (0.125, 0.625)] {
                    let v = cast(c as f32 + dx, r as f32 + dy);
                    (0..3).for_each(|k| sum[k] += 0.25 * v[k]);
                }
                canvas.pixels[r * cols + c] = sum;
            }
        }
    }
    let side = |rng: &mut Rng| if rng.bool() { 1.0 } else { -1.0 };
    let along = street.half_width - street.pavement;
    // Far things first.
    foliage::wires(rng, &mut canvas, &view, street.half_width, street.end);
    let mut trees: Vec<f32> = (0..2 + rng.usize(..4)).map(|_| between(rng, 9.0, street.end)).collect();
    trees.sort_by(|a, b| b.total_cmp(a));
    for z in trees {
        let x = side(rng) * (along + 0.5);
        foliage::tree(rng, &mut canvas, &view, [x, 0.0, z], street.sun.side);
    }
    if rng.u8(..3) > 0 {
        let x = side(rng) * (along + between(rng, 0.2, 1.0));
        foliage::railing(rng, &mut canvas, &view, x);
    }
    canvas
}
