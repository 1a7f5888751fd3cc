//! Spectral power of the light on a scene: equal energy, black bodies, daylight.

use isoplanat_base::error::{Error, Result};

/// The light on a scene, or of a light source seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Illuminant {
    /// The same power at every wavelength (CIE illuminant E).
    #[default]
    EqualEnergy,
    /// A black body (Planck's law, second radiation constant of the SI, 1.438776877e-2 m K).
    BlackBody {
        /// Temperature, K.
        kelvin: f64,
    },
    /// CIE illuminant A: Planck's law at 2848 K with the radiation constant of its definition, 1.435e-2 m K (CIE 15);
    /// on the constant of today 2855.5 K.
    A,
    /// Daylight by the CIE's three components (CIE 15; Judd, MacAdam and Wyszecki 1964).
    Daylight {
        /// Correlated colour temperature, 4000 to 25000 K. D65 is 6504 K.
        kelvin: f64,
    },
}

/// What names of lights may be.
const NAMES: &str =
    "E (equal energy), A, D50, D55, D65, D75, daylight:KELVIN from 4000 to 25000, black-body:KELVIN from 100 to 1e9";

/// By its name, as command lines have it.
impl std::str::FromStr for Illuminant {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let bad = || Error::bad("", "", name, NAMES);
        let light = match (name, name.split_once(':')) {
            ("E", _) => Self::EqualEnergy,
            ("A", _) => Self::A,
            // CIE 15: the nominal temperatures on the radiation constant of today.
            ("D50", _) => Self::Daylight { kelvin: 5003.0 },
            ("D55", _) => Self::Daylight { kelvin: 5503.0 },
            ("D65", _) => Self::Daylight { kelvin: 6504.0 },
            ("D75", _) => Self::Daylight { kelvin: 7504.0 },
            (_, Some((kind, kelvin))) => {
                let kelvin = kelvin.parse().map_err(|_| bad())?;
                match kind {
                    "daylight" => Self::Daylight { kelvin },
                    "black-body" => Self::BlackBody { kelvin },
                    _ => return Err(bad()),
                }
            }
            _ => return Err(bad()),
        };
        light.check("temperature").map_err(|_| bad())?;
        Ok(light)
    }
}

/// Second radiation constant, nm K.
const C2: f64 = 1.438_776_877e7;

impl Illuminant {
    /// Refuses temperatures that have no meaning; `place` names where it stands.
    pub(crate) fn check(self, place: &str) -> Result<()> {
        let refuse = |kelvin: f64, ok: bool, allowed: &str| {
            if ok { Ok(()) } else { Err(Error::bad("illuminant", place, format!("{kelvin} K"), allowed)) }
        };
        match self {
            Self::EqualEnergy | Self::A => Ok(()),
            // Colder, no light is left in f64 at 400 nm.
            Self::BlackBody { kelvin } => refuse(kelvin, (100.0..=1e9).contains(&kelvin), "100 to 1e9 K"),
            Self::Daylight { kelvin } => refuse(kelvin, (4000.0..=25_000.0).contains(&kelvin), "4000 to 25000 K"),
        }
    }

    /// Power per wavelength at `nm`, relative to that at 560 nm. Daylight is 0 outside its table, 300 to 830 nm.
    ///
    /// Not finite or not positive where [`Self::check`] refuses the temperature.
    pub(crate) fn relative_power(self, nm: f64) -> f64 {
        match self {
            Self::EqualEnergy => 1.0,
            Self::BlackBody { kelvin } => planck(nm, C2 / kelvin),
            Self::A => planck(nm, 1.435e7 / 2848.0),
            Self::Daylight { kelvin } => daylight(nm, kelvin),
        }
    }
}

/// Planck's law relative to 560 nm; `scale` is `c₂/T`, nm.
fn planck(nm: f64, scale: f64) -> f64 {
    // exp(a)/exp(b) by its difference, so that cold bodies do not overflow.
    let (a, b) = (scale / 560.0, scale / nm);
    (560.0 / nm).powi(5) * (a - b).exp() * (-(-a).exp_m1()) / (-(-b).exp_m1())
}

