//! Point spread functions of a lens without a prescription, from photographs of a chessboard.
//!
//! The fit of [`super::solve`] says where every edge of the board would stand without blur. What a pixel shows, between the black and the white of the
//! squares around it (`levels.rs`), is then the board's own picture (`board.rs`), moved by every move of a grid and weighted: `y(p) = Σ w(d) B(p − d)`,
//! `B` a pixel's mean. The weights belong to the radius (linear between knots), turn with the azimuth and mirror across the meridian
//! ([`MeasuredPsf`]); edges of one radius are seen under all angles to the meridian, so that a few photographs tell the kernel like the projections
//! of a tomograph. Weights are fitted by least squares, none below zero (`descent.rs`), smooth over moves and radius; how smooth is what predicts
//! half of the board's corners best from the other half. How far the kernels of the two halves differ is their statistical error.
//!
//! Not covered: lenses that are not round, a decentred or tilted one among them; light that goes farther than the reach (veiling glare: it lifts
//! the black squares, and is taken off with them). What the board's places are off by (unflat boards, lens models that do not fit) widens kernels.

mod board;
mod descent;
mod gram;
mod levels;

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use ndarray::ArrayView2;
use rayon::prelude::*;

use super::View;
use super::solve::Fit;
use crate::metrics::slanted_edge::Sites;
use board::{Board, Corner};
use descent::{Smoothness, descend};
use gram::{Gram, Lines, Part, Task};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::{product, threads};
use isoplanat_optics::psf::measured::{MeasuredPsf, Moves};
use levels::Levels;

/// Part of a square that light may move, at most: what arrives at a pixel comes from the four squares about its corner.
const REACH: f64 = 0.4;
/// Smoothness that is tried, of the mean weight of the data, from much to little.
const SMOOTH: [f64; 9] = [1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5];
/// Light that moves more than this part of the reach is said to lie at its end.
const END: f64 = 6.0 / 7.0;
/// Size of the kernels that halves are compared by, pixels beyond the reach.
const MARGIN: f64 = 2.0;

/// What has to be clear of edges between the reach and the middle of a square, pixels: levels are read there.
const CLEAR: f64 = 3.0;
/// Pixels of a colour between two radii, at most.
const PIXELS: usize = 1_000_000;

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Largest move of light, pixels; `None` for the smaller of 8 and what the squares allow.
    pub reach_px: Option<f64>,
    /// Spacing of the moves, pixels.
    pub spacing_px: f64,
    /// Radii, the centre among them.
    pub knots: usize,
    /// Pixels of a colour between two radii.
    pub pixels: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { reach_px: None, spacing_px: 0.5, knots: 9, pixels: 16_000 }
    }
}

/// Largest move of light where none is asked for, pixels.
const OWN_REACH: f64 = 8.0;

/// A photograph's pixels.
#[derive(Clone, Debug)]
pub struct Pixels<'a> {
    /// One channel or R, G, B: linear values, and which pixels count.
    pub channels: Vec<(ArrayView2<'a, f64>, Sites)>,
    /// Levels at which values are cut off.
    pub range: Option<[f64; 2]>,
}

/// How a channel's fit came out.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Quality {
    /// Smoothness that predicted best.
    pub smoothness: f64,
    /// Root mean square distance of pixels from the fit, of the contrast.
    pub rms: f64,
    /// The same of pixels of one half from the fit to the other.
    pub held_out_rms: f64,
    /// The same of pixels that no edge is near: what noise and paper leave of any fit.
    pub noise: f64,
    /// Pixels that were fitted; they are drawn, and some of them twice.
    pub pixels: usize,
    /// By knot: how far the kernels of the two halves are from their mean, L2, of the mean.
    pub half_difference: Vec<f64>,
    /// By knot: share of the light in the outer seventh of the reach.
    pub at_the_end: Vec<f64>,
    /// Largest distance of a kernel's sum from one before it was made one.
    pub sum_error: f64,
}

/// Measured kernels and how good they are.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The kernels.
    pub psf: MeasuredPsf,
    /// By channel.
    pub quality: Vec<Quality>,
}

