//! Kernels by diffraction: what one costs, forward and with its pull-back to the lens.

use std::time::Instant;

use isoplanat::lens::{Aperture, builtin};
use isoplanat::psf::{KernelForm, Model, Optics, OpticsBar, OpticsSpec, Quadrature, SensorPoint};

use super::cases::pool;

/// Lens, f-number, farthest sensor radius and pixel pitch, mm.
const CASES: [(&str, Option<f64>, f64, f64); 5] = [
    ("double_gauss", Some(2.8), 7.0, 4e-3),
    ("double_gauss", Some(8.0), 7.0, 4e-3),
    ("double_gauss", Some(16.0), 7.0, 4e-3),
    ("phone", None, 2.6, 1.1e-3),
    ("two_element", Some(8.0), 12.0, 4e-3),
];
/// Sides of windows, pixels.
const SIZES: [usize; 4] = [15, 31, 63, 127];

/// Three wavelengths, three channels that see one each, at as many points as keep two threads busy; milliseconds a point, both threads' time taken together.
pub(crate) fn print() {
    println!("| lens | f-number | window, px | transform | polynomials' degree | kernels, ms | with gradient, ms |");
    println!("|---|---|---|---|---|---|---|");
    for (name, f_number, radius_mm, pitch_mm) in CASES {
        let mut lens = builtin::lens(name).expect("shipped");
        if let Some(n) = f_number {
            lens = lens.changed(|l| l.aperture = Aperture::FNumber(n)).expect("closes");
        }
        let weight = (0..3).map(|c| (0..3).map(|l| f64::from(u8::from(c == l))).collect()).collect();
        let quadrature = Quadrature { nm: vec![470.0, 550.0, 620.0], weight };
        let spec = OpticsSpec::even(radius_mm, vec![lens.object_vergence], quadrature);
        let optics = Optics::compute(&lens, &spec).and_then(|o| o.diffracting(&lens, Model::Waves)).expect("traces");
        let points: Vec<SensorPoint> =
            (0..16u32).map(|k| SensorPoint::along([0.6, 0.8], radius_mm * f64::from(k) / 16.0)).collect();
        for size in SIZES {
            let form = KernelForm { keeps_light: true, ..optics.form(400, size, 1, pitch_mm) };
            let len = form.channels() * form.raster.len();
            let pupil = optics.pupil(0, 0, points[8]).expect("light");
            let pool = pool(2);
            let timed = |f: &(dyn Fn() + Sync)| {
                pool.install(f);
                let rounds = 3;
                let clock = Instant::now();
                (0..rounds).for_each(|_| pool.install(f));
                1e3 * clock.elapsed().as_secs_f64() / f64::from(rounds) / points.len() as f64
            };
            let forward = timed(&|| {
                optics.kernels_each(&form, 0, &points, |_, k, _| k[len / 2]);
            });
            let both = timed(&|| {
                optics.kernels_each(&form, 0, &points, |_, k, _| k[len / 2]);
                let mut bar = OpticsBar::zeros(&optics);
                let fill = |_: usize, out: &mut [f64]| {
                    out.iter_mut().enumerate().for_each(|(k, v)| *v = (k % 7) as f64);
                    true
                };
                optics.kernels_vjp(&form, 0, &points, fill).iter().for_each(|b| bar.add_kernel(&optics, 0, b));
            });
            let n = pupil.transform_size(size as f64 * pitch_mm);
            let f = f_number.map_or_else(|| "own".to_owned(), |n| n.to_string());
            println!("| {name} | {f} | {size} | {n} | {} | {forward:.2} | {both:.2} |", pupil.degree());
        }
    }
}
