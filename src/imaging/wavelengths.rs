//! The number of wavelengths that holds a requested error.
//!
//! The error of a rule is that of the channel's kernels: relative L2 over all channels and pixels against the rule of
//! 96 nodes, the worst of the fields. Monochromatic kernels are computed once on an even grid of wavelengths and
//! interpolated between (cubic) to look through the candidates; the one chosen is then computed at its own nodes, and
//! if it fails there the next is tried, so that the error stated is measured.

use glam::DVec2;

use super::spectrum::{SpectralDensity, Spectrum};
use crate::error::{Error, Result};
use crate::lens::Lens;
use crate::psf::grid::{PsfGrid, PsfNode, PsfPlan};

/// Wavelengths of the grid the kernels are kept on.
const GRID: usize = 61;
/// Nodes of the rule that counts as exact: 1e-5 by the n⁻² of [`super::spectrum`].
const FINE: usize = 96;
/// Share of the request that an interpolated candidate may take before it is computed.
const CLOSE: f64 = 1.05;

/// What one field point sends to the sensor at one wavelength.
#[derive(Clone, Debug, PartialEq)]
pub struct Monochromatic {
    /// Energy in each pixel.
    pub kernel: Vec<f64>,
    /// All energy, what misses the kernel included: the channel's kernel is its weighted mean over wavelength.
    pub energy: f64,
}

/// A rule chosen, and its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// The rule.
    pub rule: Spectrum,
    /// Its measured error; above the request if not even `at_most` nodes hold it.
    pub error: f64,
    /// Monochromatic evaluations it took.
    pub evaluations: usize,
}

/// The rule with the fewest nodes, 1 to `at_most`, whose error is at most `request`.
///
/// `kernels` gives every field's monochromatic kernel at a wavelength in nm, as many fields of as many pixels at each; its
/// errors are passed on. Fails if `request` is not above 0 or no kernel has energy.
pub fn fewest_wavelengths(
    density: &SpectralDensity,
    request: f64,
    at_most: usize,
    mut kernels: impl FnMut(f64) -> Result<Vec<Monochromatic>>,
) -> Result<Chosen> {
    if request.is_nan() || request <= 0.0 {
        return Err(Error::bad("wavelengths", "error", format!("{request}"), "a number above 0"));
    }
    let [first, last] = density.range_nm();
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let step = (last - first) / (GRID - 1) as f64;
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let grid = (0..GRID).map(|i| kernels(first + step * i as f64)).collect::<Result<Vec<_>>>()?;
    let between = |nm: f64| interpolated(&grid, (nm - first) / step);
    let exact = polychromatic(&density.quadrature(FINE), |nm| Ok(between(nm)))?;
    if !exact.iter().flatten().any(|v| *v != 0.0) {
        return Err(Error::bad("wavelengths", "kernels", "no energy", "a lens that passes light"));
    }
    let mut evaluations = GRID;
    let mut n = 1;
    loop {
        let rule = density.quadrature(n);
        let looked = distance(&polychromatic(&rule, |nm| Ok(between(nm)))?, &exact);
        if looked <= CLOSE * request || n >= at_most {
            evaluations += rule.wavelength_nm.len();
            let error = distance(&polychromatic(&rule, &mut kernels)?, &exact);
            if error <= request || n >= at_most {
                return Ok(Chosen { rule, error, evaluations });
            }
        }
        n += 1;
    }
}