/// Edges of photograph after photograph, added up: only one has to be in memory.
pub struct Edges {
    size: [usize; 2],
    centre: DVec2,
    moves: Moves,
    radii: Vec<f64>,
    /// By photograph.
    boards: Vec<Board>,
    /// Intervals between knots and halves of the corners, always in this order: sums do not depend on how work is shared.
    tasks: Vec<Task>,
    /// `[task][channel]`.
    parts: Vec<Vec<Part>>,
    /// By channel: squares of the noise, added up, and photographs.
    noise: Vec<f64>,
    seen: usize,
}

impl Edges {
    /// Ready for the photographs whose corners are `views` and whose camera is `fit`; pictures have `size` columns and rows.
    ///
    /// # Errors
    /// Settings that are none; corners too near to each other for the reach, or all near the centre.
    pub fn new(views: &[View], fit: &Fit, size: [usize; 2], settings: &Settings) -> Result<Self> {
        let Settings { spacing_px, knots, pixels, .. } = *settings;
        if !(2..=64).contains(&knots) || !(1..=PIXELS).contains(&pixels) || !(0.1..=1.0).contains(&spacing_px) {
            let found = format!("{knots} radii, {pixels} pixels, a spacing of {spacing_px}");
            let allowed = format!("2 to 64 radii, 1 to {PIXELS} pixels, a spacing of 0.1 to 1 pixels");
            return Err(Error::bad("", "settings", found, allowed));
        }
        let centre = fit.camera.centre_px;
        let boards: Vec<Board> =
            views.iter().zip(&fit.poses).map(|(v, p)| Board::new(&fit.camera, fit.max_slope, v, p)).collect();
        // As far as the grid goes.
        let reach_px = (reach(&boards, settings)? / spacing_px + 1e-9).floor() * spacing_px;
        let moves = Moves::within(reach_px, spacing_px)?;
        let large = |c: &&Corner| REACH * c.side_px[0] >= reach_px;
        let far = boards.iter().flat_map(|b| b.corners().filter(large)).map(|c| c.at.distance(centre));
        let radii = radii(far.fold(0.0, f64::max), size, knots)?;
        let tasks = (0..2)
            .flat_map(|half| (0..knots - 1).map(move |interval| (half, interval)))
            .map(|(half, interval)| {
                let ring = [radii[interval], radii[interval + 1]];
                let mut patches = Vec::new();
                for (k, board) in boards.iter().enumerate() {
                    for corner in board.corners().filter(large) {
                        if (corner.parity + k) % 2 == half && corner.meets(ring, centre, reach_px) {
                            patches.push((k, *corner));
                        }
                    }
                }
                Task { interval, half, share: (pixels / 2).div_ceil(patches.len().max(1)), patches }
            })
            .collect();
        let (parts, noise) = (Vec::new(), Vec::new());
        Ok(Self { size, centre, moves, radii, boards, tasks, parts, noise, seen: 0 })
    }

    /// Largest move of light that is looked for, pixels.
    pub fn reach_px(&self) -> f64 {
        self.moves.reach_px
    }

    /// Bytes that all sums take of three channels, once more as halves and whole, and the board's pictures.
    pub fn bytes(&self) -> u64 {
        let (n, knots) = (self.moves.len(), self.radii.len());
        let sums = product(&[3 * (3 * self.tasks.len() + 3 * 2 * knots), n, n, size_of::<f64>()]);
        sums.saturating_add(product(&[threads(), board::picture_bytes(self.moves.reach_px)]))
    }

    /// Adds the pixels of photograph `k`; as it is where it is refused.
    ///
    /// # Errors
    /// Another number of channels than the first's; squares without levels, or too small for the reach.
    pub fn add(&mut self, k: usize, pixels: &Pixels<'_>) -> Result<()> {
        let channels = pixels.channels.len();
        if self.seen > 0 && channels != self.noise.len() {
            let found = format!("{channels} channels");
            return Err(Error::bad("", "channels", found, format!("{}, as the first picture's", self.noise.len())));
        }
        if !self.tasks.iter().any(|t| t.patches.iter().any(|p| p.0 == k)) {
            let allowed = format!("squares of {:.0} pixels and more, or a smaller reach", self.moves.reach_px / REACH);
            return Err(Error::bad("", "chart", "squares that are too small for the reach", allowed));
        }
        let board = &self.boards[k];
        let reach_px = self.moves.reach_px;
        let levels: Vec<Levels> =
            (0..channels).map(|c| Levels::fit(pixels, c, board, reach_px, k as u64)).collect::<Result<_>>()?;
        if self.seen == 0 {
            let none = || (0..channels).map(|_| Part::new(self.moves.len())).collect();
            self.parts = self.tasks.iter().map(|_| none()).collect();
            self.noise = vec![0.0; channels];
        }
        let lines =
            Lines { moves: &self.moves, radii: &self.radii, centre: self.centre, board, levels: &levels, pixels };
        self.parts.par_iter_mut().zip(&self.tasks).for_each(|(parts, task)| lines.add(task, k, parts));
        self.noise.iter_mut().zip(&levels).for_each(|(sum, l)| *sum += l.noise.powi(2));
        self.seen += 1;
        Ok(())
    }

