//! Plain numbers: any processor.

use super::times::Times;
use super::{F32, F64, Kernel, Simd};

/// One f64, four f32.
#[derive(Clone, Copy)]
pub(crate) struct Plain;

impl Simd for Plain {
    type Doubles = Times<Self, 4>;
    type Wide = Times<Self, 4>;
    #[inline(always)]
    fn doubles(self) -> Self::Doubles {
        Times(self)
    }
    #[inline(always)]
    fn wide(self) -> Self::Wide {
        Times(self)
    }
    #[inline(never)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        kernel.run(self)
    }
}

/// `$f` of every lane.
macro_rules! lanes {
    ($f:expr, $($v:ident),+) => {{
        let f = $f;
        let mut out = [0.0; 4];
        for (i, out) in out.iter_mut().enumerate() {
            *out = f($($v[i]),+);
        }
        out
    }};
}

impl F32 for Plain {
    type V = [f32; 4];
    type Array = [f32; 4];
    const LANES: usize = 4;
    const BLOCK: usize = 4;
    #[inline(always)]
    fn cut(self, values: &[f32]) -> (&[[f32; 4]], &[f32]) {
        values.as_chunks()
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f32]) -> (&mut [[f32; 4]], &mut [f32]) {
        values.as_chunks_mut()
    }
    #[inline(always)]
    fn splat(self, value: f32) -> [f32; 4] {
        [value; 4]
    }
    #[inline(always)]
    fn load(self, from: &[f32; 4]) -> [f32; 4] {
        *from
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; 4], v: [f32; 4]) {
        *to = v;
    }
    #[inline(always)]
    fn load_first(self, from: &[f32]) -> [f32; 4] {
        let mut v = [0.0; 4];
        v.iter_mut().zip(from).for_each(|(v, from)| *v = *from);
        v
    }
    #[inline(always)]
    fn store_first(self, to: &mut [f32], v: [f32; 4]) {
        to.iter_mut().zip(v).for_each(|(to, v)| *to = v);
    }
    #[inline(always)]
    fn add(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32, b: f32| a + b, a, b)
    }
    #[inline(always)]
    fn mul(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32, b: f32| a * b, a, b)
    }
    #[inline(always)]
    fn fma(self, a: [f32; 4], b: [f32; 4], c: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32, b: f32, c: f32| a * b + c, a, b, c)
    }
    #[inline(always)]
    fn above_zero(self, a: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32| if a < 0.0 { 0.0 } else { a }, a)
    }
    #[inline(always)]
    fn below_zero(self, a: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32| if a > 0.0 { 0.0 } else { a }, a)
    }
    #[inline(always)]
    fn choose(self, sign: [f32; 4], a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes!(|sign: f32, a: f32, b: f32| if sign >= 0.0 { a } else { b }, sign, a, b)
    }
    #[inline(always)]
    fn max(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32, b: f32| if a > b || a.is_nan() { a } else { b }, a, b)
    }
    #[inline(always)]
    fn where_same(self, a: [f32; 4], b: [f32; 4], x: [f32; 4], y: [f32; 4]) -> [f32; 4] {
        lanes!(|a: f32, b: f32, x: f32, y: f32| if a == b || a.is_nan() { x } else { y }, a, b, x, y)
    }
    #[inline(always)]
    fn unzip(self, a: [f32; 4], b: [f32; 4]) -> ([f32; 4], [f32; 4]) {
        ([a[0], a[2], b[0], b[2]], [a[1], a[3], b[1], b[3]])
    }
    #[inline(always)]
    fn zip(self, even: [f32; 4], odd: [f32; 4]) -> ([f32; 4], [f32; 4]) {
        ([even[0], odd[0], even[1], odd[1]], [even[2], odd[2], even[3], odd[3]])
    }
    #[inline(always)]
    fn sum(self, a: [f32; 4]) -> f32 {
        (a[0] + a[2]) + (a[1] + a[3])
    }
}

impl F64 for Plain {
    type V = f64;
    type M = bool;
    type Array = f64;
    const LANES: usize = 1;
    #[inline(always)]
    fn cut(self, values: &[f64]) -> &[f64] {
        values
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f64]) -> &mut [f64] {
        values
    }
    #[inline(always)]
    fn splat(self, value: f64) -> f64 {
        value
    }
    #[inline(always)]
    fn load(self, from: &f64) -> f64 {
        *from
    }
    #[inline(always)]
    fn store(self, to: &mut f64, v: f64) {
        *to = v;
    }
    #[inline(always)]
    fn gather(self, table: &[f64], index: &[u32]) -> f64 {
        table[(index[0] as usize).min(table.len() - 1)]
    }
    #[inline(always)]
    fn add(self, a: f64, b: f64) -> f64 {
        a + b
    }
    #[inline(always)]
    fn sub(self, a: f64, b: f64) -> f64 {
        a - b
    }
    #[inline(always)]
    fn mul(self, a: f64, b: f64) -> f64 {
        a * b
    }
    #[inline(always)]
    fn div(self, a: f64, b: f64) -> f64 {
        a / b
    }
    #[inline(always)]
    fn sqrt(self, a: f64) -> f64 {
        a.sqrt()
    }
    #[inline(always)]
    fn fma(self, a: f64, b: f64, c: f64) -> f64 {
        // Not `mul_add`, which is a library call where the processor has no such instruction.
        a * b + c
    }
    #[inline(always)]
    fn fnma(self, a: f64, b: f64, c: f64) -> f64 {
        c - a * b
    }
    #[inline(always)]
    fn abs(self, a: f64) -> f64 {
        a.abs()
    }
    #[inline(always)]
    fn max(self, a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }
    #[inline(always)]
    fn sqrt_and_inverse(self, a: f64) -> (f64, f64) {
        let root = a.sqrt();
        (root, 1.0 / root)
    }
    #[inline(always)]
    fn rough_inverse(self, a: f64) -> f64 {
        1.0 / a
    }
    #[inline(always)]
    fn rough_inverse_sqrt(self, a: f64) -> f64 {
        1.0 / a.sqrt()
    }
    #[inline(always)]
    fn less(self, a: f64, b: f64) -> bool {
        a < b
    }
    #[inline(always)]
    fn at_most(self, a: f64, b: f64) -> bool {
        a <= b
    }
    #[inline(always)]
    fn and_less(self, m: bool, a: f64, b: f64) -> bool {
        m & (a < b)
    }
    #[inline(always)]
    fn and_at_most(self, m: bool, a: f64, b: f64) -> bool {
        m & (a <= b)
    }
    #[inline(always)]
    fn zero_where(self, m: bool, a: f64) -> f64 {
        if m { 0.0 } else { a }
    }
    #[inline(always)]
    fn bits(self, m: bool) -> u64 {
        u64::from(m)
    }
}
