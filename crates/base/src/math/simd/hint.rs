//! What is told to processor and compiler beside the computation.
#![expect(unsafe_code, reason = "an instruction that takes an address, and an empty piece of assembly")]

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

/// `value` again, so that its parts are read from memory where they are used instead of taking registers over a loop.
#[inline(always)]
pub fn fresh<T>(value: &T) -> &T {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        let mut pointer: *const T = value;
        // SAFETY: no instruction; the pointer stays what it is.
        unsafe {
            std::arch::asm!("/* {0} */", inout(reg) pointer, options(readonly, nostack, preserves_flags));
            &*pointer
        }
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    value
}
