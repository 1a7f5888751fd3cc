//! f64 vectors with operators, so that the kernels read like their formulas.

use std::ops::{Add, Div, Mul, Neg, Sub};

use isoplanat_base::math::simd::F64;

/// A vector: its values, and the token of the instruction set that computes with them.
#[derive(Clone, Copy)]
pub(super) struct Lanes<S: F64>(S::V, S);

/// Truth values.
#[derive(Clone, Copy)]
pub(super) struct Truth<S: F64>(S::M, S);

impl<S: F64> Truth<S> {
    /// One bit per lane, the first lowest.
    #[inline(always)]
    pub(super) fn bits(self) -> u64 {
        self.1.bits(self.0)
    }

    /// And `a < b`; false for NaN.
    #[inline(always)]
    pub(super) fn and_less(self, a: Lanes<S>, b: Lanes<S>) -> Self {
        Self(self.1.and_less(self.0, a.0, b.0), self.1)
    }

    /// And `a ≤ b`; false for NaN.
    #[inline(always)]
    pub(super) fn and_at_most(self, a: Lanes<S>, b: Lanes<S>) -> Self {
        Self(self.1.and_at_most(self.0, a.0, b.0), self.1)
    }
}

/// Vector number `at` of arrays, and constants beside it.
///
/// Methods, not closures: those are inlined only where the compiler thinks it worth while, and elsewhere they are functions
/// without the instruction set.
#[derive(Clone, Copy)]
pub(super) struct At<S> {
    pub(super) simd: S,
    pub(super) at: usize,
}

impl<S: F64> At<S> {
    /// `value` in every lane.
    #[inline(always)]
    pub(super) fn splat(self, value: f64) -> Lanes<S> {
        Lanes(self.simd.splat(value), self.simd)
    }

    /// The vector of `values`.
    ///
    /// # Panics
    /// If there is none.
    #[inline(always)]
    pub(super) fn load(self, values: &[f64]) -> Lanes<S> {
        Lanes(self.simd.load(&self.simd.cut(values)[self.at]), self.simd)
    }

    /// Stores `v` as the vector of `values`.
    ///
    /// # Panics
    /// If there is none.
    #[inline(always)]
    pub(super) fn store(self, v: Lanes<S>, values: &mut [f64]) {
        self.simd.store(&mut self.simd.cut_mut(values)[self.at], v.0);
    }

    /// `table[index[i]]` for every lane; see [`F64::gather`].
    #[inline(always)]
    pub(super) fn gather(self, table: &[f64], index: &[u32]) -> Lanes<S> {
        Lanes(self.simd.gather(table, index), self.simd)
    }
}

impl<S: F64> Lanes<S> {
    /// `self b + c`.
    #[inline(always)]
    pub(super) fn fma(self, b: Self, c: Self) -> Self {
        Self(self.1.fma(self.0, b.0, c.0), self.1)
    }

    /// `c − self b`.
    #[inline(always)]
    pub(super) fn fnma(self, b: Self, c: Self) -> Self {
        Self(self.1.fnma(self.0, b.0, c.0), self.1)
    }

    /// `√`.
    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        Self(self.1.sqrt(self.0), self.1)
    }

    /// See [`F64::sqrt_and_inverse`].
    #[inline(always)]
    pub(super) fn sqrt_and_inverse(self) -> (Self, Self) {
        let (root, inverse) = self.1.sqrt_and_inverse(self.0);
        (Self(root, self.1), Self(inverse, self.1))
    }

    /// See [`F64::rough_inverse`].
    #[inline(always)]
    pub(super) fn rough_inverse(self) -> Self {
        Self(self.1.rough_inverse(self.0), self.1)
    }

    /// See [`F64::rough_inverse_sqrt`].
    #[inline(always)]
    pub(super) fn rough_inverse_sqrt(self) -> Self {
        Self(self.1.rough_inverse_sqrt(self.0), self.1)
    }

    /// `|self|`.
    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        Self(self.1.abs(self.0), self.1)
    }

    /// The larger lanes; those of `other` where one is NaN.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        Self(self.1.max(self.0, other.0), self.1)
    }

    /// `self < other`; false for NaN.
    #[inline(always)]
    pub(super) fn less(self, other: Self) -> Truth<S> {
        Truth(self.1.less(self.0, other.0), self.1)
    }

    /// `self ≤ other`; false for NaN.
    #[inline(always)]
    pub(super) fn at_most(self, other: Self) -> Truth<S> {
        Truth(self.1.at_most(self.0, other.0), self.1)
    }

    /// 0 where `truth` holds.
    #[inline(always)]
    pub(super) fn zero_where(self, truth: Truth<S>) -> Self {
        Self(self.1.zero_where(truth.0, self.0), self.1)
    }
}

macro_rules! operators {
    ($($trait:ident, $name:ident;)+) => {
        $(
            impl<S: F64> $trait for Lanes<S> {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self(self.1.$name(self.0, other.0), self.1)
                }
            }
        )+
    };
}

operators! {
    Add, add;
    Sub, sub;
    Mul, mul;
    Div, div;
}

impl<S: F64> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.1.sub(self.1.splat(0.0), self.0), self.1)
    }
}
