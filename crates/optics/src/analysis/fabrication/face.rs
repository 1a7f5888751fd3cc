//! One face of a glass as a workshop makes and measures it: sag, slope, and the departure from a best-fit sphere.
//!
//! Sag `z(h)` is measured from the vertex along the axis, positive towards the sensor. The **best-fit sphere** passes through the vertex, and
//! its curvature `c` makes the mean square of the departure `z(h) − s(h)` over the area of the clear aperture least; `s = c h² / (1 + √(1 − c²h²))`.
//! Slopes are `dz/dh`; the mean runs over 256 rings of equal area, largest values over 1000 heights and the rim.

use serde::Serialize;

use crate::lens::{Shape, Surface};

/// Rings of equal area that the best-fit sphere is fitted to.
const RINGS: u32 = 256;
/// Heights at which the largest departure and the steepest slope are looked for.
const HEIGHTS: u32 = 1000;

/// How a face looks from outside the glass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bend {
    /// CX.
    Convex,
    /// CC.
    Concave,
    /// Neither.
    Plane,
}

impl Bend {
    /// Of a vertex curvature, with the glass behind or before the face.
    pub fn from_curvature(curvature: f64, glass_behind: bool) -> Self {
        match curvature {
            0.0 => Self::Plane,
            c if (c > 0.0) == glass_behind => Self::Convex,
            _ => Self::Concave,
        }
    }

    /// The short form of drawings.
    pub fn code(self) -> &'static str {
        match self {
            Self::Convex => "CX",
            Self::Concave => "CC",
            Self::Plane => "plane",
        }
    }
}

/// The sphere through the vertex that departs least from a face, and what is left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BestFit {
    /// Curvature of the sphere, 1/mm.
    pub curvature_per_mm: f64,
    /// Its radius, mm; none of a plane.
    pub radius_mm: Option<f64>,
    /// Largest departure of the face from it, with its sign (positive: the face lies towards the sensor), µm.
    pub departure_um: f64,
    /// Height of that departure, mm.
    pub departure_at_mm: f64,
    /// Largest slope of the departure, absolute, µm/mm.
    pub slope_um_per_mm: f64,
}

/// One power of an asphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Term {
    /// The power of the height `h`.
    pub power: usize,
    /// Its coefficient, mm^(1−power).
    pub coefficient: f64,
}

/// A row of a sag table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SagRow {
    /// Distance from the axis, mm.
    pub height_mm: f64,
    /// Sag, mm.
    pub sag_mm: f64,
    /// `dz/dh`.
    pub slope: f64,
    /// Sag less that of the best-fit sphere, mm.
    pub departure_mm: f64,
}

/// A face between glass and air, or between two glasses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Face {
    /// Its number in the prescription.
    pub surface: usize,
    /// As seen from outside the glass before it; none where air is before it.
    pub bend_before: Option<Bend>,
    /// As seen from outside the glass behind it; none where air is behind it.
    pub bend_behind: Option<Bend>,
    /// Radius `R` of the conic, mm, positive where its centre lies behind the face; none of a plane.
    pub radius_mm: Option<f64>,
    /// Its curvature `1/R`, 1/mm.
    pub curvature_per_mm: f64,
    /// Curvature at the vertex, an `h²` term included, 1/mm.
    pub vertex_curvature_per_mm: f64,
    /// Conic constant κ.
    pub conic: f64,
    /// Terms of the asphere that are not zero, by power.
    pub asphere: Vec<Term>,
    /// Clear (optically effective) diameter, mm.
    pub clear_diameter_mm: f64,
    /// Sag at the rim of the clear aperture, mm.
    pub edge_sag_mm: f64,
    /// Slope there, degrees.
    pub edge_slope_deg: f64,
    /// Steepest slope within the clear aperture, absolute, degrees.
    pub steepest_deg: f64,
    /// Smallest radius of curvature of the meridian where its glass (a cemented face's front glass) is hollow, mm; none where it is nowhere. A turning
    /// tool's nose must be smaller.
    pub tightest_concave_mm: Option<f64>,
    /// The best-fit sphere.
    pub best_fit: BestFit,
    /// Its form.
    #[serde(skip)]
    pub shape: Shape,
}

