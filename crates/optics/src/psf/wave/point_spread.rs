//! The point spread itself, before pixel and scene sample: Strehl ratio and encircled energy.
//!
//! Every wavelength of a sensor point stands on a raster of the same period `P`. The light that lands `d` from where distortion alone would put it is then one sum over frequencies,
//! `h(d) = Σ_q c_q e^{−2πi q·d/P}/P²`, all wavelengths by their light. `c_q` is the transfer function at the frequency `q/P`, `c₀ = 1`. Light that [`Pupil::kernel`] spreads evenly over the
//! period is in `c₀`, as in kernels.
//!
//! - *Strehl ratio*: the largest value of `h` anywhere in the image plane, over that of the same pupils (amplitudes as they are) without path differences. Of several wavelengths it is the
//!   peak of their sum over the peak of the perfect sum. Tilt and lateral colour that all wavelengths have in common do not lower it.
//! - *Encircled energy*: the integral of `h` over a circle about the centroid, `Σ_q c_q e^{−2πi q·m/P} r J₁(2πr|q|/P)/(P|q|)`. The centroid `m` is that of rays: the mean of the path's
//!   slopes by light.
//!
//! Light farther out than half a period is folded back into it: of a perfect lens 3e-3, nearly evenly.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use glam::{DMat2, DVec2};
use ndarray::{Array2, s};
use rustfft::num_complex::Complex;

use super::WaveFigures;
use super::functions::PupilFunctions;
use super::pupil::Pupil;
use super::raster::{Field, Sampling};
use isoplanat_base::math::fft::{fft_rows, good_size};
use isoplanat_base::math::memory::product;
use isoplanat_base::stop::look;

/// What is kept around the blur, in λ/NA.
const AROUND: f64 = 56.0;
/// Samples of the pupil up to which peaks are looked for on twice the places that a frequency needs.
const FINE: usize = 512;
/// Peaks of the grid, at least so high a part of its highest, from which a peak is looked for; most of them.
const NEARLY: f64 = 0.7;
const PEAKS: usize = 12;
/// Places a unit of frequency at which rings of frequencies stand.
const RINGS: f64 = 16.0;
/// Halvings of a radius.
const HALVINGS: u32 = 40;
/// Steps by which a radius is looked for.
const STEPS: u32 = 256;

/// Why there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Untold {
    /// No light.
    #[error("no light reaches the sensor")]
    Dark,
    /// Hundreds of waves.
    #[error("the blur has hundreds of waves")]
    Blurred,
    /// Paths or light that the polynomials of a pupil do not follow.
    #[error("paths are not told there well enough for waves")]
    Unfollowed,
}

/// The light of one sensor point, all wavelengths by theirs.
#[derive(Clone, Debug)]
pub struct PointSpread {
    /// `P`, mm.
    period: f64,
    /// `c_q`, `[row, column]`: rows from 0 on, columns from `−most` on. Those of rows beyond 0 stand for their mirror images, too.
    coefficients: Array2<Complex<f64>>,
    most: usize,
    /// The same about the centroid by `|q|`, `RINGS` places to 1.
    rings: Vec<f64>,
    /// Along columns and rows, mm; rows run outwards.
    centroid: DVec2,
    peak: DVec2,
    strehl: f64,
    figures: WaveFigures,
}

/// What one wavelength adds.
struct Part {
    /// Half of the autocorrelation of its amplitudes, as [`PointSpread::coefficients`].
    correlation: Array2<Complex<f64>>,
    far: usize,
    /// `∫a² dτ`, what its raster lacks of it, and the peak without path differences times the square of the period.
    light: f64,
    lost: f64,
    perfect: f64,
    mean: DVec2,
}

impl Part {
    fn new(pupil: &PupilFunctions, period: f64) -> Option<Self> {
        look();
        let sampling = Sampling::new(pupil, [0.0, 1.0], period);
        let field = pupil.field(&sampling);
        if field.light.is_nan() || field.light <= 0.0 {
            return None;
        }
        let far = field.across().max(1) - 1;
        let area = sampling.step * sampling.step;
        let correlation = half_correlation(&field, far) * Complex::new(area, 0.0);
        let perfect = area * field.undisturbed().powi(2) + field.lost;
        let Field { light, lost, .. } = field;
        Some(Self { correlation, far, light, lost, perfect, mean: pupil.mean_slope(&field) })
    }
}

