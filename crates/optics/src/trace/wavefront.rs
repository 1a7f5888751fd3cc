//! The optical path difference of one object point, with adjoint.
//!
//! Rays are aimed at the real stop. They start on a wavefront of the object (a plane perpendicular to the light of an
//! infinitely far one, a sphere about a near one) and end on the reference sphere: centred on the chief ray's image
//! point or on a given one, through the point where the chief ray crosses the paraxial exit pupil's plane. The sphere is
//! kept as its curvature `κ`, positive when the exit pupil lies before the image: `κ = 0`, a telecentric lens, is a plane
//! and no special case. With `q` the landing from the centre, `d` the direction and `b = q·d`, the path from the image
//! plane to the sphere, less that along a ray through the centre, is `−b + κ(q² − b²)/(1 + √(1 − κ²(q² − b²)))`.
//!
//! Sign: `OPD = [chief ray] − [ray]`, positive where the ray's path is the shorter, the wavefront ahead of the sphere.
//! That is the sign of the wave aberration `W` in W. T. Welford, *Aberrations of Optical Systems* (1986), where
//! undercorrected spherical aberration, `S_I > 0`, has `W = S_I/8` at the rim.

use glam::{DVec2, DVec3};

use super::aim::{Aimed, Aimer, aimed_vjp};
use super::exit_pupil::{ExitPupil, exit_pupil, exit_pupil_vjp};
use super::object::{ObjectBar, ObjectPoint};
use super::sequential::{Hit, HitBar, first_vignetted, trace, trace_vjp};
use super::{Cause, Failure, System, SystemGradient};

/// Centre of the reference sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reference {
    /// The chief ray's own image point.
    ChiefRay,
    /// A given point, mm in the image plane's frame: a reference wavelength's, a neighbour's.
    Point(DVec3),
}

/// A ray from its object to the image plane.
#[derive(Clone, Debug)]
struct Traced {
    aimed: Aimed,
    hits: Vec<Hit>,
}

/// Optical path differences over the stop, for one object point and wavelength.
#[derive(Clone, Debug)]
pub struct Wavefront {
    /// One per asked point of the stop, mm; a ray that fails (or is clipped, where that was asked for) is data.
    pub opd: Vec<Result<f64, Failure>>,
    /// Centre of the reference sphere, mm in the image plane's frame.
    pub centre: DVec3,
    /// Curvature of the reference sphere, 1/mm; positive when the exit pupil lies before the image.
    pub curvature: f64,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    reference: Reference,
    points: Vec<DVec2>,
    pupil: ExitPupil,
    chief: Traced,
    rays: Vec<Option<Traced>>,
}

/// Cotangents that leave [`Wavefront::vjp`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WavefrontBar {
    /// Of the object point.
    pub object: ObjectBar,
    /// Of the given reference point; zero where the chief ray's was taken.
    pub reference: DVec3,
}

/// Path to the sphere of `curvature` less that along a ray through its centre, and its derivatives by `q`, `d`, `κ`.
fn to_sphere(q: DVec3, d: DVec3, curvature: f64) -> Option<(f64, [DVec3; 2], f64)> {
    let b = q.dot(d);
    let rho = q.length_squared() - b * b;
    let under = 1.0 - curvature * curvature * rho;
    if under.is_nan() || under <= 0.0 {
        return None;
    }
    let root = under.sqrt();
    let sum = 1.0 + root;
    let by_rho = curvature / sum + curvature.powi(3) * rho / (2.0 * root * sum * sum);
    let by_b = -1.0 - 2.0 * b * by_rho;
    let by_curvature = rho / sum + (curvature * rho / sum).powi(2) / root;
    Some((curvature * rho / sum - b, [2.0 * by_rho * q + by_b * d, by_b * q], by_curvature))
}

/// `1/τ`, `τ` the distance from the chief ray's landing forward to the exit pupil's plane: `−d_z w/(n'y + P_z w)`.
fn pupil_vergence(n: f64, pupil: ExitPupil, point: DVec3, direction: DVec3) -> f64 {
    -direction.z * pupil.w / (n * pupil.y + point.z * pupil.w)
}

