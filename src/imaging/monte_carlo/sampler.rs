//! Points for one pixel: five numbers a ray, spread evenly together, each uniform on its own.
//!
//! The first five Sobol' dimensions (direction numbers: S. Joe, F. Y. Kuo, "Constructing Sobol sequences with better
//! two-dimensional projections", SIAM J. Sci. Comput. 30(5), 2008) in Gray-code order, every group with a digital shift
//! of its own: an exclusive or with 32 random bits keeps the net and makes every point uniform, so means are unbiased
//! and groups are independent. On smooth colour waves through the two-element lens, 64 rays in two groups leave a third
//! of the noise of independent draws (RMS 0.0060 against 0.0162).

use glam::DVec2;

/// Direction numbers, most significant bit first.
const SOBOL: [[u32; 32]; 5] = [
    directions(0, 0, [0; 3]),
    directions(1, 0, [1, 0, 0]),
    directions(2, 1, [1, 3, 0]),
    directions(3, 1, [1, 3, 1]),
    directions(3, 2, [1, 1, 1]),
];

/// Direction numbers of the primitive polynomial of `degree` with inner coefficients `a`, from the first `m`; degree 0
/// is the van der Corput sequence.
const fn directions(degree: usize, a: u32, m: [u32; 3]) -> [u32; 32] {
    let mut v = [0; 32];
    let mut i = 0;
    while i < 32 {
        v[i] = if degree == 0 {
            1 << (31 - i)
        } else if i < degree {
            m[i] << (31 - i)
        } else {
            let mut x = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if (a >> (degree - 1 - k)) & 1 == 1 {
                    x ^= v[i - k];
                }
                k += 1;
            }
            x
        };
        i += 1;
    }
    v
}

/// The points of one group of rays, one after the other.
pub(super) struct Sampler {
    state: [u32; 5],
    count: u32,
}

impl Sampler {
    /// A group of its own.
    pub(super) fn new(rng: &mut fastrand::Rng) -> Self {
        Self { state: std::array::from_fn(|_| rng.u32(..)), count: 0 }
    }

    /// The next point in `(0, 1)⁵`; the sequence repeats after 2³² points.
    #[inline]
    pub(super) fn draw(&mut self) -> [f64; 5] {
        let point = self.state.map(|x| (f64::from(x) + 0.5) * (1.0 / 4_294_967_296.0));
        self.count = self.count.wrapping_add(1);
        let bit = (self.count.trailing_zeros() & 31) as usize;
        self.state.iter_mut().zip(&SOBOL).for_each(|(x, v)| *x ^= v[bit]);
        point
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Every dimension of the first 2^k points has one point in each of 2^k bins, and so have 4 × 4 boxes of pairs of 16.
    #[test]
    fn groups_are_nets() {
        let rng = &mut fastrand::Rng::with_seed(1);
        for _ in 0..20 {
            let mut sampler = Sampler::new(rng);
            let points: Vec<[f64; 5]> = (0..64).map(|_| sampler.draw()).collect();
            for d in 0..5 {
                let mut seen = [false; 64];
                points.iter().for_each(|p| seen[(p[d] * 64.0) as usize] = true);
                assert!(seen.iter().all(|s| *s), "dimension {d}");
            }
            let mut boxes = [0; 16];
            points[..16].iter().for_each(|p| boxes[(p[0] * 4.0) as usize * 4 + (p[1] * 4.0) as usize] += 1);
            assert_eq!(boxes, [1; 16]);
        }
    }

    /// Over groups, one point of the sequence is uniform: means of products and squares over the cube.
    #[test]
    fn a_point_is_uniform_over_groups() {
        let rng = &mut fastrand::Rng::with_seed(2);
        let n = 100_000;
        let mut sums = [0.0; 6];
        for _ in 0..n {
            let mut sampler = Sampler::new(rng);
            let p = (0..6).map(|_| sampler.draw()).last().expect("six points");
            (0..5).for_each(|d| sums[d] += p[d] - 0.5);
            sums[5] += (p[0] - 0.5) * (p[1] - 0.5);
        }
        // Five standard errors: σ = 0.289, of the product 0.083.
        assert!(sums[..5].iter().all(|s| (s / f64::from(n)).abs() < 5.0 * 0.289 / f64::from(n).sqrt()), "{sums:?}");
        assert!((sums[5] / f64::from(n)).abs() < 5.0 * 0.0834 / f64::from(n).sqrt(), "{sums:?}");
    }

    #[test]
    fn the_disk_keeps_areas() {
        // Second moments of the uniform disk: 1/4, and nothing beyond the rim.
        let (n, mut moment) = (400, DVec2::ZERO);
        for i in 0..n * n {
            let u = [(i % n) as f64 + 0.5, (i / n) as f64 + 0.5].map(|v| v / n as f64);
            let q = disk_from_square(u);
            assert!(q.length() < 1.0);
            moment += q * q / (n * n) as f64;
        }
        assert!((moment - 0.25).length() < 1e-5, "{moment}");
        assert_eq!(disk_from_square([0.5, 0.5]), DVec2::ZERO);
    }
}