/// Autocorrelation `Σ A_{m+q} A*_m` of the amplitudes: `[row, column]`, rows from 0 to `far`, columns from `−far` to `far`.
fn half_correlation(field: &Field, far: usize) -> Array2<Complex<f64>> {
    let n = good_size(2 * far + 1);
    let (rows, cols) = field.amplitude.dim();
    let none = Complex::new(0.0, 0.0);
    let mut lines = Array2::from_elem((rows, n), none);
    lines.slice_mut(s![.., ..cols]).assign(&field.amplitude);
    fft_rows(&mut lines, true);
    let mut all = Array2::from_elem((n, n), none);
    all.slice_mut(s![.., ..rows]).assign(&lines.t());
    drop(lines);
    fft_rows(&mut all, true);
    // `[column, row]` now.
    all.mapv_inplace(|v| Complex::new(v.norm_sqr(), 0.0));
    fft_rows(&mut all, false);
    let mut half = all.slice(s![.., ..=far.min(n - 1)]).t().as_standard_layout().into_owned();
    drop(all);
    fft_rows(&mut half, false);
    let unit = 1.0 / (n * n) as f64;
    Array2::from_shape_fn((far + 1, 2 * far + 1), |(i, j)| half[[i, (j + n - far) % n]] * unit)
}

impl PointSpread {
    /// Of the pupils that one sensor point has at several wavelengths, with the weights of these beside the light that they let through.
    ///
    /// # Errors
    /// No light; a blur of hundreds of waves.
    pub fn new(pupils: &[(Pupil, f64)]) -> Result<Self, Untold> {
        let lit = || pupils.iter().filter(|(_, w)| *w > 0.0);
        let period = period(lit().map(|(p, _)| p))?;
        let mut parts = Vec::new();
        for (pupil, weight) in lit() {
            if let Some(part) = Part::new(&pupil.functions, period) {
                parts.push((part, *weight, pupil));
            }
        }
        let light: f64 = parts.iter().map(|(p, w, _)| w * p.light).sum();
        if parts.is_empty() || !(light.is_finite() && light > 0.0) {
            return Err(Untold::Dark);
        }
        let most = parts.iter().map(|(p, ..)| p.far).max().unwrap_or(0);
        let mut made = Self {
            period,
            coefficients: Array2::from_elem((most + 1, 2 * most + 1), Complex::new(0.0, 0.0)),
            most,
            rings: Vec::new(),
            centroid: DVec2::ZERO,
            peak: DVec2::ZERO,
            strehl: 0.0,
            figures: WaveFigures::default(),
        };
        let mut perfect = 0.0;
        for (part, weight, pupil) in parts {
            let (far, share) = (part.far, weight / light);
            let mut to = made.coefficients.slice_mut(s![..=far, most - far..=most + far]);
            to.scaled_add(Complex::new(share, 0.0), &part.correlation);
            made.coefficients[[0, most]] += share * part.lost;
            made.centroid += share * part.light * part.mean;
            perfect += share * part.perfect;
            made.figures = made.figures.or(pupil.figures(part.lost / part.light));
        }
        made.coefficients.slice_mut(s![1.., ..]).mapv_inplace(|c| 2.0 * c);
        made.rings = made.rings();
        let (peak, value) = made.highest();
        (made.peak, made.strehl) = (peak, value / perfect);
        Ok(made)
    }

