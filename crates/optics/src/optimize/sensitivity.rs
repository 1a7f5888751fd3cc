//! What deviations of a lens's numbers cost: its residuals and their Jacobian, from one sweep of rays, and the rms that follows for any deviation.
//!
//! With residuals `r` (mm) and Jacobian `J`, a lens that deviates by `d` has the rms `|r + J d|`, exact to second order of its square in `d` but for what
//! the residuals' own second derivatives add. What compensators take up is projected out of both first: `|P (r + J d)|`, `P = I − Q Qᵀ` over their columns.

use super::merit::{Apertures, Merit};
use super::rays::Rays;
use super::residuals::{jacobian, residuals};
use crate::lens::variables::Variables;
use crate::lens::{Lens, Parameter};
use isoplanat_base::error::{Error, Result};

/// Residuals and their derivatives.
#[derive(Clone, Debug)]
pub struct Sensitivity {
    /// The numbers that deviate.
    pub parameters: Vec<Parameter>,
    residuals: Vec<f64>,
    /// By each number, per unit of it (mm, 1/mm, radians, …).
    columns: Vec<Vec<f64>>,
}

impl Sensitivity {
    /// Of `lens` by `parameters`.
    ///
    /// # Errors
    /// A merit that is none; a ray that fails.
    pub fn new(lens: &Lens, merit: &Merit, parameters: Vec<Parameter>) -> Result<Self> {
        merit.check(lens.file())?;
        let variables = Variables::new(lens, parameters);
        let failed = |f: crate::trace::Failure| {
            let found = format!("{} at surface {}", f.cause.name(), f.surface);
            Error::bad(lens.file(), "rays", found, "a lens whose stop all rays of its fields pass")
        };
        let clip = merit.apertures == Apertures::Stated;
        let (mut rays, mut traced) = Rays::new(merit, lens, &variables, 1.0, clip).map_err(failed)?;
        let slopes = rays.slopes(lens, &mut traced).map_err(failed)?;
        let all = jacobian(&rays, &traced, &slopes, variables.parameters.len());
        let column = |(k, scale): (usize, &f64)| all.column(k).iter().map(|v| v / scale).collect();
        let columns = variables.scales.iter().enumerate().map(column).collect();
        Ok(Self { residuals: residuals(&rays, &traced), columns, parameters: variables.parameters })
    }

    /// The same where compensators, numbers `by` of the list, are set to the least rms for every deviation.
    #[must_use]
    pub(crate) fn compensated(&self, by: &[usize]) -> Self {
        let mut out = self.clone();
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for k in by {
            let mut v = self.columns[*k].clone();
            let before = norm(&v);
            // Twice, so that what is left is orthogonal to rounding.
            for _ in 0..2 {
                basis.iter().for_each(|q| take_off(&mut v, q));
            }
            let length = norm(&v);
            if length > 1e-12 * before {
                v.iter_mut().for_each(|x| *x /= length);
                basis.push(v);
            }
        }
        for q in &basis {
            take_off(&mut out.residuals, q);
            out.columns.iter_mut().for_each(|c| take_off(c, q));
        }
        out
    }

    /// Numbers and how far they are off, by their place in [`Sensitivity::parameters`].
    pub fn indexed(&self, off: &[(Parameter, f64)]) -> Vec<(usize, f64)> {
        let index = |p: &Parameter| self.parameters.iter().position(|q| q == p).unwrap_or(0);
        off.iter().map(|(p, by)| (index(p), *by)).collect()
    }

    /// How far number `by` moves, in its own unit, to the least rms where others deviate, counted from where it stands at its own least rms without them.
    pub fn taken_up(&self, by: usize, moved: &[(usize, f64)]) -> f64 {
        let own = &self.columns[by];
        let along = |k: usize| self.columns[k].iter().zip(own).map(|(a, b)| a * b).sum::<f64>();
        let square = along(by);
        if square > 0.0 { -moved.iter().map(|(k, d)| d * along(*k)).sum::<f64>() / square } else { 0.0 }
    }

