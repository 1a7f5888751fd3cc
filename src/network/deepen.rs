//! From the trimmed network of the design to the full generator (paper §4.1): the weights move by name.
//!
//! The trimmed network is the full one's part of scales `0 .. n`. What the full network adds joins it at one place: the
//! decoder block of the trimmed network's flat bottom. That block starts as the identity on the skip (weights of one in
//! the middle, slopes of one; T. Chen, I. Goodfellow, J. Shlens, "Net2Net", ICLR 2016), so the full network
//! starts with the trimmed one's output, bit by bit up to rounding, and learns from there. So does a network that sees more than
//! the capture from one that does not: what is new counts nothing at first.

use super::compute::Compute;
use super::reconstructor::Reconstructor;
use super::unet::{CHANNELS, UnetConfig};
use crate::error::{Error, Result};

impl Reconstructor {
    /// A network of `config` that starts from `self`; new weights from `seed`, a fresh optimiser.
    ///
    /// # Errors
    /// Another width, or fewer scales than `self` has.
    pub fn deepened(&self, config: &UnetConfig, seed: u64, compute: Compute) -> Result<Self> {
        let own = self.config();
        let more = own.inputs != config.inputs;
        if more && !own.inputs.is_bare() {
            let allowed = format!("a network of the same inputs, {:?}, or of none", config.inputs.names());
            return Err(Error::bad("", "starting network", format!("inputs {:?}", own.inputs.names()), allowed));
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
                (Some(moved), _) if more && parameter.name == "encoder.0.conv1.weight" => {
                    // What the capture alone does not have counts nothing yet.
                    weights.extend(widened(&moved.values, CHANNELS, parameter.shape[1]));
                }
                (Some(moved), _) if more && parameter.name == "output.weight" => {
                    let (features, all) = (config.width(0), parameter.shape[1]);
                    let mut values = widened(&moved.values, features, all);
                    let base = config.inputs.base();
                    for (colour, row) in values.chunks_mut(9 * all).enumerate().filter(|_| base > 0) {
                        // The output is the capture and what the network adds, whatever the new base.
                        row[9 * (features + colour) + 4] = 1.0;
                        row[9 * (features + base + colour) + 4] = -1.0;
                    }
                    weights.extend(values);
                }
                (Some(moved), _) => weights.extend_from_slice(&moved.values),
                (None, Some("slope1" | "slope2")) => weights.extend(vec![1.0; parameter.values.len()]),
                (None, Some("conv1.weight" | "conv2.weight")) => {
                    let (inputs, mut values) = (parameter.shape[1], vec![0.0; parameter.values.len()]);
                    for output in 0..parameter.shape[0] {
                        values[(output * inputs + output) * 9 + 4] = 1.0;
                    }
                    weights.extend(values);
                }
                _ => weights.extend(parameter.values),
            }
        }
        deeper.restart(weights);
        Ok(deeper)
    }
}

/// Weights `[out, inputs, 3, 3]` with more inputs, whose weights are nothing.
fn widened(values: &[f32], inputs: usize, all: usize) -> Vec<f32> {
    let mut out = vec![0.0; values.len() / inputs * all];
    for (from, to) in values.chunks(9 * inputs).zip(out.chunks_mut(9 * all)) {
        to[..from.len()].copy_from_slice(from);
    }
    out
}

#[cfg(test)]
mod tests {
    use ndarray::Array4;

    use super::*;
    use crate::imaging::guide::Inputs;

    #[test]
    fn the_full_network_starts_where_the_trimmed_one_ended() {
        let rng = &mut fastrand::Rng::with_seed(2);
        let mut trimmed = Reconstructor::new(UnetConfig::bare(4, 3), 3).expect("valid");
        for parameter in trimmed.parameters() {
            let values: Vec<f32> = parameter.values.iter().map(|v| v + 0.1 * (rng.f32() - 0.5)).collect();
            trimmed.set_parameter(&parameter.name, &values).expect("same length");
        }
        let input = Array4::from_shape_simple_fn((1, 3, 64, 128), || rng.f32());
        let before = trimmed.forward(input.view()).expect("fits");
        for scales in [3, 4, 7] {
            let config = UnetConfig::bare(4, scales);
            let mut full = trimmed.deepened(&config, 5, Compute::Cpu).expect("deeper");
            let after = full.forward(input.view()).expect("fits");
            let worst = (&after - &before).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(worst < 1e-5, "{scales} scales: {worst}");
            // And every new part learns within a few steps.
            let start = full.parameters();
            for _ in 0..3 {
                full.step_network_only(input.view(), input.mapv(|v| 0.5 * v).view(), 1e-3).expect("fits");
            }
            for (a, b) in start.iter().zip(full.parameters()) {
                assert_ne!(a.values, b.values, "{} of {scales} scales stays", a.name);
            }
        }
        // A network that sees more than the capture starts with the same output, whatever else it sees.
        for (wiener, field) in [(true, true), (true, false), (false, true)] {
            let inputs = Inputs { wiener, field };
            let told =
                trimmed.deepened(&UnetConfig { inputs, ..UnetConfig::bare(4, 4) }, 5, Compute::Cpu).expect("told");
            let more = Array4::from_shape_simple_fn((1, inputs.channels() - 3, 64, 128), || rng.f32());
            let all = ndarray::concatenate(ndarray::Axis(1), &[input.view(), more.view()]).expect("one size");
            let after = told.forward(all.view()).expect("fits");
            let worst = (&after - &before).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(worst < 1e-5, "{inputs:?}: {worst}");
            assert!(told.deepened(&UnetConfig::bare(4, 4), 5, Compute::Cpu).is_err(), "back to the capture alone");
        }
        for (base_width, scales) in [(8, 7), (4, 2)] {
            assert!(trimmed.deepened(&UnetConfig::bare(base_width, scales), 5, Compute::Cpu).is_err());
        }
    }
}
