//! First-order data with their derivatives by the variables, forward: two paraxial rays and one displacement of them a variable.

use super::engine::index_by;
use crate::lens::paraxial::marginal_slope;
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
        let rays = [sweep(numbers, &n, [1.0, 0.0], None), sweep(numbers, &n, [0.0, 1.0], None)];
        let dots: Vec<[[f64; 2]; 2]> = (0..count)
            .map(|j| {
                let moved = Some(moved(numbers, variables, j));
                [sweep(numbers, &n, [1.0, 0.0], moved).1, sweep(numbers, &n, [0.0, 1.0], moved).1]
            })
            .collect();
        let pick = |ray: usize, which: usize, sign: f64| Value {
            value: sign * rays[ray].0[which],
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
                let (u, v) = (marginal_slope(na), numbers.object_vergence);
                let at_stop = height / v + b.value;
                let mut stop = own(u * at_stop, u / v, (u / na).powi(3) * at_stop);
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

/// `[height at the stop, n'u' behind the last surface]` of a ray, and their displacement where one number moves.
fn sweep(lens: &Prescription, n: &[f64], start: [f64; 2], moved: Option<(usize, [f64; 3])>) -> ([f64; 2], [f64; 2]) {
    let ([mut y, mut w], [mut yd, mut wd]) = (start, [0.0; 2]);
    let (mut at_stop, mut at_stop_dot) = (0.0, 0.0);
    for (i, s) in lens.surfaces.iter().enumerate() {
        if i == lens.stop {
            (at_stop, at_stop_dot) = (y, yd);
        }
        let c = s.shape.curvature + 2.0 * s.shape.asphere.first().copied().unwrap_or(0.0);
        let power = (n[i + 1] - n[i]) * c;
        let (mut power_dot, mut t_dot, mut n_dot) = (0.0, 0.0, 0.0);
        if let Some((of, [c_by, t_by, n_by])) = moved {
            if of == i {
                (power_dot, t_dot, n_dot) = ((n[i + 1] - n[i]) * c_by + n_by * c, t_by, n_by);
            } else if of + 1 == i {
                power_dot = -n_by * c;
            }
        }
        (wd, w) = (wd - yd * power - y * power_dot, w - y * power);
        if i + 1 < lens.surfaces.len() {
            let reduced = s.thickness / n[i + 1];
            let reduced_dot = t_dot / n[i + 1] - reduced * n_dot / n[i + 1];
            (yd, y) = (yd + reduced * wd + reduced_dot * w, y + reduced * w);
        }
    }
    ([at_stop, w], [at_stop_dot, wd])
}