/// [`fewest_wavelengths`] for a lens: `plan`'s kernels at a few fields, objects at `vergence`.
///
/// `fields` are object slope and place on the sensor in mm; the wavelengths and weights of `plan` are not used.
pub fn fewest_wavelengths_of(
    lens: &Lens,
    vergence: f64,
    plan: &PsfPlan,
    fields: &[DVec2],
    density: &SpectralDensity,
    request: f64,
    at_most: usize,
) -> Result<Chosen> {
    let (slopes, radii): (Vec<f64>, Vec<f64>) = fields.iter().map(|f| (f.x, f.y)).unzip();
    let nodes: Vec<PsfNode> = (0..fields.len()).map(|radius| PsfNode { radius, outward: [0.0, 1.0] }).collect();
    fewest_wavelengths(density, request, at_most, |nm| {
        let mono = PsfPlan { wavelength_nm: vec![nm], weight: vec![vec![1.0]], ..plan.clone() };
        let grid = PsfGrid::compute(lens, vergence, &mono, &slopes, &radii, &nodes)
            .map_err(|f| super::field_map::failed(lens, "wavelengths", f))?;
        let of = |(i, kernel): (usize, ndarray::ArrayView3<'_, f64>)| {
            let energy = grid.throughput[[i, 0]];
            Monochromatic { kernel: kernel.iter().map(|v| v * energy).collect(), energy }
        };
        Ok(grid.kernels.outer_iter().enumerate().map(of).collect())
    })
}

/// Kernels at `place` between the grid's, by the cubic through the four nearest.
fn interpolated(grid: &[Vec<Monochromatic>], place: f64) -> Vec<Monochromatic> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the grid")]
    let from = (place.max(1.0) as usize - 1).min(grid.len() - 4);
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let t = place - from as f64;
    // Lagrange on 0, 1, 2, 3.
    let (a, b, c, d) = (t, t - 1.0, t - 2.0, t - 3.0);
    let weights = [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0];
    sum(grid[from..].iter().map(Vec::as_slice).zip(weights))
}

/// Weighted sum of the fields' kernels.
fn sum<'a>(parts: impl Iterator<Item = (&'a [Monochromatic], f64)>) -> Vec<Monochromatic> {
    let mut out: Vec<Monochromatic> = Vec::new();
    for (fields, w) in parts {
        if out.is_empty() {
            out = fields.iter().map(|m| Monochromatic { kernel: vec![0.0; m.kernel.len()], energy: 0.0 }).collect();
        }
        for (o, m) in out.iter_mut().zip(fields) {
            o.energy += w * m.energy;
            o.kernel.iter_mut().zip(&m.kernel).for_each(|(a, b)| *a += w * b);
        }
    }
    out
}

/// Kernels of all channels by field, channel after channel; 0 where no light comes.
fn polychromatic(rule: &Spectrum, mut kernels: impl FnMut(f64) -> Result<Vec<Monochromatic>>) -> Result<Vec<Vec<f64>>> {
    let mono = rule.wavelength_nm.iter().map(|nm| kernels(*nm)).collect::<Result<Vec<_>>>()?;
    let mut out: Vec<Vec<f64>> = vec![Vec::new(); mono.first().map_or(0, Vec::len)];
    for weight in &rule.weight {
        for (o, m) in out.iter_mut().zip(sum(mono.iter().map(Vec::as_slice).zip(weight.iter().copied()))) {
            let scale = if m.energy > 0.0 { 1.0 / m.energy } else { 0.0 };
            o.extend(m.kernel.iter().map(|v| scale * v));
        }
    }
    Ok(out)
}

