//! The diffraction transfer function of one object point: autocorrelation of the pupil.
//!
//! The pupil lives in the optical direction cosines `q = n(L, M)` of the rays at the image, where a frequency `f` of the image
//! plane is a displacement by `λf` (J. W. Goodman, *Introduction to Fourier Optics*, §6.3; H. H. Hopkins, Proc. Phys. Soc. B 70,
//! 1002, 1957): obliquity needs no factor. `P(q) = √E e^{2πiV/λ}`, `E` the light per area of `q`, `V` the path of the plane wave `q`
//! through one point of the image plane, the primary wavelength's chief ray there. Rays of the open part of the stop give `V`, `√E`
//! and the clear apertures' `1 − r²/a²` as polynomials in `q` ([`Pupil`]); the overlap is integrated between the exact edges.
//! A shift of the image plane by `z` adds `z √(n² − q²)` to `V`, no new rays.
//!
//! Accuracy (tests): 1e-4 against closed forms. The two samplings of [`Curve::error`] tell how exact an integral is, not the fit: that
//! is [`Mtf::residual_waves`]. Scalar theory: no polarisation, no diffraction between the surfaces.
//!
//! ```
//! use isoplanat_optics::analysis::diffraction::{self, Plan};
//! use isoplanat_optics::lens::builtin;
//! use isoplanat_optics::trace::ObjectPoint;
//!
//! let lens = builtin::lens("double_gauss")?;
//! let object = ObjectPoint::in_field(&lens, 5f64.to_radians(), std::f64::consts::FRAC_PI_2);
//! let mtf = diffraction::of_lens(&lens, object, &Plan::new(object, vec![0.0, 10.0, 40.0])).expect("light");
//! let [tangential, sagittal] = &mtf.curves[..] else { unreachable!() };
//! assert!((tangential.modulus(0, 0).unwrap() - 1.0).abs() < 1e-9);
//! assert!(sagittal.modulus(0, 2).unwrap() < sagittal.limit[2]);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

mod chords;
mod correlate;
mod fault;
mod fit;
mod gauss;
mod pupil;

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::wavefront::rays::chief_landing;
use crate::lens::Lens;
use crate::trace::aim::Aimer;
use crate::trace::{ObjectPoint, System};
use chords::Chords;
use correlate::{largest, overlap};
use gauss::Rules;
use isoplanat_base::stop::look;

pub use fault::Fault;
pub use pupil::Pupil;

/// First zero of the Airy pattern times the cutoff: `r = 0.6098 λ/NA`, cutoff `2 NA/λ`.
const AIRY: f64 = 1.219_669_891_266_504_5;
/// How many times as many points the second sampling of [`Curve::error`] has each way, and how many frequencies it looks at.
const FINER: (f64, usize) = (1.4, 5);

/// What is asked.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Directions of the image plane along which the frequency runs.
    pub directions: Vec<DVec2>,
    /// Cycles/mm, not negative.
    pub frequencies: Vec<f64>,
    /// Shifts of the image plane along the light, mm; evenly spaced ones are fastest.
    pub focus_mm: Vec<f64>,
    /// Most points each way of an overlap, up to 720: where blur has more cycles than about a third of them there is no value. Time goes
    /// with the square of what is needed.
    pub most_points: f64,
}

impl Plan {
    /// The most that can be asked for.
    pub(crate) const MOST_POINTS: f64 = Rules::MOST;

    /// The tangential and the sagittal direction of `object`, in focus.
    pub fn new(object: ObjectPoint, frequencies: Vec<f64>) -> Self {
        Self {
            directions: directions(object).to_vec(),
            frequencies,
            focus_mm: vec![0.0],
            most_points: Self::MOST_POINTS,
        }
    }
}

/// Tangential and sagittal direction of an object point: in its meridian and across; y and x for one on the axis.
pub(crate) fn directions(object: ObjectPoint) -> [DVec2; 2] {
    let across = object.direction.truncate();
    let tangential = if across.length() > 1e-12 { across.normalize() } else { DVec2::Y };
    [tangential, -tangential.perp()]
}

