//! The normal equations of all kernels: blocks of neighbouring radii.

use glam::DVec2;
use ndarray::{Array1, Array2, linalg::general_mat_mul};

use super::Pixels;
use super::board::{Board, Corner, Ideal};
use super::levels::Levels;
use isoplanat_optics::psf::measured::{Moves, knot};

/// Pixels that are put together.
const BATCH: usize = 256;
/// Of the pixels that light from no edge reaches, so many are taken: they tell a kernel's sum.
const FLAT: f64 = 0.1;
/// Places that are tried for a pixel.
const TRIES: usize = 24;

/// Equations of the pixels between two knots: `Σ w (1 − t)² A Aᵀ`, `Σ w (1 − t) t A Aᵀ`, `Σ w t² A Aᵀ` and so on.
pub(super) struct Part {
    blocks: [Array2<f64>; 3],
    right: [Array1<f64>; 2],
    square: f64,
    weight: f64,
    pub(super) pixels: usize,
}

/// Pixels that are added up together: of every second corner, between two knots.
pub(super) struct Task {
    pub(super) interval: usize,
    pub(super) half: usize,
    /// Photograph and corner.
    pub(super) patches: Vec<(usize, Corner)>,
    /// Pixels of a channel for each.
    pub(super) share: usize,
}

/// How lines of one photograph are made.
pub(super) struct Lines<'a, 'b> {
    pub(super) moves: &'a Moves,
    pub(super) radii: &'a [f64],
    pub(super) centre: DVec2,
    pub(super) board: &'a Board,
    pub(super) levels: &'a [Levels],
    pub(super) pixels: &'a Pixels<'b>,
}

/// Lines that wait to be added up.
struct Batch {
    low: Array2<f64>,
    high: Array2<f64>,
    value: Array1<f64>,
    count: usize,
}

impl Part {
    pub(super) fn new(n: usize) -> Self {
        let block = || Array2::zeros((n, n));
        Self {
            blocks: [block(), block(), block()],
            right: [Array1::zeros(n), Array1::zeros(n)],
            square: 0.0,
            weight: 0.0,
            pixels: 0,
        }
    }

    fn add(&mut self, batch: &mut Batch) {
        let some = ndarray::s![..batch.count, ..];
        let (low, high) = (batch.low.slice(some), batch.high.slice(some));
        for (block, (a, b)) in self.blocks.iter_mut().zip([(&low, &low), (&low, &high), (&high, &high)]) {
            general_mat_mul(1.0, &a.t(), b, 1.0, block);
        }
        let value = batch.value.slice(ndarray::s![..batch.count]);
        self.right[0] += &low.t().dot(&value);
        self.right[1] += &high.t().dot(&value);
        self.square += value.dot(&value);
        self.pixels += batch.count;
        batch.count = 0;
    }
}

impl Lines<'_, '_> {
    /// Adds the pixels of photograph `k` that belong to a task, by channel.
    pub(super) fn add(&self, task: &Task, k: usize, parts: &mut [Part]) {
        let n = self.moves.len();
        let batch = || Batch {
            low: Array2::zeros((BATCH, n)),
            high: Array2::zeros((BATCH, n)),
            value: Array1::zeros(BATCH),
            count: 0,
        };
        let mut batches: Vec<Batch> = parts.iter().map(|_| batch()).collect();
        let rng = &mut fastrand::Rng::with_seed(((k * 64 + task.interval) * 2 + task.half) as u64);
        for (_, corner) in task.patches.iter().filter(|p| p.0 == k) {
            self.patch(corner, task, rng, parts, &mut batches);
        }
        for (part, batch) in parts.iter_mut().zip(&mut batches) {
            part.add(batch);
        }
    }

    /// Adds pixels near one corner.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the picture")]
    fn patch(&self, corner: &Corner, task: &Task, rng: &mut fastrand::Rng, parts: &mut [Part], batches: &mut [Batch]) {
        let (rows, columns) = self.pixels.channels[0].0.dim();
        let (at, size) = (corner.at, corner.around_px(self.moves.reach_px));
        let clip = |v: f64, n: usize| v.clamp(0.0, n as f64);
        let low = DVec2::new(clip((at.x - size).floor(), columns), clip((at.y - size).floor(), rows));
        let high = DVec2::new(clip((at.x + size).ceil(), columns), clip((at.y + size).ceil(), rows));
        let span = high - low;
        if span.min_element() < 1.0 {
            return;
        }
        let around = (self.moves.reach_px + 2.0).ceil();
        let from = [(low.x - around) as isize, (low.y - around) as isize];
        let ideal = self.board.picture(from, [(span.x + 2.0 * around) as usize, (span.y + 2.0 * around) as usize]);
        for (channel, (plane, sites)) in self.pixels.channels.iter().enumerate() {
            let (part, batch) = (&mut parts[channel], &mut batches[channel]);
            let mut left = task.share;
            for _ in 0..task.share * TRIES {
                if left == 0 {
                    break;
                }
                let (c, r) = ((low.x + rng.f64() * span.x) as usize, (low.y + rng.f64() * span.y) as usize);
                if c >= columns || r >= rows || !sites.has(r, c) {
                    continue;
                }
                let value = plane[[r, c]];
                if !value.is_finite() || self.pixels.range.is_some_and(|[low, high]| value <= low || value >= high) {
                    continue;
                }
                let pixel = DVec2::new(c as f64 + 0.5, r as f64 + 0.5);
                let (j, t) = knot(self.radii, pixel.distance(self.centre));
                if j != task.interval {
                    continue;
                }
                let Some((spot, clear)) = self.board.clear_px(pixel) else { continue };
                if spot.corner != corner.place || (clear > self.moves.reach_px + 0.5 && rng.f64() > FLAT) {
                    continue;
                }
                let [odd, even] = self.levels[channel].at(pixel);
                let contrast = even - odd;
                let weight = contrast.abs();
                if weight.is_nan() || weight <= 0.0 {
                    continue;
                }
                let k = batch.count;
                self.line(&ideal, pixel, [(1.0 - t) * weight, t * weight], k, batch);
                batch.value[k] = (value - odd) / contrast * weight;
                part.weight += weight * weight;
                batch.count += 1;
                if batch.count == BATCH {
                    part.add(batch);
                }
                left -= 1;
            }
        }
    }

