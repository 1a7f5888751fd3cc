//! Light that surfaces scatter because of how they were polished and what mars them: the share that a picture has as haze.
//!
//! A face between indices `n` and `n'` with roughness `σ` (Rq) scatters `1 − exp(−(2π (n' − n) σ / λ)²)` of what passes it, at normal incidence (total
//! integrated scatter: Bennett and Porteus, JOSA 51, 1961, for transmission). Imperfections `N×A` of ISO 10110-7 cover `N A²` of its clear aperture, and all light on
//! them is taken for scattered: that of a beam that fills it. The whole, `1 − Π (1 − s)`, is about the light that is there for a capture's veiling glare: some of
//! it stays near the image, some goes into the barrel. Light that meets a face at a slant is scattered more (twice as much at 60° in glass of 1.5), and
//! reflections between faces are not in it.

use std::f64::consts::PI;

use serde::Serialize;

use super::fabrication::Fabrication;
use super::fabrication::tolerances::{Tolerances, parts};
use crate::lens::Lens;

/// What one face scatters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OfFace {
    /// Its surface.
    pub surface: usize,
    /// Share that its roughness scatters, by wavelength; none where no roughness is stated.
    pub roughness: Option<Vec<f64>>,
    /// Share of its clear aperture that imperfections cover; none where none are stated.
    pub imperfections: Option<f64>,
}

/// What a lens scatters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scatter {
    /// Wavelengths, nm.
    pub wavelengths_nm: Vec<f64>,
    /// Faces of which something is stated.
    pub faces: Vec<OfFace>,
    /// Share of the light of each wavelength that all of them scatter.
    pub share: Vec<f64>,
}

/// The share that one passage through a face scatters.
fn rough(step: f64, rq_nm: f64, nm: f64) -> f64 {
    -(-(2.0 * PI * step * rq_nm / nm).powi(2)).exp_m1()
}

impl Scatter {
    /// Of `lens`, made as `tolerances` state; none where they say nothing of roughness and imperfections.
    pub fn new(lens: &Lens, made: &Fabrication, tolerances: &Tolerances) -> Option<Self> {
        let wavelengths_nm = lens.wavelengths.nm.clone();
        let indices: Vec<Vec<f64>> = wavelengths_nm.iter().map(|nm| lens.indices(*nm)).collect();
        let mut faces = Vec::new();
        let mut left = vec![1.0; wavelengths_nm.len()];
        for (_, face) in made.faces() {
            let (surface, stated) = (face.surface, tolerances.surface(face.surface));
            let of = |rq: f64| -> Vec<f64> {
                let step = |n: &Vec<f64>| n[surface + 1] - n[surface];
                wavelengths_nm.iter().zip(&indices).map(|(nm, n)| rough(step(n), rq, *nm)).collect()
            };
            let roughness = stated.roughness_nm.map(of);
            let area = PI * face.clear_mm().powi(2);
            let imperfections =
                stated.imperfections.as_deref().and_then(parts).map(|(n, a)| (n * a * a / area).min(1.0));
            if roughness.is_none() && imperfections.is_none() {
                continue;
            }
            for (k, left) in left.iter_mut().enumerate() {
                *left *= (1.0 - roughness.as_ref().map_or(0.0, |s| s[k])) * (1.0 - imperfections.unwrap_or(0.0));
            }
            faces.push(OfFace { surface, roughness, imperfections });
        }
        let share = left.into_iter().map(|l| 1.0 - l).collect();
        (!faces.is_empty()).then_some(Self { wavelengths_nm, faces, share })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use isoplanat_base::testing::assert_rel;

    /// Two faces of one glass against the formula by hand, imperfections by their area, nothing where nothing is stated.
    #[test]
    fn shares_are_those_of_the_formulas() {
        let lens = builtin::lens("al2550_a").expect("shipped");
        let scatter = |text: &str| {
            let tolerances = Tolerances::parse(text, "t.toml").expect("reads");
            let made = Fabrication::new(&lens, &tolerances, None).expect("made");
            Scatter::new(&lens, &made, &tolerances)
        };
        assert_eq!(scatter("schema = 1\n[surface.all]\nradius_percent = 0.1\n"), None);
        let found = scatter("schema = 1\n[surface.all]\nroughness_nm = 5\n").expect("rough");
        assert_eq!(found.faces.len(), 2);
        for (k, nm) in lens.wavelengths.nm.iter().enumerate() {
            let n = lens.indices(*nm).into_iter().fold(1.0f64, f64::max);
            let one = 1.0 - (-(2.0 * PI * (n - 1.0) * 5.0 / nm).powi(2)).exp();
            for face in &found.faces {
                assert_rel(face.roughness.as_ref().expect("rough")[k], one, 1e-9, 0.0, "a face");
            }
            assert_rel(found.share[k], 1.0 - (1.0 - one).powi(2), 1e-9, 0.0, "both");
        }
        // 5 nm on PMMA or crown scatter some 0.1 %, more in the blue.
        assert!(found.share.iter().all(|s| (5e-4..5e-3).contains(s)), "{:?}", found.share);
        let marred = scatter("schema = 1\n[surface.all]\nimperfections = \"5×0.16\"\n").expect("marred");
        let tolerances = Tolerances::default();
        let made = Fabrication::new(&lens, &tolerances, None).expect("made");
        for (face, (_, own)) in marred.faces.iter().zip(made.faces()) {
            let share = 5.0 * 0.16 * 0.16 / (PI * 0.25 * own.clear_diameter_mm.powi(2));
            assert_rel(face.imperfections.expect("marred"), share, 1e-12, 0.0, "by area");
        }
        // Cemented faces step by the difference of two glasses: a tenth of a face in air, a hundredth of its scatter.
        let doublet = builtin::lens("ac254_050_a").expect("shipped");
        let rough = Tolerances::parse("schema = 1\n[surface.all]\nroughness_nm = 5\n", "t.toml").expect("reads");
        let made = Fabrication::new(&doublet, &rough, None).expect("made");
        let shares = Scatter::new(&doublet, &made, &rough).expect("rough");
        assert_eq!(shares.faces.len(), 3);
        let [front, cemented, rear] = [0, 1, 2].map(|k| shares.faces[k].roughness.as_ref().expect("rough")[0]);
        assert!(cemented < 0.1 * front && front < rear && cemented > 0.0, "{front} {cemented} {rear}");
        assert!(marred.share.windows(2).all(|s| s[0] == s[1]), "of every colour alike");
    }
}