impl Face {
    /// Of surface `i`; `glass` says where glass is, before it and behind it.
    pub fn new(i: usize, surface: &Surface, glass: [bool; 2]) -> Self {
        let (shape, semi) = (&surface.shape, surface.semi_diameter);
        let vertex = shape.vertex_curvature();
        let edge = at(shape, semi);
        let stated = shape.terms().filter(|(_, a)| *a != 0.0);
        let mut asphere: Vec<Term> = stated.map(|(power, coefficient)| Term { power, coefficient }).collect();
        asphere.sort_by_key(|t| t.power);
        let places = || heights(semi, HEIGHTS).map(|h| at(shape, h));
        // Positive where the face bulges out of its glass.
        let outwards = if glass[0] { -1.0 } else { 1.0 };
        let tightest = places().map(|p| outwards * p.bend).fold(0.0, f64::min);
        let curvature = best_fit_curvature(shape, semi);
        Self {
            surface: i,
            bend_before: glass[0].then(|| Bend::from_curvature(vertex, false)),
            bend_behind: glass[1].then(|| Bend::from_curvature(vertex, true)),
            radius_mm: radius(shape.curvature),
            curvature_per_mm: shape.curvature,
            vertex_curvature_per_mm: vertex,
            conic: shape.conic,
            asphere,
            clear_diameter_mm: 2.0 * semi,
            edge_sag_mm: edge.sag,
            edge_slope_deg: edge.slope.atan().to_degrees(),
            steepest_deg: places().map(|p| p.slope.abs()).fold(0.0, f64::max).atan().to_degrees(),
            tightest_concave_mm: (tightest < 0.0).then(|| -1.0 / tightest),
            best_fit: best_fit(shape, semi, curvature),
            shape: shape.clone(),
        }
    }

    /// Clear semi-diameter, mm.
    pub fn clear_mm(&self) -> f64 {
        0.5 * self.clear_diameter_mm
    }

    /// Sag of the face as its clear aperture and a flat rim at right angles to the axis, mm.
    pub fn rimmed_sag(&self, height: f64) -> f64 {
        at(&self.shape, height.min(self.clear_mm())).sag
    }

    /// Sag by the formula alone, mm; `None` where the conic does not reach.
    pub(crate) fn formula_sag(&self, height: f64) -> Option<f64> {
        self.shape.sag(height * height).map(|s| s.h)
    }

    /// How much the sag at the clear rim changes with the curvature of the conic, mm².
    pub fn edge_sag_by_curvature(&self) -> f64 {
        let rho = self.clear_mm().powi(2);
        let mut bar = self.shape.zeros_like();
        if let Some(sag) = self.shape.sag(rho) {
            self.shape.sag_vjp(rho, &sag, 1.0, 0.0, &mut bar);
        }
        bar.curvature
    }

    /// `count` rows from the axis to the clear rim, both included.
    pub fn sag_table(&self, count: u32) -> Vec<SagRow> {
        let row = |height_mm: f64| {
            let place = at(&self.shape, height_mm);
            let sphere = sphere(self.best_fit.curvature_per_mm, height_mm * height_mm);
            SagRow { height_mm, sag_mm: place.sag, slope: place.slope, departure_mm: place.sag - sphere.sag }
        };
        heights(self.clear_mm(), count.max(2) - 1).map(row).collect()
    }
}

/// Heights from the axis to `semi` in so many steps, the rim itself the last.
fn heights(semi: f64, steps: u32) -> impl Iterator<Item = f64> {
    (0..=steps).map(move |k| if k == steps { semi } else { semi * f64::from(k) / f64::from(steps) })
}

/// A face at one height.
struct FacePoint {
    sag: f64,
    slope: f64,
    /// Curvature of the meridian, 1/mm.
    bend: f64,
}

