//! What keeps a lens buildable while it moves: focal length, centre and edge thickness, air gaps, sensor clearance.
//!
//! Each is a squared penalty `w·v²` with `v` the relative (focal length) or absolute violation in mm. Ray failures are
//! not a penalty: a step whose rays fail is taken back ([`super`]).

use serde::{Deserialize, Serialize};

use isoplanat_optics::lens::{Lens, LensGradient, paraxial};

/// Bounds, mm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Constraints {
    /// Effective focal length to keep, mm.
    pub focal_length_mm: f64,
    /// Smallest glass thickness on the axis, mm.
    pub min_centre_mm: f64,
    /// Smallest glass thickness at the clear semi-diameters, mm.
    pub min_edge_mm: f64,
    /// Smallest air gap, on the axis and at the edge, mm.
    pub min_gap_mm: f64,
    /// Smallest distance of the last vertex from the sensor, mm.
    pub min_back_mm: f64,
    /// Largest conic part of the aperture: `α R²` stays below this (1 is the conic's own edge).
    pub max_reach: f64,
}

impl Constraints {
    /// Bounds for `lens` as it stands: its own focal length, 1 mm of glass, 0.1 mm of air.
    pub(crate) fn of(lens: &Lens) -> Self {
        let p = paraxial::first_order(lens, lens.wavelengths.primary_nm);
        Self {
            focal_length_mm: p.effective_focal_length,
            min_centre_mm: 1.5,
            min_edge_mm: 1.0,
            min_gap_mm: 0.1,
            min_back_mm: 5.0,
            max_reach: 0.8,
        }
    }

    /// Penalty of `lens`, its gradient added to `gradient`.
    pub(crate) fn penalty(&self, lens: &Lens, gradient: &mut LensGradient) -> f64 {
        let nm = lens.wavelengths.primary_nm;
        let mut total = 0.0;
        // Focal length: 1 % off costs 0.01.
        const FOCAL_WEIGHT: f64 = 100.0;
        let efl = paraxial::first_order(lens, nm).effective_focal_length;
        let v = (efl - self.focal_length_mm) / self.focal_length_mm;
        total += FOCAL_WEIGHT * v * v;
        paraxial::first_order_vjp(lens, nm, 2.0 * FOCAL_WEIGHT * v / self.focal_length_mm, 0.0, gradient);
        let n = lens.indices(nm);
        let last = lens.surfaces.len() - 1;
        for i in 0..=last {
            let glass = n[i + 1] > 1.0;
            let (axis_min, edge_min) = if i == last {
                (self.min_back_mm, f64::NEG_INFINITY)
            } else if glass {
                (self.min_centre_mm, self.min_edge_mm)
            } else {
                (self.min_gap_mm, self.min_gap_mm)
            };
            // On the axis.
            let t = lens.surfaces[i].thickness;
            let v = (axis_min - t).max(0.0);
            total += v * v;
            gradient.surfaces[i].thickness -= 2.0 * v;
            // At the smaller clear semi-diameter of the two surfaces.
            if i < last {
                let r = lens.surfaces[i].semi_diameter.min(lens.surfaces[i + 1].semi_diameter);
                let rho = r * r;
                if let (Some(a), Some(b)) = (lens.surfaces[i].shape.sag(rho), lens.surfaces[i + 1].shape.sag(rho)) {
                    let v = (edge_min - (t + b.h - a.h)).max(0.0);
                    total += v * v;
                    let bar = -2.0 * v;
                    gradient.surfaces[i].thickness += bar;
                    lens.surfaces[i].shape.sag_vjp(rho, &a, -bar, 0.0, &mut gradient.surfaces[i].shape);
                    lens.surfaces[i + 1].shape.sag_vjp(rho, &b, bar, 0.0, &mut gradient.surfaces[i + 1].shape);
                }
            }
            // The conic reaches beyond the clear aperture: αR² ≤ max_reach.
            let s = &lens.surfaces[i];
            let (c, k, rho) = (s.shape.curvature, s.shape.conic, s.semi_diameter.powi(2));
            let v = ((1.0 + k) * c * c * rho - self.max_reach).max(0.0);
            total += v * v;
            gradient.surfaces[i].shape.curvature += 2.0 * v * 2.0 * (1.0 + k) * c * rho;
            gradient.surfaces[i].shape.conic += 2.0 * v * c * c * rho;
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};
    use isoplanat_optics::lens::{builtin, variables::Variables};

    #[test]
    fn penalty_gradient_agrees_with_differences() {
        let lens = builtin::lens("three_element").expect("shipped");
        // Bounds that every kind of violation meets.
        let c = Constraints {
            focal_length_mm: 47.0,
            min_centre_mm: 3.0,
            min_edge_mm: 4.0,
            min_gap_mm: 3.5,
            min_back_mm: 40.0,
            max_reach: 0.1,
        };
        let vars = Variables::all(&lens);
        let x = vars.values(&lens);
        let mut g = LensGradient::zeros(&lens);
        assert!(c.penalty(&lens, &mut g) > 0.0);
        let gradient = vars.gradient(&g);
        for seed in 0..5 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
            let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
            let f = |h: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                let l = vars.lens(&lens, &moved).expect("a lens");
                c.penalty(&l, &mut LensGradient::zeros(&l))
            };
            assert_rel(pulled, central_difference(f, 1e-6), 1e-7, 1e-3, &format!("seed {seed}"));
        }
    }
}