    /// Bytes, from above, that [`Self::new`] takes for these pupils.
    pub(in crate::psf) fn bytes<'a>(pupils: impl Iterator<Item = &'a Pupil> + Clone) -> u64 {
        let Ok(period) = period(pupils.clone()) else { return 0 };
        let side = |p: &Pupil| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count, from above")]
            let across = (2.0 * p.functions.fitted.half.length() * period / p.wavelength_mm + 10.0).ceil() as usize;
            good_size(2 * across + 1)
        };
        pupils.map(side).max().map_or(0, |side| product(&[side, side, 160]))
    }

    /// The Strehl ratio.
    pub fn strehl(&self) -> f64 {
        self.strehl
    }

    /// Where the peak is, mm along columns and rows, which run outwards, from where distortion alone would put the light.
    pub fn peak(&self) -> DVec2 {
        self.peak
    }

    /// Where the centroid is, as [`Self::peak`].
    pub fn centroid(&self) -> DVec2 {
        self.centroid
    }

    /// What is to be told of it.
    pub fn figures(&self) -> &WaveFigures {
        &self.figures
    }

    /// The largest radius that is told, mm.
    pub fn farthest(&self) -> f64 {
        0.5 * self.period
    }

    /// Share of the light within a circle of `radius_mm` about the centroid; at most that of [`Self::farthest`].
    pub fn encircled(&self, radius_mm: f64) -> f64 {
        if radius_mm.is_nan() || radius_mm <= 0.0 {
            return 0.0;
        }
        let r = radius_mm.min(self.farthest()) / self.period;
        let of = |(k, c): (usize, &f64)| {
            let f = k as f64 / RINGS;
            c * r * if k == 0 { PI * r } else { bessel1(TAU * r * f) / f }
        };
        self.rings.iter().enumerate().map(of).sum()
    }

    /// Radius about the centroid that holds the share `part` of the light, mm; none where that is not told.
    pub fn radius_of(&self, part: f64) -> Option<f64> {
        let at = |k: u32| self.farthest() * f64::from(k) / f64::from(STEPS);
        let first = (1..=STEPS).find(|k| self.encircled(at(*k)) >= part)?;
        let (mut low, mut high) = (at(first - 1), at(first));
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            *(if self.encircled(middle) < part { &mut low } else { &mut high }) = middle;
        }
        Some(high)
    }

    /// Coefficients about the centroid by `|q|`, to four places around it: what is read from them is even and smooth over `|q|`.
    fn rings(&self) -> Vec<f64> {
        let longest = (self.most as f64).hypot(self.most as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small counts")]
        let mut rings = vec![0.0; (longest * RINGS) as usize + 4];
        let [x, y] = (-TAU / self.period * self.centroid).to_array();
        let across: Vec<Complex<f64>> = self.columns().map(|q| Complex::cis(x * q)).collect();
        for (i, row) in self.coefficients.rows().into_iter().enumerate() {
            let along = Complex::cis(y * i as f64);
            for ((c, turn), q) in row.iter().zip(&across).zip(self.columns()) {
                let value = (c * turn * along).re;
                let place = q.hypot(i as f64) * RINGS;
                let t = place.fract();
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small counts")]
                let k = place as usize;
                let (a, b, c) = (t + 1.0, 1.0 - t, 2.0 - t);
                rings[if k == 0 { 1 } else { k - 1 }] -= value * t * b * c / 6.0;
                rings[k] += value * a * b * c / 2.0;
                rings[k + 1] += value * a * t * c / 2.0;
                rings[k + 2] -= value * a * t * b / 6.0;
            }
        }
        rings
    }

    /// Frequencies of the columns.
    fn columns(&self) -> impl Iterator<Item = f64> {
        let most = self.most as f64;
        (0..=2 * self.most).map(move |j| j as f64 - most)
    }

    /// `h P²` at `d`, its slopes and its second derivatives.
    fn at(&self, d: DVec2) -> (f64, DVec2, DMat2) {
        let unit = TAU / self.period;
        let across: Vec<(f64, Complex<f64>)> = self.columns().map(|q| (q, Complex::cis(-unit * q * d.x))).collect();
        let (mut value, mut slope, mut bend) = (0.0, DVec2::ZERO, [0.0; 3]);
        for (i, row) in self.coefficients.rows().into_iter().enumerate() {
            let mut sums = [Complex::new(0.0, 0.0); 3];
            for (c, (q, turn)) in row.iter().zip(&across) {
                let v = c * turn;
                sums[0] += v;
                sums[1] += v * *q;
                sums[2] += v * (q * q);
            }
            let y = i as f64;
            let turn = Complex::cis(-unit * y * d.y);
            let [a, b, c] = sums.map(|s| s * turn);
            value += a.re;
            // `−i u q v` has the real part `u q v.im`.
            slope += unit * DVec2::new(b.im, y * a.im);
            let square = unit * unit;
            bend[0] -= square * c.re;
            bend[1] -= square * y * b.re;
            bend[2] -= square * y * y * a.re;
        }
        (value, slope, DMat2::from_cols(DVec2::new(bend[0], bend[1]), DVec2::new(bend[1], bend[2])))
    }

    /// Where `h` is largest, and `h P²` there: from the highest places of a grid on by Newton's steps.
    fn highest(&self) -> (DVec2, f64) {
        let finer = if self.most <= FINE { 2 } else { 1 };
        let n = good_size(finer * 2 * self.most + 1);
        let none = Complex::new(0.0, 0.0);
        let mut lines = Array2::from_elem((self.most + 1, n), none);
        for (mut line, row) in lines.rows_mut().into_iter().zip(self.coefficients.rows()) {
            for (j, c) in row.iter().enumerate() {
                line[(j + n - self.most) % n] += c;
            }
        }
        fft_rows(&mut lines, true);
        let mut all = Array2::from_elem((n, n), none);
        all.slice_mut(s![.., ..=self.most]).assign(&lines.t());
        drop(lines);
        fft_rows(&mut all, true);
        // `[column, row]` now.
        let top = all.iter().fold(f64::NEG_INFINITY, |m, v| m.max(v.re));
        let around = |i: usize, j: usize| {
            [n - 1, 0, 1].into_iter().flat_map(move |a| [n - 1, 0, 1].map(|b| [(i + a) % n, (j + b) % n]))
        };
        let mut peaks: Vec<([usize; 2], f64)> = all
            .indexed_iter()
            .map(|((i, j), v)| ([i, j], v.re))
            .filter(|([i, j], v)| *v >= NEARLY * top && around(*i, *j).all(|at| all[at].re <= *v))
            .collect();
        drop(all);
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        let step = self.period / n as f64;
        let place = |k: usize| if 2 * k > n { k as f64 - n as f64 } else { k as f64 };
        let found =
            peaks.into_iter().take(PEAKS).map(|([i, j], _)| self.climbed(step * DVec2::new(place(i), place(j)), step));
        found.fold((DVec2::ZERO, f64::NEG_INFINITY), |best, next| if next.1 > best.1 { next } else { best })
    }

    /// The peak that a place of the grid is near to.
    fn climbed(&self, from: DVec2, step: f64) -> (DVec2, f64) {
        let mut here = (from, self.at(from));
        for _ in 0..12 {
            let (at, (value, slope, bend)) = here;
            let falls = bend.x_axis.x < 0.0 && bend.determinant() > 0.0;
            let by = if falls { -bend.inverse() * slope } else { step * slope.normalize_or_zero() };
            let mut by = by.clamp_length_max(step);
            if !by.is_finite() || by.length() < 1e-9 * step {
                break;
            }
            // Half as far where it does not rise.
            let mut next = (at + by, self.at(at + by));
            for _ in 0..3 {
                if next.1.0 >= value {
                    break;
                }
                by *= 0.5;
                next = (at + by, self.at(at + by));
            }
            if next.1.0 <= value {
                break;
            }
            here = next;
        }
        (here.0, here.1.0)
    }
}

