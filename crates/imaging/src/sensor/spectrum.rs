//! Wavelengths of a channel: response × illuminant as a quadrature rule and as a density to sample (paper, eq. 9).
//!
//! The density `p_c(λ)` of channel `c` is the sensor's response, piecewise linear between the table's entries, times the
//! illuminant (`Illuminant`; equal energy unless stated), normalised to one. Under other light than equal energy the
//! product is kept piecewise linear on steps of 0.25 nm; the channel's mean wavelength then errs by less than 1e-3 nm. A quadrature has nodes common to all channels and weights of their own:
//! `∫ p_c(λ) f(λ) dλ ≈ Σ_i w_ci f(λ_i)`. The range is cut into `n` bins holding equal shares of `(Σ_c p_c)^(2/3)`; a
//! node is the centroid of `Σ_c p_c` over its bin, a weight the channel's exact mass in it.
//!
//! Error, on Gaussian blurs whose width or position drifts with wavelength by 0.005–0.02 pixel/nm, relative to the
//! kernel's peak (RMS / worst, generic sensor): 3 nodes 1.4e-2 / 8.2e-2, 5: 5.0e-3 / 2.1e-2, 7: 2.5e-3 / 9.7e-3,
//! 12: 8.0e-4 / 3.1e-3, 24: 2.0e-4 / 7.9e-4: it falls as n⁻². Probes measure it for a lens and a
//! scene (`crate::render::probe`), and `isoplanat accuracy` for lenses and their gradients.

use crate::sensor::Sensor;
use crate::sensor::illuminant::Illuminant;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;

/// Wavelengths beyond which every channel responds with less than this part of its peak are left out.
pub const SEEN: f64 = 1e-3;

/// A quadrature over wavelength, common nodes and one set of weights a channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// Nodes, nm, increasing.
    pub wavelength_nm: Vec<f64>,
    /// Weights of R, G, B at the nodes; each channel sums to 1.
    pub weight: [Vec<f64>; 3],
}

impl Spectrum {
    /// The rule of `n` nodes for a sensor under an equal-energy illuminant; `n = 0` is taken as 1.
    ///
    /// ```
    /// use isoplanat_imaging::sensor::{Sensor, spectrum::Spectrum};
    ///
    /// let rule = Spectrum::quadrature(&Sensor::generic(), 5);
    /// for weights in &rule.weight {
    ///     assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    /// }
    /// ```
    pub fn quadrature(sensor: &Sensor, n: usize) -> Self {
        SpectralDensity::new(sensor).quadrature(n)
    }
}

/// The continuous densities behind a [`Spectrum`], for sampling.
#[derive(Clone, Debug)]
pub struct SpectralDensity {
    /// Ends of the linear pieces, nm.
    nm: Vec<f64>,
    /// Density of each channel at the ends, 1/nm.
    density: [Vec<f64>; 3],
    /// Integral of each channel up to the ends.
    cumulative: [Vec<f64>; 3],
    /// Ends of the response, nm, where less than [`SEEN`] was left out there.
    left_out: [Option<f64>; 2],
}

impl SpectralDensity {
    /// The densities of a sensor under an equal-energy illuminant.
    pub fn new(sensor: &Sensor) -> Self {
        let table = &sensor.spectral_response;
        Self::normalised(table.wavelength_nm.clone(), table.channels().map(<[f64]>::to_vec))
    }

