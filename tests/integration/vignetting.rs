//! Vignetting as `check` and `trace --clip` count it, against rays traced by hand: spheres, Snell's law, nothing shared with the
//! library but the prescription, its indices and the first-order size and place of the pupil.

use glam::{DVec2, DVec3};
use isoplanat::lens::{Field, Lens, Prescription, builtin, paraxial, unchecked};
use isoplanat::trace::health::check;
use serde_json::Value;

use crate::support::Workplace;

/// Where a ray meets every surface, mm from its vertex; shorter where it is lost.
fn heights(lens: &Lens, n: &[f64], mut p: DVec3, mut d: DVec3) -> Vec<DVec2> {
    let (mut vertex, mut met) = (0.0, Vec::new());
    for (i, s) in lens.surfaces.iter().enumerate() {
        assert!(!s.shape.is_aspheric() && s.shape.conic == 0.0, "the oracle knows spheres");
        let c = s.shape.curvature;
        let q = p - vertex * DVec3::Z;
        // c|q + t d|² = 2 (q + t d)_z, the root next to the vertex.
        let (half_b, rest) = (c * q.dot(d) - d.z, c * q.length_squared() - 2.0 * q.z);
        let t = if c == 0.0 {
            -q.z / d.z
        } else {
            let root = half_b * half_b - c * rest;
            if root < 0.0 {
                break;
            }
            rest / (-half_b + root.sqrt())
        };
        let hit = q + t * d;
        met.push(hit.truncate());
        let normal = (DVec3::Z - c * hit).normalize();
        let (mu, cosine) = (n[i] / n[i + 1], normal.dot(d));
        let square = 1.0 - mu * mu * (1.0 - cosine * cosine);
        if square < 0.0 {
            break;
        }
        d = mu * d + (square.sqrt() - mu * cosine) * normal;
        p = hit + vertex * DVec3::Z;
        vertex += s.thickness;
    }
    met
}

/// The launch ray of a field angle (at the entrance pupil) that meets the stop at `target`: Newton with differences.
fn aimed(lens: &Lens, n: &[f64], angle: f64, target: DVec2) -> Vec<DVec2> {
    let pupil = paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position;
    let ray = |e: DVec2| {
        if lens.object_vergence == 0.0 {
            return (
                e.extend(0.0) - 50.0 * DVec3::new(0.0, angle.tan(), 1.0),
                DVec3::new(0.0, angle.sin(), angle.cos()),
            );
        }
        let distance = lens.object_vergence.recip();
        let object = DVec3::new(0.0, -(distance + pupil) * angle.tan(), -distance);
        (object, (e.extend(0.0) - object).normalize())
    };
    let miss = |e: DVec2| {
        let (p, d) = ray(e);
        heights(lens, n, p, d)[lens.stop] - target
    };
    let mut e = DVec2::new(0.0, -pupil * angle.tan());
    for _ in 0..30 {
        let (h, off) = (1e-5, miss(e));
        let by = [DVec2::X, DVec2::Y].map(|u| (miss(e + h * u) - miss(e - h * u)) / (2.0 * h));
        e -= glam::DMat2::from_cols(by[0], by[1]).inverse() * off;
    }
    assert!(miss(e).length() < 1e-9, "{angle}, {target}");
    let (p, d) = ray(e);
    heights(lens, n, p, d)
}

/// Rays that some aperture other than the stop stops, of the points and fields of the check.
fn counted(lens: &Lens) -> (usize, usize) {
    let radius = paraxial::stop_semi_diameter(lens);
    let mut points = vec![DVec2::ZERO];
    for (part, turn) in [(0.4, 0.0), (0.75, 0.5), (1.0, 0.0)] {
        points.extend((0..8).map(|k| part * DVec2::from_angle(std::f64::consts::TAU * (f64::from(k) + turn) / 8.0)));
    }
    let (mut all, mut stopped) = (0, 0);
    for nm in &lens.wavelengths.nm {
        let n = lens.indices(*nm);
        for share in [0.0, 0.35, 0.7, 1.0] {
            for point in &points {
                let met = aimed(lens, &n, share * lens.max_field_deg().to_radians(), *point * radius);
                let outside = |(i, h): (usize, &DVec2)| i != lens.stop && h.length() > lens.surfaces[i].semi_diameter;
                all += 1;
                stopped += usize::from(met.iter().enumerate().any(outside));
            }
        }
    }
    (all, stopped)
}

