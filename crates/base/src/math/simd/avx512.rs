//! Vectors of 512 bits: AVX-512 F, VL, DQ, BW. Without VL the compiler keeps sums that are added up across lanes in 16 of the 32
//! registers.
#![expect(unsafe_code, reason = "instructions that a token stands for, loads and stores by address")]

use std::arch::x86_64::*;

use super::times::Times;
use super::{F32, F64, Kernel, Level, Simd, compiled, last};

/// Proof that the processor has the instructions.
#[derive(Clone, Copy)]
pub(crate) struct Avx512(());

impl Avx512 {
    /// # Panics
    /// Where the processor lacks the instructions.
    #[inline]
    pub(super) fn detected() -> Self {
        assert!(Level::detect() >= Level::Avx512);
        Self(())
    }
}

impl Simd for Avx512 {
    type Doubles = Self;
    type Wide = Times<Self, 4>;
    #[inline(always)]
    fn doubles(self) -> Self {
        self
    }
    #[inline(always)]
    fn wide(self) -> Self::Wide {
        Times(self)
    }
    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
        #[inline(never)]
        fn compiled<K: Kernel>(simd: Avx512, kernel: K) -> K::Output {
            kernel.run(simd)
        }
        // SAFETY: `self` exists only where the processor has the instructions.
        unsafe { compiled(self, kernel) }
    }
}

impl F32 for Avx512 {
    type V = __m512;
    type Array = [f32; 16];
    const LANES: usize = 16;
    const BLOCK: usize = 8;
    #[inline(always)]
    fn cut(self, values: &[f32]) -> (&[[f32; 16]], &[f32]) {
        values.as_chunks()
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f32]) -> (&mut [[f32; 16]], &mut [f32]) {
        values.as_chunks_mut()
    }
    #[inline(always)]
    fn load(self, from: &[f32; 16]) -> __m512 {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm512_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; 16], v: __m512) {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), v) }
    }
    #[inline(always)]
    fn load_first(self, from: &[f32]) -> __m512 {
        // SAFETY: the mask covers at most the slice; `self` stands for the instructions.
        unsafe { _mm512_maskz_loadu_ps(first(from.len()), from.as_ptr()) }
    }
    #[inline(always)]
    fn store_first(self, to: &mut [f32], v: __m512) {
        // SAFETY: the mask covers at most the slice; `self` stands for the instructions.
        unsafe { _mm512_mask_storeu_ps(to.as_mut_ptr(), first(to.len()), v) }
    }
    compiled! {
        "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma";
        fn splat(value: f32) -> __m512 {
            _mm512_set1_ps(value)
        }
        fn add(a: __m512, b: __m512) -> __m512 {
            _mm512_add_ps(a, b)
        }
        fn mul(a: __m512, b: __m512) -> __m512 {
            _mm512_mul_ps(a, b)
        }
        fn fma(a: __m512, b: __m512, c: __m512) -> __m512 {
            _mm512_fmadd_ps(a, b, c)
        }
        fn above_zero(a: __m512) -> __m512 {
            _mm512_max_ps(_mm512_setzero_ps(), a)
        }
        fn below_zero(a: __m512) -> __m512 {
            _mm512_min_ps(_mm512_setzero_ps(), a)
        }
        fn choose(sign: __m512, a: __m512, b: __m512) -> __m512 {
            _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(sign, _mm512_setzero_ps()), b, a)
        }
        fn max(a: __m512, b: __m512) -> __m512 {
            // The instruction gives `b` where one of them is NaN.
            _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a), _mm512_max_ps(a, b), a)
        }
        fn where_same(a: __m512, b: __m512, x: __m512, y: __m512) -> __m512 {
            let same = _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b) | _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a);
            _mm512_mask_blend_ps(same, y, x)
        }
        fn unzip(a: __m512, b: __m512) -> (__m512, __m512) {
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
            (_mm512_permutex2var_ps(a, even, b), _mm512_permutex2var_ps(a, odd, b))
        }
        fn zip(even: __m512, odd: __m512) -> (__m512, __m512) {
            let first = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
            let second = _mm512_add_epi32(first, _mm512_set1_epi32(8));
            (_mm512_permutex2var_ps(even, first, odd), _mm512_permutex2var_ps(even, second, odd))
        }
        fn sum(a: __m512) -> f32 {
            _mm512_reduce_add_ps(a)
        }
    }
}

/// The first `n` of 16 lanes.
#[inline(always)]
fn first(n: usize) -> u16 {
    if n >= 16 { u16::MAX } else { (1 << n) - 1 }
}

