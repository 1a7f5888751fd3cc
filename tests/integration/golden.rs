//! Rays and derivatives against independent programs (`../shared/golden`): 1e-9 mm, 1e-10 in direction, 1e-8 relative.

use glam::{DVec2, DVec3};
use isoplanat::lens::Shape;
use isoplanat::lens::catalogue::{Glasses, Naming};
use isoplanat::testing::shared;
use isoplanat::trace::aim::Aimer;
use isoplanat::trace::sequential::{HitBar, trace, trace_vjp};
use isoplanat::trace::system::TraceSurface;
use isoplanat::trace::wavefront::{Reference, Wavefront};
use isoplanat::trace::{ObjectPoint, Ray, System, SystemGradient};
use serde_json::Value;

pub(crate) fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| v.as_str().expect("number").parse().expect("number"))
}

pub(crate) fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().expect("list").iter().map(number).collect()
}

pub(crate) fn read(name: &str) -> Option<Value> {
    let path = shared(&format!("golden/{name}.json"))?;
    Some(serde_json::from_slice(&std::fs::read(path).expect("readable")).expect("JSON"))
}

/// The golden file's own numbers: no glass catalogue, no apertures.
pub(crate) fn system(golden: &Value, wavelength: usize) -> System {
    let (mut surfaces, mut n, mut distance) = (Vec::new(), 1.0, 0.0);
    for s in golden["surfaces"].as_array().expect("list") {
        let after = number(&s["index_after"][wavelength]);
        let shape = Shape::even(number(&s["curvature"]), number(&s["conic"]), numbers(&s["coeffs"]));
        surfaces.push(TraceSurface::new(shape, distance, [n, after], number(&s["semi_diameter"]) * 2.0));
        (n, distance) = (after, number(&s["thickness"]));
    }
    surfaces.push(TraceSurface::new(Shape::default(), distance, [n, n], f64::INFINITY));
    let stop = usize::try_from(golden["stop_index"].as_u64().expect("index")).expect("small");
    System { wavelength_nm: 587.5618, surfaces, stop, stop_semi_diameter: number(&golden["stop_radius"]) }
}

fn ray(v: &Value) -> Ray {
    let vec = |k: &str| DVec3::from_slice(&numbers(&v[k]));
    Ray { origin: vec("origin"), direction: vec("direction") }
}

pub(crate) const LENSES: [&str; 5] =
    ["singlet_la1131", "achromat_laikin", "cooke_triplet", "double_gauss_us2532751", "asphere_acl5040u"];

#[test]
fn rays_agree_with_rayoptics() {
    let (mut count, mut worst) = (0, [0.0f64; 3]);
    for name in LENSES {
        let Some(golden) = read(name) else { return };
        let mut hits = Vec::new();
        for r in golden["rays"].as_array().expect("list") {
            let wavelength = usize::try_from(r["wavelength_index"].as_u64().expect("index")).expect("small");
            let s = system(&golden, wavelength);
            trace(&s, ray(r), s.image(), &mut hits).unwrap_or_else(|f| panic!("{name}: {f:?}"));
            for (hit, row) in hits.iter().zip(r["rayoptics"].as_array().expect("rows")) {
                let row = numbers(row);
                let position = (hit.at.point - DVec3::from_slice(&row[..3])).length();
                let direction = (hit.direction - DVec3::from_slice(&row[3..6])).length();
                let path = (hit.optical_path - row[6]).abs();
                worst = [worst[0].max(position), worst[1].max(direction), worst[2].max(path)];
                assert!(
                    position < 1e-9 && direction < 1e-10 && path < 1e-9,
                    "{name}: {position:e} {direction:e} {path:e}"
                );
            }
            count += 1;
        }
    }
    eprintln!(
        "{count} golden rays: worst position {:e} mm, direction {:e}, path {:e} mm",
        worst[0], worst[1], worst[2]
    );
}

/// Gradient of the landing in the file's parameter order, for cotangent `bar` at the image.
fn gradient(s: &System, golden: &Value, ray: Ray, bar: DVec3) -> (DVec3, Vec<f64>) {
    let mut hits = Vec::new();
    let last = trace(s, ray, s.image(), &mut hits).expect("golden rays survive");
    let mut g = SystemGradient::zeros(s);
    let mut bars = vec![HitBar::default(); s.image() + 1];
    bars[s.image()].point = bar;
    trace_vjp(s, &hits, &bars, &mut g);
    let list = golden["parameters"].as_array().expect("list").iter().map(|p| {
        let i = usize::try_from(p["surface"].as_u64().expect("index")).expect("small");
        match p["kind"].as_str().expect("kind") {
            "curvature" => g.shapes[i].curvature,
            "conic" => g.shapes[i].conic,
            "asphere" => {
                g.shapes[i].asphere[usize::try_from(p["order"].as_u64().expect("order")).expect("small") / 2 - 1]
            }
            "thickness" => g.distances[i + 1],
            "index_after" => g.indices[i + 1] + if i + 1 == s.image() { g.indices[i + 2] } else { 0.0 },
            other => panic!("unknown parameter kind {other}"),
        }
    });
    (last.at.point, list.collect())
}

