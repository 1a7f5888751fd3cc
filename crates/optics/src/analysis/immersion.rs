//! Objects that do not lie in air: a sphere whose aplanatic point they stand in, and a real lens against itself behind a sliver of air.

use std::f64::consts::FRAC_PI_2;

use glam::DVec2;

use super::beam::{Beam, stop_points};
use super::spot::spot;
use super::wavefront::Map;
use super::{curves, diffraction};
use crate::interchange::{self, Form};
use crate::lens::catalogue::Glasses;
use crate::lens::{Aperture, Lens, Medium, Shape, Surface, Wavelengths, builtin, paraxial, prescription};
use crate::trace::{ObjectPoint, System};
use isoplanat_base::testing::{assert_abs, assert_rel};

/// Index, radius and ideal lens of [`aplanatic`].
const N: f64 = 1.5;
const R: f64 = 6.0;
const F: f64 = 8.0;

/// An object in the aplanatic point of a sphere of index `N`, R/N before its centre: light leaves the sphere as if from N R before the centre, at every angle. An ideal lens
/// 1 mm behind the sphere images that point onto the sensor.
fn aplanatic(aperture: &str) -> Lens {
    let distance = R + R / N;
    let virtual_mm = R + N * R + 1.0;
    let image = 1.0 / (1.0 / F - 1.0 / virtual_mm);
    let text = format!(
        "schema = 1\nname = \"aplanatic\"\nsource = \"own\"\naperture = {{ {aperture} }}\n\
         object = {{ distance_mm = {distance:?}, medium = {{ wavelength_nm = [400.0, 700.0], index = [{N}, {N}] }} }}\n\
         field = {{ max_object_height_mm = 0.01 }}\n\
         wavelengths = {{ nm = [550.0], weights = [1], primary_nm = 550.0 }}\n\
         sensor = {{ columns = 100, rows = 100, pitch_um = 1.0 }}\n\
         [[surface]]\nradius_mm = -{R}\nthickness_mm = 1.0\nmedium = \"air\"\nsemi_diameter_mm = 5.99\n\
         [[surface]]\nideal_focal_length_mm = {F}\nthickness_mm = {image:?}\nmedium = \"air\"\nsemi_diameter_mm = 10.0\nstop = true\n"
    );
    prescription::from_toml(&text, "aplanatic.toml").expect("a lens")
}

/// Numerical aperture 1 in glass, which no light reaches from air: a point, without path differences, magnified N² times and by the ideal lens; the sine condition holds.
#[test]
fn an_aplanatic_sphere_images_a_point_in_its_glass() {
    let lens = aplanatic("object_space_na = 1.0");
    let first = paraxial::first_order(&lens, 550.0);
    let virtual_mm = R + N * R + 1.0;
    let image = 1.0 / (1.0 / F - 1.0 / virtual_mm);
    assert_rel(first.paraxial_image_distance, image, 1e-12, 0.0, "image");
    assert_rel(first.magnification, -N * N * image / virtual_mm, 1e-12, 0.0, "magnification");
    // The sphere divides slopes by N: n u h is kept, and heights grow N² times.
    let slope = (1.0f64 / N).asin().tan();
    assert_rel(first.stop_semi_diameter, virtual_mm * slope / N, 1e-12, 0.0, "stop");
    assert_rel(first.working_f_number, 0.5 * image / first.stop_semi_diameter, 1e-12, 0.0, "working f-number");
    let (y, h) = (paraxial::marginal_height(&lens, 550.0), 0.01);
    assert_rel(first.lagrange_invariant, N * h * y / (R + R / N), 1e-9, 0.0, "Lagrange invariant");
    let system = System::new(&lens, 550.0);
    let axis = curves::object(&lens, 0.0);
    let beam = Beam::new(&system, axis, &stop_points(200));
    assert_eq!(beam.landings.len(), 200);
    assert!(spot(&beam.landings, 0.0).expect("light").rms < 1e-12);
    let map = Map::of_lens(&lens, axis, 550.0, 16).expect("light");
    assert!(map.best.rms < 1e-9, "{} waves", map.best.rms);
    // Off the axis the image is as sharp to first order of the height: the sine condition.
    let off = Beam::new(&system, curves::object(&lens, lens.max_field_deg()), &[DVec2::ZERO]);
    assert_rel(off.chief.expect("lands").at.y, -first.magnification * h, 1e-4, 0.0, "height");
}

