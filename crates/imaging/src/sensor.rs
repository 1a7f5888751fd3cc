//! The sensor: levels, noise figures, colour and spectral response, read from `calibration/<camera>/sensor.toml`.
//!
//! `calibration/README.md` documents the file. The parsed value is checked once, here; the rest of the crate relies on it.

pub mod cfa;
#[doc(hidden)]
pub mod haze;
pub mod illuminant;
pub mod noise;
pub mod spectrum;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::sensor::cfa::Cfa;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};

/// The form of `sensor.toml` this version reads and writes.
const SCHEMA: u32 = 1;

/// Bytes of a sensor's file at most.
const LARGEST: u64 = 1 << 20;

/// A sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Form of the file: 1.
    pub schema: u32,
    /// Name of the sensor.
    pub name: String,
    /// Where the numbers come from.
    pub source: String,
    /// Bayer layout.
    pub cfa: Cfa,
    /// Bits of a raw value, 1 to 16.
    pub bits: u32,
    /// Raw value without light, DN.
    pub black_level: f64,
    /// Raw value at which a pixel saturates, DN.
    pub white_level: f64,
    /// Electrons at the white level.
    pub full_well_electrons: f64,
    /// Standard deviation of a pixel without light, electrons.
    pub read_noise_electrons: f64,
    /// Raw response to a neutral white, R, G, B relative to green.
    pub neutral_response: [f64; 3],
    /// White-balanced camera RGB to linear sRGB; each row sums to 1, so white stays white.
    pub srgb_from_camera: [[f64; 3]; 3],
    /// Relative response of each channel over wavelength.
    pub spectral_response: SpectralResponse,
}

/// A table of responses per unit of light power; linear between the entries, 0 outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpectralResponse {
    /// Wavelengths, nm, increasing.
    pub wavelength_nm: Vec<f64>,
    /// Response of the red channel.
    pub red: Vec<f64>,
    /// Response of the green channel.
    pub green: Vec<f64>,
    /// Response of the blue channel.
    pub blue: Vec<f64>,
}

impl SpectralResponse {
    /// The channels in order, R, G, B.
    pub fn channels(&self) -> [&[f64]; 3] {
        [&self.red, &self.green, &self.blue]
    }
}

/// Electrons that a pixel may hold: noise of fewer, and numbers of more, are not a picture's.
const WELL: [f64; 2] = [1.0, 1e15];

impl Sensor {
    /// The sensor that comes with the program: `calibration/generic-rggb/sensor.toml`.
    pub fn generic() -> Self {
        Self::parse(isoplanat_calibration::GENERIC_RGGB, "generic-rggb/sensor.toml")
            .expect("the shipped sensor is valid; a test parses it")
    }

    /// Reads a `sensor.toml`.
    pub fn load(path: &Path) -> Result<Self> {
        let text = atomic::read_text(path, LARGEST)?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Parses and checks the text of a `sensor.toml`; `file` names it in messages.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let allowed = "calibration/README.md lists the keys of a sensor.toml";
        let sensor: Self = atomic::of_schema(text, file, SCHEMA, allowed)?;
        sensor.check(file)?;
        Ok(sensor)
    }

    /// What a model card says of the sensor its network was trained for: SHA-256 (hex) of its TOML.
    pub fn sha256(&self) -> String {
        atomic::sha256_hex(toml::to_string(self).unwrap_or_default().as_bytes())
    }

    /// Writes this sensor as a `sensor.toml`, whole or not at all.
    pub fn save<'a>(&self, to: impl Into<atomic::Target<'a>>) -> Result<()> {
        let text = toml::to_string(self).map_err(|e| Error::Internal(format!("sensor to TOML: {e}")))?;
        atomic::write_bytes(to, text.as_bytes())
    }

    /// Refuses values that mean nothing; `file` names their file.
    pub fn check(&self, file: &str) -> Result<()> {
        let refuse = |ok: bool, place: &str, found: String, allowed: &str| {
            if ok { Ok(()) } else { Err(Error::bad(file, place, found, allowed)) }
        };
        refuse(!self.source.trim().is_empty(), "source", "nothing".into(), "where numbers and response come from")?;
        let Self { bits, black_level: black, white_level: white, .. } = *self;
        refuse((1..=16).contains(&bits), "bits", bits.to_string(), "1 to 16")?;
        refuse(black >= 0.0 && black.is_finite(), "black_level", black.to_string(), "a number of DN, 0 or more")?;
        let top = 2f64.powi(i32::try_from(bits).unwrap_or(16)) - 1.0;
        // Captures state both as whole numbers.
        let allowed =
            format!("1 DN or more above black_level, as whole numbers, and at most {top}, which {bits} bits hold");
        let apart = white.floor() - black.round() >= 1.0 && white > black;
        refuse(apart && white <= top, "white_level", white.to_string(), &allowed)?;
        let [least, most] = WELL;
        let well = self.full_well_electrons;
        let allowed = format!("{least} to {most:e} electrons");
        refuse((least..=most).contains(&well), "full_well_electrons", well.to_string(), &allowed)?;
        let read = self.read_noise_electrons;
        let allowed = format!("0 to full_well_electrons, {well}");
        refuse((0.0..=well).contains(&read), "read_noise_electrons", read.to_string(), &allowed)?;
        let neutral = self.neutral_response;
        let good = neutral.iter().all(|v| *v > 0.0 && v.is_finite()) && neutral[1] == 1.0;
        refuse(good, "neutral_response", format!("{neutral:?}"), "three numbers above 0, the second (green) 1")?;
        for (i, row) in self.srgb_from_camera.iter().enumerate() {
            let sum: f64 = row.iter().sum();
            let allowed = "three numbers that sum to 1, so that white stays white";
            refuse((sum - 1.0).abs() < 1e-6, &format!("srgb_from_camera[{i}]"), format!("{row:?}"), allowed)?;
        }
        self.spectral_response.check(&refuse)
    }
}