/// Curvature of the sphere about the point `−offset` from the chief ray's landing, through the exit pupil on the ray:
/// `−s/√(1 + 2s δ·d + s²δ²)`; with its derivatives by `s`, `δ`, `d`.
fn sphere_curvature(s: f64, offset: DVec3, direction: DVec3) -> (f64, f64, [DVec3; 2]) {
    let (along, square) = (offset.dot(direction), offset.length_squared());
    let m = 1.0 + 2.0 * s * along + s * s * square;
    let (root, cubed) = (m.sqrt(), m * m.sqrt());
    let by_s = -1.0 / root + s * (along + s * square) / cubed;
    let factor = s * s / cubed;
    (-s / root, by_s, [factor * (direction + s * offset), factor * offset])
}

impl Traced {
    fn new(aimer: &Aimer, object: ObjectPoint, target: DVec2, near: Option<&Aimed>) -> Result<Self, Failure> {
        let aimed = aimer.aim(object, target, near)?;
        let mut hits = Vec::with_capacity(aimer.system().surfaces.len());
        trace(aimer.system(), aimed.ray, aimer.system().image(), &mut hits)?;
        Ok(Self { aimed, hits })
    }

    fn landing(&self) -> (DVec3, DVec3, f64) {
        let last = &self.hits[self.hits.len() - 1];
        (last.at.point, last.direction, last.optical_path)
    }
}

impl Wavefront {
    /// Optical path differences of `object` at `points` of the unit stop.
    ///
    /// Rays beyond a clear aperture count as failed if `clip` is set. Fails if the chief ray does not reach the image
    /// or the image lies in the exit pupil.
    pub fn compute(
        aimer: &Aimer,
        object: ObjectPoint,
        points: &[DVec2],
        reference: Reference,
        clip: bool,
    ) -> Result<Self, Failure> {
        let system = aimer.system();
        let n0 = system.surfaces[0].index_before;
        let n = system.surfaces[system.image()].index_before;
        let degenerate = Failure { cause: Cause::Missed, surface: system.image() };
        let chief = Traced::new(aimer, object, DVec2::ZERO, None)?;
        let (at, direction, path) = chief.landing();
        let centre = match reference {
            Reference::ChiefRay => at,
            Reference::Point(p) => p,
        };
        let pupil = exit_pupil(system);
        let curvature = sphere_curvature(pupil_vergence(n, pupil, at, direction), at - centre, direction).0;
        if !curvature.is_finite() {
            return Err(degenerate);
        }
        let whole = |t: &Traced, path: f64, q: DVec3, d: DVec3| {
            let beyond = to_sphere(q, d, curvature).ok_or(degenerate)?.0;
            Ok(n0 * t.aimed.plane.path(&t.aimed.ray) + path + n * beyond)
        };
        let chief_path: f64 = whole(&chief, path, at - centre, direction)?;
        let (mut opd, mut rays) = (Vec::with_capacity(points.len()), Vec::with_capacity(points.len()));
        for point in points {
            let traced = Traced::new(aimer, object, *point * system.stop_semi_diameter, Some(&chief.aimed));
            let difference = traced.as_ref().map_err(|f| *f).and_then(|t| {
                if clip && let Some(failure) = first_vignetted(system, &t.hits) {
                    return Err(failure);
                }
                let (at, d, path) = t.landing();
                Ok(chief_path - whole(t, path, at - centre, d)?)
            });
            rays.push(traced.ok().filter(|_| difference.is_ok()));
            opd.push(difference);
        }
        let wavelength_nm = system.wavelength_nm;
        Ok(Self { opd, centre, curvature, wavelength_nm, reference, points: points.to_vec(), pupil, chief, rays })
    }

    /// The differences in wavelengths.
    pub(crate) fn waves(&self) -> Vec<Result<f64, Failure>> {
        self.opd.iter().map(|w| w.map(|mm| mm / (self.wavelength_nm * 1e-6))).collect()
    }

    /// Surviving rays and their mean difference.
    fn mean(&self) -> Option<(f64, f64)> {
        let count = self.opd.iter().filter(|w| w.is_ok()).count();
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let count = count as f64;
        (count > 0.0).then(|| (count, self.opd.iter().flatten().sum::<f64>() / count))
    }

    /// Root mean square of the differences about their mean, mm, every surviving ray alike; `None` if none survives.
    /// The piston is taken out, tilt and focus are not.
    pub fn rms(&self) -> Option<f64> {
        let (count, mean) = self.mean()?;
        Some((self.opd.iter().flatten().map(|w| (w - mean).powi(2)).sum::<f64>() / count).sqrt())
    }

