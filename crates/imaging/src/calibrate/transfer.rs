//! A sensor's black level, gain and read noise from dark and flat frames (photon transfer).
//!
//! The variance of a pixel over exposures grows with its mean by one unit a photoelectron: `σ² = σ_r² + (m − black) / K`, with `K` electrons a digital
//! number (J. R. Janesick, "Photon Transfer", SPIE 2007; EMVA 1288, release 4.0). Variances are of differences of two frames of one
//! exposure, so that what stays from frame to frame (vignetting, dust, pixels of other gain) is none of them; the second frame is scaled to the first tile by
//! tile, so that neither is a lamp that flickers. Tiles of one pair have different means where the lens vignettes: one pair is a curve.

use ndarray::{Array2, ArrayView2};

use crate::sensor::cfa::Cfa;
use isoplanat_base::error::{Error, Result};

/// Side of a tile, pixels; even, so that each holds whole cells of the filter.
const TILE: usize = 64;
/// Tiles with a pixel above this share of the way from black to white are left out: what is cut off has no noise.
const BRIGHTEST: f64 = 0.95;
/// Flats are of one exposure if their means differ by less than this share.
const SAME: f64 = 0.03;
/// Flats have this many times the noise of a dark pixel as light, at least.
const FAINTEST: f64 = 3.0;
/// Fits of straight lines with weights from the last one.
const ROUNDS: usize = 20;

/// Digital number above which a pixel counts as cut off.
pub(super) fn ceiling(black: f64, white: f64) -> f64 {
    black + BRIGHTEST * (white - black)
}

/// Frames of one camera at one ISO.
#[derive(Clone, Debug)]
pub struct Frames {
    /// Without light, in digital numbers.
    pub darks: Vec<Array2<f32>>,
    /// Of an even light, in digital numbers, two and more of each exposure.
    pub flats: Vec<Array2<f32>>,
    /// Their filters.
    pub cfa: Cfa,
    /// Digital number at which a pixel is cut off.
    pub white: f64,
}

/// One tile of one pair of flats: a channel's mean above black, and the variance of a pixel over exposures; digital numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// R, G, B.
    pub channel: usize,
    /// Mean above black.
    pub mean: f64,
    /// Variance.
    pub variance: f64,
    /// Pixels that it is of.
    pub pixels: usize,
}

/// A number and its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Value.
    pub value: f64,
    /// Standard error.
    pub error: f64,
}

/// What photon transfer tells.
#[derive(Clone, Debug)]
pub struct Transfer {
    /// Black level, DN.
    pub black: Measured,
    /// Black levels of the four places of the filter's cell, DN.
    pub blacks: [f64; 4],
    /// Noise of a dark pixel over exposures, DN.
    pub read_dn: Measured,
    /// Electrons a digital number, of R, G, B, and of all.
    pub gain: [Measured; 4],
    /// Noise of a dark pixel as the line through the flats has it, DN: 0 where its square is negative.
    pub read_by_flats_dn: f64,
    /// Root mean square departure of variances from the line, relative to what their pixel count lets expect: 1 for a sensor of that kind.
    pub scatter: f64,
    /// Share of the dark frames' pixels that are 0, below which nothing is told.
    pub cut: f64,
    /// Every tile.
    pub points: Vec<Point>,
    /// Digital number at which a pixel is cut off.
    pub white: f64,
}

impl Transfer {
    /// Electrons between black and white.
    pub fn full_well_electrons(&self) -> f64 {
        self.gain[3].value * (self.white - self.black.value)
    }

    /// Noise of a dark pixel, electrons.
    pub fn read_electrons(&self) -> f64 {
        self.gain[3].value * self.read_dn.value
    }

