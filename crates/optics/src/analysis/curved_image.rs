//! Lenses whose image is curved: a ball, which looks the same from everywhere, and files of other programs.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DVec2, DVec3};

use super::beam::{Beam, stop_points};
use super::spot::spot;
use super::wavefront::Map;
use super::wavefront::rays::Source;
use super::{curves, diffraction, fan};
use crate::interchange::{self, Form};
use crate::lens::catalogue::Glasses;
use crate::lens::{ImageSurface, Lens, builtin, prescription};
use crate::psf::illumination::Illumination;
use crate::psf::table::{Table, TableSpec};
use crate::psf::{SensorMap, SensorPoint};
use crate::trace::aim::Aimer;
use crate::trace::sequential::trace;
use crate::trace::{ObjectPoint, System};
use isoplanat_base::testing::{assert_abs, assert_rel};

/// Index and radius of the ball; its focal length is `n R/(2(n − 1))`, from its centre.
const N: f64 = 1.5;
const R: f64 = 10.0;
const F: f64 = 15.0;
const NM: f64 = 550.0;

/// A ball with a plane stop in its middle, and an image surface about the same centre.
fn ball(stop: f64) -> Lens {
    let glass = format!("{{ wavelength_nm = [400.0, 700.0], index = [{N}, {N}] }}");
    let text = format!(
        "schema = 1\nname = \"ball\"\nsource = \"own\"\naperture = {{ stop_semi_diameter_mm = {stop:?} }}\n\
         object = {{ distance_mm = inf }}\nfield = {{ max_angle_deg = 45.0 }}\n\
         wavelengths = {{ nm = [{NM}], weights = [1], primary_nm = {NM} }}\n\
         sensor = {{ columns = 100, rows = 100, pitch_um = 100.0 }}\nimage = {{ radius_mm = -{F} }}\n\
         [[surface]]\nradius_mm = {R}\nthickness_mm = {R}\nmedium = {glass}\nsemi_diameter_mm = 9.5\n\
         [[surface]]\nradius_mm = inf\nthickness_mm = {R}\nmedium = {glass}\nsemi_diameter_mm = {stop:?}\nstop = true\n\
         [[surface]]\nradius_mm = -{R}\nthickness_mm = {}\nmedium = \"air\"\nsemi_diameter_mm = 9.5\n",
        F - R
    );
    prescription::from_toml(&text, "ball.toml").expect("a lens")
}

fn object(angle_deg: f64) -> ObjectPoint {
    ObjectPoint::from_angle(angle_deg.to_radians(), FRAC_PI_2, 0.0)
}

