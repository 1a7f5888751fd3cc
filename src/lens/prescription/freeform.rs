//! Freeform terms, tilts and elements of the TOML form.

use super::{FileElement, FileXy, FileZernike};
use crate::error::{Error, Result};
use crate::lens::freeform::{MAX_NOLL, MAX_XY_DEGREE, Xy, Zernike};
use crate::lens::{Element, Pose, Shape};

fn radius(mm: f64, place: &str, file: &str) -> Result<f64> {
    super::positive(mm, &format!("{place}.radius_mm"), file)
}

pub(super) fn zernike(z: FileZernike, place: &str, file: &str) -> Result<Zernike> {
    let radius = radius(z.radius_mm, place, file)?;
    if z.terms.is_empty() || z.terms.len() > MAX_NOLL || z.terms.iter().any(|t| !t.is_finite()) {
        let allowed = format!("1 to {MAX_NOLL} finite coefficients in mm, Noll's order from Z1");
        return Err(Error::bad(file, format!("{place}.terms"), format!("{:?}", z.terms), allowed));
    }
    Ok(Zernike::new(radius, z.terms))
}

pub(super) fn xy(p: FileXy, place: &str, file: &str) -> Result<Xy> {
    let radius = radius(p.radius_mm, place, file)?;
    let mut terms = Vec::new();
    for (key, value) in &p.terms {
        let orders = key
            .strip_prefix('x')
            .and_then(|k| k.split_once('y'))
            .and_then(|(i, j)| Some((i.parse::<usize>().ok()?, j.parse::<usize>().ok()?)))
            .filter(|(i, j)| (1..=MAX_XY_DEGREE).contains(&i.saturating_add(*j)) && *key == format!("x{i}y{j}"));
        let Some((i, j)) = orders else {
            let allowed = format!("x<i>y<j> with i + j from 1 to {MAX_XY_DEGREE}");
            return Err(Error::bad(file, format!("{place}.terms"), format!("unknown term `{key}`"), allowed));
        };
        if !value.is_finite() {
            return Err(Error::bad(file, format!("{place}.terms"), format!("{key} = {value}"), "finite numbers of mm"));
        }
        terms.push((i, j, *value));
    }
    if terms.is_empty() {
        return Err(Error::bad(file, format!("{place}.terms"), "no terms", "at least one"));
    }
    Ok(Xy::new(radius, &terms))
}

/// A freeform's radius lies within this factor of the clear semi-diameter, either way: ten powers of it and of a search up to 70
/// semi-diameters wide stay within 1e50, and their derivatives with them.
const RADII: f64 = 1e3;
/// Bound of the slope of the polynomial terms: 1000 is 89.94°. Aspheres whose terms cancel stay far below.
const STEEPEST: f64 = 1e3;

/// Refuses polynomial terms that no surface has within its clear semi-diameter: their search would not end in sensible time, or
/// their derivatives would leave the numbers.
pub(super) fn require_moderate(shape: &Shape, semi_diameter: f64, place: &str, file: &str) -> Result<()> {
    let radii = [("zernike", shape.zernike.as_ref().map(Zernike::radius)), ("xy", shape.xy.as_ref().map(Xy::radius))];
    for (key, radius) in radii {
        if let Some(r) = radius.filter(|r| !(semi_diameter / RADII..=semi_diameter * RADII).contains(r)) {
            let allowed = format!(
                "{:e} to {:e} mm, 1/1000 to 1000 semi_diameter_mm",
                semi_diameter / RADII,
                semi_diameter * RADII
            );
            return Err(Error::bad(file, format!("{place}{key}.radius_mm"), format!("{r:e}"), allowed));
        }
    }
    let slope = Shape { curvature: 0.0, conic: 0.0, ..shape.clone() }.steepest(semi_diameter);
    if slope.is_finite() && slope <= STEEPEST {
        return Ok(());
    }
    let found = format!("a slope of up to {slope:e} within the clear semi-diameter");
    Err(Error::bad(
        file,
        format!("{place}asphere, zernike, xy"),
        found,
        format!("terms whose slopes add to at most {STEEPEST}"),
    ))
}

pub(super) fn write_xy(p: &Xy) -> FileXy {
    let terms = p.orders().iter().zip(p.terms()).map(|((i, j), c)| (format!("x{i}y{j}"), *c)).collect();
    FileXy { radius_mm: p.radius(), terms }
}

/// Degrees that give exactly `radians` back.
pub(super) fn degrees(radians: f64) -> f64 {
    let mut deg = radians.to_degrees();
    for candidate in [deg.next_down(), deg.next_up()] {
        if deg.to_radians() != radians && candidate.to_radians() == radians {
            deg = candidate;
        }
    }
    deg
}

pub(super) fn pose(
    tilt_deg: Option<[f64; 3]>,
    decentre_mm: Option<[f64; 2]>,
    place: &str,
    file: &str,
) -> Result<Option<Pose>> {
    if tilt_deg.is_none() && decentre_mm.is_none() {
        return Ok(None);
    }
    let (tilt, decentre) = (tilt_deg.unwrap_or_default(), decentre_mm.unwrap_or_default());
    let sane = tilt.iter().all(|a| a.abs() < 90.0) && decentre.iter().all(|d| d.is_finite());
    if !sane {
        let found = format!("{tilt:?}, {decentre:?}");
        return Err(Error::bad(file, place, found, "angles between -90 and 90 degrees, finite shifts"));
    }
    Ok(Some(Pose { decentre, tilt: tilt.map(f64::to_radians) }))
}

pub(super) fn element(e: &FileElement, surfaces: usize, place: &str, file: &str) -> Result<Element> {
    if e.first > e.last || e.last >= surfaces {
        let found = format!("surfaces {} to {}", e.first, e.last);
        return Err(Error::bad(file, place, found, format!("first ≤ last, both from 0 to {}", surfaces - 1)));
    }
    if !e.pivot_mm.is_finite() {
        return Err(Error::bad(file, format!("{place}: pivot_mm"), e.pivot_mm.to_string(), "a finite number"));
    }
    let pose = pose(e.tilt_deg, e.decentre_mm, place, file)?.unwrap_or_default();
    Ok(Element { first: e.first, last: e.last, pose, pivot: e.pivot_mm })
}

pub(super) fn write_element(e: &Element) -> FileElement {
    FileElement {
        first: e.first,
        last: e.last,
        tilt_deg: Some(e.pose.tilt.map(degrees)),
        decentre_mm: Some(e.pose.decentre),
        pivot_mm: e.pivot,
    }
}
