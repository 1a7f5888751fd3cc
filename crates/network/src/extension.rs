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

/// Registers a cotangent of shape `$shape` where its node asks for it.
macro_rules! register {
    ($grads:ident, $node:expr, $values:expr, $shape:expr) => {
        if let Some(node) = $node {
            $grads.register::<Flex>(node.id, primitive($values, $shape));
        }
    };
}

#[derive(Debug)]
struct ConvolvePlain;

impl Backward<Flex, 3> for ConvolvePlain {
    type State = ([Primitive; 2], Level);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, weight], level) = ops.state;
        let wanted = Wanted { inputs: x_node.is_some(), weights: weight_node.is_some() || bias_node.is_some() };
        let (mut sources, weight_bar, bias_bar) =
            kernels::convolve_vjp(level, &[source(&x, None)], extent(&x), values(&weight), values(&bar), wanted);
        register!(grads, x_node, sources.remove(0).values, dims::<4>(&x));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x]);
    }
}

#[derive(Debug)]
struct ConvolveActivated;

impl Backward<Flex, 4> for ConvolveActivated {
    type State = ([Primitive; 3], Level);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, slope_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, slope, weight], level) = ops.state;
        let wanted = Wanted {
            inputs: x_node.is_some() || slope_node.is_some(),
            weights: weight_node.is_some() || bias_node.is_some(),
        };
        let sources = [source(&x, Some(&slope))];
        let (mut bars, weight_bar, bias_bar) =
            kernels::convolve_vjp(level, &sources, extent(&x), values(&weight), values(&bar), wanted);
        let SourceBar { values: x_bar, slope: slope_bar } = bars.remove(0);
        register!(grads, x_node, x_bar, dims::<4>(&x));
        register!(grads, slope_node, slope_bar, dims::<1>(&slope));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x]);
    }
}

#[derive(Debug)]
struct ConvolveJoined;

impl Backward<Flex, 5> for ConvolveJoined {
    type State = ([Primitive; 4], Level);

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, slope_node, plain_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, slope, plain, weight], level) = ops.state;
        let wanted = Wanted {
            inputs: x_node.is_some() || slope_node.is_some() || plain_node.is_some(),
            weights: weight_node.is_some() || bias_node.is_some(),
        };
        let sources = [source(&x, Some(&slope)), source(&plain, None)];
        let (mut bars, weight_bar, bias_bar) =
            kernels::convolve_vjp(level, &sources, extent(&x), values(&weight), values(&bar), wanted);
        let SourceBar { values: x_bar, slope: slope_bar } = bars.remove(0);
        register!(grads, x_node, x_bar, dims::<4>(&x));
        register!(grads, slope_node, slope_bar, dims::<1>(&slope));
        register!(grads, plain_node, bars.remove(0).values, dims::<4>(&plain));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x, plain]);
    }
}

#[derive(Debug)]
struct DepthwiseActivated;

impl Backward<Flex, 4> for DepthwiseActivated {
    type State = ([Primitive; 3], Level);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, slope_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, slope, weight], level) = ops.state;
        let wanted = Wanted {
            inputs: x_node.is_some() || slope_node.is_some(),
            weights: weight_node.is_some() || bias_node.is_some(),
        };
        let of = source(&x, Some(&slope));
        let (source_bar, weight_bar, bias_bar) =
            kernels::depthwise_vjp(level, of, extent(&x), values(&weight), values(&bar), wanted);
        register!(grads, x_node, source_bar.values, dims::<4>(&x));
        register!(grads, slope_node, source_bar.slope, dims::<1>(&slope));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x]);
    }
}

#[derive(Debug)]
struct ConvolveColumns;

impl Backward<Flex, 3> for ConvolveColumns {
    type State = ([Primitive; 2], (Level, Taps));

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, weight], (level, taps)) = ops.state;
        let wanted = Wanted { inputs: x_node.is_some(), weights: weight_node.is_some() || bias_node.is_some() };
        let (x_bar, weight_bar, bias_bar) =
            columns::convolve_vjp(level, taps, source(&x, None), extent(&x), values(&weight), values(&bar), wanted);
        register!(grads, x_node, x_bar, dims::<4>(&x));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x]);
    }
}

