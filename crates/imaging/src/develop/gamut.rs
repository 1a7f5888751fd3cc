//! The colours that a picture's numbers stand for, and the ICC profile that says so.
//!
//! Both spaces have sRGB's white (D65) and its curve. Profiles are those of the `moxcms` crate, without the code-point tag, whose primaries for Display
//! P3 are another space's there; with `linear` their curves are straight lines. White, primaries and the layout are made to be what strict readers ask
//! for (ICC.1:2022; libpng's checks): white is D50 exactly, primaries are adapted to it (Bradford) and add up to it, elements lie on multiples of 4.

use moxcms::{ColorProfile, LocalizableString, Matrix3d, ProfileText, ToneReprCurve, Xyzd};
use serde::{Deserialize, Serialize};

use super::color::{IDENTITY, XYZ_FROM_SRGB, inverse, product};
use isoplanat_base::error::{Error, Result};

/// Linear Display P3 to CIE XYZ: SMPTE EG 432-1 primaries (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), white (0.3127, 0.3290).
const XYZ_FROM_P3: [[f64; 3]; 3] = [
    [0.486_570_948_648_216_2, 0.265_667_693_169_093_1, 0.198_217_285_234_362_5],
    [0.228_974_564_069_748_8, 0.691_738_521_836_506_4, 0.079_286_914_093_745_0],
    [0.0, 0.045_113_381_858_902_6, 1.043_944_368_900_976],
];

/// White of the profile connection space, D50 (ICC.1:2022, 7.2.16), 65536ths: what profiles hold of 0.9642, 1, 0.8249.
const D50: [u32; 3] = [0xf6d6, 0x1_0000, 0xd32d];

/// The Bradford cone response (ICC.1:2022, annex E).
const BRADFORD: [[f64; 3]; 3] = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];

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
    pub(crate) fn luminance(self) -> [f64; 3] {
        match self {
            Self::Srgb => XYZ_FROM_SRGB[1],
            Self::DisplayP3 => XYZ_FROM_P3[1],
        }
    }

    /// What Exif calls it: 1 for sRGB, 65535 for what only the profile tells.
    pub(crate) fn exif(self, linear: bool) -> u16 {
        if self == Self::Srgb && !linear { 1 } else { u16::MAX }
    }

    /// The ICC profile.
    ///
    /// # Errors
    /// None; the profile writer's own.
    pub(crate) fn icc(self, linear: bool) -> Result<Vec<u8>> {
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
        let (adapted, colorants) = self.adapted();
        let column = |k: usize| Xyzd::new(colorants[0][k], colorants[1][k], colorants[2][k]);
        (profile.red_colorant, profile.green_colorant, profile.blue_colorant) = (column(0), column(1), column(2));
        profile.chromatic_adaptation = Some(Matrix3d { v: adapted });
        let [x, y, z] = D50.map(|v| f64::from(v) / 65536.0);
        (profile.white_point, profile.media_white_point) = (Xyzd::new(x, y, z), Some(Xyzd::new(x, y, z)));
        let bytes = profile.encode().map_err(|e| Error::Internal(format!("colour profile: {e}")))?;
        let mut bytes = aligned(&bytes).ok_or_else(|| Error::Internal("colour profile: its table".into()))?;
        // Equal pictures are equal files: the date in the head (ICC.1:2022, 7.2.10) is not the clock's.
        bytes[24..36].copy_from_slice(&[7, 208, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0]);
        for (place, v) in bytes[68..80].chunks_exact_mut(4).zip(D50) {
            place.copy_from_slice(&v.to_be_bytes());
        }
        Ok(bytes)
    }

    /// Its primaries as XYZ under D50, one a column.
    pub(super) fn primaries(self) -> [[f64; 3]; 3] {
        self.adapted().1
    }

    /// From XYZ under D65 to D50, and the primaries there, one a column.
    fn adapted(self) -> ([[f64; 3]; 3], [[f64; 3]; 3]) {
        let xyz = match self {
            Self::Srgb => XYZ_FROM_SRGB,
            Self::DisplayP3 => XYZ_FROM_P3,
        };
        let cones = |white: [f64; 3]| BRADFORD.map(|row| row.iter().zip(white).map(|(m, w)| m * w).sum::<f64>());
        let (from, to) = (cones(xyz.map(|row| row.iter().sum())), cones(D50.map(|v| f64::from(v) / 65536.0)));
        let scaled: [[f64; 3]; 3] = std::array::from_fn(|k| BRADFORD[k].map(|v| v * to[k] / from[k]));
        let adapted = product(&inverse(&BRADFORD).expect("a constant with an inverse"), &scaled);
        (adapted, product(&adapted, &xyz))
    }
}

