//! The vector operations on AVX2 and AVX-512.
#![allow(unsafe_code, reason = "processor intrinsics; callers have asked the processor")]

use std::arch::x86_64::*;

use super::simd::Simd;

/// Eight lanes: AVX-512 F, VL, DQ.
#[derive(Clone, Copy)]
pub(super) struct Avx512;

/// Four lanes: AVX2 with FMA.
#[derive(Clone, Copy)]
pub(super) struct Avx2;

impl Simd for Avx512 {
    type V = __m512d;
    type M = __mmask8;
    const LANES: usize = 8;
    #[inline(always)]
    unsafe fn splat(value: f64) -> __m512d {
        unsafe { _mm512_set1_pd(value) }
    }
    #[inline(always)]
    unsafe fn load(from: *const f64) -> __m512d {
        unsafe { _mm512_loadu_pd(from) }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f64, v: __m512d) {
        unsafe { _mm512_storeu_pd(to, v) }
    }
    #[inline(always)]
    unsafe fn gather(table: *const f64, index: *const u32) -> __m512d {
        unsafe { _mm512_i32gather_pd::<8>(_mm256_loadu_si256(index.cast()), table) }
    }
    #[inline(always)]
    unsafe fn add(a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_add_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sub(a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_sub_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_mul_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn div(a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_div_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sqrt(a: __m512d) -> __m512d {
        unsafe { _mm512_sqrt_pd(a) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m512d, b: __m512d, c: __m512d) -> __m512d {
        unsafe { _mm512_fmadd_pd(a, b, c) }
    }
    #[inline(always)]
    unsafe fn fnma(a: __m512d, b: __m512d, c: __m512d) -> __m512d {
        unsafe { _mm512_fnmadd_pd(a, b, c) }
    }
    #[inline(always)]
    unsafe fn abs(a: __m512d) -> __m512d {
        unsafe { _mm512_abs_pd(a) }
    }
    #[inline(always)]
    unsafe fn max(a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_max_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sqrt_and_inverse(a: __m512d) -> (__m512d, __m512d) {
        unsafe {
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
    }
    #[inline(always)]
    unsafe fn rough_inverse(a: __m512d) -> __m512d {
        unsafe { _mm512_rcp14_pd(a) }
    }
    #[inline(always)]
    unsafe fn rough_inverse_sqrt(a: __m512d) -> __m512d {
        unsafe { _mm512_rsqrt14_pd(a) }
    }
    #[inline(always)]
    unsafe fn less(a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn at_most(a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn and_less(m: __mmask8, a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_mask_cmp_pd_mask::<_CMP_LT_OQ>(m, a, b) }
    }
    #[inline(always)]
    unsafe fn and_at_most(m: __mmask8, a: __m512d, b: __m512d) -> __mmask8 {
        unsafe { _mm512_mask_cmp_pd_mask::<_CMP_LE_OQ>(m, a, b) }
    }
    #[inline(always)]
    unsafe fn zero_where(m: __mmask8, a: __m512d) -> __m512d {
        unsafe { _mm512_maskz_mov_pd(!m, a) }
    }
    #[inline(always)]
    unsafe fn bits(m: __mmask8) -> u64 {
        u64::from(m)
    }
}

impl Simd for Avx2 {
    type V = __m256d;
    type M = __m256d;
    const LANES: usize = 4;
    #[inline(always)]
    unsafe fn splat(value: f64) -> __m256d {
        unsafe { _mm256_set1_pd(value) }
    }
    #[inline(always)]
    unsafe fn load(from: *const f64) -> __m256d {
        unsafe { _mm256_loadu_pd(from) }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f64, v: __m256d) {
        unsafe { _mm256_storeu_pd(to, v) }
    }
    #[inline(always)]
    unsafe fn gather(table: *const f64, index: *const u32) -> __m256d {
        unsafe { _mm256_i32gather_pd::<8>(table, _mm_loadu_si128(index.cast())) }
    }
    #[inline(always)]
    unsafe fn add(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_add_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sub(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_sub_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_mul_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn div(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_div_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sqrt(a: __m256d) -> __m256d {
        unsafe { _mm256_sqrt_pd(a) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
        unsafe { _mm256_fmadd_pd(a, b, c) }
    }
    #[inline(always)]
    unsafe fn fnma(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
        unsafe { _mm256_fnmadd_pd(a, b, c) }
    }
    #[inline(always)]
    unsafe fn abs(a: __m256d) -> __m256d {
        unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), a) }
    }
    #[inline(always)]
    unsafe fn max(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_max_pd(a, b) }
    }
    #[inline(always)]
    unsafe fn sqrt_and_inverse(a: __m256d) -> (__m256d, __m256d) {
        unsafe {
            let root = _mm256_sqrt_pd(a);
            (root, _mm256_div_pd(_mm256_set1_pd(1.0), root))
        }
    }
    #[inline(always)]
    unsafe fn rough_inverse(a: __m256d) -> __m256d {
        unsafe { _mm256_cvtps_pd(_mm_rcp_ps(_mm256_cvtpd_ps(a))) }
    }
    #[inline(always)]
    unsafe fn rough_inverse_sqrt(a: __m256d) -> __m256d {
        unsafe { _mm256_cvtps_pd(_mm_rsqrt_ps(_mm256_cvtpd_ps(a))) }
    }
    #[inline(always)]
    unsafe fn less(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn at_most(a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_cmp_pd::<_CMP_LE_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn and_less(m: __m256d, a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_and_pd(m, _mm256_cmp_pd::<_CMP_LT_OQ>(a, b)) }
    }
    #[inline(always)]
    unsafe fn and_at_most(m: __m256d, a: __m256d, b: __m256d) -> __m256d {
        unsafe { _mm256_and_pd(m, _mm256_cmp_pd::<_CMP_LE_OQ>(a, b)) }
    }
    #[inline(always)]
    unsafe fn zero_where(m: __m256d, a: __m256d) -> __m256d {
        unsafe { _mm256_andnot_pd(m, a) }
    }
    #[inline(always)]
    unsafe fn bits(m: __m256d) -> u64 {
        u64::from(unsafe { _mm256_movemask_pd(m) }.cast_unsigned())
    }
}