    /// What a user should know of it.
    pub fn warnings(&self) -> Vec<String> {
        let mut all = Vec::new();
        let [red, green, blue, _] = self.gain;
        for (name, gain) in [("red", red), ("blue", blue)] {
            let (apart, error) = (gain.value / green.value - 1.0, gain.error.hypot(green.error) / green.value);
            if apart.abs() > 0.03 && apart.abs() > 4.0 * error {
                let percent = 100.0 * apart;
                all.push(format!("{name} pixels have {percent:+.1} % of green's electrons a digital number: the camera scales its colours before it writes them"));
            }
        }
        if self.scatter > 1.5 {
            all.push(format!("variances lie {:.1} times as far from a line as chance puts them: the frames are not of one ISO, moved, or were changed by the camera", self.scatter));
        }
        if self.cut > 0.01 {
            let percent = 100.0 * self.cut;
            all.push(format!("{percent:.0} % of the dark pixels are 0: the camera takes black off before it writes, so that black and read noise are not what they seem"));
        }
        let apart = self.blacks.iter().map(|b| (b - self.black.value).abs()).fold(0.0, f64::max);
        if apart > 1.0 {
            all.push(format!(
                "black levels of the filter's four places differ by up to {apart:.1} DN; the file names their mean"
            ));
        }
        all
    }
}

/// Black, gain and noise.
///
/// # Errors
/// Fewer than two darks, no two flats of one exposure, frames of other sizes, flats no brighter than darks or cut off everywhere, variances that do not grow
/// with the light.
pub fn transfer(frames: &Frames) -> Result<Transfer> {
    let refuse = |place: &str, found: String, allowed: &str| Err(Error::bad("", place, found, allowed));
    let Frames { darks, flats, cfa, white } = frames;
    let [first, ..] = &darks[..] else { return refuse("darks", "none".into(), "two frames and more") };
    if darks.len() < 2 {
        return refuse("darks", "one".into(), "two frames and more: noise is told by what changes between them");
    }
    let size = first.dim();
    if let Some(other) = darks.iter().chain(flats).find(|f| f.dim() != size) {
        let (found, allowed) = (format!("{:?} beside {size:?}", other.dim()), "frames of one size");
        return refuse("frames", found, allowed);
    }
    if size.0 < TILE || size.1 < TILE {
        return refuse("frames", format!("{size:?}"), "64 pixels a side and more");
    }
    let (blacks, black) = black_levels(darks);
    let read_dn = dark_noise(darks);
    let mut points = Vec::new();
    for [a, b] in pairs(flats, black.value, FAINTEST * read_dn.value) {
        points.extend(tiles(a.view(), b.view(), &blacks, *cfa, *white));
    }
    if points.is_empty() {
        let found = format!("{} flats, no two of one exposure with light and not cut off", flats.len());
        return refuse("flats", found, "two and more of each exposure, brighter than the darks and below saturation");
    }
    let of = |channel: Option<usize>| -> Vec<Point> {
        points.iter().copied().filter(|p| channel.is_none_or(|c| p.channel == c)).collect()
    };
    let all = Line::fit(&of(None), read_dn.value.powi(2));
    if !(all.slope > 0.0 && all.slope.is_finite()) {
        let found = format!("variances that change by {:.2e} DN² a DN", all.slope);
        return refuse("flats", found, "raw frames, whose noise grows with the light");
    }
    let gain = [Some(0), Some(1), Some(2), None].map(|c| {
        let line = Line::fit(&of(c), read_dn.value.powi(2));
        let value = line.slope.recip();
        Measured { value, error: line.error * value * value }
    });
    let names = ["red", "green", "blue"];
    if let Some((name, gain)) = names.iter().zip(&gain).find(|(_, g)| !(g.value > 0.0 && g.value.is_finite())) {
        let found = format!("{name} pixels with {} electrons a DN", gain.value);
        return refuse("flats", found, "raw frames with light, and no colour cut off everywhere");
    }
    let cut = darks.iter().flatten().filter(|v| **v <= 0.0).count() as f64 / (darks.len() * darks[0].len()) as f64;
    Ok(Transfer {
        cut,
        black,
        blacks,
        read_dn,
        gain,
        read_by_flats_dn: all.free_offset.max(0.0).sqrt(),
        scatter: all.scatter,
        points,
        white: *white,
    })
}

