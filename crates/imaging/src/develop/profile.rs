//! What a picture's file says of its numbers: the curve from numbers to light, and the colours of that light. The other way round is [`super::gamut`].
//!
//! ICC profiles of curves and a matrix (ICC.1:2022, annex F.3) are read, grey ones too; those that are tables of colours say nothing here.

use std::sync::Arc;

use moxcms::{ColorProfile, DataColorSpace, ToneReprCurve};

use super::color::{inverse, linear_from_srgb, product};
use super::gamut::Gamut;

/// From numbers to light, both from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Curve {
    /// sRGB (IEC 61966-2-1).
    Srgb,
    /// Proportional to light.
    Linear,
    /// Another, of each channel, at all numbers of 16 bits.
    Own(Arc<[Vec<f64>; 3]>),
}

/// Numbers of 16 bits.
const NUMBERS: usize = 1 << 16;
/// Numbers at which two curves are compared.
const COMPARED: usize = 1024;
/// How far two curves that are one may lie apart: profiles have their numbers in 65536ths.
const ALIKE: f64 = 1e-4;
/// How far the parts of two matrices that are one may lie apart.
const ALIKE_COLOURS: f64 = 2e-3;

impl Curve {
    /// The curve that the function of a channel and a number is.
    fn of(light: impl Fn(usize, f64) -> f64) -> Self {
        let alike = |known: fn(f64) -> f64| {
            let numbers = (0..=COMPARED).map(|k| k as f64 / COMPARED as f64);
            (0..3).all(|channel| numbers.clone().all(|v| (light(channel, v) - known(v)).abs() < ALIKE))
        };
        if alike(|v| v) {
            return Self::Linear;
        }
        if alike(linear_from_srgb) {
            return Self::Srgb;
        }
        let table = |channel| (0..NUMBERS).map(|k| light(channel, k as f64 / (NUMBERS - 1) as f64)).collect();
        Self::Own(Arc::new([table(0), table(1), table(2)]))
    }

    /// Whether all of its light is a number, no farther off than any light: a damaged profile may have powers that have none.
    fn is_light(&self) -> bool {
        const MOST: f64 = 1e6;
        match self {
            Self::Own(tables) => tables.iter().flatten().all(|v| v.abs() <= MOST),
            Self::Srgb | Self::Linear => true,
        }
    }

    /// A power of the number.
    pub(crate) fn power(exponent: f64) -> Self {
        Self::of(|_, v| v.powf(exponent))
    }

    /// That of ITU-R BT.709, which BT.601 and BT.2020 have too.
    pub(crate) fn bt709() -> Self {
        Self::of(|_, v| {
            if v < 4.5 * 0.018_053_968_51 {
                v / 4.5
            } else {
                ((v + 0.099_296_826_81) / 1.099_296_826_81).powf(1.0 / 0.45)
            }
        })
    }

    /// The light of a number of a channel.
    pub(crate) fn light(&self, channel: usize, number: f64) -> f64 {
        match self {
            Self::Srgb => linear_from_srgb(number),
            Self::Linear => number,
            Self::Own(tables) => {
                let (table, place) = (&tables[channel.min(2)], number.clamp(0.0, 1.0) * (NUMBERS - 1) as f64);
                let (below, share) = (place.floor() as usize, place.fract());
                let above = table[(below + 1).min(NUMBERS - 1)];
                if share == 0.0 { table[below] } else { (1.0 - share) * table[below] + share * above }
            }
        }
    }
}

/// What a file says.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Told {
    /// From numbers to light.
    pub curve: Curve,
    /// From that light to linear sRGB; none where it is that already.
    pub to_srgb: Option<[[f64; 3]; 3]>,
}

impl From<Curve> for Told {
    fn from(curve: Curve) -> Self {
        Self { curve, to_srgb: None }
    }
}

impl Told {
    /// Numbers of `curve` that stand for colours of `gamut`.
    pub(crate) fn of(gamut: Gamut, curve: Curve) -> Self {
        let to_srgb = if gamut == Gamut::Srgb { None } else { inverse(&gamut.from_srgb()) };
        Self { curve, to_srgb }
    }

    /// What an ICC profile says; `None`: it is none, or one without curves, or with curves that are none.
    pub(crate) fn by_icc(profile: &[u8]) -> Option<Self> {
        Self::read(profile).filter(|told| told.curve.is_light())
    }

