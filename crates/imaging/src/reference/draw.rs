//! A tile of rays at once: from random bits to rays and weights, and from rays that left the lens to texels.
//!
//! Both are plain loops over the lanes, compiled for each instruction set. No operation is contracted, so every
//! instruction set gives the same bits, and a lane's numbers depend on that lane alone.

use glam::DVec2;

use super::bounds::{Ellipse, Footprints};
use super::rear::RearView;
use super::sampler::{DIMENSIONS, disk_from_square, unit};
use crate::frame::Frame;
use crate::plane::Plane;
use isoplanat_base::math::wide::{Work, wide};
use isoplanat_optics::trace::lanes::{Bundle, TILE};

/// What a tile of rays is drawn from, and what comes of it beside the rays.
pub(super) struct Draw {
    /// Random bits: two of the pupil, two of the place in the pixel. (Those of the wavelength are spent already.)
    pub(super) bits: [[u32; TILE]; DIMENSIONS - 1],
    /// Column and row of the pixel's corner.
    pub(super) corner: [[f64; TILE]; 2],
    /// `n'²` at the ray's wavelength.
    pub(super) index_square: [f64; TILE],
    /// Sensor point, mm.
    pub(super) point: [[f64; TILE]; 2],
    /// Its radial direction (up on the axis).
    radial: [[f64; TILE]; 2],
    /// Its distance from the axis, mm.
    pub(super) radius: [f64; TILE],
    /// Ellipse of every ray.
    ellipse: [[f64; TILE]; 3],
    /// Target on the rim's plane in the meridional frame: across, along.
    pub(super) target: [[f64; TILE]; 2],
    /// `n'² cos⁴θ′ / Z² A`.
    pub(super) weight: [f64; TILE],
}

/// Everything that one picture's rays share.
#[derive(Clone, Copy)]
pub(super) struct Draws<'a> {
    /// Pixel pitch, mm, and the axis, pixels.
    pitch: f64,
    axis: [f64; 2],
    /// Distance of the rim's plane.
    distance: f64,
    /// The whole rear aperture.
    disk: Ellipse,
    footprints: Option<&'a Footprints>,
}

impl<'a> Draws<'a> {
    /// Through the ellipses of `footprints`, or through the whole rear aperture.
    pub(super) fn new(frame: &Frame, rear: &RearView, footprints: Option<&'a Footprints>) -> Self {
        let disk = Ellipse { centre: 0.0, across: rear.disk_radius, along: rear.disk_radius };
        let (pitch, axis, distance) = (frame.pitch_mm, frame.axis_px, rear.distance);
        Self { pitch, axis, distance, disk, footprints }
    }
}

impl Draw {
    pub(super) fn new() -> Self {
        let (zero, pair) = ([0.0; TILE], [[0.0; TILE]; 2]);
        Self {
            bits: [[0; TILE]; DIMENSIONS - 1],
            corner: pair,
            index_square: zero,
            point: pair,
            radial: pair,
            radius: zero,
            ellipse: [zero; 3],
            target: pair,
            weight: zero,
        }
    }

    /// Sensor point and target on the rim's plane of `lane`, mm.
    pub(super) fn ends(&self, lane: usize) -> [DVec2; 2] {
        let [point, radial, [x, y]] =
            [&self.point, &self.radial, &self.target].map(|pair| [pair[0][lane], pair[1][lane]]);
        let radial = DVec2::from(radial);
        [point.into(), y * radial + x * radial.perp()]
    }

    /// Copies what is drawn of lane `from` to lane `to`.
    pub(super) fn move_lane(&mut self, to: usize, from: usize) {
        let pairs = [&mut self.point, &mut self.radial, &mut self.target];
        let arrays = pairs.into_iter().flatten().chain([&mut self.radius, &mut self.weight, &mut self.index_square]);
        arrays.for_each(|array| array[to] = array[from]);
    }

    /// Draws all lanes: points, targets, weights and the rays themselves.
    pub(super) fn place(&mut self, from: &Draws<'_>, rays: &mut Bundle) {
        wide(Placing { draw: self, from, rays });
    }
}

struct Placing<'a> {
    draw: &'a mut Draw,
    from: &'a Draws<'a>,
    rays: &'a mut Bundle,
}

impl Work for Placing<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        place(self.draw, self.from, self.rays);
    }
}

