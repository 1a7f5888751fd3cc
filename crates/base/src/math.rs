//! Numerics without an optical word.

#[doc(hidden)]
pub mod fft;
#[doc(hidden)]
pub mod least_squares;
pub mod memory;
pub mod npz;
#[doc(hidden)]
pub mod raster;
pub mod real;
#[doc(hidden)]
pub mod simd;
#[doc(hidden)]
pub mod ssim;
#[doc(hidden)]
pub mod wide;

/// A seed made of a seed and a counter (the output function of SplitMix64), so that neighbours share nothing.
pub fn mixed(seed: u64, counter: u64) -> u64 {
    let mut z = seed ^ counter.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The value that a share of `values` (0 to 1) does not exceed, the least such; NaN without values.
pub fn at_share(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let count = values.len();
    let at = ((share * count as f64).ceil() as usize).clamp(1, count.max(1)) - 1;
    values.get(at).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::at_share;

    #[test]
    fn shares_of_values() {
        let values = vec![3.0, f64::INFINITY, 1.0, 2.0];
        let at = |share| at_share(values.clone(), share);
        assert_eq!([at(0.0), at(0.25), at(0.26), at(0.75), at(1.0)], [1.0, 1.0, 2.0, 3.0, f64::INFINITY]);
        assert!(at_share(Vec::new(), 0.5).is_nan());
    }
}
