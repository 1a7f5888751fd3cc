//! How much detail photographs show: it decides which of them a plan for all is made with.

use isoplanat_base::error::Result;
use ndarray::{Array3, Axis, s};
use rayon::prelude::*;

/// Photographs that are looked at before a plan, at most.
pub const LOOKED: usize = 64;
/// Photographs that a plan is made with, at most: all of them stay in memory while it is made.
pub const PLANNED: usize = 8;

/// `most` of `count` photographs, evenly over the list; all where there are no more.
pub fn spread(count: usize, most: usize) -> Vec<usize> {
    let taken = count.min(most);
    (0..taken).map(|k| k * count / taken).collect()
}

/// Which of `count` photographs a plan for all is made with, by the [`detail`] that `look` finds in each.
///
/// # Errors
/// Those of `look`.
pub fn deciding(count: usize, look: impl Fn(usize) -> Result<f64> + Sync) -> Result<Vec<usize>> {
    let looked = spread(count, LOOKED);
    let details = looked.par_iter().map(|photo| look(*photo)).collect::<Result<Vec<f64>>>()?;
    Ok(sharpest(&details).into_iter().map(|k| looked[k]).collect())
}

/// Of photographs with these details the eighth that shows the most, one at least, in their order. What
/// such a plan holds, the others hold as well: errors of kernels grow with detail.
fn sharpest(details: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..details.len()).collect();
    order.sort_by(|a, b| details[*b].total_cmp(&details[*a]).then(a.cmp(b)));
    order.truncate(details.len().div_ceil(LOOKED / PLANNED).clamp(1, PLANNED));
    order.sort_unstable();
    order
}

/// Mean square difference of neighbouring pixels in a picture that shows so many texels of `texture`, `[channel, row, col]`, to a pixel.
pub fn detail(texture: &Array3<f32>, texels_per_pixel: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "texels a pixel")]
    let side = (texels_per_pixel.round() as usize).max(1);
    let (channels, rows, cols) = texture.dim();
    let (rows, cols) = (rows / side, cols / side);
    if rows < 2 || cols < 2 {
        return 0.0;
    }
    let mut sum = 0.0;
    for plane in texture.axis_iter(Axis(0)) {
        // Means over the texels of a pixel, a row of pixels at a time.
        let pixels = |i: usize| -> Vec<f64> {
            let strip = plane.slice(s![i * side..(i + 1) * side, ..cols * side]);
            let mean =
                |j: usize| strip.slice(s![.., j * side..(j + 1) * side]).iter().map(|v| f64::from(*v)).sum::<f64>();
            (0..cols).map(|j| mean(j) / (side * side) as f64).collect()
        };
        let mut above = pixels(0);
        for i in 1..rows {
            let here = pixels(i);
            sum += here.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>();
            sum += here.iter().zip(&above).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            above = here;
        }
    }
    sum / (channels * (rows - 1) * (2 * cols - 1)) as f64 * (texels_per_pixel / side as f64).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a wave of two pixels' length every difference across it is its full height, of one of many pixels the sum of sin² (closed form); fewer texels to a
    /// pixel show less.
    #[test]
    fn detail_of_waves() {
        let wave = |length: f64, texels: usize| {
            Array3::from_shape_fn((3, 40 * texels, 400 * texels), |(_, _, j)| {
                let pixel = (j as f64 + 0.5) / texels as f64;
                (0.5 + 0.5 * (std::f64::consts::TAU * pixel / length).sin()) as f32
            })
        };
        let own = |length: f64| 0.5 * (std::f64::consts::PI / length).sin().powi(2) * 0.5;
        for length in [10.0, 40.0] {
            let found = detail(&wave(length, 1), 1.0);
            assert!((found / own(length) - 1.0).abs() < 0.02, "{length}: {found} for {}", own(length));
            // Means over three texels dampen the wave by a sinc.
            let x = std::f64::consts::PI / length;
            let (found, wanted) = (detail(&wave(length, 3), 3.0), own(length) * (x.sin() / x).powi(2));
            assert!((found / wanted - 1.0).abs() < 0.02, "{length}: {found} for {wanted}");
        }
        assert!((detail(&wave(40.0, 1), 0.5) / own(40.0) - 0.25).abs() < 0.01);
        assert_eq!((detail(&Array3::zeros((3, 9, 9)), 1.0), detail(&wave(10.0, 1), 30.0)), (0.0, 0.0));
    }

    #[test]
    fn those_with_the_most_detail_decide() {
        assert_eq!(sharpest(&[1.0, 3.0, 2.0]), [1]);
        assert_eq!(sharpest(&[0.0, 5.0, 1.0, 2.0, 9.0, 3.0, 3.0, 3.0].repeat(2)), [4, 12]);
        let many: Vec<f64> = (0..64).map(f64::from).collect();
        assert_eq!(sharpest(&many), (56..64).collect::<Vec<_>>());
        assert_eq!(spread(3, LOOKED), [0, 1, 2]);
        assert_eq!((spread(640, LOOKED).len(), spread(640, LOOKED)[63]), (64, 630));
    }
}