/// Largest relative L2 distance over the fields; a field without light is left out.
fn distance(a: &[Vec<f64>], exact: &[Vec<f64>]) -> f64 {
    let of = |(a, e): (&Vec<f64>, &Vec<f64>)| {
        let size: f64 = e.iter().map(|v| v * v).sum();
        let off: f64 = a.iter().zip(e).map(|(x, y)| (x - y) * (x - y)).sum();
        if size > 0.0 { (off / size).sqrt() } else { 0.0 }
    };
    a.iter().zip(exact).map(of).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::illuminant::Illuminant;
    use crate::imaging::sensor::Sensor;
    use crate::lens::builtin;
    use crate::psf::chief::chief_heights;
    use crate::psf::pupil::PupilSampling;

    /// A Gaussian of `variance` about `(at, 0)` on 33 × 33 pixels.
    fn gaussian(variance: f64, at: f64) -> Monochromatic {
        let pixel = |i: i32| {
            let (x, y) = (f64::from(i % 33) - 16.0 - at, f64::from(i / 33) - 16.0);
            (-0.5 * (x * x + y * y) / variance).exp() / (std::f64::consts::TAU * variance)
        };
        Monochromatic { kernel: (0..33 * 33).map(pixel).collect(), energy: 1.0 }
    }

    /// Widening and moving Gaussians, as the doc of `spectrum` has them; each error measured again by a rule of 400
    /// nodes that shares nothing with the search.
    #[test]
    fn gaussians_get_the_fewest_nodes_that_hold() {
        let sensor = Sensor::generic();
        let lights = [Illuminant::EqualEnergy, Illuminant::A, Illuminant::Daylight { kelvin: 6504.0 }];
        for light in lights {
            let density = SpectralDensity::under(&sensor, light).expect("valid");
            for drift in [0.005, 0.02] {
                let kernels = |nm: f64| {
                    let off = (nm - 550.0) * drift;
                    Ok(vec![gaussian(1.0 + off * off, 0.0), gaussian(1.0, off)])
                };
                let exact = polychromatic(&density.quadrature(400), kernels).expect("kernels");
                let error = |n: usize| distance(&polychromatic(&density.quadrature(n), kernels).expect("ok"), &exact);
                let mut before = 0;
                for request in [0.2, 0.03, 5e-3, 1e-3] {
                    let chosen = fewest_wavelengths(&density, request, 60, kernels).expect("chooses");
                    let n = chosen.rule.wavelength_nm.len();
                    eprintln!("{light:?}, drift {drift}, {request}: {n} nodes, {:.1e}", chosen.error);
                    assert!(chosen.error <= request);
                    assert!((error(n) - chosen.error).abs() < 1e-4 + 0.02 * request, "{} {}", error(n), chosen.error);
                    assert!((1..n).all(|fewer| error(fewer) > 0.97 * request - 1e-4), "{n} is not the fewest");
                    assert!(n >= before);
                    before = n;
                }
            }
        }
    }

    /// A shipped lens: the error falls with the request, and holds against a rule of 200 nodes computed outright.
    #[test]
    fn a_lens_gets_the_nodes_it_needs() {
        let lens = builtin::lens("two_element").expect("shipped");
        let density = SpectralDensity::new(&Sensor::generic());
        let v = lens.object_vergence;
        let plan = PsfPlan {
            sampling: PupilSampling::new(5, 200),
            size: 65,
            pitch_mm: 0.02,
            wavelength_nm: vec![550.0],
            weight: vec![vec![1.0]],
        };
        let slopes = [0.0, 0.25];
        let radii = chief_heights(&lens, v, &slopes).expect("aims");
        let fields: Vec<DVec2> = slopes.iter().zip(&radii).map(|(s, r)| DVec2::new(*s, *r)).collect();
        let of = |request, at_most| fewest_wavelengths_of(&lens, v, &plan, &fields, &density, request, at_most);
        let mut before = 0;
        for request in [0.3, 0.1, 0.03] {
            let chosen = of(request, 60).expect("chooses");
            let n = chosen.rule.wavelength_nm.len();
            eprintln!("two_element, {request}: {n} nodes, error {:.1e}", chosen.error);
            assert!(chosen.error <= request && n > before, "{n} nodes");
            before = n;
            // Both rules as polychromatic plans of the grid itself.
            let grid = |rule: Spectrum| {
                let plan = PsfPlan { wavelength_nm: rule.wavelength_nm, weight: rule.weight.to_vec(), ..plan.clone() };
                let nodes = [0, 1].map(|radius| PsfNode { radius, outward: [0.0, 1.0] });
                let kernels = PsfGrid::compute(&lens, v, &plan, &slopes, &radii, &nodes).expect("traces").kernels;
                kernels.outer_iter().map(|k| k.iter().copied().collect()).collect::<Vec<Vec<f64>>>()
            };
            let error = distance(&grid(chosen.rule), &grid(density.quadrature(200)));
            assert!((error - chosen.error).abs() < 0.05 * request, "{error:e} {:e}", chosen.error);
        }
        // No rule of two nodes holds this; the error says so.
        let short = of(1e-3, 2).expect("chooses");
        assert!(short.rule.wavelength_nm.len() == 2 && short.error > 1e-3);
        assert!(of(0.0, 5).is_err() && of(f64::NAN, 5).is_err());
    }
}
