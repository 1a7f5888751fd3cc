//! From the trimmed network of the design to the full generator (paper §4.1): the weights move by name.
//!
//! The trimmed network is the full one's part of scales `0 .. n`. What the full network adds joins it at one place: the
//! decoder block of the trimmed network's flat bottom. That block starts as the identity on the skip (weights of one in
//! the middle, slopes of one; gated residuals start as nothing anyway; T. Chen, I. Goodfellow, J. Shlens, "Net2Net", ICLR 2016), so the full network
//! starts with the trimmed one's output, bit by bit up to rounding, and learns from there. So does a network that sees more than
//! the capture from one that does not: what is new counts nothing at first.

use super::compute::Compute;
use super::reconstructor::Reconstructor;
use super::unet::{CHANNELS, UnetConfig};
use isoplanat_base::error::{Error, Result};

impl Reconstructor {
    /// A network of `config` that starts from `self`; new weights from `seed`, a fresh optimiser.
    ///
    /// # Errors
    /// Other blocks, another width, or fewer scales than `self` has.
    pub fn deepened(&self, config: &UnetConfig, seed: u64, compute: Compute) -> Result<Self> {
        let own = self.config();
        let more = own.inputs != config.inputs;
        if !more && !own.inputs.is_bare() && own.base != config.base {
            let found = format!("output added to {:?}", own.base);
            return Err(Error::bad("", "starting network", found, format!("{:?}", config.base)));
        }
        if more && !own.inputs.is_bare() {
            let allowed = format!("a network of the same inputs, {:?}, or of none", config.inputs.names());
            return Err(Error::bad("", "starting network", format!("inputs {:?}", own.inputs.names()), allowed));
        }
        if config.blocks != own.blocks {
            let found = format!("blocks {}", own.blocks.name());
            let allowed = format!("blocks {}: weights of one kind are none of another", config.blocks.name());
            return Err(Error::bad("", "starting network", found, allowed));
        }
        if config.base_width != own.base_width || config.scales < own.scales {
            return Err(Error::bad(
                "",
                "starting network",
                format!("width {}, {} scales", own.base_width, own.scales),
                format!("width {}, at most {} scales", config.base_width, config.scales),
            ));
        }
        let mut deeper = Self::on(compute, config.clone(), seed)?;
        let trained = self.parameters();
        let joint = format!("decoder.{}.", own.scales - 1);
        let mut weights = Vec::new();
        for parameter in deeper.parameters() {
            let moved = trained.iter().find(|p| p.name == parameter.name);
            match (moved, parameter.name.strip_prefix(&joint)) {
                (Some(moved), _) if more && SEEING.contains(&parameter.name.as_str()) => {
                    // What the capture alone does not have counts nothing yet.
                    weights.extend(widened(&moved.values, CHANNELS, &parameter.shape));
                }
                (Some(moved), _) if more && parameter.name.starts_with(SEEN_APART) => {
                    // Taps of one channel each: those of the new channels are fresh.
                    weights.extend_from_slice(&moved.values);
                    weights.extend_from_slice(&parameter.values[moved.values.len()..]);
                }
                (Some(moved), _) if more && parameter.name == "output.weight" => {
                    let (features, all) = (config.width(0), parameter.shape[1]);
                    let mut values = widened(&moved.values, features, &parameter.shape);
                    let base = config.base_channel();
                    for (colour, row) in values.chunks_mut(9 * all).enumerate().filter(|_| base > 0) {
                        // The output is the capture and what the network adds, whatever the new base.
                        row[9 * (features + colour) + 4] = 1.0;
                        row[9 * (features + base + colour) + 4] = -1.0;
                    }
                    weights.extend(values);
                }
                (Some(moved), _) => {
                    // Shares of what filters change are nothing at first.
                    weights.extend_from_slice(&moved.values);
                    weights.resize(weights.len() + parameter.values.len() - moved.values.len(), 0.0);
                }
                (None, Some("slope1" | "slope2")) => weights.extend(vec![1.0; parameter.values.len()]),
                (None, Some(name)) if IDENTITIES.contains(&name) => weights.extend(identity(&parameter.shape)),
                _ => weights.extend(parameter.values),
            }
        }
        deeper.restart(weights);
        Ok(deeper)
    }
}

/// The weights that see a network's channels all together, and the taps that see them one by one.
const SEEING: [&str; 3] = ["encoder.0.conv1.weight", "encoder.0.point1.weight", "encoder.0.enter.weight"];
const SEEN_APART: &str = "encoder.0.depth1.";

