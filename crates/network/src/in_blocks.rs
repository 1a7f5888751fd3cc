//! Operations on pictures block by block, for devices whose gradients are wrong on large planes.
//!
//! burn 0.22.1 on wgpu loses part of the weight gradient of a convolution whose output has more than some 20,000 pixels
//! (a batch counts as one plane). The sum over blocks is the same gradient.

use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;

use isoplanat_base::math::raster::parts;

/// Most rows, and most columns, of a block, pixels.
const SIDE: usize = 128;

/// `run` on blocks of at most [`SIDE`]² pixels, put together again. `run` sees `border` pixels more on every side than it
/// answers for, zeros beyond the picture; it may change the scale.
///
/// # Shapes
/// `[batch, channel, row, col]`.
pub(super) fn in_blocks(x: Tensor<4>, border: usize, run: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
    let [batch, _, rows, columns] = x.dims();
    let x = if border > 0 { x.pad((border, border, border, border), PadMode::Constant(0.0)) } else { x };
    let pictures = (SIDE * SIDE / (rows.min(SIDE) * columns.min(SIDE)).max(1)).max(1);
    let joined = |mut all: Vec<Tensor<4>>, axis: usize| {
        if all.len() == 1 { all.remove(0) } else { Tensor::cat(all, axis) }
    };
    let of_pictures = parts(batch, pictures).map(|of| {
        let some = x.clone().narrow(0, of.start, of.len());
        let bands = parts(rows, SIDE).map(|row| {
            let band = some.clone().narrow(2, row.start, row.len() + 2 * border);
            let blocks =
                parts(columns, SIDE).map(|column| run(band.clone().narrow(3, column.start, column.len() + 2 * border)));
            joined(blocks.collect(), 3)
        });
        joined(bands.collect(), 2)
    });
    joined(of_pictures.collect(), 0)
}

#[cfg(test)]
mod tests {
    use burn::tensor::module::conv2d;
    use burn::tensor::ops::ConvOptions;
    use burn::tensor::{Device, TensorData};

    use super::*;

    /// A convolution by blocks is the whole one, and so are its gradients: ragged sides, a batch, strides of one and two.
    #[test]
    fn blocks_together_are_the_whole() {
        let device = Device::flex().autodiff();
        let rng = &mut fastrand::Rng::with_seed(2);
        let mut draw = |shape: [usize; 4]| -> Tensor<4> {
            let values: Vec<f32> = (0..shape.iter().product()).map(|_| rng.f32() - 0.5).collect();
            Tensor::from_data(TensorData::new(values, shape), &device).require_grad()
        };
        for (shape, kernel, stride) in
            [([1, 2, 150, 260], 3, 1), ([3, 2, 130, 140], 3, 1), ([9, 2, 40, 64], 3, 1), ([2, 3, 256, 130], 4, 2)]
        {
            let (x, w) = (draw(shape), draw([4, shape[1], kernel, kernel]));
            let convolve = |x: Tensor<4>, padding: usize| {
                conv2d(x, w.clone(), None, ConvOptions::new([stride; 2], [padding; 2], [1, 1], 1))
            };
            let gradients = |y: &Tensor<4>| {
                let g = (y.clone() * y.clone()).sum().backward();
                [&x, &w].map(|t| t.grad(&g).expect("tracked").into_data().try_into_vec::<f32>().expect("f32"))
            };
            let (whole, cut) = (convolve(x.clone(), 1), in_blocks(x.clone(), 1, |x| convolve(x, 0)));
            assert_eq!(whole.dims(), cut.dims());
            let close = |a: &[f32], b: &[f32]| {
                let scale = b.iter().fold(0f32, |m, v| m.max(v.abs()));
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * scale)
            };
            let values = |t: &Tensor<4>| t.clone().into_data().try_into_vec::<f32>().expect("f32");
            assert!(close(&values(&cut), &values(&whole)), "{shape:?}");
            for (a, b) in gradients(&cut).iter().zip(&gradients(&whole)) {
                assert!(close(a, b), "{shape:?}");
            }
        }
    }
}
