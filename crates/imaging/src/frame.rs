//! The only place where millimetres on the sensor become columns and rows, image inversion included.
//!
//! Pixel (row `i`, column `j`) covers `[j, j + 1) × [i, i + 1)` in pixel coordinates `(column, row)`, so its centre is
//! `(j + ½, i + ½)`. Pictures are stored *upright*, as they are looked at: columns run to the right, rows downwards.
//! Millimetres of the upright picture run right (`+x`) and up (`+y`) from the optical axis; an object at `+x, +y`
//! appears there. On the sensor itself the lens has turned the image by 180°: `Frame::upright_from_sensor_mm`.

use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};
use isoplanat_optics::psf::SensorPoint;

/// Size of a picture, pixel pitch, and where the optical axis meets it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FrameFile")]
pub struct Frame {
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// Distance between neighbouring pixel centres, mm.
    pub pitch_mm: f64,
    /// The optical axis in pixel coordinates `[column, row]`; it may lie at a corner or outside.
    pub axis_px: [f64; 2],
}

/// The form in files: `axis_px` left out means the centre.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameFile {
    columns: usize,
    rows: usize,
    pitch_mm: f64,
    axis_px: Option<[f64; 2]>,
}

impl TryFrom<FrameFile> for Frame {
    type Error = Error;

    fn try_from(file: FrameFile) -> Result<Self> {
        file.checked().map_err(|e| e.within("frame"))
    }
}

/// Pitches of frames in files, mm: those of the sensors that lens files have lie within.
const PITCHES_MM: std::ops::RangeInclusive<f64> = 1e-5..=1e3;
/// How far from the first pixel the axis of a frame in a file lies at most, as in lens files.
const FARTHEST_PX: f64 = 1e6;

impl FrameFile {
    fn checked(self) -> Result<Frame> {
        let frame = Frame::centred(self.columns, self.rows, self.pitch_mm)?;
        if !PITCHES_MM.contains(&self.pitch_mm) {
            let allowed = format!("{:e} to {} mm", PITCHES_MM.start(), PITCHES_MM.end());
            return Err(Error::bad("", "pitch_mm", self.pitch_mm.to_string(), allowed));
        }
        let Some(axis_px) = self.axis_px else { return Ok(frame) };
        if !axis_px.iter().all(|v| v.abs() <= FARTHEST_PX) {
            let allowed = format!("two numbers of pixels from -{FARTHEST_PX:e} to {FARTHEST_PX:e}");
            return Err(Error::bad("", "axis_px", format!("{axis_px:?}"), allowed));
        }
        frame.with_axis(axis_px)
    }
}

impl Frame {
    /// A frame whose axis is at its centre.
    ///
    /// ```
    /// use isoplanat_imaging::frame::Frame;
    ///
    /// let frame = Frame::centred(600, 400, 0.006)?;
    /// assert_eq!(frame.mm_from_pixel([300.0, 100.0]), [0.0, 0.6]);
    /// assert!((frame.max_radius_mm() - 300_f64.hypot(200.0) * 0.006).abs() < 1e-12);
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// A size outside `1..=65536` or a pitch that is not a positive, finite number of mm.
    pub fn centred(columns: usize, rows: usize, pitch_mm: f64) -> Result<Self> {
        for (name, size) in [("columns", columns), ("rows", rows)] {
            if !(1..=65_536).contains(&size) {
                return Err(Error::bad("", name, size.to_string(), "1 to 65536 pixels"));
            }
        }
        if !(pitch_mm > 0.0 && pitch_mm.is_finite()) {
            return Err(Error::bad("", "pitch_mm", pitch_mm.to_string(), "a positive number of mm"));
        }
        let axis_px = [columns as f64 / 2.0, rows as f64 / 2.0];
        Ok(Self { columns, rows, pitch_mm, axis_px })
    }

    /// The same frame with the optical axis at `axis_px = [column, row]`.
    ///
    /// # Errors
    /// A coordinate that is not finite.
    pub fn with_axis(mut self, axis_px: [f64; 2]) -> Result<Self> {
        if !axis_px.iter().all(|v| v.is_finite()) {
            return Err(Error::bad("", "axis_px", format!("{axis_px:?}"), "two finite numbers [column, row]"));
        }
        self.axis_px = axis_px;
        Ok(self)
    }

    /// Millimetres `[right, up]` of the upright picture from pixel coordinates `[column, row]`.
    pub fn mm_from_pixel(&self, pixel: [f64; 2]) -> [f64; 2] {
        [(pixel[0] - self.axis_px[0]) * self.pitch_mm, (self.axis_px[1] - pixel[1]) * self.pitch_mm]
    }

