//! Numerics without an optical word.

pub mod fft;
pub mod least_squares;
pub mod memory;
pub mod real;
pub mod simd;
pub mod wide;

/// A seed made of a seed and a counter (the output function of SplitMix64), so that neighbours share nothing.
pub fn mixed(seed: u64, counter: u64) -> u64 {
    let mut z = seed ^ counter.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
