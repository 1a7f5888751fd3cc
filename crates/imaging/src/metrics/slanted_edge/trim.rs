//! The part of an edge that one spread function describes: corners and other things at its ends are left out.

use super::refine::Fitted;

/// Pieces that an edge is looked at in.
const PIECES: usize = 16;
/// A piece is foreign where it is off by this many times what pieces usually are, and by this share of the contrast.
const FOREIGN: (f64, f64) = (3.0, 0.02);

/// Beginning and end, along the edge, of the longest run of pieces that agree with the fit; `None` where all do, or few.
pub(super) fn run(fitted: &Fitted) -> Option<[f64; 2]> {
    let [first, last] = fitted.ends();
    let length = (last - first) / PIECES as f64;
    let [low, high] = fitted.spread.levels();
    let mut sums = [[0.0; 2]; PIECES];
    for p in &fitted.points {
        let piece = (((p.t - first) / length).max(0.0) as usize).min(PIECES - 1);
        sums[piece] = [sums[piece][0] + 1.0, sums[piece][1] + (p.value - fitted.spread.at(p.d)).powi(2)];
    }
    let off = sums.map(|[n, s]| (s / f64::max(n, 1.0)).sqrt());
    let mut sorted = off;
    sorted.sort_by(f64::total_cmp);
    let most = f64::max(FOREIGN.0 * sorted[PIECES / 2], FOREIGN.1 * (high - low));
    let (mut best, mut from) = ([0, 0], 0);
    for (i, off) in off.into_iter().chain([f64::INFINITY]).enumerate() {
        if off > most {
            if i - from > best[1] - best[0] {
                best = [from, i];
            }
            from = i + 1;
        }
    }
    let count = best[1] - best[0];
    (PIECES / 4..PIECES).contains(&count).then(|| best.map(|i| first + i as f64 * length))
}