    /// Writes line `k`: the board's picture by every move and its mirror image, times the knots' shares.
    fn line(&self, ideal: &Ideal, pixel: DVec2, shares: [f64; 2], k: usize, batch: &mut Batch) {
        let out = pixel - self.centre;
        let length = out.length();
        let [c, r] = if length > 0.0 { (out / length).to_array() } else { [1.0, 0.0] };
        let low = batch.low.row_mut(k);
        let high = batch.high.row_mut(k);
        for ((([along, across], n), low), high) in self.moves.iter().zip(low).zip(high) {
            let seen = |across: f64| ideal.pixel(pixel - DVec2::new(along * c - across * r, along * r + across * c));
            let both = if n > 1.0 { seen(across) + seen(-across) } else { seen(0.0) };
            *low = shares[0] * both;
            *high = shares[1] * both;
        }
    }
}

/// The normal equations of a set of pixels.
#[derive(Clone)]
pub(super) struct Gram {
    /// `[knot]`: of a knot with itself.
    own: Vec<Array2<f64>>,
    /// `[knot]`: of a knot with the next.
    next: Vec<Array2<f64>>,
    pub(super) right: Vec<Array1<f64>>,
    square: f64,
    /// Sum of the pixels' weights.
    pub(super) weight: f64,
    pub(super) pixels: usize,
}

impl Gram {
    /// From the parts of all intervals, in order.
    pub(super) fn of<'a>(parts: impl Iterator<Item = &'a Part>, n: usize) -> Self {
        let mut gram = Self {
            own: vec![Array2::zeros((n, n))],
            next: Vec::new(),
            right: vec![Array1::zeros(n)],
            square: 0.0,
            weight: 0.0,
            pixels: 0,
        };
        for part in parts {
            let last = gram.own.len() - 1;
            gram.own[last] += &part.blocks[0];
            gram.next.push(part.blocks[1].clone());
            gram.own.push(part.blocks[2].clone());
            gram.right[last] += &part.right[0];
            gram.right.push(part.right[1].clone());
            gram.square += part.square;
            gram.weight += part.weight;
            gram.pixels += part.pixels;
        }
        gram
    }

    /// Of both sets.
    pub(super) fn and(&self, other: &Self) -> Self {
        let mut sum = self.clone();
        let matrices = |a: &mut [Array2<f64>], b: &[Array2<f64>]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        matrices(&mut sum.own, &other.own);
        matrices(&mut sum.next, &other.next);
        sum.right.iter_mut().zip(&other.right).for_each(|(a, b)| *a += b);
        sum.square += other.square;
        sum.weight += other.weight;
        sum.pixels += other.pixels;
        sum
    }

    pub(super) fn knots(&self) -> usize {
        self.own.len()
    }

    /// Diagonal, `[knot][move]`.
    pub(super) fn diagonal(&self) -> Vec<Array1<f64>> {
        self.own.iter().map(|m| m.diag().to_owned()).collect()
    }

    /// The product with weights, `[knot][move]`.
    pub(super) fn times(&self, weights: &[Array1<f64>]) -> Vec<Array1<f64>> {
        let mut out: Vec<Array1<f64>> = self.own.iter().zip(weights).map(|(m, w)| m.dot(w)).collect();
        for (j, m) in self.next.iter().enumerate() {
            out[j] += &m.dot(&weights[j + 1]);
            out[j + 1] += &m.t().dot(&weights[j]);
        }
        out
    }

    /// Sum of the squared distances of the pixels from what weights predict.
    pub(super) fn square(&self, weights: &[Vec<f64>]) -> f64 {
        let weights: Vec<Array1<f64>> = weights.iter().map(|w| Array1::from(w.clone())).collect();
        let product = self.times(&weights);
        let of = |(w, (p, r)): (&Array1<f64>, (&Array1<f64>, &Array1<f64>))| w.dot(p) - 2.0 * w.dot(r);
        (self.square + weights.iter().zip(product.iter().zip(&self.right)).map(of).sum::<f64>()).max(0.0)
    }
}
