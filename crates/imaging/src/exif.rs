//! Facts of an exposure as Exif has them: what a camera wrote into its RAW file, carried over to the picture made of it.
//!
//! CIPA DC-008 (Exif 2.32). Entries are kept as number, kind and value, each in its directory; maker notes, previews and what
//! describes the RAW file's own samples are not among them.

use std::borrow::Cow;
use std::io::{Seek, Write};

use serde::{Deserialize, Serialize};
use tiff::TiffResult;
use tiff::encoder::{DirectoryEncoder, Rational, SRational, TiffEncoder, TiffKindStandard, TiffValue};
use tiff::tags::{Tag, Type};

/// Longest text that is kept, characters.
const LONGEST: usize = 1000;

/// What turns a stored picture upright: first the transposition, then the mirrorings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Rows become columns.
    pub transpose: bool,
    /// Top and bottom change places.
    pub flip_rows: bool,
    /// Left and right change places.
    pub flip_columns: bool,
}

impl Turn {
    /// Of Exif's orientation (tag 0x0112); `None` where the picture stands upright as it is.
    pub fn from_exif(orientation: u8) -> Option<Self> {
        // 2 mirrors left–right, 3 turns by 180°, 4 mirrors top–bottom, 5 transposes, 6 turns clockwise to stand upright, 7 transposes on
        // the other diagonal, 8 turns counterclockwise.
        let (transpose, flip_rows, flip_columns) = match orientation {
            2 => (false, false, true),
            3 => (false, true, true),
            4 => (false, true, false),
            5 => (true, false, false),
            6 => (true, false, true),
            7 => (true, true, true),
            8 => (true, true, false),
            _ => return None,
        };
        Some(Self { transpose, flip_rows, flip_columns })
    }
}

/// The directory of a file that an entry stands in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Directory {
    /// That of the picture.
    Picture,
    /// The exposure's.
    Exposure,
    /// The place's.
    Place,
}

/// What an entry holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Value {
    /// Printable ASCII.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
    /// 16 bits.
    Short(u16),
    /// 32 bits.
    Long(u32),
    /// Fractions.
    Ratios(Vec<[u32; 2]>),
    /// Fractions with a sign.
    SignedRatios(Vec<[i32; 2]>),
}

/// One entry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Where it stands.
    pub directory: Directory,
    /// Its number.
    pub tag: u16,
    /// What it holds.
    pub value: Value,
}

/// Numbers of entries that this program itself reads or writes.
#[doc(hidden)]
pub mod tags {
    /// Maker of the camera.
    pub const MAKE: u16 = 0x010f;
    /// Camera.
    pub const MODEL: u16 = 0x0110;
    /// Program.
    pub const SOFTWARE: u16 = 0x0131;
    /// How to turn the picture.
    pub const ORIENTATION: u16 = 0x0112;
    /// Seconds.
    pub const EXPOSURE_TIME: u16 = 0x829a;
    /// F-number.
    pub const F_NUMBER: u16 = 0x829d;
    /// ISO speed.
    pub const ISO: u16 = 0x8827;
    /// Which of the following tell the speed.
    pub const SENSITIVITY_TYPE: u16 = 0x8830;
    /// Recommended exposure index: a speed beyond 16 bits.
    pub const EXPOSURE_INDEX: u16 = 0x8832;
    /// ISO speed: the same.
    pub const ISO_LONG: u16 = 0x8833;
    /// When it was taken.
    pub const TAKEN: u16 = 0x9003;
    /// Metres.
    pub const SUBJECT_DISTANCE: u16 = 0x9206;
    /// Millimetres.
    pub const FOCAL_LENGTH: u16 = 0x920a;
    /// Lens.
    pub const LENS_MODEL: u16 = 0xa434;
    pub(super) const VERSION: u16 = 0x9000;
    pub(super) const COLOR_SPACE: u16 = 0xa001;
    pub(super) const GPS_VERSION: u16 = 0x0000;
}

/// Bytes of the kind that TIFF calls undefined.
pub(crate) struct Undefined<'a>(pub(crate) &'a [u8]);

impl TiffValue for Undefined<'_> {
    const BYTE_LEN: u8 = 1;
    const FIELD_TYPE: Type = Type::UNDEFINED;

    fn count(&self) -> usize {
        self.0.len()
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(self.0)
    }
}

/// Printable ASCII, of bounded length; other letters become `?`.
pub(crate) fn ascii(text: &str) -> String {
    text.chars().map(|c| if matches!(c, ' '..='~') { c } else { '?' }).take(LONGEST).collect()
}

/// The facts of one exposure; empty where a file tells none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Exif {
    entries: Vec<Entry>,
}

impl Exif {
    /// Adds an entry, in place of one with its number. Text is cut to printable ASCII; empty text is none.
    pub fn set(&mut self, directory: Directory, tag: u16, value: Value) {
        let value = match value {
            Value::Text(text) => {
                let text = ascii(text.trim_matches(['\0', ' ']));
                if text.is_empty() {
                    return;
                }
                Value::Text(text)
            }
            other => other,
        };
        self.entries.retain(|e| (e.directory, e.tag) != (directory, tag));
        self.entries.push(Entry { directory, tag, value });
    }

