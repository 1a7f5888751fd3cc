//! First-order data with their derivatives by the variables, forward: two paraxial rays and one displacement of them a variable.

use super::engine::index_by;
use crate::lens::paraxial::{marginal_slope, marginal_slope_by_na, sweep, sweep_jvp};
use crate::lens::variables::Variables;
use crate::lens::{Aperture, Kind, Prescription};

/// A number with its derivatives by the variables.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Value {
    /// The number.
    pub value: f64,
    /// Its derivative by every scaled variable.
    pub by: Vec<f64>,
}

impl Value {
    pub(super) fn constant(value: f64, variables: usize) -> Self {
        Self { value, by: vec![0.0; variables] }
    }

    pub(super) fn map(&self, value: f64, slope: f64) -> Self {
        Self { value, by: self.by.iter().map(|d| slope * d).collect() }
    }

    pub(super) fn times(&self, other: &Self) -> Self {
        let by = self.by.iter().zip(&other.by).map(|(a, b)| a * other.value + b * self.value);
        Self { value: self.value * other.value, by: by.collect() }
    }

    pub(super) fn plus(&self, other: &Self, factor: f64) -> Self {
        let by = self.by.iter().zip(&other.by).map(|(a, b)| a + factor * b);
        Self { value: self.value + factor * other.value, by: by.collect() }
    }
}

/// First-order data at the primary wavelength, mm.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FirstOrder {
    /// `1/focal length`; 0 of an afocal lens.
    pub power: Value,
    /// `n'u'` behind the lens of the paraxial ray through the first vertex at unit slope.
    pub(super) skew: Value,
    /// Semi-diameter of the stop.
    pub stop: Value,
    /// Entrance-pupil diameter.
    pub pupil_diameter: Value,
    /// Entrance pupil, from the first vertex.
    pub pupil_position: Value,
}

fn is_aperture(kind: Kind) -> bool {
    matches!(kind, Kind::EntrancePupilDiameter | Kind::FNumber | Kind::StopSemiDiameter)
}

/// What one variable moves, per unit: curvatures and thicknesses of surfaces, indices of spaces.
fn moved(numbers: &Prescription, variables: &Variables, j: usize) -> (usize, [f64; 3]) {
    let (p, s) = (variables.parameters[j], variables.scales[j]);
    let by = match p.kind {
        Kind::Curvature => [s, 0.0, 0.0],
        Kind::Even if p.entry == 0 => [2.0 * s, 0.0, 0.0],
        Kind::Thickness => [0.0, s, 0.0],
        Kind::Index | Kind::Abbe => {
            [0.0, 0.0, s * index_by(&numbers.surfaces[p.of].medium, numbers.wavelengths.primary_nm, p.kind)]
        }
        _ => [0.0; 3],
    };
    (p.of, by)
}

impl FirstOrder {
    /// Of `numbers` as they stand.
    pub(crate) fn new(numbers: &Prescription, variables: &Variables) -> Self {
        let n = numbers.indices(numbers.wavelengths.primary_nm);
        let count = variables.parameters.len();
        let states = [[1.0, 0.0], [0.0, 1.0]].map(|[y, u]| sweep(numbers, &n, y, u));
        // Height at the stop, n'u' behind the last surface.
        let ends = |states: &[[f64; 2]]| [states[numbers.stop][0], states[numbers.surfaces.len()][1]];
        let rays = states.each_ref().map(|state| ends(state));
        let dots: Vec<[[f64; 2]; 2]> = (0..count)
            .map(|j| {
                let (of, by) = moved(numbers, variables, j);
                states.each_ref().map(|state| ends(&sweep_jvp(numbers, &n, state, of, by)))
            })
            .collect();
        let pick = |ray: usize, which: usize, sign: f64| Value {
            value: sign * rays[ray][which],
            by: dots.iter().map(|d| sign * d[ray][which]).collect(),
        };
        let (power, a, b) = (pick(0, 1, -1.0), pick(0, 0, 1.0), pick(1, 0, 1.0));
        // The aperture's own number may be a variable.
        let own = |value: f64, slope_of_height: f64, by_number: f64| Value {
            value,
            by: (variables.parameters.iter().zip(&variables.scales).zip(&a.by))
                .map(|((p, s), da)| slope_of_height * da + if is_aperture(p.kind) { by_number * s } else { 0.0 })
                .collect(),
        };
        let height = a.value;
        let stop = match numbers.aperture {
            Aperture::StopSemiDiameter(r) => own(r, 0.0, 1.0),
            Aperture::EntrancePupilDiameter(d) => own(0.5 * d * height, 0.5 * d, 0.5 * height),
            Aperture::ObjectNa(na) => {
                let (u, v) = (marginal_slope(na, n[0]), numbers.object_vergence);
                let at_stop = height / v + b.value;
                let mut stop = own(u * at_stop, u / v, marginal_slope_by_na(na, n[0]) * at_stop);
                stop.by.iter_mut().zip(&b.by).for_each(|(s, db)| *s += u * db);
                stop
            }
            Aperture::FNumber(f) => {
                let k = 0.5 / (f * power.value);
                let mut stop = own(k * height, k, -k * height / f);
                stop.by.iter_mut().zip(&power.by).for_each(|(s, dp)| *s -= k * height / power.value * dp);
                stop
            }
        };
        let stop = stop.map(stop.value.abs(), stop.value.signum());
        let ratio = |x: &Value, y: &Value, f: f64| Value {
            value: f * x.value / y.value,
            by: x.by.iter().zip(&y.by).map(|(dx, dy)| f * (dx - x.value / y.value * dy) / y.value).collect(),
        };
        let sign = a.value.signum();
        Self {
            pupil_diameter: ratio(&stop, &a, 2.0 * sign),
            pupil_position: ratio(&b, &a, 1.0),
            power,
            skew: pick(1, 1, 1.0),
            stop,
        }
    }
}
