//! Point spread functions that were measured on a camera: kernels over the radius, which stand where a traced table would.
//!
//! Light that an ideal lens (its distortion aside) would bring to `q` arrives at `q + d`. How much goes to which `d` is kept as weights on a grid of
//! moves, by radius and colour: along the direction away from the centre, and across it. The lens is taken to be round: a kernel is its own mirror
//! image across the meridian, and at one radius it is the same everywhere but turned. The pixel's aperture is not in the weights; whoever makes a
//! kernel adds it, as to rays.
//!
//! ```
//! use isoplanat_optics::psf::measured::{Moves, MeasuredPsf};
//!
//! // All light where it belongs, at the centre and 100 pixels from it.
//! let moves = Moves::within(1.0, 0.5)?;
//! let mut weights = vec![0.0; moves.len()];
//! weights[moves.middle()] = 1.0;
//! let psf = MeasuredPsf::new([640, 480], [320.0, 240.0], moves, vec![0.0, 100.0], vec![vec![weights]; 2])?;
//! let kernel = psf.kernel(50.0, 0, [1.0, 0.0], 3);
//! assert!((kernel[4] - 0.5625).abs() < 1e-12);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

mod file;

use super::splat::Raster;
use isoplanat_base::error::{Error, Result};

/// Moves at most.
const MOST: usize = 20_000;
/// How far weights may sum from one.
const SUM: f64 = 1e-6;

/// A grid of moves of light, pixels: those within a distance, at even steps along and across the meridian, the half with `across ≥ 0`; the other is
/// its mirror image.
#[derive(Clone, Debug, PartialEq)]
pub struct Moves {
    /// Largest move, pixels.
    pub reach_px: f64,
    /// Step of the grid, pixels.
    pub spacing_px: f64,
    /// `[along, across]` in steps.
    steps: Vec<[i32; 2]>,
}

impl Moves {
    /// Those within `reach_px`, `spacing_px` apart.
    ///
    /// # Errors
    /// A reach or a spacing that is not positive, or more moves than can be told apart (20,000).
    pub fn within(reach_px: f64, spacing_px: f64) -> Result<Self> {
        let count = (reach_px / spacing_px + 1e-9).floor();
        let finite = spacing_px > 0.0 && spacing_px.is_finite() && reach_px > 0.0;
        // Half a disk.
        if !(finite && 0.5 * std::f64::consts::PI * count * count < MOST as f64) {
            let allowed = format!("positive numbers with fewer than {MOST} moves");
            return Err(Error::bad("", "reach_px, spacing_px", format!("{reach_px}, {spacing_px}"), allowed));
        }
        #[expect(clippy::cast_possible_truncation, reason = "bounded")]
        let n = count as i32;
        let rows = -n..=n;
        let steps = rows.flat_map(|a| (0..=n).map(move |b| [a, b])).filter(|[a, b]| a * a + b * b <= n * n).collect();
        Ok(Self { reach_px, spacing_px, steps })
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// `[along, across]` in steps of the grid.
    pub fn steps(&self) -> &[[i32; 2]] {
        &self.steps
    }

    /// Number of the move by nothing.
    pub fn middle(&self) -> usize {
        self.steps.iter().position(|s| *s == [0, 0]).unwrap_or(0)
    }

    /// `[along, across]` of every move, pixels, and how often it stands in the whole: once on the meridian, else twice.
    pub fn iter(&self) -> impl Iterator<Item = ([f64; 2], f64)> + '_ {
        self.steps.iter().map(|s| (s.map(|n| f64::from(n) * self.spacing_px), if s[1] == 0 { 1.0 } else { 2.0 }))
    }
}

/// Measured point spread functions, in pixels of the pictures they were measured in.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredPsf {
    /// Columns and rows of the pictures.
    pub size: [usize; 2],
    /// Centre `[column, row]` that kernels turn about.
    pub centre_px: [f64; 2],
    /// The grid of moves.
    pub moves: Moves,
    /// Radii, pixels, growing, the first 0.
    pub radii_px: Vec<f64>,
    /// `[radius][channel][move]`: the weight of a move and of its mirror image, each.
    weights: Vec<Vec<Vec<f64>>>,
}

