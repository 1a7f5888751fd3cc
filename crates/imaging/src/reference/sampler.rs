//! Points for one pixel: five numbers a ray, spread evenly together, each uniform on its own.
//!
//! The first five Sobol' dimensions (direction numbers: S. Joe, F. Y. Kuo, "Constructing Sobol sequences with better
//! two-dimensional projections", SIAM J. Sci. Comput. 30(5), 2008) in Gray-code order, every group with a digital shift
//! of its own: an exclusive or with 32 random bits keeps the net and makes every point uniform, so means are unbiased
//! and groups are independent. On smooth colour waves through the two-element lens, 64 rays in two groups leave a third
//! of the noise of independent draws (RMS 0.0060 against 0.0162).

use glam::DVec2;

use isoplanat_optics::trace::lanes::TILE;

/// Pupil, place in the pixel, wavelength.
pub(super) const DIMENSIONS: usize = 5;

/// Direction numbers, most significant bit first.
const SOBOL: [[u32; 32]; DIMENSIONS] = [
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

/// The first points of the sequence, dimension by dimension.
const FIRST: [[u32; TILE]; DIMENSIONS] = {
    let mut table = [[0; TILE]; DIMENSIONS];
    let mut d = 0;
    while d < DIMENSIONS {
        let mut k = 1;
        while k < TILE {
            table[d][k] = table[d][k - 1] ^ SOBOL[d][(k as u32).trailing_zeros() as usize];
            k += 1;
        }
        d += 1;
    }
    table
};

/// The points of one group of rays: 32 bits a dimension, of which [`unit`] makes numbers.
#[derive(Clone, Copy)]
pub(super) struct Group {
    shift: [u32; DIMENSIONS],
}

impl Group {
    /// A group of its own.
    pub(super) fn new(rng: &mut fastrand::Rng) -> Self {
        Self { shift: std::array::from_fn(|_| rng.u32(..)) }
    }

    /// Point `TILE * block` in the exclusive-or form that [`Self::bits`] takes; the sequence repeats after 2³² points.
    ///
    /// Gray code is linear: point `TILE * block + k` is point `TILE * block` xor point `k`.
    pub(super) fn block(&self, block: usize) -> Self {
        let first = (block * TILE) as u32;
        let gray = first ^ (first >> 1);
        let mut shift = self.shift;
        for (bit, _) in (0..32).map(|bit| (bit, (gray >> bit) & 1)).filter(|(_, set)| *set == 1) {
            shift.iter_mut().zip(&SOBOL).for_each(|(x, v)| *x ^= v[bit]);
        }
        Self { shift }
    }

    /// Dimension `d` of the block's points from number `from` on, one for each entry of `to`.
    #[inline]
    pub(super) fn bits(&self, d: usize, from: usize, to: &mut [u32]) {
        let shift = self.shift[d];
        to.iter_mut().zip(&FIRST[d][from..]).for_each(|(to, first)| *to = first ^ shift);
    }
}

/// 32 random bits as a number in `(0, 1)`, never exactly ½.
#[inline(always)]
pub(super) fn unit(bits: u32) -> f64 {
    // The lower half of the signed numbers stands for the lower half of the interval.
    (f64::from((bits ^ 0x8000_0000).cast_signed()) + 2_147_483_648.5) * (1.0 / 4_294_967_296.0)
}

/// `sin` and `cos` of `π x/4`, `|x| ≤ 1`, to 1e-12: the series, without branches.
#[inline(always)]
fn sin_cos_quarter(x: f64) -> (f64, f64) {
    let a = std::f64::consts::FRAC_PI_4 * x;
    let s = a * a;
    let sin = 1.0
        + s * (-1.0 / 6.0
            + s * (1.0 / 120.0
                + s * (-1.0 / 5040.0
                    + s * (1.0 / 362_880.0 + s * (-1.0 / 39_916_800.0 + s * (1.0 / 6_227_020_800.0))))));
    let cos = 1.0
        + s * (-0.5
            + s * (1.0 / 24.0
                + s * (-1.0 / 720.0 + s * (1.0 / 40_320.0 + s * (-1.0 / 3_628_800.0 + s * (1.0 / 479_001_600.0))))));
    (a * sin, cos)
}

/// A point of the unit disk from one of the unit square, areas kept in proportion and neighbours kept together.
///
/// P. Shirley, K. Chiu, "A low distortion map between disk and square", J. Graphics Tools 2(3), 1997; written without
/// branches.
#[inline(always)]
pub(super) fn disk_from_square(u: [f64; 2]) -> DVec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let swap = a.abs() <= b.abs();
    let (large, small) = if swap { (b, a) } else { (a, b) };
    let (sin, cos) = sin_cos_quarter(small / if large == 0.0 { 1.0 } else { large });
    let (along, across) = (large * cos, large * sin);
    if swap { DVec2::new(across, along) } else { DVec2::new(along, across) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(group: &Group, count: usize) -> Vec<[f64; 5]> {
        let mut bits = [[0; TILE]; 5];
        (0..5).for_each(|d| group.bits(d, 0, &mut bits[d]));
        (0..count).map(|k| std::array::from_fn(|d| unit(bits[d][k]))).collect()
    }

    /// Blocks go on where the sequence in Gray-code order, one direction number a step, does.
    #[test]
    fn blocks_follow_the_sequence() {
        let group = Group { shift: [3, 1 << 31, 77, 0, u32::MAX] };
        let mut state = group.shift;
        for k in 0..1000usize {
            let mut bits = [[0]; 5];
            (0..5).for_each(|d| group.block(k / TILE).bits(d, k % TILE, &mut bits[d]));
            assert_eq!(bits.map(|b| b[0]), state, "point {k}");
            let bit = (k as u32 + 1).trailing_zeros() as usize;
            state.iter_mut().zip(&SOBOL).for_each(|(x, v)| *x ^= v[bit]);
        }
        assert_eq!([0, u32::MAX].map(unit), [0.5 / 4_294_967_296.0, 1.0 - 0.5 / 4_294_967_296.0]);
    }

    #[test]
    fn the_series_is_the_sine() {
        for i in -1000..=1000 {
            let x = f64::from(i) * 1e-3;
            let (sin, cos) = sin_cos_quarter(x);
            let exact = (std::f64::consts::FRAC_PI_4 * x).sin_cos();
            assert!((sin - exact.0).abs() < 1e-13 && (cos - exact.1).abs() < 1e-12, "{x}: {sin} {cos} {exact:?}");
        }
    }

    /// Every dimension of the first 2^k points has one point in each of 2^k bins, and so have 4 × 4 boxes of pairs of 16.
    #[test]
    fn groups_are_nets() {
        let rng = &mut fastrand::Rng::with_seed(1);
        for _ in 0..20 {
            let points = points(&Group::new(rng), 64);
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
            let p = points(&Group::new(rng), 6)[5];
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