impl SpectralResponse {
    fn check(&self, refuse: &impl Fn(bool, &str, String, &str) -> Result<()>) -> Result<()> {
        let nm = &self.wavelength_nm;
        let place = "spectral_response.wavelength_nm";
        refuse(nm.len() >= 2, place, format!("{} entries", nm.len()), "two or more")?;
        let increasing = nm.windows(2).all(|w| w[0] < w[1]) && nm[0] > 0.0 && nm[nm.len() - 1].is_finite();
        refuse(increasing, place, format!("{nm:?}"), "positive and increasing")?;
        for (name, response) in ["red", "green", "blue"].into_iter().zip(self.channels()) {
            let place = format!("spectral_response.{name}");
            let allowed = format!("as many as wavelength_nm: {}", nm.len());
            refuse(response.len() == nm.len(), &place, format!("{} entries", response.len()), &allowed)?;
            let good = response.iter().all(|v| *v >= 0.0 && v.is_finite()) && response.iter().any(|v| *v > 0.0);
            refuse(good, &place, format!("{response:?}"), "numbers of 0 or more, not all 0")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text() -> &'static str {
        isoplanat_calibration::GENERIC_RGGB
    }

    #[test]
    fn the_shipped_sensor_is_what_its_source_says() {
        let sensor = Sensor::generic();
        assert_eq!((sensor.bits, sensor.cfa), (12, Cfa::RGGB));
        assert_eq!((sensor.black_level, sensor.white_level), (256.0, 4095.0));
        let table = &sensor.spectral_response;
        for (channel, (mean, sigma)) in [(600.0, 35.0), (540.0, 38.0), (460.0, 28.0f64)].into_iter().enumerate() {
            for (nm, v) in table.wavelength_nm.iter().zip(table.channels()[channel]) {
                let gauss = (-0.5 * ((nm - mean) / sigma).powi(2)).exp();
                assert!((v - gauss).abs() <= 5.1e-7, "channel {channel} at {nm} nm: {v} against {gauss}");
            }
        }
    }

    #[test]
    fn a_saved_sensor_reads_back_the_same() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("sensor.toml");
        let sensor = Sensor { black_level: 511.6, bits: 14, white_level: 16000.0, ..Sensor::generic() };
        sensor.save(&path).expect("writes");
        assert_eq!(Sensor::load(&path).expect("reads"), sensor);
    }

    #[test]
    fn bad_files_are_refused_with_file_and_place() {
        let cases = [
            ("schema = 1", "schema = 2", "schema"),
            ("schema = 1", "", "schema"),
            ("source = \"", "source = \" \" # \"", "source"),
            ("bits = 12", "bits = 17", "bits"),
            ("bits = 12", "bits = 12\nlens = 3", "lens"),
            ("\"RGGB\"", "\"RGBW\"", "RGBW"),
            ("white_level = 4095", "white_level = 4096", "white_level"),
            ("white_level = 4095", "white_level = 256", "white_level"),
            ("white_level = 4095", "white_level = 256.5", "white_level"),
            ("black_level = 256", "black_level = 4094.9999", "white_level"),
            ("black_level = 256", "black_level = nan", "black_level"),
            ("full_well_electrons = 6000", "full_well_electrons = 5e-324", "full_well_electrons"),
            ("read_noise_electrons = 4", "read_noise_electrons = 1e308", "read_noise_electrons"),
            ("0.55, 1.0, 0.7]", "0.55, 1.0, 0.7, 1.0]", "a list of 4 in place of a list of 3"),
            ("full_well_electrons = 6000", "full_well_electrons = 0", "full_well_electrons"),
            ("read_noise_electrons = 4", "read_noise_electrons = -4", "read_noise_electrons"),
            ("0.55, 1.0, 0.7", "0.55, 0.9, 0.7", "neutral_response"),
            ("[1.0, 0.0, 0.0]", "[1.0, 0.1, 0.0]", "srgb_from_camera[0]"),
            ("400, 410,", "410, 400,", "wavelength_nm"),
            ("400, 410,", "410,", "spectral_response.red"),
            ("name = ", "name == ", "line 3"),
        ];
        for (from, to, place) in cases {
            assert!(text().contains(from), "{from}");
            let error = Sensor::parse(&text().replacen(from, to, 1), "x.toml").expect_err(to).to_string();
            assert!(error.starts_with("x.toml: ") && error.contains(place), "{to}: {error}");
        }
        let missing = Path::new("/nonexistent/sensor.toml");
        assert!(Sensor::load(missing).expect_err("no such file").to_string().contains("sensor.toml"));
    }
}