    /// Fits the kernels. `progress` hears the share done.
    ///
    /// # Errors
    /// No photograph, or no edge at some radius.
    pub fn fit(&self, progress: &(dyn Fn(f64) + Sync)) -> Result<Measured> {
        let done = AtomicUsize::new(0);
        let channels = self.noise.len();
        if self.seen == 0 {
            return Err(Error::bad("", "charts", "no picture with edges", "photographs of a chessboard"));
        }
        for (task, parts) in self.tasks.iter().zip(&self.parts) {
            if parts.iter().any(|p| p.pixels == 0) {
                let [from, to] = [self.radii[task.interval], self.radii[task.interval + 1]];
                let found = format!("no edges between {from:.0} and {to:.0} pixels from the centre");
                return Err(Error::bad("", "charts", found, "boards over the whole field, from the centre outwards"));
            }
        }
        let fitted: Vec<ChannelFit> = (0..channels)
            .into_par_iter()
            .map(|channel| {
                let gram = |half: usize| {
                    let own = self.tasks.iter().zip(&self.parts).filter(|(t, _)| t.half == half);
                    Gram::of(own.map(|(_, p)| &p[channel]), self.moves.len())
                };
                let fitted = channel_fit(&self.moves, &[gram(0), gram(1)]);
                progress((1 + done.fetch_add(1, Ordering::Relaxed)) as f64 / channels as f64);
                fitted
            })
            .collect::<Result<_>>()?;
        let made = |of: &dyn Fn(&ChannelFit) -> &Vec<Vec<f64>>| {
            let weights = (0..self.radii.len()).map(|j| fitted.iter().map(|f| of(f)[j].clone()).collect()).collect();
            let (centre, radii) = (self.centre.to_array(), self.radii.clone());
            MeasuredPsf::new(self.size, centre, self.moves.clone(), radii, weights)
        };
        let psf = made(&|f| &f.whole)?;
        let halves = [made(&|f| &f.halves[0])?, made(&|f| &f.halves[1])?];
        let quality = fitted.iter().enumerate().map(|(c, f)| self.quality(c, f, &psf, &halves)).collect();
        Ok(Measured { psf, quality })
    }

    fn quality(&self, channel: usize, fit: &ChannelFit, psf: &MeasuredPsf, halves: &[MeasuredPsf; 2]) -> Quality {
        let reach_px = self.moves.reach_px;
        let difference = |radius: &f64| {
            let kernel = |psf: &MeasuredPsf| psf.kernel(*radius, channel, [1.0, 0.0], side(reach_px));
            let (a, b, mean) = (kernel(&halves[0]), kernel(&halves[1]), kernel(psf));
            let off: f64 = a.iter().zip(&b).map(|(a, b)| (0.5 * (a - b)).powi(2)).sum();
            (off / mean.iter().map(|v| v * v).sum::<f64>()).sqrt()
        };
        let far = |j: usize| {
            let all = self.moves.iter().zip(psf.weights(j, channel));
            all.filter(|((at, _), _)| at[0].hypot(at[1]) > END * reach_px).map(|((_, n), w)| n * w).sum()
        };
        Quality {
            smoothness: fit.smoothness,
            rms: fit.rms,
            held_out_rms: fit.held_out_rms,
            noise: (self.noise[channel] / self.seen as f64).sqrt(),
            pixels: fit.pixels,
            half_difference: self.radii.iter().map(difference).collect(),
            at_the_end: (0..self.radii.len()).map(far).collect(),
            sum_error: fit.sum_error,
        }
    }
}

