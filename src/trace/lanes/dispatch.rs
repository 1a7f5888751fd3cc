//! The kernels compiled for every instruction set, chosen at run time.
#![allow(unsafe_code, reason = "functions compiled for an instruction set; `Level` says that the processor has it")]

use super::adjoint::Back;
use super::forward::{Mode, Run, one_by_one};
use super::program::{Kind, Step};

/// Which code runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Plain numbers, on any processor.
    Portable,
    /// Four lanes: AVX2 with FMA.
    Avx2,
    /// Eight lanes: AVX-512 (F, VL, DQ, BW).
    Avx512,
}

impl Level {
    /// The best this processor runs.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
            if avx2
                && std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512vl")
                && std::arch::is_x86_feature_detected!("avx512dq")
                && std::arch::is_x86_feature_detected!("avx512bw")
            {
                return Self::Avx512;
            }
            if avx2 {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// The best up to `most` that this processor runs.
    pub fn at_most(most: Option<Self>) -> Self {
        most.map_or(Self::detect(), |most| most.min(Self::detect()))
    }

    /// All that this processor runs, plainest first.
    pub fn available() -> impl Iterator<Item = Self> {
        [Self::Portable, Self::Avx2, Self::Avx512].into_iter().filter(|level| *level <= Self::detect())
    }
}

/// One surface, one tile, forward.
///
/// # Safety
/// The processor must have the instruction set it is compiled for; the pointers of [`Run`] must be valid.
pub(super) type Forward = unsafe fn(&Step, &Run);

/// One surface, one tile, back.
///
/// # Safety
/// The processor must have the instruction set it is compiled for; the pointers of [`Back`] must be valid.
pub(super) type Adjoint = unsafe fn(&Step, &Back);

/// Which of some lanes' roots are certain; see [`super::prove`].
///
/// # Safety
/// As [`Forward`].
pub(super) type Prove = unsafe fn(&Step, &Run, usize, u64) -> u64;

/// The kernels for `$lanes`, and the choice among them.
macro_rules! compiled {
    ($name:ident, $forward:ty, $adjoint:ty $(, #[$attribute:meta])?) => {
        mod $name {
            use super::{Adjoint, Back, Forward, Kind, Mode, Prove, Run, Step, one_by_one};
            use crate::trace::lanes::{adjoint, forward, prove};

            $(#[$attribute])?
            unsafe fn plane<M: Mode>(step: &Step, run: &Run) {
                unsafe { forward::plane::<$forward, M>(step, run) }
            }

            $(#[$attribute])?
            unsafe fn conic<M: Mode, const SPHERE: bool>(step: &Step, run: &Run) {
                unsafe { forward::conic::<$forward, M, SPHERE>(step, run) }
            }

            $(#[$attribute])?
            unsafe fn even<M: Mode, const N: usize>(step: &Step, run: &Run) {
                unsafe { forward::even::<$forward, M, N>(step, run) }
            }

            $(#[$attribute])?
            unsafe fn sure<const N: usize>(step: &Step, run: &Run, at: usize, unsure: u64) -> u64 {
                unsafe { prove::prove::<$adjoint, N>(step, run, at, unsure) }
            }

            $(#[$attribute])?
            unsafe fn back<const N: usize>(step: &Step, back: &Back) {
                unsafe { adjoint::surface_vjp::<$adjoint, N>(step, back) }
            }

            pub(super) fn choose_forward<M: Mode>(kind: Kind, terms: usize) -> Forward {
                match (kind, terms) {
                    (Kind::General, _) => one_by_one::<M>,
                    (Kind::Plane, _) => plane::<M>,
                    (Kind::Sphere, _) => conic::<M, true>,
                    (Kind::Conic, _) => conic::<M, false>,
                    (Kind::Even, 0..=2) => even::<M, 2>,
                    (Kind::Even, 3) => even::<M, 3>,
                    (Kind::Even, 4) => even::<M, 4>,
                    (Kind::Even, 5) => even::<M, 5>,
                    (Kind::Even, 6) => even::<M, 6>,
                    (Kind::Even, 7..=8) => even::<M, 8>,
                    (Kind::Even, _) => even::<M, 10>,
                }
            }

            pub(super) fn choose_prove(terms: usize) -> Prove {
                match terms {
                    0..=2 => sure::<2>,
                    3 => sure::<3>,
                    4 => sure::<4>,
                    5 => sure::<5>,
                    6 => sure::<6>,
                    7..=8 => sure::<8>,
                    _ => sure::<10>,
                }
            }

            pub(super) fn choose_adjoint(terms: usize) -> Adjoint {
                match terms {
                    0 => back::<0>,
                    1..=2 => back::<2>,
                    3 => back::<3>,
                    4 => back::<4>,
                    5 => back::<5>,
                    6 => back::<6>,
                    7..=8 => back::<8>,
                    _ => back::<10>,
                }
            }
        }
    };
}

compiled!(
    portable,
    crate::trace::lanes::simd::Times<crate::trace::lanes::simd::Portable, 4>,
    crate::trace::lanes::simd::Times<crate::trace::lanes::simd::Portable, 4>
);
#[cfg(target_arch = "x86_64")]
compiled!(
    avx2,
    crate::trace::lanes::simd::Times<crate::trace::lanes::x86::Avx2, 4>,
    crate::trace::lanes::x86::Avx2,
    #[target_feature(enable = "avx2,fma")]
);
#[cfg(target_arch = "x86_64")]
compiled!(
    avx512,
    crate::trace::lanes::simd::Times<crate::trace::lanes::x86::Avx512, 4>,
    crate::trace::lanes::x86::Avx512,
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
);

/// The code of a surface; the same for `Kind::General` at every level.
pub(super) fn forward<M: Mode>(level: Level, kind: Kind, terms: usize) -> Forward {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => avx512::choose_forward::<M>(kind, terms),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => avx2::choose_forward::<M>(kind, terms),
        _ => portable::choose_forward::<M>(kind, terms),
    }
}

/// The proof of a surface's roots.
pub(super) fn prove(level: Level, terms: usize) -> Prove {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => avx512::choose_prove(terms),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => avx2::choose_prove(terms),
        _ => portable::choose_prove(terms),
    }
}

/// The code of a surface's adjoint.
pub(super) fn adjoint(level: Level, terms: usize) -> Adjoint {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => avx512::choose_adjoint(terms),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => avx2::choose_adjoint(terms),
        _ => portable::choose_adjoint(terms),
    }
}