    /// Pulls a cotangent on [`Self::rms`] back to the differences; zero where they all are equal.
    pub fn rms_vjp(&self, rms_bar: f64) -> Vec<f64> {
        let rms = self.rms().unwrap_or(0.0);
        let Some((count, mean)) = self.mean().filter(|_| rms > 0.0) else { return vec![0.0; self.opd.len()] };
        self.opd.iter().map(|w| w.map_or(0.0, |w| rms_bar * (w - mean) / (count * rms))).collect()
    }

    /// Pulls cotangents on the differences (those of failed rays are not looked at) back to the system (added to
    /// `out`), the object and the reference point.
    pub fn vjp(&self, system: &System, opd_bar: &[f64], out: &mut SystemGradient) -> WavefrontBar {
        let image = system.image();
        let (n0, n) = (system.surfaces[0].index_before, system.surfaces[image].index_before);
        let mut back = WavefrontBar::default();
        let (mut centre_bar, mut curvature_bar, mut chief_bar) = (DVec3::ZERO, 0.0, 0.0);
        let (at, d, _) = self.chief.landing();
        let q = at - self.centre;
        let Some((_, [by_q, _], by_curvature)) = to_sphere(q, d, self.curvature) else { return back };
        let mut bars = vec![HitBar::default(); image + 1];
        // One ray's path from the object to the sphere, back to everything but the chief ray's own part in the sphere.
        let mut pull = |t: &Traced, point: DVec2, path_bar: f64, extra: HitBar, out: &mut SystemGradient| {
            let (at, d, _) = t.landing();
            let Some((beyond, [by_q, by_d], by_curvature)) = to_sphere(at - self.centre, d, self.curvature) else {
                return (DVec3::ZERO, 0.0);
            };
            let bar = n * path_bar;
            out.indices[image] += beyond * path_bar;
            bars[image] = HitBar {
                point: bar * by_q + extra.point,
                direction: bar * by_d + extra.direction,
                optical_path: path_bar,
            };
            let (mut o, d_bar) = trace_vjp(system, &t.hits, &bars, out);
            let (plane, ray) = (&t.aimed.plane, &t.aimed.ray);
            out.indices[0] += plane.path(ray) * path_bar;
            let (o_path, object) = plane.path_vjp(ray, n0 * path_bar);
            o += o_path;
            back.object.add(&object);
            let aimed = aimed_vjp(system, &t.aimed, &t.hits, o, d_bar, out);
            back.object.add(&aimed.object);
            out.stop_semi_diameter += aimed.target.dot(point);
            (-bar * by_q, bar * by_curvature)
        };
        for ((ray, point), bar) in self.rays.iter().zip(&self.points).zip(opd_bar) {
            if let Some(t) = ray {
                let (c, k) = pull(t, *point, -bar, HitBar::default(), out);
                centre_bar += c;
                curvature_bar += k;
                chief_bar += bar;
            }
        }
        // The chief ray: its own path, and the sphere that it makes.
        centre_bar -= n * chief_bar * by_q;
        curvature_bar += n * chief_bar * by_curvature;
        let s = pupil_vergence(n, self.pupil, at, d);
        let (_, by_s, [by_offset, by_d]) = sphere_curvature(s, q, d);
        let s_bar = curvature_bar * by_s;
        // s = −d_z w/Q, Q = n'y + P_z w.
        let (ExitPupil { y, w }, bottom) = (self.pupil, n * self.pupil.y + at.z * self.pupil.w);
        let bottom_bar = s_bar * d.z * w / (bottom * bottom);
        let mut extra = HitBar {
            point: curvature_bar * by_offset + DVec3::Z * (bottom_bar * w),
            direction: curvature_bar * by_d - DVec3::Z * (s_bar * w / bottom),
            optical_path: 0.0,
        };
        out.indices[image] += bottom_bar * y;
        let pupil_bar = ExitPupil { y: bottom_bar * n, w: bottom_bar * at.z - s_bar * d.z / bottom };
        exit_pupil_vjp(system, &pupil_bar, out);
        centre_bar -= curvature_bar * by_offset;
        let on_chief = self.reference == Reference::ChiefRay;
        if on_chief {
            extra.point += centre_bar;
        }
        pull(&self.chief, DVec2::ZERO, chief_bar, extra, out);
        if !on_chief {
            back.reference = centre_bar;
        }
        back
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Lens, LensGradient, Shape, builtin, seidel, unchecked, variables::Variables};
    use crate::trace::system::TraceSurface;
    use crate::trace::test_lenses::{laikin_100, nikkor_180, tilt};
    use isoplanat_base::testing::{assert_abs, assert_rel, between, central_difference};

