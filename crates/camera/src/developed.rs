//! Pictures that are developed already, as captures: what `calibrate` measured in such pictures of a camera can be taken out of others of it.

use std::path::Path;

use crate::orientation::Orientation;
use crate::raw::{Area, RawCapture, RawPixels, has_raw_name};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::Limit;
use isoplanat_imaging::develop::color::{XYZ_FROM_SRGB, inverse};
use isoplanat_imaging::exif::Exif;
use isoplanat_imaging::files::{self, Stored};

/// Whether a file's name is that of a developed picture.
pub(crate) fn is_picture(path: &Path) -> bool {
    files::PICTURES.contains(&files::extension(path).as_str()) && !has_raw_name(path)
}

/// Reads a picture as it is stored (a calibration's places are the sensor's), linear light from 0 to 1, its numbers taken as the file says, or as sRGB.
///
/// # Errors
/// A file that cannot be read, or is no picture; one that takes more than `memory`, or is of more than 65536 pixels a side.
pub(crate) fn read(path: &Path, memory: Limit) -> Result<RawCapture> {
    let Stored { image, orientation, bits, told, left_out } = files::read_stored_within(path, None, memory)?;
    let (_, rows, columns) = image.dim();
    if !(1..=65_536).contains(&rows) || !(1..=65_536).contains(&columns) {
        let found = format!("{columns} × {rows} pixels");
        return Err(Error::bad(path.display().to_string(), "picture", found, "1 to 65536 pixels a side"));
    }
    let taken = match (bits, told) {
        (_, true) => "what its profile says",
        (Some(_), false) => "sRGB",
        (None, false) => "linear sRGB",
    };
    let mut notes = vec![format!(
        "a developed picture; its numbers are taken as {taken}, facts of its exposure are not carried over"
    )];
    notes.extend(left_out.map(str::to_owned));
    Ok(RawCapture {
        pixels: RawPixels::Linear(image),
        black: [0.0; 4],
        white: [1.0; 4],
        corrected: false,
        crop: Area { row: 0, column: 0, rows, columns },
        neutral: Some([1.0; 3]),
        camera_from_xyz: inverse(&XYZ_FROM_SRGB),
        orientation: Orientation::from_exif(u16::from(orientation)),
        make: String::new(),
        model: String::new(),
        exif: Exif::default(),
        notes,
    })
}
