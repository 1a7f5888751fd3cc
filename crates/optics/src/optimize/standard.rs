//! What is optimised where nobody says more: variables, their bounds, and what is held.

use super::constraint::{Constraint, Held, Quantity};
use super::first_order::FirstOrder;
use super::merit::Merit;
use super::problem::Problem;
use crate::lens::variables::Variables;
use crate::lens::{Aperture, Kind, Lens, Parameter, paraxial};
use isoplanat_base::error::{Error, Result};

/// Least thickness of glass on the axis and at the rim, of air at both, in focal lengths.
const CENTRE: f64 = 0.02;
const RIM: f64 = 0.02;
const AIR: f64 = 0.002;
/// Thickest glass and air, in focal lengths, and by how much a thicker start may grow.
const THICKEST: f64 = 0.3;
const GROWTH: f64 = 1.5;
/// How much longer a lens may become.
const LONGER: f64 = 1.2;
/// How many times as large the working f-number may become.
const DARKER: f64 = 1.05;
/// Steepest surface (56°), and how far a conic may go towards its edge.
const SLOPE: f64 = 1.5;
const REACH: f64 = 0.9;

impl Problem {
    /// Curvatures of refracting surfaces and all thicknesses within `Self::bounds_of`; the focal length held, the length to 1.2 of the
    /// start's; the cone of light kept ([`Self::light`]); glass and air kept open ([`Self::room`]); spots over the field.
    pub fn standard(lens: &Lens) -> Self {
        let n = lens.indices(lens.wavelengths.primary_nm);
        let chosen = |p: &Parameter| match p.kind {
            Kind::Curvature => n[p.of] != n[p.of + 1],
            Kind::Thickness => true,
            _ => false,
        };
        let mut constraints = Self::focal_length(lens);
        if !constraints.is_empty() {
            // Left alone, lenses grow without end.
            let bounds = [f64::NEG_INFINITY, LONGER * lens.length()];
            constraints.push(Constraint { quantity: Quantity::Track, bounds });
        }
        constraints.extend(Self::light(lens, lens.object_vergence));
        constraints.extend(Self::room(lens));
        Self::new(lens, Parameter::all(lens).filter(chosen).collect(), constraints, Merit::default())
    }

    /// These variables in the standard bounds, these constraints, this merit.
    pub fn new(lens: &Lens, parameters: Vec<Parameter>, constraints: Vec<Constraint>, merit: Merit) -> Self {
        let variables = Variables::new(lens, parameters);
        let bounds = variables.parameters.iter().map(|p| Self::bounds_of(lens, *p)).collect();
        Self { lens: lens.clone(), variables, bounds, constraints, targets: Vec::new(), merit }
    }

    /// The focal length as it is; nothing for an afocal lens.
    pub fn focal_length(lens: &Lens) -> Vec<Constraint> {
        let f = paraxial::first_order(lens, lens.wavelengths.primary_nm).effective_focal_length;
        let held = Constraint { quantity: Quantity::FocalLength, bounds: [f, f] };
        if f.is_finite() && f.abs() < 1e9 { vec![held] } else { Vec::new() }
    }

    /// The working f-number of objects at `vergence` within 1.05 of the start's, where the aperture's own number does not hold it. The entrance pupil of a near
    /// object is free to move: left alone it runs to infinity, where a pupil of the same diameter lets no light through, and spots vanish.
    pub fn light(lens: &Lens, vergence: f64) -> Vec<Constraint> {
        let free = vergence != 0.0 || matches!(lens.aperture, Aperture::StopSemiDiameter(_));
        let quantity = Quantity::WorkingFNumber(vergence);
        let variables = Variables::new(lens, Vec::new());
        let first = FirstOrder::new(lens, &variables);
        let most =
            DARKER * Held { numbers: lens, variables: &variables, first, rims: &[], rays: None }.value(quantity).value;
        let held = Constraint { quantity, bounds: [f64::NEG_INFINITY, most] };
        if free && most.is_finite() && most > 0.0 { vec![held] } else { Vec::new() }
    }

    /// Edges of glass and air, slopes and reaches of surfaces: the standard bounds, or the start's own value where that is beyond them.
    pub fn room(lens: &Lens) -> Vec<Constraint> {
        let (size, n) = (size(lens), lens.indices(lens.wavelengths.primary_nm));
        let variables = Variables::new(lens, Vec::new());
        let rims: Vec<f64> = lens.surfaces.iter().map(|s| s.semi_diameter).collect();
        let held = Held {
            numbers: lens,
            variables: &variables,
            first: FirstOrder::new(lens, &variables),
            rims: &rims,
            rays: None,
        };
        let mut all = Vec::new();
        for i in 0..lens.surfaces.len() {
            if i + 1 < lens.surfaces.len() {
                let quantity = Quantity::Edge(i);
                let least = if n[i + 1] > 1.0 { RIM } else { AIR } * size;
                let own = held.value(quantity).value;
                all.push(Constraint { quantity, bounds: [least.min(own), f64::INFINITY] });
            }
            if n[i] != n[i + 1] {
                let slope = held.value(Quantity::Slope(i)).value.abs().max(SLOPE);
                all.push(Constraint { quantity: Quantity::Slope(i), bounds: [-slope, slope] });
                let reach = held.value(Quantity::Reach(i)).value.max(REACH);
                all.push(Constraint { quantity: Quantity::Reach(i), bounds: [f64::NEG_INFINITY, reach] });
            }
        }
        all
    }