/// Means of the four places of the cell, and of all of them; the error is that between frames.
fn black_levels(darks: &[Array2<f32>]) -> ([f64; 4], Measured) {
    let mean = |frame: &Array2<f32>, place: usize| {
        let part = frame.slice(ndarray::s![place / 2..;2, place % 2..;2]);
        part.iter().map(|v| f64::from(*v)).sum::<f64>() / part.len() as f64
    };
    let each: Vec<[f64; 4]> = darks.iter().map(|d| std::array::from_fn(|place| mean(d, place))).collect();
    let n = each.len() as f64;
    let blacks: [f64; 4] = std::array::from_fn(|place| each.iter().map(|m| m[place]).sum::<f64>() / n);
    let means: Vec<f64> = each.iter().map(|m| m.iter().sum::<f64>() / 4.0).collect();
    let value = means.iter().sum::<f64>() / n;
    let spread = means.iter().map(|m| (m - value).powi(2)).sum::<f64>() / (n - 1.0);
    (blacks, Measured { value, error: (spread / n).sqrt() })
}

/// Noise of a pixel over exposures, from frames that follow each other.
fn dark_noise(darks: &[Array2<f32>]) -> Measured {
    let (mut square, mut count) = (0.0, 0.0);
    for pair in darks.windows(2) {
        let n = pair[0].len() as f64;
        let differences = || pair[0].iter().zip(&pair[1]).map(|(a, b)| f64::from(a - b));
        let mean = differences().sum::<f64>() / n;
        square += differences().map(|d| (d - mean).powi(2)).sum::<f64>() / 2.0;
        count += n - 1.0;
    }
    let value = (square / count).sqrt();
    // Neighbouring differences share a frame (J. von Neumann, Ann. Math. Stat. 12(4), 1941): of n frames the variance is (3n − 4)/(2(n − 1)) times that of
    // as many that share none.
    let n = darks.len() as f64;
    Measured { value, error: value * ((3.0 * n - 4.0) / (2.0 * (n - 1.0)) / (2.0 * count)).sqrt() }
}

/// Flats of one exposure that follow each other by their means, each used once; those with less light than `faintest` tell nothing.
fn pairs(flats: &[Array2<f32>], black: f64, faintest: f64) -> Vec<[&Array2<f32>; 2]> {
    let light = |f: &Array2<f32>| f.iter().map(|v| f64::from(*v)).sum::<f64>() / f.len() as f64 - black;
    let mut by_light: Vec<(f64, &Array2<f32>)> =
        flats.iter().map(|f| (light(f), f)).filter(|f| f.0 > faintest).collect();
    by_light.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut pairs = Vec::new();
    let mut rest = &by_light[..];
    while let [a, b, more @ ..] = rest {
        if b.0 - a.0 < SAME * b.0 {
            pairs.push([a.1, b.1]);
            rest = more;
        } else {
            rest = &rest[1..];
        }
    }
    pairs
}

/// The points of a pair of flats.
fn tiles(a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>, blacks: &[f64; 4], cfa: Cfa, white: f64) -> Vec<Point> {
    let (rows, columns) = a.dim();
    let mut points = Vec::new();
    for (top, left) in (0..rows / TILE).flat_map(|r| (0..columns / TILE).map(move |c| (r * TILE, c * TILE))) {
        for (place, black) in blacks.iter().enumerate() {
            let part = ndarray::s![top + place / 2..top + TILE;2, left + place % 2..left + TILE;2];
            let (a, b) = (a.slice(part), b.slice(part));
            let ceiling = ceiling(*black, white);
            if a.iter().chain(&b).any(|v| f64::from(*v) > ceiling) {
                continue;
            }
            let n = a.len() as f64;
            let mean = |part: &ArrayView2<'_, f32>| part.iter().map(|v| f64::from(*v)).sum::<f64>() / n - black;
            let [of_a, of_b] = [mean(&a), mean(&b)];
            if of_a <= 0.0 || of_b <= 0.0 {
                continue;
            }
            // a − g b has no mean; what both have in common goes with it. One number of the n is spent on g.
            let g = of_a / of_b;
            let difference = |(a, b): (&f32, &f32)| (f64::from(*a) - black) - g * (f64::from(*b) - black);
            let square = a.iter().zip(&b).map(difference).map(|d| d * d).sum::<f64>() / (n - 1.0);
            let mean = 0.5 * (of_a + of_b);
            let channel = cfa.channel(place / 2, place % 2);
            points.push(Point { channel, mean, variance: square / (1.0 + g * g), pixels: a.len() });
        }
    }
    points
}