/// The profile with every element on a multiple of 4 bytes, equal elements once, and as long as a multiple of 4 (ICC.1:2022, 7.2.2 and 7.3.1). `None`
/// where its table points outside.
fn aligned(profile: &[u8]) -> Option<Vec<u8>> {
    let word = |at: usize| Some(u32::from_be_bytes(profile.get(at..at + 4)?.try_into().ok()?) as usize);
    let count = word(128)?;
    let mut out = profile.get(..132 + 12 * count)?.to_vec();
    let mut places: Vec<(&[u8], usize)> = Vec::with_capacity(count);
    for entry in (0..count).map(|k| 132 + 12 * k) {
        let (from, length) = (word(entry + 4)?, word(entry + 8)?);
        let element = profile.get(from..from.checked_add(length)?)?;
        let place = places.iter().find(|(other, _)| *other == element).map(|(_, place)| *place);
        let place = place.unwrap_or_else(|| {
            let place = out.len();
            out.extend_from_slice(element);
            out.resize(out.len().next_multiple_of(4), 0);
            places.push((element, place));
            place
        });
        out[entry + 4..entry + 8].copy_from_slice(&u32::try_from(place).ok()?.to_be_bytes());
    }
    let length = u32::try_from(out.len()).ok()?;
    out[..4].copy_from_slice(&length.to_be_bytes());
    Some(out)
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

    /// A strict reader's rules, stated apart from the writer: those of libpng 1.6 (`png_icc_check_length`, `_header`, `_tag_table`) and of ICC.1:2022,
    /// 7.2 and 7.3, for a display's profile.
    fn strict(profile: &[u8]) -> std::result::Result<(), String> {
        let word = |at: usize| u32::from_be_bytes(profile[at..at + 4].try_into().expect("four bytes"));
        let need = |ok: bool, what: &str| if ok { Ok(()) } else { Err(what.to_owned()) };
        need(profile.len() >= 132 && word(0) as usize == profile.len(), "length")?;
        need(profile.len().is_multiple_of(4), "length no multiple of 4")?;
        need(profile[8] == 4, "version")?;
        need(&profile[12..24] == b"mntrRGB XYZ " && &profile[36..40] == b"acsp", "class, space or signature")?;
        need(word(64) < 4, "intent")?;
        need([word(68), word(72), word(76)] == D50, "illuminant is not D50")?;
        need(profile[100..128].iter().all(|b| *b == 0), "reserved")?;
        let count = word(128) as usize;
        need(count <= (profile.len() - 132) / 12, "tag count")?;
        let mut seen = Vec::new();
        for entry in (0..count).map(|k| 132 + 12 * k) {
            let (name, start, length) =
                (&profile[entry..entry + 4], word(entry + 4) as usize, word(entry + 8) as usize);
            let told = String::from_utf8_lossy(name).into_owned();
            need(start.is_multiple_of(4), &format!("{told} is not aligned"))?;
            need(
                start >= 132 + 12 * count && length <= profile.len() - start.min(profile.len()),
                &format!("{told} is outside"),
            )?;
            need(!seen.contains(&told), &format!("{told} stands twice"))?;
            seen.push(told);
        }
        for name in ["desc", "cprt", "wtpt", "chad", "rXYZ", "gXYZ", "bXYZ", "rTRC", "gTRC", "bTRC"] {
            need(seen.iter().any(|s| s == name), &format!("{name} is missing"))?;
        }
        Ok(())
    }

    /// The three numbers of an XYZ element.
    fn xyz(profile: &[u8], name: &[u8; 4]) -> [f64; 3] {
        let word = |at: usize| i32::from_be_bytes(profile[at..at + 4].try_into().expect("four bytes"));
        let entry = (132..).step_by(12).find(|at| &profile[*at..at + 4] == name).expect("there");
        let at = word(entry + 4) as usize + 8;
        [0, 4, 8].map(|k| f64::from(word(at + k)) / 65536.0)
    }

    /// Against the strict reader, and the numbers that lcms2 sees (`tests/peers/icc_lcms.py`): primaries as XYZ of D50.
    #[test]
    fn strict_readers_take_the_profiles() {
        let lcms: serde_json::Value =
            serde_json::from_str(include_str!("../../../../tests/peers/icc_lcms.json")).expect("JSON");
        for (gamut, name) in [(Gamut::Srgb, "srgb"), (Gamut::DisplayP3, "display-p3")] {
            for linear in [false, true] {
                let profile = gamut.icc(linear).expect("writes");
                strict(&profile).unwrap_or_else(|what| panic!("{gamut:?} {linear}: {what}"));
                assert!(strict(&profile[..profile.len() - 1]).is_err());
                let white = D50.map(|v| f64::from(v) / 65536.0);
                assert_eq!(xyz(&profile, b"wtpt"), white);
                let primaries = [b"rXYZ", b"gXYZ", b"bXYZ"].map(|name| xyz(&profile, name));
                for (k, white) in white.into_iter().enumerate() {
                    let sum: f64 = primaries.iter().map(|p| p[k]).sum();
                    assert!((sum - white).abs() < 2.5 / 65536.0, "{gamut:?}: white {sum} {white}");
                    for (p, colour) in primaries.iter().zip(["red", "green", "blue"]) {
                        let seen = lcms[name][colour][k].as_f64().expect("a number");
                        assert!((p[k] - seen).abs() < 3e-4, "{gamut:?} {colour}: {} {seen}", p[k]);
                    }
                }
            }
        }
        // What the writer gave before: unaligned, of odd length.
        let plain = ColorProfile::new_display_p3().encode().expect("writes");
        assert!(strict(&plain).is_err());
        assert_eq!(aligned(&plain).map(|p| p.len() % 4), Some(0));
        assert!(aligned(&plain[..140]).is_none() && aligned(&plain[..100]).is_none());
    }
}
