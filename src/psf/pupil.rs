//! The map from the real stop to the sensor for one field point and wavelength.
//!
//! Rays are aimed at a few nodes of the stop and continued to a dense set by a polynomial over the stop, fitted by
//! least squares (`psf/fit.rs`): constant matrices, so the adjoint is their transpose. The residual at the nodes is
//! measured and reported. By rotational symmetry the field lies on +y; only the half `x ≥ 0` of the stop is traced and
//! evaluated, and mirrored at the end.
//!
//! A dense ray carries the étendue `N⁴ |∂e/∂(stop)| dA` (see [`crate::trace::launch`]) times the soft edge of every
//! clear aperture that clips it (`psf/clip.rs`): a C² ramp about one pupil-sample spacing wide, symmetric about
//! the hard edge.
//! Apertures that no node comes near are left out. Where node rays fail, the largest concentric part of the stop whose nodes
//! all survive is kept and the rest counts as lost ([`PupilMap::kept`]).

use glam::{DVec2, DVec3};

use super::clip::Clip;
use super::old_fit::{Fit, Of};
use crate::trace::aim::{ParaxialPupil, aim, aim_vjp};
use crate::trace::launch::{FieldPoint, launch, launch_vjp};
use crate::trace::sequential::{Hit, HitBar, trace, trace_vjp};
use crate::trace::{Failure, System, SystemGradient};

/// Node rays, dense points and the constant matrices between them, on the unit stop.
#[derive(Clone, Debug)]
pub struct PupilSampling {
    /// Nodes with `x ≥ 0`; their mirror images follow by symmetry.
    pub(super) nodes: Vec<DVec2>,
    /// Dense points (both halves), equal area.
    pub points: Vec<DVec2>,
    /// Functions even in x, from nodes to the first half of the points (`x > 0`).
    pub(super) even: Fit,
    /// Functions odd in x.
    pub(super) odd: Fit,
    /// Spacing of the dense points on the unit stop.
    pub(super) spacing: f64,
}

/// Fractions of the stop tried in turn when rays fail.
const FRACTIONS: [f64; 6] = [1.0, 0.93, 0.85, 0.75, 0.6, 0.4];

impl PupilSampling {
    /// A polynomial of `degree` over the stop, evaluated at about `dense` points.
    pub fn new(degree: usize, dense: usize) -> Self {
        Self::with_points(degree, equal_area_rings(dense))
    }

    /// A polynomial of `degree` evaluated at `points` of the unit stop, whose second half mirrors the first (`x ≥ 0`) in
    /// x. Each point's weight stands for an equal area, whether or not it has one.
    pub fn with_points(degree: usize, points: Vec<DVec2>) -> Self {
        // Rings at Gauss–Lobatto-like radii (rim included), half-turn azimuths symmetric about y.
        let rings = degree / 2 + 2;
        let azimuths = degree + 2;
        let mut nodes = Vec::new();
        for i in 0..rings {
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let radius = (std::f64::consts::FRAC_PI_2 * (i as f64 + 1.0) / rings as f64).sin();
            for j in 0..azimuths {
                #[expect(clippy::cast_precision_loss, reason = "small counts")]
                let angle = std::f64::consts::PI * ((j as f64 + 0.5) / azimuths as f64 - 0.5);
                nodes.push(radius * DVec2::new(angle.cos(), angle.sin()));
            }
        }
        let half = &points[..points.len() / 2];
        let even = Fit::new(&nodes, half, degree, 0);
        let odd = Fit::new(&nodes, half, degree, 1);
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let spacing = (std::f64::consts::PI / points.len() as f64).sqrt();
        Self { nodes, points, even, odd, spacing }
    }

    /// Area of the unit stop that a dense point stands for.
    fn area(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let count = self.points.len() as f64;
        std::f64::consts::PI / count
    }

    /// Rays traced per field point and wavelength.
    pub fn traced_rays(&self) -> usize {
        self.nodes.len()
    }
}