    /// The densities of a sensor under `light`. Fails if the illuminant means nothing, or if a channel sees none of it.
    pub fn under(sensor: &Sensor, light: Illuminant) -> Result<Self> {
        if light == Illuminant::EqualEnergy {
            return Ok(Self::new(sensor));
        }
        light.check("temperature")?;
        let table = &sensor.spectral_response;
        let mut nm = vec![table.wavelength_nm[0]];
        let mut density = table.channels().map(|p| vec![p[0] * light.relative_power(nm[0])]);
        for (i, piece) in table.wavelength_nm.windows(2).enumerate() {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "lengths of a table, nm")]
            let steps = (4.0 * (piece[1] - piece[0])).ceil().clamp(1.0, 1e4) as usize;
            for k in 1..=steps {
                let t = k as f64 / steps as f64;
                let at = piece[0] + t * (piece[1] - piece[0]);
                nm.push(at);
                let power = light.relative_power(at);
                for (out, p) in density.iter_mut().zip(table.channels()) {
                    out.push(((1.0 - t) * p[i] + t * p[i + 1]) * power);
                }
            }
        }
        let lit = |p: &Vec<f64>| p.iter().all(|v| v.is_finite()) && p.iter().any(|v| *v > 0.0);
        if !density.iter().all(lit) {
            return Err(Error::bad("illuminant", "power", "a channel sees none of it", "light within the response"));
        }
        Ok(Self::normalised(nm, density))
    }

    fn normalised(nm: Vec<f64>, density: [Vec<f64>; 3]) -> Self {
        let (nm, mut density, left_out) = seen(nm, density);
        let cumulative = density.each_mut().map(|p| {
            let mut sums = vec![0.0];
            for i in 1..nm.len() {
                sums.push(sums[i - 1] + 0.5 * (p[i - 1] + p[i]) * (nm[i] - nm[i - 1]));
            }
            let total = sums[sums.len() - 1];
            p.iter_mut().for_each(|v| *v /= total);
            sums.iter_mut().for_each(|v| *v /= total);
            sums
        });
        Self { nm, density, cumulative, left_out }
    }

    /// Shortest and longest wavelength at which a channel has light, nm.
    pub fn ends_nm(&self) -> [f64; 2] {
        let lit = |i: &usize| self.density.iter().any(|p| p[*i] > 0.0);
        let (first, last) = ((0..self.nm.len()).find(lit), (0..self.nm.len()).rev().find(lit));
        // The pieces beside them have light as well.
        [first.unwrap_or(0).saturating_sub(1), (last.unwrap_or(0) + 1).min(self.nm.len() - 1)].map(|i| self.nm[i])
    }

    /// Ranges in nm, at the short and the long end, where the sensor has a response of less than [`SEEN`] of its peak, which are left out.
    pub fn left_out_nm(&self) -> Vec<[f64; 2]> {
        let (first, last) = (self.nm[0], self.nm[self.nm.len() - 1]);
        let [short, long] = self.left_out;
        short.map(|end| [end, first]).into_iter().chain(long.map(|end| [last, end])).collect()
    }

    /// Refuses to image with `lens` where it states only wavelengths that these densities do not hold, or where they hold
    /// wavelengths at which the index of one of its media is not known.
    pub fn require(&self, lens: &Lens) -> Result<()> {
        let ([short, long], [first, last]) = (self.ends_nm(), lens.wavelengths.ends_nm());
        if first > long || last < short {
            let found = format!("{first} to {last} nm");
            let allowed = format!("wavelengths within {short} to {long} nm, what the sensor responds to");
            return Err(Error::bad(lens.file(), "wavelengths.nm", found, allowed));
        }
        [short, long].iter().try_for_each(|nm| lens.require_indices(*nm, lens.file()))
    }

    /// The wavelength in nm at which channel `channel` has collected the share `u` (`0 ≤ u < 1`) of its light.
    ///
    /// Uniform `u` gives wavelengths with the channel's density: the inverse of its cumulative distribution, exact.
    ///
    /// # Panics
    /// If `channel` is not 0, 1 or 2.
    pub fn sample(&self, channel: usize, u: f64) -> f64 {
        let (sums, p) = (&self.cumulative[channel], &self.density[channel]);
        // The piece whose sum passes `u`; a piece without light never does.
        let u = u.clamp(0.0, 1f64.next_down());
        let i = sums.partition_point(|&s| s <= u).saturating_sub(1);
        let (rest, width) = ((u - sums[i]).max(0.0), self.nm[i + 1] - self.nm[i]);
        // Solve p₀ t + (p₁ − p₀) t² / (2 width) = rest in the form without cancellation.
        let root = (p[i] * p[i] + 2.0 * rest * (p[i + 1] - p[i]) / width).max(0.0).sqrt();
        let t = if p[i] + root > 0.0 { 2.0 * rest / (p[i] + root) } else { 0.0 };
        self.nm[i] + t.clamp(0.0, width)
    }

    /// Integrals of `p` and `λ p` of a channel from `from` to `to`.
    fn moments(&self, channel: usize, from: f64, to: f64) -> (f64, f64) {
        let p = &self.density[channel];
        let mut sums = (0.0, 0.0);
        let before = self.nm.partition_point(|nm| *nm <= from).saturating_sub(1);
        for (i, piece) in self.nm.windows(2).enumerate().skip(before) {
            let (a, b) = (piece[0].max(from), piece[1].min(to));
            if a >= b {
                break;
            }
            let at = |nm: f64| p[i] + (p[i + 1] - p[i]) * (nm - piece[0]) / (piece[1] - piece[0]);
            // Simpson's rule is exact for the quadratic λ p.
            let (middle, h) = (0.5 * (a + b), (b - a) / 6.0);
            sums.0 += h * (at(a) + 4.0 * at(middle) + at(b));
            sums.1 += h * (a * at(a) + 4.0 * middle * at(middle) + b * at(b));
        }
        sums
    }

    /// The rule of `n` nodes for these densities; `n = 0` is taken as 1.
    pub fn quadrature(&self, n: usize) -> Spectrum {
        let n = n.max(1);
        // Place the bins on a fine grid by the running integral of (Σ p)^(2/3).
        let (first, last) = (self.nm[0], self.nm[self.nm.len() - 1]);
        let cells = 4000.max(40 * n);
        let edge = |i: usize| first + (last - first) * i as f64 / cells as f64;
        let share = |i: usize| {
            let mass: f64 = (0..3).map(|c| self.moments(c, edge(i), edge(i + 1)).0).sum();
            mass.max(0.0).powf(2.0 / 3.0)
        };
        let shares: Vec<f64> = (0..cells).map(share).collect();
        let total: f64 = shares.iter().sum();
        let mut edges = vec![first];
        let mut running = 0.0;
        for (i, s) in shares.iter().enumerate() {
            running += s;
            if running >= total * edges.len() as f64 / n as f64 && edges.len() < n {
                edges.push(edge(i + 1));
            }
        }
        edges.push(last);
        // Take each bin's centroid as node, each channel's mass as weight.
        let mut rule = Spectrum { wavelength_nm: Vec::new(), weight: Default::default() };
        for bin in edges.windows(2) {
            let channels: [(f64, f64); 3] = std::array::from_fn(|c| self.moments(c, bin[0], bin[1]));
            let mass: f64 = channels.iter().map(|m| m.0).sum();
            if mass <= 0.0 {
                continue;
            }
            rule.wavelength_nm.push(channels.iter().map(|m| m.1).sum::<f64>() / mass);
            (0..3).for_each(|c| rule.weight[c].push(channels[c].0));
        }
        for weight in &mut rule.weight {
            let sum: f64 = weight.iter().sum();
            weight.iter_mut().for_each(|w| *w /= sum);
        }
        rule
    }
}

