//! Points for one pixel: five numbers a ray, spread evenly, uniform on their own.
//!
//! A rank-1 sequence with the irrational steps `g⁻¹ … g⁻⁵`, `g⁶ = g + 1` (M. Roberts, "The unreasonable effectiveness of
//! quasirandom sequences", 2018), shifted by a uniform draw modulo 1 (Cranley and Patterson): every point is uniform in
//! the cube, so means are unbiased, and groups with their own shifts are independent.

use glam::DVec2;

/// `g⁻¹ … g⁻⁵`.
const STEPS: [f64; 5] =
    [0.881_271_461_633_569_6, 0.776_639_389_089_768_2, 0.684_430_129_585_342_7, 0.603_168_740_685_728_3, 0.531_555_397_715_791_4];

/// The points of one group of rays.
pub(super) struct Sampler {
    shift: [f64; 5],
}

impl Sampler {
    /// A group of `_size` points.
    pub(super) fn new(rng: &mut fastrand::Rng, _size: usize) -> Self {
        Self { shift: std::array::from_fn(|_| rng.f64()) }
    }

    /// Point `k` in `[0, 1)⁵`.
    #[inline]
    pub(super) fn point(&self, k: usize) -> [f64; 5] {
        std::array::from_fn(|i| (self.shift[i] + k as f64 * STEPS[i]).fract())
    }
}

/// A point of the unit disk from one of the unit square, areas kept in proportion and neighbours kept together.
///
/// P. Shirley, K. Chiu, "A low distortion map between disk and square", J. Graphics Tools 2(3), 1997.
#[inline]
pub(super) fn disk_from_square(u: [f64; 2]) -> DVec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let (large, small, swap) = if a.abs() > b.abs() { (a, b, false) } else { (b, a, true) };
    if large == 0.0 {
        return DVec2::ZERO;
    }
    let (sin, cos) = (std::f64::consts::FRAC_PI_4 * small / large).sin_cos();
    let (along, across) = (large * cos, large * sin);
    if swap { DVec2::new(across, along) } else { DVec2::new(along, across) }
}