    /// Points over the unit stop, rim included.
    fn points(count: u32) -> Vec<DVec2> {
        (0..=count)
            .map(|i| (f64::from(i) / f64::from(count)).sqrt() * DVec2::from_angle(2.399_963 * f64::from(i)))
            .collect()
    }

    fn opd(system: &System, object: ObjectPoint, points: &[DVec2], reference: Reference) -> Wavefront {
        let aimer = Aimer::new(system).expect("has a stop");
        let w = Wavefront::compute(&aimer, object, points, reference, false).expect("computes");
        assert!(w.opd.iter().all(Result::is_ok), "{:?}", w.opd);
        w
    }

    fn largest(w: &Wavefront) -> f64 {
        w.opd.iter().flatten().fold(0.0, |m, v| m.max(v.abs()))
    }

    fn system(surfaces: Vec<TraceSurface>, stop: usize, stop_semi_diameter: f64) -> System {
        System { wavelength_nm: 550.0, surfaces, stop, stop_semi_diameter }
    }

    const AXIS: ObjectPoint = ObjectPoint { direction: DVec3::Z, vergence: 0.0 };

    /// Stigmatic surfaces: plane and hyperboloid (κ = −n²) in air, ellipsoid (κ = −1/n²) into glass, the aplanatic
    /// sphere for a near object in glass with its virtual image.
    #[test]
    fn stigmatic_lenses_have_no_path_difference() {
        let n = 1.6;
        let air = |shape: Shape, distance: f64, a: f64, b: f64| TraceSurface::new(shape, distance, [a, b], 40.0);
        let image = |distance: f64, n: f64| TraceSurface::new(Shape::default(), distance, [n, n], f64::INFINITY);
        let hyperboloid = system(
            vec![
                air(Shape::default(), 0.0, 1.0, n),
                air(Shape::even(-1.0 / 30.0, -n * n, vec![]), 12.0, n, 1.0),
                image(30.0 / (n - 1.0), 1.0),
            ],
            0,
            20.0,
        );
        let ellipsoid = system(
            vec![air(Shape::even(1.0 / 30.0, -1.0 / (n * n), vec![]), 0.0, 1.0, n), image(30.0 * n / (n - 1.0), n)],
            0,
            15.0,
        );
        let r = -30.0;
        let aplanatic = system(vec![air(Shape::sphere(1.0 / r), 0.0, n, 1.0), image(r * (1.0 + n), 1.0)], 0, 12.0);
        let cases = [
            ("hyperboloid", hyperboloid, AXIS),
            ("ellipsoid", ellipsoid, AXIS),
            ("aplanatic", aplanatic, ObjectPoint { vergence: -1.0 / (r * (1.0 + 1.0 / n)), ..AXIS }),
        ];
        for (name, system, object) in cases {
            let w = opd(&system, object, &points(60), Reference::ChiefRay);
            eprintln!("{name}: largest path difference {:e} mm, κ {}", largest(&w), w.curvature);
            assert!(largest(&w) < 1e-11, "{name}: {:e}", largest(&w));
            assert!(w.rms().expect("rays") < 1e-11);
            // A sphere instead of the right conic is not stigmatic, so the zero is no accident.
            let mut wrong = system.clone();
            let last = wrong.image() - 1;
            wrong.surfaces[last].shape.conic += 0.1;
            assert!(largest(&opd(&wrong, object, &points(60), Reference::ChiefRay)) > 1e-4, "{name}");
        }
    }

