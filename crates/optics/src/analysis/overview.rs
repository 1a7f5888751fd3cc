//! Everything about one lens at one object distance: spots, fans, curves, MTF, each with what its sampling leaves open.

mod energy;
mod frequencies;

use std::time::Instant;

use glam::DVec2;
use rayon::prelude::*;

use super::beam::{Beam, Landing, stop_points};
use super::curves::{FieldRow, ZoneRow, object, over_field, over_zones};
use super::diffraction::{self, Mtf, Plan, directions};
use super::fan::{Fans, path, reference, transverse};
use super::spot::{Spot, best_focus, encircled, joined, radius_of, spot};
use super::wavefront::Map;
use super::zernike::{Fit, Order};
use crate::lens::{Lens, paraxial};
use crate::trace::{Failure, ObjectPoint, System};
use isoplanat_base::stop::look;

pub use energy::Energy;
use frequencies::{Frequencies, even};

/// Points each way of an overlap, at most: blur of more than about 100 cycles has no value, but on the sensor, where it is followed as far as it can
/// be at every so many frequencies. A fast lens out of focus would take minutes otherwise.
const MOST_POINTS: f64 = 240.0;
const EVERY: usize = 4;

/// How finely a lens is looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Field angles at the paraxial entrance pupil, degrees, rising from the axis.
    pub angles_deg: Vec<f64>,
    /// Rays of a spot and wavelength.
    pub rays: usize,
    /// Rays of a spot and wavelength that are drawn.
    pub drawn: usize,
    /// Rays of a fan.
    pub fan: u32,
    /// Places of the curves over the field, and zones of the stop.
    pub places: u32,
    /// Highest frequency of the MTF, cycles/mm.
    pub cycles_per_mm: f64,
    /// Frequencies from 0 to that.
    pub frequencies: u32,
    /// Frequencies beside them, cycles/mm: the even ones go up to the highest of all.
    pub asked_cycles_per_mm: Vec<f64>,
    /// Shifts of the image plane to each side.
    pub shifts: u32,
    /// Largest shift, mm; `None` takes what the lens's own foci and depth of focus ask for.
    pub shift_mm: Option<f64>,
    /// Points across a map of the wavefront, and Zernike terms; none leaves waves out: no maps, no MTF by diffraction.
    pub waves: Option<(usize, usize)>,
    /// Whether Strehl ratio and encircled energy are made by diffraction beside those of rays.
    pub energy: bool,
    /// Whether spots, fans and MTF are made: without, there are curves over the field alone.
    pub spots: bool,
}

impl Settings {
    /// The usual ones: five fields to `max_angle_deg`, the MTF to the sensor's Nyquist frequency.
    pub fn usual(lens: &Lens, max_angle_deg: f64) -> Self {
        let angles_deg =
            if max_angle_deg > 0.0 { (0..5).map(|k| max_angle_deg * f64::from(k) / 4.0).collect() } else { vec![0.0] };
        Self {
            angles_deg,
            rays: 1600,
            drawn: 150,
            fan: 65,
            places: 33,
            cycles_per_mm: 0.5 / lens.sensor.pitch_mm(),
            frequencies: 41,
            asked_cycles_per_mm: Vec::new(),
            shifts: 6,
            shift_mm: None,
            waves: Some((64, 28)),
            energy: true,
            spots: true,
        }
    }
}

/// A number with what its sampling leaves open: the difference from a quarter of the rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// The number.
    pub value: f64,
    /// Its difference from that of a quarter of the rays.
    pub change: f64,
}

/// The geometric MTF of a field: tangential and sagittal.
pub(crate) type Pair = [f64; 2];