#[derive(Debug)]
struct GatePlain;

impl Backward<Flex, 1> for GatePlain {
    type State = ([Primitive; 1], Level);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x], level) = ops.state;
        let x_bar = kernels::gate_vjp(level, values(&x), extent(&x), values(&bar));
        register!(grads, x_node, x_bar, dims::<4>(&x));
        release([bar, x]);
    }
}

#[derive(Debug)]
struct PoolActivated;

impl Backward<Flex, 2> for PoolActivated {
    type State = ([Primitive; 2], Level);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, slope_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, slope], level) = ops.state;
        let source_bar = kernels::pool_vjp(level, source(&x, Some(&slope)), extent(&x), values(&bar));
        register!(grads, x_node, source_bar.values, dims::<4>(&x));
        register!(grads, slope_node, source_bar.slope, dims::<1>(&slope));
        release([bar, x]);
    }
}

#[derive(Debug)]
struct UnpoolActivated;

impl Backward<Flex, 4> for UnpoolActivated {
    type State = ([Primitive; 3], Level);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [x_node, slope_node, weight_node, bias_node] = ops.parents;
        let bar = contiguous(grads.consume::<Flex>(&ops.node));
        let ([x, slope, weight], level) = ops.state;
        let wanted = Wanted {
            inputs: x_node.is_some() || slope_node.is_some(),
            weights: weight_node.is_some() || bias_node.is_some(),
        };
        let (source_bar, weight_bar, bias_bar) =
            kernels::unpool_vjp(level, source(&x, Some(&slope)), extent(&x), values(&weight), values(&bar), wanted);
        register!(grads, x_node, source_bar.values, dims::<4>(&x));
        register!(grads, slope_node, source_bar.slope, dims::<1>(&slope));
        let outputs = bias_bar.len();
        register!(grads, weight_node, weight_bar, dims::<4>(&weight));
        register!(grads, bias_node, bias_bar, [outputs]);
        release([bar, x]);
    }
}

/// Runs the kernel on the inner tensors and registers `$step`, which keeps the tensors `$kept`.
macro_rules! tracked {
    ($step:expr, [$($input:ident),+], [$($kept:ident),+], $level:ident, $forward:ident) => {
        match $step.prepare::<C>([$($input.node()),+]).compute_bound().stateful() {
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
        tracked!(ConvolvePlain, [x, weight, bias], [x, weight], level, convolve_plain)
    }

    fn convolve_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(ConvolveActivated, [x, slope, weight, bias], [x, slope, weight], level, convolve_activated)
    }

    fn convolve_joined(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        plain: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(ConvolveJoined, [x, slope, plain, weight, bias], [x, slope, plain, weight], level, convolve_joined)
    }

    fn depthwise_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(DepthwiseActivated, [x, slope, weight, bias], [x, slope, weight], level, depthwise_activated)
    }

    fn gate_plain(x: FloatTensor<Self>, level: Level) -> FloatTensor<Self> {
        tracked!(GatePlain, [x], [x], level, gate_plain)
    }

    fn convolve_columns(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        how: (Level, Taps),
    ) -> FloatTensor<Self> {
        tracked!(ConvolveColumns, [x, weight, bias], [x, weight], how, convolve_columns)
    }

    fn pool_activated(x: FloatTensor<Self>, slope: FloatTensor<Self>, level: Level) -> FloatTensor<Self> {
        tracked!(PoolActivated, [x, slope], [x, slope], level, pool_activated)
    }

    fn unpool_activated(
        x: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        level: Level,
    ) -> FloatTensor<Self> {
        tracked!(UnpoolActivated, [x, slope, weight, bias], [x, slope, weight], level, unpool_activated)
    }
}