/// First wavelength of [`DAYLIGHT`], nm; its entries are 10 nm apart.
const FIRST_NM: f64 = 300.0;

/// Components S₀, S₁, S₂ of daylight, 300 to 830 nm every 10 nm (CIE 15, table T.2).
#[rustfmt::skip]
const DAYLIGHT: [[f64; 3]; 54] = [
    [0.04, 0.02, 0.0], [6.0, 4.5, 2.0], [29.6, 22.4, 4.0], [55.3, 42.0, 8.5], [57.3, 40.6, 7.8],
    [61.8, 41.6, 6.7], [61.5, 38.0, 5.3], [68.8, 42.4, 6.1], [63.4, 38.5, 3.0], [65.8, 35.0, 1.2],
    [94.8, 43.4, -1.1], [104.8, 46.3, -0.5], [105.9, 43.9, -0.7], [96.8, 37.1, -1.2], [113.9, 36.7, -2.6],
    [125.6, 35.9, -2.9], [125.5, 32.6, -2.8], [121.3, 27.9, -2.6], [121.3, 24.3, -2.6], [113.5, 20.1, -1.8],
    [113.1, 16.2, -1.5], [110.8, 13.2, -1.3], [106.5, 8.6, -1.2], [108.8, 6.1, -1.0], [105.3, 4.2, -0.5],
    [104.4, 1.9, -0.3], [100.0, 0.0, 0.0], [96.0, -1.6, 0.2], [95.1, -3.5, 0.5], [89.1, -3.5, 2.1],
    [90.5, -5.8, 3.2], [90.3, -7.2, 4.1], [88.4, -8.6, 4.7], [84.0, -9.5, 5.1], [85.1, -10.9, 6.7],
    [81.9, -10.7, 7.3], [82.6, -12.0, 8.6], [84.9, -14.0, 9.8], [81.3, -13.6, 10.2], [71.9, -12.0, 8.3],
    [74.3, -13.3, 9.6], [76.4, -12.9, 8.5], [63.3, -10.6, 7.0], [71.7, -11.6, 7.6], [77.0, -12.2, 8.0],
    [65.2, -10.2, 6.7], [47.7, -7.8, 5.2], [68.6, -11.2, 7.4], [65.0, -10.4, 6.8], [66.0, -10.6, 7.0],
    [61.0, -9.7, 6.4], [53.3, -8.3, 5.5], [58.9, -9.3, 6.1], [61.9, -9.8, 6.5],
];