/// Rays at the stop's rim meet it to rounding; what stops them behind it is not lost, and near objects have the field angle
/// of the entrance pupil.
#[test]
fn check_counts_the_rays_that_apertures_stop() {
    let with = |lens: &Lens, change: &dyn Fn(&mut Prescription)| lens.changed(change).expect("a lens");
    let shipped = |name: &str| builtin::lens(name).expect("shipped");
    let cooke = with(&shipped("cooke_triplet"), &|l| l.surfaces[5].semi_diameter = 4.0);
    // All rays of the stop's rim, and no other: 8 of 25 points, four times the axis, three wavelengths.
    let axis = with(&cooke, &|l| l.field = Field::Angle(0.0));
    let near = with(&cooke, &|l| l.object_vergence = 1.0 / 120.0);
    let two = with(&shipped("two_element"), &|l| {
        (l.object_vergence, l.field, l.surfaces[4].semi_diameter) = (1.0 / 60.0, Field::Angle(25.0), 8.0);
    });
    let open = unchecked(&shipped("cooke_triplet"), |l| l.surfaces.iter_mut().for_each(|s| s.semi_diameter = 10.0));
    let lenses = [
        ("axis", axis, Some(96)),
        ("cooke", cooke, None),
        ("near", near, None),
        ("two elements", two, None),
        ("open", open, Some(0)),
    ];
    for (name, lens, expected) in lenses {
        let (all, stopped) = counted(&lens);
        let health = check(&lens);
        let found = health.failed.get("vignetted").copied().unwrap_or(0);
        eprintln!("{name}: {found} of {} vignetted, {stopped} of {all} by hand", health.rays);
        assert_eq!((health.rays, found), (all, stopped), "{name}");
        assert!(expected.is_none_or(|e| e == stopped), "{name}");
        assert!(expected.is_some() || stopped > 10, "{name}");
    }
}

/// A stop whose own clear aperture is smaller than `aperture` asks for: the smaller one stops rays, and reading says so.
#[test]
fn a_stop_is_no_larger_than_its_own_clear_aperture() {
    let place = Workplace::new();
    let text = include_str!("../../models/lenses/cooke_triplet.toml");
    assert_eq!(text.matches("semi_diameter_mm = 4.6").count(), 1);
    place.write("small.toml", text.replacen("semi_diameter_mm = 4.6", "semi_diameter_mm = 2.5", 1));
    place.write("whole.toml", text);
    let lens = isoplanat::lens::prescription::load(&place.path("whole.toml")).expect("reads");
    let (n, mut rays, mut at_stop) = (lens.indices(587.5618), Vec::new(), Vec::new());
    for k in 0..60 {
        let y = 0.08 * f64::from(k);
        let (p, d) = (DVec3::new(0.0, y, -5.0), DVec3::Z);
        at_stop.push(heights(&lens, &n, p, d)[lens.stop].length());
        rays.push(serde_json::json!({ "origin_mm": p.to_array(), "direction": d.to_array() }));
    }
    place.write("rays.json", serde_json::json!({ "wavelength_nm": 587.5618, "rays": rays }).to_string());
    let mut counts = Vec::new();
    for (file, stop) in [("whole.toml", paraxial::stop_semi_diameter(&lens)), ("small.toml", 2.5)] {
        let ran = place.run(&format!("trace {file} --rays rays.json --clip"));
        let warned = ran.err.lines().any(|l| l.starts_with("warning: small.toml: surface[3].semi_diameter_mm: 2.5"));
        assert_eq!(warned, file == "small.toml", "{}", ran.err);
        let answer: Value = serde_json::from_str(&ran.done()).expect("JSON");
        for (ray, h) in answer["rays"].as_array().expect("list").iter().zip(&at_stop) {
            assert_eq!(ray["status"] == "vignetted", *h > stop, "{file}, {h}");
            assert!(*h <= stop || ray["surface"] == 3, "{file}: {ray}");
        }
        counts.push(at_stop.iter().filter(|h| **h > stop).count());
    }
    assert!(counts[0] == 0 && counts[1] > 10, "{counts:?}");
    // The size that counts is the one that is reported, and both renderers and the design see the same lens.
    let json: Value = serde_json::from_str(&place.run("inspect small.toml --json").done()).expect("JSON");
    assert_eq!(json["stop_semi_diameter_mm"], 2.5);
}
