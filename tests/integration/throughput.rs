//! Irradiance: its hard edges against counted rays, kernels' soft edges against it, its derivatives against differences.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use isoplanat::lens::{Aperture, Lens, LensGradient, builtin, paraxial::first_order, unchecked};
use isoplanat::psf::{Model, Optics, OpticsBar, OpticsSpec, Quadrature, SensorPoint};
use isoplanat::report::field::FieldLine;
use isoplanat::testing::{assert_rel, central_difference};
use isoplanat::trace::aim::{Aimer, SensorView};
use isoplanat::trace::sequential::first_vignetted;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, Ray, System};
use rayon::prelude::*;

const NM: f64 = 550.0;

/// The lens as one sensor point sees it: knots on the axis and there, nothing interpolated.
fn optics(lens: &Lens, radius_mm: f64) -> Optics {
    let spec = OpticsSpec {
        radii_mm: vec![0.0, radius_mm],
        vergences: vec![lens.object_vergence],
        quadrature: Quadrature { nm: vec![NM], weight: vec![vec![1.0]] },
        degree: 9,
        lit: false,
        illuminations: 1,
        diffraction: Model::Rays,
    };
    Optics::compute(lens, &spec).expect("traces")
}

fn irradiance(lens: &Lens, radius_mm: f64) -> f64 {
    optics(lens, radius_mm).irradiance(at(radius_mm))[0]
}

fn at(radius_mm: f64) -> SensorPoint {
    SensorPoint::along([0.0, 1.0], radius_mm)
}

/// Irradiance through hard edges, without polynomials: a raster over the direction cosines at the sensor point.
fn hard_irradiance(lens: &Lens, radius_mm: f64, side: u32) -> f64 {
    let view = SensorView::new(&System::new(lens, NM));
    let (system, at) = (&view.system, DVec2::new(0.0, radius_mm));
    let mut hits = Vec::new();
    // The raster's frame: around the stop's rim, a little more on every side.
    let rim: Vec<DVec2> = (0..32)
        .map(|k| {
            let target = system.stop_semi_diameter * DVec2::from_angle(TAU * f64::from(k) / 32.0);
            view.aim(at, target, None, &mut hits).expect("aims")
        })
        .collect();
    let (low, high) = rim.iter().fold((rim[0], rim[0]), |(a, b), p| (a.min(*p), b.max(*p)));
    let (low, high) = (low - 0.03 * (high - low), high + 0.03 * (high - low));
    let step = DVec2::new(high.x, high.y - low.y) / DVec2::new(f64::from(side / 2), f64::from(side));
    let mut sum = 0.0;
    for i in 0..side {
        for j in 0..side / 2 {
            // By symmetry half of it.
            let p = DVec2::new((f64::from(j) + 0.5) * step.x, low.y + (f64::from(i) + 0.5) * step.y);
            let direction = DVec3::new(p.x, p.y, (1.0 - p.length_squared()).sqrt());
            let arrives = trace(system, Ray { origin: at.extend(0.0), direction }, system.image(), &mut hits).is_ok();
            if arrives && first_vignetted(system, &hits).is_none() {
                sum += 2.0 * step.x * step.y;
            }
        }
    }
    view.image_index().powi(2) * sum
}

/// Shipped lenses and slopes.
const CASES: [(&str, f64); 7] = [
    ("two_element", 0.3),
    ("two_element", 0.4),
    ("cooke_triplet", 0.2),
    ("cooke_triplet", 0.35),
    ("double_gauss", 0.15),
    ("double_gauss", 0.25),
    ("three_element", 0.02),
];

/// A shipped lens whose first and last surface are cut so that each takes a part of the beam at `slope`: the first the
/// outer 60 % of its upper or lower half, the last 40 %; and the sensor radius where the beam arrives.
fn narrowed(name: &str, slope: f64) -> (Lens, f64) {
    let lens = builtin::lens(name).expect("shipped");
    let system = System::new(&lens, NM);
    let object = ObjectPoint::from_slope(DVec2::new(0.0, slope), lens.object_vergence);
    let aimer = Aimer::new(&system).expect("a stop");
    let heights = |target: f64, surface: usize| {
        let mut hits = Vec::new();
        let target = DVec2::new(0.0, target * system.stop_semi_diameter);
        let aimed = aimer.aim(object, target, None).expect("aims");
        trace(&system, aimed.ray, system.image(), &mut hits).expect("traces");
        hits[surface].at.point.y.abs()
    };
    let radius_mm = heights(0.0, lens.surfaces.len());
    let count = lens.surfaces.len();
    let cut = lens.changed(|cut| {
        for (surface, part) in [(0, 0.4), (count - 1, 0.6)].into_iter().filter(|(s, _)| *s != lens.stop) {
            let (chief, far) = (heights(0.0, surface), heights(1.0, surface).max(heights(-1.0, surface)));
            cut.surfaces[surface].semi_diameter = chief + part * (far - chief);
        }
    });
    (cut.expect("a lens"), radius_mm)
}

