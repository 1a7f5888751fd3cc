//! The trace in any arithmetic: f32, f64, double-double. One plain loop, for measuring what precision costs.
//!
//! The branch of every intersection comes from an f64 trace of the same ray; here the root is polished by Newton in the
//! arithmetic asked for. In double-double (32 digits) the result serves as the reference for f64 rays, and central
//! differences with steps of 1e-10 are derivatives to 20 digits: an oracle for the adjoint that shares none of its
//! formulas.

use std::ops::{Add, Div, Mul, Neg, Sub};

use glam::DVec3;
use twofloat::TwoFloat;

use super::sequential::Hit;
use super::{Ray, System};
use crate::lens::freeform::Polynomial;
use crate::lens::{Kind, Lens, Parameter, Pose, Shape};

/// What a trace needs of its numbers.
pub trait Scalar:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// Rounded from f64.
    fn of(x: f64) -> Self;
    /// Rounded to f64.
    fn to_f64(self) -> f64;
    /// Square root.
    fn root(self) -> Self;
}

impl Scalar for f64 {
    fn of(x: f64) -> Self {
        x
    }
    fn to_f64(self) -> f64 {
        self
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

impl Scalar for f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
    fn of(x: f64) -> Self {
        x as f32
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

/// 32 digits as the sum of two f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubleDouble(TwoFloat);

impl Scalar for DoubleDouble {
    fn of(x: f64) -> Self {
        Self(TwoFloat::from(x))
    }
    fn to_f64(self) -> f64 {
        self.0.hi() + self.0.lo()
    }
    fn root(self) -> Self {
        Self(self.0.sqrt())
    }
}

impl Add for DoubleDouble {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl Sub for DoubleDouble {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }
}

impl Mul for DoubleDouble {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

impl Neg for DoubleDouble {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Div for DoubleDouble {
    type Output = Self;
    /// twofloat 0.8.4 divides to 16 digits only; its remainder, divided once more, gives the other 16.
    fn div(self, other: Self) -> Self {
        let quotient = self.0 / other.0;
        Self(quotient + (self.0 - quotient * other.0) / other.0)
    }
}

type Vec3<S> = [S; 3];

/// Powers of x and y, coefficient.
type Monomial<S> = (usize, usize, S);

/// Radius and monomials of freeform terms.
type Freeform<S> = (S, Vec<Monomial<S>>);

/// One surface in arithmetic `S`.
#[derive(Clone)]
struct PreciseSurface<S> {
    curvature: S,
    conic: S,
    even: Vec<S>,
    odd: Vec<S>,
    zernike: Option<Freeform<S>>,
    xy: Option<Freeform<S>>,
    distance: S,
    indices: [S; 2],
    /// Focal length of an ideal lens, and [`crate::trace::system::TraceSurface::conjugate`].
    ideal: Option<[S; 2]>,
    /// Rotation (rows) and shift.
    motion: Option<([Vec3<S>; 3], Vec3<S>)>,
}

/// A [`System`] in arithmetic `S`.
#[derive(Clone)]
pub struct PreciseSystem<S> {
    surfaces: Vec<PreciseSurface<S>>,
}

/// Where a precise ray lands: x, y on the image plane, direction, optical path from its origin.
#[derive(Clone, Copy)]
pub struct Landing<S> {
    /// Point on the image plane, mm.
    pub x: S,
    /// Point on the image plane, mm.
    pub y: S,
    /// Direction behind the last surface.
    pub direction: [S; 3],
    /// Optical path, mm.
    pub path: S,
}

/// Which number of a system is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// A number of the lens's form; glass and poses of elements aside.
    Of(Parameter),
    /// Index of the space behind a surface.
    IndexBehind(usize),
}

impl<S: Scalar> PreciseSystem<S> {
    /// `system`, every number rounded to `S`.
    pub fn new(system: &System) -> Self {
        let of = |list: &[f64]| list.iter().map(|x| S::of(*x)).collect::<Vec<S>>();
        let surfaces = system
            .surfaces
            .iter()
            .map(|s| {
                let Shape { curvature, conic, asphere, odd, zernike, xy, ideal } = &s.shape;
                let freeform = |p: &Polynomial| {
                    (S::of(p.radius()), p.terms().iter().map(|(i, j, c)| (*i, *j, S::of(*c))).collect())
                };
                PreciseSurface {
                    curvature: S::of(*curvature),
                    conic: S::of(*conic),
                    even: of(asphere),
                    odd: of(odd),
                    zernike: zernike.as_ref().map(|z| freeform(z.polynomial())),
                    xy: xy.as_ref().map(|p| freeform(p.polynomial())),
                    distance: S::of(s.distance),
                    indices: [S::of(s.index_before), S::of(s.index_after)],
                    ideal: ideal.map(|f| [f, s.conjugate].map(S::of)),
                    motion: s.motion.map(|m| {
                        let rows = m.rotation.transpose();
                        (
                            [rows.x_axis, rows.y_axis, rows.z_axis].map(|r| r.to_array().map(S::of)),
                            m.shift.to_array().map(S::of),
                        )
                    }),
                }
            })
            .collect();
        Self { surfaces }
    }

    /// Moves one number by `h`. False for what it cannot move: poses of and thicknesses inside elements, glass formulas.
    pub(crate) fn bump(&mut self, lens: &Lens, number: Number, h: f64) -> bool {
        let h = S::of(h);
        let add = |x: &mut S| *x = *x + h;
        let last = self.surfaces.len() - 1;
        match number {
            Number::IndexBehind(i) => {
                add(&mut self.surfaces[i].indices[1]);
                add(&mut self.surfaces[i + 1].indices[0]);
                if i + 1 == last {
                    add(&mut self.surfaces[last].indices[1]);
                }
            }
            Number::Of(Parameter { kind, of: i, entry }) => match kind {
                Kind::Curvature => add(&mut self.surfaces[i].curvature),
                Kind::Conic => add(&mut self.surfaces[i].conic),
                Kind::Even => add(&mut self.surfaces[i].even[entry]),
                Kind::Odd => add(&mut self.surfaces[i].odd[entry]),
                // Inside an element a thickness moves the lever arms as well: not done here.
                Kind::Thickness if lens.elements.iter().any(|e| e.first <= i && i < e.last) => return false,
                Kind::Thickness => add(&mut self.surfaces[i + 1].distance),
                Kind::Zernike => {
                    let (Some(z), Some((_, terms))) = (&lens.surfaces[i].shape.zernike, &mut self.surfaces[i].zernike)
                    else {
                        return false;
                    };
                    for (a, b, c) in z.monomials(entry) {
                        match terms.iter_mut().find(|t| (t.0, t.1) == (*a, *b)) {
                            Some(term) => term.2 = term.2 + h * S::of(*c),
                            None => terms.push((*a, *b, h * S::of(*c))),
                        }
                    }
                }
                Kind::Xy => {
                    let Some((_, terms)) = &mut self.surfaces[i].xy else { return false };
                    add(&mut terms[entry].2);
                }
                Kind::Decentre if !in_element(lens, i) => {
                    let Some((_, shift)) = &mut self.surfaces[i].motion else { return false };
                    add(&mut shift[entry]);
                }
                Kind::Tilt if !in_element(lens, i) => {
                    let (Some(motion), Some(pose)) = (&mut self.surfaces[i].motion, &lens.surfaces[i].pose) else {
                        return false;
                    };
                    motion.0 = tilted(pose, entry, h);
                }
                // Poses of and within elements, glass, and what no design moves.
                Kind::Decentre
                | Kind::Tilt
                | Kind::ElementTilt
                | Kind::ElementDecentre
                | Kind::Pivot
                | Kind::IdealFocalLength
                | Kind::Index
                | Kind::Abbe
                | Kind::Dispersion
                | Kind::Tabulated
                | Kind::SemiDiameter
                | Kind::EntrancePupilDiameter
                | Kind::FNumber
                | Kind::StopSemiDiameter
                | Kind::ObjectNa => return false,
            },
        }
        true
    }

    /// Traces `ray` along the branch of `hits` (the f64 trace of the same ray, image plane included). `None` where the
    /// polished ray leaves that branch.
    pub fn trace(&self, ray: Ray, hits: &[Hit]) -> Option<Landing<S>> {
        let mut origin = ray.origin.to_array().map(S::of);
        let mut direction = ray.direction.to_array().map(S::of);
        let length = dot(direction, direction).root();
        direction = direction.map(|x| x / length);
        let mut path = S::of(0.0);
        for (surface, hit) in self.surfaces.iter().zip(hits) {
            origin[2] = origin[2] - surface.distance;
            if let Some((r, s)) = &surface.motion {
                let from: Vec3<S> = std::array::from_fn(|k| origin[k] - s[k]);
                (origin, direction) = (back(r, from), back(r, direction));
            }
            let (t, slope) = surface.polish(origin, direction, hit.at.t)?;
            let mut point: Vec3<S> = std::array::from_fn(|k| origin[k] + t * direction[k]);
            path = path + surface.indices[0] * t;
            if let Some([f, conjugate]) = surface.ideal {
                let added;
                (direction, added) = ideal(f, conjugate, surface.indices, point, direction);
                path = path + added;
            } else if (surface.indices[0] - surface.indices[1]).to_f64() != 0.0 {
                let mu = surface.indices[0] / surface.indices[1];
                let length = (slope[0] * slope[0] + slope[1] * slope[1] + S::of(1.0)).root();
                let mut normal = [slope[0] / length, slope[1] / length, -(S::of(1.0) / length)];
                if dot(normal, direction).to_f64() > 0.0 {
                    normal = normal.map(|x| -x);
                }
                let ci = -dot(direction, normal);
                let under = S::of(1.0) - mu * mu * (S::of(1.0) - ci * ci);
                if under.to_f64() < 0.0 {
                    return None;
                }
                let gamma = mu * ci - under.root();
                direction = std::array::from_fn(|k| mu * direction[k] + gamma * normal[k]);
            }
            if let Some((r, s)) = &surface.motion {
                let turned = forth(r, point);
                point = std::array::from_fn(|k| turned[k] + s[k]);
                direction = forth(r, direction);
            }
            origin = point;
        }
        let landing = Landing { x: origin[0], y: origin[1], direction, path };
        (landing.x.to_f64().is_finite() && landing.y.to_f64().is_finite()).then_some(landing)
    }
}

/// Where Newton's iteration for an intersection starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Where the ray meets the vertex plane.
    VertexPlane,
    /// Where it meets the base conic (the vertex plane if it misses that).
    BaseConic,
}

impl<S: Scalar> PreciseSystem<S> {
    /// Newton on the intersection of a ray in the frame of `surface`, until the step is at most `tolerance` mm: distance
    /// and number of iterations. Unsafeguarded, for measuring what tolerance, start and arithmetic cost and give.
    pub fn newton(
        &self,
        surface: usize,
        origin: [S; 3],
        direction: [S; 3],
        start: Start,
        tolerance: f64,
    ) -> Option<(S, u32)> {
        let s = &self.surfaces[surface];
        let plane = -(origin[2] / direction[2]);
        let mut t = match start {
            Start::VertexPlane => plane,
            Start::BaseConic => s.conic_root(origin, direction, plane),
        };
        for iteration in 1..=50 {
            let p: Vec3<S> = std::array::from_fn(|k| origin[k] + t * direction[k]);
            let (h, slope) = s.at(p[0], p[1])?;
            let step = (h - p[2]) / (slope[0] * direction[0] + slope[1] * direction[1] - direction[2]);
            t = t - step;
            let size = step.to_f64().abs();
            if !size.is_finite() {
                return None;
            }
            if size <= tolerance {
                return Some((t, iteration));
            }
        }
        None
    }
}

/// An ideal lens of focal length `f`: the direction behind it and the path that it adds ([`super::ideal`]).
fn ideal<S: Scalar>(f: S, conjugate: S, n: [S; 2], p: Vec3<S>, d: Vec3<S>) -> (Vec3<S>, S) {
    let (one, two) = (S::of(1.0), S::of(2.0));
    let m = [d[0] / d[2], d[1] / d[2]];
    let behind: [S; 2] = std::array::from_fn(|k| (n[0] * m[k] - p[k] / f) / n[1]);
    let long = |slope: [S; 2]| (slope[0] * slope[0] + slope[1] * slope[1] + one).root();
    let vergences = [(one / (f + f) + conjugate) / n[0], (one / (f + f) - conjugate) / n[1]];
    let mut path = S::of(0.0);
    for (sign, slope, v, n) in [(S::of(-1.0), m, vergences[0], n[0]), (one, behind, vergences[1], n[1])] {
        let from_vertex = std::array::from_fn(|k| slope[k] + sign * v * p[k]);
        let squares = p[0] * (two * sign * slope[0] + v * p[0]) + p[1] * (two * sign * slope[1] + v * p[1]);
        path = path + n * squares / (long(from_vertex) + long(slope));
    }
    let length = long(behind);
    ([behind[0] / length, behind[1] / length, one / length], path)
}

fn in_element(lens: &Lens, surface: usize) -> bool {
    lens.elements.iter().any(|e| (e.first..=e.last).contains(&surface))
}

fn dot<S: Scalar>(a: Vec3<S>, b: Vec3<S>) -> S {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn forth<S: Scalar>(rows: &[Vec3<S>; 3], v: Vec3<S>) -> Vec3<S> {
    rows.map(|r| dot(r, v))
}

fn back<S: Scalar>(rows: &[Vec3<S>; 3], v: Vec3<S>) -> Vec3<S> {
    std::array::from_fn(|k| rows[0][k] * v[0] + rows[1][k] * v[1] + rows[2][k] * v[2])
}

/// Rows of the rotation of `pose` with angle `axis` moved by a small `h`: sine and cosine by the addition theorem from
/// the f64 values, so that the nominal rotation is the f64 one.
fn tilted<S: Scalar>(pose: &Pose, axis: usize, h: S) -> [Vec3<S>; 3] {
    let (one, zero) = (S::of(1.0), S::of(0.0));
    let (sin_h, cos_h) = (h - h * h * h / S::of(6.0), one - h * h / S::of(2.0) + h * h * h * h / S::of(24.0));
    let about = |k: usize| {
        let (s, c) = pose.tilt[k].sin_cos();
        let (mut s, mut c) = (S::of(s), S::of(c));
        if k == axis {
            (s, c) = (s * cos_h + c * sin_h, c * cos_h - s * sin_h);
        }
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let mut r = [[zero; 3]; 3];
        r[k][k] = one;
        (r[i][i], r[i][j], r[j][i], r[j][j]) = (c, -s, s, c);
        r
    };
    let product = |a: [Vec3<S>; 3], b: [Vec3<S>; 3]| a.map(|row| back(&b, row));
    product(product(about(0), about(1)), about(2))
}

impl<S: Scalar> PreciseSurface<S> {
    /// Sag and slope; `None` beyond the conic's reach.
    fn at(&self, x: S, y: S) -> Option<(S, [S; 2])> {
        let Self { curvature, conic, even, odd, zernike, xy, distance: _, indices: _, ideal: _, motion: _ } = self;
        let (curvature, conic, one) = (*curvature, *conic, S::of(1.0));
        let rho = x * x + y * y;
        let phi_sq = one - (one + conic) * curvature * curvature * rho;
        let reach = phi_sq.to_f64();
        if reach.is_nan() || reach <= 0.0 {
            return None;
        }
        let phi = phi_sq.root();
        let mut h = curvature * rho / (one + phi);
        // dh/dρ, twice.
        let mut twice = curvature / phi;
        let series = |terms: &[S], from: f64| {
            let (mut p, mut d) = (S::of(0.0), S::of(0.0));
            for (i, a) in terms.iter().enumerate().rev() {
                #[expect(clippy::cast_precision_loss, reason = "small orders")]
                let order = i as f64 + from;
                p = p * rho + *a;
                d = d * rho + *a * S::of(order);
            }
            (p, d)
        };
        // Σ a ρ^{i+1} and its derivative Σ (i+1) a ρ^i.
        let (p, d) = series(even, 1.0);
        h = h + p * rho;
        twice = twice + d + d;
        if !odd.is_empty() {
            let r = rho.root();
            let (p, d) = series(odd, 1.5);
            h = h + p * rho * r;
            twice = twice + (d + d) * r;
        }
        let mut slope = [twice * x, twice * y];
        for (radius, terms) in [zernike, xy].into_iter().flatten() {
            let (u, v) = (x / *radius, y / *radius);
            let power = |base: S, n: usize| (0..n).fold(one, |p, _| p * base);
            for (i, j, c) in terms {
                #[expect(clippy::cast_precision_loss, reason = "small orders")]
                let (di, dj) = (*i as f64, *j as f64);
                h = h + *c * power(u, *i) * power(v, *j);
                if *i > 0 {
                    slope[0] = slope[0] + *c * S::of(di) * power(u, *i - 1) * power(v, *j) / *radius;
                }
                if *j > 0 {
                    slope[1] = slope[1] + *c * S::of(dj) * power(u, *i) * power(v, *j - 1) / *radius;
                }
            }
        }
        Some((h, slope))
    }

    /// The exact root on the base conic from the vertex plane on, `plane` where there is none.
    fn conic_root(&self, origin: Vec3<S>, d: Vec3<S>, plane: S) -> S {
        let (c, one) = (self.curvature, S::of(1.0));
        let (x, y) = (origin[0] + plane * d[0], origin[1] + plane * d[1]);
        let a = c * (one + self.conic * d[2] * d[2]);
        let b = d[2] - c * (x * d[0] + y * d[1]);
        let cc = c * (x * x + y * y);
        let disc = b * b - a * cc;
        if disc.to_f64() >= 0.0 { plane + cc / (b + disc.root()) } else { plane }
    }

    /// The root near `t`, and the slope there.
    fn polish(&self, origin: Vec3<S>, d: Vec3<S>, t: f64) -> Option<(S, [S; 2])> {
        let mut t = S::of(t);
        let mut before = f64::INFINITY;
        for _ in 0..40 {
            let p: Vec3<S> = std::array::from_fn(|k| origin[k] + t * d[k]);
            let (h, slope) = self.at(p[0], p[1])?;
            let step = (h - p[2]) / (slope[0] * d[0] + slope[1] * d[1] - d[2]);
            let size = step.to_f64().abs();
            if !size.is_finite() {
                return None;
            }
            // Steps shrink until they are rounding.
            if size >= 0.25 * before || size == 0.0 {
                return Some((t, slope));
            }
            before = size;
            t = t - step;
        }
        None
    }
}

/// `∂(x, y)/∂number` of a ray's landing by central differences in double-double, step `h` (a natural scale of the number
/// times about 1e-10). `None` where the number cannot be moved or the ray is lost.
pub(crate) fn derivative(
    lens: &Lens,
    system: &System,
    ray: Ray,
    hits: &[Hit],
    number: Number,
    h: f64,
) -> Option<[f64; 2]> {
    let side = |h: f64| {
        let mut moved = PreciseSystem::<DoubleDouble>::new(system);
        moved.bump(lens, number, h).then(|| moved.trace(ray, hits)).flatten()
    };
    let (a, b) = (side(h)?, side(-h)?);
    let per = |p: DoubleDouble, q: DoubleDouble| ((p - q) / DoubleDouble::of(2.0 * h)).to_f64();
    Some([per(a.x, b.x), per(a.y, b.y)])
}

/// Landing of `ray` in double-double, rounded: point on the image plane and optical path.
pub(crate) fn reference(system: &System, ray: Ray, hits: &[Hit]) -> Option<(DVec3, f64)> {
    let l = PreciseSystem::<DoubleDouble>::new(system).trace(ray, hits)?;
    Some((DVec3::new(l.x.to_f64(), l.y.to_f64(), 0.0), l.path.to_f64()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::trace::sequential::trace;

    #[test]
    fn double_double_keeps_thirty_digits() {
        let rng = &mut fastrand::Rng::with_seed(5);
        let of = DoubleDouble::of;
        for _ in 0..1000 {
            let (x, y) = (of(rng.f64()) + of(rng.f64() * 1e-17), of(1.0 + rng.f64()) + of(rng.f64() * 1e-17));
            let off = |z: DoubleDouble| (z.to_f64() / x.to_f64()).abs();
            assert!(off(x / y * y - x) < 1e-30, "{:e}", off(x / y * y - x));
            assert!(off(x.root() * x.root() - x) < 1e-30, "{:e}", off(x.root() * x.root() - x));
        }
    }

    /// f64 in this loop is the plain trace, f32 is worse by its digits, double-double is better.
    #[test]
    fn precision_falls_and_rises_with_the_arithmetic() {
        for name in ["cooke_triplet", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let system = System::new(&lens, 550.0);
            let ray = Ray { origin: DVec3::new(0.1, 0.4, -1.0), direction: DVec3::new(0.02, 0.1, 1.0).normalize() };
            let mut hits = Vec::new();
            let landing = trace(&system, ray, system.image(), &mut hits).expect("traces").at.point;
            let (exact, path) = reference(&system, ray, &hits).expect("traces");
            let double = PreciseSystem::<f64>::new(&system).trace(ray, &hits).expect("traces");
            let single = PreciseSystem::<f32>::new(&system).trace(ray, &hits).expect("traces");
            let off = |x: f64, y: f64| (x - exact.x).hypot(y - exact.y);
            assert!(off(landing.x, landing.y) < 1e-13, "{name}: {:e}", off(landing.x, landing.y));
            assert!(off(double.x, double.y) < 1e-13, "{name}: {:e}", off(double.x, double.y));
            let rough = off(f64::from(single.x), f64::from(single.y));
            assert!((1e-9..1e-4).contains(&rough), "{name}: {rough:e}");
            assert!((hits[system.image()].optical_path - path).abs() < 1e-12, "{name}");
        }
    }
}