/// Variance over mean.
struct Line {
    /// Per DN, through the dark frames' own variance.
    slope: f64,
    /// Its standard error.
    error: f64,
    /// Variance without light of the line that is free there.
    free_offset: f64,
    scatter: f64,
}

impl Line {
    /// By least squares, each variance weighted by what its pixel count lets expect of it: `2 σ⁴ / n`.
    fn fit(points: &[Point], dark: f64) -> Self {
        let rough: [f64; 2] = points.iter().fold([0.0; 2], |[v, m], p| [v + p.variance - dark, m + p.mean]);
        let mut slope = rough[0] / rough[1];
        let spread = |p: &Point, slope: f64| 2.0 * (dark + slope.max(0.0) * p.mean).powi(2) / p.pixels as f64;
        let weight = |p: &Point, slope: f64| spread(p, slope).max(f64::MIN_POSITIVE).recip();
        for _ in 0..ROUNDS {
            let [up, down] = points.iter().fold([0.0; 2], |[up, down], p| {
                let w = weight(p, slope);
                [up + w * p.mean * (p.variance - dark), down + w * p.mean * p.mean]
            });
            slope = up / down;
        }
        let [mut w1, mut wm, mut wv, mut wmm, mut wmv] = [0.0; 5];
        let mut off = 0.0;
        for p in points {
            let w = weight(p, slope);
            (w1, wm, wv, wmm, wmv) = (
                w1 + w,
                wm + w * p.mean,
                wv + w * p.variance,
                wmm + w * p.mean * p.mean,
                wmv + w * p.mean * p.variance,
            );
            off += w * (p.variance - dark - slope * p.mean).powi(2);
        }
        let free_offset = (wmm * wv - wm * wmv) / (w1 * wmm - wm * wm);
        let scatter = (off / (points.len() as f64 - 1.0).max(1.0)).sqrt();
        Self { slope, error: (1.0 / wmm).sqrt() * scatter.max(1.0), free_offset, scatter }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::noise::standard_normal;

    /// Frames of a sensor of known gain and noise: electrons by a law of their own (normal, rounded), pixels of other gain, vignetting, a lamp that flickers,
    /// whole digital numbers.
    fn frames(gain: f64, read: f64, levels: &[f64]) -> Frames {
        let (rows, columns, black) = (256, 384, 512.0);
        let draw = |seed| standard_normal::<f64>(seed, (rows, columns));
        let uneven = draw(999);
        let frame = |seed: u64, level: f64| {
            let eps = [draw(2 * seed), draw(2 * seed + 1)];
            let flicker = 1.0 + 0.004 * (seed as f64 * 1.7).sin();
            Array2::from_shape_fn((rows, columns), |(r, c)| {
                let far = (r as f64 / 256.0 - 0.5).hypot(c as f64 / 384.0 - 0.5);
                let colour = [0.6, 1.0, 1.0, 0.8][(r % 2) * 2 + c % 2];
                let light = level * flicker * colour * (1.0 - far * far) * (1.0 + 0.01 * uneven[[r, c]]);
                let electrons = (light + light.sqrt() * eps[0][[r, c]]).round().max(0.0) + read * eps[1][[r, c]];
                (black + electrons / gain).round().min(16383.0) as f32
            })
        };
        Frames {
            darks: (0..4).map(|k| frame(100 + k, 0.0)).collect(),
            flats: levels
                .iter()
                .enumerate()
                .flat_map(|(k, l)| [frame(2 * k as u64, *l), frame(2 * k as u64 + 1, *l)])
                .collect(),
            cfa: Cfa::RGGB,
            white: 16383.0,
        }
    }

    /// Several sensors, one pair of flats and four: gain and noise within four standard errors, which are below a percent; rounding to whole numbers is
    /// noise too (a twelfth of a square).
    #[test]
    fn gain_and_noise_are_found() {
        for (gain, read, levels) in [
            (2.0, 6.0, vec![1000.0, 4000.0, 12000.0, 24000.0]),
            (0.5, 2.5, vec![3000.0]),
            (8.0, 20.0, vec![20000.0, 90000.0]),
        ] {
            let t = transfer(&frames(gain, read, &levels)).expect("measures");
            assert!((t.black.value - 512.0).abs() < 0.05, "{:?}", t.black);
            let noise = (read / gain).hypot(12f64.sqrt().recip());
            assert!((t.read_dn.value - noise).abs() < 4.0 * t.read_dn.error + 0.005 * noise, "{:?} {noise}", t.read_dn);
            for (found, most) in t.gain.into_iter().zip([0.02, 0.02, 0.02, 0.01]) {
                let near = (found.value - gain).abs() < 4.0 * found.error;
                assert!(near && found.error < most * gain, "{gain}: {found:?}");
            }
            assert!((0.8..1.2).contains(&t.scatter), "{}", t.scatter);
            assert!(t.warnings().is_empty(), "{:?}", t.warnings());
            assert!((t.full_well_electrons() / (gain * (16383.0 - 512.0)) - 1.0).abs() < 0.01);
        }
    }

    /// Colours that the camera has scaled are told.
    #[test]
    fn what_is_no_raw_frame_is_told() {
        let mut scaled = frames(2.0, 6.0, &[4000.0, 12000.0]);
        for flat in &mut scaled.flats {
            flat.indexed_iter_mut()
                .filter(|((r, c), _)| r % 2 == 1 && c % 2 == 1)
                .for_each(|(_, v)| *v = (512.0 + 1.5 * (*v - 512.0)).round());
        }
        let told = transfer(&scaled).expect("measures").warnings();
        assert!(told.iter().any(|w| w.starts_with("blue pixels")), "{told:?}");
    }

    #[test]
    fn frames_that_tell_nothing_are_refused() {
        let whole = frames(2.0, 6.0, &[4000.0]);
        let mut green = whole.flats[0].clone();
        green.indexed_iter_mut().filter(|((r, c), _)| (r + c) % 2 == 1).for_each(|(_, v)| *v = 16383.0);
        for (frames, words) in [
            (Frames { darks: vec![], ..whole.clone() }, "darks"),
            (Frames { darks: whole.darks[..1].to_vec(), ..whole.clone() }, "darks"),
            (Frames { flats: whole.flats[..1].to_vec(), ..whole.clone() }, "flats"),
            (Frames { flats: whole.darks.clone(), ..whole.clone() }, "flats"),
            // Green pixels cut off everywhere.
            (Frames { flats: vec![green.clone(); 2], ..whole.clone() }, "flats"),
            (Frames { white: 600.0, ..whole.clone() }, "flats"),
            (Frames { flats: vec![Array2::zeros((3, 4)); 2], ..whole.clone() }, "one size"),
            (Frames { flats: vec![Array2::from_elem((256, 384), 3000.0); 2], ..whole.clone() }, "flats"),
        ] {
            let error = transfer(&frames).expect_err(words);
            assert!(error.exit_code() == 2 && error.to_string().contains(words), "{words}: {error}");
        }
    }
}
