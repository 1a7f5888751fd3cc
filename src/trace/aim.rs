//! Rays aimed at a point of the real stop, with the implicit derivative of the aiming.
//!
//! Newton on the point `e` of the first vertex plane: `S(e) = s`, with the Jacobian from the trace's own pull-back,
//! started from the paraxial entrance pupil and, where that fails, continued from the axis in steps of field.
//! At the solution `δe = −S_e⁻¹ (S_θ δθ)`: [`aim_vjp`].

use glam::{DMat2, DVec2, DVec3};

use super::launch::{FieldPoint, launch, launch_vjp};
use super::sequential::{Hit, HitBar, trace, trace_vjp};
use super::{Cause, Failure, System, SystemGradient};

/// Aimed to this distance in the stop, relative to its semi-diameter.
const TOLERANCE: f64 = 1e-12;
const ITERATIONS: usize = 30;

/// First guess: the paraxial entrance pupil at `pupil_z`, `pupil_scale` mm of pupil per mm of stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParaxialPupil {
    /// Position from the first vertex, mm.
    pub z: f64,
    /// Entrance-pupil radius over stop radius.
    pub scale: f64,
}

impl ParaxialPupil {
    /// The entrance pupil of `lens` at its primary wavelength.
    pub fn new(lens: &crate::lens::Lens) -> Self {
        let p = crate::lens::paraxial::first_order(lens, lens.wavelengths.primary_nm);
        Self { z: p.entrance_pupil_position, scale: 0.5 * p.entrance_pupil_diameter / p.stop_semi_diameter }
    }

    fn guess(&self, field: FieldPoint, target: DVec2) -> DVec2 {
        (target * self.scale - self.z * field.slope) / (1.0 + self.z * field.vergence)
    }
}

/// The point on the first vertex plane whose ray meets the stop at `target` (mm); `hits` ends with the stop.
pub fn aim(
    system: &System,
    pupil: ParaxialPupil,
    field: FieldPoint,
    target: DVec2,
    start: Option<DVec2>,
    hits: &mut Vec<Hit>,
) -> Result<DVec2, Failure> {
    let first = newton(system, field, target, start.unwrap_or_else(|| pupil.guess(field, target)), hits);
    if first.is_ok() || start.is_some() {
        return first.or_else(|_| continued(system, pupil, field, target, hits));
    }
    continued(system, pupil, field, target, hits)
}

/// Walks from the axis to the field, each solution (and its trend) the start of the next.
fn continued(
    system: &System,
    pupil: ParaxialPupil,
    field: FieldPoint,
    target: DVec2,
    hits: &mut Vec<Hit>,
) -> Result<DVec2, Failure> {
    const STEPS: u32 = 12;
    let (mut before, mut last) = (None::<DVec2>, None::<DVec2>);
    for i in 0..=STEPS {
        let f = f64::from(i) / f64::from(STEPS);
        let at = FieldPoint { slope: field.slope * f, vergence: field.vergence };
        let start = match (before, last) {
            (Some(a), Some(b)) => 2.0 * b - a,
            (None, Some(b)) => {
                b + pupil.guess(at, target) - pupil.guess(FieldPoint { slope: DVec2::ZERO, ..at }, target)
            }
            _ => pupil.guess(at, target),
        };
        let e = newton(system, at, target, start, hits)?;
        (before, last) = (last, Some(e));
    }
    Ok(last.expect("at least one step"))
}

fn newton(
    system: &System,
    field: FieldPoint,
    target: DVec2,
    start: DVec2,
    hits: &mut Vec<Hit>,
) -> Result<DVec2, Failure> {
    let stop = system.stop;
    let scale = system.stop_semi_diameter;
    let mut e = start;
    let mut hit = trace(system, launch(field, e), stop, hits)?;
    for _ in 0..ITERATIONS {
        let miss = hit.at.point.truncate() - target;
        if miss.length() <= TOLERANCE * scale {
            return Ok(e);
        }
        let step = stop_jacobian(system, field, e, hits).inverse() * miss;
        if !step.is_finite() {
            break;
        }
        // Halve the step while it loses the ray or the distance.
        let mut factor = 1.0;
        loop {
            let trial = e - factor * step;
            match trace(system, launch(field, trial), stop, hits) {
                Ok(h) if (h.at.point.truncate() - target).length() < miss.length() => {
                    (e, hit) = (trial, h);
                    break;
                }
                _ if factor > 1e-3 => factor *= 0.5,
                // No better point: rounding at the solution is accepted, anything else is not.
                _ => {
                    trace(system, launch(field, e), stop, hits)?;
                    return if miss.length() <= 1e3 * TOLERANCE * scale {
                        Ok(e)
                    } else {
                        Err(Failure { cause: Cause::NotConverged, surface: stop })
                    };
                }
            }
        }
    }
    Err(Failure { cause: Cause::NotConverged, surface: stop })
}

/// `∂(stop point)/∂e`: two pull-backs, one per row.
fn stop_jacobian(system: &System, field: FieldPoint, e: DVec2, hits: &[Hit]) -> DMat2 {
    let mut scratch = SystemGradient::zeros(system);
    let ray = launch(field, e);
    let mut row = |bar: DVec3| {
        let mut bars = vec![HitBar::default(); system.stop + 1];
        bars[system.stop].point = bar;
        let (o, d) = trace_vjp(system, hits, &bars, &mut scratch);
        launch_vjp(field, ray, o, d).0
    };
    DMat2::from_cols(row(DVec3::X), row(DVec3::Y)).transpose()
}

/// Cotangents that leave [`aim_vjp`].
pub struct AimBar {
    /// Of the field's slope.
    pub slope: DVec2,
    /// Of the target point in the stop.
    pub target: DVec2,
}

/// Pulls a cotangent on the aimed `e` back to the system (added to `out`), the slope and the target.
///
/// `hits` are those of the aimed ray up to the stop at least.
pub fn aim_vjp(
    system: &System,
    field: FieldPoint,
    e: DVec2,
    hits: &[Hit],
    e_bar: DVec2,
    out: &mut SystemGradient,
) -> AimBar {
    let lambda = stop_jacobian(system, field, e, hits).transpose().inverse() * e_bar;
    let mut bars = vec![HitBar::default(); system.stop + 1];
    bars[system.stop].point = DVec3::new(-lambda.x, -lambda.y, 0.0);
    let (o, d) = trace_vjp(system, hits, &bars, out);
    let (_, slope) = launch_vjp(field, launch(field, e), o, d);
    AimBar { slope, target: lambda }
}