#[test]
fn derivatives_agree_with_fifty_digits() {
    let mut worst = 0.0f64;
    for name in ["cooke_triplet", "asphere_acl5040u"] {
        let (Some(golden), Some(deriv)) = (read(name), read(&format!("{name}.derivatives"))) else { return };
        let s = system(&golden, 1);
        for r in deriv["single_rays"].as_array().expect("list") {
            for (bar, key) in [(DVec3::X, "dx"), (DVec3::Y, "dy")] {
                let (_, ours) = gradient(&s, &deriv, ray(r), bar);
                let theirs = numbers(&r[key]);
                let size = theirs.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                for (k, (a, b)) in ours.iter().zip(&theirs).enumerate() {
                    // Relative to the value itself; exact zeros of symmetry to the gradient's size.
                    let error = (a - b).abs() / if b.abs() > 1e-12 * size { b.abs() } else { size.max(1.0) };
                    worst = worst.max(error);
                    assert!(error < 1e-8, "{name} {key}[{k}]: {a:e} against {b:e}");
                }
            }
        }
        // The mean squared spot about its centroid, over the file's launch grid.
        for spot in deriv["rms2_spot"].as_array().expect("list") {
            let n = u32::try_from(spot["grid_N"].as_u64().expect("count")).expect("small");
            let launch = &spot["launch"];
            let (center, direction) = (numbers(&launch["center"]), DVec3::from_slice(&numbers(&launch["direction"])));
            let (hx, hy) = (number(&launch["half_width_x"]), number(&launch["half_width_y"]));
            let mut rays = Vec::new();
            for i in 0..n {
                for j in 0..n {
                    let u = |k: u32| (f64::from(k) + 0.5) / f64::from(n) * 2.0 - 1.0;
                    if u(i) * u(i) + u(j) * u(j) <= 1.0 {
                        let origin = DVec3::new(center[0] + u(i) * hx, center[1] + u(j) * hy, center[2]);
                        rays.push(Ray { origin, direction });
                    }
                }
            }
            #[expect(clippy::cast_precision_loss, reason = "tens of rays")]
            let count = rays.len() as f64;
            assert_eq!(rays.len() as u64, spot["rays"].as_u64().expect("count"));
            let points: Vec<DVec3> = rays.iter().map(|r| gradient(&s, &deriv, *r, DVec3::ZERO).0).collect();
            let centroid = points.iter().sum::<DVec3>() / count;
            let rms2 = points.iter().map(|p| (p - centroid).truncate().length_squared()).sum::<f64>() / count;
            isoplanat::testing::assert_rel(rms2, number(&spot["rms2"]), 1e-10, 0.0, name);
            let mut total = vec![0.0; deriv["parameters"].as_array().expect("list").len()];
            for (r, p) in rays.iter().zip(&points) {
                let mut bar = 2.0 / count * (p - centroid);
                bar.z = 0.0;
                let (_, g) = gradient(&s, &deriv, *r, bar);
                total.iter_mut().zip(g).for_each(|(a, b)| *a += b);
            }
            for (k, (a, b)) in total.iter().zip(numbers(&spot["gradient"])).enumerate() {
                let error = (a - b).abs() / b.abs().max(1e-9);
                worst = worst.max(error);
                assert!(error < 1e-8, "{name} spot[{k}]: {a:e} against {b:e}");
            }
        }
    }
    eprintln!("golden derivatives: worst relative error {worst:e}");
}

