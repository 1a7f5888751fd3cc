//! DNGs of known samples for tests, tag by tag (TIFF 6.0, section 2), so that they can hold what the program's own writer does not.

use std::collections::BTreeMap;
use std::path::Path;

/// Types of TIFF.
const BYTE: u16 = 1;
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const UNDEFINED: u16 = 7;
const SRATIONAL: u16 = 10;

/// A file on its way: samples row by row, planes beside each other, and entries by number.
#[derive(Clone)]
pub(crate) struct Synthetic {
    samples: Vec<u16>,
    entries: BTreeMap<u16, (u16, u32, Vec<u8>)>,
}

impl Synthetic {
    /// A mosaic, RGGB, or with three planes linear colours; black 0, white 65535.
    pub(crate) fn new(rows: usize, columns: usize, planes: usize, sample: impl Fn(usize, usize, usize) -> u16) -> Self {
        let places = (0..rows).flat_map(|r| (0..columns).flat_map(move |c| (0..planes).map(move |k| (r, c, k))));
        let samples = places.map(|(r, c, k)| sample(r, c, k)).collect();
        let file = Self { samples, entries: BTreeMap::new() };
        let side = |n: usize| u32::try_from(n).expect("a small file");
        let filter = if planes == 1 { 32803 } else { 34892 };
        let matrix =
            [3.240_454, -1.537_138, -0.498_531, -0.969_266, 1.876_011, 0.041_556, 0.055_643, -0.204_026, 1.057_225];
        let file = file.longs(254, &[0]).longs(256, &[side(columns)]).longs(257, &[side(rows)]);
        let file = file.shorts(258, &vec![16; planes]).shorts(259, &[1]).shorts(262, &[filter]);
        let file = file.text(271, "Test").text(272, "Table").longs(273, &[0]).shorts(277, &[planes as u16]);
        let file = file.longs(278, &[side(rows)]).longs(279, &[side(2 * rows * columns * planes)]).shorts(284, &[1]);
        let file = file.bytes(50706, &[1, 4, 0, 0]).bytes(50707, &[1, 1, 0, 0]).text(50708, "Test Table");
        let file = file
            .longs(50714, &vec![0; planes])
            .longs(50717, &vec![65535; planes])
            .ratios(50721, &matrix)
            .shorts(50778, &[21]);
        if planes > 1 {
            return file;
        }
        file.shorts(33421, &[2, 2]).bytes(33422, &[0, 1, 1, 2]).bytes(50710, &[0, 1, 2]).shorts(50711, &[1])
    }

    /// An entry of any type of TIFF; `count` values in `data`, little-endian.
    pub(crate) fn put(mut self, tag: u16, kind: u16, count: usize, data: Vec<u8>) -> Self {
        self.entries.insert(tag, (kind, u32::try_from(count).expect("a small file"), data));
        self
    }

    pub(crate) fn shorts(self, tag: u16, values: &[u16]) -> Self {
        self.put(tag, SHORT, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    pub(crate) fn longs(self, tag: u16, values: &[u32]) -> Self {
        self.put(tag, LONG, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    pub(crate) fn ratios(self, tag: u16, values: &[f64]) -> Self {
        let halves = |v: &f64| [(v * 1e6).round() as i32, 1_000_000];
        self.put(tag, SRATIONAL, values.len(), values.iter().flat_map(halves).flat_map(i32::to_le_bytes).collect())
    }

    pub(crate) fn bytes(self, tag: u16, values: &[u8]) -> Self {
        self.put(tag, BYTE, values.len(), values.to_vec())
    }

    pub(crate) fn undefined(self, tag: u16, values: Vec<u8>) -> Self {
        self.put(tag, UNDEFINED, values.len(), values)
    }

    pub(crate) fn text(self, tag: u16, text: &str) -> Self {
        self.put(tag, ASCII, text.len() + 1, format!("{text}\0").into_bytes())
    }

    pub(crate) fn without(mut self, tag: u16) -> Self {
        self.entries.remove(&tag);
        self
    }

    /// Writes the file.
    pub(crate) fn write(&self, path: &Path) {
        std::fs::write(path, self.file()).expect("writes");
    }

    /// The bytes of the file, little-endian.
    pub(crate) fn file(&self) -> Vec<u8> {
        let mut place = 8 + 2 + 12 * self.entries.len() + 4;
        let beside: usize =
            self.entries.values().map(|(_, _, d)| if d.len() > 4 { d.len().next_multiple_of(2) } else { 0 }).sum();
        let pixels = (place + beside) as u32;
        let mut head = b"II*\0\x08\0\0\0".to_vec();
        head.extend((self.entries.len() as u16).to_le_bytes());
        let mut after = Vec::new();
        for (tag, (kind, count, data)) in &self.entries {
            head.extend(tag.to_le_bytes());
            head.extend(kind.to_le_bytes());
            head.extend(count.to_le_bytes());
            if *tag == 273 {
                head.extend(pixels.to_le_bytes());
            } else if data.len() <= 4 {
                head.extend(data.iter().copied().chain([0; 4]).take(4));
            } else {
                head.extend((place as u32).to_le_bytes());
                after.extend(data);
                after.extend(vec![0; data.len() % 2]);
                place += data.len().next_multiple_of(2);
            }
        }
        head.extend([0; 4]);
        head.extend(after);
        head.extend(self.samples.iter().flat_map(|v| v.to_le_bytes()));
        head
    }
}

/// An opcode list of corrections, each by its number and what follows its head.
pub(crate) fn opcodes(list: &[(u32, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = (list.len() as u32).to_be_bytes().to_vec();
    for (code, body) in list {
        for word in [*code, 0x0103_0000, 0, body.len() as u32] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
    }
    bytes
}

/// The area of a correction: top, left, bottom, right, first plane, planes, steps down and across.
pub(crate) fn area(words: [u32; 8]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_be_bytes()).collect()
}

/// `MapPolynomial` over an area.
pub(crate) fn polynomial(words: [u32; 8], coefficients: &[f64]) -> (u32, Vec<u8>) {
    let mut body = area(words);
    body.extend((coefficients.len() as u32 - 1).to_be_bytes());
    body.extend(coefficients.iter().flat_map(|c| c.to_be_bytes()));
    (8, body)
}

/// `GainMap` over an area: points down and across, spacing, origin, planes of the map, gains.
pub(crate) fn gain_map(
    words: [u32; 8],
    points: [u32; 2],
    [spacing, origin]: [[f64; 2]; 2],
    planes: u32,
    gains: &[f32],
) -> (u32, Vec<u8>) {
    let mut body = area(words);
    body.extend(points.iter().flat_map(|w| w.to_be_bytes()));
    body.extend(spacing.iter().chain(&origin).flat_map(|c| c.to_be_bytes()));
    body.extend(planes.to_be_bytes());
    body.extend(gains.iter().flat_map(|g| g.to_be_bytes()));
    (9, body)
}
