//! The blocks of a U-Net: their weights, fresh ones, and the forward pass.
//!
//! Of a gated block `enter` brings the channels to the scale's width where they change. Two residuals follow:
//! `x + b · narrow1(gate(depth(wide1(x))))` and `x + g · narrow2(gate(wide2(x)))`, where `wide` doubles the channels and the gate
//! multiplies the first half by the second. `b` and `g` (`scale1`, `scale2`) are one number a channel and act on the weights of
//! `narrow`, so that they cost nothing in a picture.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

use super::layers::{Features, Way, convolve, depthwise, gate};
use isoplanat_card::Blocks;

/// PReLU's slope at the start (He et al. 2015, as in the common frameworks).
const INITIAL_SLOPE: f32 = 0.25;

/// Weights of one convolution.
#[derive(Module, Debug)]
pub(super) struct Convolution {
    pub(super) weight: Param<Tensor<4>>,
    pub(super) bias: Param<Tensor<1>>,
}

impl Convolution {
    /// `side × side`, `[out, in, side, side]`, He's uniform distribution for PReLU times `gain`.
    pub(super) fn square(
        side: usize,
        inputs: usize,
        outputs: usize,
        gain: f64,
        rng: &mut fastrand::Rng,
        device: &Device,
    ) -> Self {
        Self::draw([outputs, inputs, side, side], outputs, side * side * inputs, gain, rng, device)
    }

    /// 3×3 with taps for every channel of its own, `[channels, 1, 3, 3]`.
    fn depthwise(channels: usize, gain: f64, rng: &mut fastrand::Rng, device: &Device) -> Self {
        Self::draw([channels, 1, 3, 3], channels, 9, gain, rng, device)
    }

    /// 2×2 transposed, `[in, out, 2, 2]`; each output pixel sees one tap of every input.
    pub(super) fn transposed(inputs: usize, outputs: usize, rng: &mut fastrand::Rng, device: &Device) -> Self {
        Self::draw([inputs, outputs, 2, 2], outputs, inputs, 1.0, rng, device)
    }

    /// He's bound for PReLU times `gain`.
    pub(super) fn bound(fan_in: usize, gain: f64) -> f64 {
        3f64.sqrt() * (2.0 / ((1.0 + f64::from(INITIAL_SLOPE).powi(2)) * fan_in as f64)).sqrt() * gain
    }

    fn draw(
        shape: [usize; 4],
        outputs: usize,
        fan_in: usize,
        gain: f64,
        rng: &mut fastrand::Rng,
        device: &Device,
    ) -> Self {
        let bound = Self::bound(fan_in, gain);
        let values: Vec<f32> = (0..shape.iter().product()).map(|_| (bound * (2.0 * rng.f64() - 1.0)) as f32).collect();
        Self { weight: Param::from_data(TensorData::new(values, shape), device), bias: constant(0.0, outputs, device) }
    }

    fn forward(&self, way: Way, inputs: &[&Features]) -> Tensor<4> {
        convolve(way, inputs, self.weight.val(), self.bias.val())
    }

    /// With every output's weights times one number.
    fn scaled(&self, way: Way, input: Tensor<4>, scale: &Param<Tensor<1>>) -> Tensor<4> {
        let weight = self.weight.val();
        let scale = scale.val().reshape([weight.dims()[0], 1, 1, 1]);
        convolve(way, &[&Features::plain(input)], weight * scale, self.bias.val())
    }
}

fn constant(value: f32, n: usize, device: &Device) -> Param<Tensor<1>> {
    Param::from_data(TensorData::new(vec![value; n], [n]), device)
}

/// A block of any kind.
#[expect(clippy::large_enum_variant, reason = "a handful of blocks, all of one kind")]
#[derive(Module, Debug)]
pub(super) enum Block {
    /// [`Blocks::Paper`].
    Paper(Paper),
    /// [`Blocks::Separable`].
    Separable(Separable),
    /// [`Blocks::Gated`].
    Gated(Gated),
}

impl Block {
    /// Fresh weights for `inputs` channels; `finest` is the block that sees the picture.
    pub(super) fn new(
        kind: Blocks,
        [inputs, outputs]: [usize; 2],
        finest: bool,
        rng: &mut fastrand::Rng,
        device: &Device,
    ) -> Self {
        match kind {
            Blocks::Paper => Self::Paper(Paper::new(inputs, outputs, rng, device)),
            Blocks::Separable => Self::Separable(Separable::new(inputs, outputs, rng, device)),
            Blocks::Gated => Self::Gated(Gated::new(inputs, outputs, finest || inputs != outputs, rng, device)),
        }
    }

    /// From the channels of all `inputs` in turn.
    pub(super) fn forward(&self, way: Way, inputs: &[&Features]) -> Features {
        match self {
            Self::Paper(block) => block.forward(way, inputs),
            Self::Separable(block) => block.forward(way, inputs),
            Self::Gated(block) => block.forward(way, inputs),
        }
    }
}

/// Two convolutions with PReLU.
#[derive(Module, Debug)]
pub(super) struct Paper {
    conv1: Convolution,
    slope1: Param<Tensor<1>>,
    conv2: Convolution,
    slope2: Param<Tensor<1>>,
}