impl F64 for Avx512 {
    type V = __m512d;
    type M = __mmask8;
    type Array = [f64; 8];
    const LANES: usize = 8;
    #[inline(always)]
    fn cut(self, values: &[f64]) -> &[[f64; 8]] {
        values.as_chunks().0
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f64]) -> &mut [[f64; 8]] {
        values.as_chunks_mut().0
    }
    #[inline(always)]
    fn load(self, from: &[f64; 8]) -> __m512d {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm512_loadu_pd(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f64; 8], v: __m512d) {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm512_storeu_pd(to.as_mut_ptr(), v) }
    }
    #[inline(always)]
    fn gather(self, table: &[f64], index: &[u32]) -> __m512d {
        let last = last(table);
        let index: &[u32; 8] = index.first_chunk().expect("an index for every lane");
        // SAFETY: eight indices, none beyond the table; `self` stands for the instructions.
        unsafe {
            let index = _mm256_min_epu32(_mm256_loadu_si256(index.as_ptr().cast()), _mm256_set1_epi32(last));
            _mm512_i32gather_pd::<8>(index, table.as_ptr())
        }
    }
    compiled! {
        "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma";
        fn splat(value: f64) -> __m512d {
            _mm512_set1_pd(value)
        }
        fn add(a: __m512d, b: __m512d) -> __m512d {
            _mm512_add_pd(a, b)
        }
        fn sub(a: __m512d, b: __m512d) -> __m512d {
            _mm512_sub_pd(a, b)
        }
        fn mul(a: __m512d, b: __m512d) -> __m512d {
            _mm512_mul_pd(a, b)
        }
        fn div(a: __m512d, b: __m512d) -> __m512d {
            _mm512_div_pd(a, b)
        }
        fn sqrt(a: __m512d) -> __m512d {
            _mm512_sqrt_pd(a)
        }
        fn fma(a: __m512d, b: __m512d, c: __m512d) -> __m512d {
            _mm512_fmadd_pd(a, b, c)
        }
        fn fnma(a: __m512d, b: __m512d, c: __m512d) -> __m512d {
            _mm512_fnmadd_pd(a, b, c)
        }
        fn max(a: __m512d, b: __m512d) -> __m512d {
            _mm512_max_pd(a, b)
        }
        fn abs(a: __m512d) -> __m512d {
            _mm512_abs_pd(a)
        }
        fn sqrt_and_inverse(a: __m512d) -> (__m512d, __m512d) {
            // 14 bits, then Goldschmidt's pair s → √a, h → 1/2√a with one residual e for both: 28, 56 bits.
            let y = _mm512_rsqrt14_pd(a);
            let half = _mm512_set1_pd(0.5);
            let (s, h) = (_mm512_mul_pd(a, y), _mm512_mul_pd(half, y));
            let e = _mm512_fnmadd_pd(s, h, half);
            let (s, h) = (_mm512_fmadd_pd(s, e, s), _mm512_fmadd_pd(h, e, h));
            let e = _mm512_fnmadd_pd(s, h, half);
            let (s, h) = (_mm512_fmadd_pd(s, e, s), _mm512_fmadd_pd(h, e, h));
            // The rounding of the pair leaves a few units; the residual of the root itself takes them off.
            let s = _mm512_fmadd_pd(_mm512_fnmadd_pd(s, s, a), h, s);
            (s, _mm512_add_pd(h, h))
        }
        fn rough_inverse(a: __m512d) -> __m512d {
            _mm512_rcp14_pd(a)
        }
        fn rough_inverse_sqrt(a: __m512d) -> __m512d {
            _mm512_rsqrt14_pd(a)
        }
        fn less(a: __m512d, b: __m512d) -> __mmask8 {
            _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b)
        }
        fn at_most(a: __m512d, b: __m512d) -> __mmask8 {
            _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a, b)
        }
        fn and_less(m: __mmask8, a: __m512d, b: __m512d) -> __mmask8 {
            _mm512_mask_cmp_pd_mask::<_CMP_LT_OQ>(m, a, b)
        }
        fn and_at_most(m: __mmask8, a: __m512d, b: __m512d) -> __mmask8 {
            _mm512_mask_cmp_pd_mask::<_CMP_LE_OQ>(m, a, b)
        }
        fn zero_where(m: __mmask8, a: __m512d) -> __m512d {
            _mm512_maskz_mov_pd(!m, a)
        }
        fn bits(m: __mmask8) -> u64 {
            u64::from(m)
        }
    }
}
