//! Vector operations on f64 lanes: one trait, which `x86` implements, plain numbers for any processor, and a type with
//! operators so that the kernels read like their formulas.
//!
//! Everything is `#[inline(always)]` into a function compiled for its processor (`dispatch`).
#![allow(unsafe_code, reason = "processor intrinsics behind a trait; see each Safety note")]

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Vector operations of one instruction set.
///
/// # Safety
/// All methods need a processor with the instruction set, and pointers valid for the lanes they touch.
pub(super) trait Simd: Copy {
    /// One vector.
    type V: Copy;
    /// A truth value per lane.
    type M: Copy;
    /// Values in a vector; divides 64.
    const LANES: usize;
    unsafe fn splat(value: f64) -> Self::V;
    unsafe fn load(from: *const f64) -> Self::V;
    unsafe fn store(to: *mut f64, v: Self::V);
    /// `table[index[i]]` for every lane.
    unsafe fn gather(table: *const f64, index: *const u32) -> Self::V;
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn div(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn sqrt(a: Self::V) -> Self::V;
    /// `a b + c`.
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c − a b`.
    unsafe fn fnma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    unsafe fn abs(a: Self::V) -> Self::V;
    /// The larger lanes.
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V;
    /// `√a` and `1/√a` for `a > 0`, to a unit in the last place or two.
    unsafe fn sqrt_and_inverse(a: Self::V) -> (Self::V, Self::V);
    /// `1/a`, to 11 bits at least: only for what converges anyway; 0 or ∞ beyond the range of f32.
    unsafe fn rough_inverse(a: Self::V) -> Self::V;
    /// `1/√a`, as above.
    unsafe fn rough_inverse_sqrt(a: Self::V) -> Self::V;
    /// `a < b`; false for NaN.
    unsafe fn less(a: Self::V, b: Self::V) -> Self::M;
    /// `a ≤ b`; false for NaN.
    unsafe fn at_most(a: Self::V, b: Self::V) -> Self::M;
    /// `m` and `a < b`.
    unsafe fn and_less(m: Self::M, a: Self::V, b: Self::V) -> Self::M;
    /// `m` and `a ≤ b`.
    unsafe fn and_at_most(m: Self::M, a: Self::V, b: Self::V) -> Self::M;
    /// 0 where `m` is true, `a` elsewhere.
    unsafe fn zero_where(m: Self::M, a: Self::V) -> Self::V;
    /// One bit per lane, the first lowest.
    unsafe fn bits(m: Self::M) -> u64;
}

/// One plain number: any processor.
#[derive(Clone, Copy)]
pub(super) struct Portable;

impl Simd for Portable {
    type V = f64;
    type M = bool;
    const LANES: usize = 1;
    #[inline(always)]
    unsafe fn splat(value: f64) -> f64 {
        value
    }
    #[inline(always)]
    unsafe fn load(from: *const f64) -> f64 {
        unsafe { *from }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f64, v: f64) {
        unsafe { *to = v }
    }
    #[inline(always)]
    unsafe fn gather(table: *const f64, index: *const u32) -> f64 {
        unsafe { *table.add(*index as usize) }
    }
    #[inline(always)]
    unsafe fn add(a: f64, b: f64) -> f64 {
        a + b
    }
    #[inline(always)]
    unsafe fn sub(a: f64, b: f64) -> f64 {
        a - b
    }
    #[inline(always)]
    unsafe fn mul(a: f64, b: f64) -> f64 {
        a * b
    }
    #[inline(always)]
    unsafe fn div(a: f64, b: f64) -> f64 {
        a / b
    }
    #[inline(always)]
    unsafe fn sqrt(a: f64) -> f64 {
        a.sqrt()
    }
    #[inline(always)]
    unsafe fn fma(a: f64, b: f64, c: f64) -> f64 {
        // Not `mul_add`, which is a library call where the processor has no such instruction.
        a * b + c
    }
    #[inline(always)]
    unsafe fn fnma(a: f64, b: f64, c: f64) -> f64 {
        c - a * b
    }
    #[inline(always)]
    unsafe fn abs(a: f64) -> f64 {
        a.abs()
    }
    #[inline(always)]
    unsafe fn max(a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }
    #[inline(always)]
    unsafe fn sqrt_and_inverse(a: f64) -> (f64, f64) {
        let root = a.sqrt();
        (root, 1.0 / root)
    }
    #[inline(always)]
    unsafe fn rough_inverse(a: f64) -> f64 {
        1.0 / a
    }
    #[inline(always)]
    unsafe fn rough_inverse_sqrt(a: f64) -> f64 {
        1.0 / a.sqrt()
    }
    #[inline(always)]
    unsafe fn less(a: f64, b: f64) -> bool {
        a < b
    }
    #[inline(always)]
    unsafe fn at_most(a: f64, b: f64) -> bool {
        a <= b
    }
    #[inline(always)]
    unsafe fn and_less(m: bool, a: f64, b: f64) -> bool {
        m & (a < b)
    }
    #[inline(always)]
    unsafe fn and_at_most(m: bool, a: f64, b: f64) -> bool {
        m & (a <= b)
    }
    #[inline(always)]
    unsafe fn zero_where(m: bool, a: f64) -> f64 {
        if m { 0.0 } else { a }
    }
    #[inline(always)]
    unsafe fn bits(m: bool) -> u64 {
        u64::from(m)
    }
}

/// `U` vectors side by side: independent chains hide the latency of one another.
#[derive(Clone, Copy)]
pub(super) struct Times<S, const U: usize>(S);

macro_rules! side_by_side {
    ($(fn $name:ident($($arg:ident),+) -> $out:ident;)+) => {
        $(
            #[inline(always)]
            unsafe fn $name($($arg: [S::V; U]),+) -> [S::$out; U] {
                let mut i = 0;
                unsafe {
                    let mut out = [S::$name($($arg[0]),+); U];
                    while i + 1 < U {
                        i += 1;
                        out[i] = S::$name($($arg[i]),+);
                    }
                    out
                }
            }
        )+
    };
}

impl<S: Simd, const U: usize> Simd for Times<S, U> {
    type V = [S::V; U];
    type M = [S::M; U];
    const LANES: usize = U * S::LANES;
    #[inline(always)]
    unsafe fn splat(value: f64) -> Self::V {
        unsafe { [S::splat(value); U] }
    }
    #[inline(always)]
    unsafe fn load(from: *const f64) -> Self::V {
        unsafe {
            let mut out = [S::load(from); U];
            for (i, out) in out.iter_mut().enumerate().skip(1) {
                *out = S::load(from.add(i * S::LANES));
            }
            out
        }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f64, v: Self::V) {
        for (i, v) in v.into_iter().enumerate() {
            unsafe { S::store(to.add(i * S::LANES), v) }
        }
    }
    #[inline(always)]
    unsafe fn gather(table: *const f64, index: *const u32) -> Self::V {
        unsafe {
            let mut out = [S::gather(table, index); U];
            for (i, out) in out.iter_mut().enumerate().skip(1) {
                *out = S::gather(table, index.add(i * S::LANES));
            }
            out
        }
    }
    side_by_side! {
        fn add(a, b) -> V;
        fn sub(a, b) -> V;
        fn mul(a, b) -> V;
        fn div(a, b) -> V;
        fn sqrt(a) -> V;
        fn fma(a, b, c) -> V;
        fn fnma(a, b, c) -> V;
        fn abs(a) -> V;
        fn max(a, b) -> V;
        fn rough_inverse(a) -> V;
        fn rough_inverse_sqrt(a) -> V;
        fn less(a, b) -> M;
        fn at_most(a, b) -> M;
    }
    #[inline(always)]
    unsafe fn sqrt_and_inverse(a: Self::V) -> (Self::V, Self::V) {
        let (mut root, mut inverse) = (a, a);
        for i in 0..U {
            (root[i], inverse[i]) = unsafe { S::sqrt_and_inverse(a[i]) };
        }
        (root, inverse)
    }
    #[inline(always)]
    unsafe fn and_less(m: Self::M, a: Self::V, b: Self::V) -> Self::M {
        let mut out = m;
        for i in 0..U {
            out[i] = unsafe { S::and_less(m[i], a[i], b[i]) };
        }
        out
    }
    #[inline(always)]
    unsafe fn and_at_most(m: Self::M, a: Self::V, b: Self::V) -> Self::M {
        let mut out = m;
        for i in 0..U {
            out[i] = unsafe { S::and_at_most(m[i], a[i], b[i]) };
        }
        out
    }
    #[inline(always)]
    unsafe fn zero_where(m: Self::M, a: Self::V) -> Self::V {
        let mut out = a;
        for i in 0..U {
            out[i] = unsafe { S::zero_where(m[i], a[i]) };
        }
        out
    }
    #[inline(always)]
    unsafe fn bits(m: Self::M) -> u64 {
        let mut bits = 0;
        for (i, m) in m.into_iter().enumerate() {
            bits |= unsafe { S::bits(m) } << (i * S::LANES);
        }
        bits
    }
}

/// A vector with operators.
///
/// A value exists only where the processor has the instruction set: [`Lanes::splat`] and [`Lanes::load`], which make
/// the first ones, are unsafe. That is the Safety note of every operator below.
pub(super) struct Lanes<S: Simd>(pub(super) S::V);

impl<S: Simd> Clone for Lanes<S> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: Simd> Copy for Lanes<S> {}

/// Truth values.
pub(super) struct Truth<S: Simd>(S::M);

impl<S: Simd> Truth<S> {
    /// One bit per lane, the first lowest.
    #[inline(always)]
    pub(super) fn bits(self) -> u64 {
        unsafe { S::bits(self.0) }
    }

    /// And `a < b`; false for NaN.
    #[inline(always)]
    pub(super) fn and_less(self, a: Lanes<S>, b: Lanes<S>) -> Self {
        Self(unsafe { S::and_less(self.0, a.0, b.0) })
    }

    /// And `a ≤ b`; false for NaN.
    #[inline(always)]
    pub(super) fn and_at_most(self, a: Lanes<S>, b: Lanes<S>) -> Self {
        Self(unsafe { S::and_at_most(self.0, a.0, b.0) })
    }
}

impl<S: Simd> Lanes<S> {
    /// `value` in every lane.
    ///
    /// # Safety
    /// The processor must have the instruction set of `S`.
    #[inline(always)]
    pub(super) unsafe fn splat(value: f64) -> Self {
        Self(unsafe { S::splat(value) })
    }

    /// The values at `from`.
    ///
    /// # Safety
    /// The processor must have the instruction set of `S`, and the lanes must be readable.
    #[inline(always)]
    pub(super) unsafe fn load(from: *const f64) -> Self {
        Self(unsafe { S::load(from) })
    }

    /// Stores the lanes.
    ///
    /// # Safety
    /// The lanes must be writable.
    #[inline(always)]
    pub(super) unsafe fn store(self, to: *mut f64) {
        unsafe { S::store(to, self.0) }
    }

    /// `self b + c`.
    #[inline(always)]
    pub(super) fn fma(self, b: Self, c: Self) -> Self {
        Self(unsafe { S::fma(self.0, b.0, c.0) })
    }

    /// `c − self b`.
    #[inline(always)]
    pub(super) fn fnma(self, b: Self, c: Self) -> Self {
        Self(unsafe { S::fnma(self.0, b.0, c.0) })
    }

    /// `√`.
    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        Self(unsafe { S::sqrt(self.0) })
    }

    /// See [`Simd::sqrt_and_inverse`].
    #[inline(always)]
    pub(super) fn sqrt_and_inverse(self) -> (Self, Self) {
        let (root, inverse) = unsafe { S::sqrt_and_inverse(self.0) };
        (Self(root), Self(inverse))
    }

    /// See [`Simd::rough_inverse`].
    #[inline(always)]
    pub(super) fn rough_inverse(self) -> Self {
        Self(unsafe { S::rough_inverse(self.0) })
    }

    /// See [`Simd::rough_inverse_sqrt`].
    #[inline(always)]
    pub(super) fn rough_inverse_sqrt(self) -> Self {
        Self(unsafe { S::rough_inverse_sqrt(self.0) })
    }

    /// `|self|`.
    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        Self(unsafe { S::abs(self.0) })
    }

    /// The larger lanes.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        Self(unsafe { S::max(self.0, other.0) })
    }

    /// `self < other`; false for NaN.
    #[inline(always)]
    pub(super) fn less(self, other: Self) -> Truth<S> {
        Truth(unsafe { S::less(self.0, other.0) })
    }

    /// `self ≤ other`; false for NaN.
    #[inline(always)]
    pub(super) fn at_most(self, other: Self) -> Truth<S> {
        Truth(unsafe { S::at_most(self.0, other.0) })
    }

    /// 0 where `truth` holds.
    #[inline(always)]
    pub(super) fn zero_where(self, truth: Truth<S>) -> Self {
        Self(unsafe { S::zero_where(truth.0, self.0) })
    }
}

impl<S: Simd> Clone for Truth<S> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: Simd> Copy for Truth<S> {}

macro_rules! operators {
    ($($trait:ident, $name:ident;)+) => {
        $(
            impl<S: Simd> $trait for Lanes<S> {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self(unsafe { S::$name(self.0, other.0) })
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

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(unsafe { S::sub(S::splat(0.0), self.0) })
    }
}
