//! Telecentric lenses and lenses that are nearly so: every figure runs smoothly through a pupil at infinity.
//!
//! The lens of `nearly` is an equiconvex singlet whose stop stands off its rear (object side) or front (image side) focal plane by
//! a small way: the pupil is at the square of the focal length over that. Figures at pupils of 1e6 to 1e20 mm on either side are held
//! against the parabola through those at −4e5 mm, at infinity and at 4e5 mm.

use glam::DVec2;

use super::beam::{Beam, stop_points};
use super::spot::{best_focus, spot};
use super::wavefront::Map;
use super::{curves, diffraction};
use crate::interchange;
use crate::lens::catalogue::{Glasses, Naming};
use crate::lens::{Lens, paraxial, prescription, seidel};
use crate::trace::health::check;
use crate::trace::{ObjectPoint, System};
use isoplanat_base::testing::assert_rel;

/// Distance of the pupils that the parabola is drawn through, mm.
const NEAR: f64 = 4e5;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Side {
    Object,
    Image,
}

/// Front focal length of the singlet by the lensmaker's formula: from its first vertex to the focal plane before it.
fn front_focus(n: f64, radius: f64, thickness: f64) -> f64 {
    let c = 1.0 / radius;
    let power = (n - 1.0) * (2.0 * c - (n - 1.0) * thickness * c * c / n);
    (1.0 - (n - 1.0) * thickness * c / n) / power
}

/// The lens whose pupil is at about `pupil_mm` (infinite: telecentric to rounding).
fn nearly(side: Side, pupil_mm: f64) -> Lens {
    let glass = "surface.medium";
    let singlet = |after: f64| {
        format!(
            "[[surface]]\nradius_mm = 50.0\nthickness_mm = 4.0\nmedium = \"N-BK7\"\nsemi_diameter_mm = 13.0\n\
             [[surface]]\nradius_mm = -50.0\nthickness_mm = {after:?}\nmedium = \"air\"\nsemi_diameter_mm = 13.0\n"
        )
    };
    let stop = |after: f64| {
        format!(
            "[[surface]]\nradius_mm = inf\nthickness_mm = {after:?}\nmedium = \"air\"\nsemi_diameter_mm = 3.0\nstop = true\n"
        )
    };
    let n = Glasses::shipped().find("N-BK7", Naming::Exact).expect(glass).index(587.5618);
    let focus = front_focus(n, 50.0, 4.0);
    let off = 49.043 * 49.043 / pupil_mm;
    let (object, field, surfaces) = match side {
        Side::Object => ("60.0", "max_object_height_mm = 3.0", singlet(focus + off) + &stop(195.0)),
        Side::Image => ("inf", "max_angle_deg = 3.0", stop(focus + off) + &singlet(47.0)),
    };
    let text = format!(
        "schema = 1\nname = \"nearly telecentric\"\nsource = \"own\"\naperture = {{ stop_semi_diameter_mm = 3.0 }}\n\
         object = {{ distance_mm = {object} }}\nfield = {{ {field} }}\n\
         wavelengths = {{ nm = [587.5618, 486.1327], weights = [1, 1], primary_nm = 587.5618 }}\n\
         sensor = {{ columns = 1000, rows = 1000, pitch_um = 5.0 }}\n{surfaces}"
    );
    prescription::from_toml(&text, "nearly.toml").expect("a lens")
}

/// Figures of axis and field that an engineer would read, each with its name.
fn figures(lens: &Lens) -> Vec<(String, f64)> {
    let nm = lens.wavelengths.primary_nm;
    let first = paraxial::first_order(lens, nm);
    let mut all = vec![
        ("focal length".to_owned(), first.effective_focal_length),
        ("working f-number".to_owned(), first.working_f_number),
        ("Lagrange invariant".to_owned(), first.lagrange_invariant),
        ("image distance".to_owned(), first.paraxial_image_distance),
    ];
    let system = System::new(lens, nm);
    let points = stop_points(120);
    for share in [0.0, 0.7, 1.0] {
        let angle = lens.max_field_deg() * share;
        let object = curves::object(lens, angle);
        let beam = Beam::new(&system, object, &points);
        let figure = spot(&beam.landings, 0.0).expect("light");
        let put = |all: &mut Vec<(String, f64)>, what: &str, v: f64| all.push((format!("{what} at {share}"), v));
        put(&mut all, "rms", figure.rms);
        put(&mut all, "best focus", best_focus(&beam.landings).expect("light")[2]);
        put(&mut all, "light", beam.landings.iter().map(|l| l.weight).sum());
        put(&mut all, "wavefront", Map::of_lens(lens, object, nm, 16).expect("light").best.rms);
        let plan = diffraction::Plan::new(object, vec![2.0, 5.0]);
        let mtf = diffraction::of_lens(lens, object, &plan).expect("light");
        put(&mut all, "MTF", mtf.curves[0].modulus(0, 1).expect("a value"));
        if share > 0.0 {
            put(&mut all, "height", beam.chief.expect("lands").at.y);
            let row = &curves::over_field(lens, &[nm, 486.1327], &[angle])[0];
            put(&mut all, "sagittal focus", row.sagittal);
            put(&mut all, "tangential focus", row.tangential);
            put(&mut all, "lateral colour", row.lateral_colour[1]);
        }
    }
    let sums = seidel::per_surface(lens, nm);
    all.extend(sums.iter().enumerate().map(|(i, s)| (format!("S_II of {i}"), s.coma)));
    all
}