/// Pieces without those ends where every channel has less than [`SEEN`] of its peak; the response's former ends where it was not 0 there.
type Seen = (Vec<f64>, [Vec<f64>; 3], [Option<f64>; 2]);
fn seen(mut nm: Vec<f64>, mut density: [Vec<f64>; 3]) -> Seen {
    let floor = density.each_ref().map(|p| SEEN * p.iter().copied().fold(0.0, f64::max));
    let cut = |nm: &mut Vec<f64>, density: &mut [Vec<f64>; 3]| -> Option<f64> {
        // From the end of the lists: how many entries lie below, and where the first channel comes up to its floor before them.
        let below = |i: &usize| (0..3).all(|c| density[c][*i] < floor[c]);
        let dark = (0..nm.len()).rev().take_while(below).count();
        if dark == 0 || dark == nm.len() {
            return None;
        }
        let (inner, outer) = (nm.len() - dark - 1, nm.len() - dark);
        let lit = (outer..nm.len()).any(|i| density.iter().any(|p| p[i] > 0.0));
        if !lit {
            return None;
        }
        let crossing = |c: usize| {
            let (a, b) = (density[c][inner], density[c][outer]);
            if a < floor[c] { 0.0 } else { (a - floor[c]) / (a - b) }
        };
        let t = (0..3).map(crossing).fold(0.0, f64::max);
        let end = nm[nm.len() - 1];
        let mix = |a: f64, b: f64| a + t * (b - a);
        nm[outer] = mix(nm[inner], nm[outer]);
        nm.truncate(outer + 1);
        for p in density.iter_mut() {
            p[outer] = mix(p[inner], p[outer]);
            p.truncate(outer + 1);
        }
        if t == 0.0 {
            nm.truncate(outer);
            density.iter_mut().for_each(|p| p.truncate(outer));
        }
        Some(end)
    };
    let long = cut(&mut nm, &mut density);
    // The other end, the lists turned round.
    let turn = |nm: &mut Vec<f64>, density: &mut [Vec<f64>; 3]| {
        nm.reverse();
        density.iter_mut().for_each(|p| p.reverse());
    };
    turn(&mut nm, &mut density);
    let short = cut(&mut nm, &mut density);
    turn(&mut nm, &mut density);
    (nm, density, [short, long])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `∫ p_c f` by a fine midpoint rule on the response table, independent of the code under test.
    fn integral(sensor: &Sensor, channel: usize, f: impl Fn(f64) -> f64) -> f64 {
        let table = &sensor.spectral_response;
        let (nm, p) = (&table.wavelength_nm, table.channels()[channel]);
        let (mut sum, mut mass) = (0.0, 0.0);
        for i in 0..30_000 {
            let x = 400.0 + (f64::from(i) + 0.5) * 0.01;
            let j = (((x - 400.0) / 10.0) as usize).min(nm.len() - 2);
            let v = p[j] + (p[j + 1] - p[j]) * (x - nm[j]) / (nm[j + 1] - nm[j]);
            sum += v * f(x);
            mass += v;
        }
        sum / mass
    }

    fn mean_nm(density: &SpectralDensity, channel: usize) -> f64 {
        density.moments(channel, density.nm[0], density.nm[density.nm.len() - 1]).1
    }

    /// Gaussian blur values whose width and position drift with wavelength.
    fn blurs() -> Vec<impl Fn(f64) -> f64> {
        let mut cases = Vec::new();
        for drift in [0.005, 0.01, 0.02] {
            for (best, radius, moves) in [(480.0, 0.0, 0.0), (550.0, 1.0, 0.0), (620.0, 2.0, 0.0), (550.0, 1.0, 1.0)] {
                cases.push(move |nm: f64| {
                    let off = (nm - best) * drift;
                    let (variance, x) = (1.0 + (1.0 - moves) * off * off, radius - moves * off);
                    (-0.5 * x * x / variance).exp() / variance
                });
            }
        }
        cases
    }

    #[test]
    fn the_rule_is_normalised_and_its_error_falls() {
        let sensor = Sensor::generic();
        for (n, limit) in [(1, 0.7), (3, 9e-2), (5, 2.5e-2), (7, 1.2e-2), (12, 3.5e-3), (24, 9e-4)] {
            let rule = Spectrum::quadrature(&sensor, n);
            assert_eq!(rule.wavelength_nm.len(), n);
            assert!(rule.wavelength_nm.windows(2).all(|w| w[0] < w[1]));
            let mut worst = 0.0f64;
            for c in 0..3 {
                assert!((rule.weight[c].iter().sum::<f64>() - 1.0).abs() < 1e-14);
                assert!(rule.weight[c].iter().all(|w| *w >= 0.0));
                for f in blurs() {
                    let sum: f64 = rule.wavelength_nm.iter().zip(&rule.weight[c]).map(|(&nm, w)| w * f(nm)).sum();
                    worst = worst.max((sum - integral(&sensor, c, f)).abs());
                }
            }
            assert!(worst < limit, "{n} nodes: {worst}");
        }
    }

    /// Means under a light against a fine midpoint rule on response × power.
    #[test]
    fn other_light_moves_the_means() {
        let sensor = Sensor::generic();
        let lights = [
            Illuminant::A,
            Illuminant::BlackBody { kelvin: 1500.0 },
            Illuminant::BlackBody { kelvin: 12_000.0 },
            Illuminant::Daylight { kelvin: 5003.0 },
        ];
        for light in lights {
            let density = SpectralDensity::under(&sensor, light).expect("valid");
            for c in 0..3 {
                let power = |nm: f64| light.relative_power(nm);
                let mean = integral(&sensor, c, |x| x * power(x)) / integral(&sensor, c, power);
                assert!((mean_nm(&density, c) - mean).abs() < 1e-3, "{light:?} {c}: {} {mean}", mean_nm(&density, c));
                assert!((mean - integral(&sensor, c, |x| x)).abs() > 0.01, "{light:?} {c}: {mean}");
            }
            let rule = density.quadrature(7);
            assert!((0..3).all(|c| (rule.weight[c].iter().sum::<f64>() - 1.0).abs() < 1e-14));
        }
        let equal = SpectralDensity::under(&sensor, Illuminant::EqualEnergy).expect("valid");
        assert_eq!(equal.quadrature(5), Spectrum::quadrature(&sensor, 5));
        assert!(SpectralDensity::under(&sensor, Illuminant::BlackBody { kelvin: 0.0 }).is_err());
        assert!(SpectralDensity::under(&sensor, Illuminant::Daylight { kelvin: f64::NAN }).is_err());
    }

    /// Ends that the sensor hardly sees are left out; the rest is as it was, and sharp cut-offs and zeros stay.
    #[test]
    fn what_the_sensor_hardly_sees_is_left_out() {
        let generic = Sensor::generic();
        assert!(SpectralDensity::new(&generic).left_out_nm().is_empty());
        assert_eq!(SpectralDensity::new(&generic).ends_nm(), [400.0, 700.0]);
        let mut sensor = Sensor::generic();
        sensor.spectral_response.wavelength_nm = vec![380.0, 390.0, 400.0, 500.0, 600.0, 700.0, 720.0];
        let with = |peak: f64| vec![0.0, 5e-4, 5.5e-3, 1.0, peak, 0.2, 1e-4];
        sensor.spectral_response.red = with(1.0);
        sensor.spectral_response.green = with(1.0);
        sensor.spectral_response.blue = with(0.5);
        let density = SpectralDensity::new(&sensor);
        let [short, long] = density.ends_nm();
        // The floor of 1e-3 is crossed a tenth into the piece from 390 nm, and at 700 + 20 (0.2 − 1e-3)/(0.2 − 1e-4) nm.
        assert!((short - 391.0).abs() < 1e-9, "{short}");
        assert!((long - (700.0 + 20.0 * 0.199 / 0.1999)).abs() < 1e-9, "{long}");
        assert_eq!(density.left_out_nm(), vec![[380.0, short], [long, 720.0]]);
        for c in 0..3 {
            assert!((density.moments(c, 0.0, 1e4).0 - 1.0).abs() < 1e-12);
            assert!(density.sample(c, 0.0) >= short && density.sample(c, 1.0) <= long);
        }
    }

    #[test]
    fn samples_follow_the_density() {
        let sensor = Sensor::generic();
        let density = SpectralDensity::new(&sensor);
        for c in 0..3 {
            // Stratified samples make the mean of any smooth function converge fast.
            let n = 20_000;
            let nm: Vec<f64> = (0..n).map(|i| density.sample(c, (f64::from(i) + 0.5) / f64::from(n))).collect();
            assert!(nm.windows(2).all(|w| w[0] < w[1]) && nm[0] >= 400.0 && nm[nm.len() - 1] <= 700.0);
            let mean = nm.iter().sum::<f64>() / f64::from(n);
            let square = nm.iter().map(|v| (v - 550.0).powi(2)).sum::<f64>() / f64::from(n);
            assert!((mean - integral(&sensor, c, |x| x)).abs() < 1e-3);
            assert!((mean - mean_nm(&density, c)).abs() < 1e-3);
            assert!((square - integral(&sensor, c, |x| (x - 550.0).powi(2))).abs() < 1.0);
            assert!(density.sample(c, 0.0) >= 400.0 && density.sample(c, 1.0) <= 700.0);
        }
    }

    #[test]
    fn pieces_without_light_are_never_sampled() {
        let mut sensor = Sensor::generic();
        let n = sensor.spectral_response.wavelength_nm.len();
        sensor.spectral_response.green = (0..n).map(|i| if (10..=12).contains(&i) { 1.0 } else { 0.0 }).collect();
        let density = SpectralDensity::new(&sensor);
        for i in 0..=1000 {
            let nm = density.sample(1, f64::from(i) / 1000.0);
            assert!((490.0..=530.0).contains(&nm), "{nm}");
        }
    }
}
