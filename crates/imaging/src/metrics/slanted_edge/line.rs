//! The edge's course: a straight line, or a parabola along it.

use super::samples::Sample;

/// A line through the picture with a slight bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    /// Where offset and tangent coordinate are counted from, `[x, y]` pixels.
    pub(super) centre: [f64; 2],
    /// Direction of the normal towards the brighter side, rad from +x towards +y.
    pub(super) angle: f64,
    /// Distance from the centre along the normal, pixels.
    pub(super) offset: f64,
    /// Curvature, 1/px; positive bends towards the brighter side.
    pub(super) curvature: f64,
}

impl Line {
    /// Distance from the line, positive on the brighter side, and the place along it, pixels.
    pub(super) fn distance(&self, s: &Sample) -> [f64; 2] {
        let (sin, cos) = self.angle.sin_cos();
        let [x, y] = [s.x - self.centre[0], s.y - self.centre[1]];
        let t = cos * y - sin * x;
        let bend = self.curvature * t;
        [(cos * x + sin * y - self.offset - 0.5 * bend * t) / (1.0 + bend * bend).sqrt(), t]
    }

    /// The point of the line at the place `t` along it.
    pub(super) fn point(&self, t: f64) -> [f64; 2] {
        let (sin, cos) = self.angle.sin_cos();
        let d = self.offset + 0.5 * self.curvature * t * t;
        [self.centre[0] + d * cos - t * sin, self.centre[1] + d * sin + t * cos]
    }
}