/// One field.
#[derive(Clone, Debug)]
pub struct Field {
    /// Field angle, degrees.
    pub angle_deg: f64,
    /// Rays by wavelength.
    pub beams: Vec<Beam>,
    /// Rays to be drawn, by wavelength.
    pub drawn: Vec<Vec<Landing>>,
    /// Landing of the primary wavelength's chief ray, mm; none where it does not land.
    pub chief: Option<DVec2>,
    /// The spot of all wavelengths by their weights; none without light.
    pub spot: Option<Spot>,
    /// Its rms radius, mm.
    pub rms: Option<Sampled>,
    /// Shifts to the least rms: along x, along y, both; mm.
    pub best_focus: Option<[f64; 3]>,
    /// The least rms radius over focus, mm.
    pub best_rms: Option<f64>,
    /// Part of the stop's rays that arrives, all wavelengths by their weights; rays that were not found count as stopped.
    /// [`FieldRow::open_part`] is by area, of the primary wavelength.
    pub open_part: f64,
    /// Transverse fans by wavelength, mm.
    pub transverse: Vec<Fans>,
    /// Path fans by wavelength, waves.
    pub path: Vec<Fans>,
    /// Radius (mm) and share of the light within.
    pub encircled: Vec<[f64; 2]>,
    /// Radii that hold 50, 80 and 95 % of the light, mm.
    pub energy: Option<[f64; 3]>,
    /// Strehl ratio and encircled energy by diffraction, on the sensor; why there are none; nothing where they are left out.
    pub diffracted: Option<Result<Energy, String>>,
    /// Geometric MTF at the overview's frequencies, on the sensor; not numbers without light.
    pub mtf: Vec<Pair>,
    /// Largest difference of it from that of a quarter of the rays.
    pub mtf_change: f64,
    /// Geometric MTF `[shift][frequency]` at the overview's shifts.
    pub through_focus: Vec<Vec<Pair>>,
    /// The wavefront of the primary wavelength about its chief ray's landing, with Zernike coefficients (Noll) where there is enough of
    /// it; none where there is none, or where waves are left out.
    pub map: Option<(Map, Option<Fit>)>,
    /// MTF by diffraction at the overview's frequencies and shifts, tangential and sagittal; why there is none; nothing where waves are left out.
    pub diffraction: Option<Result<Mtf, diffraction::Fault>>,
    /// Why rays that no aperture stops do not arrive.
    pub failure: Option<Failure>,
}

/// A lens as it was looked at.
#[derive(Clone, Debug)]
pub struct Overview {
    /// How.
    pub settings: Settings,
    /// Wavelengths, nm, with their shares of the light.
    pub colours: Vec<(f64, f64)>,
    /// The one of them that foci and references belong to, nm.
    pub primary_nm: f64,
    /// Fields, from the axis.
    pub fields: Vec<Field>,
    /// Curves over the field, to the last of the settings' angles.
    pub curve: Vec<FieldRow>,
    /// Foci of zones on the axis.
    pub zones: Vec<ZoneRow>,
    /// Shifts of the image plane, mm, 0 in the middle.
    pub shifts_mm: Vec<f64>,
    /// Frequencies, cycles/mm.
    pub cycles_per_mm: Vec<f64>,
    /// Radius of the Airy disc's first dark ring on the axis, mm: `1.22 λ N` of the working f-number; infinite for an afocal lens.
    pub airy_radius: f64,
    /// Seconds that spots and fans took, wavefronts and diffraction, the curves.
    pub seconds: [f64; 3],
}

