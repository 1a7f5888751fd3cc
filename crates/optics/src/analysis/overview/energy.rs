//! Strehl ratio and encircled energy of a lens's fields by diffraction.

use super::Field;
use crate::lens::Lens;
use crate::lens::paraxial::first_order;
use crate::psf::table::Tolerance;
use crate::psf::wave::{PointSpread, Untold};
use crate::psf::{Model, Optics, OpticsSpec, Quadrature, SensorPoint};
use isoplanat_base::error::Result;

/// Radii of the light before the lens, less one: only where it ends is asked.
const ILLUMINATIONS: u32 = 32;
/// What rays may be off by, mm: much less than light can tell.
const LANDING_MM: f64 = 1e-4;
/// Radius of the Airy disk in wavelengths times the f-number.
const AIRY: f64 = 1.22;
/// How much farther from the centroid waves have light than rays do, as a factor, and in Airy radii beside it.
const FARTHER: f64 = 1.5;
const DISKS: f64 = 4.0;
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
            let of = |(h, f): (&Option<f64>, &Field)| {
                h.and_then(|_| found.next()).unwrap_or_else(dark).and_then(|e| beside(lens, f, e))
            };
            heights.iter().zip(fields).map(of).collect()
        }
        Err(e) => vec![Err(e.without_file().to_string()); fields.len()],
    }
}

/// The energy, where its radii are not far beyond those of the field's rays: waves add about the Airy disk to them. Polynomials of paths, in which fields near 90° and ragged
/// pupils do not go, put light anywhere.
fn beside(lens: &Lens, field: &Field, energy: Energy) -> std::result::Result<Energy, String> {
    let first = first_order(lens, lens.wavelengths.primary_nm);
    let airy = AIRY * lens.wavelengths.primary_nm * 1e-6 * first.working_f_number.abs();
    let Some(rays) = field.energy.filter(|_| airy.is_finite()) else { return Ok(energy) };
    let beyond = |(k, rays): (usize, f64)| energy.radii[k].is_none_or(|r| r > FARTHER * rays + DISKS * airy);
    if rays.into_iter().take(2).enumerate().any(beyond) {
        return Err("paths are not told there well enough for waves: rays have far smaller radii".to_owned());
    }
    Ok(energy)
}

fn at_points(lens: &Lens, points: &[SensorPoint]) -> Result<Vec<std::result::Result<Energy, String>>> {
    let farthest = points.iter().map(|p| p.radius_mm()).fold(0.0, f64::max);
    let (nm, share): (Vec<f64>, Vec<f64>) = lens.wavelengths.shares().unzip();
    let quadrature = Quadrature { nm, weight: vec![share.clone()] };
    let vergences = vec![lens.object_vergence];
    let spec =
        OpticsSpec { illuminations: ILLUMINATIONS, ..OpticsSpec::even(farthest.max(1e-3), vergences, quadrature) };
    let (optics, _) = Optics::adapted(lens, spec, Tolerance { landing_mm: LANDING_MM, weight: 1e-4 })?;
    let found = optics.diffracting(lens, Model::Waves)?.point_spreads(0, points, &share);
    let read = |p: std::result::Result<PointSpread, Untold>| p.map(|p| Energy::of(&p)).map_err(|e| e.to_string());
    Ok(found.into_iter().map(read).collect())
}

#[cfg(test)]
mod tests {
    use crate::analysis::overview::{Overview, Settings};
    use isoplanat_base::testing::shared;

    /// Half the light by waves is where half the rays are, or untold: in fisheyes, where it was told to be at 720 µm for 15, and another for every list of fields.
    #[test]
    fn wide_fields_agree_with_rays_or_are_untold() {
        let glasses = crate::lens::catalogue::Glasses::shipped();
        let (mut told, mut untold) = (0, 0);
        for (name, lists) in [
            ("139", [vec![60.0, 82.0, 83.0], vec![60.0, 84.0], vec![80.0, 85.0, 90.0]]),
            ("226", [vec![50.0, 60.0], vec![70.0], vec![45.0]]),
        ] {
            let Some(path) = shared(&format!("data/lenses/optics_database/{name}.zmx")) else { return };
            let lens = crate::interchange::lens_or_file(&path, glasses, crate::interchange::Reading::default())
                .expect("reads")
                .lens;
            let mut of_60 = Vec::new();
            for angles_deg in lists {
                let settings = Settings { angles_deg, waves: None, ..Settings::usual(&lens, 10.0) };
                for f in Overview::new(&lens, settings).fields {
                    let rays = f.energy.expect("rays")[0];
                    match f.diffracted.as_ref().expect("asked for") {
                        Ok(energy) => {
                            let waves = energy.radii[0].expect("followed");
                            assert!(
                                (waves / rays - 1.0).abs() < 0.1,
                                "{name}, {}°: {waves} of waves, {rays} of rays",
                                f.angle_deg
                            );
                            told += 1;
                            of_60.extend((f.angle_deg - 60.0).abs().le(&1e-9).then_some(waves));
                        }
                        Err(why) => {
                            eprintln!("{name}, {}°: {why}", f.angle_deg);
                            untold += 1;
                        }
                    }
                }
            }
            of_60.windows(2).for_each(|w| assert!((w[0] / w[1] - 1.0).abs() < 1e-3, "{name}: {of_60:?}"));
        }
        eprintln!("{told} told, {untold} untold");
        assert!(told >= 5);
    }
}
