//! Opcode lists of a DNG: what its writer wants done to the samples. The second list is for linearised samples before demosaicking.
//!
//! DNG specification 1.6, chapter 7. Applied are, from the second list, `MapPolynomial` (8: lossy DNGs hold their tone curve there) and
//! `GainMap` (9: shading by lens and sensor), in the list's order. Others (geometry, bad pixels, what comes after demosaicking) are named, so
//! that the user hears of them.

use rawler::formats::tiff::Value;

/// A correction that is applied.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Applied {
    area: Area,
    what: What,
}

#[derive(Clone, Debug, PartialEq)]
enum What {
    /// `y = Σ c_k x^k` on samples from 0 (black) to 1 (white): `c_0, c_1, …`
    Polynomial(Vec<f64>),
    Gains(GainMap),
}

/// The samples that a correction covers.
#[derive(Clone, Debug, PartialEq)]
struct Area {
    /// Rows it covers, from `.0` up to, not including, `.1`.
    rows: (usize, usize),
    /// Columns, likewise.
    columns: (usize, usize),
    /// First plane and number of planes.
    planes: (usize, usize),
    /// Every how many rows and columns it applies.
    step: (usize, usize),
}

/// Gains of a map are within: those of lenses are a few, and products of samples and sums between points stay numbers.
const GAINS: std::ops::RangeInclusive<f32> = -1e6..=1e6;

/// Gains at points of a grid, linear between them, the outermost beyond.
#[derive(Clone, Debug, PartialEq)]
struct GainMap {
    /// Rows and columns of the grid.
    points: (usize, usize),
    /// Between points down and across, of the whole picture's height and width.
    spacing: (f64, f64),
    /// The first point, likewise.
    origin: (f64, f64),
    planes: usize,
    /// `[row, column, plane]`
    gains: Vec<f32>,
}

/// What a list asks for.
#[derive(Debug)]
pub(super) struct List {
    /// What is applied, in order.
    pub(super) applied: Vec<Applied>,
    /// Numbers of what is not.
    pub(super) others: Vec<u32>,
}

impl Applied {
    /// Corrects row `row` of a plane of a picture of `size` rows and columns; samples run from 0 to 1, and are cut off there as the specification asks.
    pub(super) fn apply(&self, plane: usize, row: usize, size: (usize, usize), samples: &mut [f32]) {
        let Area { rows, columns, planes, step } = self.area;
        let covered = (planes.0..planes.0.saturating_add(planes.1)).contains(&plane)
            && (rows.0..rows.1).contains(&row)
            && (row - rows.0).is_multiple_of(step.0);
        let end = columns.1.min(samples.len());
        if !covered || columns.0 >= end {
            return;
        }
        let line = (columns.0..end).step_by(step.1).zip(samples[columns.0..end].iter_mut().step_by(step.1));
        match &self.what {
            What::Polynomial(coefficients) => {
                for (_, v) in line {
                    let x = f64::from(*v);
                    *v = coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c).clamp(0.0, 1.0) as f32;
                }
            }
            What::Gains(map) => {
                let down = place(row, size.0, map.points.0, map.spacing.0, map.origin.0);
                for (c, v) in line {
                    let across = place(c, size.1, map.points.1, map.spacing.1, map.origin.1);
                    *v = (*v * map.at(down, across, plane)).min(1.0);
                }
            }
        }
    }
}

/// Where pixel `k` of `n` lies along the points of a map: the point before it, the one behind, and the share of that.
fn place(k: usize, n: usize, points: usize, spacing: f64, origin: f64) -> (usize, usize, f32) {
    let last = points - 1;
    if last == 0 {
        return (0, 0, 0.0);
    }
    let at = (((k as f64 + 0.5) / n as f64 - origin) / spacing).clamp(0.0, last as f64);
    let before = (at as usize).min(last - 1);
    (before, before + 1, (at - before as f64) as f32)
}

