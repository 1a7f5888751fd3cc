//! The network's operations as nodes of a graph, in order, as in the in-crate forward pass.

use std::collections::BTreeMap;

use onnx_rs::ast::{Attribute, AttributeType, DataType, Node, OpType};

use crate::learner::Parameter;
use crate::unet::{CHANNELS, UnetConfig};
use isoplanat_card::Blocks;

/// Names of the number by which changes are enlarged, and of its negative: a difference of sums and products needs no operator that cameras do not know.
pub(super) const CHANGE: [&str; 2] = ["change.gain", "change.less"];

/// Name of the axis of channels.
const CHANNEL_AXIS: &str = "cut.axis";

/// Name of a number of a channel at which slices begin or end.
fn cut(channel: usize) -> String {
    format!("cut.{channel}")
}

/// The whole numbers that slices of three channels ask for, by name.
pub(super) fn cuts(config: &UnetConfig) -> BTreeMap<String, i64> {
    let firsts = (0..=config.blended()).map(|bank| CHANNELS * bank).chain([config.base_channel()]);
    let ends = firsts.flat_map(|first| [first, first + CHANNELS]).chain([config.inputs.channels()]);
    let ends = ends.map(|at| (cut(at), at as i64));
    ends.chain([(CHANNEL_AXIS.to_owned(), 1)]).collect()
}

/// One node; a single output has its name.
pub(super) struct Operation {
    kind: Kind,
    name: String,
    inputs: Vec<String>,
    outputs: Vec<String>,
}

#[derive(Clone, Copy)]
enum Kind {
    Cast,
    /// With taps of this side.
    Convolution(i64),
    /// 3×3, of this many channels.
    Depthwise(i64),
    Activation,
    Pool,
    Unpool,
    Concatenation,
    Slice,
    /// Of a parameter, along its first axis.
    Halves,
    Product,
    Addition,
}

/// Operations so far.
struct Steps(Vec<Operation>);

impl Steps {
    /// Adds a node with one output, whose name it returns.
    fn push(&mut self, kind: Kind, name: &str, inputs: &[&str]) -> String {
        self.0.push(Operation::new(kind, name, inputs));
        name.to_owned()
    }

    /// A layer with the weights and the bias of its name.
    fn layer(&mut self, kind: Kind, name: &str, input: &str) -> String {
        self.push(kind, name, &[input, &format!("{name}.weight"), &format!("{name}.bias")])
    }

    /// Three channels of `of`.
    fn colours(&mut self, name: &str, of: &str, first: usize) -> String {
        self.push(Kind::Slice, name, &[of, &cut(first), &cut(first + CHANNELS), CHANNEL_AXIS])
    }

    /// The channels as the layers see them.
    fn seen(&mut self, config: &UnetConfig) -> String {
        let blended = config.blended();
        if blended == 0 {
            return "input".to_owned();
        }
        let capture = self.colours("capture", "input", 0);
        let less = self.push(Kind::Product, "less", &[&capture, CHANGE[1]]);
        let mut parts = vec![capture];
        for bank in 1..=blended {
            let filtered = self.colours(&format!("filtered.{bank}"), "input", CHANNELS * bank);
            let enlarged = self.push(Kind::Product, &format!("enlarged.{bank}"), &[&filtered, CHANGE[0]]);
            parts.push(self.push(Kind::Addition, &format!("change.{bank}"), &[&enlarged, &less]));
        }
        let (filtered, all) = (CHANNELS * (1 + blended), config.inputs.channels());
        if all > filtered {
            parts.push(self.push(Kind::Slice, "rest", &["input", &cut(filtered), &cut(all), CHANNEL_AXIS]));
        }
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        self.push(Kind::Concatenation, "seen", &parts)
    }