/// The irradiance against counted rays, and the bias of the kernels' soft edges against both.
#[test]
fn the_soft_edge_has_little_bias() {
    let (mut worst, mut worst_hard) = ([0.0f64; 3], 0.0f64);
    for (name, slope) in CASES {
        let (lens, radius) = narrowed(name, slope);
        let hard = hard_irradiance(&lens, radius, 1200);
        let optics = optics(&lens, radius);
        let exact = optics.irradiance(at(radius))[0];
        let open = exact / irradiance(&builtin::lens(name).expect("shipped"), radius);
        let bias = |count: usize| {
            let rays = optics.form(count, 3, 1, 0.01).rays(optics.table(), &optics.maps[0], 0, at(radius));
            [rays.etendue() / exact - 1.0, rays.etendue() / hard - 1.0]
        };
        let (b60, b200, b3000) = (bias(60), bias(200), bias(3000));
        let off = exact / hard - 1.0;
        eprintln!(
            "{name} slope {slope}: {hard:.6} sr counted, {off:+.2e} in closed form; {:.0} % open, clipped by {:?}; \
             soft edges {:+.2e} (60 points) {:+.2e} (200) {:+.2e} (3000)",
            1e2 * open,
            optics.table().clips,
            b60[0],
            b200[0],
            b3000[0]
        );
        for (w, b) in worst.iter_mut().zip([b60, b200, b3000]) {
            *w = b.iter().fold(*w, |w, b| w.max(b.abs()));
        }
        worst_hard = worst_hard.max(off.abs());
    }
    let [a, b, c] = worst;
    // Where the edges of two apertures nearly coincide (the three elements near the axis) or cross at a small angle, the
    // product of their ramps falls short, most where little of the stop is left.
    eprintln!("hard edges {worst_hard:.2e}; worst bias {a:.2e} (60 points), {b:.2e} (200), {c:.2e} (3000)");
    assert!(b < 1e-2 && c < 2e-3, "{worst:?}");
    assert!(worst_hard < 5e-4, "{worst_hard:e}");
}