/// About `count` points of equal area on the unit disk: rings of as many points as their area asks for, mirror images
/// in x and nearly so in y, so that a beam cut from above and one cut from below come out alike.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small counts"
)]
fn equal_area_rings(count: usize) -> Vec<DVec2> {
    use std::f64::consts::PI;
    let half = count.div_ceil(2).max(1);
    let rings = ((count as f64 / PI).sqrt().round() as usize).clamp(1, half);
    // Points of the half `x > 0`, ring by ring; the last takes what is left.
    let mut in_ring: Vec<usize> = (0..rings)
        .map(|k| ((2 * k + 1) as f64 * half as f64 / (rings * rings) as f64).round().max(1.0) as usize)
        .collect();
    let inner: usize = in_ring[..rings - 1].iter().sum();
    in_ring[rings - 1] = half.saturating_sub(inner).max(1);
    let total: usize = in_ring.iter().sum();
    let mut points = Vec::with_capacity(2 * total);
    let mut before = 0;
    for n in in_ring {
        let radius = ((before as f64 + 0.5 * n as f64) / total as f64).sqrt();
        before += n;
        points.extend((0..n).map(|j| {
            let (x, y) = (PI * (j as f64 + 0.5) / n as f64).sin_cos();
            radius * DVec2::new(x, y)
        }));
    }
    let mirrored: Vec<DVec2> = points.iter().map(|p| DVec2::new(-p.x, p.y)).collect();
    points.extend(mirrored);
    points
}

/// Dense landings and weights of one field point on +y and one wavelength.
#[derive(Clone, Debug)]
pub struct PupilMap {
    /// Landings on the sensor, mm.
    pub x: Vec<f64>,
    /// Landings on the sensor, mm.
    pub y: Vec<f64>,
    /// Weights: étendue per unit object slope squared, soft edges included, mm².
    pub weight: Vec<f64>,
    /// Fraction of the stop's radius that was traced (1 unless rays fail).
    pub kept: f64,
    /// Largest landing residual of the polynomial at its nodes (y component), mm.
    pub residual: f64,
    // Of the half `x > 0`: the mirrored half has the same.
    /// Dense weights before the soft edges.
    open: Vec<f64>,
    clips: Vec<Clip>,
    nodes: Vec<Node>,
    /// Points on the first vertex plane.
    e: [Vec<f64>; 2],
    /// `∂e_x/∂s_x, ∂e_x/∂s_y, ∂e_y/∂s_x, ∂e_y/∂s_y` over the unit stop.
    jacobian: [Vec<f64>; 4],
    /// `N⁴` and `−4 N⁶`.
    n4: [Vec<f64>; 2],
}

#[derive(Clone, Debug)]
struct Node {
    target: DVec2,
    e: DVec2,
    hits: Vec<Hit>,
}

impl PupilMap {
    /// Traces the nodes of `sampling` for `field` (on +y) through `system`.
    pub fn compute(
        system: &System,
        pupil: ParaxialPupil,
        sampling: &PupilSampling,
        field: FieldPoint,
    ) -> Result<Self, Failure> {
        Self::compute_near(system, pupil, sampling, field, None)
    }

    /// The same, its rays sought from those of `near`: the map of a neighbouring wavelength.
    pub(super) fn compute_near(
        system: &System,
        pupil: ParaxialPupil,
        sampling: &PupilSampling,
        field: FieldPoint,
        near: Option<&Self>,
    ) -> Result<Self, Failure> {
        debug_assert!(field.slope.x == 0.0, "the field lies on +y");
        let mut failure = None;
        for kept in FRACTIONS {
            let near = near.filter(|m| m.kept == kept).map(|m| m.nodes.as_slice());
            match trace_nodes(system, pupil, sampling, field, kept, near) {
                Ok(nodes) => return Ok(Self::from_nodes(system, sampling, field, nodes, kept)),
                Err(f) => failure = failure.or(Some(f)),
            }
        }
        Err(failure.expect("at least one fraction was tried"))
    }

