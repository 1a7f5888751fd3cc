//! The paraxial exit pupil as the image sees it, with adjoint.
//!
//! A paraxial ray from the stop's centre arrives at the image plane with height `y` and `w = n'u`; it seems to come from
//! the axis at `−n'y/w` behind the image plane (negative: before it). Kept as the pair `(y, w)`, so that a telecentric
//! lens (`w = 0`) is no special case. Tilts and freeform terms are left out.

use super::{System, SystemGradient};

/// The ray from the stop's centre at the image plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExitPupil {
    /// Height, mm, for `w = 1` in the stop.
    pub y: f64,
    /// Index times slope.
    pub w: f64,
}

/// States `(y, w)` behind each surface from the stop to the image plane.
fn sweep(system: &System) -> Vec<[f64; 2]> {
    let (mut y, mut w) = (0.0, 1.0);
    let mut states = vec![[y, w]];
    for i in system.stop + 1..system.surfaces.len() {
        let s = &system.surfaces[i];
        y += s.distance / s.index_before * w;
        w -= s.shape.deflection(y, s.index_before, s.index_after);
        states.push([y, w]);
    }
    states
}

/// The exit pupil of `system`.
pub(crate) fn exit_pupil(system: &System) -> ExitPupil {
    let [y, w] = sweep(system)[system.image() - system.stop];
    ExitPupil { y, w }
}

/// Pulls a cotangent on [`exit_pupil`] back to the system (added to `out`).
pub(crate) fn exit_pupil_vjp(system: &System, bar: &ExitPupil, out: &mut SystemGradient) {
    let states = sweep(system);
    let ExitPupil { y: mut y_bar, w: mut w_bar } = *bar;
    for i in (system.stop + 1..system.surfaces.len()).rev() {
        let s = &system.surfaces[i];
        let [_, w_in] = states[i - 1 - system.stop];
        let [y, _] = states[i - system.stop];
        let (n, n1) = (s.index_before, s.index_after);
        let by_index = s.shape.power_vjp(n, n1, -w_bar * y, &mut out.shapes[i]);
        out.indices[i] += by_index[0];
        out.indices[i + 1] += by_index[1];
        y_bar -= s.shape.deflection(w_bar, n, n1);
        out.distances[i] += y_bar * w_in / n;
        out.indices[i] -= y_bar * s.distance * w_in / (n * n);
        w_bar += y_bar * s.distance / n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{LensGradient, builtin, paraxial, variables::Variables};
    use isoplanat_base::testing::{assert_rel, central_difference};

    #[test]
    fn exit_pupil_agrees_with_first_order_data() {
        for name in ["two_element", "cooke_triplet", "double_gauss", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let nm = lens.wavelengths.primary_nm;
            let system = System::new(&lens, nm);
            let p = exit_pupil(&system);
            let behind_last =
                -system.surfaces[system.image()].index_before * p.y / p.w + system.surfaces[system.image()].distance;
            let expected = paraxial::first_order(&lens, nm).exit_pupil_position;
            assert_rel(behind_last, expected, 1e-10, 1.0, name);
        }
    }

    #[test]
    fn exit_pupil_vjp_agrees_with_differences() {
        for name in ["two_element", "double_gauss", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let system = System::new(&lens, 550.0);
            let mut out = SystemGradient::zeros(&system);
            exit_pupil_vjp(&system, &ExitPupil { y: 0.3, w: -20.0 }, &mut out);
            let mut g = LensGradient::zeros(&lens);
            out.add_to(&lens, 550.0, &mut g);
            let variables = Variables::all(&lens);
            let (x, g) = (variables.values(&lens), variables.gradient(&g));
            let rng = &mut fastrand::Rng::with_seed(6);
            for _ in 0..4 {
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    let p = exit_pupil(&System::new(&variables.lens(&lens, &moved).expect("a lens"), 550.0));
                    0.3 * p.y - 20.0 * p.w
                };
                let pulled: f64 = g.iter().zip(&dx).map(|(a, b)| a * b).sum();
                assert_rel(pulled, central_difference(f, 1e-4), 1e-8, 1e-2, name);
            }
        }
    }
}
