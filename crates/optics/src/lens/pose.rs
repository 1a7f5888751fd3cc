//! Tilt and decentre of a surface or of an element, for tolerances.
//!
//! A pose moves a frame by `(dx, dy, 0)` and turns it about its own origin by `R = Rx(aₓ) Ry(a_y) Rz(a_z)`
//! (right-handed; `Rx` takes +y towards +z): `p' = R p + d`. A surface's own pose acts in its nominal vertex frame; an
//! [`Element`] moves its surfaces rigidly about a pivot on the axis, outside their own poses. Surfaces behind stay.

use glam::{DMat3, DVec3};

/// Displacement of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Shift in x and y, mm.
    pub decentre: [f64; 2],
    /// Angles about x, y, z, radians.
    pub tilt: [f64; 3],
}

/// Surfaces `first..=last` moved rigidly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Element {
    /// First surface, counted from 0.
    pub first: usize,
    /// Last surface, included.
    pub last: usize,
    /// The displacement.
    pub pose: Pose,
    /// Pivot on the axis, mm behind the vertex of the first surface.
    pub pivot: f64,
}

/// `p ↦ rotation · p + shift`; also the type of its own cotangent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Rotation.
    pub rotation: DMat3,
    /// Shift, mm.
    pub shift: DVec3,
}

impl Motion {
    /// Cotangent of nothing.
    pub const ZERO: Self = Self { rotation: DMat3::ZERO, shift: DVec3::ZERO };

    /// The same motion seen with z turned round.
    #[must_use]
    pub(crate) fn mirrored(&self) -> Self {
        let m = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        Self { rotation: m * self.rotation * m, shift: m * self.shift }
    }
}

/// Rotations about the three axes and their derivatives.
fn rotations(tilt: [f64; 3]) -> [[DMat3; 2]; 3] {
    std::array::from_fn(|k| {
        let (s, c) = tilt[k].sin_cos();
        // Row by row, transposed at the end: glam's matrices are columns.
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (mut r, mut d) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
        r[k][k] = 1.0;
        (r[i][i], r[i][j], r[j][i], r[j][j]) = (c, -s, s, c);
        (d[i][i], d[i][j], d[j][i], d[j][j]) = (-s, -c, c, -s);
        [r, d].map(|m| DMat3::from_cols_array_2d(&m).transpose())
    })
}

impl Pose {
    /// Whether the frame stays where it is.
    pub fn is_nominal(&self) -> bool {
        *self == Self::default()
    }

    /// The motion of points of the frame.
    pub(crate) fn motion(&self) -> Motion {
        let [x, y, z] = rotations(self.tilt);
        Motion { rotation: x[0] * y[0] * z[0], shift: DVec3::new(self.decentre[0], self.decentre[1], 0.0) }
    }

    /// Adds the pull-back of a cotangent on [`Self::motion`] to `bar`.
    pub(crate) fn motion_vjp(&self, motion_bar: &Motion, bar: &mut Self) {
        bar.decentre[0] += motion_bar.shift.x;
        bar.decentre[1] += motion_bar.shift.y;
        let [x, y, z] = rotations(self.tilt);
        let by = [x[1] * y[0] * z[0], x[0] * y[1] * z[0], x[0] * y[0] * z[1]];
        for (b, d) in bar.tilt.iter_mut().zip(by) {
            *b += (0..3).map(|k| d.col(k).dot(motion_bar.rotation.col(k))).sum::<f64>();
        }
    }
}

