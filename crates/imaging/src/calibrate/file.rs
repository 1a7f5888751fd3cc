//! `distortion.toml`: the measured distortion of a lens on a camera (`calibration/README.md` lists its keys).

use std::path::Path;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::model::{Pinhole, TERMS};
use crate::develop::distortion::Distortion;
use crate::frame::Frame;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};

/// Form of the files written here; files of this form are read.
const SCHEMA: u32 = 1;
const ALLOWED: &str = "calibration/README.md lists the keys of a distortion.toml";
/// Bytes of a file at most.
const MOST: u64 = 1 << 20;

/// A measured distortion, in pixels of its pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredDistortion {
    /// 1.
    pub schema: u32,
    /// Camera it was measured on; may be empty.
    pub camera: String,
    /// Lens it was measured of; may be empty.
    pub lens: String,
    /// Where the numbers come from: pictures, or a publication.
    pub source: String,
    /// Columns of the pictures.
    pub columns: usize,
    /// Rows of the pictures.
    pub rows: usize,
    /// Focal length, pixels.
    pub focal_length_px: f64,
    /// Centre of distortion `[column, row]`.
    pub centre_px: [f64; 2],
    /// `k₁, k₂, k₃` of `r_d = f r (1 + k₁ r² + k₂ r⁴ + k₃ r⁶)`, `r` the tangent of the field angle.
    pub k: [f64; TERMS],
    /// Largest `r` of a corner; beyond it the model is continued linearly.
    pub max_slope: f64,
    /// Root mean square distance of corners from where the model lands them, pixels.
    pub rms_px: f64,
}

impl MeasuredDistortion {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// A file that cannot be read, of another form, or with values that mean nothing.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&atomic::read_text(path, MOST)?, &path.display().to_string())
    }

    /// Parses and checks a text; `file` names it in messages.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let measured: Self = atomic::of_schema(text, file, SCHEMA, ALLOWED)?;
        measured.check(file)?;
        Ok(measured)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// Values that mean nothing.
    pub fn text(&self) -> Result<String> {
        self.check("")?;
        toml::to_string(self).map_err(|e| Error::Internal(format!("distortion to TOML: {e}")))
    }

    fn check(&self, file: &str) -> Result<()> {
        let refuse = |place: &str, found: String, allowed: &str| Err(Error::bad(file, place, found, allowed));
        if !(f64::MIN_POSITIVE..1e9).contains(&self.focal_length_px) {
            return refuse("focal_length_px", self.focal_length_px.to_string(), "above 0 and below 1e9");
        }
        if !(self.k.iter().chain(&self.centre_px).all(|v| v.abs() < 1e9)) {
            return refuse("k, centre_px", format!("{:?}, {:?}", self.k, self.centre_px), "finite numbers below 1e9");
        }
        Frame::centred(self.columns, self.rows, 1.0).map_err(|e| e.in_file(Path::new(file)))?;
        check_centre(file, self.centre_px, [self.columns, self.rows])?;
        self.distortion().check(["max_slope", "k", "rms_px"]).map_err(|e| e.in_file(file))
    }

    fn camera(&self) -> Pinhole {
        Pinhole { focal_px: DVec2::splat(self.focal_length_px), centre_px: self.centre_px.into(), k: self.k }
    }

    /// The frame of its pictures, in which a pixel is a millimetre: only ratios count where a picture is straightened.
    ///
    /// # Errors
    /// None where [`Self::load`] made it.
    pub fn frame(&self) -> Result<Frame> {
        Frame::centred(self.columns, self.rows, 1.0)?.with_axis(self.centre_px).map_err(|e| e.at("centre_px"))
    }

    /// The distortion in that frame.
    pub fn distortion(&self) -> Distortion {
        let unit = self.camera().distortion(self.max_slope);
        let coefficients_mm = unit.coefficients_mm.map(|b| self.focal_length_px * b);
        Distortion { coefficients_mm, residual_mm: self.rms_px, ..unit }
    }
}

/// Refuses a centre farther from the frame than its own size: nothing was measured there.
pub(super) fn check_centre(file: &str, centre_px: [f64; 2], [columns, rows]: [usize; 2]) -> Result<()> {
    for (axis, at, count) in [("x", centre_px[0], columns), ("y", centre_px[1], rows)] {
        let size = count as f64;
        if !(-size..=2.0 * size).contains(&at) {
            let allowed =
                format!("no farther from the frame than its own size: {} to {} px in {axis}", -size, 2.0 * size);
            return Err(Error::bad(file, "centre_px", at.to_string(), allowed));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_rel;

    fn measured() -> MeasuredDistortion {
        MeasuredDistortion {
            schema: 1,
            camera: "C".into(),
            lens: "L".into(),
            source: "20 pictures".into(),
            columns: 1280,
            rows: 720,
            focal_length_px: 1157.0,
            centre_px: [665.0, 388.0],
            k: [-0.25, 0.01, 0.02],
            max_slope: 0.6,
            rms_px: 0.9,
        }
    }

    #[test]
    fn files_come_back_and_wrong_ones_are_refused_by_key() {
        let text = measured().text().expect("valid");
        assert_eq!(MeasuredDistortion::parse(&text, "a.toml").expect("reads"), measured());
        for (from, to, words) in [
            ("schema = 1", "schema = 2", "schema"),
            ("schema = 1\n", "", "schema"),
            ("rows = 720", "rows = 0", "rows"),
            ("rows = 720", "rows = 720\nzoom = 3", "zoom"),
            ("focal_length_px = 1157.0", "focal_length_px = nan", "focal_length_px"),
            ("max_slope = 0.6", "max_slope = -1.0", "max_slope"),
            ("max_slope = 0.6", "max_slope = 5e-324", "max_slope: 5e-324; at least 1e-12"),
            ("rms_px = 0.9", "rms_px = -1.0", "rms_px"),
            ("rms_px = 0.9", "rms_px = inf", "rms_px"),
            ("centre_px = [665.0", "centre_px = [nan", "centre_px"),
            ("-0.25", "-2.5", "growing"),
        ] {
            assert!(text.contains(from), "{from}");
            let error = MeasuredDistortion::parse(&text.replace(from, to), "a.toml").expect_err(to);
            assert!(error.to_string().contains(words) && error.to_string().contains("a.toml"), "{to}: {error}");
            assert_eq!(error.exit_code(), 2);
        }
    }

    /// The polynomial in pixels is that of the camera.
    #[test]
    fn the_polynomial_is_the_cameras() {
        let (measured, distortion) = (measured(), measured().distortion());
        for i in 0..=10 {
            let r = 0.06 * f64::from(i);
            let landed = measured.camera().land(DVec2::new(r, 0.0)).x - 665.0;
            assert_rel(distortion.sensor_from_slope(r), landed, 1e-14, 1.0, "radius");
            assert_rel(
                distortion.sensor_from_slope_derivative(r),
                1157.0 * measured.camera().growth(r),
                1e-13,
                0.0,
                "growth",
            );
        }
    }
}
