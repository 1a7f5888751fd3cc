//! Third-order aberration sums (W. T. Welford, *Aberrations of Optical Systems*, 1986, ch. 8), mm.
//!
//! With the marginal ray `(y, u)`, the chief ray `(ȳ, ū)` of the largest field, `A = n(u + yc)`, `Ā = n(ū + ȳc)`,
//! `H = Aȳ − Āy` and `Δ` the change across a surface:
//!
//! `S_I = −A² y Δ(u/n)`, `S_II = −AĀ y Δ(u/n)`, `S_III = −Ā² y Δ(u/n)`, `S_IV = −H² c Δ(1/n)`,
//! `S_V = −Ā³ y Δ(1/n²) + Āȳ(Āy − H) c Δ(1/n)`, `C_I = A y Δ(δn/n)`, `C_II = Ā y Δ(δn/n)`.
//!
//! A surface's departure from the sphere of its vertex curvature, `G ρ²/8Δn` in sag, adds `G (y⁴, y³ȳ, y²ȳ², 0, yȳ³)`;
//! an `r²` term belongs to the vertex curvature. `S_V` is written without the usual division by `A`.
//! `C_I` and `C_II` belong to the lens: `δn` is the index at the shortest less that at the longest of its own wavelengths
//! that have a weight, rays and indices are those of its primary wavelength, whatever wavelength the other sums are taken at. A lens
//! of one wavelength has no colour, and sums of 0.
//! Not covered: orders above the third, tilted surfaces.

use serde::Serialize;

use super::{Lens, paraxial};

/// The sums of one surface or of a whole lens, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Seidel {
    /// `S_I`: positive where the rim focuses short.
    pub spherical: f64,
    /// `S_II`.
    pub coma: f64,
    /// `S_III`.
    pub astigmatism: f64,
    /// `S_IV`: Petzval curvature.
    pub petzval: f64,
    /// `S_V`: positive for barrel distortion.
    pub distortion: f64,
    /// `C_I` between the shortest and the longest of the lens's wavelengths ([`super::Wavelengths::ends_nm`]).
    pub axial_colour: f64,
    /// `C_II`.
    pub lateral_colour: f64,
}

impl Seidel {
    /// The seven numbers in the order of the fields.
    pub fn to_array(self) -> [f64; 7] {
        let Self { spherical, coma, astigmatism, petzval, distortion, axial_colour, lateral_colour } = self;
        [spherical, coma, astigmatism, petzval, distortion, axial_colour, lateral_colour]
    }
}

/// One entry per surface, at `nm` (colour: of the lens's own wavelengths), for the lens's own object distance, aperture and
/// largest field.
pub fn per_surface(lens: &Lens, nm: f64) -> Vec<Seidel> {
    let mut sums = at(lens, nm);
    if nm != lens.wavelengths.primary_nm {
        for (sums, own) in sums.iter_mut().zip(at(lens, lens.wavelengths.primary_nm)) {
            (sums.axial_colour, sums.lateral_colour) = (own.axial_colour, own.lateral_colour);
        }
    }
    sums
}

