//! The lenses shipped in `models/lenses/`, compiled in so that every command works without files.

use super::{Lens, prescription};
use isoplanat_base::error::{Error, Result};

pub use isoplanat_models::LENSES;

/// The TOML text of a shipped lens by name.
///
/// # Errors
/// A name that is none; those that are are listed.
pub fn text(name: &str) -> Result<&'static str> {
    let Some((_, text)) = LENSES.iter().find(|(n, _)| *n == name) else {
        let known: Vec<&str> = LENSES.iter().map(|(n, _)| *n).collect();
        return Err(Error::bad("built-in lens", "name", format!("`{name}`"), format!("one of {}", known.join(", "))));
    };
    Ok(text)
}

/// A shipped lens by name.
///
/// # Errors
/// As [`text`].
pub fn lens(name: &str) -> Result<Lens> {
    prescription::from_toml(text(name)?, name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::paraxial;
    use isoplanat_base::testing::assert_abs;

    /// Published focal lengths (mm) of the shipped lenses, and the round trip through the TOML form.
    #[test]
    fn shipped_lenses_load_and_have_their_published_focal_lengths() {
        let published = [
            ("two_element", 49.999, 2e-3),
            ("three_element", 50.005, 2e-3),
            ("cooke_triplet", 50.021_350_719_4, 1e-6),
            ("double_gauss", 27.442_734_010_6, 1e-6),
            ("al2550_a", 50.0016 * 0.511_183_3 / 0.5168, 1e-2),
            ("ac254_050_a", 50.0, 0.5),
            ("aca254_050_a_surrogate", 50.0, 1e-4),
            ("petzval", 100.0, 0.03),
            ("telephoto", 5.0 * 25.4, 0.02),
            ("tessar", 50.0, 0.006),
            ("retrofocus", 35.0, 0.001),
            ("heliar", 100.0, 0.12),
            ("sonnar", 50.0, 0.013),
            ("biotar", 50.0, 0.046),
            ("wide_angle", 100.0, 0.09),
            ("hologon", 15.0, 0.001),
        ];
        for (name, efl, tol) in published {
            let l = lens(name).expect(name);
            let p = paraxial::first_order(&l, l.wavelengths.primary_nm);
            assert_abs(p.effective_focal_length, efl, tol, name);
            let text = prescription::to_toml(&l);
            assert_eq!(prescription::from_toml(&text, "again").expect("round trip"), l, "{name}");
        }
        lens("phone").expect("phone");
        let known = |name: &str| published.iter().any(|(n, ..)| *n == name) || ["phone", "landscape"].contains(&name);
        assert!(LENSES.iter().all(|(name, _)| known(name)), "a focal length for every lens");
    }

    /// The landscape lens has a focal length of 10 mm at its own reference wavelength; of three others the back focal length is known.
    #[test]
    fn shipped_lenses_have_their_other_published_numbers() {
        let of = |name: &str, nm: f64| paraxial::first_order(&lens(name).expect(name), nm);
        assert_abs(of("landscape", 550.0).effective_focal_length, 10.0, 1e-6, "landscape");
        assert_abs(of("landscape", 550.0).back_focal_length, 10.150_245, 1e-6, "landscape");
        for (name, bfl, tol) in
            [("retrofocus", 35.0 * 1.0493, 4e-3), ("petzval", 56.5, 6e-3), ("hologon", 15.0 * 0.3030, 2e-3)]
        {
            assert_abs(of(name, 587.5618).back_focal_length, bfl, tol, name);
        }
    }
}