    /// The rms, mm, where numbers deviate: index of the number and by how much, in its own unit.
    pub fn rms(&self, moved: &[(usize, f64)]) -> f64 {
        let mut r = self.residuals.clone();
        for (k, by) in moved {
            r.iter_mut().zip(&self.columns[*k]).for_each(|(r, c)| *r += by * c);
        }
        norm(&r)
    }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Takes the part along the unit vector `q` off `v`.
fn take_off(v: &mut [f64], q: &[f64]) {
    let along: f64 = v.iter().zip(q).map(|(a, b)| a * b).sum();
    v.iter_mut().zip(q).for_each(|(a, b)| *a -= along * b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::pose::{Element, Pose};
    use crate::lens::{Kind, builtin};
    use crate::optimize::residuals_of;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    fn as_built() -> Lens {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        lens.changed(|l| {
            l.surfaces[2].pose = Some(Pose::default());
            l.elements = vec![Element { first: 0, last: 1, pose: Pose::default(), pivot: 0.0 }];
        })
        .expect("a lens")
    }

    /// Every kind of number that a maker may miss, tilts and decentres of surfaces and elements among them: columns against central differences of residuals
    /// that are traced anew, 1e-6 of the column.
    #[test]
    fn columns_agree_with_differences() {
        let lens = as_built();
        let merit = Merit { whole: true, rings: 2, arms: 3, ..Merit::default() };
        let numbers = vec![
            (Kind::Curvature.at(0), 1e-7),
            (Kind::Thickness.at(1), 1e-5),
            (Kind::Conic.at(3), 1e-4),
            (Kind::Tilt.at(2), 1e-6),
            (Kind::Tilt.entry(2, 1), 1e-6),
            (Kind::Decentre.at(2), 1e-5),
            (Kind::ElementTilt.at(0), 1e-6),
            (Kind::ElementDecentre.entry(0, 1), 1e-5),
        ];
        let found = Sensitivity::new(&lens, &merit, numbers.iter().map(|n| n.0).collect()).expect("traces");
        for (k, (p, h)) in numbers.into_iter().enumerate() {
            let at = |by: f64| {
                let moved = lens.changed(|l| p.kind.list_mut(l, p.of)[p.entry] += by).expect("a lens");
                residuals_of(&moved, &merit).expect("traces")
            };
            let (a, b) = (at(h), at(-h));
            let length = norm(&found.columns[k]);
            assert!(length > 0.0, "{p:?}");
            for ((a, b), c) in a.iter().zip(&b).zip(&found.columns[k]) {
                assert_abs((a - b) / (2.0 * h), *c, 1e-6 * length, &format!("{p:?}"));
            }
        }
    }

    /// A lens out of focus by little is in focus again where the sensor compensates, and the model says by how much it is worse where it does not.
    #[test]
    fn compensators_take_up_what_they_can() {
        let lens = as_built();
        let merit = Merit { whole: true, ..Merit::default() };
        let last = Kind::Thickness.at(lens.surfaces.len() - 1);
        let s = Sensitivity::new(&lens, &merit, vec![last, Kind::Thickness.at(1)]).expect("traces");
        let focused = s.compensated(&[0]);
        assert_rel(focused.rms(&[(0, 0.3)]), focused.rms(&[]), 1e-9, 0.0, "the compensator's own deviation");
        assert!(focused.rms(&[]) <= s.rms(&[]) && focused.rms(&[(1, 0.05)]) < s.rms(&[(1, 0.05)]));
        let back = s.taken_up(0, &[(1, 0.05)]);
        assert_rel(
            s.rms(&[(0, back), (1, 0.05)]).powi(2) - focused.rms(&[(1, 0.05)]).powi(2),
            s.rms(&[]).powi(2) - focused.rms(&[]).powi(2),
            1e-6,
            0.0,
            "refocused",
        );
        let moved = lens.changed(|l| l.surfaces[1].thickness += 0.01).expect("a lens");
        let traced = norm(&residuals_of(&moved, &merit).expect("traces"));
        assert_rel(s.rms(&[(1, 0.01)]), traced, 1e-3, 0.0, "the model");
    }
}
