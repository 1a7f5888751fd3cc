//! Numbers and names as sheets print them. What is not stated is a dash.

use crate::report::table::significant;
use isoplanat_optics::analysis::fabrication::face::{Bend, Face};
use isoplanat_optics::analysis::fabrication::tolerances::OfSurface;

/// What stands where nothing is stated.
pub(super) const NOT_STATED: &str = "–";

/// With so many places behind the point, and no minus before zeros.
pub(super) fn fixed(x: f64, places: usize) -> String {
    let text = format!("{x:.places$}");
    if text.starts_with('-') && text.bytes().all(|b| b"-0.".contains(&b)) { text[1..].to_owned() } else { text }
}

/// A number, or a dash.
pub(super) fn number(x: Option<f64>, digits: usize) -> String {
    x.filter(|x| x.is_finite()).map_or_else(|| NOT_STATED.to_owned(), |x| significant(x, digits))
}

/// A radius, mm; a plane is `∞`.
pub(super) fn radius(r: Option<f64>) -> String {
    r.map_or_else(|| "∞".to_owned(), |r| significant(r, 8))
}

/// `±x unit`, or a dash.
pub(super) fn tolerance(x: Option<f64>, unit: &str) -> String {
    x.map_or_else(|| NOT_STATED.to_owned(), |x| format!("±{}{unit}", significant(x, 4)))
}

/// A text behind its code, such as `5/ 5×0.16`; a dash where it is not stated.
pub(super) fn indication(code: &str, text: Option<String>) -> String {
    format!("{code} {}", text.unwrap_or_else(|| NOT_STATED.to_owned()))
}

/// 3/ A(B/C) of ISO 10110-5: a radius that is stated otherwise has a dash in the place of A.
pub(super) fn form_indication(t: &OfSurface) -> String {
    let text = |x: Option<f64>| number(x, 4);
    let (a, b, c) = (t.radius_fringes, t.irregularity_fringes, t.rotational_fringes);
    let behind = match (b, c) {
        (None, None) => String::new(),
        (b, None) => format!("({})", text(b)),
        (b, c) => format!("({}/{})", text(b), text(c)),
    };
    format!("3/ {}{behind}", text(a))
}

/// A tolerance of the radius in mm, per cent and fringes of `nm`, however it is stated; none where it is not, or where there is no radius.
pub(super) fn radius_tolerances(face: &Face, t: &OfSurface, nm: Option<f64>) -> [Option<f64>; 3] {
    // A plane has no radius to be a per cent of.
    let Some(r) = face.radius_mm else { return [None, None, t.radius_fringes] };
    // A fringe is half a wavelength of sag at the rim of the clear aperture; nm to mm. By first differences of the curvature.
    let fringe = nm.map(|nm| 0.5e-6 * nm / face.edge_sag_by_curvature().abs());
    let curvature = match (t.radius_percent, t.radius_fringes) {
        (Some(percent), _) => Some(0.01 * percent / r.abs()),
        (None, fringes) => fringes.zip(fringe).map(|(n, each)| n * each),
    };
    let of = |c: f64| [Some(c * r * r), Some(100.0 * c * r.abs()), fringe.map(|each| c / each)];
    curvature.map_or([None; 3], of).map(|x| x.filter(|x| x.is_finite()))
}

/// What a face is: its kind, and convex or concave from each side that has glass.
pub(super) fn form(face: &Face) -> String {
    let kind = match (face.curvature_per_mm == 0.0, face.conic == 0.0, face.asphere.is_empty()) {
        (true, _, true) => return "plane".to_owned(),
        (false, true, true) => "sphere",
        (false, false, true) => "conic",
        _ => "asphere",
    };
    let codes: Vec<&str> = [face.bend_before, face.bend_behind].into_iter().flatten().map(Bend::code).collect();
    // A gull wing bends back: its rim lies on the other side of the vertex.
    let back = if face.edge_sag_mm * face.vertex_curvature_per_mm < 0.0 { " at the vertex, rim bent back" } else { "" };
    format!("{kind}, {}{back}", codes.join(" / "))
}

/// A power as a superscript.
pub(super) fn superscript(n: i32) -> String {
    let digit = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        c => c.to_digit(10).and_then(|d| char::from_u32(0x2070 + d)).unwrap_or(c),
    };
    n.to_string().chars().map(digit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::lens::{Medium, Shape, Surface};

    #[test]
    fn indications_have_dashes_where_nothing_is_stated() {
        let t = OfSurface::default();
        assert_eq!(form_indication(&t), "3/ –");
        assert_eq!(form_indication(&OfSurface { irregularity_fringes: Some(0.5), ..t.clone() }), "3/ –(0.5)");
        let both = OfSurface { radius_fringes: Some(3.0), rotational_fringes: Some(0.25), ..t };
        assert_eq!(form_indication(&both), "3/ 3(–/0.25)");
        assert_eq!(indication("5/", None), "5/ –");
        assert_eq!(tolerance(Some(0.05), " mm"), "±0.05 mm");
        assert_eq!([fixed(-1e-9, 3), fixed(-0.5, 3)], ["0.000", "-0.500"]);
        assert_eq!(superscript(-13), "⁻¹³");
        assert_eq!(superscript(4), "⁴");
    }

    /// Fringes of power and the radius that they stand for, by differences of the sag itself.
    #[test]
    fn fringes_are_half_waves_of_sag_at_the_rim() {
        let shape = Shape::sphere(1.0 / 40.0);
        let surface = Surface { shape, thickness: 1.0, medium: Medium::Air, semi_diameter: 8.0, pose: None };
        let face = Face::new(0, &surface, [false, true]);
        let t = OfSurface { radius_fringes: Some(4.0), ..OfSurface::default() };
        let [mm, percent, fringes] = radius_tolerances(&face, &t, Some(632.8)).map(|x| x.expect("known"));
        let sag = |r: f64| r - (r * r - 64.0).sqrt();
        let moved = (sag(40.0) - sag(40.0 + mm)).abs();
        assert!((moved / (4.0 * 0.5 * 632.8e-6) - 1.0).abs() < 0.01, "{mm}: {moved}");
        assert!((fringes - 4.0).abs() < 1e-12 && (percent - mm / 0.4).abs() < 1e-12);
        let back = OfSurface { radius_percent: Some(percent), ..OfSurface::default() };
        assert!((radius_tolerances(&face, &back, Some(632.8))[2].expect("known") - 4.0).abs() < 1e-12);
        assert_eq!(radius_tolerances(&face, &back, None)[2], None);
        assert_eq!(radius_tolerances(&face, &OfSurface::default(), Some(632.8)), [None; 3]);
    }
}
