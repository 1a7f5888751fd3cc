//! The colours that a picture's numbers stand for, and the ICC profile that says so.
//!
//! Both spaces have sRGB's white (D65) and its curve. Profiles are those of the `moxcms` crate, without the code-point tag, whose primaries for Display
//! P3 are another space's there; with `linear` their curves are straight lines.

use moxcms::{ColorProfile, LocalizableString, ProfileText, ToneReprCurve};
use serde::{Deserialize, Serialize};

use super::color::{IDENTITY, XYZ_FROM_SRGB, inverse, product};
use isoplanat_base::error::{Error, Result};

/// Linear Display P3 to CIE XYZ: SMPTE EG 432-1 primaries (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), white (0.3127, 0.3290).
const XYZ_FROM_P3: [[f64; 3]; 3] = [
    [0.486_570_948_648_216_2, 0.265_667_693_169_093_1, 0.198_217_285_234_362_5],
    [0.228_974_564_069_748_8, 0.691_738_521_836_506_4, 0.079_286_914_093_745_0],
    [0.0, 0.045_113_381_858_902_6, 1.043_944_368_900_976],
];

/// A space of colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gamut {
    /// sRGB (IEC 61966-2-1).
    #[default]
    Srgb,
    /// Display P3: a quarter more colours, as most screens since 2016 show them.
    DisplayP3,
}

impl Gamut {
    /// Linear values in this space from linear sRGB.
    pub fn from_srgb(self) -> [[f64; 3]; 3] {
        match self {
            Self::Srgb => IDENTITY,
            Self::DisplayP3 => product(&inverse(&XYZ_FROM_P3).expect("a constant with an inverse"), &XYZ_FROM_SRGB),
        }
    }

    /// How much each of its primaries adds to luminance.
    pub fn luminance(self) -> [f64; 3] {
        match self {
            Self::Srgb => XYZ_FROM_SRGB[1],
            Self::DisplayP3 => XYZ_FROM_P3[1],
        }
    }

    /// What Exif calls it: 1 for sRGB, 65535 for what only the profile tells.
    pub fn exif(self, linear: bool) -> u16 {
        if self == Self::Srgb && !linear { 1 } else { u16::MAX }
    }

    /// The ICC profile.
    ///
    /// # Errors
    /// None; the profile writer's own.
    pub fn icc(self, linear: bool) -> Result<Vec<u8>> {
        let mut profile = match self {
            Self::Srgb => ColorProfile::new_srgb(),
            Self::DisplayP3 => ColorProfile::new_display_p3(),
        };
        profile.cicp = None;
        if linear {
            let line = Some(ToneReprCurve::Lut(Vec::new()));
            (profile.red_trc, profile.green_trc, profile.blue_trc) = (line.clone(), line.clone(), line);
            let name = match self {
                Self::Srgb => "sRGB, linear",
                Self::DisplayP3 => "Display P3, linear",
            };
            let name = LocalizableString::new("en".into(), "US".into(), name.into());
            profile.description = Some(ProfileText::Localizable(vec![name]));
        }
        let mut bytes = profile.encode().map_err(|e| Error::Internal(format!("colour profile: {e}")))?;
        // Equal pictures are equal files: the date in the head (ICC.1:2022, 7.2.10) is not the clock's.
        if let Some(date) = bytes.get_mut(24..36) {
            date.copy_from_slice(&[7, 208, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0]);
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against published values (CSS Color 4: `color(display-p3 1 0 0)` and sRGB red in Display P3), and white stays white.
    #[test]
    fn display_p3_is_the_standards() {
        let p3 = Gamut::DisplayP3.from_srgb();
        for (row, expected) in p3.iter().zip([0.822_458, 0.033_194, 0.017_085]) {
            assert!((row[0] - expected).abs() < 2e-4, "{row:?}");
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-3, "white: {row:?}");
        }
        assert!((Gamut::DisplayP3.luminance().iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }

    /// A colour engine that reads the profiles gives the matrix and the curve that pictures are made with.
    #[test]
    fn profiles_say_what_pictures_are() {
        use moxcms::{Layout, TransformOptions};
        let srgb = ColorProfile::new_from_slice(&Gamut::Srgb.icc(true).expect("writes")).expect("reads");
        for (gamut, linear) in [(Gamut::Srgb, false), (Gamut::DisplayP3, false), (Gamut::DisplayP3, true)] {
            let profile = ColorProfile::new_from_slice(&gamut.icc(linear).expect("writes")).expect("reads");
            let transform = profile
                .create_transform_f32(Layout::Rgb, &srgb, Layout::Rgb, TransformOptions::default())
                .expect("a transform");
            for colour in [[0.5, 0.5, 0.5], [0.3, 0.5, 0.4], [0.42, 0.4, 0.38]] {
                let mut out = [0.0f32; 3];
                transform.transform(&colour, &mut out).expect("transforms");
                let light = colour.map(|v| {
                    let v = f64::from(v);
                    if linear { v } else { crate::develop::color::linear_from_srgb(v) }
                });
                let back = inverse(&gamut.from_srgb()).expect("an inverse");
                for (row, seen) in back.iter().zip(out) {
                    let expected: f64 = row.iter().zip(light).map(|(m, v)| m * v).sum();
                    assert!((expected - f64::from(seen)).abs() < 2e-3, "{gamut:?} {colour:?}: {expected} {seen}");
                }
            }
        }
    }
}