impl GainMap {
    fn at(&self, down: (usize, usize, f32), across: (usize, usize, f32), plane: usize) -> f32 {
        let plane = plane.min(self.planes - 1);
        let gain = |r: usize, c: usize| self.gains[(r * self.points.1 + c) * self.planes + plane];
        let mix = |a: f32, b: f32, share: f32| a + (b - a) * share;
        let row = |r: usize| mix(gain(r, across.0), gain(r, across.1), across.2);
        mix(row(down.0), row(down.1), down.2)
    }
}

/// The name of an opcode.
pub(super) fn name(code: u32) -> String {
    const NAMES: [&str; 14] = [
        "WarpRectilinear",
        "WarpFisheye",
        "FixVignetteRadial",
        "FixBadPixelsConstant",
        "FixBadPixelsList",
        "TrimBounds",
        "MapTable",
        "MapPolynomial",
        "GainMap",
        "DeltaPerRow",
        "DeltaPerColumn",
        "ScalePerRow",
        "ScalePerColumn",
        "WarpRectilinear2",
    ];
    let known = (code as usize).checked_sub(1).and_then(|k| NAMES.get(k));
    known.map_or_else(|| format!("opcode {code}"), |name| (*name).to_owned())
}

/// The bytes of a list; `None` where its entry holds something else.
pub(super) fn bytes(value: &Value) -> Option<&[u8]> {
    match value {
        Value::Byte(bytes) | Value::Undefined(bytes) => Some(bytes),
        _ => None,
    }
}

/// What a list asks for; `None` if it is damaged. Only the second list's corrections are applied.
pub(super) fn parse(list: &[u8], second: bool) -> Option<List> {
    let mut rest = list;
    let count = u32::from_be_bytes(take(&mut rest)?);
    let (mut applied, mut others) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let [code, _version, _flags, size] = words(&mut rest)?;
        let mut body = rest.get(..size as usize)?;
        rest = &rest[size as usize..];
        let read: fn(&mut &[u8]) -> Option<What> = match code {
            8 => polynomial,
            9 => gain_map,
            _ => {
                others.push(code);
                continue;
            }
        };
        if !second {
            others.push(code);
            continue;
        }
        let area = area(&mut body)?;
        applied.push(Applied { area, what: read(&mut body)? });
    }
    Some(List { applied, others })
}

fn area(body: &mut &[u8]) -> Option<Area> {
    let [top, left, bottom, right, plane, planes, down, across] = words::<8>(body)?.map(|v| v as usize);
    let area = Area { rows: (top, bottom), columns: (left, right), planes: (plane, planes), step: (down, across) };
    (down > 0 && across > 0).then_some(area)
}

fn polynomial(body: &mut &[u8]) -> Option<What> {
    let [degree] = words(body)?;
    if degree > 8 {
        return None;
    }
    (0..=degree).map(|_| number(body)).collect::<Option<_>>().map(What::Polynomial)
}

fn gain_map(body: &mut &[u8]) -> Option<What> {
    let [rows, columns] = words::<2>(body)?.map(|v| v as usize);
    let mut pair = || Some((number(body)?, number(body)?));
    let (spacing, origin) = (pair()?, pair()?);
    let [planes] = words::<1>(body)?.map(|v| v as usize);
    let count = rows.checked_mul(columns)?.checked_mul(planes)?;
    // One point is everywhere the same: its spacing means nothing.
    let spaced = |points: usize, spacing: f64| points == 1 || spacing > 0.0;
    if count == 0 || body.len() / 4 < count || !spaced(rows, spacing.0) || !spaced(columns, spacing.1) {
        return None;
    }
    let gains =
        (0..count).map(|_| take(body).map(f32::from_be_bytes).filter(|g| GAINS.contains(g))).collect::<Option<_>>()?;
    Some(What::Gains(GainMap { points: (rows, columns), spacing, origin, planes, gains }))
}

fn number(rest: &mut &[u8]) -> Option<f64> {
    take(rest).map(f64::from_be_bytes).filter(|v| v.is_finite())
}

