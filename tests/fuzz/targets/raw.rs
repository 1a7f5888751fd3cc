//! What this program reads of a DNG itself: levels, filters, crops, opcode lists, colours and facts of the exposure. A file of few samples whose entries
//! are the input's; what the decoder alone reads (sizes, strips, compression) stays as it is, since decoding is the business of a child process.

#[path = "../../../crates/camera/src/raw/synthetic.rs"]
#[allow(dead_code, reason = "the tests of its crate use the rest")]
mod synthetic;

use std::path::Path;

use isoplanat::deploy::raw::{RawPixels, decode_bytes};

use self::synthetic::{Synthetic, gain_map, opcodes, polynomial};
use super::read;

const ROWS: usize = 8;
const COLUMNS: usize = 10;

/// Entries that an input may set.
const TAGS: [u16; 28] = [
    262, 271, 272, 274, 305, 33421, 33422, 33434, 33437, 34855, 36867, 37386, 50708, 50710, 50711, 50712, 50713, 50714,
    50715, 50716, 50717, 50718, 50719, 50720, 50728, 50829, 51125, 50721,
];
const LISTS: [u16; 3] = [51008, 51009, 51022];

/// Bytes of the values of a type, by its number; 0 for a number that is none.
fn size(kind: u16) -> usize {
    [0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8].get(usize::from(kind)).copied().unwrap_or(0)
}

/// A first byte says how many planes there are; then come entries: which, type, number of bytes, bytes. Type 0 takes an entry away.
fn dng_of(bytes: &[u8]) -> Vec<u8> {
    let (first, mut rest) = bytes.split_first().map_or((0, bytes), |(b, rest)| (*b, rest));
    let planes = if first % 2 == 0 { 1 } else { 3 };
    let mut file = Synthetic::new(ROWS, COLUMNS, planes, |r, c, k| (997 * (1 + r * COLUMNS + c) + 31 * k) as u16);
    while let [which, kind, count, low, after @ ..] = rest {
        let which = usize::from(*which) % (TAGS.len() + LISTS.len());
        let tag = TAGS.get(which).copied().unwrap_or_else(|| LISTS[which - TAGS.len()]);
        let (kind, length) = (u16::from(*kind % 13), (usize::from(*count) * 256 + usize::from(*low)).min(after.len()));
        let (data, after) = after.split_at(length);
        file = match size(kind) {
            0 => file.without(tag),
            size => file.put(tag, kind, length / size, data[..length / size * size].to_vec()),
        };
        rest = after;
    }
    file.file()
}

pub(super) fn dng(bytes: &[u8]) {
    let Some(capture) = read("a.dng", decode_bytes(dng_of(bytes), Path::new("a.dng"))) else { return };
    let (rows, columns) = capture.size();
    assert!((1..=ROWS).contains(&rows) && (1..=COLUMNS).contains(&columns), "{rows} × {columns}");
    let crop = capture.crop;
    assert!(crop.rows > 0 && crop.columns > 0 && crop.row + crop.rows <= rows && crop.column + crop.columns <= columns);
    let (samples, levels) = match &capture.pixels {
        RawPixels::Mosaic { samples, .. } | RawPixels::Grey(samples) => (samples.as_slice(), 4),
        RawPixels::Linear(samples) => (samples.as_slice(), 3),
    };
    assert!(samples.expect("rows").iter().all(|v| v.is_finite()), "a sample that is no number");
    for (black, white) in capture.black.iter().zip(&capture.white).take(levels) {
        assert!(black.is_finite() && white.is_finite() && black < white, "black {black}, white {white}");
    }
    let facts = capture.neutral.iter().flatten().chain(capture.camera_from_xyz.iter().flatten().flatten());
    assert!(facts.copied().all(f64::is_finite), "{:?}, {:?}", capture.neutral, capture.camera_from_xyz);
    assert!(capture.notes.iter().all(|note| !note.contains('\n')), "{:?}", capture.notes);
}

/// An entry as an input states it.
fn entry(tag: u16, kind: u8, data: &[u8]) -> Vec<u8> {
    let which = TAGS.iter().chain(&LISTS).position(|t| *t == tag).expect("an entry of the list");
    [&[which as u8, kind], &(data.len() as u16).to_be_bytes()[..], data].concat()
}

pub(super) fn starts() -> Vec<Vec<u8>> {
    let longs = |all: &[u32]| all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let shorts = |all: &[u16]| all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let ratios = |n: usize| (0..n).flat_map(|k| [k as i32 - 2, 1]).flat_map(i32::to_le_bytes).collect::<Vec<u8>>();
    let whole = [0, 0, ROWS as u32, COLUMNS as u32, 0, 1, 1, 1];
    let unit = [[1.0, 1.0], [0.0, 0.0]];
    let second = opcodes(&[
        gain_map(whole, [2, 2], unit, 1, &[1.0, 1.5, 2.0, 2.5]),
        polynomial(whole, &[0.0, 0.5, 0.5]),
        (5, vec![0; 8]),
    ]);
    let other = opcodes(&[(4, vec![0; 8]), (77, Vec::new())]);
    let with = |first: u8, entries: &[Vec<u8>]| [&[first][..], &entries.concat()].concat();
    vec![
        with(0, &[entry(51009, 7, &second), entry(51008, 7, &other), entry(51022, 7, &other)]),
        with(
            0,
            &[entry(50716, 10, &ratios(ROWS)), entry(50715, 10, &ratios(COLUMNS)), entry(50714, 4, &longs(&[256]))],
        ),
        with(
            0,
            &[entry(50713, 3, &shorts(&[2, 2])), entry(50714, 4, &longs(&[1, 2, 3, 4])), entry(274, 3, &shorts(&[6]))],
        ),
        with(
            0,
            &[
                entry(50829, 4, &longs(&[0, 0, 8, 10])),
                entry(50719, 4, &longs(&[1, 1])),
                entry(50720, 4, &longs(&[4, 4])),
            ],
        ),
        with(0, &[entry(33421, 3, &shorts(&[2, 2])), entry(33422, 1, &[2, 1, 1, 0]), entry(51125, 10, &ratios(4))]),
        with(
            1,
            &[
                entry(51009, 7, &second),
                entry(50717, 4, &longs(&[60000, 61000, 62000])),
                entry(50728, 5, &longs(&[1, 2, 1, 1, 2, 3])),
            ],
        ),
        with(
            0,
            &[
                entry(33434, 5, &longs(&[1, 60])),
                entry(34855, 3, &shorts(&[400])),
                entry(36867, 2, b"2026:11:27 10:00:00\0"),
            ],
        ),
        with(0, &[entry(262, 3, &shorts(&[34892])), entry(33421, 0, &[]), entry(33422, 0, &[])]),
    ]
}