/// The ball turned about its centre is itself. Rays across the meridian meet the stop on the line that stays where it is: everything of them is that of the axis, turned.
#[test]
fn a_ball_sees_the_same_everywhere() {
    let lens = ball(3.0);
    let system = System::new(&lens, NM);
    let aimer = Aimer::new(&system).expect("a stop");
    let centre = DVec3::new(0.0, 0.0, -F);
    let rays = |angle: f64| {
        let about = super::wavefront::rays::chief_landing(&aimer, object(angle)).expect("lands");
        let source = Source::new(&aimer, object(angle), about).expect("lands");
        [-1.0, -0.5, 0.2, 0.7, 1.0].map(|u| source.ray(DVec2::new(u, 0.0)).expect("arrives"))
    };
    let axis = rays(0.0);
    assert!(axis[0].landing.x.abs() > 0.02 && axis[0].path.abs() > 1e-3, "a ball has aberrations: {:?}", axis[0]);
    for angle in [1.0f64, 20.0, 45.0] {
        let (sin, cos) = angle.to_radians().sin_cos();
        let turn = DMat3::from_rotation_x(-angle.to_radians());
        let chief = Beam::new(&system, object(angle), &[]).chief.expect("lands");
        assert_abs(chief.at.y, F * sin, 1e-12, "height");
        for (here, there) in axis.iter().zip(rays(angle)) {
            let landing = centre + turn * (here.landing - centre);
            assert_abs((there.landing - landing).length(), 0.0, 1e-11, "landing");
            assert_abs((there.direction - turn * here.direction).length(), 0.0, 1e-12, "direction");
            assert_abs(there.path, here.path, 1e-11, "path");
            // Along the surface, at the chief ray's landing.
            assert_abs(there.cosines.x, here.cosines.x, 1e-12, "cosines");
            assert_abs(there.cosines.y, (there.direction.y * cos - there.direction.z * sin) / cos, 1e-11, "cosines");
        }
        // Rays close to the chief ray meet on the image surface itself.
        let rows = curves::over_field(&lens, &[NM], &[0.0, angle]);
        for focus in [rows[0].sagittal, rows[1].sagittal, rows[1].tangential] {
            assert_abs(focus, 0.0, 1e-6, "focus");
        }
        assert_abs(rows[1].chief_angle_deg, 0.0, 1e-9, "chief ray's angle on the sensor");
        let plane = lens.changed(|l| l.image = ImageSurface::default()).expect("a lens");
        let on_plane = curves::over_field(&plane, &[NM], &[angle])[0].chief_angle_deg;
        assert_abs(on_plane, angle, 1e-9, "chief ray's angle on a plane");
        // On the plane through the vertex neither is there.
        let flat = lens.changed(|l| l.image = ImageSurface::default()).expect("a lens");
        let row = &curves::over_field(&flat, &[NM], &[angle])[0];
        let behind = F * (cos - 1.0);
        assert_abs(row.sagittal, behind, 1e-6, "focus before a plane");
    }
    // Fans of paths and of landings.
    let fans = |angle: f64| {
        let from = fan::reference(&system, object(angle)).expect("lands");
        let [_, across] = fan::transverse(&system, object(angle), from, 21);
        let [_, waves] = fan::path(&system, object(angle), from, 21);
        (across.points, waves.points)
    };
    let (here, there) = (fans(0.0), fans(30.0));
    for (a, b) in here.0.iter().zip(&there.0) {
        assert_abs(a[1], b[1], 1e-11, "transverse fan");
    }
    // Spheres through the exit pupil's plane on the chief ray: at 30° their radius is another, by the cosine.
    for (a, b) in here.1.iter().zip(&there.1) {
        assert_abs(a[1], b[1], 2e-2 * a[1].abs() + 1e-9, "path fan");
    }
}

/// A stop so small that only diffraction is left: along the surface the cutoff falls with the cosine across which the stop is seen, and heights grow with less of it, so that by
/// heights it is that of the axis; and so is the light of a pixel, which is as wide by heights.
#[test]
fn a_small_stop_of_a_ball_resolves_and_lights_the_same_everywhere() {
    let lens = ball(0.05);
    let mtf = |angle: f64, focus: f64| {
        let mut plan = diffraction::Plan::new(object(angle), vec![0.0, 3.0, 8.0]);
        plan.focus_mm = vec![focus];
        diffraction::of_lens(&lens, object(angle), &plan).expect("light").curves
    };
    let axis = mtf(0.0, 0.0);
    for angle in [10.0f64, 40.0] {
        for (curve, of_axis) in mtf(angle, 0.0).iter().zip(&axis) {
            assert_rel(curve.cutoff, of_axis.cutoff, 1e-4, 0.0, "cutoff");
            for k in [1, 2] {
                let [a, b] = [curve, of_axis].map(|c| c.modulus(0, k).expect("told"));
                assert_abs(a, b, 1e-4, "MTF");
            }
        }
        // Moved along the axis by dz the surface is dz cos θ from focus, where the blur across is as wide as that much of defocus makes it on the axis.
        let dz = 30.0;
        let [moved, there] = [mtf(angle, dz), mtf(0.0, dz * angle.to_radians().cos())];
        let [a, b] = [&moved[1], &there[1]].map(|c| c.modulus(0, 2).expect("told"));
        assert!(b < 0.98 * axis[1].modulus(0, 2).expect("told"), "{b}");
        assert_abs(a, b, 2e-3, "MTF out of focus");
    }
    let spec = TableSpec { radii_mm: vec![0.0, 3.0, 6.0, 10.0], wavelength_nm: vec![NM], degree: 7, lit: false };
    let table = Table::compute(&lens, &spec).expect("light");
    let map = SensorMap::fit(&lens, &table, 0.0).expect("a map");
    for (radius, angle) in [(3.0f64, (3.0f64 / F).asin()), (10.0, (10.0 / F).asin())] {
        assert_rel(map.slope(radius), angle.tan(), 1e-9, 0.0, "slope");
    }
    let light = Illumination::compute(&table, 10.0, 40);
    let at = |radius: f64| light.at(SensorPoint::at([0.0, radius]))[0];
    for radius in [2.0, 5.0, 8.0, 10.0] {
        assert_rel(at(radius), at(0.0), 1e-4, 0.0, "light of a pixel");
    }
}

