//! Freeform terms, tilts and elements of the TOML form.

use super::{FileElement, FileXy, FileZernike};
use crate::error::{Error, Result};
use crate::lens::freeform::{MAX_NOLL, MAX_XY_DEGREE, Xy, Zernike};
use crate::lens::{Element, Pose};

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