impl MeasuredPsf {
    /// From its parts, `weights` as `[radius][channel][move]`.
    ///
    /// # Errors
    /// Radii that do not grow from 0, weights that are not finite, below 0, or do not sum to one with their mirror images, channels that are not
    /// one or three.
    pub fn new(
        size: [usize; 2],
        centre_px: [f64; 2],
        moves: Moves,
        radii_px: Vec<f64>,
        weights: Vec<Vec<Vec<f64>>>,
    ) -> Result<Self> {
        let bad = |place: String, found: String, allowed: &str| Err(Error::bad("", place, found, allowed));
        if size.iter().any(|n| !(1..=65_536).contains(n)) {
            return bad("size".into(), format!("{size:?}"), "1 to 65536 columns and rows");
        }
        if !centre_px.iter().all(|v| v.abs() < 1e9) {
            return bad("centre_px".into(), format!("{centre_px:?}"), "finite numbers below 1e9");
        }
        let grows = radii_px.first() == Some(&0.0)
            && radii_px.windows(2).all(|w| w[1] > w[0])
            && radii_px.iter().all(|r| r.is_finite());
        if !grows {
            return bad("radii_px".into(), format!("{radii_px:?}"), "finite radii that grow from 0");
        }
        let channels = weights.first().map_or(0, Vec::len);
        if weights.len() != radii_px.len()
            || !matches!(channels, 1 | 3)
            || weights.iter().any(|w| w.len() != channels || w.iter().any(|w| w.len() != moves.len()))
        {
            let allowed = "for every radius one channel or three, for each of them every move";
            return bad("weights".into(), format!("{} radii, {channels} channels", weights.len()), allowed);
        }
        for (j, of_radius) in weights.iter().enumerate() {
            for (c, of_channel) in of_radius.iter().enumerate() {
                let place = || format!("weights[{j}][{c}]");
                if let Some(w) = of_channel.iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
                    return bad(place(), w.to_string(), "0 or more");
                }
                let sum: f64 = moves.iter().zip(of_channel).map(|((_, n), w)| n * w).sum();
                if (sum - 1.0).abs() > SUM {
                    return bad(place(), format!("a sum of {sum}"), "1, mirror images counted");
                }
            }
        }
        Ok(Self { size, centre_px, moves, radii_px, weights })
    }

    /// Channels: one, or R, G and B.
    pub fn channels(&self) -> usize {
        self.weights[0].len()
    }

    /// Weights of a knot's channel, by move.
    pub fn weights(&self, knot: usize, channel: usize) -> &[f64] {
        &self.weights[knot][channel]
    }

    /// Weights of a channel at a radius, by move: linear between knots, held beyond the last.
    pub fn at(&self, radius_px: f64, channel: usize) -> Vec<f64> {
        let (knot, share) = knot(&self.radii_px, radius_px);
        let [low, high] = [knot, (knot + 1).min(self.radii_px.len() - 1)].map(|j| &self.weights[j][channel]);
        low.iter().zip(high).map(|(a, b)| (1.0 - share) * a + share * b).collect()
    }

    /// Mean move along the meridian, and root mean square moves along it (about that mean) and across it, pixels, of a channel at a radius.
    pub fn widths(&self, radius_px: f64, channel: usize) -> [f64; 3] {
        let weights = self.at(radius_px, channel);
        let sum = |f: &dyn Fn([f64; 2]) -> f64| {
            self.moves.iter().zip(&weights).map(|((at, n), w)| n * w * f(at)).sum::<f64>()
        };
        let mean = sum(&|[along, _]| along);
        [mean, sum(&|[along, _]| (along - mean).powi(2)).sqrt(), sum(&|[_, across]| across * across).sqrt()]
    }

    /// The kernel of a channel on `size × size` whole pixels, `[row][col]`, where the radius grows along `outward` (column, row; a unit vector): what
    /// arrives of a scene that is sampled once a pixel, as [`Raster`] has it.
    ///
    /// # Panics
    /// For an even size.
    pub fn kernel(&self, radius_px: f64, channel: usize, outward: [f64; 2], size: usize) -> Vec<f64> {
        assert!(size % 2 == 1, "a kernel has a middle");
        let raster = Raster { size, samples: 1 };
        let mut out = vec![0.0; raster.len()];
        let [c, r] = outward;
        let weights = self.at(radius_px, channel);
        let both = self.moves.iter().zip(&weights).filter(|(_, w)| **w > 0.0).flat_map(|(([along, across], n), w)| {
            let turned = move |across: f64| ([along * c - across * r, along * r + across * c], *w);
            std::iter::once(turned(across)).chain((n > 1.0).then(|| turned(-across)))
        });
        raster.splat(&mut out, &[(0, 1.0)], both);
        out
    }
}

/// How light falls off from the centre, by colour R, G, B; relative to the centre, linear between radii and held beyond the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Falloff {
    /// Radii, pixels, growing, the first 0.
    pub radii_px: Vec<f64>,
    /// Relative illumination at them.
    pub light: [Vec<f64>; 3],
}

impl Falloff {
    /// Of every colour at a radius.
    pub fn at(&self, radius_px: f64) -> Vec<f64> {
        self.light.iter().map(|v| linear(&self.radii_px, v, radius_px)).collect()
    }
}

/// `values` at `radii`, linear between them and held beyond the last.
pub fn linear(radii: &[f64], values: &[f64], radius: f64) -> f64 {
    let (knot, share) = knot(radii, radius);
    let next = (knot + 1).min(values.len() - 1);
    values[knot] + share * (values[next] - values[knot])
}