/// An element whose object lies in its glass is the same element whose object lies in a sliver of air before it, to the sliver's thickness times the slopes: spots, paths,
/// and MTF of a triplet behind water, axis to corner.
#[test]
fn a_lens_under_water_is_one_behind_a_sliver_of_air() {
    const SLIVER: f64 = 2e-6;
    let water = Medium::Table { wavelength_nm: vec![440.0, 550.0, 680.0], index: vec![1.341, 1.335, 1.331] };
    let wet = builtin::lens("cooke_triplet").expect("shipped").changed(|l| {
        (l.object_medium, l.object_vergence) = (water.clone(), 1.0 / 400.0);
        let last = l.surfaces.len() - 1;
        l.surfaces[last].thickness = 60.0;
        l.aperture = Aperture::StopSemiDiameter(3.0);
        // Of several wavelengths the two objects would have other shares: what Lambert's law gives grows with the index squared.
        l.wavelengths = Wavelengths { nm: vec![550.0], weights: vec![1.0], primary_nm: 550.0 };
    });
    let wet = wet.expect("a lens");
    let focus = paraxial::first_order(&wet, 550.0).paraxial_image_distance;
    let wet = wet.changed(|l| l.surfaces.last_mut().expect("surfaces").thickness = focus).expect("a lens");
    let dry = wet.changed(|l| {
        let plane = Surface {
            shape: Shape::default(),
            thickness: 400.0,
            medium: water.clone(),
            semi_diameter: 400.0,
            pose: None,
        };
        (l.object_medium, l.object_vergence) = (Medium::Air, 1.0 / SLIVER);
        l.surfaces.insert(0, plane);
        l.stop += 1;
    });
    let dry = dry.expect("a lens");
    let (a, b) = (paraxial::first_order(&wet, 550.0), paraxial::first_order(&dry, 550.0));
    for (what, x, y) in [
        ("image", a.paraxial_image_distance, b.paraxial_image_distance),
        ("magnification", a.magnification, b.magnification),
        ("working f-number", a.working_f_number, b.working_f_number),
        ("exit pupil", a.exit_pupil_position, b.exit_pupil_position),
    ] {
        assert_rel(x, y, 1e-7, 0.0, what);
    }
    for height in [0.0, 60.0, 130.0] {
        let object = |z: f64| ObjectPoint::finite(glam::DVec3::new(0.0, -height, -z));
        let figures = |lens: &Lens, object: ObjectPoint| {
            let beam = Beam::new(&System::new(lens, 550.0), object, &stop_points(120));
            let plan = diffraction::Plan::new(object, vec![10.0, 30.0]);
            let mtf = diffraction::of_lens(lens, object, &plan).expect("light");
            let waves = Map::of_lens(lens, object, 550.0, 16).expect("light").best.rms;
            let rms = spot(&beam.landings, 0.0).expect("light").rms;
            [rms, beam.chief.expect("lands").at.y, waves, mtf.curves[0].modulus(0, 1).expect("a value")]
        };
        let (x, y) = (figures(&wet, object(400.0)), figures(&dry, object(SLIVER)));
        for (k, what) in ["rms", "height", "waves", "MTF"].into_iter().enumerate() {
            assert_rel(x[k], y[k], 1e-5, 1e-2, &format!("{what} at {height} mm"));
        }
    }
}

/// What is written is read: own form, Zemax, CODE V; also where the object stands on the plane that its medium begins with.
#[test]
fn objects_in_glass_are_written_and_read() {
    let glasses = Glasses::shipped();
    let bk7 = glasses.find("N-BK7", crate::lens::catalogue::Naming::Exact).expect("shipped");
    let lens = builtin::lens("cooke_triplet").expect("shipped").changed(|l| {
        (l.object_medium, l.object_vergence) = (bk7.clone(), 1.0 / 400.0);
        l.surfaces.last_mut().expect("surfaces").thickness = 55.0;
        l.aperture = Aperture::ObjectNa(0.02);
    });
    let lens = lens.expect("a lens");
    let text = prescription::to_toml(&lens);
    assert!(text.contains("medium = \"N-BK7\""), "{text}");
    assert_eq!(prescription::from_toml(&text, "again.toml").expect("a lens"), lens);
    let landings = |lens: &Lens| {
        let object = ObjectPoint::in_field(lens, 0.1, FRAC_PI_2);
        Beam::new(&System::new(lens, 550.0), object, &stop_points(20))
            .landings
            .iter()
            .map(|l| l.at.y)
            .collect::<Vec<_>>()
    };
    let expected = landings(&lens);
    let same = |read: &interchange::Imported, what: &str| {
        assert_eq!(read.lens.object_medium, bk7, "{what}");
        assert!(read.notes.iter().any(|n| n.contains("lies within N-BK7")), "{what}: {:?}", read.notes);
        for (a, b) in landings(&read.lens).iter().zip(&expected) {
            assert_abs(*a, *b, 1e-9, what);
        }
    };
    for form in [Form::Zmx, Form::Seq] {
        let (text, _) = interchange::text_of(&lens, form, glasses).expect("written");
        same(&interchange::parse(&text, form, "again", glasses).expect("read"), &format!("{form:?}"));
    }
    // The object on a slide's face, as most files of microscopes have it.
    let (text, _) = interchange::text_of(&lens, Form::Zmx, glasses).expect("written");
    let glass = text.lines().find(|l| l.contains("GLAS N-BK7")).expect("a glass").to_owned();
    let on_slide = text.replacen(&format!("DISZ 400\n{glass}\n"), "DISZ 0\n", 1).replacen(
        "SURF 1\n",
        &format!("SURF 1\n  TYPE STANDARD\n  CURV 0\n  DISZ 400\n{glass}\n  DIAM 200 0 0 0 1\nSURF 90\n"),
        1,
    );
    let mut number = 0;
    let renumbered: Vec<String> = on_slide
        .lines()
        .map(|l| {
            if l.starts_with("SURF ") {
                number += 1;
                format!("SURF {}", number - 1)
            } else {
                l.to_owned()
            }
        })
        .collect();
    same(&interchange::parse(&renumbered.join("\n"), Form::Zmx, "slide", glasses).expect("read"), "slide");
    // An aperture that the medium cannot have.
    let error = lens.changed(|l| l.aperture = Aperture::ObjectNa(1.6)).expect_err("beyond the index").to_string();
    assert!(error.contains("aperture.object_space_na: 1.6; above 0, below 1.5168"), "{error}");
    let error =
        prescription::from_toml(&text_of(&lens).replace("\"N-BK7\"\n\n[field]", "\"N-BK99\"\n\n[field]"), "a.toml");
    assert!(error.expect_err("unknown").to_string().contains("object.medium"));
}

fn text_of(lens: &Lens) -> String {
    prescription::to_toml(lens)
}