    /// A perfect lens out of focus: the difference of two spheres about F and C, in closed form.
    #[test]
    fn defocus_is_the_difference_of_two_spheres() {
        let n = 1.5;
        for defocus in [-0.3, -1e-3, 1e-3, 0.2] {
            let focus = 40.0 / (n - 1.0);
            let lens = system(
                vec![
                    TraceSurface::new(Shape::default(), 0.0, [1.0, n], 40.0),
                    TraceSurface::new(Shape::even(-1.0 / 40.0, -n * n, vec![]), 10.0, [n, 1.0], 40.0),
                    TraceSurface::new(Shape::default(), focus + defocus, [1.0, 1.0], f64::INFINITY),
                ],
                0,
                16.0,
            );
            let points = points(40);
            let w = opd(&lens, AXIS, &points, Reference::ChiefRay);
            let radius = 1.0 / w.curvature;
            // The exit pupil of the plate: 10/n behind the first vertex, seen from the image through a lens of f = 80.
            let pupil = 1.0 / (1.0 / focus - n / 10.0);
            assert_rel(radius, focus + defocus - pupil, 1e-12, 1.0, "radius");
            for (i, value) in w.opd.iter().enumerate() {
                let hit = w.rays[i].as_ref().expect("traced").landing().1;
                // From F back along the ray to the sphere about C = F + defocus.
                let cos = hit.z;
                let back = |cos: f64| defocus * cos - (radius * radius - defocus * defocus * (1.0 - cos * cos)).sqrt();
                let expected = back(1.0) - back(cos);
                assert_abs(value.expect("lives"), expected, 1e-12, &format!("defocus {defocus}, point {i}"));
            }
            // The sign of W₀₂₀ = defocus NA²/2.
            let rim = w.opd.last().expect("rays").expect("lives");
            let cos = w.rays[w.rays.len() - 1].as_ref().expect("traced").landing().1.z;
            assert_rel(rim, 0.5 * defocus * (1.0 - cos * cos), 0.02, 0.0, "W020");
        }
    }

    /// Against the third-order sum at a small aperture: `W = S_I/8`, sign and all.
    #[test]
    fn spherical_aberration_is_that_of_seidel() {
        for name in ["ac254_050_a", "al2550_a", "two_element"] {
            let lens = builtin::lens(name).expect("shipped");
            let lens = unchecked(&lens, |lens| {
                for s in &mut lens.surfaces {
                    s.shape = Shape::sphere(s.shape.vertex_curvature());
                }
                lens.aperture = crate::lens::Aperture::EntrancePupilDiameter(3.0);
            });
            let nm = lens.wavelengths.primary_nm;
            let wanted = |lens: &Lens| seidel::per_surface(lens, nm).iter().map(|s| s.spherical).sum::<f64>();
            // The image plane goes to the paraxial image.
            let image = crate::lens::paraxial::first_order(&lens, nm).paraxial_image_distance;
            let lens = unchecked(&lens, |l| l.surfaces.last_mut().expect("surfaces").thickness = image);
            let system = System::new(&lens, nm);
            let object = ObjectPoint { vergence: lens.object_vergence, ..AXIS };
            let w = opd(&system, object, &[DVec2::X], Reference::ChiefRay);
            let value = w.opd[0].expect("lives");
            let expected = wanted(&lens) / 8.0;
            eprintln!("{name}: W {value:e} mm, S_I/8 {expected:e} mm");
            assert_rel(value, expected, 0.03, 1e-9, name);
        }
    }

    /// One given point for all wavelengths, and the chief ray's own: only tilt and piston differ to first order.
    #[test]
    fn a_given_reference_point_is_taken() {
        let lens = builtin::lens("double_gauss").expect("shipped");
        let system = System::new(&lens, 550.0);
        let object = ObjectPoint::from_angle(0.15, 1.0, lens.object_vergence);
        let own = opd(&system, object, &points(30), Reference::ChiefRay);
        let same = opd(&system, object, &points(30), Reference::Point(own.centre));
        assert_eq!(own.opd, same.opd);
        assert_eq!(own.curvature, same.curvature);
        let moved = opd(&system, object, &points(30), Reference::Point(own.centre + DVec3::new(1e-3, 0.0, 0.0)));
        assert!(moved.opd.iter().zip(&own.opd).any(|(a, b)| (a.expect("lives") - b.expect("lives")).abs() > 1e-5));
        assert_abs(moved.opd[0].expect("lives"), 0.0, 1e-12, "the chief ray against itself");
    }