/// Weights of a block, by kind, that make it the identity.
const IDENTITIES: [&str; 7] = [
    "conv1.weight",
    "conv2.weight",
    "depth1.weight",
    "point1.weight",
    "depth2.weight",
    "point2.weight",
    "enter.weight",
];

/// Weights of one where an output meets its own input, `[out, in, side, side]`; with one input a channel, everywhere.
fn identity(shape: &[usize]) -> Vec<f32> {
    let (outputs, inputs, taps) = (shape[0], shape[1], shape[2] * shape[3]);
    let mut values = vec![0.0; outputs * inputs * taps];
    for output in 0..outputs {
        values[(output * inputs + output % inputs) * taps + taps / 2] = 1.0;
    }
    values
}

/// Weights with `inputs` inputs as weights of `shape`, `[out, all, side, side]`: those of further inputs are nothing.
fn widened(values: &[f32], inputs: usize, shape: &[usize]) -> Vec<f32> {
    let (all, taps) = (shape[1], shape[2] * shape[3]);
    let mut out = vec![0.0; shape[0] * all * taps];
    for (from, to) in values.chunks(taps * inputs).zip(out.chunks_mut(taps * all)) {
        to[..from.len()].copy_from_slice(from);
    }
    out
}

#[cfg(test)]
mod tests {
    use ndarray::Array4;

    use super::*;
    use crate::Base;
    use isoplanat_card::Blocks;
    use isoplanat_card::Inputs;

    #[test]
    fn the_full_network_starts_where_the_trimmed_one_ended() {
        Blocks::ALL.into_iter().for_each(deepens);
    }

    fn deepens(blocks: Blocks) {
        let of = |base_width, scales| UnetConfig { blocks, ..UnetConfig::bare(base_width, scales) };
        let rng = &mut fastrand::Rng::with_seed(2);
        let mut trimmed = Reconstructor::new(of(4, 3), 3).expect("valid");
        for parameter in trimmed.parameters() {
            let values: Vec<f32> = parameter.values.iter().map(|v| v + 0.1 * (rng.f32() - 0.5)).collect();
            trimmed.set_parameter(&parameter.name, &values).expect("same length");
        }
        let input = Array4::from_shape_simple_fn((1, 3, 64, 128), || rng.f32());
        let before = trimmed.forward(input.view()).expect("fits");
        for scales in [3, 4, 7] {
            let config = of(4, scales);
            let mut full = trimmed.deepened(&config, 5, Compute::Cpu).expect("deeper");
            let after = full.forward(input.view()).expect("fits");
            let worst = (&after - &before).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(worst < 1e-5, "{blocks:?}, {scales} scales: {worst}");
            // And every new part learns within a few steps.
            let start = full.parameters();
            for _ in 0..3 {
                full.step_network_only(input.view(), input.mapv(|v| 0.5 * v).view(), None, 1e-3).expect("fits");
            }
            for (a, b) in start.iter().zip(full.parameters()) {
                assert_ne!(a.values, b.values, "{} of {scales} scales, {blocks:?}, stays", a.name);
            }
        }
        // A network that sees more than the capture starts with the same output, whatever else it sees.
        let told = |wiener, field| Inputs { wiener, field, ..Inputs::BARE };
        let levels = Inputs { levels: true, ..told(true, true) };
        let all = [told(true, true), told(true, false), told(false, true), levels];
        for (inputs, base) in all.into_iter().flat_map(|i| Base::ALL.map(|base| (i, base))) {
            let told = trimmed.deepened(&UnetConfig { inputs, base, ..of(4, 4) }, 5, Compute::Cpu).expect("told");
            let more = Array4::from_shape_simple_fn((1, inputs.channels() - 3, 64, 128), || rng.f32());
            let all = ndarray::concatenate(ndarray::Axis(1), &[input.view(), more.view()]).expect("one size");
            let after = told.forward(all.view()).expect("fits");
            let worst = (&after - &before).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(worst < 1e-5, "{blocks:?}, {inputs:?}, {base:?}: {worst}");
            assert!(told.deepened(&of(4, 4), 5, Compute::Cpu).is_err(), "back to the capture alone");
        }
        for (base_width, scales) in [(8, 7), (4, 2)] {
            assert!(trimmed.deepened(&of(base_width, scales), 5, Compute::Cpu).is_err());
        }
        for other in Blocks::ALL.into_iter().filter(|b| *b != blocks) {
            let config = UnetConfig { blocks: other, ..of(4, 4) };
            let error = trimmed.deepened(&config, 5, Compute::Cpu).expect_err("other blocks").to_string();
            assert!(error.contains(blocks.name()) && error.contains(other.name()), "{error}");
        }
    }
}
