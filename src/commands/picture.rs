//! The channels of a picture that is measured in: grey, R, G, B with luminance, or the colours of a mosaic.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

#[cfg(feature = "deploy")]
use isoplanat::deploy::raw::has_raw_name;
use isoplanat::imaging::develop::color::XYZ_FROM_SRGB;
use isoplanat::imaging::files::{Encoding, Planes, picture_size, read_planes, read_sensor_planes};
use isoplanat::imaging::metrics::slanted_edge::Sites;
use isoplanat::imaging::sensor::cfa::Cfa;
use isoplanat::math::memory::product;
use isoplanat::{Error, Result};
use ndarray::{ArcArray2, Axis};

/// Names of the colours, in the order of channels.
const COLOURS: [&str; 3] = ["R", "G", "B"];

/// Bytes of a pixel while it is read: three channels as they come and twice as double precision, luminance.
const BYTES: usize = 64;

/// Pictures whose left-out parts were told of.
static TOLD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Says what of a picture is left out, once for each file: commands read some twice.
pub(crate) fn tell_left_out(path: &Path, left_out: Option<&str>) {
    let Some(words) = left_out else { return };
    let first = TOLD.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned());
    if first {
        crate::aside!("note: {}: {words}", path.display());
    }
}

/// One channel: linear values, and which of them count.
pub(crate) struct Channel {
    pub(crate) name: &'static str,
    pub(crate) plane: ArcArray2<f64>,
    pub(crate) sites: Sites,
    /// Levels at which values are cut off.
    pub(crate) range: Option<[f64; 2]>,
}

/// What was read.
pub(crate) struct Picture {
    pub(crate) channels: Vec<Channel>,
    /// What the numbers were taken as, in words.
    pub(crate) source: String,
}

/// Which way up a picture is taken; RAW files are always the sensor's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Way {
    /// As it is looked at: the orientation in Exif is applied.
    Seen,
    /// As the sensor has it.
    #[cfg_attr(not(feature = "calibrate"), expect(dead_code, reason = "charts are taken so"))]
    Sensor,
}

/// Reads a picture or a RAW file; a mosaic is the sensor's whatever is asked for.
pub(crate) fn read(path: &Path, encoding: Option<Encoding>, cfa: Option<Cfa>, way: Way) -> Result<Picture> {
    if has_raw_name(path) {
        let found = |option: &str| Error::bad(option, "value", "given for a RAW file", "RAW files say it themselves");
        if encoding.is_some() {
            return Err(found("--encoding"));
        }
        if cfa.is_some() {
            return Err(found("--cfa"));
        }
        return raw(path);
    }
    // What cannot be read is told below.
    if let Ok([rows, columns]) = picture_size(path) {
        let bytes = product(&[rows, columns, BYTES]);
        let picture = format!("{}: {columns} × {rows} pixels", path.display());
        crate::memory::limit().allow(&picture, bytes, "a part of it")?;
    }
    let as_seen = way == Way::Seen && cfa.is_none();
    let read = if as_seen { read_planes } else { read_sensor_planes };
    let Planes { values, bits, taken, left_out, .. } = read(path, encoding)?;
    tell_left_out(path, left_out);
    let form = bits.map_or_else(|| "floating point".into(), |b| format!("{b} bits"));
    let range = bits.map(|_| [0.0, 1.0]);
    let mut planes = values.axis_iter(Axis(0)).map(|p| p.to_owned().into_shared()).collect::<Vec<_>>();
    // Three equal channels are grey.
    if planes.len() == 3 && planes[0] == planes[1] && planes[1] == planes[2] {
        planes.truncate(1);
    }
    let one = |name, plane: &ArcArray2<f64>| Channel { name, plane: plane.clone(), sites: Sites::ALL, range };
    if let Some(cfa) = cfa {
        let [mosaic] = &planes[..] else {
            let file = path.display().to_string();
            return Err(Error::bad(file, "picture", "three different channels", "one channel with --cfa"));
        };
        let source = format!("{form}, taken as {taken}, {cfa} mosaic");
        return Ok(Picture { channels: mosaic_channels(mosaic, cfa, range), source });
    }
    let channels = match &planes[..] {
        [r, g, b] => {
            let [red, green, blue] = XYZ_FROM_SRGB[1];
            let luminance = (red * r + green * g + blue * b).into_shared();
            let colours = COLOURS.into_iter().zip(&planes).map(|(name, plane)| one(name, plane));
            // A sum of clipped channels has no level of its own.
            colours.chain([Channel { range: None, ..one("luminance", &luminance) }]).collect()
        }
        _ => vec![one("grey", &planes[0])],
    };
    Ok(Picture { channels, source: format!("{form}, taken as {taken}") })
}