/// Pixels along a side of a kernel that holds all moves.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded")]
pub fn side(reach_px: f64) -> usize {
    2 * (reach_px + MARGIN).ceil() as usize + 1
}

/// The reach: as asked for, or as the squares allow.
fn reach(boards: &[Board], settings: &Settings) -> Result<f64> {
    let mut sides: Vec<f64> = boards.iter().flat_map(Board::corners).map(|c| c.side_px[0]).collect();
    if sides.is_empty() {
        return Err(Error::bad("", "charts", "no corners", "photographs of a chessboard"));
    }
    let tenth = sides.len() / 10;
    let small = *sides.select_nth_unstable_by(tenth, f64::total_cmp).1;
    let reach = settings.reach_px.unwrap_or(OWN_REACH.min(REACH * small).min(0.5 * small - CLEAR));
    if !(1.0..=64.0).contains(&reach) {
        let found = format!("{reach:.2} pixels; a tenth of the squares are smaller than {small:.1} pixels");
        return Err(Error::bad("", "reach", found, "1 to 64 pixels, 0.4 of the squares' sides at most"));
    }
    Ok(reach)
}

/// Even radii from the centre to the farthest corner that is used.
fn radii(far: f64, size: [usize; 2], knots: usize) -> Result<Vec<f64>> {
    let [columns, rows] = size.map(|n| n as f64);
    if far < 0.05 * columns.hypot(rows) {
        let found = format!("corners with squares that are large enough out to {far:.0} pixels from the centre");
        return Err(Error::bad("", "charts", found, "corners out to where the PSF is wanted, a smaller reach"));
    }
    Ok((0..knots).map(|j| far * j as f64 / (knots - 1) as f64).collect())
}

/// Weights of a channel, `[knot][move]`.
type Weights = Vec<Vec<f64>>;

/// One channel's kernels.
struct ChannelFit {
    whole: Weights,
    halves: [Weights; 2],
    smoothness: f64,
    rms: f64,
    held_out_rms: f64,
    pixels: usize,
    sum_error: f64,
}

/// The smoothness that predicts best, and the fit with it.
fn channel_fit(moves: &Moves, halves: &[Gram; 2]) -> Result<ChannelFit> {
    let smooth = Smoothness::new(moves);
    let all = halves[0].and(&halves[1]);
    let start = vec![vec![0.0; moves.len()]; all.knots()];
    let mut at = [start.clone(), start.clone()];
    let mut best: Option<(f64, f64, [Weights; 2])> = None;
    for smoothness in SMOOTH {
        for (half, weights) in at.iter_mut().enumerate() {
            *weights = descend(&halves[half], &smooth, smoothness, std::mem::take(weights));
        }
        let square = halves[1].square(&at[0]) + halves[0].square(&at[1]);
        match &best {
            Some((_, least, _)) if square > *least * 1.02 => break,
            Some((_, least, _)) if square >= *least => {}
            _ => best = Some((smoothness, square, at.clone())),
        }
    }
    let Some((smoothness, held_out, mut of_halves)) = best else {
        return Err(Error::Internal("no smoothness was tried".into()));
    };
    let mut whole = descend(&all, &smooth, smoothness, of_halves[0].clone());
    let rms = (all.square(&whole) / all.weight).sqrt();
    let mut sum_error = 0.0f64;
    for (is_whole, weights) in std::iter::once((true, &mut whole)).chain(of_halves.iter_mut().map(|h| (false, h))) {
        for of_knot in weights.iter_mut() {
            let sum: f64 = moves.iter().zip(&*of_knot).map(|((_, n), w)| n * w).sum();
            if sum.is_nan() || sum < 0.1 {
                return Err(Error::bad("", "charts", "no light at a radius", "corners over the whole field"));
            }
            if is_whole {
                sum_error = sum_error.max((sum - 1.0).abs());
            }
            of_knot.iter_mut().for_each(|w| *w /= sum);
        }
    }
    Ok(ChannelFit {
        whole,
        halves: of_halves,
        smoothness,
        rms,
        held_out_rms: (held_out / all.weight).sqrt(),
        pixels: all.pixels,
        sum_error,
    })
}

#[cfg(test)]
mod tests;