/// All sums with rays and indices at `nm`.
fn at(lens: &Lens, nm: f64) -> Vec<Seidel> {
    let n = lens.indices(nm);
    let [short, long] = lens.wavelengths.ends_nm();
    let dispersion: Vec<f64> = lens.indices(short).iter().zip(lens.indices(long)).map(|(f, c)| f - c).collect();
    // Both rays at the first vertex: the marginal one from the axial object point, the chief one through the pupil.
    let v = lens.object_vergence;
    let mut y = paraxial::marginal_height(lens, nm);
    let mut u = v * y;
    let slope = lens.max_field_deg().to_radians().tan() * paraxial::field_origin(lens).object_slope();
    let [mut y_chief, mut u_chief] = paraxial::chief_ray(lens, nm, slope);
    let mut sums = Vec::with_capacity(lens.surfaces.len());
    for (i, s) in lens.surfaces.iter().enumerate() {
        let (before, after) = (n[i], n[i + 1]);
        let c = s.shape.vertex_curvature();
        let refracted = |y: f64, u: f64| (before * u - s.shape.deflection(y, before, after)) / after;
        let (u_after, u_chief_after) = (refracted(y, u), refracted(y_chief, u_chief));
        let (a, a_chief) = (before * (u + y * c), before * (u_chief + y_chief * c));
        let lagrange = a * y_chief - a_chief * y;
        let change = u_after / after - u / before;
        let (inverse, inverse_square) = (1.0 / after - 1.0 / before, after.powi(-2) - before.powi(-2));
        let colour = dispersion[i + 1] / after - dispersion[i] / before;
        // Fourth-order sag beyond the vertex sphere's c³/8.
        let quartic = s.shape.quartic() - c.powi(3) / 8.0;
        let g = 8.0 * quartic * (after - before);
        let own = Seidel {
            spherical: -a * a * y * change + g * y.powi(4),
            coma: -a * a_chief * y * change + g * y.powi(3) * y_chief,
            astigmatism: -a_chief * a_chief * y * change + g * (y * y_chief).powi(2),
            petzval: -lagrange * lagrange * c * inverse,
            distortion: -a_chief.powi(3) * y * inverse_square
                + a_chief * y_chief * (a_chief * y - lagrange) * c * inverse
                + g * y * y_chief.powi(3),
            axial_colour: a * y * colour,
            lateral_colour: a_chief * y * colour,
        };
        // An ideal lens has no aberration.
        sums.push(if s.shape.ideal.is_some() { Seidel::default() } else { own });
        (u, u_chief) = (u_after, u_chief_after);
        y += s.thickness * u;
        y_chief += s.thickness * u_chief;
    }
    sums
}