/// A shape at a height within its clear aperture; rounding may put the rim on the end of the conic's reach.
fn at(shape: &Shape, height: f64) -> FacePoint {
    let h = height.min(shape.reach() * (1.0 - 1e-12));
    let rho = h * h;
    shape.sag(rho).map_or(FacePoint { sag: 0.0, slope: 0.0, bend: 0.0 }, |s| {
        let slope = 2.0 * h * s.h1;
        // The h³ term's second derivative by ρ is not finite on the axis, where ρ takes it away.
        let second = if rho > 0.0 { 2.0 * s.h1 + 4.0 * rho * s.h2 } else { 2.0 * s.h1 };
        FacePoint { sag: s.h, slope, bend: second / (1.0 + slope * slope).powf(1.5) }
    })
}

/// Radius of a curvature; none of a plane.
fn radius(curvature: f64) -> Option<f64> {
    Some(curvature.recip()).filter(|r| r.is_finite())
}

/// A sphere through the vertex at one `ρ`.
struct Sphere {
    sag: f64,
    /// `ds/dh`.
    slope: f64,
    /// `ds/dc`, mm².
    by_curvature: f64,
}

fn sphere(c: f64, rho: f64) -> Sphere {
    let phi = (1.0 - c * c * rho).max(0.0).sqrt().max(1e-9);
    let sag = c * rho / (1.0 + phi);
    Sphere { sag, slope: c * rho.sqrt() / phi, by_curvature: (rho + sag * sag) / (2.0 * phi) }
}

/// Curvature of the best-fit sphere, 1/mm.
fn best_fit_curvature(shape: &Shape, semi: f64) -> f64 {
    if !shape.is_aspheric() && (shape.conic == 0.0 || shape.curvature == 0.0) {
        return shape.curvature;
    }
    let rings: Vec<[f64; 2]> = (0..RINGS)
        .map(|k| {
            let rho = semi * semi * (f64::from(k) + 0.5) / f64::from(RINGS);
            [rho, at(shape, rho.sqrt()).sag]
        })
        .collect();
    // Sum of squares, and half its derivative.
    let misfit = |c: f64| {
        rings.iter().fold([0.0, 0.0], |[sum, by_c], [rho, sag]| {
            let s = sphere(c, *rho);
            let d = s.sag - sag;
            [sum + d * d, by_c + d * s.by_curvature]
        })
    };
    // Spheres reach the rim up to a curvature of 1/semi, evenly in the angle of their rim.
    const STEPS: i32 = 64;
    let curvature = |k: i32| {
        let turn = std::f64::consts::FRAC_PI_2 * f64::from(k.clamp(-STEPS, STEPS)) / f64::from(STEPS);
        turn.sin() * (1.0 - 1e-9) / semi
    };
    let best = (-STEPS..=STEPS).min_by(|a, b| misfit(curvature(*a))[0].total_cmp(&misfit(curvature(*b))[0]));
    let k = best.unwrap_or(0);
    let [mut low, mut high] = if misfit(curvature(k))[1] < 0.0 { [k, k + 1] } else { [k - 1, k] }.map(curvature);
    // The derivative changes its sign in there: halve until nothing is left.
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if misfit(middle)[1] < 0.0 { low = middle } else { high = middle }
    }
}

/// What departs from the sphere of `curvature`.
fn best_fit(shape: &Shape, semi: f64, curvature: f64) -> BestFit {
    let mut fit = BestFit {
        curvature_per_mm: curvature,
        radius_mm: radius(curvature),
        departure_um: 0.0,
        departure_at_mm: 0.0,
        slope_um_per_mm: 0.0,
    };
    if !shape.is_aspheric() && shape.curvature == curvature && (shape.conic == 0.0 || curvature == 0.0) {
        return fit;
    }
    for h in heights(semi, HEIGHTS) {
        let (place, sphere) = (at(shape, h), sphere(curvature, h * h));
        let departure = 1e3 * (place.sag - sphere.sag);
        if departure.abs() > fit.departure_um.abs() {
            (fit.departure_um, fit.departure_at_mm) = (departure, h);
        }
        fit.slope_um_per_mm = fit.slope_um_per_mm.max(1e3 * (place.slope - sphere.slope).abs());
    }
    fit
}

#[cfg(test)]
mod tests;