    /// A layer whose outputs are the two sides of a gate, computed apart: no picture is cut up, only the layer's weights.
    fn two_sided(&mut self, kind: Kind, name: &str, inputs: [&str; 2]) -> [String; 2] {
        let [weights, biases] = ["weight", "bias"].map(|part| {
            let whole = format!("{name}.{part}");
            let halves = [0, 1].map(|half| format!("{whole}.{half}"));
            let cut = Operation { outputs: halves.to_vec(), ..Operation::new(Kind::Halves, &whole, &[&whole]) };
            self.0.push(Operation { name: format!("{whole}.halves"), ..cut });
            halves
        });
        [0, 1].map(|half| self.push(kind, &format!("{name}.{half}"), &[inputs[half], &weights[half], &biases[half]]))
    }

    /// A 1×1 layer with scaled weights, added to `x`.
    fn residual(&mut self, block: &str, n: usize, x: &str, input: &str) -> String {
        let layer = format!("{block}.narrow{n}");
        let (weight, scale) = (format!("{layer}.weight"), format!("{block}.scale{n}"));
        let scaled = self.push(Kind::Product, &format!("{weight}.scaled"), &[&weight, &scale]);
        let narrow = self.push(Kind::Convolution(1), &layer, &[input, &scaled, &format!("{layer}.bias")]);
        self.push(Kind::Addition, &format!("{block}.sum{n}"), &[x, &narrow])
    }

    fn block(&mut self, config: &UnetConfig, name: &str, input: &str, [seen, width]: [usize; 2]) -> String {
        let of = |layer: &str| format!("{name}.{layer}");
        let mut value = input.to_owned();
        match config.blocks {
            Blocks::Paper | Blocks::Separable => {
                for (n, seen) in [(1, seen), (2, width)] {
                    value = if config.blocks.is_paper() {
                        self.layer(Kind::Convolution(3), &of(&format!("conv{n}")), &value)
                    } else {
                        let deep = self.layer(Kind::Depthwise(seen as i64), &of(&format!("depth{n}")), &value);
                        self.layer(Kind::Convolution(1), &of(&format!("point{n}")), &deep)
                    };
                    let slope = of(&format!("slope{n}"));
                    value = self.push(Kind::Activation, &of(&format!("act{n}")), &[&value, &slope]);
                }
            }
            Blocks::Gated => {
                if seen != width || name == "encoder.0" {
                    value = self.layer(Kind::Convolution(1), &of("enter"), &value);
                }
                let wide = self.two_sided(Kind::Convolution(1), &of("wide1"), [&value, &value]);
                let sides = [wide[0].as_str(), &wide[1]];
                let [a, b] = self.two_sided(Kind::Depthwise(width as i64), &of("depth"), sides);
                let gate = self.push(Kind::Product, &of("gate1"), &[&a, &b]);
                value = self.residual(name, 1, &value, &gate);
                let [a, b] = self.two_sided(Kind::Convolution(1), &of("wide2"), [&value, &value]);
                let gate = self.push(Kind::Product, &of("gate2"), &[&a, &b]);
                value = self.residual(name, 2, &value, &gate);
            }
        }
        value
    }
}

/// The network's operations in order.
pub(super) fn steps(config: &UnetConfig) -> Vec<Operation> {
    let mut steps = Steps(Vec::new());
    let (scales, inputs, width) = (config.scales, config.inputs, |scale| config.width(scale));
    let seen = steps.seen(config);
    let mut value = seen.clone();
    let mut skips = Vec::new();
    for scale in 0..scales {
        if scale > 0 {
            value = steps.push(Kind::Pool, &format!("pool.{}", scale - 1), &[&value]);
        }
        let seen = if scale == 0 { inputs.channels() } else { width(scale - 1) };
        value = steps.block(config, &format!("encoder.{scale}"), &value, [seen, width(scale)]);
        skips.push(value.clone());
    }
    for scale in (0..scales - 1).rev() {
        value = steps.layer(Kind::Unpool, &format!("up.{scale}"), &value);
        value = steps.push(Kind::Concatenation, &format!("concat.{scale}"), &[&skips[scale], &value]);
        value = steps.block(config, &format!("decoder.{scale}"), &value, [2 * width(scale), width(scale)]);
    }
    let output = ["output.weight", "output.bias"];
    let blended = config.blended();
    if inputs.is_bare() {
        let residual = steps.push(Kind::Convolution(3), "residual", &[&value, output[0], output[1]]);
        steps.push(Kind::Addition, "output", &["input", &residual]);
        return steps.0;
    }
    let beside = steps.push(Kind::Concatenation, "beside", &[&value, &seen]);
    let base = if blended > 0 { "capture".to_owned() } else { steps.colours("base", "input", config.base_channel()) };
    let name = if blended > 0 { "given" } else { "residual" };
    let given = steps.push(Kind::Convolution(3), name, &[&beside, output[0], output[1]]);
    let residual = if blended > 0 { steps.colours("residual", &given, 0) } else { given.clone() };
    let sum = |bank: usize| if bank == blended { "output".to_owned() } else { format!("sum.{bank}") };
    let mut total = steps.push(Kind::Addition, &sum(0), &[&base, &residual]);
    for bank in 1..=blended {
        let share = steps.colours(&format!("share.{bank}"), &given, CHANNELS * bank);
        let part = steps.push(Kind::Product, &format!("part.{bank}"), &[&share, &format!("change.{bank}")]);
        total = steps.push(Kind::Addition, &sum(bank), &[&total, &part]);
    }
    steps.0
}