/// CODE V 10.8 on its double Gauss (`../shared/data/lenses/ag_dblgauss.seq`, numbers typed in from there; glasses of the
/// shipped Schott catalogue): chief-ray heights at 10° and 14° in the file's own image plane, to the printed digits.
#[test]
fn chief_rays_of_the_double_gauss_agree_with_code_v() {
    use isoplanat::lens::{Aperture, Surface, builtin, unchecked};
    use isoplanat::psf::table::chief_slopes;
    use isoplanat::trace::ObjectPoint;
    use isoplanat::trace::aim::Aimer;
    let rows: [(f64, f64, &str); 11] = [
        (0.017_792_840_940_915_43, 8.75, "N-SSK2"),
        (0.006_566_600_536_925_569, 0.5, "air"),
        (0.026_537_432_946_709_83, 12.5, "N-SK2"),
        (0.0, 3.8, "F5"),
        (0.041_268_928_785_700_84, 16.369_444_926_535_64, "air"),
        (0.0, 13.747_956_963_889_06, "air"),
        (-0.035_239_426_544_290_74, 3.8, "F5"),
        (0.0, 11.0, "N-SK16"),
        (-0.026_367_508_286_577_09, 0.5, "air"),
        (0.005_636_604_951_748_545, 7.0, "N-SK16"),
        (-0.012_592_645_859_057_6, 61.487_536_417_982_1 - 0.400_268_645_354_137_7, "air"),
    ];
    let surfaces = rows
        .iter()
        .map(|(c, t, glass)| Surface {
            shape: Shape::sphere(*c),
            thickness: *t,
            medium: Glasses::shipped().find(glass, Naming::Exact).expect("shipped glass"),
            semi_diameter: 35.0,
            pose: None,
        })
        .collect();
    let lens = unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |lens| {
        (lens.surfaces, lens.stop) = (surfaces, 5);
        lens.aperture = Aperture::EntrancePupilDiameter(50.0);
        lens.object_vergence = 0.0;
        lens.wavelengths.primary_nm = 587.6;
    });
    let angles = [10.000_000_002_3f64, 14.000_000_003_2];
    let system = System::new(&lens, lens.wavelengths.primary_nm);
    let aimer = Aimer::new(&system).expect("a stop");
    let heights = angles.map(|a| {
        let object = ObjectPoint::from_slope(DVec2::new(0.0, a.to_radians().tan()), 0.0);
        let mut hits = Vec::new();
        let aimed = aimer.aim(object, DVec2::ZERO, None).expect("aims");
        trace(&system, aimed.ray, system.image(), &mut hits).expect("lands").at.point.y
    });
    for (height, printed) in heights.iter().zip([17.485_856, 24.588_739]) {
        eprintln!("chief ray {height:.9} mm, CODE V {printed:.6}");
        assert!((height - printed).abs() < 0.5e-6, "{height} against CODE V's {printed}");
    }
    // The same rays from the sensor: image formation's own chief rays come from the angles that were asked for.
    let slopes = chief_slopes(&lens, 0.0, &[0.0, heights[0], heights[1]]).expect("traces");
    for (slope, angle) in slopes[1..].iter().zip(angles) {
        isoplanat::testing::assert_rel(*slope, angle.to_radians().tan(), 1e-10, 0.0, "from the sensor");
    }
}

/// Path differences from the golden rays' own paths and landings (d line), by the plain formula of the sphere, against
/// ours: rays aimed anew at the stop points that the golden rays met.
#[test]
fn path_differences_agree_with_rayoptics() {
    let (mut count, mut worst, mut largest) = (0, 0.0f64, 0.0f64);
    for name in LENSES {
        let Some(golden) = read(name) else { return };
        let s = system(&golden, 1);
        let aimer = Aimer::new(&s).expect("has a stop");
        let exit = number(&golden["paraxial_d_line"]["reference_40digit"]["exit_pupil_from_last_vertex"]);
        let all = golden["rays"].as_array().expect("list");
        let line: Vec<&Value> = all.iter().filter(|r| r["wavelength_index"].as_u64() == Some(1)).collect();
        for chief in line.iter().filter(|r| numbers(&r["pupil"]) == [0.0, 0.0]) {
            let of_field = |r: &&&Value| r["object"] == chief["object"] && r["field"] == chief["field"];
            let rays: Vec<&&Value> = line.iter().filter(of_field).collect();
            let infinite = chief["object"].as_str() == Some("inf");
            let launch = ray(chief);
            let object =
                if infinite { ObjectPoint::infinite(launch.direction) } else { ObjectPoint::finite(launch.origin) };
            // Landing, direction and path from the object (or the plane through the first vertex).
            let end = |r: &Value| {
                let rows = r["rayoptics"].as_array().expect("rows");
                let row = numbers(&rows[rows.len() - 1]);
                let start = if infinite { ray(r).origin.dot(launch.direction) } else { 0.0 };
                (DVec3::from_slice(&row[..3]), DVec3::from_slice(&row[3..6]), row[6] + start)
            };
            let (centre, direction, chief_path) = end(chief);
            let back = (exit - s.surfaces[s.image()].distance - centre.z) / direction.z;
            let radius = back.abs();
            let to_sphere = |p: DVec3, d: DVec3| {
                let (q, b) = (p - centre, (p - centre).dot(d));
                let root = (radius * radius - q.length_squared() + b * b).sqrt();
                -b + back.signum() * root
            };
            let stop = |r: &Value| {
                let row = numbers(&r["rayoptics"].as_array().expect("rows")[s.stop]);
                DVec2::new(row[0], row[1]) / s.stop_semi_diameter
            };
            let points: Vec<DVec2> = rays.iter().map(|r| stop(r)).collect();
            let ours = Wavefront::compute(&aimer, object, &points, Reference::ChiefRay, false).expect("computes");
            for (r, w) in rays.iter().zip(&ours.opd) {
                let (p, d, path) = end(r);
                let expected = chief_path + back - path - to_sphere(p, d);
                let error = (w.expect("lives") - expected).abs();
                (worst, largest) = (worst.max(error), largest.max(expected.abs()));
                assert!(error < 1e-10, "{name} {}: {error:e} mm of {expected:e}", chief["field"]);
                count += 1;
            }
        }
    }
    eprintln!("{count} golden path differences up to {largest} mm: worst {worst:e} mm");
}
