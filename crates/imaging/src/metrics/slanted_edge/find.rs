//! The largest part of a picture that holds one straight edge and nothing else.
//!
//! Windows of falling size are laid over the picture, each seen at about forty cells a side. A window will do where one step
//! across a straight line explains most of it, and a profile across that line nearly all of it but noise. Of a chart the window is taken whose edge is slanted:
//! one along rows or columns cannot be measured, however large it stands there.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

use super::line::Line;
use super::refine;
use super::samples::{Rectangle, Sample, Sites};
use super::step::{self, Step};
use isoplanat_base::error::{Error, Result};

/// Cells a side that a window is looked at with.
const CELLS: usize = 40;
/// Least cells across a picture.
const LEAST_CELLS: usize = 4;
/// Least window, pixels.
const LEAST: usize = 24;
/// What a step must explain of a window's variance beyond noise, and what the profile across it must.
const EXPLAINED: [f64; 2] = [0.75, 0.95];
/// Least share of a window on either side of the edge.
const SIDE: f64 = 0.12;
/// Slant of an edge, degrees from rows and columns, and pixels that it crosses of them, from which it is surely slanted.
const SLANT: f64 = 0.5;
const CROSSED: f64 = 2.0;
/// Windows of one size whose edge is looked at more closely, the best first.
const TRIED: usize = 64;

/// The largest window with one straight edge among the pixels of `plane` that count; of those with a slanted edge, where there is one.
///
/// # Errors
/// A value that is not finite; a picture without such a window.
pub fn find_region<T: Copy + Into<f64> + Sync>(plane: ArrayView2<'_, T>, sites: Sites) -> Result<Rectangle> {
    let (rows, columns) = plane.dim();
    let mosaic = sites != Sites::ALL;
    Rectangle::whole((rows, columns)).check((rows, columns), super::LEAST_SIDE)?;
    check(plane, sites)?;
    let mut share = 1.0;
    let mut any = false;
    let mut straight = None;
    while share == 1.0 || share * rows.max(columns) as f64 >= LEAST as f64 {
        let longer = (share * rows.max(columns) as f64) as usize;
        let size = [rows, columns].map(|n| n.min(if share == 1.0 { n } else { longer.max(LEAST) }));
        // A strip is seen by its width.
        let mut side = longer.div_ceil(CELLS).min(rows.min(columns) / LEAST_CELLS).max(1);
        // A cell of a mosaic holds every colour.
        side += usize::from(mosaic && side % 2 == 1);
        let cells = reduced(plane, sites, side);
        let noise = noise(cells.view());
        let window = size.map(|n| (n / side).max(1));
        any |= cells.iter().any(|v| *v != cells[[0, 0]]);
        let columns_of = starts(cells.ncols(), window[1]);
        let in_row = |row: usize| {
            let scores = columns_of.iter().filter_map(|&column| {
                let part = cells.slice(s![row..row + window[0], column..column + window[1]]);
                judged(part, noise).map(|(score, line)| (score, line, [row, column]))
            });
            scores.collect::<Vec<_>>()
        };
        let rows_of: Vec<_> = starts(cells.nrows(), window[0]).into_par_iter().map(in_row).collect();
        let mut fitting: Vec<_> = rows_of.into_iter().flatten().collect();
        // The first of equal ones.
        fitting.sort_by(|a, b| b.0.total_cmp(&a.0));
        let [height, width] = window.map(|n| n * side);
        let placed = |[row, column]: [usize; 2]| match share == 1.0 {
            true => Rectangle::whole((rows, columns)),
            false => Rectangle { x: column * side, y: row * side, width, height },
        };
        let slanted = fitting.iter().take(TRIED).find(|(_, line, [row, column])| {
            let part = cells.slice(s![*row..row + window[0], *column..column + window[1]]);
            is_slanted(refine::logistic(&samples(part), *line).0.angle, [width, height])
        });
        if let Some((_, _, at)) = slanted {
            return Ok(placed(*at));
        }
        straight = straight.or_else(|| fitting.first().map(|(_, _, at)| placed(*at)));
        share *= 0.75;
    }
    if let Some(region) = straight {
        return Ok(region);
    }
    let found = if any { "no single straight edge was found" } else { "all pixels are equal" };
    let allowed = "a picture of a straight edge between two even areas, or a region (x,y,w,h) that holds one";
    Err(Error::bad("", "picture", found, allowed))
}

/// Whether an edge whose normal has this angle crosses rows or columns for certain in a window of so many columns and rows.
fn is_slanted(angle: f64, [columns, rows]: [usize; 2]) -> bool {
    let [across, along] = [angle.cos().abs(), angle.sin().abs()];
    let length = if across > along { rows } else { columns };
    let slant = across.min(along).atan2(across.max(along));
    slant >= SLANT.to_radians() && slant.tan() * length as f64 >= CROSSED
}

