//! The processor's vectors behind safe functions.
//!
//! `Level::run` runs a `Kernel` compiled for an instruction set and hands it a token, whose methods are the vector
//! operations: `F32` on the token itself, `F64` on the two that it gives. A token exists only where the processor has
//! its instructions, and values are read and written through slices and arrays, so kernels need no unsafe code; what is
//! left of it stands in `avx2`, `avx512` and `hint`.
//!
//! Public for the kernels of this project's crates, and hidden: not an interface for others.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod hint;
mod level;
mod plain;
mod times;

#[doc(hidden)]
pub use hint::fresh;
pub use hint::prefetch;
pub use level::{Level, check_environment};

/// Work compiled for every instruction set.
#[doc(hidden)]
pub trait Kernel {
    /// What the work gives.
    type Output;
    /// Does the work. Implementations, and all that they call and is not a `Simd::run`, must be `#[inline(always)]`: only
    /// then are they compiled for the instruction set.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// An instruction set that this processor has.
#[doc(hidden)]
pub trait Simd: F32 {
    /// f64 vectors as they are.
    type Doubles: F64;
    /// Several f64 vectors side by side: independent chains hide the latency of one another.
    type Wide: F64;
    fn doubles(self) -> Self::Doubles;
    fn wide(self) -> Self::Wide;
    /// Runs `kernel` as a function of its own, compiled for this instruction set. Inner loops that are inlined into the
    /// loops around them get registers too few.
    fn run<K: Kernel>(self, kernel: K) -> K::Output;
}

/// Vectors of f32.
#[doc(hidden)]
pub trait F32: Copy {
    /// One vector.
    type V: Copy;
    /// Its values in memory.
    type Array;
    /// Values in a vector; divides 16.
    const LANES: usize;
    /// Most vectors × 3 that registers hold as sums.
    const BLOCK: usize;
    /// Whole vectors of `values`, and the rest.
    fn cut(self, values: &[f32]) -> (&[Self::Array], &[f32]);
    /// As `cut`, to be written.
    fn cut_mut(self, values: &mut [f32]) -> (&mut [Self::Array], &mut [f32]);
    fn splat(self, value: f32) -> Self::V;
    fn load(self, from: &Self::Array) -> Self::V;
    fn store(self, to: &mut Self::Array, v: Self::V);
    /// The first values of `from`, all or a vector; zero in lanes beyond.
    fn load_first(self, from: &[f32]) -> Self::V;
    /// Stores the first lanes: as many as `to` takes.
    fn store_first(self, to: &mut [f32], v: Self::V);
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Largest of the lanes and 0; NaN stays.
    fn above_zero(self, a: Self::V) -> Self::V;
    /// Smallest of the lanes and 0; NaN stays.
    fn below_zero(self, a: Self::V) -> Self::V;
    /// `a` where `sign` is ≥ 0, `b` elsewhere.
    fn choose(self, sign: Self::V, a: Self::V, b: Self::V) -> Self::V;
    /// The larger lanes; NaN where one of them is.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `x` where `a` equals `b` or is NaN, `y` elsewhere.
    fn where_same(self, a: Self::V, b: Self::V, x: Self::V, y: Self::V) -> Self::V;
    /// The even and the odd lanes of `a` followed by `b`.
    fn unzip(self, a: Self::V, b: Self::V) -> (Self::V, Self::V);
    /// The inverse of `unzip`.
    fn zip(self, even: Self::V, odd: Self::V) -> (Self::V, Self::V);
    /// Sum of the lanes, in a fixed order.
    fn sum(self, a: Self::V) -> f32;

    /// A vector from `from[at]` on.
    ///
    /// # Panics
    /// Where there are fewer values.
    #[inline(always)]
    fn load_at(self, from: &[f32], at: usize) -> Self::V {
        self.load(&self.cut(&from[at..][..Self::LANES]).0[0])
    }

    /// Stores a vector from `to[at]` on.
    ///
    /// # Panics
    /// Where there are fewer values.
    #[inline(always)]
    fn store_at(self, to: &mut [f32], at: usize, v: Self::V) {
        self.store(&mut self.cut_mut(&mut to[at..][..Self::LANES]).0[0], v);
    }
}

/// Vectors of f64.
#[doc(hidden)]
pub trait F64: Copy {
    /// One vector.
    type V: Copy;
    /// A truth value per lane.
    type M: Copy;
    /// Its values in memory.
    type Array;
    /// Values in a vector; divides 64.
    const LANES: usize;
    /// Whole vectors of `values`; the rest is left out.
    fn cut(self, values: &[f64]) -> &[Self::Array];
    /// As `cut`, to be written.
    fn cut_mut(self, values: &mut [f64]) -> &mut [Self::Array];
    fn splat(self, value: f64) -> Self::V;
    fn load(self, from: &Self::Array) -> Self::V;
    fn store(self, to: &mut Self::Array, v: Self::V);
    /// `table[index[i]]` for every lane; an index beyond the table takes its last value.
    ///
    /// # Panics
    /// Where `index` holds less than a vector or `table` nothing.
    fn gather(self, table: &[f64], index: &[u32]) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    fn sqrt(self, a: Self::V) -> Self::V;
    /// `a b + c`.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c − a b`.
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    fn abs(self, a: Self::V) -> Self::V;
    /// The larger lanes; those of `b` where one is NaN.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `√a` and `1/√a` for `a > 0`, to a unit in the last place or two.
    fn sqrt_and_inverse(self, a: Self::V) -> (Self::V, Self::V);
    /// `1/a`, to 11 bits at least: only for what converges anyway; 0 or ∞ beyond the range of f32.
    fn rough_inverse(self, a: Self::V) -> Self::V;
    /// `1/√a`, as above.
    fn rough_inverse_sqrt(self, a: Self::V) -> Self::V;
    /// `a < b`; false for NaN.
    fn less(self, a: Self::V, b: Self::V) -> Self::M;
    /// `a ≤ b`; false for NaN.
    fn at_most(self, a: Self::V, b: Self::V) -> Self::M;
    /// `m` and `a < b`.
    fn and_less(self, m: Self::M, a: Self::V, b: Self::V) -> Self::M;
    /// `m` and `a ≤ b`.
    fn and_at_most(self, m: Self::M, a: Self::V, b: Self::V) -> Self::M;
    /// 0 where `m` is true, `a` elsewhere.
    fn zero_where(self, m: Self::M, a: Self::V) -> Self::V;
    /// One bit per lane, the first lowest.
    fn bits(self, m: Self::M) -> u64;
}

/// Safe methods over functions compiled for `$feature`, for a token of that instruction set.
#[cfg(target_arch = "x86_64")]
macro_rules! compiled {
    ($feature:literal; $(fn $name:ident($($argument:ident: $type:ty),+) -> $out:ty $body:block)+) => {
        $(
            #[inline(always)]
            fn $name(self, $($argument: $type),+) -> $out {
                #[inline]
                #[target_feature(enable = $feature)]
                fn compiled($($argument: $type),+) -> $out $body
                // SAFETY: `self` exists only where the processor has the instructions.
                unsafe { compiled($($argument),+) }
            }
        )+
    };
}
#[cfg(target_arch = "x86_64")]
use compiled;

/// The last index of a table that lanes gather from.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn last(table: &[f64]) -> i32 {
    table.len().checked_sub(1).and_then(|last| i32::try_from(last).ok()).expect("a table of 1 to 2³¹ values")
}
