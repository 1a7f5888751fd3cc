//! `OpcodeList2` of a DNG: what its writer wants done to the linearised samples before demosaicking.
//!
//! Only `MapPolynomial` (opcode 8; DNG specification 1.6, chapter 7) is applied: lossy DNGs hold their tone curve there,
//! and without it the picture is wrong. Others (lens shading, bad pixels) are named so that the user hears of them.

/// One `MapPolynomial`: `y = Σ c_k x^k` on samples from 0 (black) to 1 (white).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MapPolynomial {
    /// Rows it covers, from `.0` up to, not including, `.1`.
    pub(super) rows: (usize, usize),
    /// Columns, likewise.
    pub(super) columns: (usize, usize),
    /// First plane and number of planes.
    pub(super) planes: (usize, usize),
    /// Every how many rows and columns it applies.
    pub(super) step: (usize, usize),
    /// `c_0, c_1, …`
    pub(super) coefficients: Vec<f64>,
}

impl MapPolynomial {
    /// Whether it applies to a sample.
    pub(super) fn covers(&self, plane: usize, row: usize, column: usize) -> bool {
        let on = |at: usize, (from, to): (usize, usize), step: usize| {
            at >= from && at < to && (at - from).is_multiple_of(step)
        };
        let (first, planes) = self.planes;
        (first..first.saturating_add(planes)).contains(&plane)
            && on(row, self.rows, self.step.0)
            && on(column, self.columns, self.step.1)
    }

    /// The polynomial's value, kept within 0 and 1 as the specification asks.
    pub(super) fn at(&self, x: f64) -> f64 {
        self.coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c).clamp(0.0, 1.0)
    }
}

/// The polynomials of a list and the numbers of the opcodes that are not applied; `None` if the list is damaged.
pub(super) fn parse(list: &[u8]) -> Option<(Vec<MapPolynomial>, Vec<u32>)> {
    let mut rest = list;
    let count = take_u32(&mut rest)?;
    let (mut maps, mut others) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let opcode = take_u32(&mut rest)?;
        let (_version, _flags) = (take_u32(&mut rest)?, take_u32(&mut rest)?);
        let size = take_u32(&mut rest)? as usize;
        let mut body = rest.get(..size)?;
        rest = &rest[size..];
        if opcode != 8 {
            others.push(opcode);
            continue;
        }
        let mut next = || take_u32(&mut body).map(|v| v as usize);
        let (top, left, bottom, right) = (next()?, next()?, next()?, next()?);
        let (plane, planes, row_step, column_step, degree) = (next()?, next()?, next()?, next()?, next()?);
        let mut coefficients = Vec::new();
        for _ in 0..=degree.min(8) {
            let (bytes, after) = body.split_first_chunk::<8>()?;
            body = after;
            coefficients.push(Some(f64::from_be_bytes(*bytes)).filter(|c| c.is_finite())?);
        }
        if degree > 8 || row_step == 0 || column_step == 0 {
            return None;
        }
        maps.push(MapPolynomial {
            rows: (top, bottom),
            columns: (left, right),
            planes: (plane, planes),
            step: (row_step, column_step),
            coefficients,
        });
    }
    Some((maps, others))
}

fn take_u32(rest: &mut &[u8]) -> Option<u32> {
    let (bytes, after) = rest.split_first_chunk::<4>()?;
    *rest = after;
    Some(u32::from_be_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut push = |words: &[u32]| words.iter().for_each(|w| bytes.extend(w.to_be_bytes()));
        push(&[2, 9, 0x0103_0000, 1, 4, 77]);
        push(&[8, 0x0103_0000, 0, 36 + 24, 0, 0, 816, 1224, 1, 1, 1, 1, 2]);
        for c in [0.0_f64, 0.25, 0.75] {
            bytes.extend(c.to_be_bytes());
        }
        bytes
    }

    #[test]
    fn polynomials_are_read_and_others_named() {
        let (maps, others) = parse(&list()).expect("whole");
        assert_eq!(others, [9]);
        assert_eq!(maps.len(), 1);
        assert_eq!((maps[0].planes, maps[0].rows, maps[0].columns), ((1, 1), (0, 816), (0, 1224)));
        assert!((maps[0].at(0.5) - (0.125 + 0.1875)).abs() < 1e-15);
        assert_eq!((maps[0].at(-0.2), maps[0].at(2.0)), (0.0, 1.0));
        assert!(maps[0].covers(1, 5, 5) && !maps[0].covers(0, 5, 5) && !maps[0].covers(1, 816, 5));
    }

    #[test]
    fn a_damaged_list_is_none_at_every_length() {
        let whole = list();
        for keep in 0..whole.len() {
            assert!(parse(&whole[..keep]).is_none(), "{keep}");
        }
    }
}
