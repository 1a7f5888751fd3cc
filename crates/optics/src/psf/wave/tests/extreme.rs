//! Kernels where they are hard: a hundred waves of defocus, a sliver of a pupil, cells much smaller and much larger than what bends.

use super::*;

/// Kernel entries over cell area: light a square millimetre, in cells so small that pixel and tent leave it as it is.
fn densities(pupil: &Pupil, cell: f64, size: usize) -> Vec<f64> {
    let raster = Raster { size, samples: 1 };
    let mut kernel = vec![0.0; raster.len()];
    pupil.kernel([0.6, 0.8], raster, cell, &mut kernel);
    kernel.iter().map(|v| v / (cell * cell)).collect()
}

/// Out of focus, by as many waves as a raster tells: light on the axis is `sinc²(W)` of the focused peak, a whole number of waves is dark. Both to a part of the pattern's peak.
#[test]
fn middles_of_defocused_patterns_are_light_and_dark() {
    let (wavelength, na) = (5e-4_f64, 0.1_f64);
    let focused = PI * (na / wavelength).powi(2);
    let cell = 0.005 * wavelength / na;
    let middle = |waves: f64| {
        let pupil = Pupil::perfect(wavelength, na, waves);
        assert!(pupil.is_told(cell), "{waves}");
        densities(&pupil, cell, 5)[12]
    };
    for (waves, part) in [(1.0, 3e-3), (3.0, 3e-3), (10.0, 2e-2), (40.0, 2e-2), (70.0, 2e-2)] {
        let exact = focused / (PI * (waves + 0.5)).powi(2);
        let (light, dark) = (middle(waves + 0.5) / exact, middle(waves) / exact);
        eprintln!("{waves} waves: {light:.5} and {dark:.5} of the pattern's peak");
        assert!((light - 1.0).abs() < part && dark < part, "{waves}: {light} {dark}");
    }
    let many = Pupil::perfect(wavelength, na, 100.0);
    assert!(!many.is_told(cell), "as rays are");
}

/// `J₀(x)`, by Bessel's integral: exact for the arguments here, as even samples of a period are.
fn bessel0(x: f64) -> f64 {
    let n = 64 + 2 * x.abs() as usize;
    (0..n).map(|k| (x * (PI * (k as f64 + 0.5) / n as f64).sin()).cos()).sum::<f64>() / n as f64
}

/// In cells of half a `λ/NA`, as a phone's are, defocused patterns against Lommel's integral under pixel and tent: to 1e-3 of the pattern's peak for a few waves, to 6e-3 for
/// thirty, whose peak is a narrow spot of edges' light on the axis.
#[test]
fn defocused_kernels_are_lommels_integral() {
    let (wavelength, na) = (5e-4_f64, 0.1_f64);
    let unit = wavelength / na;
    for (waves, part) in [(0.3, 1e-3), (3.5, 1e-3), (10.5, 2e-3), (30.5, 6e-3)] {
        let pupil = Pupil::perfect(wavelength, na, waves);
        let (cell, size) = (0.5 * unit, 401);
        let raster = Raster { size, samples: 1 };
        let mut kernel = vec![0.0; raster.len()];
        pupil.kernel([0.6, 0.8], raster, cell, &mut kernel);
        // Light a square λ/NA at `r` λ/NA, by the midpoint rule over ρ².
        let steps = (60.0 * (waves + 10.0)) as usize;
        let density = |r: f64| {
            let at = |k: usize| {
                let square = (k as f64 + 0.5) / steps as f64;
                bessel0(TAU * r * square.sqrt()) * Complex::cis(TAU * waves * square)
            };
            PI * ((0..steps).map(at).sum::<Complex<f64>>() / steps as f64).norm_sqr()
        };
        // By distance, once.
        let table: Vec<f64> = (0..=1400).map(|k| density(f64::from(k) / 100.0)).collect();
        let at = |r: f64| {
            let x = r * 100.0;
            let k = x as usize;
            table[k] + (x - k as f64) * (table[k + 1] - table[k])
        };
        let fine = 24;
        let weight = |k: i32| pixel_on_tent(f64::from(k) / f64::from(fine));
        let value = |i: i32, j: i32| {
            let far = 3 * fine / 2;
            let mut sum = 0.0;
            for (a, b) in (-far..=far).flat_map(|a| (-far..=far).map(move |b| (a, b))) {
                let [y, x] = [(i, a), (j, b)].map(|(k, by)| 0.5 * (f64::from(k) + f64::from(by) / f64::from(fine)));
                sum += weight(a) * weight(b) * at(x.hypot(y));
            }
            sum * (0.5 / f64::from(fine)).powi(2)
        };
        let places = [(0, 0), (0, 1), (1, 1), (3, -2), (0, 7), (10, 10), (14, -3), (9, 20)];
        let found = |i: i32, j: i32| kernel[(200 + i) as usize * size + (200 + j) as usize];
        let peak = kernel.iter().copied().fold(0.0, f64::max);
        let worst = places.into_iter().map(|(i, j)| (found(i, j) - value(i, j)).abs() / peak).fold(0.0, f64::max);
        eprintln!("{waves} waves: worst {worst:.1e} of the pattern's peak {peak:.2e}");
        assert!(worst < part, "{waves}: {worst}");
    }
}

