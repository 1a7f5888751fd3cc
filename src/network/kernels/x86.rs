//! The vector operations on AVX2 and AVX-512.
#![allow(unsafe_code, reason = "processor intrinsics; callers have asked the processor")]

use std::arch::x86_64::*;

use super::simd::{Kernel, Rows, Simd, correlate_tile, tile};

/// Runs `kernel` with sixteen lanes.
///
/// # Safety
/// The processor must have the features named here.
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
pub(super) unsafe fn run_avx512<K: Kernel>(kernel: &K) {
    unsafe { kernel.run::<Avx512>() }
}

/// Runs `kernel` with eight lanes.
///
/// # Safety
/// The processor must have the features named here.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn run_avx2<K: Kernel>(kernel: &K) {
    unsafe { kernel.run::<Avx2>() }
}

/// The two inner loops as functions compiled for `$feature`. Inlined into the loops around them, the compiler's register
/// allocation puts half of the sums on the stack.
macro_rules! inner_loops {
    ($simd:ty, $feature:literal) => {
        #[inline(always)]
        unsafe fn tile<const K: usize, const O: usize, const N: usize>(
            rows: &Rows,
            weights: *const f32,
            bias: *const f32,
            to: *mut f32,
            plane: usize,
            left: usize,
        ) {
            #[target_feature(enable = $feature)]
            #[inline(never)]
            unsafe fn compiled<const K: usize, const O: usize, const N: usize>(
                rows: &Rows,
                weights: *const f32,
                bias: *const f32,
                to: *mut f32,
                plane: usize,
                left: usize,
            ) {
                unsafe { tile::<$simd, K, O, N>(rows, weights, bias, to, plane, left) }
            }
            unsafe { compiled::<K, O, N>(rows, weights, bias, to, plane, left) }
        }
        #[inline(always)]
        unsafe fn correlate<const O: usize>(
            a: &Rows,
            b: &[*const f32; 3],
            b_row_stride: usize,
            rows: usize,
            n: usize,
            to: *mut f32,
            strides: (usize, usize),
        ) {
            #[target_feature(enable = $feature)]
            #[inline(never)]
            unsafe fn compiled<const O: usize>(
                a: &Rows,
                b: &[*const f32; 3],
                b_row_stride: usize,
                rows: usize,
                n: usize,
                to: *mut f32,
                strides: (usize, usize),
            ) {
                unsafe { correlate_tile::<$simd, O>(a, b, b_row_stride, rows, n, to, strides) }
            }
            unsafe { compiled::<O>(a, b, b_row_stride, rows, n, to, strides) }
        }
    };
}

/// AVX-512 F, VL, DQ, BW. Without VL the compiler keeps sums that are added up across lanes in 16 of the 32 registers.
#[derive(Clone, Copy)]
pub(super) struct Avx512;

/// AVX2 with FMA.
#[derive(Clone, Copy)]
pub(super) struct Avx2;

impl Simd for Avx512 {
    type V = __m512;
    const LANES: usize = 16;
    const BLOCK: usize = 8;
    #[inline(always)]
    unsafe fn zero() -> __m512 {
        unsafe { _mm512_setzero_ps() }
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> __m512 {
        unsafe { _mm512_set1_ps(value) }
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> __m512 {
        unsafe { _mm512_loadu_ps(from) }
    }
    #[inline(always)]
    unsafe fn load_first(from: *const f32, n: usize) -> __m512 {
        unsafe { _mm512_maskz_loadu_ps(mask16(n), from) }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f32, v: __m512) {
        unsafe { _mm512_storeu_ps(to, v) }
    }
    #[inline(always)]
    unsafe fn store_first(to: *mut f32, n: usize, v: __m512) {
        unsafe { _mm512_mask_storeu_ps(to, mask16(n), v) }
    }
    #[inline(always)]
    unsafe fn add(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m512, b: __m512, c: __m512) -> __m512 {
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    unsafe fn above_zero(a: __m512) -> __m512 {
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), a) }
    }
    #[inline(always)]
    unsafe fn below_zero(a: __m512) -> __m512 {
        unsafe { _mm512_min_ps(_mm512_setzero_ps(), a) }
    }
    #[inline(always)]
    unsafe fn choose(sign: __m512, a: __m512, b: __m512) -> __m512 {
        unsafe {
            _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(sign, _mm512_setzero_ps()), b, a)
        }
    }
    #[inline(always)]
    unsafe fn max(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn where_equal(a: __m512, b: __m512, x: __m512, y: __m512) -> __m512 {
        unsafe { _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b), y, x) }
    }
    #[inline(always)]
    unsafe fn unzip(a: __m512, b: __m512) -> (__m512, __m512) {
        unsafe {
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
            (_mm512_permutex2var_ps(a, even, b), _mm512_permutex2var_ps(a, odd, b))
        }
    }
    #[inline(always)]
    unsafe fn zip(even: __m512, odd: __m512) -> (__m512, __m512) {
        unsafe {
            let first = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
            let second = _mm512_add_epi32(first, _mm512_set1_epi32(8));
            (_mm512_permutex2var_ps(even, first, odd), _mm512_permutex2var_ps(even, second, odd))
        }
    }
    #[inline(always)]
    unsafe fn sum(a: __m512) -> f32 {
        unsafe { _mm512_reduce_add_ps(a) }
    }
    inner_loops!(Avx512, "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma");
}

