//! Fused multiply-adds a second of one thread, so that figures scale to other machines.
#![allow(unsafe_code, reason = "processor intrinsics; the processor is asked first")]

use std::hint::black_box;
use std::time::Instant;

use isoplanat::trace::lanes::Level;

/// Multiply-adds of f64 numbers in a nanosecond, best of many runs, with the vectors of `level`.
pub(crate) fn per_ns(level: Level) -> f64 {
    const ROUNDS: usize = 20_000;
    let mut best = 0.0f64;
    for _ in 0..300 {
        let start = Instant::now();
        let count = match level {
            // SAFETY: an available level is one that the processor has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { x86::avx512(ROUNDS) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { x86::avx2(ROUNDS) },
            _ => portable(ROUNDS),
        };
        best = best.max(count as f64 / start.elapsed().as_secs_f64() * 1e-9);
    }
    best
}

/// Products and sums of plain numbers.
fn portable(rounds: usize) -> usize {
    let mut sums = [1.0f64; 16];
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = *sum * 0.999_999 + 1e-9;
        }
    }
    black_box(sums);
    rounds * sums.len()
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;
    use std::hint::black_box;

    /// Chains enough to hide the latency of two units.
    const CHAINS: usize = 12;

    #[target_feature(enable = "avx512f")]
    pub(super) fn avx512(rounds: usize) -> usize {
        let (a, b) = (_mm512_set1_pd(0.999_999), _mm512_set1_pd(1e-9));
        let mut sums = [_mm512_set1_pd(1.0); CHAINS];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = _mm512_fmadd_pd(*sum, a, b);
            }
        }
        black_box(sums);
        rounds * CHAINS * 8
    }

    #[target_feature(enable = "avx2,fma")]
    pub(super) fn avx2(rounds: usize) -> usize {
        let (a, b) = (_mm256_set1_pd(0.999_999), _mm256_set1_pd(1e-9));
        let mut sums = [_mm256_set1_pd(1.0); CHAINS];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = _mm256_fmadd_pd(*sum, a, b);
            }
        }
        black_box(sums);
        rounds * CHAINS * 4
    }
}
