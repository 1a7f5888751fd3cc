//! ONNX files. What a runtime is given is taken again and comes back byte by byte, and holds no function, no graph within a graph, no tensor outside of the
//! weights and none whose numbers lie in another file: looked at by a plain reader of the wire format of its own.

use std::path::Path;

use isoplanat::deploy::session::{metadata, rewritten};
use isoplanat::network::card::ModelCard;
use isoplanat::network::{Reconstructor, UnetConfig, onnx as export};

use super::{again, made, read};

pub(super) fn onnx(bytes: &[u8]) {
    let file = Path::new("a.onnx");
    let model = read("a.onnx", rewritten(bytes, file));
    let entries = read("a.onnx", metadata(bytes, file));
    assert_eq!(model.is_some(), entries.is_some());
    let (Some(model), Some(entries)) = (model, entries) else { return };
    assert_eq!(again(rewritten(&model, file), ""), model, "another model");
    assert_eq!(again(metadata(&model, file), ""), entries);
    closed(&model);
    // A card is read, or refused.
    made(ModelCard::from_metadata(&entries));
}

/// A number of the wire format (protobuf, 7 bits a byte, the lowest first).
fn number(bytes: &mut &[u8]) -> u64 {
    let mut all = 0;
    for shift in (0..64).step_by(7) {
        let (first, rest) = bytes.split_first().expect("a number");
        *bytes = rest;
        all |= u64::from(first & 127) << shift;
        if first & 128 == 0 {
            break;
        }
    }
    all
}

/// Fields of a message by number; of a number in place of bytes its value.
fn fields(mut bytes: &[u8]) -> Vec<(u64, u64, &[u8])> {
    let mut all = Vec::new();
    while !bytes.is_empty() {
        let key = number(&mut bytes);
        let (value, length) = match key & 7 {
            0 => (number(&mut bytes), 0),
            1 => (0, 8),
            2 => (0, number(&mut bytes) as usize),
            5 => (0, 4),
            kind => panic!("wire type {kind}"),
        };
        let (inside, rest) = bytes.split_at(length);
        all.push((key >> 3, value, inside));
        bytes = rest;
    }
    all
}

/// Nothing of a model leads out of its file or hides a graph (onnx.proto's numbers of fields).
fn closed(model: &[u8]) {
    let none = |within: &[u8], numbers: &[u64], what: &str| {
        assert!(fields(within).iter().all(|(n, ..)| !numbers.contains(n)), "{what}");
    };
    // training_info, functions.
    none(model, &[20, 25], "a training or a function");
    for (_, _, graph) in fields(model).into_iter().filter(|(n, ..)| *n == 7) {
        none(graph, &[14, 15], "a note on quantised tensors, or a sparse tensor");
        for (_, _, tensor) in fields(graph).into_iter().filter(|(n, ..)| *n == 5) {
            none(tensor, &[13], "external_data");
            assert!(fields(tensor).iter().all(|(n, value, _)| *n != 14 || *value == 0), "data_location");
        }
        for (_, _, node) in fields(graph).into_iter().filter(|(n, ..)| *n == 1) {
            for (_, _, attribute) in fields(node).into_iter().filter(|(n, ..)| *n == 5) {
                none(attribute, &[5, 6, 10, 11, 14, 15, 22, 23], "a tensor, a graph or a type");
            }
        }
    }
}

/// The smallest network.
pub(super) fn smallest() -> (Reconstructor, ModelCard) {
    let model = Reconstructor::new(UnetConfig::bare(1, 1), 1).expect("valid");
    (model, ModelCard::for_unet("a", 1, 1))
}

pub(super) fn starts() -> Vec<Vec<u8>> {
    let (model, card) = smallest();
    let deeper = Reconstructor::new(UnetConfig::bare(1, 2), 1).expect("valid");
    let models = [(model, card), (deeper, ModelCard::for_unet("b", 1, 2))];
    models.iter().map(|(model, card)| export::encode(model, card).expect("a model")).collect()
}