impl Operation {
    fn new(kind: Kind, name: &str, inputs: &[&str]) -> Self {
        let inputs = inputs.iter().map(|input| (*input).to_owned()).collect();
        Self { kind, name: name.to_owned(), inputs, outputs: vec![name.to_owned()] }
    }

    pub(super) fn node(&self) -> Node<'_> {
        let three = || vec![ints("kernel_shape", &[3, 3]), ints("pads", &[1, 1, 1, 1])];
        let (op_type, attribute) = match self.kind {
            Kind::Cast => (OpType::Cast, vec![int("to", DataType::Float as i64)]),
            Kind::Convolution(3) => (OpType::Conv, three()),
            Kind::Convolution(side) => (OpType::Conv, vec![ints("kernel_shape", &[side, side])]),
            Kind::Depthwise(channels) => (OpType::Conv, [three(), vec![int("group", channels)]].concat()),
            Kind::Activation => (OpType::PRelu, vec![]),
            Kind::Pool => (OpType::MaxPool, vec![ints("kernel_shape", &[2, 2]), ints("strides", &[2, 2])]),
            Kind::Unpool => (OpType::ConvTranspose, vec![ints("kernel_shape", &[2, 2]), ints("strides", &[2, 2])]),
            Kind::Concatenation => (OpType::Concat, vec![int("axis", 1)]),
            Kind::Slice => (OpType::Slice, vec![]),
            Kind::Halves => (OpType::Split, vec![int("axis", 0)]),
            Kind::Product => (OpType::Mul, vec![]),
            Kind::Addition => (OpType::Add, vec![]),
        };
        Node {
            name: &self.name,
            op_type,
            input: self.inputs.iter().map(String::as_str).collect(),
            output: self.outputs.iter().map(String::as_str).collect(),
            attribute,
            ..Default::default()
        }
    }
}

/// A cast behind every parameter, first in the file, and `steps` that read the casts' outputs.
pub(super) fn with_casts(steps: Vec<Operation>, parameters: &[Parameter]) -> Vec<Operation> {
    let wide = |name: &str| format!("{name}.f32");
    let cast = |p: &Parameter| Operation::new(Kind::Cast, &wide(&p.name), &[&p.name]);
    let read = |input: String| if parameters.iter().any(|p| p.name == input) { wide(&input) } else { input };
    let steps = steps.into_iter().map(|s| Operation { inputs: s.inputs.into_iter().map(read).collect(), ..s });
    parameters.iter().map(cast).chain(steps).collect()
}

fn int<'a>(name: &'a str, value: i64) -> Attribute<'a> {
    Attribute { name, r#type: AttributeType::Int, i: value, ..Default::default() }
}

fn ints<'a>(name: &'a str, values: &[i64]) -> Attribute<'a> {
    Attribute { name, r#type: AttributeType::Ints, ints: values.to_vec(), ..Default::default() }
}