    fn from_nodes(system: &System, sampling: &PupilSampling, field: FieldPoint, nodes: Vec<Node>, kept: f64) -> Self {
        let image = system.image();
        let (odd, even) = (&sampling.odd, &sampling.even);
        let gather = |f: &dyn Fn(&Node) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
        let at = |surface: usize| (gather(&|n| n.hits[surface].at.point.x), gather(&|n| n.hits[surface].at.point.y));
        let (x_nodes, y_nodes) = at(image);
        let (cx, cy) = (odd.coefficients(&x_nodes), even.coefficients(&y_nodes));
        let residual = even.residual(&cy, &y_nodes);
        // Étendue: N⁴ |∂e/∂stop| dA; N is a function of e and the field alone.
        let (ex, ey) = (odd.coefficients(&gather(&|n| n.e.x)), even.coefficients(&gather(&|n| n.e.y)));
        let jacobian = [odd.dense(Of::X, &ex), odd.dense(Of::Y, &ex), even.dense(Of::X, &ey), even.dense(Of::Y, &ey)];
        let e = [odd.dense(Of::Value, &ex), even.dense(Of::Value, &ey)];
        let n4 = cosines(field, &e);
        let [a, b, c, d] = &jacobian;
        let area = sampling.area();
        let open: Vec<f64> = (0..n4[0].len()).map(|q| area * n4[0][q] * (a[q] * d[q] - b[q] * c[q])).collect();
        // Apertures that any node comes near.
        let mut weight = open.clone();
        let mut clips = Vec::new();
        for (surface, s) in system.surfaces.iter().enumerate() {
            if surface == system.stop || !s.semi_diameter.is_finite() {
                continue;
            }
            let (cx, cy) = at(surface);
            let Some(clip) = Clip::new(sampling, surface, s.semi_diameter, &cx, &cy) else { continue };
            weight.iter_mut().enumerate().for_each(|(q, w)| *w *= clip.share(q));
            clips.push(clip);
        }
        let x = mirrored(odd.dense(Of::Value, &cx), -1.0);
        let y = mirrored(even.dense(Of::Value, &cy), 1.0);
        Self { x, y, weight: mirrored(weight, 1.0), kept, residual, open, clips, nodes, e, jacobian, n4 }
    }

    /// Apertures that clip this beam, by surface.
    pub fn clipping(&self) -> Vec<usize> {
        self.clips.iter().map(|c| c.surface).collect()
    }

    /// Pulls cotangents on landings and weights back to the system (added to `out`); returns that of the slope (y).
    #[expect(clippy::too_many_arguments, reason = "the forward call's own arguments and three cotangents")]
    pub fn vjp(
        &self,
        system: &System,
        sampling: &PupilSampling,
        field: FieldPoint,
        x_bar: &[f64],
        y_bar: &[f64],
        weight_bar: &[f64],
        out: &mut SystemGradient,
    ) -> f64 {
        let (odd, even) = (&sampling.odd, &sampling.even);
        let (x_bar, y_bar) = (folded(x_bar, -1.0), folded(y_bar, 1.0));
        let weight_bar = folded(weight_bar, 1.0);
        let count = weight_bar.len();
        // Soft edges: weight = open · Π share.
        let shares: Vec<Vec<f64>> = self.clips.iter().map(|c| (0..count).map(|q| c.share(q)).collect()).collect();
        let open_bar: Vec<f64> =
            (0..count).map(|q| weight_bar[q] * shares.iter().map(|s| s[q]).product::<f64>()).collect();
        let mut bars_at: Vec<(usize, Vec<f64>, Vec<f64>)> = Vec::with_capacity(self.clips.len() + 1);
        for (k, clip) in self.clips.iter().enumerate() {
            let others = |q: usize| (0..shares.len()).filter(|j| *j != k).map(|j| shares[j][q]).product::<f64>();
            let share_bar: Vec<f64> = (0..count).map(|q| weight_bar[q] * self.open[q] * others(q)).collect();
            let (nodes, radius) = clip.share_vjp(sampling, &share_bar);
            out.semi_diameters[clip.surface] += radius;
            bars_at.push((clip.surface, nodes.x, nodes.y));
        }
        // Étendue.
        let area = sampling.area();
        let [a, b, c, d] = &self.jacobian;
        let mut jacobian_bar: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; count]);
        let mut e_bar = [vec![0.0; count], vec![0.0; count]];
        let mut slope_bar = 0.0;
        for q in 0..count {
            let det = a[q] * d[q] - b[q] * c[q];
            let det_bar = open_bar[q] * area * self.n4[0][q];
            jacobian_bar[0][q] = det_bar * d[q];
            jacobian_bar[1][q] = -det_bar * c[q];
            jacobian_bar[2][q] = -det_bar * b[q];
            jacobian_bar[3][q] = det_bar * a[q];
            // N⁴ = (1 + g_x² + g_y²)^{-2} with g = v e + s; ∂N⁴/∂g = −4 g N⁶ = n4[1]·g.
            let n4_bar = open_bar[q] * area * det * self.n4[1][q];
            let gx = field.vergence * self.e[0][q] + field.slope.x;
            let gy = field.vergence * self.e[1][q] + field.slope.y;
            e_bar[0][q] = n4_bar * gx * field.vergence;
            e_bar[1][q] = n4_bar * gy * field.vergence;
            slope_bar += n4_bar * gy;
        }
        // Back to the nodes.
        let image = system.image();
        let back = |fit: &Fit, parts: &[(Of, &[f64])]| {
            let mut sum = fit.no_bar();
            parts.iter().for_each(|(of, bar)| fit.pull(*of, bar, &mut sum));
            fit.coefficients_vjp(&sum)
        };
        bars_at.push((image, back(odd, &[(Of::Value, &x_bar)]), back(even, &[(Of::Value, &y_bar)])));
        let [a, b, c, d] = &jacobian_bar;
        let ex_bar = back(odd, &[(Of::Value, &e_bar[0]), (Of::X, a), (Of::Y, b)]);
        let ey_bar = back(even, &[(Of::Value, &e_bar[1]), (Of::X, c), (Of::Y, d)]);
        let mut hit_bars = vec![HitBar::default(); image + 1];
        for (j, node) in self.nodes.iter().enumerate() {
            hit_bars.fill(HitBar::default());
            for (surface, bx, by) in &bars_at {
                hit_bars[*surface].point += DVec3::new(bx[j], by[j], 0.0);
            }
            let (o, d) = trace_vjp(system, &node.hits, &hit_bars, out);
            let (from_trace, s) = launch_vjp(field, launch(field, node.e), o, d);
            let aimed = aim_vjp(system, field, node.e, &node.hits, from_trace + DVec2::new(ex_bar[j], ey_bar[j]), out);
            slope_bar += s.y + aimed.slope.y;
            out.stop_semi_diameter += aimed.target.dot(node.target) / system.stop_semi_diameter;
        }
        slope_bar
    }
}

