//! Where a chord of the pupil is open, and where it overlaps with itself displaced.

use super::fit::{Surface, chebyshev, slope, value};
use super::pupil::Oriented;

/// Samples between which an edge is looked for.
const SAMPLES: u32 = 24;
/// Chords that show where the displaced pupils overlap.
const LOOK: u32 = 96;

/// An open part of a chord.
pub(super) type Part = [f64; 2];

/// Points of the box where every clip is positive, along the line of constant `eta`.
pub(super) fn open(pupil: &Oriented, eta: f64) -> Vec<Part> {
    let (mut at, mut line) = (Vec::new(), Vec::new());
    chebyshev(eta, pupil.clips.iter().map(Surface::degree).max().unwrap_or(0), &mut at);
    let mut parts: Vec<Part> = pupil.hull.chord(eta).into_iter().collect();
    for clip in &pupil.clips {
        clip.along(&at, &mut line);
        let others: f64 = line[1..].iter().map(|c| c.abs()).sum();
        if line[0] <= others {
            parts = common(&parts, &positive(&line), 0.0);
        }
        if parts.is_empty() {
            break;
        }
    }
    parts
}

/// Common parts of `a` and of `b` moved by `−shift`.
pub(super) fn common(a: &[Part], b: &[Part], shift: f64) -> Vec<Part> {
    let pairs = a.iter().flat_map(|x| b.iter().map(move |y| [x[0].max(y[0] - shift), x[1].min(y[1] - shift)]));
    pairs.filter(|p| p[1] > p[0]).collect()
}

/// Where a series is positive.
fn positive(c: &[f64]) -> Vec<Part> {
    let at = |i: u32| 2.0 * f64::from(i) / f64::from(SAMPLES) - 1.0;
    let values: Vec<(f64, f64)> = (0..=SAMPLES).map(|i| slope(c, at(i))).collect();
    let mut edges = vec![-1.0];
    for (i, pair) in (0..SAMPLES).zip(values.windows(2)) {
        let (a, b) = (at(i), at(i + 1));
        if (pair[0].0 > 0.0) != (pair[1].0 > 0.0) {
            edges.push(root(c, a, b));
        } else if let Some(x) = turn(c, [a, b], [pair[0], pair[1]]) {
            edges.push(root(c, a, x));
            edges.push(root(c, x, b));
        }
    }
    edges.push(1.0);
    let pairs = edges.windows(2).map(|p| [p[0], p[1]]);
    pairs.filter(|p| p[1] > p[0] && value(c, 0.5 * (p[0] + p[1])) > 0.0).collect()
}

/// A point between `a` and `b`, whose values have one sign, where the series has the other.
fn turn(c: &[f64], [mut a, mut b]: [f64; 2], [(va, da), (_, db)]: [(f64, f64); 2]) -> Option<f64> {
    let sign = if va > 0.0 { 1.0 } else { -1.0 };
    if sign * da >= 0.0 || sign * db <= 0.0 {
        return None;
    }
    for _ in 0..40 {
        let x = 0.5 * (a + b);
        let (v, d) = slope(c, x);
        if (v > 0.0) != (va > 0.0) {
            return Some(x);
        }
        if sign * d < 0.0 { a = x } else { b = x }
    }
    None
}

/// The sign change between `a` and `b`, by safeguarded Newton.
fn root(c: &[f64], mut a: f64, mut b: f64) -> f64 {
    let start = value(c, a) > 0.0;
    let mut x = 0.5 * (a + b);
    for _ in 0..50 {
        let (v, d) = slope(c, x);
        if (v > 0.0) == start {
            a = x
        } else {
            b = x
        }
        let next = x - v / d;
        let next = if next > a && next < b { next } else { 0.5 * (a + b) };
        let done = (next - x).abs() <= 1e-14;
        x = next;
        if done {
            break;
        }
    }
    x
}

/// The chords of a pupil, looked at once.
pub(super) struct Chords {
    seen: Vec<(f64, Vec<Part>)>,
    longest: f64,
    /// Where another clip takes over an end.
    corners: Vec<f64>,
}

/// Which clips end the chord first and last, and how many open parts it has.
fn ends(pupil: &Oriented, eta: f64) -> (usize, usize, usize) {
    let parts = open(pupil, eta);
    let (Some(first), Some(last)) = (parts.first(), parts.last()) else { return (0, 0, 0) };
    let (mut at, mut line) = (Vec::new(), Vec::new());
    chebyshev(eta, pupil.clips.iter().map(Surface::degree).max().unwrap_or(0), &mut at);
    let mut by = [(f64::INFINITY, 0); 2];
    for (k, clip) in pupil.clips.iter().enumerate() {
        clip.along(&at, &mut line);
        for (by, x) in by.iter_mut().zip([first[0], last[1]]) {
            let v = value(&line, x).abs();
            if v < by.0 {
                *by = (v, k);
            }
        }
    }
    (by[0].1, by[1].1, parts.len())
}

