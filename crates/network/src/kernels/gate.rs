//! The product of a picture's first and second half of channels, and its cotangent.

use rayon::prelude::*;

use super::strip::filled;
use super::{Extent, Level};
use isoplanat_base::math::simd::{Kernel, Simd};

/// Output `[batch, channels / 2, rows, columns]` of `values`, `[batch, channels, rows, columns]`.
pub(in super::super) fn gate(level: Level, values: &[f32], extent: Extent) -> Vec<f32> {
    let halves = Halves::new(values, extent);
    filled(values.len() / 2, |output| {
        output.par_chunks_mut(extent.plane()).enumerate().for_each(|(plane, to)| {
            let (image, channel) = (plane / halves.channels, plane % halves.channels);
            let [a, b] = [0, 1].map(|half| halves.plane(image, half, channel));
            level.run(Product { a, b, to });
        });
    })
}

/// Cotangent of [`gate`]'s values.
pub(in super::super) fn gate_vjp(level: Level, values: &[f32], extent: Extent, output_bar: &[f32]) -> Vec<f32> {
    let halves = Halves::new(values, extent);
    assert_eq!(output_bar.len(), values.len() / 2);
    filled(values.len(), |bars| {
        bars.par_chunks_mut(extent.plane()).enumerate().for_each(|(plane, to)| {
            let (image, channel) = (plane / (2 * halves.channels), plane % (2 * halves.channels));
            let (half, channel) = (channel / halves.channels, channel % halves.channels);
            let a = halves.plane(image, 1 - half, channel);
            let b = &output_bar[(image * halves.channels + channel) * extent.plane()..][..extent.plane()];
            level.run(Product { a, b, to });
        });
    })
}

/// Pictures whose channels are read in two halves.
struct Halves<'a> {
    values: &'a [f32],
    extent: Extent,
    /// Of one half.
    channels: usize,
}

impl<'a> Halves<'a> {
    /// # Panics
    /// Where there are no whole pictures of an even number of channels.
    fn new(values: &'a [f32], extent: Extent) -> Self {
        let halves = extent.batch * 2 * extent.plane();
        assert!(values.len().is_multiple_of(halves), "{} values, {extent:?}", values.len());
        Self { values, extent, channels: values.len() / halves }
    }

    fn plane(&self, image: usize, half: usize, channel: usize) -> &'a [f32] {
        let plane = self.extent.plane();
        &self.values[((2 * image + half) * self.channels + channel) * plane..][..plane]
    }
}

struct Product<'a> {
    a: &'a [f32],
    b: &'a [f32],
    to: &'a mut [f32],
}

impl Kernel for Product<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { a, b, to } = self;
        let ((a, a_rest), (b, b_rest), (to, to_rest)) = (simd.cut(a), simd.cut(b), simd.cut_mut(to));
        for ((a, b), to) in a.iter().zip(b).zip(to) {
            simd.store(to, simd.mul(simd.load(a), simd.load(b)));
        }
        simd.store_first(to_rest, simd.mul(simd.load_first(a_rest), simd.load_first(b_rest)));
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::draw;
    use super::*;

    #[test]
    fn gates_and_cotangents_match_plain_loops() {
        for level in Level::available() {
            let rng = &mut fastrand::Rng::with_seed(8);
            for (channels, batch, rows, columns) in [(1, 1, 1, 1), (3, 2, 5, 7), (2, 3, 16, 16), (5, 1, 9, 33)] {
                let extent = Extent { batch, rows, columns };
                let half = channels * extent.plane();
                let values = draw(2 * batch * half, rng);
                let bar = draw(batch * half, rng);
                let at = |i: usize| i / half * 2 * half + i % half;
                let output: Vec<f32> = (0..bar.len()).map(|i| values[at(i)] * values[at(i) + half]).collect();
                assert_eq!(gate(level, &values, extent), output, "{level:?} {channels} {extent:?}");
                let mut expected = vec![0.0; values.len()];
                for (i, bar) in bar.iter().enumerate() {
                    expected[at(i)] = bar * values[at(i) + half];
                    expected[at(i) + half] = bar * values[at(i)];
                }
                assert_eq!(gate_vjp(level, &values, extent, &bar), expected, "{level:?} {channels} {extent:?}");
            }
        }
    }
}