/// The colours of a mosaic, each at its own pixels.
fn mosaic_channels(mosaic: &ArcArray2<f64>, cfa: Cfa, range: Option<[f64; 2]>) -> Vec<Channel> {
    let channel = |(i, name)| Channel { name, plane: mosaic.clone(), sites: Sites::from_cfa(cfa, i), range };
    COLOURS.into_iter().enumerate().map(|(i, name)| channel((i, name))).collect()
}

/// A RAW file, decoded in a child process; levels from the file: black 0, white 1.
#[cfg(feature = "deploy")]
fn raw(path: &Path) -> Result<Picture> {
    use isoplanat::deploy::child::Helper;
    use isoplanat::deploy::raw::RawPixels;
    use isoplanat::deploy::raw_process;

    let (raw, _) = raw_process::decode(&Helper::current()?, path, crate::memory::limit())?;
    let (rows, columns) = raw.size();
    // Samples as they come, and in double precision.
    let colours = if matches!(raw.pixels, RawPixels::Linear(_)) { 3 } else { 1 };
    let bytes = product(&[rows, columns, colours, size_of::<f32>() + size_of::<f64>()]);
    let what = format!("{}: {columns} × {rows} pixels", path.display());
    crate::memory::limit().allow(&what, bytes, "a smaller frame")?;
    let (black, white) = (raw.black.map(f64::from), raw.white.map(f64::from));
    let level = |v: f32, i: usize| (f64::from(v) - black[i]) / (white[i] - black[i]);
    // Below black is noise, not a cut; the cut lies at the sensor's zero.
    let range = Some([f64::NEG_INFINITY, 1.0]);
    match raw.pixels {
        RawPixels::Mosaic { samples, cfa } => {
            let at = |(r, c): (usize, usize)| level(samples[[r, c]], (r & 1) * 2 + (c & 1));
            let mosaic = ndarray::Array2::from_shape_fn(samples.dim(), at).into_shared();
            let source = format!("RAW of {} {}, {cfa} mosaic", raw.make, raw.model);
            Ok(Picture { channels: mosaic_channels(&mosaic, cfa, range), source })
        }
        RawPixels::Grey(samples) => {
            let at = |(r, c): (usize, usize)| level(samples[[r, c]], (r & 1) * 2 + (c & 1));
            let plane = ndarray::Array2::from_shape_fn(samples.dim(), at).into_shared();
            let grey = Channel { name: "grey", plane, sites: Sites::ALL, range };
            Ok(Picture { channels: vec![grey], source: format!("RAW of {} {} without colours", raw.make, raw.model) })
        }
        RawPixels::Linear(samples) => {
            let plane = |i: usize| samples.index_axis(Axis(0), i).mapv(|v| level(v, i)).into_shared();
            let one = |(i, name)| Channel { name, plane: plane(i), sites: Sites::ALL, range };
            let channels = COLOURS.into_iter().enumerate().map(|(i, name)| one((i, name))).collect();
            Ok(Picture { channels, source: format!("linear RAW of {} {}", raw.make, raw.model) })
        }
    }
}

/// Endings of the best-known RAW files: builds that read none still say what is missing.
#[cfg(not(feature = "deploy"))]
fn has_raw_name(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let known = ["dng", "nef", "nrw", "arw", "sr2", "cr2", "cr3", "crw", "raf", "rw2", "orf", "pef", "srw", "iiq"];
    known.contains(&ending.as_str())
}

/// RAW files need the decoder.
#[cfg(not(feature = "deploy"))]
fn raw(path: &Path) -> Result<Picture> {
    Err(Error::bad(
        path.display().to_string(),
        "RAW file",
        "this build lacks the feature `deploy`, which reads RAW files",
        "a PNG, JPEG or TIFF picture, or a build with --features deploy",
    ))
}