impl Paper {
    fn new(inputs: usize, outputs: usize, rng: &mut fastrand::Rng, device: &Device) -> Self {
        Self {
            conv1: Convolution::square(3, inputs, outputs, 1.0, rng, device),
            slope1: constant(INITIAL_SLOPE, outputs, device),
            conv2: Convolution::square(3, outputs, outputs, 1.0, rng, device),
            slope2: constant(INITIAL_SLOPE, outputs, device),
        }
    }

    fn forward(&self, way: Way, inputs: &[&Features]) -> Features {
        let middle = Features { values: self.conv1.forward(way, inputs), slope: Some(self.slope1.val()) };
        Features { values: self.conv2.forward(way, &[&middle]), slope: Some(self.slope2.val()) }
    }
}

/// Two depthwise convolutions, each with a 1×1 convolution and PReLU behind it.
#[derive(Module, Debug)]
pub(super) struct Separable {
    depth1: Convolution,
    point1: Convolution,
    slope1: Param<Tensor<1>>,
    depth2: Convolution,
    point2: Convolution,
    slope2: Param<Tensor<1>>,
}

impl Separable {
    fn new(inputs: usize, outputs: usize, rng: &mut fastrand::Rng, device: &Device) -> Self {
        Self {
            depth1: Convolution::depthwise(inputs, 1.0, rng, device),
            point1: Convolution::square(1, inputs, outputs, linear(), rng, device),
            slope1: constant(INITIAL_SLOPE, outputs, device),
            depth2: Convolution::depthwise(outputs, 1.0, rng, device),
            point2: Convolution::square(1, outputs, outputs, linear(), rng, device),
            slope2: constant(INITIAL_SLOPE, outputs, device),
        }
    }

    fn forward(&self, way: Way, inputs: &[&Features]) -> Features {
        let (weight, bias) = (self.depth1.weight.val(), self.depth1.bias.val());
        let mut first = 0;
        let deep = |input: &&Features| {
            let channels = input.values.dims()[1];
            let part = (weight.clone().narrow(0, first, channels), bias.clone().narrow(0, first, channels));
            first += channels;
            let (weight, bias) = if inputs.len() == 1 { (weight.clone(), bias.clone()) } else { part };
            Features::plain(depthwise(way, input, weight, bias))
        };
        let deep: Vec<Features> = inputs.iter().map(deep).collect();
        let values = self.point1.forward(way, &deep.iter().collect::<Vec<_>>());
        drop(deep);
        let middle = Features { values, slope: Some(self.slope1.val()) };
        let deep = depthwise(way, &middle, self.depth2.weight.val(), self.depth2.bias.val());
        drop(middle);
        Features { values: self.point2.forward(way, &[&Features::plain(deep)]), slope: Some(self.slope2.val()) }
    }
}

/// Gain of weights that no PReLU stands before.
fn linear() -> f64 {
    ((1.0 + f64::from(INITIAL_SLOPE).powi(2)) / 2.0).sqrt()
}

/// Two gated residuals.
#[derive(Module, Debug)]
pub(super) struct Gated {
    enter: Option<Convolution>,
    wide1: Convolution,
    depth: Convolution,
    narrow1: Convolution,
    scale1: Param<Tensor<1>>,
    wide2: Convolution,
    narrow2: Convolution,
    scale2: Param<Tensor<1>>,
}

impl Gated {
    /// Scales of zero: a fresh block is its entry alone. Gates start open, their second halves around one, so that what they
    /// multiply counts from the first step on.
    fn new(inputs: usize, width: usize, enters: bool, rng: &mut fastrand::Rng, device: &Device) -> Self {
        let enter = enters.then(|| Convolution::square(1, inputs, width, linear(), rng, device));
        let open = |convolution: Convolution| {
            let bias = (0..2 * width).map(|channel| if channel < width { 0.0 } else { 1.0 }).collect();
            Convolution { bias: Param::from_data(TensorData::new(bias, [2 * width]), device), ..convolution }
        };
        Self {
            enter,
            wide1: Convolution::square(1, width, 2 * width, linear(), rng, device),
            depth: open(Convolution::depthwise(2 * width, linear(), rng, device)),
            narrow1: Convolution::square(1, width, width, linear(), rng, device),
            scale1: constant(0.0, width, device),
            wide2: open(Convolution::square(1, width, 2 * width, linear(), rng, device)),
            narrow2: Convolution::square(1, width, width, linear(), rng, device),
            scale2: constant(0.0, width, device),
        }
    }

    fn forward(&self, way: Way, inputs: &[&Features]) -> Features {
        let x = match (&self.enter, inputs) {
            (None, [Features { values, slope: None }]) => values.clone(),
            (None, _) => unreachable!("a block without entry has one plain input"),
            (Some(enter), _) => enter.forward(way, inputs),
        };
        let x = Features::plain(x);
        let wide = Features::plain(self.wide1.forward(way, &[&x]));
        let wide = depthwise(way, &wide, self.depth.weight.val(), self.depth.bias.val());
        let x = x.values + self.narrow1.scaled(way, gate(way, wide), &self.scale1);
        let x = Features::plain(x);
        let wide = self.wide2.forward(way, &[&x]);
        Features::plain(x.values + self.narrow2.scaled(way, gate(way, wide), &self.scale2))
    }
}
