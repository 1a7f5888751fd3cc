//! Which instruction set runs.

use std::sync::OnceLock;

use super::plain::Plain;
use super::{Kernel, Simd};
use crate::error::{Error, Result};

/// The environment variable that names the best instruction set to use: `plain`, `avx2` or `avx512`.
const VARIABLE: &str = "ISOPLANAT_SIMD";

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Plain numbers, on any processor.
    Plain,
    /// Vectors of 256 bits: AVX2 with FMA.
    Avx2,
    /// Vectors of 512 bits: AVX-512 (F, VL, DQ, BW).
    Avx512,
}

impl Level {
    const ALL: [Self; 3] = [Self::Plain, Self::Avx2, Self::Avx512];

    /// The best that this processor runs, and at most what the environment variable `ISOPLANAT_SIMD` names.
    ///
    /// The variable is read once; see [`check_environment`] for what it may say.
    pub fn detect() -> Self {
        static BEST: OnceLock<Level> = OnceLock::new();
        *BEST.get_or_init(|| named().ok().flatten().map_or(Self::of_processor(), |most| most.min(Self::of_processor())))
    }

    fn of_processor() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx2 = has!("avx2") && has!("fma");
            if avx2 && has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw") {
                return Self::Avx512;
            }
            if avx2 {
                return Self::Avx2;
            }
        }
        Self::Plain
    }

    /// The best up to `most` that this processor runs.
    pub fn at_most(most: Option<Self>) -> Self {
        most.map_or(Self::detect(), |most| most.min(Self::detect()))
    }

    /// All that this processor runs, plainest first.
    pub fn available() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|level| *level <= Self::detect())
    }

    /// Runs `kernel` on this instruction set, or on the best that this processor runs where that is less.
    #[doc(hidden)]
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        match self.min(Self::detect()) {
            Self::Plain => Plain.run(kernel),
            Self::Avx2 => super::avx2::Avx2::detected().run(kernel),
            Self::Avx512 => super::avx512::Avx512::detected().run(kernel),
        }
        #[cfg(not(target_arch = "x86_64"))]
        Plain.run(kernel)
    }
}

/// What the environment names.
fn named() -> Result<Option<Level>> {
    let set = std::env::var_os(VARIABLE).filter(|text| !text.is_empty());
    set.map_or(Ok(None), |text| parse(&text.to_string_lossy()).map(Some))
}

fn parse(text: &str) -> Result<Level> {
    match text {
        "plain" => Ok(Level::Plain),
        "avx2" => Ok(Level::Avx2),
        "avx512" => Ok(Level::Avx512),
        _ => Err(Error::bad("environment", VARIABLE, format!("`{text}`"), "`plain`, `avx2` or `avx512`")),
    }
}

/// Whether `ISOPLANAT_SIMD` is unset, empty, or names an instruction set; [`Level::detect`] takes no notice of anything else.
///
/// # Errors
/// It says something else.
pub fn check_environment() -> Result<()> {
    named().map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variable_names_an_instruction_set() {
        let found = ["plain", "avx2", "avx512"].map(|text| parse(text).expect("known"));
        assert_eq!(found, Level::ALL);
        let message = parse("AVX").expect_err("unknown").to_string();
        assert_eq!(message, "environment: ISOPLANAT_SIMD: `AVX`; `plain`, `avx2` or `avx512`");
    }
}