/// Where windows of `size` start on `all` cells: a third of a window apart, the last at the end.
fn starts(all: usize, size: usize) -> Vec<usize> {
    let last = all.saturating_sub(size);
    let mut out: Vec<usize> = (0..last).step_by((size / 3).max(1)).collect();
    out.push(last);
    out
}

/// Means of the pixels that count over whole cells of `side` pixels.
fn reduced<T: Copy + Into<f64> + Sync>(plane: ArrayView2<'_, T>, sites: Sites, side: usize) -> Array2<f64> {
    let columns = plane.ncols() / side;
    let mut sums = Array2::zeros((plane.nrows() / side, columns));
    let bands = sums.axis_iter_mut(Axis(0)).into_par_iter().zip(plane.axis_chunks_iter(Axis(0), side)).enumerate();
    bands.for_each(|(band, (mut sums, part))| {
        let mut counts = vec![0.0f64; columns];
        for (i, row) in part.outer_iter().enumerate() {
            let r = band * side + i;
            for (c, v) in row.iter().enumerate().take(columns * side).filter(|(c, _)| sites.has(r, *c)) {
                sums[c / side] += (*v).into();
                counts[c / side] += 1.0;
            }
        }
        sums.iter_mut().zip(counts).for_each(|(sum, n)| *sum /= n.max(1.0));
    });
    sums
}

/// Refuses values that are not finite, among those that count.
fn check<T: Copy + Into<f64> + Sync>(plane: ArrayView2<'_, T>, sites: Sites) -> Result<()> {
    let wrong = plane.outer_iter().into_par_iter().enumerate().find_map_first(|(r, row)| {
        let at = row.iter().enumerate().find(|(c, v)| sites.has(r, *c) && !(**v).into().is_finite())?;
        Some((r, at.0, (*at.1).into()))
    });
    match wrong {
        Some((r, c, value)) => {
            Err(Error::bad("", format!("pixel at column {c}, row {r}"), value.to_string(), "finite values"))
        }
        None => Ok(()),
    }
}

/// Standard deviation of a cell's noise: the median difference of a cell from its four neighbours, which edges hardly move.
fn noise(cells: ArrayView2<'_, f64>) -> f64 {
    let (rows, columns) = cells.dim();
    let mut off = Vec::new();
    for r in 1..rows.saturating_sub(1) {
        for c in 1..columns.saturating_sub(1) {
            let around = cells[[r - 1, c]] + cells[[r + 1, c]] + cells[[r, c - 1]] + cells[[r, c + 1]];
            off.push((cells[[r, c]] - 0.25 * around).abs());
        }
    }
    off.sort_by(f64::total_cmp);
    // The median of |x| of unit normal noise is 0.6745; the difference has 1.25 times its variance.
    off.get(off.len() / 2).map_or(0.0, |m| m / (0.6745 * 1.25f64.sqrt()))
}

/// The cells of a window.
fn samples(part: ArrayView2<'_, f64>) -> Vec<Sample> {
    part.indexed_iter().map(|((r, c), v)| Sample { x: c as f64, y: r as f64, value: *v }).collect()
}

/// How well one edge explains a window, and where it lies roughly; `None` where it does not.
fn judged(part: ArrayView2<'_, f64>, noise: f64) -> Option<(f64, Line)> {
    let samples = samples(part);
    let centre = Rectangle::whole(part.dim()).centre();
    let Step { angle, offset, explained, contrast } = step::find(&samples, centre, 1.0)?;
    let count = samples.len() as f64;
    let mean = samples.iter().map(|s| s.value).sum::<f64>() / count;
    let total = samples.iter().map(|s| (s.value - mean).powi(2)).sum::<f64>();
    let signal = total - count * noise * noise;
    if contrast < 2.0 * noise || signal <= 0.0 || explained * total < EXPLAINED[0] * signal {
        return None;
    }
    // The profile in bins of one cell, and what it leaves.
    let (sin, cos) = angle.sin_cos();
    let place = |s: &Sample| cos * (s.x - centre[0]) + sin * (s.y - centre[1]) - offset;
    let reach = samples.iter().fold(0.0f64, |m, s| m.max(place(s).abs())).ceil();
    let bins = 2 * reach as usize + 2;
    let bin = |s: &Sample| (place(s) + reach) as usize;
    let mut profile = vec![[0.0; 2]; bins];
    for s in &samples {
        profile[bin(s)] = [profile[bin(s)][0] + 1.0, profile[bin(s)][1] + s.value];
    }
    let between: f64 = profile.iter().filter(|b| b[0] > 0.0).map(|b| b[0] * (b[1] / b[0] - mean).powi(2)).sum();
    let bright = samples.iter().filter(|s| place(s) > 0.0).count() as f64 / count;
    let fits = between >= EXPLAINED[1] * signal && (SIDE..=1.0 - SIDE).contains(&bright);
    fits.then_some((between / total, Line { centre, angle, offset, curvature: 0.0 }))
}