impl Overview {
    /// `lens` for its own object distance and wavelengths.
    pub fn new(lens: &Lens, settings: Settings) -> Self {
        let start = Instant::now();
        let colours: Vec<(f64, f64)> = lens.wavelengths.shares().collect();
        let primary_nm = lens.wavelengths.primary_nm;
        let frequencies = Frequencies::new(settings.frequencies, settings.cycles_per_mm, &settings.asked_cycles_per_mm);
        let cycles_per_mm = frequencies.cycles_per_mm();
        let systems: Vec<System> = colours.iter().map(|(nm, _)| System::new(lens, *nm)).collect();
        let primary = System::new(lens, primary_nm);
        let view = View { lens, settings: &settings, colours: &colours, systems: &systems, primary: &primary };
        let spotted = if settings.spots { &settings.angles_deg[..] } else { &[] };
        let mut fields: Vec<Field> = spotted.par_iter().map(|angle| view.field(*angle, &frequencies)).collect();
        let f_number = paraxial::first_order(lens, primary_nm).working_f_number;
        let airy_radius = 1.22 * primary_nm * 1e-6 * f_number;
        let largest = settings.shift_mm.unwrap_or_else(|| view.shift(&fields, f_number));
        let steps = i32::try_from(settings.shifts).unwrap_or(6);
        let shifts_mm: Vec<f64> = (-steps..=steps).map(|k| largest * f64::from(k) / f64::from(steps.max(1))).collect();
        fields.par_iter_mut().for_each(|f| f.through_focus = f.over_focus(&colours, &shifts_mm, &frequencies));
        let spots = start.elapsed().as_secs_f64();
        if let Some((size, terms)) = settings.waves {
            let (cycles, focus_mm) = (cycles_per_mm.clone(), shifts_mm.clone());
            let plan = Plan { directions: Vec::new(), frequencies: cycles, focus_mm, most_points: MOST_POINTS };
            fields.par_iter_mut().for_each(|f| {
                let point = object(lens, f.angle_deg);
                f.map = Map::of_lens(lens, point, primary_nm, size).ok().map(|m| {
                    let fit = m.zernike(Order::Noll, terms);
                    (m, fit)
                });
                let plan = Plan { directions: directions(point).to_vec(), ..plan.clone() };
                f.diffraction = Some(waves_of(lens, point, &plan, &settings.asked_cycles_per_mm));
            });
        }
        if settings.energy {
            let found = energy::over_fields(lens, &fields);
            fields.iter_mut().zip(found).for_each(|(f, found)| f.diffracted = Some(found));
        }
        let waves = start.elapsed().as_secs_f64() - spots;
        let end = settings.angles_deg.last().copied().unwrap_or(0.0);
        let angles = if end > 0.0 { even(settings.places, 0.0, end) } else { vec![0.0] };
        let nm: Vec<f64> = colours.iter().map(|(nm, _)| *nm).collect();
        let (curve, zones) = rayon::join(|| over_field(lens, &nm, &angles), || over_zones(lens, &nm, settings.places));
        let seconds = [spots, waves, start.elapsed().as_secs_f64() - spots - waves];
        Self { settings, colours, primary_nm, fields, curve, zones, shifts_mm, cycles_per_mm, airy_radius, seconds }
    }
}

/// MTF by diffraction: all of the plan as far as [`MOST_POINTS`] follow, then what is missing in the middle of the shifts at every fourth frequency and at those `asked` for.
fn waves_of(lens: &Lens, point: ObjectPoint, plan: &Plan, asked: &[f64]) -> Result<Mtf, diffraction::Fault> {
    let pupils = diffraction::pupils(lens, point)?;
    let mut mtf = diffraction::of_pupils(&pupils, plan)?;
    let middle = plan.focus_mm.len() / 2;
    let Some(focus) = plan.focus_mm.get(middle) else { return Ok(mtf) };
    for (curve, direction) in mtf.curves.iter_mut().zip(&plan.directions) {
        let looked_at = |k: usize| k.is_multiple_of(EVERY) || asked.contains(&plan.frequencies[k]);
        let missing = |k: &usize| looked_at(*k) && curve.transfer[middle][*k].is_none();
        let lost: Vec<usize> = (0..plan.frequencies.len()).filter(missing).collect();
        if lost.is_empty() {
            continue;
        }
        let frequencies = lost.iter().map(|k| plan.frequencies[*k]).collect();
        let more =
            Plan { directions: vec![*direction], frequencies, focus_mm: vec![*focus], most_points: Plan::MOST_POINTS };
        let more = diffraction::of_pupils(&pupils, &more)?;
        if let [found] = &more.curves[..] {
            lost.iter().zip(&found.transfer[0]).for_each(|(k, value)| curve.transfer[middle][*k] = *value);
            curve.error = curve.error.max(found.error);
        }
    }
    Ok(mtf)
}

/// What all fields share.
struct View<'a> {
    lens: &'a Lens,
    settings: &'a Settings,
    colours: &'a [(f64, f64)],
    systems: &'a [System],
    primary: &'a System,
}