/// Spots of rays from the scene and of rays from the sensor; what is written is read, with its landings.
#[test]
fn curved_images_are_written_and_read() {
    let glasses = Glasses::shipped();
    let image = ImageSurface { curvature: -1.0 / 37.0, conic: -0.4 };
    let flat = builtin::lens("cooke_triplet").expect("shipped");
    let lens = flat.changed(|l| l.image = image).expect("a lens");
    let text = prescription::to_toml(&lens);
    assert!(text.contains("[image]") && !prescription::to_toml(&flat).contains("[image]"), "{text}");
    assert_eq!(prescription::from_toml(&text, "again.toml").expect("a lens"), lens);
    assert_ne!(lens.sha256(), flat.sha256());
    let landings = |lens: &Lens| {
        let beam = Beam::new(&System::new(lens, NM), object(15.0), &stop_points(40));
        beam.landings.iter().map(|l| l.at).collect::<Vec<_>>()
    };
    let expected = landings(&lens);
    assert!((expected[0] - landings(&flat)[0]).length() > 0.1);
    for form in [Form::Zmx, Form::Seq] {
        let (text, _) = interchange::text_of(&lens, form, glasses).expect("written");
        let read = interchange::parse(&text, form, "again", glasses).expect("read");
        assert!(
            read.notes.iter().any(|n| n.contains("the image is curved, with a radius of -37 mm")),
            "{:?}",
            read.notes
        );
        for (a, b) in landings(&read.lens).iter().zip(&expected) {
            assert_abs((*a - *b).length(), 0.0, 1e-9, &format!("{form:?}"));
        }
    }
    let error = flat.changed(|l| l.image = ImageSurface { curvature: 1.0 / 20.0, conic: 0.0 }).expect_err("too small");
    assert!(error.to_string().contains("whose corner lies"), "{error}");
    let error =
        prescription::from_toml(&text.replace("conic = -0.4", "conic = nan"), "a.toml").expect_err("not a number");
    assert!(error.to_string().contains("image.conic: NaN"), "{error}");
    // A ray that lands is on the surface.
    let system = System::new(&lens, NM);
    let aimed = Aimer::new(&system).expect("a stop").aim(object(15.0), DVec2::new(1.0, 2.0), None).expect("aims");
    let hit = trace(&system, aimed.ray, system.image(), &mut Vec::new()).expect("lands");
    let rho = hit.at.point.truncate().length_squared();
    let c = image.curvature;
    assert_abs(hit.at.point.z, c * rho / (1.0 + (1.0 - (1.0 + image.conic) * c * c * rho).sqrt()), 1e-13, "sag");
    assert!(spot(&Beam::new(&system, object(0.0), &stop_points(40)).landings, 0.0).expect("light").rms > 0.0);
    let map = Map::of_lens(&lens, object(10.0), NM, 16).expect("light");
    assert!(map.figures.rms.is_finite());
}
