//! Lenses at their stops, as kernels see them, and what is measured of kernels.

use std::time::Instant;

use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Aperture, Lens, builtin};
use isoplanat::psf::{Model, Optics, Quadrature, SensorPoint};

/// Shares of a kernel's light that its window leaves to geometry and how many `λ/NA` it follows what bends.
const OUTSIDE: f64 = 5e-3;
const BENT: f64 = 8.0;
/// Largest half-width of a window, pixels.
const WIDEST: f64 = 150.0;

/// A lens at one stop, with rays and waves of it.
pub(crate) struct Case {
    pub(crate) lens: Lens,
    /// Kernels of rays.
    pub(crate) rays: Optics,
    /// Of rays convolved with the open pupil's diffraction.
    pub(crate) approximate: Optics,
    /// By diffraction.
    pub(crate) waves: Optics,
    pub(crate) radius_mm: f64,
}

/// A quadrature of so many wavelengths over the generic sensor's three channels.
pub(crate) fn colours(count: usize) -> Quadrature {
    let spectrum = SpectralDensity::new(&Sensor::generic()).quadrature(count);
    Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() }
}

/// A quadrature of one wavelength.
pub(crate) fn one(nm: f64) -> Quadrature {
    Quadrature { nm: vec![nm], weight: vec![vec![1.0]] }
}

impl Case {
    /// `name` at an f-number (its own where none is given) over `radius_mm` of the sensor; nothing where it does not open so far.
    pub(crate) fn new(name: &str, f_number: Option<f64>, radius_mm: f64, quadrature: Quadrature) -> Option<Self> {
        let mut lens = builtin::lens(name).expect("shipped");
        if let Some(n) = f_number {
            lens = lens.changed(|l| l.aperture = Aperture::FNumber(n)).ok()?;
        }
        let rays = Optics::even(&lens, radius_mm, vec![lens.object_vergence], quadrature, 64).ok()?;
        let [approximate, waves] =
            [Model::Approximate, Model::Waves].map(|model| rays.clone().diffracting(&lens, model).ok());
        Some(Self { lens, rays, approximate: approximate?, waves: waves?, radius_mm })
    }

    pub(crate) fn point(&self, share: f64) -> SensorPoint {
        SensorPoint::along([0.6, 0.8], share * self.radius_mm)
    }

    /// Side of a window, pixels, that holds what rays and diffraction blur at a point.
    pub(crate) fn window(&self, point: SensorPoint, pitch_mm: f64) -> usize {
        let look = self.rays.form(400, 1, 1, pitch_mm);
        let rays = self.rays.half_widths(&look, 0, &[OUTSIDE], [point.radius_mm(); 2])[0];
        // The bench's own measure of ten `λ/NA` is `bending_mm_at`.
        let bent = 0.1 * BENT * self.waves.bending_mm_at(0, &[point]);
        2 * ((rays as f64 + (bent / pitch_mm).ceil()).min(WIDEST) as usize) + 1
    }
}

/// Largest difference over the largest value of `exact`, and that of all together, root of the sums of squares.
pub(crate) fn errors(found: &[f64], exact: &[f64]) -> [f64; 2] {
    let peak = exact.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let worst = found.iter().zip(exact).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
    let square = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>().sqrt();
    let norm = square(&mut exact.iter().copied());
    [worst / peak, square(&mut found.iter().zip(exact).map(|(a, b)| a - b)) / norm]
}

/// Milliseconds of processor time of a piece of work on one thread: the median of three times as many runs as a fifth of a second holds. Processor time hardly sees what else
/// the machine does, but is counted in steps of some milliseconds.
pub(crate) fn milliseconds(mut work: impl FnMut() + Send) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("starts");
    pool.install(|| {
        let clock = Instant::now();
        work();
        let runs = (0.2 / clock.elapsed().as_secs_f64().max(1e-6)).ceil().max(1.0);
        let mut timed = || {
            let (clock, before) = (Instant::now(), processor());
            (0..runs as usize).for_each(|_| work());
            let wall = clock.elapsed().as_secs_f64();
            1e3 / runs * before.zip(processor()).map_or(wall, |(a, b)| b - a)
        };
        let mut all = [timed(), timed(), timed()];
        all.sort_by(f64::total_cmp);
        all[1]
    })
}

/// Seconds that this thread has run (`schedstat`, proc(5)); nothing where the system does not say.
fn processor() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse::<f64>().ok().map(|nanoseconds| 1e-9 * nanoseconds)
}

/// `1.2e-3`.
pub(crate) fn short(v: f64) -> String {
    format!("{v:.1e}")
}