    /// Pixel coordinates `[column, row]` from millimetres `[right, up]` of the upright picture.
    pub fn pixel_from_mm(&self, mm: [f64; 2]) -> [f64; 2] {
        [self.axis_px[0] + mm[0] / self.pitch_mm, self.axis_px[1] - mm[1] / self.pitch_mm]
    }

    /// Millimetres of the upright picture from millimetres on the sensor in the lens frame (`+y` up, `z` along the
    /// light, so `+x` is to the right of someone behind the camera). Its own inverse.
    pub(crate) fn upright_from_sensor_mm(sensor_mm: [f64; 2]) -> [f64; 2] {
        [-sensor_mm[0], -sensor_mm[1]]
    }

    /// Pixel coordinates `[column, row]` of a ray that lands at `sensor_mm` in the lens frame.
    pub fn pixel_from_sensor_mm(&self, sensor_mm: [f64; 2]) -> [f64; 2] {
        self.pixel_from_mm(Self::upright_from_sensor_mm(sensor_mm))
    }

    /// Landing point in the lens frame of pixel coordinates `[column, row]`.
    pub(crate) fn sensor_mm_from_pixel(&self, pixel: [f64; 2]) -> [f64; 2] {
        Self::upright_from_sensor_mm(self.mm_from_pixel(pixel))
    }

    /// The point of the sensor at pixel coordinates `(column, row)`; a pixel's centre is at `(j + ½, i + ½)`.
    pub fn point(&self, column: f64, row: f64) -> SensorPoint {
        SensorPoint::at([(column - self.axis_px[0]) * self.pitch_mm, (row - self.axis_px[1]) * self.pitch_mm])
    }

    /// Distance from the axis, mm, of pixel coordinates `(column, row)`; a pixel's centre is at `(j + ½, i + ½)`.
    pub fn radius_mm(&self, column: f64, row: f64) -> f64 {
        (column - self.axis_px[0]).hypot(row - self.axis_px[1]) * self.pitch_mm
    }

    /// Distance from the axis to the farthest corner, mm.
    pub fn max_radius_mm(&self) -> f64 {
        let (w, h) = (self.columns as f64, self.rows as f64);
        [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].iter().map(|&(c, r)| self.radius_mm(c, r)).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_millimetres_are_inverse_and_upright() {
        let frame = Frame::centred(6, 4, 0.5).expect("valid");
        assert_eq!(frame.axis_px, [3.0, 2.0]);
        // The top left pixel's centre is 2.5 pixels left of and 1.5 above the axis.
        assert_eq!(frame.mm_from_pixel([0.5, 0.5]), [-1.25, 0.75]);
        assert_eq!(frame.pixel_from_mm([-1.25, 0.75]), [0.5, 0.5]);
        // A ray of an object above the axis lands below it on the sensor and is shown above.
        assert!(frame.pixel_from_sensor_mm([0.0, -1.0])[1] < frame.axis_px[1]);
        assert_eq!(frame.sensor_mm_from_pixel(frame.pixel_from_sensor_mm([0.25, -0.5])), [0.25, -0.5]);
        assert!((frame.max_radius_mm() - 3.0_f64.hypot(2.0) * 0.5).abs() < 1e-15);
    }

    #[test]
    fn files_default_to_a_centred_axis_and_are_checked() {
        let frame: Frame = toml::from_str("columns = 4096\nrows = 512\npitch_mm = 0.006").expect("valid");
        assert_eq!(frame.axis_px, [2048.0, 256.0]);
        let corner: Frame =
            toml::from_str("columns = 4096\nrows = 512\npitch_mm = 0.006\naxis_px = [0.0, 512.0]").expect("valid");
        assert_eq!(toml::from_str::<Frame>(&toml::to_string(&corner).expect("writes")).expect("reads"), corner);
        for bad in ["columns = 0\nrows = 5\npitch_mm = 1.0", "columns = 5\nrows = 5\npitch_mm = nan", "rows = 5"] {
            assert!(toml::from_str::<Frame>(bad).is_err(), "{bad}");
        }
        // What lens files may say, and nothing beyond.
        for (pitch, axis, good) in [
            ("2e-5", "[-1e6, 1e6]", true),
            ("1e3", "[0.0, -7.5]", true),
            ("1e-300", "[0.0, 0.0]", false),
            ("1e6", "[0.0, 0.0]", false),
            ("0.006", "[1e8, 0.0]", false),
            ("0.006", "[0.0, -1e300]", false),
            ("0.006", "[nan, 0.0]", false),
        ] {
            let read = toml::from_str::<Frame>(&format!("columns = 9\nrows = 5\npitch_mm = {pitch}\naxis_px = {axis}"));
            assert_eq!(read.is_ok(), good, "{pitch} {axis}");
        }
    }
}
