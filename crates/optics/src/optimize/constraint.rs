//! What a lens must keep while it is improved, with analytic gradients: equalities and bounds that the solver holds by multipliers.

use glam::DVec2;
use serde::Serialize;

use super::first_order::{FirstOrder, Value};
use super::rays::{Rays, Slopes, Traced};
use crate::lens::variables::Variables;
use crate::lens::{Kind, Prescription};

/// Slope and place of the line above which there are no glasses.
const GLASS: [f64; 2] = [0.0085, 2.23];

/// A number of a lens that may be held or bounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quantity {
    /// Effective focal length at the primary wavelength, mm.
    FocalLength,
    /// Focal length over entrance-pupil diameter.
    FNumber,
    /// Of the paraxial cone of light from the axial object point at this vergence, 1/mm: `1 / (2 n'u')`. Of an object at infinity the f-number.
    WorkingFNumber(f64),
    /// First vertex to sensor, mm.
    Track,
    /// Last vertex to sensor, mm.
    BackFocus,
    /// Thickness behind a surface on the axis, mm.
    Centre(usize),
    /// Thickness behind a surface at the rim of what it has to let through, mm: of glass at the larger rim of its two surfaces, of
    /// air at the smaller.
    Edge(usize),
    /// Slope of a surface at its rim.
    Slope(usize),
    /// `(1+κ)c²r²` at a surface's rim: 1 is the conic's own edge.
    Reach(usize),
    /// Chief ray's height over the paraxial one, less 1, at the object point of that number.
    Distortion(usize),
    /// `n_d + 0.0085 v_d − 2.23` of the two-number glass behind a surface: below 0 there are glasses (between LASF and FK types).
    GlassLine(usize),
}

/// A quantity with its bounds; equal bounds hold it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Constraint {
    /// What is held.
    #[serde(rename = "name")]
    pub quantity: Quantity,
    /// Smallest and largest value; infinite where there is none.
    pub bounds: [f64; 2],
}

/// A quantity that is wanted near a value without being held: its deviation counts beside the rays.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Target {
    /// What is wanted.
    #[serde(rename = "name")]
    pub quantity: Quantity,
    /// Near which value.
    #[serde(rename = "target")]
    pub value: f64,
    /// By how many mm of rms a unit of deviation counts.
    #[serde(rename = "weight_mm_per_unit")]
    pub weight: f64,
}

impl Serialize for Quantity {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&self.name())
    }
}

impl Quantity {
    /// As messages and files call it.
    pub fn name(self) -> String {
        match self {
            Self::FocalLength => "focal_length".into(),
            Self::FNumber => "f_number".into(),
            Self::WorkingFNumber(_) => "working_f_number".into(),
            Self::Track => "track".into(),
            Self::BackFocus => "back_focus".into(),
            Self::Centre(i) => format!("surface[{i}].centre"),
            Self::Edge(i) => format!("surface[{i}].edge"),
            Self::Slope(i) => format!("surface[{i}].slope"),
            Self::Reach(i) => format!("surface[{i}].reach"),
            Self::Distortion(k) => format!("distortion[{k}]"),
            Self::GlassLine(i) => format!("surface[{i}].glass_line"),
        }
    }

    /// Whether the solver sees it as a function of its inverse, which may be 0.
    pub(super) fn is_inverse(self) -> bool {
        matches!(self, Self::FocalLength | Self::FNumber | Self::WorkingFNumber(_))
    }

    /// Its unit, for tables.
    pub fn unit(self) -> &'static str {
        match self {
            Self::FNumber
            | Self::WorkingFNumber(_)
            | Self::Slope(_)
            | Self::Reach(_)
            | Self::Distortion(_)
            | Self::GlassLine(_) => "",
            _ => "mm",
        }
    }
}

/// A lens with all that constraints ask of it.
pub(super) struct Held<'a> {
    pub(super) numbers: &'a Prescription,
    pub(super) variables: &'a Variables,
    pub(super) first: FirstOrder,
    /// How far from the axis each surface has to reach, mm.
    pub(super) rims: &'a [f64],
    /// Rays, for distortion; slopes where derivatives are asked for.
    pub(super) rays: Option<(&'a Rays, &'a Traced, Option<&'a Slopes>)>,
}

