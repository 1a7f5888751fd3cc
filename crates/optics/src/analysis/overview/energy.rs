//! Strehl ratio and encircled energy of a lens's fields by diffraction.

use super::Field;
use crate::lens::Lens;
use crate::psf::wave::{PointSpread, Untold};
use crate::psf::{Model, Optics, Quadrature, SensorPoint};
use isoplanat_base::error::Result;

/// Radii of the light before the lens, less one: only where it ends is asked.
const ILLUMINATIONS: u32 = 32;
/// Points of a curve, and how far beyond 95 % of the light it goes.
const POINTS: u32 = 96;
const BEYOND: f64 = 1.25;

/// What waves make of one field on the sensor, all wavelengths by their weights and light.
#[derive(Clone, Debug, PartialEq)]
pub struct Energy {
    /// Strehl ratio: the largest value of the point spread anywhere in the image plane over that of the same pupils without path differences.
    pub strehl: f64,
    /// Radius about the centroid (mm) and share of the light within.
    pub encircled: Vec<[f64; 2]>,
    /// Radii that hold 50, 80 and 95 % of the light, mm; none where that is farther than is followed.
    pub radii: [Option<f64>; 3],
    /// Root mean square residual of the paths' polynomials, wavelengths.
    pub residual_waves: f64,
    /// Share of the light that bends so far that it was spread evenly.
    pub spread: f64,
}

impl Energy {
    /// What is read from a point spread.
    fn of(found: &PointSpread) -> Self {
        let radii = [0.5, 0.8, 0.95].map(|part| found.radius_of(part));
        let end = radii[2].map_or(found.farthest(), |r| (BEYOND * r).min(found.farthest()));
        let at = |k: u32| {
            let radius = end * f64::from(k) / f64::from(POINTS);
            [radius, found.encircled(radius)]
        };
        let figures = found.figures();
        Self {
            strehl: found.strehl(),
            encircled: (0..=POINTS).map(at).collect(),
            radii,
            residual_waves: figures.residual_waves,
            spread: figures.spread,
        }
    }
}

/// Of every field of `lens`, or why there is none.
pub(super) fn over_fields(lens: &Lens, fields: &[Field]) -> Vec<std::result::Result<Energy, String>> {
    let height = |f: &Field| f.spot.and(f.chief).map(|c| c.length()).filter(|r| r.is_finite());
    let heights: Vec<Option<f64>> = fields.iter().map(height).collect();
    let points: Vec<SensorPoint> = heights.iter().flatten().map(|r| SensorPoint::along([0.0, 1.0], *r)).collect();
    match at_points(lens, &points) {
        Ok(found) => {
            let mut found = found.into_iter();
            let dark = || Err(Untold::Dark.to_string());
            heights.iter().map(|h| h.and_then(|_| found.next()).unwrap_or_else(dark)).collect()
        }
        Err(e) => vec![Err(e.without_file().to_string()); fields.len()],
    }
}

fn at_points(lens: &Lens, points: &[SensorPoint]) -> Result<Vec<std::result::Result<Energy, String>>> {
    let farthest = points.iter().map(|p| p.radius_mm()).fold(0.0, f64::max);
    let (nm, share): (Vec<f64>, Vec<f64>) = lens.wavelengths.shares().unzip();
    let quadrature = Quadrature { nm, weight: vec![share.clone()] };
    let vergences = vec![lens.object_vergence];
    let optics = Optics::even(lens, farthest.max(1e-3), vergences, quadrature, ILLUMINATIONS)?;
    let found = optics.diffracting(lens, Model::Waves)?.point_spreads(0, points, &share);
    let read = |p: std::result::Result<PointSpread, Untold>| p.map(|p| Energy::of(&p)).map_err(|e| e.to_string());
    Ok(found.into_iter().map(read).collect())
}