/// The sums over all surfaces.
pub fn total(per_surface: &[Seidel]) -> Seidel {
    per_surface.iter().fold(Seidel::default(), |a, b| Seidel {
        spherical: a.spherical + b.spherical,
        coma: a.coma + b.coma,
        astigmatism: a.astigmatism + b.astigmatism,
        petzval: a.petzval + b.petzval,
        distortion: a.distortion + b.distortion,
        axial_colour: a.axial_colour + b.axial_colour,
        lateral_colour: a.lateral_colour + b.lateral_colour,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Aperture, Field, Lens, Medium, Prescription, Shape, Surface, Wavelengths, builtin, unchecked};
    use isoplanat_base::testing::{assert_abs, assert_rel, shared};

    fn number(v: &serde_json::Value) -> f64 {
        v.as_f64().unwrap_or_else(|| v.as_str().expect("number").parse().expect("number"))
    }

    /// The lens of a golden file at its second wavelength.
    fn golden_lens(golden: &serde_json::Value) -> Lens {
        let list = |v: &serde_json::Value| v.as_array().expect("list").clone();
        let surfaces = list(&golden["surfaces"])
            .iter()
            .map(|s| Surface {
                shape: Shape::even(
                    number(&s["curvature"]),
                    number(&s["conic"]),
                    list(&s["coeffs"]).iter().map(number).collect(),
                ),
                pose: None,
                thickness: number(&s["thickness"]),
                medium: Medium::Table { wavelength_nm: vec![587.5618], index: vec![number(&s["index_after"][1])] },
                semi_diameter: 100.0,
            })
            .collect();
        // Rims far beyond the beam cross.
        unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |lens| {
            lens.surfaces = surfaces;
            lens.stop = usize::try_from(golden["stop_index"].as_u64().expect("index")).expect("small");
            lens.aperture = Aperture::EntrancePupilDiameter(number(&golden["entrance_pupil_diameter"]));
            lens.object_vergence = 0.0;
            lens.field = Field::Angle(list(&golden["fields_deg"]).iter().map(number).fold(0.0, f64::max));
        })
    }

    /// Sums of five lenses, a strong asphere among them, against an independent high-precision computation.
    #[test]
    fn sums_agree_with_the_reference() {
        for name in ["singlet_la1131", "achromat_laikin", "cooke_triplet", "double_gauss_us2532751", "asphere_acl5040u"]
        {
            let Some(path) = shared(&format!("golden/{name}.json")) else { return };
            let golden: serde_json::Value =
                serde_json::from_slice(&std::fs::read(path).expect("readable")).expect("JSON");
            let lens = golden_lens(&golden);
            let sums = per_surface(&lens, 587.5618);
            let largest = sums.iter().flat_map(|s| s.to_array()).fold(0.0, |m: f64, x| m.max(x.abs()));
            let expected = golden["seidel"]["reference_SI_SV"].as_array().expect("list");
            for (k, (a, b)) in total(&sums).to_array().iter().zip(expected).enumerate() {
                assert_abs(*a, number(b), 1e-13 * largest, &format!("{name} S{}", k + 1));
            }
            let (f, reference) =
                (paraxial::first_order(&lens, 587.5618), &golden["paraxial_d_line"]["reference_40digit"]);
            for (key, value) in [
                ("efl", f.effective_focal_length),
                ("bfl", f.back_focal_length),
                ("fno", f.f_number),
                ("entrance_pupil_from_first_vertex", f.entrance_pupil_position),
                ("exit_pupil_from_last_vertex", f.exit_pupil_position),
            ] {
                let expected = number(&reference[key]);
                assert_rel(value, expected, 1e-12, 1e-3 * f.effective_focal_length.abs(), &format!("{name} {key}"));
            }
        }
    }

    /// The Cooke triplet for other light.
    fn coloured(nm: &[f64], weights: &[f64]) -> Lens {
        let light = |l: &mut Prescription| (l.wavelengths.nm, l.wavelengths.weights) = (nm.to_vec(), weights.to_vec());
        builtin::lens("cooke_triplet").and_then(|l| l.changed(light)).expect("a lens")
    }

    /// Colour sums against the paraxial image of the extreme wavelengths: `δl' n'u'² = −C_I` to first order.
    #[test]
    fn axial_colour_is_the_shift_of_the_paraxial_image() {
        // Small dispersion, so that the first order is all there is.
        let lens = coloured(&[587.0, 588.0], &[1.0; 2]);
        let sums = total(&per_surface(&lens, 587.5));
        let first = paraxial::first_order(&lens, 587.5);
        let image = |nm: f64| paraxial::first_order(&lens, nm).paraxial_image_distance;
        let u = 0.5 * first.entrance_pupil_diameter / first.effective_focal_length;
        assert_rel((image(588.0) - image(587.0)) * u * u, sums.axial_colour, 1e-4, 0.0, "C_I");
    }

    /// At any wavelength of the other sums colour is the lens's own; those move.
    #[test]
    fn colour_sums_are_of_the_lenses_own_colours_at_any_wavelength() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let sums_at = |lens: &Lens, nm: f64| total(&per_surface(lens, nm));
        let reference = sums_at(&lens, 587.5618);
        assert_abs(reference.axial_colour, 0.80e-3, 0.005e-3, "C_I");
        for nm in [400.0, 486.1327, 700.0, 900.0] {
            let sums = sums_at(&lens, nm);
            assert_eq!(sums.axial_colour, reference.axial_colour, "C_I at {nm}");
            assert_eq!(sums.lateral_colour, reference.lateral_colour, "C_II at {nm}");
            assert!((sums.spherical / reference.spherical - 1.0).abs() > 1e-3, "S_I at {nm}");
        }
        // A wavelength without weight is none of the lens's colours; one colour has no dispersion.
        let Wavelengths { nm, weights, .. } = &lens.wavelengths;
        let other = coloured(&[&nm[..], &[900.0]].concat(), &[&weights[..], &[0.0]].concat());
        assert_eq!(sums_at(&other, 587.5618), reference);
        assert_eq!(sums_at(&coloured(&[587.5618], &[1.0]), 900.0).axial_colour, 0.0);
    }
}