/// Daylight relative to 560 nm, linear between the table's entries.
fn daylight(nm: f64, kelvin: f64) -> f64 {
    let t = 1e3 / kelvin;
    // The locus of daylight: x over T, y over x.
    let x = if kelvin <= 7000.0 {
        0.244_063 + t * (0.099_11 + t * (2.9678 - t * 4.6070))
    } else {
        0.237_040 + t * (0.247_48 + t * (1.9018 - t * 2.0064))
    };
    let y = -0.275 + x * (2.870 - 3.0 * x);
    let m = 0.0241 + 0.2562 * x - 0.7341 * y;
    let weights = [1.0, (-1.3515 - 1.7703 * x + 5.9114 * y) / m, (0.03 - 31.4424 * x + 30.0717 * y) / m];
    let at = |i: usize| DAYLIGHT[i].iter().zip(weights).map(|(s, w)| s * w).sum::<f64>();
    let place = (nm - FIRST_NM) / 10.0;
    #[expect(clippy::cast_precision_loss, reason = "a short table")]
    let last = (DAYLIGHT.len() - 1) as f64;
    if !(0.0..=last).contains(&place) {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the table")]
    let i = (place as usize).min(DAYLIGHT.len() - 2);
    #[expect(clippy::cast_precision_loss, reason = "a short table")]
    let rest = place - i as f64;
    // At 560 nm the components are 100, 0, 0.
    ((1.0 - rest) * at(i) + rest * at(i + 1)).max(0.0) / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    /// The published table of illuminant A (ISO 11664-2), six digits.
    #[test]
    fn illuminant_a_agrees_with_its_table() {
        let table = [(400.0, 14.7080), (450.0, 33.0859), (500.0, 59.8611), (560.0, 100.0), (600.0, 129.043)];
        for (nm, value) in table.into_iter().chain([(700.0, 198.261)]) {
            assert_rel(100.0 * Illuminant::A.relative_power(nm), value, 5e-6, 0.0, "illuminant A");
            let today = Illuminant::BlackBody { kelvin: 2848.0 * C2 / 1.435e7 };
            assert_rel(100.0 * today.relative_power(nm), value, 5e-6, 0.0, "the same black body");
        }
    }

    /// Wien's displacement law, and the two limits of Planck's.
    #[test]
    fn black_bodies_have_their_maximum_and_limits() {
        for kelvin in [3000.0, 5778.0, 1e4] {
            let peak = 2.897_771_955e6 / kelvin;
            let at = |nm: f64| Illuminant::BlackBody { kelvin }.relative_power(nm);
            assert!(at(peak) > at(0.999 * peak) && at(peak) > at(1.001 * peak), "{kelvin}");
        }
        // Hot: λ⁻⁴. Cold: finite.
        let hot = Illuminant::BlackBody { kelvin: 1e9 };
        assert_rel(hot.relative_power(400.0), (560.0f64 / 400.0).powi(4), 1e-4, 0.0, "Rayleigh-Jeans");
        let cold = Illuminant::BlackBody { kelvin: 100.0 };
        assert!((380..=780).all(|nm| cold.relative_power(f64::from(nm)).is_finite()));
    }

    /// The published table of D65, from another source than the components: 31 values from 2 weights.
    #[test]
    fn daylight_agrees_with_the_table_of_d65() {
        let table = [
            82.7549, 91.4860, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811, 109.354, 107.802,
            104.790, 107.689, 104.405, 104.046, 100.000, 96.3342, 95.7880, 88.6856, 90.0062, 89.5991, 87.6987, 83.2886,
            83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091,
        ];
        let d65 = Illuminant::Daylight { kelvin: 6504.0 };
        for (i, value) in (0u32..).zip(table) {
            let nm = 400.0 + 10.0 * f64::from(i);
            assert_abs(100.0 * d65.relative_power(nm), value, 0.03, &format!("D65 at {nm}"));
        }
        assert_eq!((d65.relative_power(299.0), d65.relative_power(831.0)), (0.0, 0.0));
        // The two pieces of the locus meet.
        let at = |kelvin: f64| Illuminant::Daylight { kelvin }.relative_power(450.0);
        assert_abs(at(7000.0), at(7000.001), 2e-3, "7000 K");
    }

    #[test]
    fn lights_have_names() {
        for (name, light) in [
            ("E", Illuminant::EqualEnergy),
            ("A", Illuminant::A),
            ("D65", Illuminant::Daylight { kelvin: 6504.0 }),
            ("daylight:5200", Illuminant::Daylight { kelvin: 5200.0 }),
            ("black-body:2856", Illuminant::BlackBody { kelvin: 2856.0 }),
        ] {
            assert_eq!(name.parse::<Illuminant>().expect(name), light);
        }
        for name in
            ["", "d65", "D60", "daylight", "daylight:", "daylight:3000", "black-body:nan", "black-body:0", "lamp:3000"]
        {
            let error = name.parse::<Illuminant>().expect_err(name).to_string();
            assert!(error.contains(name) && error.contains("daylight:KELVIN"), "{error}");
        }
    }

    #[test]
    fn temperatures_without_meaning_are_refused() {
        for kelvin in [0.0, -5.0, f64::NAN, f64::INFINITY, 99.0] {
            assert!(Illuminant::BlackBody { kelvin }.check("light").is_err());
            assert!(Illuminant::Daylight { kelvin }.check("light").is_err());
        }
        assert!(Illuminant::Daylight { kelvin: 3999.0 }.check("light").is_err());
        assert!(Illuminant::Daylight { kelvin: 6504.0 }.check("light").is_ok());
        assert!(Illuminant::A.check("light").is_ok() && Illuminant::EqualEnergy.check("light").is_ok());
    }
}