/// Distance between the outermost open points of a chord.
fn length(parts: &[Part]) -> f64 {
    match (parts.first(), parts.last()) {
        (Some(a), Some(b)) => b[1] - a[0],
        _ => 0.0,
    }
}

impl Chords {
    pub(super) fn new(pupil: &Oriented) -> Self {
        let at = |i: u32| (std::f64::consts::FRAC_PI_2 * (2.0 * (f64::from(i) + 0.5) / f64::from(LOOK) - 1.0)).sin();
        let seen: Vec<(f64, Vec<Part>)> = (0..LOOK).map(|i| (at(i), open(pupil, at(i)))).collect();
        let by_length = |a: &&(f64, Vec<Part>), b: &&(f64, Vec<Part>)| length(&a.1).total_cmp(&length(&b.1));
        let (mut best, mut longest) = seen.iter().max_by(by_length).map_or((0.0, 0.0), |(eta, p)| (*eta, length(p)));
        // Uphill from the longest one.
        let mut step = 2.0 / f64::from(LOOK);
        while step > 1e-6 && longest > 0.0 {
            let tried = [best - step, best + step]
                .map(|eta| (eta.clamp(-1.0, 1.0), length(&open(pupil, eta.clamp(-1.0, 1.0)))));
            match tried.into_iter().find(|(_, l)| *l > longest) {
                Some(better) => (best, longest) = better,
                None => step *= 0.5,
            }
        }
        Self { corners: corners(pupil, &seen), seen, longest }
    }

    /// Longest distance between two open points of one chord: half the support of the transfer function.
    pub(super) fn longest(&self) -> f64 {
        self.longest
    }

    /// Ranges of `η` where the pupil and the pupil displaced by `shift` overlap, parted at the corners of the pupil.
    pub(super) fn ranges(&self, pupil: &Oriented, shift: f64) -> Vec<Part> {
        let mut out = Vec::new();
        for [mut low, high] in self.overlaps(pupil, shift) {
            for corner in &self.corners {
                if *corner > low + 1e-6 && *corner < high - 1e-6 {
                    out.push([low, *corner]);
                    low = *corner;
                }
            }
            out.push([low, high]);
        }
        out
    }

    fn overlaps(&self, pupil: &Oriented, shift: f64) -> Vec<Part> {
        let met = |parts: &[Part]| !common(parts, parts, shift).is_empty();
        let (mut out, mut begin, mut before) = (Vec::new(), None, -1.0);
        for (eta, parts) in &self.seen {
            match (met(parts), begin) {
                (true, None) => begin = Some(end(pupil, shift, *eta, before)),
                (false, Some(from)) => {
                    out.push([from, end(pupil, shift, before, *eta)]);
                    begin = None;
                }
                _ => {}
            }
            before = *eta;
        }
        if let Some(from) = begin {
            out.push([from, end(pupil, shift, before, 1.0)]);
        }
        out
    }
}

/// Heights where [`ends`] changes, by bisection; growing.
fn corners(pupil: &Oriented, seen: &[(f64, Vec<Part>)]) -> Vec<f64> {
    if pupil.clips.len() < 2 {
        return Vec::new();
    }
    let kinds: Vec<_> = seen.iter().map(|(eta, _)| (*eta, ends(pupil, *eta))).collect();
    let changes = kinds.windows(2).filter(|p| p[0].1 != p[1].1 && p[0].1.2 > 0 && p[1].1.2 > 0);
    let corner = |pair: &[(f64, (usize, usize, usize))]| {
        let (mut low, mut high) = (pair[0].0, pair[1].0);
        while high - low > 1e-9 {
            let middle = 0.5 * (low + high);
            if ends(pupil, middle) == pair[0].1 { low = middle } else { high = middle }
        }
        low
    };
    changes.map(corner).collect()
}

/// Longest overlap of a chord with itself displaced; what is missing to one, negative.
fn overlap(pupil: &Oriented, shift: f64, eta: f64) -> f64 {
    let parts = open(pupil, eta);
    let longest = |a: f64, p: &Part| a.max(p[1] - p[0]);
    let met = common(&parts, &parts, shift).iter().fold(0.0, longest);
    if met > 0.0 { met } else { parts.iter().fold(0.0, longest) - shift }
}

/// Where the overlap ends between `inside` and `outside`: bisection with false position (Illinois).
fn end(pupil: &Oriented, shift: f64, inside: f64, outside: f64) -> f64 {
    let (mut a, mut b) = (inside, outside);
    let (mut at_a, mut at_b) = (overlap(pupil, shift, a), overlap(pupil, shift, b));
    if at_b > 0.0 {
        return b;
    }
    for k in 0..40 {
        if (b - a).abs() < 1e-9 {
            break;
        }
        let guess = a + (b - a) * at_a / (at_a - at_b);
        let x = if k % 4 == 3 || !guess.is_finite() || at_b >= 0.0 { 0.5 * (a + b) } else { guess };
        let v = overlap(pupil, shift, x);
        if v > 0.0 {
            (a, at_a) = (x, v);
            at_b *= 0.5;
        } else {
            (b, at_b) = (x, v);
            at_a *= 0.5;
        }
    }
    a
}