fn words<const N: usize>(rest: &mut &[u8]) -> Option<[u32; N]> {
    let mut out = [0; N];
    for word in &mut out {
        *word = u32::from_be_bytes(take(rest)?);
    }
    Some(out)
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (bytes, after) = rest.split_first_chunk::<N>()?;
    *rest = after;
    Some(*bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut push = |words: &[u32]| words.iter().for_each(|w| bytes.extend(w.to_be_bytes()));
        push(&[3, 4, 0x0103_0000, 1, 4, 77]);
        push(&[8, 0x0103_0000, 0, 36 + 24, 0, 0, 816, 1224, 1, 1, 1, 1, 2]);
        for c in [0.0_f64, 0.25, 0.75] {
            bytes.extend(c.to_be_bytes());
        }
        let mut push = |words: &[u32]| words.iter().for_each(|w| bytes.extend(w.to_be_bytes()));
        // Gains 1, 2, 3 / 3, 4, 5 at the corners and the middle of the sides, for every other row and third column of all planes.
        push(&[9, 0x0103_0000, 0, 76 + 24, 0, 1, 4, 9, 0, 3, 2, 3, 2, 3]);
        for c in [1.0_f64, 0.5, 0.0, 0.0] {
            bytes.extend(c.to_be_bytes());
        }
        bytes.extend(1u32.to_be_bytes());
        for g in [1.0_f32, 2.0, 3.0, 3.0, 4.0, 5.0] {
            bytes.extend(g.to_be_bytes());
        }
        bytes
    }

    #[test]
    fn polynomials_and_gains_are_read_and_others_named() {
        let List { applied, others } = parse(&list(), true).expect("whole");
        assert_eq!(
            (others.iter().map(|c| name(*c)).collect::<Vec<_>>(), name(99)),
            (vec!["FixBadPixelsConstant".to_owned()], "opcode 99".to_owned())
        );
        let [map, gains] = &applied[..] else { panic!("two: {applied:?}") };
        let on = |a: &Applied, plane: usize, row: usize, v: f32| {
            let mut samples = [v; 9];
            a.apply(plane, row, (4, 9), &mut samples);
            samples
        };
        assert_eq!(on(map, 1, 5, 0.5), [0.3125; 9]);
        assert_eq!((on(map, 1, 5, -0.2), on(map, 1, 5, 2.0)), ([0.0; 9], [1.0; 9]));
        assert_eq!((on(map, 0, 5, 0.5), on(map, 1, 816, 0.5)), ([0.5; 9], [0.5; 9]));
        // Linear in both: 1 + 2 (r + ½) / 4 + 2 (c + ½) / 9, at columns 1, 4, 7 of rows 0 and 2.
        for (row, down) in [(0, 0.25), (2, 1.25)] {
            for (c, v) in on(gains, 2, row, 0.1).into_iter().enumerate() {
                let gain = if c % 3 == 1 { 1.0 + down + 2.0 * (c as f32 + 0.5) / 9.0 } else { 1.0 };
                assert!((v - 0.1 * gain).abs() < 1e-7, "{row} {c}: {v}");
            }
        }
        assert_eq!((on(gains, 0, 1, 0.1), on(gains, 3, 0, 0.1)), ([0.1; 9], [0.1; 9]));
        assert_eq!(on(gains, 0, 0, 0.9)[4], 1.0, "cut off at white");
        assert_eq!(parse(&list(), false).expect("whole").others, [4, 8, 9], "the other lists are not applied");
    }

    /// Gains whose difference is no number would make samples that are none.
    #[test]
    fn gains_beyond_all_lenses_are_a_damaged_list() {
        let (whole, last) = (list(), 5.0f32.to_be_bytes());
        assert!(whole.ends_with(&last));
        for (gain, is_read) in [(1e6, true), (2e6, false), (f32::MAX, false), (f32::INFINITY, false), (f32::NAN, false)]
        {
            let mut changed = whole.clone();
            changed.truncate(whole.len() - 4);
            changed.extend(f32::to_be_bytes(gain));
            assert_eq!(parse(&changed, true).is_some(), is_read, "{gain}");
        }
    }

    #[test]
    fn a_damaged_list_is_none_at_every_length() {
        let whole = list();
        for keep in 0..whole.len() {
            assert!(parse(&whole[..keep], true).is_none(), "{keep}");
        }
    }
}
