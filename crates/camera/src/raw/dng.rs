//! What a DNG's own directory says of its samples and the decoder leaves aside: the filter, steps of black, the part to show, corrections.

use std::path::Path;

use isoplanat_base::error::Result;
use rawler::formats::tiff::IFD;
use rawler::tags::{DngTag, ExifTag, TiffCommonTag};

use super::filter::{Filter, filter};
use super::levels::Deltas;
use super::opcodes::{self, Applied};
use super::{Area, RawCapture, RawPixels, bad};

/// Numbers of an entry; `None` where it has other values than numbers.
fn numbers(directory: &IFD, tag: DngTag) -> Option<Vec<f32>> {
    let entry = directory.get_entry(tag)?;
    (0..entry.count() as usize).map(|k| entry.get_f32(k).ok().flatten().filter(|v| v.is_finite())).collect()
}

/// Refuses, by name, what the decoder takes for something else or breaks off at.
pub(super) fn check_filter(path: &Path, directory: &IFD) -> Result<()> {
    let whole = |tag: TiffCommonTag| {
        let entry = directory.get_entry(tag)?;
        (0..entry.count() as usize).map(|k| entry.get_usize(k).ok().flatten()).collect::<Option<Vec<usize>>>()
    };
    if whole(TiffCommonTag::PhotometricInt) != Some(vec![32803]) {
        return Ok(());
    }
    let allowed = "a Bayer filter (RGGB, BGGR, GRBG, GBRG), or no colours";
    if let (Some(size), Some(pattern)) = (whole(TiffCommonTag::CFARepeatPatternDim), whole(TiffCommonTag::CFAPattern)) {
        let colours: Vec<u8> = pattern.iter().map(|c| u8::try_from(*c).unwrap_or(u8::MAX)).collect();
        let [rows, columns] = size[..] else {
            return Err(bad(
                path,
                format!("a size of the colour filter of {} numbers", size.len()),
                "rows and columns",
            ));
        };
        match filter(rows, columns, &colours) {
            Filter::Other(name) => return Err(bad(path, name, allowed)),
            // The decoder knows the smallest form.
            Filter::Bayer(_) if colours.len() != 4 => {
                let found = format!("a Bayer filter stated as {columns} × {rows} pixels");
                return Err(bad(path, found, "a Bayer filter stated as 2 × 2 pixels"));
            }
            // Without a filter the file would be LinearRaw, with black and white of one plane.
            Filter::Grey => return Err(bad(path, "a colour filter of one colour", allowed)),
            Filter::Bayer(_) => {}
        }
    }
    match numbers(directory, DngTag::CFALayout).as_deref() {
        None | Some([1.0]) => {}
        Some(layout) => {
            return Err(bad(path, format!("pixels in staggered rows or columns (CFALayout {layout:?})"), allowed));
        }
    }
    match numbers(directory, DngTag::CFAPlaneColor) {
        Some(planes) if planes.len() > 1 && planes != [0.0, 1.0, 2.0] => {
            Err(bad(path, format!("a colour filter of planes {planes:?} (CFAPlaneColor)"), "red, green, blue: 0, 1, 2"))
        }
        _ => Ok(()),
    }
}

/// Refuses bits that the decoder would take the other way round.
pub(super) fn check_order(path: &Path, directory: &IFD) -> Result<()> {
    match directory.get_entry(ExifTag::FillOrder).map(|entry| entry.force_u32(0)) {
        None | Some(1) => Ok(()),
        Some(order) => Err(bad(path, format!("bits in reverse order (FillOrder {order})"), "FillOrder 1")),
    }
}

/// The newest version of the format that is known here; what newer readers need is told.
const KNOWN: [f32; 3] = [1.0, 7.0, 1.0];

/// What the file asks for in its first directory and is not done: a newer reader, an exposure, a profile's look.
pub(super) fn look_left_out(root: &IFD) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(version) = numbers(root, DngTag::DNGBackwardVersion).filter(|v| v[..3.min(v.len())] > KNOWN[..]) {
        let words: Vec<String> = version.iter().map(f32::to_string).collect();
        notes.push(format!(
            "the file is for readers of DNG {} (DNGBackwardVersion), 1.7.1 is known here; the picture may be wrong",
            words.join(".")
        ));
    }
    let steps = |tag: DngTag| numbers(root, tag).and_then(|v| v.first().copied()).unwrap_or(0.0);
    let exposure = steps(DngTag::BaselineExposure) + steps(DngTag::BaselineExposureOffset);
    if exposure != 0.0 {
        notes.push(format!(
            "the exposure that the file asks for is left out (BaselineExposure, {exposure:+} steps); --exposure {exposure} makes it"
        ));
    }
    let looks = [
        (DngTag::ForwardMatrix1, "ForwardMatrix1"),
        (DngTag::ForwardMatrix2, "ForwardMatrix2"),
        (DngTag::ProfileHueSatMapDims, "ProfileHueSatMap"),
        (DngTag::ProfileLookTableDims, "ProfileLookTable"),
        (DngTag::ProfileToneCurve, "ProfileToneCurve"),
        (DngTag::RGBTables, "RGBTables"),
    ];
    let left: Vec<&str> = looks.into_iter().filter(|(tag, _)| root.get_entry(*tag).is_some()).map(|(_, n)| n).collect();
    if !left.is_empty() {
        notes.push(format!("the file's colour profile is left out but for its matrix ({})", left.join(", ")));
    }
    notes
}