    /// Every number of the lens, the object, the stop, the reference point; wide and tilted lenses, near objects.
    #[test]
    fn wavefront_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(12);
        let cases = [
            (builtin::lens("cooke_triplet").expect("shipped"), 0.25, 0.0, false),
            (builtin::lens("double_gauss").expect("shipped"), 0.15, 1e-3, true),
            (builtin::lens("two_element").expect("shipped"), 0.3, 1e-3, false),
            (builtin::lens("phone").expect("shipped"), 0.4, 0.0, true),
            (laikin_100(), 0.8, 0.0, false),
            (nikkor_180(), 1.56, 1e-3, true),
        ];
        for (lens, angle, vergence, tilted) in cases {
            let lens = if tilted { tilt(&lens, rng, 0.3) } else { lens };
            let nm = 587.5618;
            let points: Vec<DVec2> = points(8).iter().map(|p| 0.9 * *p).collect();
            for given in [false, true] {
                let bar: Vec<f64> = points.iter().map(|_| between(rng, -1.0, 1.0)).collect();
                // The RMS of a small wavefront is no smooth function over the steps that paths rounded to 1e-13 mm need:
                // one lens shows that its cotangents arrive.
                let rms_bar = if !given && lens.name.starts_with("Cooke") { 1.3 } else { 0.0 };
                let system = System::new(&lens, nm);
                let object = |angle: f64, v: f64| ObjectPoint::from_angle(angle, 0.9, v);
                let at = opd(&system, object(angle, vergence), &points, Reference::ChiefRay).centre;
                let reference = |shift: DVec3| {
                    if given {
                        Reference::Point(at + DVec3::new(2e-3, -1e-3, 5e-3) + shift)
                    } else {
                        Reference::ChiefRay
                    }
                };
                let value = |lens: &Lens, object: ObjectPoint, shift: DVec3| {
                    let w = opd(&System::new(lens, nm), object, &points, reference(shift));
                    let dot: f64 = w.opd.iter().flatten().zip(&bar).map(|(a, b)| a * b).sum();
                    dot + rms_bar * w.rms().expect("rays")
                };
                let here = opd(&system, object(angle, vergence), &points, reference(DVec3::ZERO));
                let opd_bar: Vec<f64> = here.rms_vjp(rms_bar).iter().zip(&bar).map(|(a, b)| a + b).collect();
                let mut out = SystemGradient::zeros(&system);
                let back = here.vjp(&system, &opd_bar, &mut out);
                let mut gradient = LensGradient::zeros(&lens);
                out.add_to(&lens, nm, &mut gradient);
                let variables = Variables::all(&lens);
                let (x, gradient) = (variables.values(&lens), variables.gradient(&gradient));
                let size = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
                let what = format!("{} given {given}", lens.name);
                for _ in 0..3 {
                    let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
                    let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
                    let f = |h: f64| {
                        let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                        value(&unchecked(&lens, |l| variables.put(l, &moved)), object(angle, vergence), DVec3::ZERO)
                    };
                    assert_rel(pulled, central_difference(f, 8e-5), 1e-7, 0.1 * size, &what);
                }
                let pulled = ObjectPoint::from_angle_vjp(angle, 0.9, &back.object).0;
                let f = |h: f64| value(&lens, object(angle + h, vergence), DVec3::ZERO);
                assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.1, &format!("{what}: angle"));
                let f = |h: f64| value(&lens, object(angle, vergence + 1e-2 * h), DVec3::ZERO);
                let pulled = 1e-2 * back.object.vergence;
                assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.1, &format!("{what}: vergence"));
                if given {
                    let dot = DVec3::new(0.3, 0.7, -0.5);
                    let f = |h: f64| value(&lens, object(angle, vergence), h * dot);
                    let pulled = back.reference.dot(dot);
                    assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.1, &format!("{what}: reference"));
                } else {
                    assert_eq!(back.reference, DVec3::ZERO);
                }
            }
        }
    }

    /// A telecentric lens (the stop in the front focus) has a plane for a reference; so has its neighbourhood.
    #[test]
    fn a_telecentric_lens_is_no_special_case() {
        let n = 1.5;
        let lens = |gap: f64| {
            system(
                vec![
                    TraceSurface::new(Shape::default(), 0.0, [1.0, 1.0], 20.0),
                    TraceSurface::new(Shape::sphere(1.0 / 50.0), gap, [1.0, n], 20.0),
                    TraceSurface::new(Shape::default(), 200.0, [n, n], f64::INFINITY),
                ],
                0,
                3.0,
            )
        };
        // f = 50/(n − 1) = 100 mm before the surface.
        let object = ObjectPoint::from_angle(0.05, 0.4, 0.0);
        let exact = opd(&lens(100.0), object, &points(20), Reference::ChiefRay);
        assert!(exact.curvature.abs() < 1e-16, "{}", exact.curvature);
        let near = opd(&lens(100.0 + 1e-7), object, &points(20), Reference::ChiefRay);
        assert!(near.curvature.abs() < 1e-8 && near.curvature != 0.0);
        for (a, b) in exact.opd.iter().zip(&near.opd) {
            assert_abs(a.expect("lives"), b.expect("lives"), 1e-9, "continuous");
        }
    }
}