    /// Every entry.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    fn get(&self, directory: Directory, tag: u16) -> Option<&Value> {
        self.entries.iter().find(|e| (e.directory, e.tag) == (directory, tag)).map(|e| &e.value)
    }

    /// A number of the exposure, if it is one and no fraction by zero.
    fn number(&self, tag: u16) -> Option<f64> {
        match self.get(Directory::Exposure, tag)? {
            Value::Short(v) => Some(f64::from(*v)),
            Value::Long(v) => Some(f64::from(*v)),
            Value::Ratios(v) => v.first().filter(|[_, d]| *d > 0).map(|[n, d]| f64::from(*n) / f64::from(*d)),
            _ => None,
        }
    }

    /// ISO speed.
    pub fn iso(&self) -> Option<f64> {
        // The short form stands at its end where the speed is beyond it.
        let short = self.number(tags::ISO).filter(|v| *v > 0.0);
        match short {
            Some(v) if v < f64::from(u16::MAX) => Some(v),
            _ => {
                let long = [tags::EXPOSURE_INDEX, tags::ISO_LONG].into_iter().filter_map(|tag| self.number(tag));
                long.filter(|v| *v > 0.0).max_by(f64::total_cmp).or(short)
            }
        }
    }

    /// F-number.
    pub fn f_number(&self) -> Option<f64> {
        self.number(tags::F_NUMBER).filter(|v| *v > 0.0)
    }

    /// Exposure time, s.
    pub fn exposure_s(&self) -> Option<f64> {
        self.number(tags::EXPOSURE_TIME).filter(|v| *v > 0.0)
    }

    /// Focal length, mm.
    pub fn focal_length_mm(&self) -> Option<f64> {
        self.number(tags::FOCAL_LENGTH).filter(|v| *v > 0.0)
    }

    /// Distance of the subject, m; infinite where it is told to be.
    pub fn subject_distance_m(&self) -> Option<f64> {
        match self.get(Directory::Exposure, tags::SUBJECT_DISTANCE)? {
            Value::Ratios(v) if v.first().is_some_and(|[n, _]| *n == u32::MAX) => Some(f64::INFINITY),
            _ => self.number(tags::SUBJECT_DISTANCE).filter(|v| *v > 0.0),
        }
    }

    /// The lens's name.
    pub fn lens(&self) -> Option<&str> {
        match self.get(Directory::Exposure, tags::LENS_MODEL)? {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The whole as a TIFF stream without pixels: what JPEG and PNG files carry.
    ///
    /// # Errors
    /// None for what [`Self::set`] took; the writer's own.
    pub(crate) fn block(&self, color_space: u16) -> TiffResult<Vec<u8>> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut file = TiffEncoder::new(&mut bytes)?;
        let offsets = self.write_directories(&mut file, color_space)?;
        let mut picture = file.image_directory()?;
        self.write_picture_entries(&mut picture, offsets)?;
        picture.finish()?;
        Ok(bytes.into_inner())
    }

    /// Writes the directories of exposure and place; where they stand.
    pub(crate) fn write_directories<W: Write + Seek>(
        &self,
        file: &mut TiffEncoder<W>,
        color_space: u16,
    ) -> TiffResult<[Option<u32>; 2]> {
        let mut exposure = file.extra_directory()?;
        exposure.write_tag(Tag::Unknown(tags::VERSION), Undefined(b"0232"))?;
        exposure.write_tag(Tag::Unknown(tags::COLOR_SPACE), color_space)?;
        self.write_entries(&mut exposure, Directory::Exposure)?;
        let exposure = exposure.finish_with_offsets()?.offset;
        if !self.entries.iter().any(|e| e.directory == Directory::Place) {
            return Ok([Some(exposure), None]);
        }
        let mut place = file.extra_directory()?;
        place.write_tag(Tag::Unknown(tags::GPS_VERSION), &[2u8, 3, 0, 0][..])?;
        self.write_entries(&mut place, Directory::Place)?;
        Ok([Some(exposure), Some(place.finish_with_offsets()?.offset)])
    }

    /// Writes what stands in the picture's own directory, upright, and where the others stand.
    pub(crate) fn write_picture_entries<W: Write + Seek>(
        &self,
        picture: &mut DirectoryEncoder<'_, W, TiffKindStandard>,
        [exposure, place]: [Option<u32>; 2],
    ) -> TiffResult<()> {
        picture.write_tag(Tag::Orientation, 1u16)?;
        self.write_entries(picture, Directory::Picture)?;
        exposure.map_or(Ok(()), |offset| picture.write_tag(Tag::ExifDirectory, offset))?;
        place.map_or(Ok(()), |offset| picture.write_tag(Tag::GpsDirectory, offset))
    }

    fn write_entries<W: Write + Seek>(
        &self,
        to: &mut DirectoryEncoder<'_, W, TiffKindStandard>,
        directory: Directory,
    ) -> TiffResult<()> {
        for Entry { tag, value, .. } in self.entries.iter().filter(|e| e.directory == directory) {
            let tag = Tag::from_u16_exhaustive(*tag);
            match value {
                Value::Text(text) => to.write_tag(tag, text.as_str())?,
                Value::Bytes(bytes) => to.write_tag(tag, &bytes[..])?,
                Value::Short(v) => to.write_tag(tag, *v)?,
                Value::Long(v) => to.write_tag(tag, *v)?,
                Value::Ratios(v) => {
                    let v: Vec<Rational> = v.iter().map(|[n, d]| Rational { n: *n, d: *d }).collect();
                    to.write_tag(tag, &v[..])?;
                }
                Value::SignedRatios(v) => {
                    let v: Vec<SRational> = v.iter().map(|[n, d]| SRational { n: *n, d: *d }).collect();
                    to.write_tag(tag, &v[..])?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_where_they_are_numbers() {
        let mut exif = Exif::default();
        let exposure = |exif: &mut Exif, tag, value| exif.set(Directory::Exposure, tag, value);
        assert_eq!((exif.iso(), exif.f_number(), exif.lens()), (None, None, None));
        exposure(&mut exif, tags::ISO, Value::Short(u16::MAX));
        assert_eq!(exif.iso(), Some(65535.0));
        exposure(&mut exif, tags::EXPOSURE_INDEX, Value::Long(102_400));
        assert_eq!(exif.iso(), Some(102_400.0));
        exposure(&mut exif, tags::ISO, Value::Short(200));
        assert_eq!(exif.iso(), Some(200.0));
        exposure(&mut exif, tags::F_NUMBER, Value::Ratios(vec![[28, 10]]));
        exposure(&mut exif, tags::EXPOSURE_TIME, Value::Ratios(vec![[1, 0]]));
        exposure(&mut exif, tags::SUBJECT_DISTANCE, Value::Ratios(vec![[u32::MAX, 1]]));
        exposure(&mut exif, tags::LENS_MODEL, Value::Text(" Doppel-Gauß 50\0".into()));
        assert_eq!((exif.f_number(), exif.exposure_s()), (Some(2.8), None));
        assert_eq!((exif.subject_distance_m(), exif.lens()), (Some(f64::INFINITY), Some("Doppel-Gau? 50")));
        exposure(&mut exif, 0x9999, Value::Text(" \0".into()));
        assert_eq!(exif.entries().len(), 6, "empty text is none");
    }

    /// The bytes are a TIFF whose directories hold what was put in: walked by hand, as TIFF 6.0 (section 2) has it.
    #[test]
    fn a_block_holds_its_entries() {
        let mut exif = Exif::default();
        exif.set(Directory::Picture, tags::MAKE, Value::Text("Maker".into()));
        exif.set(Directory::Exposure, tags::EXPOSURE_TIME, Value::Ratios(vec![[1, 250]]));
        exif.set(Directory::Exposure, 0x9204, Value::SignedRatios(vec![[-1, 3]]));
        exif.set(Directory::Place, 0x0002, Value::Ratios(vec![[48, 1], [8, 1], [30, 1]]));
        let block = exif.block(1).expect("writes");
        let long = |at: usize| u32::from_ne_bytes(block[at..at + 4].try_into().expect("four bytes"));
        let short = |at: usize| u16::from_ne_bytes(block[at..at + 2].try_into().expect("two bytes"));
        assert_eq!((short(2), &block[..2]), (42, &if cfg!(target_endian = "little") { *b"II" } else { *b"MM" }[..]));
        // Kind, count, and place of the value, which stands in the entry where it fits.
        let find = |directory: u32, tag: u16| {
            let directory = directory as usize;
            let entries = (0..usize::from(short(directory))).map(|k| directory + 2 + 12 * k);
            let numbers: Vec<u16> = entries.clone().map(short).collect();
            assert!(numbers.windows(2).all(|p| p[0] < p[1]), "sorted: {numbers:?}");
            let at = entries.into_iter().find(|at| short(*at) == tag).expect("there");
            (short(at + 2), long(at + 4), at + 8)
        };
        let first = long(4);
        let (kind, count, at) = find(first, tags::MAKE);
        assert_eq!((kind, count, &block[long(at) as usize..][..6]), (2, 6, &b"Maker\0"[..]));
        assert_eq!(short(find(first, tags::ORIENTATION).2), 1);
        let (exposure, place) = (long(find(first, 0x8769).2), long(find(first, 0x8825).2));
        let ratio = |directory, tag, k: usize| {
            let (kind, _, at) = find(directory, tag);
            let at = long(at) as usize + 8 * k;
            (kind, long(at).cast_signed(), long(at + 4))
        };
        assert_eq!(ratio(exposure, tags::EXPOSURE_TIME, 0), (5, 1, 250));
        assert_eq!(ratio(exposure, 0x9204, 0), (10, -1, 3));
        assert_eq!(short(find(exposure, tags::COLOR_SPACE).2), 1);
        assert_eq!(find(exposure, tags::VERSION).0, 7, "undefined, as the standard has it");
        assert_eq!((find(place, 2).1, ratio(place, 2, 2)), (3, (5, 30, 1)));
    }
}