/// Where a surface stands relative to its nominal vertex frame: its own pose, then its elements' (first in the list
/// first). `vertex[i]` is the nominal position of surface `i` along the axis.
///
/// `None` if nothing states a pose; a pose that is stated and zero counts, for its derivative is wanted.
pub(crate) fn placed(surface: usize, own: Option<&Pose>, elements: &[Element], vertex: &[f64]) -> Option<Motion> {
    let moving: Vec<&Element> = elements.iter().filter(|e| (e.first..=e.last).contains(&surface)).collect();
    if own.is_none() && moving.is_empty() {
        return None;
    }
    let mut motion = own.copied().unwrap_or_default().motion();
    for element in moving {
        let m = element.pose.motion();
        let arm = DVec3::new(0.0, 0.0, vertex[surface] - vertex[element.first] - element.pivot);
        motion =
            Motion { rotation: m.rotation * motion.rotation, shift: m.rotation * (motion.shift + arm) - arm + m.shift };
    }
    Some(motion)
}

/// Adds the pull-back of a cotangent on [`placed`] to the surface's own pose, the elements' and the vertices.
#[expect(clippy::too_many_arguments, reason = "the forward call's own arguments and four cotangents")]
pub(crate) fn placed_vjp(
    surface: usize,
    own: Option<&Pose>,
    elements: &[Element],
    vertex: &[f64],
    bar: &Motion,
    own_bar: Option<&mut Pose>,
    element_bars: &mut [Element],
    vertex_bar: &mut [f64],
) {
    // The states on the way out.
    let own = own.copied().unwrap_or_default();
    let mut states = vec![own.motion()];
    let order: Vec<usize> =
        (0..elements.len()).filter(|i| (elements[*i].first..=elements[*i].last).contains(&surface)).collect();
    for i in &order {
        let (m, s) = (elements[*i].pose.motion(), states[states.len() - 1]);
        let arm = DVec3::new(0.0, 0.0, vertex[surface] - vertex[elements[*i].first] - elements[*i].pivot);
        states.push(Motion { rotation: m.rotation * s.rotation, shift: m.rotation * (s.shift + arm) - arm + m.shift });
    }
    let mut bar = *bar;
    for (k, i) in order.iter().enumerate().rev() {
        let (element, before) = (&elements[*i], states[k]);
        let m = element.pose.motion();
        let arm = DVec3::new(0.0, 0.0, vertex[surface] - vertex[element.first] - element.pivot);
        let lever = before.shift + arm;
        let outer = DMat3::from_cols(bar.shift * lever.x, bar.shift * lever.y, bar.shift * lever.z);
        let motion_bar = Motion { rotation: bar.rotation * before.rotation.transpose() + outer, shift: bar.shift };
        element.pose.motion_vjp(&motion_bar, &mut element_bars[*i].pose);
        let back = m.rotation.transpose() * bar.shift;
        let arm_bar = back.z - bar.shift.z;
        vertex_bar[surface] += arm_bar;
        vertex_bar[element.first] -= arm_bar;
        element_bars[*i].pivot -= arm_bar;
        bar = Motion { rotation: m.rotation.transpose() * bar.rotation, shift: back };
    }
    if let Some(own_bar) = own_bar {
        own.motion_vjp(&bar, own_bar);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, between, central_difference};

    fn random(rng: &mut fastrand::Rng, size: f64) -> Pose {
        let mut draw = || between(rng, -size, size);
        Pose { decentre: [draw(), draw()], tilt: [draw(), draw(), draw()] }
    }

    #[test]
    fn tilts_turn_the_way_the_head_says() {
        let about_x = Pose { tilt: [std::f64::consts::FRAC_PI_2, 0.0, 0.0], ..Pose::default() }.motion();
        assert!((about_x.rotation * DVec3::Y - DVec3::Z).length() < 1e-15);
        let about_z = Pose { tilt: [0.0, 0.0, std::f64::consts::FRAC_PI_2], ..Pose::default() }.motion();
        assert!((about_z.rotation * DVec3::X - DVec3::Y).length() < 1e-15);
    }

    #[test]
    fn motion_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let (pose, dot) = (random(rng, 0.8), random(rng, 1.0));
        let mut draw = || DVec3::new(between(rng, -1.0, 1.0), between(rng, -1.0, 1.0), between(rng, -1.0, 1.0));
        let motion_bar = Motion { rotation: DMat3::from_cols(draw(), draw(), draw()), shift: draw() };
        let f = |h: f64| {
            let moved = Pose {
                decentre: std::array::from_fn(|k| pose.decentre[k] + h * dot.decentre[k]),
                tilt: std::array::from_fn(|k| pose.tilt[k] + h * dot.tilt[k]),
            };
            let m = moved.motion();
            m.shift.dot(motion_bar.shift)
                + (0..3).map(|k| m.rotation.col(k).dot(motion_bar.rotation.col(k))).sum::<f64>()
        };
        let mut bar = Pose::default();
        pose.motion_vjp(&motion_bar, &mut bar);
        let pulled = bar.decentre.iter().zip(&dot.decentre).map(|(a, b)| a * b).sum::<f64>()
            + bar.tilt.iter().zip(&dot.tilt).map(|(a, b)| a * b).sum::<f64>();
        assert_rel(pulled, central_difference(f, 1e-3), 1e-10, 1e-2, "pose");
    }

    /// A pull-back through a surface's pose and two elements against differences.
    #[test]
    fn placed_vjp_agrees_with_differences() {
        for seed in 0..50 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let vertex = [0.0, 3.0, 7.5];
            let own = random(rng, 0.4);
            let elements: Vec<Element> =
                [0, 1].iter().map(|f| Element { first: *f, last: 2, pose: random(rng, 0.5), pivot: 1.5 }).collect();
            let (own_dot, dots) = (random(rng, 1.0), [random(rng, 1.0), random(rng, 1.0)]);
            let vertex_dot = [0.3, -0.8, 1.1];
            let mut draw = || DVec3::new(between(rng, -1.0, 1.0), between(rng, -1.0, 1.0), between(rng, -1.0, 1.0));
            let bar = Motion { rotation: DMat3::from_cols(draw(), draw(), draw()), shift: draw() };
            let moved = |pose: &Pose, dot: &Pose, h: f64| Pose {
                decentre: std::array::from_fn(|k| pose.decentre[k] + h * dot.decentre[k]),
                tilt: std::array::from_fn(|k| pose.tilt[k] + h * dot.tilt[k]),
            };
            let f = |h: f64| {
                let e: Vec<Element> =
                    elements.iter().zip(&dots).map(|(e, dot)| Element { pose: moved(&e.pose, dot, h), ..*e }).collect();
                let v: Vec<f64> = vertex.iter().zip(&vertex_dot).map(|(a, b)| a + h * b).collect();
                let m = placed(2, Some(&moved(&own, &own_dot, h)), &e, &v).expect("moved");
                m.shift.dot(bar.shift) + (0..3).map(|k| m.rotation.col(k).dot(bar.rotation.col(k))).sum::<f64>()
            };
            let mut element_bars = elements.clone();
            element_bars.iter_mut().for_each(|e| (e.pose, e.pivot) = (Pose::default(), 0.0));
            let (mut own_bar, mut vertex_bar) = (Pose::default(), [0.0; 3]);
            placed_vjp(2, Some(&own), &elements, &vertex, &bar, Some(&mut own_bar), &mut element_bars, &mut vertex_bar);
            let dot = |a: &Pose, b: &Pose| {
                a.decentre.iter().zip(&b.decentre).chain(a.tilt.iter().zip(&b.tilt)).map(|(x, y)| x * y).sum::<f64>()
            };
            let pulled = dot(&own_bar, &own_dot)
                + element_bars.iter().zip(&dots).map(|(a, b)| dot(&a.pose, b)).sum::<f64>()
                + vertex_bar.iter().zip(&vertex_dot).map(|(a, b)| a * b).sum::<f64>();
            assert_rel(pulled, central_difference(f, 1e-4), 1e-9, 1e-2, &format!("seed {seed}"));
        }
    }
}
