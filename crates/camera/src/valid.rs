//! What a kit is for: ISO, f-number, focal length and distance of the captures that its network and its calibration know.

use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};
use isoplanat_base::figures::significant;
use isoplanat_imaging::exif::Exif;

/// Ranges of a capture's facts, each from lowest to highest; what is left out is not looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Valid {
    /// ISO speed: with it the noise that the network was trained for changes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<[f64; 2]>,
    /// F-number: blur and falling light are of one aperture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_number: Option<[f64; 2]>,
    /// Focal length, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<[f64; 2]>,
    /// Distance of the subject, m; the highest may be infinite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<[f64; 2]>,
}

/// A range's key in `kit.toml`, the range, and the capture's own value.
type Row = (&'static str, Option<[f64; 2]>, Option<f64>);

impl Valid {
    /// Whether nothing is stated.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    fn rows(&self, exif: &Exif) -> [Row; 4] {
        [
            ("iso", self.iso, exif.iso()),
            ("f_number", self.f_number, exif.f_number()),
            ("focal_length_mm", self.focal_length_mm, exif.focal_length_mm()),
            ("distance_m", self.distance_m, exif.subject_distance_m()),
        ]
    }

    /// Adds `KEY=LOW..HIGH` (or `KEY=VALUE`), as the command line has it.
    ///
    /// ```
    /// use isoplanat_camera::valid::Valid;
    ///
    /// let mut valid = Valid::default();
    /// valid.put("iso=100..800")?;
    /// assert_eq!(valid.iso, Some([100.0, 800.0]));
    /// assert!(valid.put("iso=800..100").is_err());
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// A key or a range that is none.
    pub fn put(&mut self, text: &str) -> Result<()> {
        let refuse = || {
            Error::bad(
                "--valid",
                "value",
                text,
                "iso, f_number, focal_length_mm or distance_m, `=`, LOW..HIGH or a number",
            )
        };
        let (key, range) = text.split_once('=').ok_or_else(refuse)?;
        let number = |t: &str| t.trim().parse::<f64>().map_err(|_| refuse());
        let range = match range.split_once("..") {
            Some((low, high)) => [number(low)?, number(high)?],
            None => [number(range)?; 2],
        };
        let place = match key.trim() {
            "iso" => &mut self.iso,
            "f_number" => &mut self.f_number,
            "focal_length_mm" => &mut self.focal_length_mm,
            "distance_m" => &mut self.distance_m,
            _ => return Err(refuse()),
        };
        *place = Some(range);
        self.check("--valid")
    }

    /// Refuses ranges that are none; `file` names them.
    ///
    /// # Errors
    /// A number that is not above 0, or a range that ends before it begins.
    pub(crate) fn check(&self, file: &str) -> Result<()> {
        for (key, range, _) in self.rows(&Exif::default()) {
            if let Some([low, high]) = range.filter(|[low, high]| !(*low > 0.0 && low.is_finite() && low <= high)) {
                let allowed = "from a number above 0 to the same or a higher one";
                return Err(Error::bad(file, format!("valid.{key}"), format!("[{low}, {high}]"), allowed));
            }
        }
        Ok(())
    }

    /// One sentence for each fact of a capture that the kit is not for; facts that the capture does not tell are not known to be wrong.
    pub fn notes(&self, exif: &Exif) -> Vec<String> {
        /// Cameras write rounded numbers.
        const ROUNDED: f64 = 0.01;
        let shown = |v: f64| if v.is_finite() { significant(v, 4) } else { "infinity".into() };
        let outside = self.rows(exif).into_iter().filter_map(|(key, range, found)| Some((key, range?, found?)));
        outside
            .filter(|(_, [low, high], found)| *found < low * (1.0 - ROUNDED) || *found > high * (1.0 + ROUNDED))
            .map(|(key, [low, high], found)| {
                let (name, unit) = match key {
                    "iso" => ("ISO", ""),
                    "f_number" => ("f-number", ""),
                    "focal_length_mm" => ("focal length", " mm"),
                    _ => ("distance", " m"),
                };
                let to = if low < high { format!(" to {}", shown(high)) } else { String::new() };
                format!("taken at {name} {}{unit}; the kit is for {}{to}{unit}", shown(found), shown(low))
            })
            .collect()
    }

    /// The ranges in words.
    pub fn told(&self) -> String {
        let rows = self.rows(&Exif::default());
        let all: Vec<String> = rows
            .into_iter()
            .filter_map(|(key, range, _)| {
                range.map(|[low, high]| format!("{key} {} to {}", significant(low, 4), significant(high, 4)))
            })
            .collect();
        if all.is_empty() { "not stated".into() } else { all.join(", ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_imaging::exif::{Directory, Value, tags};

    #[test]
    fn captures_outside_are_told_and_silent_ones_are_not() {
        let mut valid = Valid::default();
        for text in ["iso=100..400", "f_number=4", "distance_m=0.8..inf"] {
            valid.put(text).expect("a range");
        }
        let mut exif = Exif::default();
        assert!(valid.notes(&exif).is_empty(), "nothing is told");
        let mut set = |tag, value| exif.set(Directory::Exposure, tag, value);
        set(tags::ISO, Value::Short(400));
        set(tags::F_NUMBER, Value::Ratios(vec![[401, 100]]));
        set(tags::SUBJECT_DISTANCE, Value::Ratios(vec![[u32::MAX, 1]]));
        set(tags::FOCAL_LENGTH, Value::Ratios(vec![[50, 1]]));
        assert!(valid.notes(&exif).is_empty(), "{:?}", valid.notes(&exif));
        exif.set(Directory::Exposure, tags::ISO, Value::Short(1600));
        exif.set(Directory::Exposure, tags::F_NUMBER, Value::Ratios(vec![[28, 10]]));
        let notes = valid.notes(&exif);
        assert_eq!(notes, ["taken at ISO 1600; the kit is for 100 to 400", "taken at f-number 2.8; the kit is for 4"]);
        let text = toml::to_string(&valid).expect("writes");
        assert_eq!(toml::from_str::<Valid>(&text).expect("reads"), valid, "{text}");
    }

    #[test]
    fn ranges_that_are_none_are_refused() {
        for text in ["iso", "iso=", "iso=400..100", "iso=0", "iso=nan", "iso=inf", "f=4", "f_number=4..x", "=3"] {
            let error = Valid::default().put(text).expect_err(text);
            assert_eq!(error.exit_code(), 2, "{text}: {error}");
        }
    }
}
