//! Freeform terms, tilts and elements of the TOML form.

use super::{FileElement, FileXy, FileZernike};
use crate::lens::freeform::{MAX_NOLL, MAX_XY_DEGREE, Xy, Zernike};
use crate::lens::{Element, Pose};
use isoplanat_base::error::{Error, Location, Result};

pub(super) fn zernike(z: FileZernike, place: &Location, file: &str) -> Result<Zernike> {
    if z.terms.is_empty() || z.terms.len() > MAX_NOLL {
        let allowed = format!("1 to {MAX_NOLL} coefficients in mm, Noll's order from Z1");
        return Err(Error::bad(file, place.clone().key("terms"), format!("{:?}", z.terms), allowed));
    }
    Ok(Zernike::new(z.radius_mm, z.terms))
}

pub(super) fn xy(p: FileXy, place: &Location, file: &str) -> Result<Xy> {
    let mut terms = Vec::new();
    for (key, value) in &p.terms {
        let orders = key
            .strip_prefix('x')
            .and_then(|k| k.split_once('y'))
            .and_then(|(i, j)| Some((i.parse::<usize>().ok()?, j.parse::<usize>().ok()?)))
            .filter(|(i, j)| (1..=MAX_XY_DEGREE).contains(&i.saturating_add(*j)) && *key == format!("x{i}y{j}"));
        let Some((i, j)) = orders else {
            let allowed = format!("x<i>y<j> with i + j from 1 to {MAX_XY_DEGREE}");
            return Err(Error::bad(file, place.clone().key("terms"), format!("unknown term `{key}`"), allowed));
        };
        terms.push((i, j, *value));
    }
    if terms.is_empty() {
        return Err(Error::bad(file, place.clone().key("terms"), "no terms", "at least one"));
    }
    Ok(Xy::new(p.radius_mm, &terms))
}

pub(super) fn write_xy(p: &Xy) -> FileXy {
    let terms = p.orders().iter().zip(p.terms()).map(|((i, j), c)| (format!("x{i}y{j}"), *c)).collect();
    FileXy { radius_mm: p.radius(), terms }
}

/// Degrees that give exactly `radians` back.
pub(crate) fn degrees(radians: f64) -> f64 {
    let mut deg = radians.to_degrees();
    for candidate in [deg.next_down(), deg.next_up()] {
        if deg.to_radians() != radians && candidate.to_radians() == radians {
            deg = candidate;
        }
    }
    deg
}

pub(super) fn pose(tilt_deg: Option<[f64; 3]>, decentre_mm: Option<[f64; 2]>) -> Option<Pose> {
    let stated = tilt_deg.is_some() || decentre_mm.is_some();
    let (tilt, decentre) = (tilt_deg.unwrap_or_default(), decentre_mm.unwrap_or_default());
    stated.then(|| Pose { decentre, tilt: tilt.map(f64::to_radians) })
}

pub(super) fn element(e: &FileElement) -> Element {
    let pose = pose(e.tilt_deg, e.decentre_mm).unwrap_or_default();
    Element { first: e.first, last: e.last, pose, pivot: e.pivot_mm }
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