/// `N⁴` and `−4 N⁶` at the dense points.
fn cosines(field: FieldPoint, e: &[Vec<f64>; 2]) -> [Vec<f64>; 2] {
    let n2: Vec<f64> = e[0]
        .iter()
        .zip(&e[1])
        .map(|(x, y)| {
            let (gx, gy) = (field.vergence * x + field.slope.x, field.vergence * y + field.slope.y);
            1.0 / (1.0 + gx * gx + gy * gy)
        })
        .collect();
    [n2.iter().map(|v| v * v).collect(), n2.iter().map(|v| -4.0 * v * v * v).collect()]
}

/// Values on both halves of the stop from those on the half `x > 0`.
fn mirrored(mut half: Vec<f64>, sign: f64) -> Vec<f64> {
    half.extend_from_within(..);
    let count = half.len() / 2;
    half[count..].iter_mut().for_each(|v| *v *= sign);
    half
}

/// Its transpose.
fn folded(whole: &[f64], sign: f64) -> Vec<f64> {
    let (right, left) = whole.split_at(whole.len() / 2);
    right.iter().zip(left).map(|(a, b)| a + sign * b).collect()
}

fn trace_nodes(
    system: &System,
    pupil: ParaxialPupil,
    sampling: &PupilSampling,
    field: FieldPoint,
    kept: f64,
    near: Option<&[Node]>,
) -> Result<Vec<Node>, Failure> {
    let mut hits = Vec::with_capacity(system.surfaces.len());
    let radius = kept * system.stop_semi_diameter;
    let chief = match near {
        Some(_) => DVec2::ZERO,
        None => aim(system, pupil, field, DVec2::ZERO, None, &mut hits)?,
    };
    let magnification = pupil.scale / (1.0 + pupil.z * field.vergence);
    let mut nodes = Vec::with_capacity(sampling.nodes.len());
    for (j, s) in sampling.nodes.iter().enumerate() {
        let target = *s * radius;
        // From the neighbour's ray, or from the chief ray outwards by the paraxial magnification.
        let start = near.and_then(|n| n.get(j)).map_or_else(|| chief + target * magnification, |n| n.e);
        let e = aim(system, pupil, field, target, Some(start), &mut hits)?;
        trace(system, launch(field, e), system.image(), &mut hits)?;
        nodes.push(Node { target, e, hits: hits.clone() });
    }
    Ok(nodes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{LensGradient, builtin, variables::Variables};
    use crate::testing::{assert_rel, central_difference};

    fn at(lens: &crate::lens::Lens, slope: f64) -> FieldPoint {
        FieldPoint { slope: DVec2::new(0.0, slope), vergence: lens.object_vergence }
    }

    /// Dense landings against directly aimed rays: the polynomial's own error, per lens.
    #[test]
    fn dense_landings_agree_with_aimed_rays() {
        for (name, slope, tol) in [("two_element", 0.4, 2e-4), ("cooke_triplet", 0.3, 1e-4), ("phone", 0.5, 1e-3)] {
            let lens = builtin::lens(name).expect("shipped");
            let system = System::new(&lens, 550.0);
            let pupil = ParaxialPupil::new(&lens);
            let sampling = PupilSampling::new(9, 200);
            let map = PupilMap::compute(&system, pupil, &sampling, at(&lens, slope)).expect("traces");
            let mut hits = Vec::new();
            let mut worst = 0.0f64;
            for (q, s) in sampling.points.iter().enumerate() {
                let target = *s * system.stop_semi_diameter * map.kept;
                let e = aim(&system, pupil, at(&lens, slope), target, None, &mut hits).expect("aims");
                let hit = trace(&system, launch(at(&lens, slope), e), system.image(), &mut hits).expect("traces");
                worst = worst.max((hit.at.point.x - map.x[q]).hypot(hit.at.point.y - map.y[q]));
            }
            eprintln!("{name}: kept {}, polynomial error {worst:e} mm, residual {:e}", map.kept, map.residual);
            assert!(worst < tol, "{name}: {worst:e} mm");
        }
    }

    /// Rings of equal area: their count, their mirror images, their moments those of the disk.
    #[test]
    fn dense_points_cover_the_disk_evenly() {
        for count in [1, 2, 7, 60, 100, 200, 512, 3000] {
            let points = equal_area_rings(count);
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let n = points.len() as f64;
            assert!((points.len()).abs_diff(count) <= 1, "{count}: {}", points.len());
            let (right, left) = points.split_at(points.len() / 2);
            assert!(right.iter().zip(left).all(|(a, b)| a.x == -b.x && a.y == b.y && a.x > 0.0));
            let mean = |f: &dyn Fn(&DVec2) -> f64| points.iter().map(f).sum::<f64>() / n;
            // ⟨y⟩ = 0, ⟨r²⟩ = 1/2, ⟨y²⟩ = 1/4 over the disk.
            assert!(mean(&|p| p.y).abs() < 1e-12, "{count}");
            assert_rel(mean(&|p| p.length_squared()), 0.5, 1e-12, 0.0, "second moment");
            if count >= 60 {
                assert_rel(mean(&|p| p.y * p.y), 0.25, 1e-2, 0.0, "moment of y");
            }
        }
    }

    /// Landings, weights (étendue and soft edges) and stop size against differences of the whole lens.
    #[test]
    fn pupil_map_vjp_agrees_with_differences() {
        for (name, slope) in [("two_element", 0.5), ("cooke_triplet", 0.35), ("three_element", 0.02), ("phone", 0.5)] {
            let lens = builtin::lens(name).expect("shipped");
            let sampling = PupilSampling::new(7, 60);
            let rng = &mut fastrand::Rng::with_seed(9);
            let count = sampling.points.len();
            let bars: [Vec<f64>; 3] = std::array::from_fn(|_| (0..count).map(|_| rng.f64() - 0.5).collect());
            let value = |lens: &crate::lens::Lens, slope: f64| {
                let system = System::new(lens, 480.0);
                let map =
                    PupilMap::compute(&system, ParaxialPupil::new(lens), &sampling, at(lens, slope)).expect("traces");
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
                dot(&map.x, &bars[0]) + dot(&map.y, &bars[1]) + dot(&map.weight, &bars[2])
            };
            let system = System::new(&lens, 480.0);
            let map =
                PupilMap::compute(&system, ParaxialPupil::new(&lens), &sampling, at(&lens, slope)).expect("traces");
            let mut out = SystemGradient::zeros(&system);
            let slope_bar = map.vjp(&system, &sampling, at(&lens, slope), &bars[0], &bars[1], &bars[2], &mut out);
            let mut g = LensGradient::zeros(&lens);
            out.add_to(&lens, 480.0, &mut g);
            let numeric = central_difference(|h| value(&lens, slope + h), 1e-5);
            assert_rel(slope_bar, numeric, 1e-7, 1e-3, &format!("{name} slope"));
            let vars = Variables::all(&lens);
            let x = vars.values(&lens);
            for seed in 0..4 {
                let rng = &mut fastrand::Rng::with_seed(seed);
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let pulled: f64 = vars.gradient(&g).iter().zip(&dx).map(|(a, b)| a * b).sum();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    value(&vars.lens(&lens, &moved), slope)
                };
                assert_rel(pulled, central_difference(f, 1e-6), 1e-6, 1e-2, &format!("{name} seed {seed}"));
            }
        }
    }
}
