//! The kernels as burn operations on Flex, with their derivatives: burn's graph calls them like its own.
//!
//! Each operation exists for `Flex` (the kernel) and for `Autodiff<Flex>` (the kernel and a step back). The cotangents that
//! nothing asks for (a frozen network, an input without gradient) are not computed.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, TensorMetadata, backend_extension};
use burn::tensor::TensorData;

use super::kernels::columns::{self, Taps};
use super::kernels::{self, Extent, Level, Source, SourceBar, Wanted};

/// The operations; semantics as in `layers`.
#[backend_extension(Flex, Autodiff)]
pub(super) trait FastOps: Backend {
    /// 3×3 or 1×1 convolution of a picture without activation.
    fn convolve_plain(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self>;

    /// 3×3 or 1×1 convolution of an activated picture.
    fn convolve_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self>;

    /// 3×3 or 1×1 convolution of the channels of an activated picture, then those of a plain one.
    fn convolve_joined(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        plain: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self>;

    /// Depthwise 3×3 convolution of an activated picture.
    fn depthwise_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self>;

    /// The product of a plain picture's first and second half of channels.
    fn gate_plain(x: FloatTensor<Self>, level: Level) -> FloatTensor<Self>;

    /// Convolution of a picture without activation by a kernel of any size and stride.
    fn convolve_columns(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        how: (Level, Taps),
    ) -> FloatTensor<Self>;

    /// 2×2 max-pooling of an activated picture.
    fn pool_activated(x: FloatTensor<Self>, slope: FloatTensor<Self>, level: Level) -> FloatTensor<Self>;

    /// Transposed 2×2 convolution of an activated picture.
    fn unpool_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self>;
}

type Primitive = FloatTensor<Flex>;

/// The same tensor in row-major order from the start of its memory.
fn contiguous(tensor: Primitive) -> Primitive {
    if tensor.is_contiguous() && tensor.layout().start_offset() == 0 { tensor } else { tensor.to_contiguous() }
}

fn values(tensor: &Primitive) -> &[f32] {
    &tensor.storage::<f32>()[..tensor.shape().num_elements()]
}

fn dims<const D: usize>(tensor: &Primitive) -> [usize; D] {
    tensor.shape().dims()
}

fn primitive<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Primitive {
    Primitive::from_data(TensorData::new(values, shape))
}

/// Keeps the memory of tensors nobody else holds for the next operations.
fn release<const N: usize>(tensors: [Primitive; N]) {
    for tensor in tensors {
        if tensor.is_unique()
            && tensor.is_contiguous()
            && let Ok(values) = tensor.into_data().try_into_vec::<f32>()
        {
            kernels::give(values);
        }
    }
}

fn source<'a>(x: &'a Primitive, slope: Option<&'a Primitive>) -> Source<'a> {
    Source { values: values(x), channels: dims::<4>(x)[1], slope: slope.map(values) }
}

fn extent(x: &Primitive) -> Extent {
    let [batch, _, rows, columns] = dims(x);
    Extent { batch, rows, columns }
}

fn convolve(sources: &[Source], extent: Extent, weight: &Primitive, bias: &Primitive, level: Level) -> Primitive {
    let output = kernels::convolve(level, sources, extent, values(weight), values(bias));
    primitive(output, [extent.batch, dims::<1>(bias)[0], extent.rows, extent.columns])
}

impl FastOps for Flex {
    fn convolve_plain(x: Primitive, weight: Primitive, bias: Primitive, level: Level) -> Primitive {
        let [x, weight, bias] = [x, weight, bias].map(contiguous);
        let output = convolve(&[source(&x, None)], extent(&x), &weight, &bias, level);
        release([x]);
        output
    }

    fn convolve_activated(
        x: Primitive,
        slope: Primitive,
        weight: Primitive,
        bias: Primitive,
        level: Level,
    ) -> Primitive {
        let [x, slope, weight, bias] = [x, slope, weight, bias].map(contiguous);
        let output = convolve(&[source(&x, Some(&slope))], extent(&x), &weight, &bias, level);
        release([x]);
        output
    }

    fn convolve_joined(
        x: Primitive,
        slope: Primitive,
        plain: Primitive,
        weight: Primitive,
        bias: Primitive,
        level: Level,
    ) -> Primitive {
        let [x, slope, plain, weight, bias] = [x, slope, plain, weight, bias].map(contiguous);
        let sources = [source(&x, Some(&slope)), source(&plain, None)];
        let output = convolve(&sources, extent(&x), &weight, &bias, level);
        release([x, plain]);
        output
    }

    fn depthwise_activated(
        x: Primitive,
        slope: Primitive,
        weight: Primitive,
        bias: Primitive,
        level: Level,
    ) -> Primitive {
        let [x, slope, weight, bias] = [x, slope, weight, bias].map(contiguous);
        let output = kernels::depthwise(level, source(&x, Some(&slope)), extent(&x), values(&weight), values(&bias));
        let shape = dims::<4>(&x);
        release([x]);
        primitive(output, shape)
    }

    fn gate_plain(x: Primitive, level: Level) -> Primitive {
        let x = contiguous(x);
        let [batch, channels, rows, columns] = dims(&x);
        let output = kernels::gate(level, values(&x), extent(&x));
        release([x]);
        primitive(output, [batch, channels / 2, rows, columns])
    }

    fn convolve_columns(x: Primitive, weight: Primitive, bias: Primitive, (level, taps): (Level, Taps)) -> Primitive {
        let [x, weight, bias] = [x, weight, bias].map(contiguous);
        let (extent, out) = (extent(&x), taps.output(extent(&x)));
        let output = columns::convolve(level, taps, source(&x, None), extent, values(&weight), values(&bias));
        release([x]);
        primitive(output, [out.batch, dims::<1>(&bias)[0], out.rows, out.columns])
    }

    fn pool_activated(x: Primitive, slope: Primitive, level: Level) -> Primitive {
        let [x, slope] = [x, slope].map(contiguous);
        let [batch, channels, rows, columns] = dims(&x);
        let output = kernels::pool(level, source(&x, Some(&slope)), extent(&x));
        release([x]);
        primitive(output, [batch, channels, rows / 2, columns / 2])
    }

    fn unpool_activated(x: Primitive, slope: Primitive, weight: Primitive, bias: Primitive, level: Level) -> Primitive {
        let [x, slope, weight, bias] = [x, slope, weight, bias].map(contiguous);
        let [batch, _, rows, columns] = dims(&x);
        let output = kernels::unpool(level, source(&x, Some(&slope)), extent(&x), values(&weight), values(&bias));
        release([x]);
        primitive(output, [batch, dims::<1>(&bias)[0], 2 * rows, 2 * columns])
    }
}

/// The way back through an operation of `N` inputs: what it keeps (its inputs in order; of a convolution all but the bias), how it was run and the cotangent of its
/// output give those of all inputs. The pictures that it kept are released there.
type Vjp<const N: usize, const K: usize, H> = fn([Primitive; K], H, &Primitive, Wanted) -> [Vec<f32>; N];

/// A step back in burn's graph.
#[derive(Debug)]
struct Back<const N: usize, const K: usize, H>(Vjp<N, K, H>);

impl<const N: usize, const K: usize, H> Backward<Flex, N> for Back<N, K, H>
where
    H: Clone + std::fmt::Debug + Send + 'static,
{
    type State = ([Primitive; K], H);

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let (kept, how) = ops.state;
        // A convolution's last two inputs are its weights and its bias.
        let (pictures, weights) = ops.parents.split_at(N.saturating_sub(2));
        let asked = |nodes: &[Option<_>]| nodes.iter().any(Option::is_some);
        let wanted = Wanted { inputs: asked(pictures), weights: asked(weights) };
        let shapes = kept.each_ref().map(TensorMetadata::shape);
        let bars = (self.0)(kept, how, &bar, wanted);
        for (k, (node, values)) in ops.parents.into_iter().zip(bars).enumerate() {
            if let Some(node) = node {
                let shape = shapes.get(k).cloned().unwrap_or_else(|| [values.len()].into());
                grads.register::<Flex>(node.id, Primitive::from_data(TensorData::new(values, shape)));
            }
        }
        release([bar]);
    }
}

fn convolve_plain_vjp([x, weight]: [Primitive; 2], level: Level, bar: &Primitive, wanted: Wanted) -> [Vec<f32>; 3] {
    let (mut sources, weight_bar, bias_bar) =
        kernels::convolve_vjp(level, &[source(&x, None)], extent(&x), values(&weight), values(bar), wanted);
    release([x]);
    [sources.remove(0).values, weight_bar, bias_bar]
}

fn convolve_activated_vjp(
    [x, slope, weight]: [Primitive; 3],
    level: Level,
    bar: &Primitive,
    wanted: Wanted,
) -> [Vec<f32>; 4] {
    let sources = [source(&x, Some(&slope))];
    let (mut bars, weight_bar, bias_bar) =
        kernels::convolve_vjp(level, &sources, extent(&x), values(&weight), values(bar), wanted);
    release([x]);
    let SourceBar { values, slope } = bars.remove(0);
    [values, slope, weight_bar, bias_bar]
}

fn convolve_joined_vjp(
    [x, slope, plain, weight]: [Primitive; 4],
    level: Level,
    bar: &Primitive,
    wanted: Wanted,
) -> [Vec<f32>; 5] {
    let sources = [source(&x, Some(&slope)), source(&plain, None)];
    let (mut bars, weight_bar, bias_bar) =
        kernels::convolve_vjp(level, &sources, extent(&x), values(&weight), values(bar), wanted);
    release([x, plain]);
    let SourceBar { values, slope } = bars.remove(0);
    [values, slope, bars.remove(0).values, weight_bar, bias_bar]
}

/// A kernel's way back to an activated picture, weights and biases.
type ActivatedVjp = fn(Level, Source, Extent, &[f32], &[f32], Wanted) -> (SourceBar, Vec<f32>, Vec<f32>);

fn activated_vjp(
    vjp: ActivatedVjp,
    [x, slope, weight]: [Primitive; 3],
    level: Level,
    bar: &Primitive,
    wanted: Wanted,
) -> [Vec<f32>; 4] {
    let (SourceBar { values, slope }, weight_bar, bias_bar) =
        vjp(level, source(&x, Some(&slope)), extent(&x), self::values(&weight), self::values(bar), wanted);
    release([x]);
    [values, slope, weight_bar, bias_bar]
}

fn convolve_columns_vjp(
    [x, weight]: [Primitive; 2],
    (level, taps): (Level, Taps),
    bar: &Primitive,
    wanted: Wanted,
) -> [Vec<f32>; 3] {
    let (x_bar, weight_bar, bias_bar) =
        columns::convolve_vjp(level, taps, source(&x, None), extent(&x), values(&weight), values(bar), wanted);
    release([x]);
    [x_bar, weight_bar, bias_bar]
}

fn gate_plain_vjp([x]: [Primitive; 1], level: Level, bar: &Primitive, _: Wanted) -> [Vec<f32>; 1] {
    let x_bar = kernels::gate_vjp(level, values(&x), extent(&x), values(bar));
    release([x]);
    [x_bar]
}

fn pool_activated_vjp([x, slope]: [Primitive; 2], level: Level, bar: &Primitive, _: Wanted) -> [Vec<f32>; 2] {
    let SourceBar { values, slope } = kernels::pool_vjp(level, source(&x, Some(&slope)), extent(&x), self::values(bar));
    release([x]);
    [values, slope]
}

/// Runs the kernel on the inner tensors and registers the way back by `$vjp`, which keeps the tensors `$kept`.
macro_rules! tracked {
    ($vjp:expr, [$($input:ident),+], [$($kept:ident),+], $level:ident, $forward:ident) => {
        match Back($vjp).prepare::<C>([$($input.node()),+]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                $(let $input = contiguous($input.into_primitive());)+
                let kept = [$($kept.clone()),+];
                let output = Flex::$forward($($input),+, $level);
                prep.finish((kept, $level), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(Flex::$forward($($input.into_primitive()),+, $level)),
        }
    };
}

impl<C: CheckpointStrategy> FastOps for Autodiff<Flex, C> {
    fn convolve_plain(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(convolve_plain_vjp, [x, weight, bias], [x, weight], level, convolve_plain)
    }

    fn convolve_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(convolve_activated_vjp, [x, slope, weight, bias], [x, slope, weight], level, convolve_activated)
    }

    fn convolve_joined(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        plain: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(
            convolve_joined_vjp,
            [x, slope, plain, weight, bias],
            [x, slope, plain, weight],
            level,
            convolve_joined
        )
    }

    fn depthwise_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(
            |kept, level, bar, wanted| activated_vjp(kernels::depthwise_vjp, kept, level, bar, wanted),
            [x, slope, weight, bias],
            [x, slope, weight],
            level,
            depthwise_activated
        )
    }

    fn gate_plain(x: FloatTensor<Self>, level: Level) -> FloatTensor<Self> {
        tracked!(gate_plain_vjp, [x], [x], level, gate_plain)
    }

    fn convolve_columns(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        how: (Level, Taps),
    ) -> FloatTensor<Self> {
        tracked!(convolve_columns_vjp, [x, weight, bias], [x, weight], how, convolve_columns)
    }

    fn pool_activated(x: FloatTensor<Self>, slope: FloatTensor<Self>, level: Level) -> FloatTensor<Self> {
        tracked!(pool_activated_vjp, [x, slope], [x, slope], level, pool_activated)
    }

    fn unpool_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(
            |kept, level, bar, wanted| activated_vjp(kernels::unpool_vjp, kept, level, bar, wanted),
            [x, slope, weight, bias],
            [x, slope, weight],
            level,
            unpool_activated
        )
    }
}
