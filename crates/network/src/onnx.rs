//! Export to ONNX: the same operations as the in-crate forward pass, dynamic batch, height and width, the card in the
//! metadata.
//!
//! Opset 17, IR 9. Input `input` is `[batch, channel, height, width]`, output `output` `[batch, 3, height, width]` f32; height and width must be multiples
//! of the card's `multiple`. Initialisers carry the parameters' names. What gated blocks compute of their weights alone (halves for the
//! two sides of a gate, products with scales) are nodes of the graph (`graph`). Where the card asks for f16 weights, initialisers are
//! stored so, and a `Cast` behind each (`NAME.f32`) brings it back. A runtime folds all of these when it loads the file, and computes in
//! f32 as before.

use std::path::Path;

use onnx_rs::ast::{
    DataType, Dimension, Graph, Model, OperatorSetId, StringStringEntry, TensorProto, TensorShape,
    TensorShapeDimension, TensorTypeProto, TypeProto, TypeValue, ValueInfo,
};

use half::f16;

use self::graph::{CHANGE, Operation, cuts, steps, with_casts};
use super::learner::Parameter;
use super::reconstructor::Reconstructor;
use super::unet::CHANGE_GAIN;
use isoplanat_base::atomic::write_bytes;
use isoplanat_base::error::{Error, Result};
use isoplanat_card::Inputs;
use isoplanat_card::{Blocks, ModelCard, Weights};

mod graph;

const OPSET: i64 = 17;
const IR_VERSION: i64 = 9;

/// Writes `model` with `card` in its metadata to `path`, whole or not at all.
///
/// Refuses weights that are not finite or, stored as f16, beyond its range; and a card of another network.
pub fn export(model: &Reconstructor, card: &ModelCard, path: &Path) -> Result<()> {
    write_bytes(path, &encode(model, card)?)
}

/// The bytes of [`export`]'s file.
pub fn encode(model: &Reconstructor, card: &ModelCard) -> Result<Vec<u8>> {
    let config = model.config();
    let facts = |w: usize, s: usize, m: usize, inputs: Inputs, blocks: Blocks| {
        format!("width {w}, scales {s}, multiple {m}, inputs {:?}, blocks {}", inputs.names(), blocks.name())
    };
    let said = facts(card.base_width, card.scales, card.multiple, card.inputs, card.blocks);
    let own = facts(config.base_width, config.scales, config.multiple(), config.inputs, config.blocks);
    if said != own {
        return Err(Error::bad("", "model card", said, format!("the network's: {own}")));
    }
    let parameters = model.parameters();
    if let Some(bad) = parameters.iter().find(|p| p.values.iter().any(|v| !v.is_finite())) {
        return Err(Error::Internal(format!("parameter {} is not finite; nothing was exported", bad.name)));
    }
    let halves = match card.weights {
        Weights::F32 => None,
        Weights::F16 => Some(parameters.iter().map(half_bytes).collect::<Result<Vec<_>>>()?),
    };
    let mut initializers: Vec<TensorProto<'_>> = parameters.iter().map(initializer).collect();
    let mut steps = steps(config);
    let bounds;
    if !config.inputs.is_bare() {
        bounds = cuts(config);
        let named = bounds.iter().map(|(name, v)| TensorProto::from_i64(name, vec![1], vec![*v]));
        initializers.extend(named);
        if config.blended() > 0 {
            let gains = CHANGE.into_iter().zip([CHANGE_GAIN, -CHANGE_GAIN]);
            initializers.extend(gains.map(|(name, v)| TensorProto::from_f32(name, vec![1], vec![v])));
        }
    }
    if let Some(halves) = &halves {
        for (tensor, bytes) in initializers.iter_mut().zip(halves) {
            *tensor = TensorProto::from_raw(tensor.name(), tensor.dims().to_vec(), DataType::Float16, bytes);
        }
        steps = with_casts(steps, &parameters);
    }
    let metadata = card.to_metadata();
    let encoded = Model {
        ir_version: IR_VERSION,
        opset_import: vec![OperatorSetId { domain: "", version: OPSET }],
        producer_name: "isoplanat",
        producer_version: env!("CARGO_PKG_VERSION"),
        metadata_props: metadata.iter().map(|(key, value)| StringStringEntry { key, value }).collect(),
        graph: Some(Graph {
            name: "reconstruction",
            node: steps.iter().map(Operation::node).collect(),
            initializer: initializers,
            input: vec![image("input", config.inputs.channels())],
            output: vec![image("output", 3)],
            ..Default::default()
        }),
        ..Default::default()
    };
    Ok(onnx_rs::encode(&encoded))
}

