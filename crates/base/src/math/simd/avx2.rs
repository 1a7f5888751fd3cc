//! Vectors of 256 bits: AVX2 with FMA.
#![expect(unsafe_code, reason = "instructions that a token stands for, loads and stores by address")]

use std::arch::x86_64::*;

use super::times::Times;
use super::{F32, F64, Kernel, Level, Simd, compiled, last};

/// Proof that the processor has the instructions.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

impl Avx2 {
    /// # Panics
    /// Where the processor lacks the instructions.
    #[inline]
    pub(super) fn detected() -> Self {
        assert!(Level::detect() >= Level::Avx2);
        Self(())
    }
}

impl Simd for Avx2 {
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
        #[target_feature(enable = "avx2,fma")]
        #[inline(never)]
        fn compiled<K: Kernel>(simd: Avx2, kernel: K) -> K::Output {
            kernel.run(simd)
        }
        // SAFETY: `self` exists only where the processor has the instructions.
        unsafe { compiled(self, kernel) }
    }
}

impl F32 for Avx2 {
    type V = __m256;
    type Array = [f32; 8];
    const LANES: usize = 8;
    const BLOCK: usize = 4;
    #[inline(always)]
    fn cut(self, values: &[f32]) -> (&[[f32; 8]], &[f32]) {
        values.as_chunks()
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f32]) -> (&mut [[f32; 8]], &mut [f32]) {
        values.as_chunks_mut()
    }
    #[inline(always)]
    fn load(self, from: &[f32; 8]) -> __m256 {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; 8], v: __m256) {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), v) }
    }
    #[inline(always)]
    fn load_first(self, from: &[f32]) -> __m256 {
        // SAFETY: the mask covers at most the slice; `self` stands for the instructions.
        unsafe { _mm256_maskload_ps(from.as_ptr(), first(from.len())) }
    }
    #[inline(always)]
    fn store_first(self, to: &mut [f32], v: __m256) {
        // SAFETY: the mask covers at most the slice; `self` stands for the instructions.
        unsafe { _mm256_maskstore_ps(to.as_mut_ptr(), first(to.len()), v) }
    }
    compiled! {
        "avx2,fma";
        fn splat(value: f32) -> __m256 {
            _mm256_set1_ps(value)
        }
        fn add(a: __m256, b: __m256) -> __m256 {
            _mm256_add_ps(a, b)
        }
        fn mul(a: __m256, b: __m256) -> __m256 {
            _mm256_mul_ps(a, b)
        }
        fn fma(a: __m256, b: __m256, c: __m256) -> __m256 {
            _mm256_fmadd_ps(a, b, c)
        }
        fn above_zero(a: __m256) -> __m256 {
            _mm256_max_ps(_mm256_setzero_ps(), a)
        }
        fn below_zero(a: __m256) -> __m256 {
            _mm256_min_ps(_mm256_setzero_ps(), a)
        }
        fn choose(sign: __m256, a: __m256, b: __m256) -> __m256 {
            _mm256_blendv_ps(b, a, _mm256_cmp_ps::<_CMP_GE_OQ>(sign, _mm256_setzero_ps()))
        }
        fn max(a: __m256, b: __m256) -> __m256 {
            // The instruction gives `b` where one of them is NaN.
            _mm256_blendv_ps(_mm256_max_ps(a, b), a, _mm256_cmp_ps::<_CMP_UNORD_Q>(a, a))
        }
        fn where_same(a: __m256, b: __m256, x: __m256, y: __m256) -> __m256 {
            let same = _mm256_or_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(a, b), _mm256_cmp_ps::<_CMP_UNORD_Q>(a, a));
            _mm256_blendv_ps(y, x, same)
        }
        fn unzip(a: __m256, b: __m256) -> (__m256, __m256) {
            // Pairs of four lanes, then the halves in order.
            let even = _mm256_castps_pd(_mm256_shuffle_ps::<0b10_00_10_00>(a, b));
            let odd = _mm256_castps_pd(_mm256_shuffle_ps::<0b11_01_11_01>(a, b));
            (
                _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(even)),
                _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(odd)),
            )
        }
        fn zip(even: __m256, odd: __m256) -> (__m256, __m256) {
            let low = _mm256_unpacklo_ps(even, odd);
            let high = _mm256_unpackhi_ps(even, odd);
            (_mm256_permute2f128_ps::<0x20>(low, high), _mm256_permute2f128_ps::<0x31>(low, high))
        }
        fn sum(a: __m256) -> f32 {
            let quad = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let pair = _mm_add_ps(quad, _mm_movehl_ps(quad, quad));
            _mm_cvtss_f32(_mm_add_ss(pair, _mm_shuffle_ps::<1>(pair, pair)))
        }
    }
}