    /// The bounds of a number where nobody says more. Thicknesses: glass from 0.02 to 0.3 focal lengths, air from 0.002 on, the last one
    /// from 0.05; each up to 1.5 of the start's where that is more, and down to the start's where that is less. Conics -20 to 20,
    /// indices 1.45 to 1.95, Abbe numbers 18 to 90; the start's own value always lies within.
    pub(crate) fn bounds_of(lens: &Lens, p: Parameter) -> [f64; 2] {
        let own = p.value(&**lens).unwrap_or(0.0);
        let size = size(lens);
        let [low, high] = match p.kind {
            Kind::Thickness => {
                let glass = lens.indices(lens.wavelengths.primary_nm)[p.of + 1] > 1.0;
                let last = p.of + 1 == lens.surfaces.len();
                let (least, most) = match (last, glass) {
                    (true, _) => (0.05, 2.0),
                    (_, true) => (CENTRE, THICKEST),
                    _ => (AIR, 2.0 * THICKEST),
                };
                [least * size, (most * size).max(GROWTH * own)]
            }
            Kind::Conic => [-20.0, 20.0],
            Kind::Index => [1.45, 1.95],
            Kind::Abbe => [18.0, 90.0],
            Kind::EntrancePupilDiameter | Kind::FNumber | Kind::StopSemiDiameter => [0.5 * own, 2.0 * own],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        };
        [low.min(own), high.max(own)]
    }

    /// Refuses what is no problem.
    ///
    /// # Errors
    /// Bounds or constraints that no number satisfies, named with their place.
    pub(crate) fn check(&self) -> Result<()> {
        let file = self.lens.file();
        self.merit.check(file)?;
        for (p, [a, b]) in self.variables.parameters.iter().zip(&self.bounds) {
            check_bounds(file, &p.name(&self.lens), [*a, *b])?;
        }
        for c in &self.constraints {
            let [a, b] = c.bounds;
            let name = c.quantity.name();
            self.known(c.quantity)?;
            check_bounds(file, &name, [a, b])?;
            if matches!(c.quantity, Quantity::WorkingFNumber(_)) && b <= 0.0 {
                return Err(Error::bad(file, name, b.to_string(), "a largest value above 0"));
            }
            if c.quantity.is_inverse() && (a == 0.0 || b == 0.0) {
                return Err(Error::bad(file, name, "0", "bounds other than 0"));
            }
        }
        for t in &self.targets {
            self.known(t.quantity)?;
            let refuse =
                |found: f64, allowed: &str| Err(Error::bad(file, t.quantity.name(), found.to_string(), allowed));
            if !(-LARGEST..=LARGEST).contains(&t.value) || t.quantity.is_inverse() && t.value == 0.0 {
                return refuse(t.value, &format!("{NUMBERS}, of focal length and f-number other than 0"));
            }
            if !(0.0..=LARGEST).contains(&t.weight) {
                return refuse(t.weight, "a weight from 0 to 1e12, mm of rms a unit");
            }
        }
        if self.bounds.len() != self.variables.parameters.len() {
            let found = format!("{} bounds for {} variables", self.bounds.len(), self.variables.parameters.len());
            return Err(Error::bad(file, "bounds", found, "one pair a variable"));
        }
        if self.variables.parameters.is_empty() {
            return Err(Error::bad(file, "variables", "none", "at least one"));
        }
        Ok(())
    }

    /// Refuses a quantity of a surface that the lens has not.
    fn known(&self, quantity: Quantity) -> Result<()> {
        let surfaces = self.lens.surfaces.len();
        let known = match quantity {
            Quantity::Edge(i) => i + 1 < surfaces,
            Quantity::Centre(i) | Quantity::Slope(i) | Quantity::Reach(i) | Quantity::GlassLine(i) => i < surfaces,
            _ => true,
        };
        let allowed = || format!("surfaces 0 to {}", surfaces - 1);
        if known { Ok(()) } else { Err(Error::bad(self.lens.file(), quantity.name(), "no such surface", allowed())) }
    }
}

/// Refuses bounds of `place` that no number satisfies.
pub(super) fn check_bounds(file: &str, place: &str, [low, high]: [f64; 2]) -> Result<()> {
    if let Some(far) = [low, high].into_iter().find(|b| b.is_finite() && b.abs() > LARGEST) {
        return Err(Error::bad(file, place, far.to_string(), format!("{NUMBERS}, or a side left out (`..`)")));
    }
    if low.is_nan() || high.is_nan() || low > high || low == f64::INFINITY || high == f64::NEG_INFINITY {
        let allowed = "a smallest value not above the largest";
        return Err(Error::bad(file, place, format!("{low} to {high}"), allowed));
    }
    Ok(())
}

/// What is held or wanted at most, in its own unit: beyond it what a lens misses has no digits left.
const LARGEST: f64 = 1e12;
/// The same in words.
const NUMBERS: &str = "a number from -1e12 to 1e12";

/// What thicknesses are measured by: the focal length, or the length of an afocal lens, mm.
fn size(lens: &Lens) -> f64 {
    let f = paraxial::first_order(lens, lens.wavelengths.primary_nm).effective_focal_length.abs();
    if f.is_finite() && f < 20.0 * lens.length() { f } else { lens.length() }
}