/// Transfer functions of one object point.
#[derive(Clone, Debug)]
pub struct Mtf {
    /// One for each direction.
    pub curves: Vec<Curve>,
    /// Light that reaches the image by wavelength, weights left out: comparable between wavelengths of one object point.
    pub light: Vec<f64>,
    /// Largest root mean square residual of the fits of `V`, wavelengths.
    pub residual_waves: f64,
}

/// One direction.
#[derive(Clone, Debug)]
pub struct Curve {
    /// The direction, a unit vector.
    pub direction: DVec2,
    /// `[focus][frequency]`, 1 at frequency 0, `e^{−2πi f x}` for a point image at `x`; `None` where the blur has so many
    /// cycles ([`Plan::most_points`]) that the phase is not followed.
    pub transfer: Vec<Vec<Option<Complex<f64>>>>,
    /// The same pupils without aberration: the diffraction limit, by frequency.
    pub limit: Vec<f64>,
    /// Highest frequency of any wavelength, cycles/mm.
    pub cutoff: f64,
    /// Radius of the first dark ring of a round pupil with the first wavelength's cutoff, mm.
    pub airy_mm: f64,
    /// Largest difference from a sampling with 1.4 times as many points each way, at five of the frequencies.
    pub error: f64,
}

impl Curve {
    /// The modulus, at numbers of a focus and a frequency.
    pub fn modulus(&self, focus: usize, frequency: usize) -> Option<f64> {
        self.transfer.get(focus)?.get(frequency)?.map(|t| t.norm())
    }
}

/// The transfer functions of `object` in the light of `lens`, by the weights of its wavelengths.
///
/// # Errors
/// `Fault`; wavelengths without light add none.
pub fn of_lens(lens: &Lens, object: ObjectPoint, plan: &Plan) -> Result<Mtf, Fault> {
    of_pupils(&pupils(lens, object)?, plan)
}

/// The pupils of `object` in the light of `lens`, about the primary wavelength's chief ray, with the weights of their wavelengths.
///
/// # Errors
/// As [`of_lens`].
pub(crate) fn pupils(lens: &Lens, object: ObjectPoint) -> Result<Vec<(Pupil, f64)>, Fault> {
    let primary = System::new(lens, lens.wavelengths.primary_nm);
    let centre = chief_landing(&Aimer::new(&primary)?, object)?;
    let shares: Vec<(f64, f64)> = lens.wavelengths.shares().collect();
    let traced: Vec<Result<Pupil, Fault>> = shares
        .par_iter()
        .map(|(nm, _)| {
            let system = System::new(lens, *nm);
            Pupil::trace(&Aimer::new(&system)?, object, centre)
        })
        .collect();
    let mut pupils = Vec::new();
    for (pupil, (_, weight)) in traced.into_iter().zip(&shares) {
        match pupil {
            Ok(pupil) => pupils.push((pupil, *weight)),
            // A colour without light has none to add; one whose edge is not known would leave the others' sum wrong.
            Err(Fault::Dark) => {}
            Err(fault) => return Err(fault),
        }
    }
    Ok(pupils)
}