impl View<'_> {
    /// Rays of all wavelengths of the field `angle_deg` through about `count` points.
    fn beams(&self, angle_deg: f64, count: usize) -> Vec<Beam> {
        let points = stop_points(count);
        let of = |system: &System| {
            look();
            Beam::new(system, object(self.lens, angle_deg), &points)
        };
        self.systems.par_iter().map(of).collect()
    }

    fn field(&self, angle_deg: f64, frequencies: &Frequencies) -> Field {
        let of =
            |beams: &[Beam]| joined(beams.iter().zip(self.colours).map(|(b, (_, share))| (&b.landings[..], *share)));
        let (beams, fewer) = (self.beams(angle_deg, self.settings.rays), self.beams(angle_deg, self.settings.rays / 4));
        let drawn = self.beams(angle_deg, self.settings.drawn).into_iter().map(|b| b.landings).collect();
        let (rays, quarter) = (of(&beams), of(&fewer));
        let whole = spot(&rays, 0.0);
        let rms = whole.map(|s| Sampled {
            value: s.rms,
            change: spot(&quarter, 0.0).map_or(f64::INFINITY, |q| (s.rms - q.rms).abs()),
        });
        let [mtf, coarse] = [&rays, &quarter].map(|rays| frequencies.mtf(rays, 0.0));
        let differences = mtf.iter().zip(&coarse).flat_map(|(a, b)| [a[0] - b[0], a[1] - b[1]]);
        // Without light there is neither.
        let mtf_change = whole.map_or(f64::NAN, |_| differences.fold(0.0, |m: f64, d| m.max(d.abs())));
        let point = object(self.lens, angle_deg);
        let chief = reference(self.primary, point);
        let fans = |make: &dyn Fn(&System, DVec2) -> Fans| -> Vec<Fans> {
            chief.map_or(Vec::new(), |from| self.systems.iter().map(|s| make(s, from)).collect())
        };
        let best = best_focus(&rays);
        let every = self.settings.rays / 64;
        let within = encircled(&rays, 0.0);
        let [half, most, nearly] = [0.5, 0.8, 0.95].map(|part| radius_of(&within, part));
        Field {
            angle_deg,
            chief,
            spot: whole,
            rms,
            best_focus: best,
            best_rms: best.and_then(|b| spot(&rays, b[2])).map(|s| s.rms),
            open_part: beams.iter().zip(self.colours).map(|(b, (_, share))| share * b.open_part()).sum(),
            transverse: fans(&|s, from| transverse(s, point, from, self.settings.fan)),
            path: fans(&|s, from| path(s, point, from, self.settings.fan)),
            encircled: thinned(&within, every.max(1)),
            diffracted: None,
            energy: half.zip(most).zip(nearly).map(|((a, b), c)| [a, b, c]),
            mtf,
            mtf_change,
            through_focus: Vec::new(),
            map: None,
            diffraction: None,
            failure: beams.iter().find_map(|b| b.failure),
            beams,
            drawn,
        }
    }

    /// The largest shift of the image plane that tells something: what the fields' foci lie apart, two depths of focus at least
    /// (`2 λ N²`, or two pixels of blur), a tenth of the focal length at most.
    fn shift(&self, fields: &[Field], f_number: f64) -> f64 {
        let foci = fields.iter().filter_map(|f| f.best_focus).flatten().fold(0.0, |m: f64, z| m.max(z.abs()));
        let depth =
            (2.0 * self.primary.wavelength_nm * 1e-6 * f_number * f_number).max(self.lens.sensor.pitch_mm() * f_number);
        let focal = paraxial::first_order(self.lens, self.primary.wavelength_nm).effective_focal_length.abs();
        let wanted = (1.25 * foci).max(2.0 * depth).min(0.1 * focal);
        if wanted.is_finite() && wanted > 0.0 { wanted } else { 0.1 }
    }
}

/// Every so many of a curve's points, the ends included.
fn thinned(points: &[[f64; 2]], every: usize) -> Vec<[f64; 2]> {
    let last = points.len().saturating_sub(1);
    points.iter().enumerate().filter(|(k, _)| k % every == 0 || *k == last).map(|(_, p)| *p).collect()
}