/// A parameter's values as little-endian binary16, rounded to the nearest.
fn half_bytes(parameter: &Parameter) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(2 * parameter.values.len());
    for value in &parameter.values {
        let rounded = f16::from_f32(*value);
        if !rounded.is_finite() {
            let allowed = format!("magnitudes up to {}, the range of f16; f32 weights have no such limit", f16::MAX);
            return Err(Error::bad("", format!("weights as f16: {}", parameter.name), value.to_string(), allowed));
        }
        bytes.extend(rounded.to_le_bytes());
    }
    Ok(bytes)
}

/// Slopes are stored as `[channels, 1, 1]`, which is how ONNX's PRelu broadcasts them, scales as `[channels, 1, 1, 1]`, for products
/// with weights.
fn initializer(parameter: &Parameter) -> TensorProto<'_> {
    let mut shape: Vec<i64> = parameter.shape.iter().map(|&n| n as i64).collect();
    if parameter.name.contains(".slope") {
        shape.extend([1, 1]);
    } else if parameter.name.contains(".scale") {
        shape.extend([1, 1, 1]);
    }
    TensorProto::from_f32(&parameter.name, shape, parameter.values.clone())
}

/// `[batch, channels, height, width]` f32.
fn image(name: &str, channels: usize) -> ValueInfo<'_> {
    let channels = Dimension::Value(channels as i64);
    let dim = [Dimension::Param("batch"), channels, Dimension::Param("height"), Dimension::Param("width")]
        .map(|value| TensorShapeDimension { value, ..Default::default() });
    let shape = Some(TensorShape { dim: dim.into() });
    let value = Some(TypeValue::Tensor(TensorTypeProto { elem_type: DataType::Float, shape }));
    ValueInfo { name, r#type: Some(TypeProto { value, ..Default::default() }), ..Default::default() }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::UnetConfig;

    fn model() -> (Reconstructor, ModelCard) {
        model_of(Blocks::Paper)
    }

    fn model_of(blocks: Blocks) -> (Reconstructor, ModelCard) {
        let config = UnetConfig { blocks, ..UnetConfig::bare(6, 3) };
        let mut model = Reconstructor::new(config, 9).expect("valid");
        let rng = &mut fastrand::Rng::with_seed(2);
        for mut parameter in model.parameters() {
            if parameter.values.iter().all(|&v| v == parameter.values[0]) || parameter.name == "output.weight" {
                parameter.values.iter_mut().for_each(|v| *v = rng.f32() - 0.4);
            }
            model.set_parameter(&parameter.name, &parameter.values).expect("same length");
        }
        (model, ModelCard::for_unet("test", 6, 3).made_of(blocks))
    }

    #[test]
    fn the_file_carries_card_and_names() {
        for blocks in Blocks::ALL {
            let (model, mut card) = model_of(blocks);
            card.lens_name = "triplet".into();
            let bytes = encode(&model, &card).expect("finite");
            let parsed = onnx_rs::parse(&bytes).expect("own file");
            let metadata: BTreeMap<String, String> =
                parsed.metadata_props.iter().map(|e| (e.key.to_owned(), e.value.to_owned())).collect();
            assert_eq!(ModelCard::from_metadata(&metadata).expect("complete"), card);
            let graph = parsed.graph.expect("there");
            for parameter in model.parameters() {
                let stored = graph.initializer.iter().find(|t| t.name() == parameter.name).expect("named");
                assert_eq!(stored.as_f32().expect("f32").as_ref(), parameter.values, "{}", parameter.name);
            }
            let others = if blocks.is_paper() { Blocks::Gated } else { Blocks::Paper };
            let message = encode(&model, &card.clone().made_of(others)).expect_err("another's card").to_string();
            assert!(message.contains(blocks.name()) && message.contains(others.name()), "{message}");
            card.scales = 2;
            assert!(encode(&model, &card).is_err());
        }
    }

    #[test]
    fn tract_computes_the_same() {
        use ndarray::Array4;
        use tract_onnx::prelude::*;

        for (blocks, (batch, rows, columns)) in
            Blocks::ALL.into_iter().flat_map(|b| [(b, (1usize, 32usize, 24usize)), (b, (2, 20, 44))])
        {
            let (model, card) = model_of(blocks);
            let bytes = encode(&model, &card).expect("finite");
            let rng = &mut fastrand::Rng::with_seed(3);
            let input = Array4::from_shape_simple_fn((batch, 3, rows, columns), || rng.f32());
            let plan = tract_onnx::onnx()
                .model_for_read(&mut bytes.as_slice())
                .and_then(|m| m.with_input_fact(0, f32::fact([batch, 3, rows, columns]).into()))
                .and_then(|m| m.into_optimized())
                .and_then(|m| m.into_runnable())
                .expect("tract reads the file");
            let tensor = Tensor::from_shape(&[batch, 3, rows, columns], input.as_slice().expect("standard layout"))
                .expect("shape fits");
            let theirs = plan.run(tvec!(tensor.into())).expect("tract runs");
            let theirs = theirs[0].to_plain_array_view::<f32>().expect("f32").to_owned();
            let ours = model.forward(input.view()).expect("fits");
            let scale = ours.iter().fold(1f32, |m, v| m.max(v.abs()));
            let worst = ours.iter().zip(theirs.iter()).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
            assert!(worst <= 1e-5 * scale, "{worst} of {scale}");
        }
    }

    /// The stored halves are the nearest to the weights, by arithmetic on their exponents; every operation reads the casts.
    #[test]
    fn f16_files_hold_the_nearest_halves_behind_casts() {
        for blocks in Blocks::ALL {
            let (model, card) = model_of(blocks);
            nearest_halves_behind_casts(&model, card);
        }
    }

    fn nearest_halves_behind_casts(model: &Reconstructor, mut card: ModelCard) {
        let whole = encode(model, &card).expect("finite").len();
        card.weights = Weights::F16;
        let bytes = encode(model, &card).expect("in range");
        let nodes = if card.blocks.is_paper() { 20_000 } else { 40_000 };
        assert!(2 * bytes.len() < whole + nodes, "{} of {whole}", bytes.len());
        let graph = onnx_rs::parse(&bytes).expect("own file").graph.expect("there");
        for parameter in model.parameters() {
            let stored = graph.initializer.iter().find(|t| t.name() == parameter.name).expect("named");
            let raw = stored.as_raw().expect("raw");
            assert_eq!((stored.data_type(), raw.len()), (DataType::Float16, 2 * parameter.values.len()));
            for (pair, v) in raw.chunks(2).zip(&parameter.values) {
                // 2^(e − 10) is the spacing of halves from 2^e on, 2^−24 below 2^−14.
                let spacing = 2f64.powi((f64::from(v.abs()).log2().floor() as i32).max(-14) - 10);
                let nearest = (f64::from(*v) / spacing).round_ties_even() * spacing;
                let bits = u16::from_le_bytes([pair[0], pair[1]]);
                assert_eq!(f64::from(f16::from_bits(bits)), nearest, "{v}");
            }
            let reads = |name: &str| graph.node.iter().filter(|n| n.input.contains(&name)).count();
            assert_eq!(reads(&parameter.name), 1, "the cast alone");
            assert_eq!(reads(&format!("{}.f32", parameter.name)), 1);
        }
    }

    #[test]
    fn weights_beyond_f16_are_refused_by_name() {
        let (mut model, mut card) = model();
        model.set_parameter("output.bias", &[0.0, -65_519.0, 0.0]).expect("three");
        card.weights = Weights::F16;
        encode(&model, &card).expect("rounds to the largest half");
        model.set_parameter("output.bias", &[0.0, -65_520.0, 0.0]).expect("three");
        let message = encode(&model, &card).expect_err("too large").to_string();
        assert!(message.contains("output.bias") && message.contains("-65520"), "{message}");
        card.weights = Weights::F32;
        encode(&model, &card).expect("no limit");
    }
}