    fn read(profile: &[u8]) -> Option<Self> {
        let profile = ColorProfile::new_from_slice(profile).ok()?;
        let light = |curve: &Option<ToneReprCurve>| curve.as_ref()?.make_linear_evaluator().ok();
        match profile.color_space {
            DataColorSpace::Gray => {
                let grey = light(&profile.gray_trc)?;
                Some(Curve::of(|_, v| f64::from(grey.evaluate_value(v as f32))).into())
            }
            DataColorSpace::Rgb => {
                let curves = [light(&profile.red_trc)?, light(&profile.green_trc)?, light(&profile.blue_trc)?];
                let curve = Curve::of(|channel, v| f64::from(curves[channel].evaluate_value(v as f32)));
                Some(Self { curve, to_srgb: to_srgb(profile.colorant_matrix().v) })
            }
            _ => None,
        }
    }
}

/// From light of these primaries (XYZ of D50, one a column) to linear sRGB; none where they are its own, or none.
fn to_srgb(primaries: [[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let matrix = product(&inverse(&Gamut::Srgb.primaries())?, &primaries);
    let apart = |r: usize, c: usize| (matrix[r][c] - f64::from(u8::from(r == c))).abs();
    let own = (0..3).all(|r| (0..3).all(|c| apart(r, c) < ALIKE_COLOURS));
    let usable = matrix.iter().flatten().all(|v| v.is_finite()) && inverse(&primaries).is_some();
    (usable && !own).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What our own profiles say is what was written by them, to the bit.
    #[test]
    fn our_profiles_are_read() {
        for (gamut, linear) in [Gamut::Srgb, Gamut::DisplayP3].into_iter().flat_map(|g| [(g, false), (g, true)]) {
            let told = Told::by_icc(&gamut.icc(linear).expect("writes")).expect("reads");
            assert_eq!(told.curve, if linear { Curve::Linear } else { Curve::Srgb }, "{gamut:?}");
            match (gamut, told.to_srgb) {
                (Gamut::Srgb, None) => {}
                (Gamut::DisplayP3, Some(back)) => {
                    let both = product(&gamut.from_srgb(), &back);
                    for (r, row) in both.iter().enumerate() {
                        for (c, v) in row.iter().enumerate() {
                            assert!((v - f64::from(u8::from(r == c))).abs() < 1e-3, "{both:?}");
                        }
                    }
                }
                other => panic!("{other:?}"),
            }
        }
    }

    /// A curve whose power overflows is none: the profile says nothing then.
    #[test]
    fn curves_without_light_are_none() {
        let mut broken = ColorProfile::new_adobe_rgb();
        broken.cicp = None;
        // (a v + b) to a power that overflows within the numbers.
        let curve = Some(ToneReprCurve::Parametric(vec![30000.0, 30000.0, 1.0, 0.0, 0.0]));
        (broken.red_trc, broken.green_trc, broken.blue_trc) = (curve.clone(), curve.clone(), curve);
        let written = broken.encode().expect("writes");
        assert!(Told::read(&written).is_none_or(|told| !told.curve.is_light()));
        assert!(Told::by_icc(&written).is_none());
    }

    /// Adobe RGB (1998) has a power of 563/256; Rec. 709 and powers go through their own points.
    #[test]
    fn other_curves_are_their_own() {
        let mut adobe = ColorProfile::new_adobe_rgb();
        adobe.cicp = None;
        let told = Told::by_icc(&adobe.encode().expect("writes")).expect("reads");
        for v in [0.0, 0.1, 0.5, 0.73, 1.0f64] {
            let found = told.curve.light(1, v);
            assert!((found - v.powf(563.0 / 256.0)).abs() < 2e-4, "{v}: {found}");
        }
        assert!(told.to_srgb.is_some());
        assert_eq!((Curve::power(1.0), Curve::power(2.2).light(2, 1.0)), (Curve::Linear, 1.0));
        assert!((Curve::power(2.2).light(0, 0.123_456_7) - 0.123_456_7f64.powf(2.2)).abs() < 1e-9);
        // BT.709-6: V = 1.099 L^0.45 - 0.099.
        assert!((Curve::bt709().light(0, 1.099 * 0.18f64.powf(0.45) - 0.099) - 0.18).abs() < 2e-4);
        assert!((Curve::bt709().light(0, 0.045) - 0.01).abs() < 1e-6);
        for bytes in [&b""[..], b"no profile", &[0; 200]] {
            assert_eq!(Told::by_icc(bytes), None);
        }
    }
}