impl Field {
    /// Rays of all wavelengths as one spot.
    pub fn rays(&self, colours: &[(f64, f64)]) -> Vec<Landing> {
        joined(self.beams.iter().zip(colours).map(|(b, (_, share))| (&b.landings[..], *share)))
    }

    fn over_focus(&self, colours: &[(f64, f64)], shifts_mm: &[f64], frequencies: &Frequencies) -> Vec<Vec<Pair>> {
        let rays = self.rays(colours);
        shifts_mm.iter().map(|dz| frequencies.mtf(&rays, *dz)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;

    #[test]
    fn a_lens_is_looked_at_as_asked() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let settings = Settings { rays: 400, frequencies: 11, places: 9, fan: 21, ..Settings::usual(&lens, 20.0) };
        let found = Overview::new(&lens, settings);
        assert_eq!((found.fields.len(), found.curve.len(), found.zones.len()), (5, 9, 9));
        assert_eq!((found.shifts_mm.len(), found.shifts_mm[6]), (13, 0.0));
        for field in &found.fields {
            assert_eq!((field.mtf.len(), field.mtf[0]), (11, [1.0, 1.0]));
            let (on, at) = (&field.mtf, &field.through_focus[6]);
            assert_eq!(on, at, "no shift");
            let rms = field.rms.expect("light");
            assert!(field.best_rms.expect("light") <= rms.value && rms.change < 0.05 * rms.value, "{rms:?}");
        }
        // Waves: on the axis both directions are alike, and nothing is above the limit.
        for field in &found.fields {
            let mtf = field.diffraction.as_ref().expect("asked").as_ref().expect("light");
            for curve in &mtf.curves {
                for (k, limit) in curve.limit.iter().enumerate() {
                    assert!(curve.modulus(6, k).expect("followed") <= limit + 1e-3, "{} {k}", field.angle_deg);
                }
            }
            let (map, fit) = field.map.as_ref().expect("light");
            assert!(map.best.rms <= map.figures.rms && fit.as_ref().expect("a whole pupil").residual_rms < 0.02);
        }
        // Energy by diffraction lies farther out than the perfect lens's, and its Strehl ratio on the axis is the wavefront's, nearly: other wavelengths are in it.
        for field in &found.fields {
            let energy = field.diffracted.as_ref().expect("asked").as_ref().expect("light");
            let [half, most, nearly] = energy.radii.map(|r| r.expect("told"));
            assert!(0.3 * found.airy_radius < half && half < most && most < nearly, "{:?}", energy.radii);
            assert!(energy.strehl > 0.0 && energy.strehl < 1.0 && energy.residual_waves < 1e-3, "{energy:?}");
            assert!(energy.encircled.windows(2).all(|w| w[0][1] <= w[1][1] + 1e-4), "rises");
            // Where blur is many times what bends, rays have it, too.
            let rays = field.energy.expect("light");
            eprintln!("{}°: {:?} {rays:?} {}", field.angle_deg, energy.radii, energy.strehl);
            if rays[1] > 4.0 * found.airy_radius {
                assert!((most / rays[1] - 1.0).abs() < 0.25, "{most} {}", rays[1]);
            }
        }
        // On the axis both directions are alike.
        assert!(found.fields[0].mtf.iter().all(|[t, s]| (t - s).abs() < 2e-3));
    }

    #[test]
    fn a_field_without_light_is_said_to_be_dark() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let settings = Settings { rays: 100, angles_deg: vec![0.0, 80.0], places: 5, ..Settings::usual(&lens, 20.0) };
        let found = Overview::new(&lens, settings);
        let dark = &found.fields[1];
        assert!(dark.spot.is_none() && dark.rms.is_none() && dark.open_part == 0.0 && dark.encircled.is_empty());
        assert!(dark.diffracted.as_ref().expect("asked").as_ref().is_err_and(|why| why.contains("no light")));
        assert!(found.fields[0].diffracted.as_ref().expect("asked").is_ok());
        assert!(dark.mtf.iter().flatten().all(|v| v.is_nan()) && dark.mtf_change.is_nan());
    }
}