/// The period of all pupils together, mm.
fn period<'a>(pupils: impl Iterator<Item = &'a Pupil> + Clone) -> Result<f64, Untold> {
    let wanted = pupils.clone().map(|p| p.period(4.0 * p.reach_mm() + AROUND * p.bend_mm())).fold(0.0, f64::max);
    if wanted == 0.0 {
        return Err(Untold::Dark);
    }
    // What the shortest wavelength's raster takes, however many times longer the longest is.
    let most = pupils.clone().map(|p| p.period(f64::INFINITY)).fold(f64::INFINITY, f64::min);
    let period = wanted.min(most);
    if pupils.clone().all(|p| p.is_told(0.0) && p.least() <= period) { Ok(period) } else { Err(Untold::Blurred) }
}

/// Bessel's function `J₁` of an argument that is not negative, to 1e-9: its series, and far out Hankel's.
fn bessel1(x: f64) -> f64 {
    if x < 14.0 {
        let square = -0.25 * x * x;
        let (mut term, mut sum, mut k) = (0.5 * x, 0.5 * x, 1.0);
        while k < 8.0 || f64::abs(term) > 1e-14 {
            term *= square / (k * (k + 1.0));
            sum += term;
            k += 1.0;
        }
        return sum;
    }
    let (mut even, mut odd, mut term) = (1.0, 0.0, 1.0);
    for k in 1..10_u32 {
        let m = f64::from(2 * k - 1);
        term *= (4.0 - m * m) / (8.0 * f64::from(k) * x);
        let signed = if k % 4 < 2 { term } else { -term };
        if k % 2 == 1 {
            odd += signed;
        } else {
            even += signed;
        }
    }
    let (sin, cos) = (x - 3.0 * FRAC_PI_4).sin_cos();
    (2.0 / (PI * x)).sqrt() * (even * cos - odd * sin)
}