#[inline(always)]
fn place(draw: &mut Draw, from: &Draws<'_>, rays: &mut Bundle) {
    let (pitch, [axis_x, axis_y], z) = (from.pitch, from.axis, from.distance);
    for i in 0..TILE {
        // As `Frame::sensor_mm_from_pixel`.
        let x = (axis_x - (draw.corner[0][i] + unit(draw.bits[2][i]))) * pitch;
        let y = (draw.corner[1][i] + unit(draw.bits[3][i]) - axis_y) * pitch;
        let radius = (x * x + y * y).sqrt();
        let inverse = 1.0 / if radius > 0.0 { radius } else { 1.0 };
        (draw.point[0][i], draw.point[1][i], draw.radius[i]) = (x, y, radius);
        draw.radial[0][i] = x * inverse;
        draw.radial[1][i] = if radius > 0.0 { y * inverse } else { 1.0 };
    }
    let [centre, across, along] = &mut draw.ellipse;
    if let Some(footprints) = from.footprints {
        for i in 0..TILE {
            let e = footprints.at(draw.radius[i]);
            (centre[i], across[i], along[i]) = (e.centre, e.across, e.along);
        }
    } else {
        (*centre, *across, *along) = ([from.disk.centre; TILE], [from.disk.across; TILE], [from.disk.along; TILE]);
    }
    for i in 0..TILE {
        let q = disk_from_square([unit(draw.bits[0][i]), unit(draw.bits[1][i])]);
        let (x, y) = (across[i] * q.x, centre[i] + along[i] * q.y);
        (draw.target[0][i], draw.target[1][i]) = (x, y);
        let (rx, ry) = (draw.radial[0][i], draw.radial[1][i]);
        let (tx, ty) = (y * rx - x * ry, y * ry + x * rx);
        let (ox, oy) = (tx - draw.point[0][i], ty - draw.point[1][i]);
        let inverse = 1.0 / (z * z + (ox * ox + oy * oy)).sqrt();
        let cos = z * inverse;
        (rays.x[i], rays.y[i], rays.z[i]) = (tx, ty, z);
        (rays.l[i], rays.m[i], rays.n[i]) = (ox * inverse, oy * inverse, cos);
        // cos θ′ = z / length.
        let share = cos * inverse;
        let area = std::f64::consts::PI * across[i] * along[i];
        draw.weight[i] = draw.index_square[i] * share * share * area;
    }
}

/// A scene made ready for many look-ups.
pub(super) struct Texels<'a> {
    /// Radiance, texel after texel, row after row, channel after channel.
    texture: &'a [f32],
    channels: usize,
    rows: usize,
    cols: usize,
    per_slope: f64,
    axis: [f64; 2],
    vergence: f64,
}

/// Where a tile of rays meets the scene.
pub(super) struct Met {
    /// Column and row of the texel before the point.
    texel: [[u32; TILE]; 2],
    /// The rest, from 0 to 1.
    rest: [[f64; TILE]; 2],
}

impl Met {
    pub(super) fn new() -> Self {
        Self { texel: [[0; TILE]; 2], rest: [[0.0; TILE]; 2] }
    }
}

impl<'a> Texels<'a> {
    /// `scene`, whose texture is in standard layout and has at least one texel.
    pub(super) fn new(scene: &'a Plane, texture: &'a [f32]) -> Self {
        let (channels, rows, cols) = scene.texture.dim();
        let (per_slope, axis, vergence) = (scene.texels_per_slope, scene.axis_texel, scene.vergence);
        Self { texture, channels, rows, cols, per_slope, axis, vergence }
    }

    /// Where rays that left the lens towards the object meet the scene; see [`super::gradient::object_slope`].
    pub(super) fn meet(&self, rays: &Bundle, met: &mut Met) {
        wide(Meet { texels: self, rays, met });
    }

    /// Bilinear radiance of `channel` (of the only one, where there is one) for `lane`: as [`Plane::sample`].
    #[inline]
    pub(super) fn radiance(&self, channel: usize, met: &Met, lane: usize) -> f64 {
        let first = channel.min(self.channels - 1) * self.rows * self.cols;
        let [c0, r0] = [0, 1].map(|k| met.texel[k][lane] as usize);
        let c1 = (c0 + 1).min(self.cols - 1);
        let (r0, r1) = (first + r0 * self.cols, first + (r0 + 1).min(self.rows - 1) * self.cols);
        let at = |i: usize| f64::from(self.texture[i]);
        let (a, b, c, d) = (at(r0 + c0), at(r0 + c1), at(r1 + c0), at(r1 + c1));
        let top = a + met.rest[0][lane] * (b - a);
        let bottom = c + met.rest[0][lane] * (d - c);
        top + met.rest[1][lane] * (bottom - top)
    }
}

struct Meet<'a> {
    texels: &'a Texels<'a>,
    rays: &'a Bundle,
    met: &'a mut Met,
}

impl Work for Meet<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        meet(self.texels, self.rays, self.met);
    }
}

#[inline(always)]
fn meet(texels: &Texels<'_>, rays: &Bundle, met: &mut Met) {
    let v = texels.vergence;
    let (last_col, last_row) = ((texels.cols - 1) as f64, (texels.rows - 1) as f64);
    for i in 0..TILE {
        let inverse = 1.0 / rays.n[i];
        let (mx, my) = (rays.l[i] * inverse, rays.m[i] * inverse);
        let right = v * (rays.x[i] - rays.z[i] * mx) + mx;
        let up = v * (rays.y[i] - rays.z[i] * my) + my;
        // Texel centres stand at ½; beyond the border the nearest texel goes on.
        let col = (texels.axis[0] + right * texels.per_slope - 0.5).max(0.0).min(last_col);
        let row = (texels.axis[1] - up * texels.per_slope - 0.5).max(0.0).min(last_row);
        let (c, r) = (col as i32, row as i32);
        (met.texel[0][i], met.texel[1][i]) = (c.cast_unsigned(), r.cast_unsigned());
        (met.rest[0][i], met.rest[1][i]) = (col - f64::from(c), row - f64::from(r));
    }
}