/// Irradiance of every ray from the rear aperture, as [`hard_irradiance`] has it, but that nothing is aimed: a coarse raster over the rear surface
/// tells where a fine one is needed.
fn counted(lens: &Lens, nm: f64, radius_mm: f64) -> f64 {
    let view = SensorView::new(&System::new(lens, nm));
    let (system, at) = (&view.system, DVec2::new(0.0, radius_mm));
    let rear = lens.surfaces.last().expect("surfaces");
    let wide = 1.05 * rear.semi_diameter;
    let depth = (rear.shape.curvature * wide).abs().min(1.0);
    let sag = wide * depth / (1.0 + (1.0 - depth * depth).sqrt());
    let far = [rear.thickness - sag, rear.thickness + sag, (rear.thickness + sag).hypot(wide)];
    let cosines = [-wide, wide].into_iter().flat_map(|y| far.map(|d| (y - radius_mm) / (y - radius_mm).hypot(d)));
    let (low, high) = cosines.fold((1.0f64, -1.0f64), |(a, b), c| (a.min(c), b.max(c)));
    // By symmetry half of it: across from 0, along the meridian from low to high.
    let mut frame = [DVec2::new(0.0, low), DVec2::new(wide / wide.hypot(far[0]), high)];
    let mut hits = Vec::new();
    let mut sum = 0.0;
    for side in [160, 700] {
        let step = (frame[1] - frame[0]) / f64::from(side);
        let open: Vec<DVec2> = (0..side * side)
            .map(|k| frame[0] + step * DVec2::new(f64::from(k % side) + 0.5, f64::from(k / side) + 0.5))
            .filter(|p| p.length_squared() < 1.0)
            .filter(|p| {
                let direction = p.extend((1.0 - p.length_squared()).sqrt());
                let ray = Ray { origin: at.extend(0.0), direction };
                trace(system, ray, system.image(), &mut hits).is_ok() && first_vignetted(system, &hits).is_none()
            })
            .collect();
        sum = 2.0 * step.x * step.y * f64::from(u32::try_from(open.len()).expect("a raster"));
        let (from, to) = open.iter().fold((DVec2::INFINITY, -DVec2::INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        frame = [(from - 2.0 * step).max(DVec2::new(0.0, -1.0)), to + 2.0 * step];
    }
    view.image_index().powi(2) * sum
}

/// Light over the field of lenses whose stop's rim is not seen from everywhere, or hardly: rays of a part of the stop fail, mostly of one that other
/// apertures close.
#[test]
fn light_over_the_field_is_counted_light() {
    let names = ["biotar", "sonnar", "tessar", "heliar", "petzval", "retrofocus", "wide_angle", "hologon", "phone"];
    let found: Vec<(f64, String)> = names
        .into_par_iter()
        .flat_map_iter(|name| {
            let lens = builtin::lens(name).expect("shipped");
            let radius = FieldLine::new(&lens, lens.object_vergence, 2).expect("a field").radius_mm[1];
            let quadrature = Quadrature { nm: vec![NM], weight: vec![vec![1.0]] };
            let optics = Optics::even(&lens, radius, vec![lens.object_vergence], quadrature, 256).expect("light");
            let lost = optics.illumination().lost.iter().copied().fold(0.0, f64::max);
            assert!(
                optics.table().is_partial() || lost < 1e-12,
                "{name}: {lost:e} of the light lost though no ray fails"
            );
            let axis = counted(&lens, NM, 0.0);
            [0.6, 0.8, 0.85, 0.9, 0.95, 1.0].map(|part| {
                let r = part * radius;
                let expected = counted(&lens, NM, r) / axis;
                let found = optics.relative_illumination(at(r))[0];
                let part = optics.table().row(0, &optics.table().taps(r)).part;
                let heights = part.heights;
                let line = format!("{name} {r:.2} mm: {found:.4}, counted {expected:.4}; {heights:?}, lost {lost:.1e}");
                ((found - expected).abs(), line)
            })
        })
        .collect();
    found.iter().for_each(|(_, line)| eprintln!("{line}"));
    let worst = found.into_iter().reduce(|a, b| if a.0 > b.0 { a } else { b }).expect("some");
    assert!(worst.0 < 2e-3, "{}", worst.1);
}

/// Irradiance at a sensor point and its gradient.
fn gradient(lens: &Lens, radius_mm: f64) -> (f64, LensGradient) {
    let optics = optics(lens, radius_mm);
    let mut bar = OpticsBar::zeros(&optics);
    optics.illumination().at_vjp(at(radius_mm), &[1.0], &mut bar.illumination);
    (optics.irradiance(at(radius_mm))[0], optics.vjp(lens, &bar))
}

#[test]
fn throughput_follows_clear_apertures() {
    let mut clipping = 0;
    for (name, slope) in CASES {
        let (lens, radius) = narrowed(name, slope);
        let (level, g) = gradient(&lens, radius);
        for i in (0..lens.surfaces.len()).filter(|i| *i != lens.stop) {
            let f = |h: f64| {
                let moved = lens.changed(|l| l.surfaces[i].semi_diameter += h);
                irradiance(&moved.expect("a lens"), radius) / level
            };
            let pulled = g.surfaces[i].semi_diameter / level;
            assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.03, &format!("{name} {slope} surface {i}"));
            // A larger aperture lets more light through.
            clipping += u32::from(pulled > 3e-3);
        }
    }
    assert!(clipping >= 5, "{clipping} apertures that clip");
}

/// However the lens states its aperture: stop size, entrance pupil, f-number.
#[test]
fn throughput_follows_the_stop_size() {
    for (name, slope) in CASES {
        let (shipped, radius) = narrowed(name, slope);
        let first = first_order(&shipped, shipped.wavelengths.primary_nm);
        let level = irradiance(&shipped, radius);
        let stop = first.stop_semi_diameter;
        // The rim of the stop does its part; where other apertures leave nothing of it the derivative is small.
        for aperture in [
            Aperture::StopSemiDiameter(stop),
            Aperture::EntrancePupilDiameter(first.entrance_pupil_diameter),
            Aperture::FNumber(first.f_number),
        ] {
            let with_aperture = |aperture| unchecked(&shipped, |l| l.aperture = aperture);
            let lens = with_aperture(aperture);
            let mut g = gradient(&lens, radius).1;
            let with = |h: f64| {
                let mut moved = aperture;
                *moved.number_mut() += h;
                moved
            };
            let f = |h: f64| irradiance(&with_aperture(with(h)), radius) / level;
            // The stop's size follows the stated number.
            let pulled = *g.aperture.number_mut() / level;
            assert_rel(pulled, central_difference(f, 1e-4), 1e-6, 3e-3, &format!("{name} {slope} {aperture:?}"));
            // Curvatures move the pupil and, where the stop follows from the aperture, its size.
            for i in 0..lens.surfaces.len() {
                let size = 1e-3 / lens.surfaces[i].semi_diameter;
                let f = |h: f64| {
                    let moved = lens.changed(|l| l.surfaces[i].shape.curvature += h * size);
                    irradiance(&moved.expect("a lens"), radius) / level
                };
                let pulled = g.surfaces[i].shape.curvature * size / level;
                let what = format!("{name} {slope} {aperture:?} curvature {i}");
                assert_rel(pulled, central_difference(f, 1e-2), 1e-6, 3e-5, &what);
            }
        }
    }
}