/// The first `n` of 16 lanes.
#[inline(always)]
fn mask16(n: usize) -> u16 {
    if n >= 16 { u16::MAX } else { (1 << n) - 1 }
}

impl Simd for Avx2 {
    type V = __m256;
    const LANES: usize = 8;
    const BLOCK: usize = 4;
    #[inline(always)]
    unsafe fn zero() -> __m256 {
        unsafe { _mm256_setzero_ps() }
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> __m256 {
        unsafe { _mm256_set1_ps(value) }
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> __m256 {
        unsafe { _mm256_loadu_ps(from) }
    }
    #[inline(always)]
    unsafe fn load_first(from: *const f32, n: usize) -> __m256 {
        unsafe { _mm256_maskload_ps(from, mask8(n)) }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f32, v: __m256) {
        unsafe { _mm256_storeu_ps(to, v) }
    }
    #[inline(always)]
    unsafe fn store_first(to: *mut f32, n: usize, v: __m256) {
        unsafe { _mm256_maskstore_ps(to, mask8(n), v) }
    }
    #[inline(always)]
    unsafe fn add(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m256, b: __m256, c: __m256) -> __m256 {
        unsafe { _mm256_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    unsafe fn above_zero(a: __m256) -> __m256 {
        unsafe { _mm256_max_ps(_mm256_setzero_ps(), a) }
    }
    #[inline(always)]
    unsafe fn below_zero(a: __m256) -> __m256 {
        unsafe { _mm256_min_ps(_mm256_setzero_ps(), a) }
    }
    #[inline(always)]
    unsafe fn choose(sign: __m256, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_blendv_ps(b, a, _mm256_cmp_ps::<_CMP_GE_OQ>(sign, _mm256_setzero_ps())) }
    }
    #[inline(always)]
    unsafe fn max(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn where_equal(a: __m256, b: __m256, x: __m256, y: __m256) -> __m256 {
        unsafe { _mm256_blendv_ps(y, x, _mm256_cmp_ps::<_CMP_EQ_OQ>(a, b)) }
    }
    #[inline(always)]
    unsafe fn unzip(a: __m256, b: __m256) -> (__m256, __m256) {
        unsafe {
            // Pairs of four lanes, then the halves in order.
            let order =
                |v| _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(_mm256_castps_pd(v)));
            let even = _mm256_shuffle_ps::<0b10_00_10_00>(a, b);
            let odd = _mm256_shuffle_ps::<0b11_01_11_01>(a, b);
            (order(even), order(odd))
        }
    }
    #[inline(always)]
    unsafe fn zip(even: __m256, odd: __m256) -> (__m256, __m256) {
        unsafe {
            let low = _mm256_unpacklo_ps(even, odd);
            let high = _mm256_unpackhi_ps(even, odd);
            (_mm256_permute2f128_ps::<0x20>(low, high), _mm256_permute2f128_ps::<0x31>(low, high))
        }
    }
    #[inline(always)]
    unsafe fn sum(a: __m256) -> f32 {
        unsafe {
            let quad = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let pair = _mm_add_ps(quad, _mm_movehl_ps(quad, quad));
            _mm_cvtss_f32(_mm_add_ss(pair, _mm_shuffle_ps::<1>(pair, pair)))
        }
    }
    inner_loops!(Avx2, "avx2,fma");
}

/// The first `n` of 8 lanes.
#[inline(always)]
unsafe fn mask8(n: usize) -> __m256i {
    const ONES_THEN_ZEROS: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
    unsafe { _mm256_loadu_si256(ONES_THEN_ZEROS.as_ptr().add(8 - n.min(8)).cast()) }
}
