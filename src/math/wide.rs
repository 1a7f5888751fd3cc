//! Loops compiled for the widest vectors the processor has.
//!
//! The operations and their order are the same at every width (no fused multiply-add is formed), so the numbers are
//! the same bits on every processor.

#![expect(unsafe_code, reason = "a function of an instruction set may be called only where the processor has it")]

/// Work to be compiled for several instruction sets; `run` and all it calls must be `#[inline(always)]` to profit.
pub trait Work {
    /// What the work gives.
    type Output;
    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Runs `work` in its widest version.
#[inline]
pub fn wide<W: Work>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    {
        if std::is_x86_feature_detected!("avx512f") && std::is_x86_feature_detected!("avx512vl") {
            // SAFETY: the processor has the features that the function is compiled for.
            return unsafe { avx512(work) };
        }
        if std::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the features that the function is compiled for.
            return unsafe { avx2(work) };
        }
    }
    work.run()
}

/// Asks the processor to fetch `values` into its second cache; a hint, without effect on any value.
#[inline]
pub fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        for part in values.chunks((64 / size_of::<T>().max(1)).max(1)) {
            // SAFETY: a prefetch reads nothing that the program sees, and the address is that of a live value.
            unsafe { _mm_prefetch::<_MM_HINT_T1>(part.as_ptr().cast()) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2")]
fn avx512<W: Work>(work: W) -> W::Output {
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<W: Work>(work: W) -> W::Output {
    work.run()
}