#[test]
fn figures_run_smoothly_through_a_pupil_at_infinity() {
    for side in [Side::Object, Side::Image] {
        let [minus, exact, plus] = [-NEAR, f64::INFINITY, NEAR].map(|pupil| figures(&nearly(side, pupil)));
        let mut lenses = 0;
        for exponent in [6, 7, 8, 10, 12, 13, 14, 16, 18, 20] {
            for sign in [-1.0, 1.0] {
                let pupil = sign * 10f64.powi(exponent);
                let x = NEAR / pupil;
                for (k, (what, value)) in figures(&nearly(side, pupil)).into_iter().enumerate() {
                    let (a, c, b) = (minus[k].1, exact[k].1, plus[k].1);
                    let expected = c + x * (0.5 * (b - a) + x * (0.5 * (a + b) - c));
                    // Against the figure's own size; what is close to zero against that of its kin.
                    assert_rel(value, expected, 1e-6, 0.1, &format!("{side:?} {pupil:e}: {what}"));
                    // And infinity lies between its neighbours.
                    assert_rel(c, 0.5 * (a + b), 1e-4, 0.1, &format!("{side:?}: {what}"));
                }
                lenses += 1;
            }
        }
        assert_eq!(lenses, 20);
    }
}

/// The stop at the rear focal plane: light of each object point runs through the stop's middle parallel to the axis, and the paraxial
/// image is where Newton's formula puts it.
#[test]
fn a_telecentric_lens_has_the_figures_of_the_closed_form() {
    let lens = nearly(Side::Object, f64::INFINITY);
    let first = paraxial::first_order(&lens, lens.wavelengths.primary_nm);
    let focal = first.effective_focal_length;
    assert!(paraxial::field_origin(&lens).telecentric);
    // Newton: the object's distance from the front focus times the image's from the rear one (where the stop is) is f².
    let before = 60.0 + first.front_focal_length;
    assert_rel(first.paraxial_image_distance, focal * focal / before, 1e-12, 0.0, "image");
    assert_rel(first.magnification, -focal / before, 1e-12, 0.0, "magnification");
    assert_rel(first.working_f_number, first.paraxial_image_distance / 6.0, 1e-12, 0.0, "working f-number");
    // The marginal ray meets the stop, in the focal plane, at f u.
    let height = paraxial::marginal_height(&lens, lens.wavelengths.primary_nm);
    assert_rel(height / 60.0 * focal, 3.0, 1e-12, 0.0, "marginal ray");
    assert_rel(first.lagrange_invariant, 3.0 * 3.0 / focal, 1e-12, 0.0, "Lagrange invariant");
    // Objects by height; angles are those at the first vertex.
    let object = curves::object(&lens, lens.max_field_deg());
    assert_rel(object.position().expect("near").y, -3.0, 1e-12, 0.0, "height");
    assert_eq!(object, ObjectPoint::in_field(&lens, (3.0f64 / 60.0).atan(), std::f64::consts::FRAC_PI_2));
    let chief = Beam::new(&System::new(&lens, 587.5618), object, &[DVec2::ZERO]).chief.expect("lands");
    assert!((chief.at.y - 3.0 * focal / before).abs() < 0.05, "{}", chief.at.y);
    assert!(check(&lens).passes());
}

/// The aperture as a numerical aperture in object space is that of the ray to the stop's edge, and files of other programs say it.
#[test]
fn telecentric_lenses_are_written_and_read() {
    let lens = nearly(Side::Object, f64::INFINITY);
    let na = |lens: &Lens| {
        let slope = paraxial::marginal_height(lens, 587.5618) * lens.object_vergence;
        slope / slope.hypot(1.0)
    };
    let stated = lens.changed(|l| l.aperture = crate::lens::Aperture::ObjectNa(na(&lens))).expect("a lens");
    let (a, b) = (figures(&lens), figures(&stated));
    for ((what, a), (_, b)) in a.iter().zip(&b) {
        assert_rel(*b, *a, 1e-9, 1e-3, what);
    }
    let again = prescription::from_toml(&prescription::to_toml(&stated), "again.toml").expect("a lens");
    assert_eq!(again, stated);
    let glasses = crate::lens::catalogue::Glasses::shipped();
    for form in [interchange::Form::Zmx, interchange::Form::Seq] {
        let (text, _) = interchange::text_of(&stated, form, glasses).expect("written");
        let read = interchange::parse(&text, form, "again", glasses).expect("read").lens;
        for ((what, a), (_, b)) in a.iter().zip(figures(&read)) {
            assert_rel(b, *a, 1e-6, 1e-2, &format!("{form:?}: {what}"));
        }
    }
}