/// The knot at or below a radius and how far the way to the next is, from 0 to 1; held beyond the last.
pub fn knot(radii: &[f64], radius: f64) -> (usize, f64) {
    let last = radii.len().saturating_sub(1);
    let above = radii.partition_point(|r| *r <= radius);
    if above > last || last == 0 {
        return (last, 0.0);
    }
    let low = above.saturating_sub(1);
    (low, ((radius - radii[low]) / (radii[low + 1] - radii[low])).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(weights: Vec<f64>, moves: &Moves) -> Result<MeasuredPsf> {
        MeasuredPsf::new([100, 80], [50.0, 40.0], moves.clone(), vec![0.0], vec![vec![weights]])
    }

    /// A move along the meridian and one across it land where they should, at any azimuth.
    #[test]
    fn kernels_turn_with_the_azimuth() {
        let moves = Moves::within(4.0, 1.0).expect("valid");
        let at = |step: [i32; 2]| moves.steps().iter().position(|s| *s == step).expect("on the grid");
        let mut along = vec![0.0; moves.len()];
        along[at([3, 0])] = 1.0;
        let mut across = vec![0.0; moves.len()];
        across[at([0, 2])] = 0.5;
        let (along, across) = (one(along, &moves).expect("valid"), one(across, &moves).expect("valid"));
        let mean = |kernel: &[f64]| {
            let mut sum = [0.0; 5];
            for (i, w) in kernel.iter().enumerate() {
                let [x, y] = [(i % 11) as f64 - 5.0, (i / 11) as f64 - 5.0];
                [w, &(w * x), &(w * y), &(w * x * x), &(w * y * y)].iter().zip(&mut sum).for_each(|(v, s)| *s += **v);
            }
            sum
        };
        assert_eq!((along.widths(1.0, 0), across.widths(1.0, 0)), ([3.0, 0.0, 0.0], [0.0, 0.0, 2.0]));
        for outward in [[1.0, 0.0], [0.0, -1.0], [0.6, 0.8]] {
            let [sum, x, y, ..] = mean(&along.kernel(10.0, 0, outward, 11));
            assert!((sum - 1.0).abs() < 1e-12);
            assert!((x - 3.0 * outward[0]).abs() < 1e-12 && (y - 3.0 * outward[1]).abs() < 1e-12, "{x} {y}");
            // Two equal parts, two pixels to either side; box and tent have a variance of a quarter along each axis.
            let [sum, x, y, xx, yy] = mean(&across.kernel(10.0, 0, outward, 11));
            assert!((sum - 1.0).abs() < 1e-12 && x.abs() < 1e-12 && y.abs() < 1e-12);
            let [u, v] = [4.0 * outward[1] * outward[1] + 0.25, 4.0 * outward[0] * outward[0] + 0.25];
            assert!((xx - u).abs() < 1e-12 && (yy - v).abs() < 1e-12, "{xx} {u}, {yy} {v}");
        }
    }

    #[test]
    fn what_is_no_psf_is_refused_by_place() {
        let moves = Moves::within(1.0, 0.5).expect("valid");
        let mut good = vec![0.0; moves.len()];
        good[moves.middle()] = 1.0;
        assert!(one(good.clone(), &moves).is_ok());
        let changed = |i: usize, v: f64| {
            let mut weights = good.clone();
            weights[i] = v;
            one(weights, &moves).expect_err("refused").to_string()
        };
        assert!(changed(0, f64::NAN).contains("weights[0][0]") && changed(0, -1.0).contains("0 or more"));
        assert!(changed(0, 0.5).contains("sum"));
        assert!(one(good[1..].to_vec(), &moves).is_err());
        for (reach, spacing) in
            [(0.0, 1.0), (1.0, 0.0), (f64::NAN, 1.0), (1e9, 1e-3), (1.0, -1.0), (1.0, f64::INFINITY)]
        {
            assert!(Moves::within(reach, spacing).is_err(), "{reach} {spacing}");
        }
        let twice = vec![vec![good.clone()]; 2];
        for radii in [vec![0.0, 0.0], vec![1.0, 2.0], vec![0.0, f64::INFINITY], vec![0.0]] {
            let psf = MeasuredPsf::new([10, 10], [5.0; 2], moves.clone(), radii.clone(), twice.clone());
            assert!(psf.is_err(), "{radii:?}");
        }
    }

    #[test]
    fn between_knots_weights_are_interpolated() {
        let moves = Moves::within(1.0, 1.0).expect("valid");
        let pure = |i: usize| (0..moves.len()).map(|k| f64::from(u8::from(k == i))).collect::<Vec<_>>();
        // The last move along the meridian, and the middle.
        let ends: Vec<usize> = (0..moves.len()).filter(|i| moves.steps()[*i][1] == 0).collect();
        let weights = vec![vec![pure(ends[0])], vec![pure(ends[1])]];
        let psf = MeasuredPsf::new([10, 10], [5.0; 2], moves, vec![0.0, 8.0], weights).expect("valid");
        assert_eq!(psf.at(2.0, 0)[ends[0]], 0.75);
        assert_eq!(psf.at(2.0, 0)[ends[1]], 0.25);
        assert_eq!(psf.at(9.0, 0), psf.at(8.0, 0));
    }
}