/// The transfer functions of pupils about one common point, each with its weight.
///
/// # Errors
/// `Fault::Dark` without light.
pub fn of_pupils(pupils: &[(Pupil, f64)], plan: &Plan) -> Result<Mtf, Fault> {
    let mut mtf = Mtf { curves: Vec::new(), light: Vec::new(), residual_waves: 0.0 };
    let most = plan.most_points.clamp(64.0, Rules::MOST);
    for direction in &plan.directions {
        let direction = direction.normalize_or(DVec2::Y);
        let oriented: Vec<_> = pupils
            .par_iter()
            .map(|(pupil, _)| {
                let pupil = pupil.along(direction);
                let chords = Chords::new(&pupil);
                (pupil, chords)
            })
            .collect();
        let points =
            oriented.iter().map(|(p, _)| largest(p, &plan.frequencies, &plan.focus_mm).min(most)).fold(64.0, f64::max);
        let rules = Rules::up_to(FINER.0 * points);
        let zero = |fineness: f64| -> Vec<f64> {
            oriented.iter().map(|(p, chords)| overlap(p, chords, &rules, (0.0, &[]), most, fineness).limit).collect()
        };
        // All pupils at one frequency: transfer by focus, and limit.
        let at = |frequency: f64, light: &[f64], fineness: f64| {
            look();
            let whole: f64 = light.iter().zip(pupils).map(|(l, (_, weight))| l * weight).sum();
            let mut sums = vec![Some(Complex::new(0.0, 0.0)); plan.focus_mm.len()];
            let mut limit = 0.0;
            for ((p, chords), (_, weight)) in oriented.iter().zip(pupils) {
                let part = overlap(p, chords, &rules, (frequency, &plan.focus_mm), most, fineness);
                limit += weight * part.limit / whole;
                for (sum, part) in sums.iter_mut().zip(part.transfer) {
                    *sum = sum.zip(part).map(|(s, p)| s + p * (weight / whole));
                }
            }
            (sums, limit)
        };
        let light = zero(1.0);
        let whole: f64 = light.iter().zip(pupils).map(|(l, (_, weight))| l * weight).sum();
        if whole.is_nan() || whole <= 0.0 {
            return Err(Fault::Dark);
        }
        let all: Vec<_> = plan.frequencies.par_iter().map(|f| at(*f, &light, 1.0)).collect();
        // A finer sampling of some frequencies.
        let finer = zero(FINER.0);
        let every = plan.frequencies.len().div_ceil(FINER.1).max(1);
        let differences: Vec<f64> = (0..plan.frequencies.len())
            .into_par_iter()
            .filter(|k| k % every == every / 2)
            .map(|k| {
                let (sums, limit) = at(plan.frequencies[k], &finer, FINER.0);
                let pairs = sums.iter().zip(&all[k].0).filter_map(|(a, b)| Some((a.as_ref()? - b.as_ref()?).norm()));
                pairs.fold((limit - all[k].1).abs(), f64::max)
            })
            .collect();
        let transfer = (0..plan.focus_mm.len()).map(|z| all.iter().map(|(sums, _)| sums[z]).collect()).collect();
        let cutoffs: Vec<f64> = oriented.iter().map(|(p, chords)| chords.longest() * p.half.x / p.wavelength).collect();
        mtf.residual_waves = oriented.iter().map(|(p, _)| p.residual).fold(mtf.residual_waves, f64::max);
        mtf.light = light;
        mtf.curves.push(Curve {
            direction,
            transfer,
            limit: all.iter().map(|(_, limit)| *limit).collect(),
            cutoff: cutoffs.iter().copied().fold(0.0, f64::max),
            airy_mm: AIRY / cutoffs[0],
            error: differences.into_iter().fold(0.0, f64::max),
        });
    }
    Ok(mtf)
}

impl Pupil {
    /// The transfer function along `direction` by counting points of a raster of direction cosines, `count` across, the copy
    /// displaced by `points` of them: the frequency (cycles/mm), the transfer function, the limit.
    ///
    /// Plain and slow, beside [`of_pupils`]; its error falls as `1/count`.
    pub fn counted(&self, direction: DVec2, count: u32, points: u32, focus_mm: f64) -> (f64, Complex<f64>, f64) {
        let pupil = self.along(direction);
        let (_, whole) = correlate::counted(&pupil, count, 0, focus_mm);
        let (transfer, limit) = correlate::counted(&pupil, count, points, focus_mm);
        let frequency = 2.0 * f64::from(points) / f64::from(count) * pupil.half.x / pupil.wavelength;
        (frequency, transfer / whole, limit / whole)
    }
}

#[cfg(test)]
mod tests;