/// A strip of a round pupil, a fifteenth of its width, against the integral over it: to 1e-2 of the peak; its light is that of the strip alone.
#[test]
fn a_sliver_of_a_pupil_is_its_integral() {
    let (wavelength, na, share) = (5e-4_f64, 0.1_f64, 1.0_f64 / 15.0);
    let nodes = Part::WHOLE.nodes(6);
    let of = |f: &dyn Fn(&DVec2) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
    let even = vec![of(&|_| 0.0), of(&|s| na * s.y), of(&|s| s.y), of(&|s| 1.0 - (s.y / share).powi(2))];
    let odd = vec![of(&|s| na * s.x), of(&|s| s.x)];
    let tau = nodes.iter().map(|s| na * *s).collect();
    let pupil = Pupil::of(wavelength, Part::WHOLE, 6, (tau, [even, odd]), None).expect("spans an area");
    // Over the strip's height, `∫ sin(k x c)/(k x) e^{iky}` with the chord `c`; `(x, y)` across the meridian and along it.
    let wave = TAU / wavelength * na;
    let count = 2000;
    let heights = || (0..count).map(|k| share * (2.0 * (f64::from(k) + 0.5) / f64::from(count) - 1.0));
    let step = 2.0 * share / f64::from(count);
    let chord = |y: f64| (1.0 - y * y).sqrt();
    let area: f64 = heights().map(|y| 2.0 * chord(y) * step).sum();
    let density = |x: f64, y: f64| {
        let across = |c: f64| if x == 0.0 { 2.0 * c } else { 2.0 * (wave * x * c).sin() / (wave * x) };
        let sum: Complex<f64> = heights().map(|h| across(chord(h)) * step * Complex::cis(wave * y * h)).sum();
        sum.norm_sqr() / area * (na / wavelength).powi(2)
    };
    // Along the meridian it is fifteen times as wide as across.
    let cell = 0.02 * wavelength / na;
    let (size, half) = (601, 300);
    let found = densities(&pupil, cell, size);
    let peak = density(0.0, 0.0);
    let mut worst = 0.0f64;
    for (i, j) in
        [(0, 0), (0, 8), (8, 0), (20, -15), (-100, 75), (-10, -8), (200, 150), (280, 210), (-280, -210), (290, 218)]
    {
        let (down, right) = (f64::from(i) * cell, f64::from(j) * cell);
        let (x, y) = (-0.8 * right + 0.6 * down, 0.6 * right + 0.8 * down);
        let at = (half + i) as usize * size + (half + j) as usize;
        worst = worst.max((found[at] - density(x, y)).abs() / peak);
    }
    eprintln!("a sliver: worst {worst:.1e} of the peak");
    assert!(worst < 1e-2, "{worst}");
}

/// Cells much larger than what bends have no kernel by diffraction; before that nothing jumps: what leaves the middle cell falls as the cell grows.
#[test]
fn cells_grow_from_a_tenth_of_the_airy_disk_to_hundreds() {
    let (wavelength, na) = (5e-4_f64, 0.1_f64);
    let pupil = Pupil::perfect(wavelength, na, 0.0);
    let mut left = f64::INFINITY;
    for cells in [0.122, 1.0, 4.0, 16.0, 60.0] {
        let cell = cells * wavelength / na;
        assert!(pupil.is_told(cell), "{cells}");
        let raster = Raster { size: 3, samples: 1 };
        let mut kernel = vec![0.0; raster.len()];
        pupil.kernel([1.0, 0.0], raster, cell, &mut kernel);
        assert!(kernel.iter().all(|v| *v > -1e-6) && kernel.iter().sum::<f64>() < 1.0 + 1e-6, "{cells}: {kernel:?}");
        let leaves = 1.0 - kernel[4];
        eprintln!("{cells} λ/NA: {leaves:.4} leaves the middle, {:.4} all", 1.0 - kernel.iter().sum::<f64>());
        assert!(leaves < left, "{cells}: {leaves} after {left}");
        left = leaves;
    }
    assert!(!pupil.is_told(200.0 * wavelength / na));
}
