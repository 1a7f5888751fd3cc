//! The camera that looks down a street.

use fastrand::Rng;

use super::palette::between;

/// Height of the camera, m.
pub(super) const EYE: f32 = 1.7;

/// The camera: position across the street, direction, focal length in pixels.
pub(super) struct View {
    pub(super) x: f32,
    pub(super) yaw: [f32; 2],
    pub(super) pitch: [f32; 2],
    pub(super) focal: f32,
    pub(super) centre: [f32; 2],
}

impl View {
    pub(super) fn new(rng: &mut Rng, rows: usize, cols: usize, half_width: f32) -> Self {
        let (yaw, pitch) = (between(rng, -0.5, 0.5), between(rng, 0.0, 0.2));
        let (width, height) = (cols as f32, rows as f32);
        Self {
            x: between(rng, -0.6, 0.6) * half_width,
            yaw: [yaw.cos(), yaw.sin()],
            pitch: [pitch.cos(), pitch.sin()],
            focal: width.max(height) * between(rng, 0.7, 1.1),
            centre: [0.5 * width, between(rng, 0.5, 0.65) * height],
        }
    }

    /// Direction of the ray through a pixel position.
    pub(super) fn ray(&self, px: f32, py: f32) -> [f32; 3] {
        let (x, y) = ((px - self.centre[0]) / self.focal, (self.centre[1] - py) / self.focal);
        let (up, ahead) = (self.pitch[0] * y + self.pitch[1], self.pitch[0] - self.pitch[1] * y);
        [self.yaw[0] * x + self.yaw[1] * ahead, up, self.yaw[0] * ahead - self.yaw[1] * x]
    }

    /// Pixel position of a point and pixels per metre there; `None` closer than half a metre.
    pub(super) fn project(&self, p: [f32; 3]) -> Option<([f32; 2], f32)> {
        let (x, y) = (p[0] - self.x, p[1] - EYE);
        let (right, ahead) = (self.yaw[0] * x - self.yaw[1] * p[2], self.yaw[1] * x + self.yaw[0] * p[2]);
        let (up, depth) = (self.pitch[0] * y - self.pitch[1] * ahead, self.pitch[0] * ahead + self.pitch[1] * y);
        let scale = self.focal / depth;
        (depth > 0.5).then(|| ([self.centre[0] + right * scale, self.centre[1] - up * scale], scale))
    }
}
