//! Colour filters by name: which are developed, and what the others are called.

use isoplanat_imaging::sensor::cfa::Cfa;

/// What a sensor's pixels look through.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    /// A Bayer filter.
    Bayer(Cfa),
    /// All of one colour: a sensor without colours.
    Grey,
    /// What is not developed, by name.
    Other(String),
}

/// Letters of the colours of TIFF/EP and DNG (tag CFAPattern), by number.
const LETTERS: [char; 7] = ['R', 'G', 'B', 'C', 'M', 'Y', 'W'];

/// The filter whose pattern of `rows` × `columns` pixels has these colours, row by row.
pub(super) fn filter(rows: usize, columns: usize, colours: &[u8]) -> Filter {
    let letters = || colours.iter().take(12).map(|c| LETTERS.get(usize::from(*c)).copied().unwrap_or('?'));
    let more = if colours.len() > 12 { "…" } else { "" };
    let unnamed = || format!("a colour filter of {columns} × {rows} pixels, `{}{more}`", letters().collect::<String>());
    if rows == 0 || columns == 0 || rows.checked_mul(columns) != Some(colours.len()) {
        return Filter::Other(format!("a colour filter of {columns} × {rows} pixels with {} colours", colours.len()));
    }
    let at = |r: usize, c: usize| colours[(r % rows) * columns + c % columns];
    // The layout of blocks of `k` × `k` pixels, if the pattern is made of them.
    let blocks = |k: usize| {
        let whole = rows.is_multiple_of(k) && columns.is_multiple_of(k);
        let cfa = Cfa([at(0, 0), at(0, k), at(k, 0), at(k, k)]);
        let all = (0..rows.max(2 * k))
            .all(|r| (0..columns.max(2 * k)).all(|c| at(r, c) == cfa.0[(r / k % 2) * 2 + c / k % 2]));
        (whole && all && Cfa::ALL.contains(&cfa)).then_some(cfa)
    };
    if colours.iter().all(|c| *c == colours[0]) {
        return Filter::Grey;
    }
    if let Some(cfa) = blocks(1) {
        return Filter::Bayer(cfa);
    }
    for (k, name) in [(2, "Quad Bayer"), (3, "Nona Bayer"), (4, "Hexadeca Bayer")] {
        if blocks(k).is_some() {
            return Filter::Other(format!("a {name} filter, blocks of {k} × {k} pixels of one colour"));
        }
    }
    let count = |colour: u8| colours.iter().filter(|c| **c == colour).count();
    if (rows, columns) == (6, 6) && [count(0), count(1), count(2)] == [8, 20, 8] {
        return Filter::Other("an X-Trans filter, 6 × 6 pixels".into());
    }
    Filter::Other(unnamed())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_known_by_their_pattern() {
        for cfa in Cfa::ALL {
            assert_eq!(filter(2, 2, &cfa.0), Filter::Bayer(cfa));
            // The same, stated over more pixels than it needs.
            let wide: Vec<u8> = (0..16).map(|i| cfa.0[(i / 4 % 2) * 2 + i % 2]).collect();
            assert_eq!(filter(4, 4, &wide), Filter::Bayer(cfa));
            for (k, word) in [(2, "Quad Bayer"), (3, "Nona Bayer"), (4, "Hexadeca Bayer")] {
                let side = 2 * k;
                let blocks: Vec<u8> = (0..side * side).map(|i| cfa.0[(i / side / k) * 2 + i % side / k]).collect();
                assert!(matches!(filter(side, side, &blocks), Filter::Other(name) if name.contains(word)), "{cfa} {k}");
            }
        }
        assert_eq!(filter(2, 2, &[1; 4]), Filter::Grey);
        let rgbw = [6, 0, 6, 1, 0, 6, 1, 6, 6, 1, 6, 2, 1, 6, 2, 6];
        for (rows, columns, colours, word) in [
            (4, 4, &rgbw[..], "4 × 4 pixels, `WRWGRWGWWGWB…`"),
            (2, 2, &[3, 4, 5, 1], "`CMYG`"),
            (2, 2, &[0, 1, 1], "with 3 colours"),
            (0, 2, &[], "with 0 colours"),
            (2, 2, &[0, 1, 1, 200], "`RGG?`"),
        ] {
            assert!(matches!(filter(rows, columns, colours), Filter::Other(name) if name.contains(word)), "{word}");
        }
    }
}