/// Steps of black by row and column of the active area of `(rows, columns)`.
pub(super) fn deltas(path: &Path, directory: &IFD, (rows, columns): (usize, usize)) -> Result<Deltas> {
    let read = |tag: DngTag, name: &str, n: usize, what: &str| {
        if directory.get_entry(tag).is_none() {
            return Ok(Vec::new());
        }
        match numbers(directory, tag) {
            Some(list) if list.len() == n => Ok(list),
            Some(list) => Err(bad(path, format!("{name} of {} numbers", list.len()), &format!("{n}, one {what}"))),
            None => Err(bad(path, format!("{name} that is no list of numbers"), &format!("{n}, one {what}"))),
        }
    };
    Ok(Deltas {
        of_rows: read(DngTag::BlackLevelDeltaV, "BlackLevelDeltaV", rows, "a row")?,
        of_columns: read(DngTag::BlackLevelDeltaH, "BlackLevelDeltaH", columns, "a column")?,
    })
}

/// The part of the active area of `(rows, columns)` that the writer means to be shown (DefaultCropOrigin, DefaultCropSize); fractions are rounded.
pub(super) fn crop(path: &Path, directory: &IFD, (rows, columns): (usize, usize)) -> Result<Area> {
    let pair = |tag: DngTag, name: &str| match numbers(directory, tag).as_deref() {
        _ if directory.get_entry(tag).is_none() => Ok(None),
        Some([x, y]) if *x >= 0.0 && *y >= 0.0 => Ok(Some([x.round() as usize, y.round() as usize])),
        other => {
            let words = |list: &[f32]| list.iter().map(|v| v.to_string()).collect::<Vec<_>>().join(", ");
            let found = other.map_or_else(|| "that is no list of numbers".into(), words);
            Err(bad(path, format!("{name} {found}"), "two numbers, column and row, from 0"))
        }
    };
    let origin = pair(DngTag::DefaultCropOrigin, "DefaultCropOrigin")?;
    let size = pair(DngTag::DefaultCropSize, "DefaultCropSize")?;
    let [left, top] = origin.unwrap_or([0, 0]);
    let [width, height] = size.unwrap_or([columns.saturating_sub(left), rows.saturating_sub(top)]);
    let fits = |from: usize, n: usize, all: usize| n > 0 && from.checked_add(n).is_some_and(|end| end <= all);
    if fits(left, width, columns) && fits(top, height, rows) {
        return Ok(Area { row: top, column: left, rows: height, columns: width });
    }
    let found = format!("a part to show (DefaultCrop) of {width} × {height} pixels from column {left}, row {top}");
    Err(bad(path, found, &format!("a part of the {columns} × {rows} pixels of the active area")))
}

/// What the file asks for and is not done.
pub(super) fn left_out(directory: &IFD) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some([x, y]) = numbers(directory, DngTag::DefaultScale).as_deref()
        && x != y
    {
        notes.push(format!("pixels are not square (DefaultScale {x} × {y}); the picture is not stretched"));
    }
    if let Some(part) = numbers(directory, DngTag::DefaultUserCrop)
        && part != [0.0, 0.0, 1.0, 1.0]
    {
        notes.push(format!("the part that the photographer chose (DefaultUserCrop {part:?}) is not cut out"));
    }
    notes
}

/// Does what the second opcode list asks, the samples then run from 0 to 1; tells what is left out of all three.
pub(super) fn apply_opcodes(path: &Path, directory: &IFD, capture: &mut RawCapture) -> Result<()> {
    let mut applied = Vec::new();
    for (tag, name, second) in [
        (DngTag::OpcodeList1, "OpcodeList1", false),
        (DngTag::OpcodeList2, "OpcodeList2", true),
        (DngTag::OpcodeList3, "OpcodeList3", false),
    ] {
        let Some(entry) = directory.get_entry(tag) else { continue };
        let damaged =
            || bad(path, format!("a damaged list of corrections ({name})"), "a list as the DNG specification has it");
        let list = opcodes::bytes(&entry.value).and_then(|bytes| opcodes::parse(bytes, second)).ok_or_else(damaged)?;
        if !list.others.is_empty() {
            let names: Vec<String> = list.others.iter().map(|code| opcodes::name(*code)).collect();
            capture.notes.push(format!("corrections the file asks for are left out ({name}: {})", names.join(", ")));
        }
        applied.extend(list.applied);
    }
    if !applied.is_empty() {
        correct(capture, &applied);
    }
    Ok(())
}

/// Corrects the samples in place, row by row.
fn correct(capture: &mut RawCapture, applied: &[Applied]) {
    let (black, white) = (capture.black, capture.white);
    let size = capture.size();
    let unit = |v: &mut f32, level: usize| {
        *v = ((*v - black[level]) / (white[level] - black[level])).min(1.0);
    };
    let row =
        |plane: usize, r: usize, samples: &mut [f32]| applied.iter().for_each(|a| a.apply(plane, r, size, samples));
    let plane = |plane: usize, mut samples: ndarray::ArrayViewMut2<'_, f32>, mosaic: bool| {
        let columns = samples.ncols();
        let Some(all) = samples.as_slice_mut() else { return };
        for (r, samples) in all.chunks_exact_mut(columns.max(1)).enumerate() {
            for (c, v) in samples.iter_mut().enumerate() {
                unit(v, if mosaic { (r & 1) * 2 + (c & 1) } else { plane });
            }
            row(plane, r, samples);
        }
    };
    match &mut capture.pixels {
        RawPixels::Mosaic { samples, .. } | RawPixels::Grey(samples) => plane(0, samples.view_mut(), true),
        RawPixels::Linear(samples) => {
            samples.outer_iter_mut().enumerate().for_each(|(k, samples)| plane(k, samples, false));
        }
    }
    (capture.black, capture.white, capture.corrected) = ([0.0; 4], [1.0; 4], true);
}