/// The first `n` of 8 lanes.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn first(n: usize) -> __m256i {
    _mm256_cmpgt_epi32(_mm256_set1_epi32(n.min(8) as i32), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7))
}

impl F64 for Avx2 {
    type V = __m256d;
    type M = __m256d;
    type Array = [f64; 4];
    const LANES: usize = 4;
    #[inline(always)]
    fn cut(self, values: &[f64]) -> &[[f64; 4]] {
        values.as_chunks().0
    }
    #[inline(always)]
    fn cut_mut(self, values: &mut [f64]) -> &mut [[f64; 4]] {
        values.as_chunks_mut().0
    }
    #[inline(always)]
    fn load(self, from: &[f64; 4]) -> __m256d {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm256_loadu_pd(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f64; 4], v: __m256d) {
        // SAFETY: the array is one vector; `self` stands for the instructions.
        unsafe { _mm256_storeu_pd(to.as_mut_ptr(), v) }
    }
    #[inline(always)]
    fn gather(self, table: &[f64], index: &[u32]) -> __m256d {
        let last = last(table);
        let index: &[u32; 4] = index.first_chunk().expect("an index for every lane");
        // SAFETY: four indices, none beyond the table; `self` stands for the instructions.
        unsafe {
            let index = _mm_min_epu32(_mm_loadu_si128(index.as_ptr().cast()), _mm_set1_epi32(last));
            _mm256_i32gather_pd::<8>(table.as_ptr(), index)
        }
    }
    compiled! {
        "avx2,fma";
        fn splat(value: f64) -> __m256d {
            _mm256_set1_pd(value)
        }
        fn add(a: __m256d, b: __m256d) -> __m256d {
            _mm256_add_pd(a, b)
        }
        fn sub(a: __m256d, b: __m256d) -> __m256d {
            _mm256_sub_pd(a, b)
        }
        fn mul(a: __m256d, b: __m256d) -> __m256d {
            _mm256_mul_pd(a, b)
        }
        fn div(a: __m256d, b: __m256d) -> __m256d {
            _mm256_div_pd(a, b)
        }
        fn sqrt(a: __m256d) -> __m256d {
            _mm256_sqrt_pd(a)
        }
        fn fma(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            _mm256_fmadd_pd(a, b, c)
        }
        fn fnma(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            _mm256_fnmadd_pd(a, b, c)
        }
        fn max(a: __m256d, b: __m256d) -> __m256d {
            _mm256_max_pd(a, b)
        }
        fn abs(a: __m256d) -> __m256d {
            _mm256_andnot_pd(_mm256_set1_pd(-0.0), a)
        }
        fn sqrt_and_inverse(a: __m256d) -> (__m256d, __m256d) {
            let root = _mm256_sqrt_pd(a);
            (root, _mm256_div_pd(_mm256_set1_pd(1.0), root))
        }
        fn rough_inverse(a: __m256d) -> __m256d {
            _mm256_cvtps_pd(_mm_rcp_ps(_mm256_cvtpd_ps(a)))
        }
        fn rough_inverse_sqrt(a: __m256d) -> __m256d {
            _mm256_cvtps_pd(_mm_rsqrt_ps(_mm256_cvtpd_ps(a)))
        }
        fn less(a: __m256d, b: __m256d) -> __m256d {
            _mm256_cmp_pd::<_CMP_LT_OQ>(a, b)
        }
        fn at_most(a: __m256d, b: __m256d) -> __m256d {
            _mm256_cmp_pd::<_CMP_LE_OQ>(a, b)
        }
        fn and_less(m: __m256d, a: __m256d, b: __m256d) -> __m256d {
            _mm256_and_pd(m, _mm256_cmp_pd::<_CMP_LT_OQ>(a, b))
        }
        fn and_at_most(m: __m256d, a: __m256d, b: __m256d) -> __m256d {
            _mm256_and_pd(m, _mm256_cmp_pd::<_CMP_LE_OQ>(a, b))
        }
        fn zero_where(m: __m256d, a: __m256d) -> __m256d {
            _mm256_andnot_pd(m, a)
        }
        fn bits(m: __m256d) -> u64 {
            u64::from(_mm256_movemask_pd(m).cast_unsigned())
        }
    }
}
