//! Vectors side by side. Loops count by hand: iterators are functions that are not always inlined.

use super::F64;

/// `U` vectors of `S` as one.
#[derive(Clone, Copy)]
pub(crate) struct Times<S, const U: usize>(pub(super) S);

macro_rules! side_by_side {
    ($(fn $name:ident($($arg:ident: $type:ident),+) -> $out:ident;)+) => {
        $(
            #[inline(always)]
            fn $name(self, $($arg: Self::$type),+) -> Self::$out {
                let mut out = [self.0.$name($($arg[0]),+); U];
                let mut i = 1;
                while i < U {
                    out[i] = self.0.$name($($arg[i]),+);
                    i += 1;
                }
                out
            }
        )+
    };
}

impl<S: F64, const U: usize> F64 for Times<S, U> {
    type V = [S::V; U];
    type M = [S::M; U];
    type Array = [S::Array; U];
    const LANES: usize = U * S::LANES;
    #[inline(always)]
    fn cut(self, values: &[f64]) -> &[[S::Array; U]] {
        self.0.cut(values).as_chunks().0
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f64]) -> &mut [[S::Array; U]] {
        self.0.cut_mut(values).as_chunks_mut().0
    }
    #[inline(always)]
    fn splat(self, value: f64) -> Self::V {
        [self.0.splat(value); U]
    }
    #[inline(always)]
    fn load(self, from: &[S::Array; U]) -> Self::V {
        let mut out = [self.0.load(&from[0]); U];
        let mut i = 1;
        while i < U {
            out[i] = self.0.load(&from[i]);
            i += 1;
        }
        out
    }
    #[inline(always)]
    fn store(self, to: &mut [S::Array; U], v: Self::V) {
        let mut i = 0;
        while i < U {
            self.0.store(&mut to[i], v[i]);
            i += 1;
        }
    }
    #[inline(always)]
    fn gather(self, table: &[f64], index: &[u32]) -> Self::V {
        let mut out = [self.0.gather(table, index); U];
        let mut i = 1;
        while i < U {
            out[i] = self.0.gather(table, &index[i * S::LANES..]);
            i += 1;
        }
        out
    }
    side_by_side! {
        fn add(a: V, b: V) -> V;
        fn sub(a: V, b: V) -> V;
        fn mul(a: V, b: V) -> V;
        fn div(a: V, b: V) -> V;
        fn sqrt(a: V) -> V;
        fn fma(a: V, b: V, c: V) -> V;
        fn fnma(a: V, b: V, c: V) -> V;
        fn abs(a: V) -> V;
        fn max(a: V, b: V) -> V;
        fn rough_inverse(a: V) -> V;
        fn rough_inverse_sqrt(a: V) -> V;
        fn less(a: V, b: V) -> M;
        fn at_most(a: V, b: V) -> M;
        fn and_less(m: M, a: V, b: V) -> M;
        fn and_at_most(m: M, a: V, b: V) -> M;
        fn zero_where(m: M, a: V) -> V;
    }
    #[inline(always)]
    fn sqrt_and_inverse(self, a: Self::V) -> (Self::V, Self::V) {
        let (mut root, mut inverse) = (a, a);
        let mut i = 0;
        while i < U {
            (root[i], inverse[i]) = self.0.sqrt_and_inverse(a[i]);
            i += 1;
        }
        (root, inverse)
    }
    #[inline(always)]
    fn bits(self, m: Self::M) -> u64 {
        let mut bits = 0;
        let mut i = 0;
        while i < U {
            bits |= self.0.bits(m[i]) << (i * S::LANES);
            i += 1;
        }
        bits
    }
}