impl Held<'_> {
    /// The value of `quantity` as the solver sees it near `bound`, and its derivatives: focal length and f-numbers as functions of their
    /// inverses, which stay finite through an afocal lens and agree with them at the bound to first order.
    pub(super) fn near(&self, quantity: Quantity, bound: f64) -> Value {
        match self.inverse(quantity) {
            Some(inverse) => inverse.map(bound + bound * (1.0 - inverse.value * bound), -bound * bound),
            None => self.value(quantity),
        }
    }

    /// One over a quantity that [is seen so](Quantity::is_inverse).
    fn inverse(&self, quantity: Quantity) -> Option<Value> {
        let FirstOrder { power, skew, pupil_diameter, pupil_position, .. } = &self.first;
        match quantity {
            Quantity::FocalLength => Some(power.clone()),
            Quantity::FNumber => Some(power.times(pupil_diameter)),
            Quantity::WorkingFNumber(v) => {
                // The ray from the axial object point to the pupil's rim has slope and height in the proportion of v and 1 at the first vertex.
                let slope = power.plus(skew, -v);
                let reach = pupil_position.map(1.0 + v * pupil_position.value, v);
                let cone = pupil_diameter.times(&slope).times(&reach.map(reach.value.recip(), -reach.value.powi(-2)));
                Some(cone.map(cone.value.abs(), cone.value.signum()))
            }
            _ => None,
        }
    }

    /// What a target adds to the residuals, mm.
    pub(super) fn residual(&self, target: &Target) -> Value {
        let value = self.near(target.quantity, target.value);
        value.map(target.weight * (value.value - target.value), target.weight)
    }

    /// The value of `quantity` and its derivatives.
    pub(super) fn value(&self, quantity: Quantity) -> Value {
        let n = self.variables.parameters.len();
        let surfaces = &self.numbers.surfaces;
        match quantity {
            Quantity::FocalLength | Quantity::FNumber | Quantity::WorkingFNumber(_) => {
                let inverse = self.inverse(quantity).unwrap_or_else(|| Value::constant(0.0, n));
                let f = inverse.value.recip();
                inverse.map(f, -f * f)
            }
            Quantity::Track => self.thicknesses(0..surfaces.len()),
            Quantity::BackFocus => self.thicknesses(surfaces.len() - 1..surfaces.len()),
            Quantity::Centre(i) => self.thicknesses(i..i + 1),
            Quantity::Edge(i) => self.edge(i),
            Quantity::Slope(i) => {
                let (r, shape) = (self.within(i, self.rims[i]), &surfaces[i].shape);
                let Some(sag) = shape.sag(r * r) else { return Value::constant(f64::INFINITY, n) };
                let mut bar = shape.zeros_like();
                shape.sag_vjp(r * r, &sag, 0.0, 2.0 * r, &mut bar);
                let mut value = Value::constant(2.0 * r * sag.h1, n);
                self.add_shape(i, &bar, &mut value.by);
                value
            }
            Quantity::Reach(i) => {
                let (shape, rho) = (&surfaces[i].shape, self.rims[i].powi(2));
                let (c, k) = (shape.curvature, 1.0 + shape.conic);
                let mut bar = shape.zeros_like();
                (bar.curvature, bar.conic) = (2.0 * k * c * rho, c * c * rho);
                let mut value = Value::constant(k * c * c * rho, n);
                self.add_shape(i, &bar, &mut value.by);
                value
            }
            Quantity::Distortion(k) => self.distortion(k),
            Quantity::GlassLine(i) => {
                let [n_d, v_d] = surfaces[i].medium.pair();
                let slope = |(p, s): (&crate::lens::Parameter, &f64)| match p.kind {
                    Kind::Index if p.of == i => *s,
                    Kind::Abbe if p.of == i => GLASS[0] * s,
                    _ => 0.0,
                };
                let by = self.variables.parameters.iter().zip(&self.variables.scales).map(slope).collect();
                Value { value: n_d + GLASS[0] * v_d - GLASS[1], by }
            }
        }
    }

    fn thicknesses(&self, of: std::ops::Range<usize>) -> Value {
        let mut value = Value::constant(of.clone().map(|i| self.numbers.surfaces[i].thickness).sum(), 0);
        let own = |p: &crate::lens::Parameter| p.kind == Kind::Thickness && of.contains(&p.of);
        let each = self.variables.parameters.iter().zip(&self.variables.scales);
        value.by = each.map(|(p, s)| if own(p) { *s } else { 0.0 }).collect();
        value
    }

    /// `r`, or a little less than where the conic ends.
    fn within(&self, i: usize, r: f64) -> f64 {
        r.min(0.98 * self.numbers.surfaces[i].shape.reach())
    }

    fn edge(&self, i: usize) -> Value {
        let surfaces = &self.numbers.surfaces;
        let mut value = self.thicknesses(i..i + 1);
        let (a, b) = (self.rims[i], self.rims.get(i + 1).copied().unwrap_or(f64::INFINITY));
        let glass = self.numbers.indices(self.numbers.wavelengths.primary_nm)[i + 1] > 1.0;
        let r = if glass && b.is_finite() { a.max(b) } else { a.min(b) };
        for (k, sign) in [(i, -1.0), (i + 1, 1.0)] {
            let Some(surface) = surfaces.get(k) else { continue };
            let r = self.within(k, r);
            let Some(sag) = surface.shape.sag(r * r) else { continue };
            let mut bar = surface.shape.zeros_like();
            surface.shape.sag_vjp(r * r, &sag, sign, 0.0, &mut bar);
            value.value += sign * sag.h;
            self.add_shape(k, &bar, &mut value.by);
        }
        value
    }

    fn distortion(&self, k: usize) -> Value {
        let n = self.variables.parameters.len();
        let Some((rays, traced, slopes)) = self.rays else { return Value::constant(0.0, n) };
        let (Some(point), Some(Some((c, i)))) = (rays.points.get(k), rays.chiefs().get(k).copied()) else {
            return Value::constant(0.0, n);
        };
        let Some((DVec2 { y: slope, .. }, v)) = point.plane.object.slope() else { return Value::constant(0.0, n) };
        if slope == 0.0 || !slope.is_finite() {
            return Value::constant(0.0, n);
        }
        // Paraxial height: slope over n'u' of the axial ray of unit height at the object's angle.
        let (power, skew) = (&self.first.power, &self.first.skew);
        let w = power.value - v * skew.value;
        let y = traced.landing(c, i).y;
        let by = |j: usize| {
            let dy = slopes.map_or(0.0, |s| s.of(c, i, n)[1][j]);
            (dy * w + y * (power.by[j] - v * skew.by[j])) / slope
        };
        Value { value: y * w / slope - 1.0, by: (0..n).map(by).collect() }
    }

    /// Adds a shape's cotangent to derivatives by the variables.
    fn add_shape(&self, of: usize, bar: &crate::lens::Shape, by: &mut [f64]) {
        for ((p, s), by) in self.variables.parameters.iter().zip(&self.variables.scales).zip(by) {
            if p.of != of {
                continue;
            }
            *by += s * p.kind.of_shape(bar).get(p.entry).copied().unwrap_or(0.0);
        }
    }
}
