//! What an ONNX file may hold, as a list of what is allowed; everything else is refused by its name before a runtime sees the file.
//!
//! The file is read by one reader, looked at field by field (a field that the reader comes to know later does not compile until it is allowed or refused here), and
//! written again: a runtime that reads bytes gets those of [`bytes`], so fields that the reader does not know reach nobody.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use prost::Message;
use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto, TensorProto,
    TypeProto, ValueInfoProto, attribute_proto::AttributeType, tensor_shape_proto::Dimension, type_proto,
};

use isoplanat_base::error::{Error, Result};

/// Operators that the exporter writes.
const OPERATORS: [&str; 10] =
    ["Add", "Cast", "Concat", "Conv", "ConvTranspose", "MaxPool", "Mul", "PRelu", "Slice", "Split"];
/// Nodes of a graph at most: the exporter's largest networks have some hundreds. As many values may be described.
const MOST_NODES: usize = 20_000;
/// Attributes, inputs or outputs of a node at most, and sides of a tensor.
const MOST_PARTS: usize = 64;
/// Numbers of an attribute at most.
const MOST_NUMBERS: usize = 1024;
/// Entries of the metadata at most, and bytes of all of them.
const MOST_ENTRIES: usize = 256;
const MOST_METADATA: usize = 1 << 20;
/// Bytes of a name, and of a description, at most.
const MOST_NAME: usize = 1024;
const MOST_WORDS: usize = 64 << 10;
/// Forms of the file: the exporter writes 9. Below 4, weights were inputs.
const FORMS: std::ops::RangeInclusive<i64> = 4..=13;
/// Sets of operators: the exporter writes 17. Before 13, parts of a split were attributes.
const OPERATOR_SETS: std::ops::RangeInclusive<i64> = 13..=24;

/// What a model should be.
const ALLOWED: &str = "an ONNX model that takes and returns an image";

/// Reads a file's structure and checks all of it; `file` names it in messages.
///
/// # Errors
/// Bytes that are no ONNX model, and whatever in it is not allowed: its name, and what is.
pub(super) fn read(model: &[u8], file: &Path) -> Result<ModelProto> {
    let read = || tract_onnx::onnx().proto_model_for_read(&mut &model[..]).map_err(|e| e.to_string());
    use tract_onnx::prelude::Framework;
    let proto = super::guarded(read).map_err(|_| bad(file, "cannot be read as ONNX"))?;
    check(&proto).map_err(|Bad { place, found, allowed }| {
        let found: String = found.chars().take(200).collect();
        Error::bad(file.display().to_string(), place, found, allowed)
    })?;
    Ok(proto)
}

/// The bytes of a model that was checked, without whatever the reader did not know.
pub(super) fn bytes(proto: &ModelProto) -> Vec<u8> {
    proto.encode_to_vec()
}

/// The entries that the model's writer left.
pub(super) fn metadata(proto: &ModelProto) -> BTreeMap<String, String> {
    proto.metadata_props.iter().map(|entry| (entry.key.clone(), entry.value.clone())).collect()
}

/// A model that is refused for a reason that a runtime gave.
pub(super) fn bad(file: &Path, reason: &str) -> Error {
    Error::bad(file.display().to_string(), "model", reason, ALLOWED)
}

/// Why a model is refused.
struct Bad {
    place: String,
    found: String,
    allowed: String,
}

type Checked = std::result::Result<(), Bad>;

fn refuse(place: impl Into<String>, found: impl Into<String>, allowed: impl Into<String>) -> Checked {
    Err(Bad { place: place.into(), found: found.into(), allowed: allowed.into() })
}

/// What must not be there at all.
fn none(place: &str, found: &str, count: usize) -> Checked {
    if count == 0 { Ok(()) } else { refuse(place, found, "a model without") }
}

/// At most so many.
fn few(place: &str, what: &str, count: usize, most: usize) -> Checked {
    if count <= most { Ok(()) } else { refuse(place, format!("{count} {what}"), format!("at most {most}")) }
}

fn name(place: &str, text: &str) -> Checked {
    few(place, "bytes of a name", text.len(), MOST_NAME)
}

fn words(place: &str, text: &str) -> Checked {
    few(place, "bytes of a description", text.len(), MOST_WORDS)
}

fn check(model: &ModelProto) -> Checked {
    let ModelProto {
        ir_version,
        opset_import,
        producer_name,
        producer_version,
        domain,
        model_version: _,
        doc_string,
        graph,
        metadata_props,
        training_info,
        functions,
    } = model;
    if !FORMS.contains(ir_version) {
        return refuse("ir_version", ir_version.to_string(), format!("{} to {}", FORMS.start(), FORMS.end()));
    }
    operator_sets(opset_import)?;
    name("producer_name", producer_name)?;
    name("producer_version", producer_version)?;
    name("domain", domain)?;
    words("doc_string", doc_string)?;
    entries(metadata_props)?;
    none("training_info", "steps of a training", training_info.len())?;
    if let Some(function) = functions.first() {
        return refuse("functions", format!("a function `{}`", function.name()), "a model without");
    }
    match graph {
        Some(graph) => check_graph(graph),
        None => refuse("model", "holds no graph", ALLOWED),
    }
}

fn operator_sets(sets: &[OperatorSetIdProto]) -> Checked {
    let place = "opset_import";
    if sets.len() != 1 {
        return refuse(place, format!("{} sets of operators", sets.len()), "ONNX's own");
    }
    let OperatorSetIdProto { domain, version } = &sets[0];
    if !(domain.is_empty() || domain == "ai.onnx") {
        return refuse(place, format!("operators of `{domain}`"), "ONNX's own");
    }
    if !OPERATOR_SETS.contains(version) {
        let (first, last) = (OPERATOR_SETS.start(), OPERATOR_SETS.end());
        return refuse(place, version.to_string(), format!("{first} to {last}"));
    }
    Ok(())
}

fn entries(all: &[StringStringEntryProto]) -> Checked {
    let place = "metadata_props";
    few(place, "entries", all.len(), MOST_ENTRIES)?;
    few(place, "bytes", all.iter().map(|e| e.key.len().saturating_add(e.value.len())).sum(), MOST_METADATA)?;
    let mut seen = BTreeSet::new();
    for StringStringEntryProto { key, value: _ } in all {
        name(place, key)?;
        if !seen.insert(key) {
            return refuse(place, format!("`{key}` twice"), "each once");
        }
    }
    Ok(())
}

fn check_graph(graph: &GraphProto) -> Checked {
    let GraphProto {
        node,
        name: own_name,
        initializer,
        sparse_initializer,
        doc_string,
        input,
        output,
        value_info,
        quantization_annotation,
    } = graph;
    name("graph", own_name)?;
    words("graph", doc_string)?;
    // First whatever points out of the file: its name says most.
    let mut names = BTreeSet::new();
    for tensor in initializer {
        let place = format!("initializer `{}`", tensor.name);
        check_tensor(&place, tensor)?;
        if tensor.name.is_empty() || !names.insert(tensor.name.as_str()) {
            return refuse(place, "no name, or that of another", "tensors with names of their own");
        }
    }
    if let Some(sparse) = sparse_initializer.first() {
        let (values, indices) = (sparse.values.as_ref(), sparse.indices.as_ref());
        let place = format!("sparse_initializer `{}`", values.map_or("", |v| &v.name));
        for (part, tensor) in [("values", values), ("indices", indices)] {
            tensor.map_or(Ok(()), |tensor| inside(&format!("{place}, {part}"), tensor))?;
        }
        return refuse(place, "a sparse tensor", "dense ones");
    }
    none("quantization_annotation", "notes on quantised tensors", quantization_annotation.len())?;
    few("node", "nodes", node.len(), MOST_NODES)?;
    node.iter().try_for_each(check_node)?;
    few("value_info", "values", value_info.len(), MOST_NODES)?;
    few("input", "inputs", input.len(), MOST_NODES)?;
    few("output", "outputs", output.len(), MOST_NODES)?;
    value_info.iter().chain(input).chain(output).try_for_each(check_value)?;
    let inputs = input.iter().filter(|i| !names.contains(i.name.as_str())).count();
    if inputs != 1 || output.len() != 1 {
        return refuse("model", format!("has {inputs} inputs and {} outputs", output.len()), ALLOWED);
    }
    Ok(())
}

fn check_node(node: &NodeProto) -> Checked {
    let NodeProto { input, output, name: own_name, op_type, domain, attribute, doc_string } = node;
    if !domain.is_empty() {
        return refuse("operator", format!("{op_type} of `{domain}`"), "ONNX's own");
    }
    if !OPERATORS.contains(&op_type.as_str()) {
        let allowed = format!("the operators that `isoplanat export` writes: {}", OPERATORS.join(", "));
        return refuse("operator", op_type.chars().take(60).collect::<String>(), allowed);
    }
    let place = format!("node `{own_name}` ({op_type})");
    name(&place, own_name)?;
    words(&place, doc_string)?;
    few(&place, "inputs", input.len(), MOST_PARTS)?;
    few(&place, "outputs", output.len(), MOST_PARTS)?;
    input.iter().chain(output).try_for_each(|value| name(&place, value))?;
    few(&place, "attributes", attribute.len(), MOST_PARTS)?;
    attribute.iter().try_for_each(|attribute| check_attribute(&place, attribute))
}

/// Numbers and short texts: no operator of the list takes a tensor or a graph.
fn check_attribute(node: &str, attribute: &AttributeProto) -> Checked {
    let AttributeProto {
        name: own_name,
        ref_attr_name,
        doc_string,
        r#type,
        f: _,
        i: _,
        s,
        t,
        g,
        sparse_tensor,
        floats,
        ints,
        strings,
        tensors,
        graphs,
        sparse_tensors,
        type_protos,
    } = attribute;
    let place = format!("{node}, attribute `{own_name}`");
    name(&place, own_name)?;
    words(&place, doc_string)?;
    t.iter().chain(tensors).try_for_each(|tensor| inside(&place, tensor))?;
    let sparse = sparse_tensor.iter().chain(sparse_tensors);
    sparse.flat_map(|s| s.values.iter().chain(&s.indices)).try_for_each(|tensor| inside(&place, tensor))?;
    none(&place, "a tensor", usize::from(t.is_some()) + tensors.len())?;
    none(&place, "a sparse tensor", usize::from(sparse_tensor.is_some()) + sparse_tensors.len())?;
    none(&place, "a graph", usize::from(g.is_some()) + graphs.len())?;
    none(&place, "a type", type_protos.len())?;
    none(&place, "an attribute of a function", ref_attr_name.len())?;
    use AttributeType as Kind;
    let kind = AttributeType::try_from(*r#type).unwrap_or(Kind::Undefined);
    if !matches!(kind, Kind::Float | Kind::Int | Kind::String | Kind::Floats | Kind::Ints | Kind::Strings) {
        return refuse(place, format!("a value of kind {}", *r#type), "numbers, or texts");
    }
    few(&place, "numbers", floats.len().max(ints.len()).max(strings.len()), MOST_NUMBERS)?;
    let longest = strings.iter().chain([s]).map(Vec::len).max().unwrap_or(0);
    few(&place, "bytes of a text", longest, MOST_NAME)
}

/// Refuses a tensor whose numbers are not in the file.
fn inside(place: &str, tensor: &TensorProto) -> Checked {
    let external = &tensor.external_data;
    let here = tensor.data_location.is_none_or(|l| l == DataLocation::Default as i32);
    if external.is_empty() && here {
        return Ok(());
    }
    let location = external.iter().find(|e| e.key == "location").map_or("another file", |e| &e.value);
    refuse(place, format!("its data lies in `{location}`"), "data within the model's file")
}

/// A tensor of numbers that the exporter writes, all of them in the file and no more.
fn check_tensor(place: &str, tensor: &TensorProto) -> Checked {
    let TensorProto {
        dims,
        data_type,
        segment,
        float_data,
        int32_data,
        string_data,
        int64_data,
        name: own_name,
        doc_string,
        raw_data,
        double_data,
        uint64_data,
        data_location: _,
        external_data: _,
    } = tensor;
    name(place, own_name)?;
    words(place, doc_string)?;
    inside(place, tensor)?;
    none(place, "a part of a tensor", usize::from(segment.is_some()))?;
    none(place, "texts", string_data.len())?;
    few(place, "sides", dims.len(), MOST_PARTS)?;
    let count = dims.iter().try_fold(1_usize, |n, side| n.checked_mul(usize::try_from(*side).ok()?));
    // Each kind's bytes, and the list that holds its numbers where they are not raw.
    let (bytes, listed) = match DataType::try_from(*data_type) {
        Ok(DataType::Float) => (4, float_data.len()),
        Ok(DataType::Float16 | DataType::Bfloat16) => (2, int32_data.len()),
        Ok(DataType::Int32) => (4, int32_data.len()),
        Ok(DataType::Int64) => (8, int64_data.len()),
        _ => return refuse(place, format!("numbers of type {data_type}"), "FLOAT, FLOAT16, BFLOAT16, INT32 or INT64"),
    };
    let lists = [float_data.len(), int32_data.len(), int64_data.len(), double_data.len(), uint64_data.len()];
    let fits = count.is_some_and(|count| {
        let raw = listed == 0 && count.checked_mul(bytes) == Some(raw_data.len());
        let list = raw_data.is_empty() && listed == count;
        (raw || list) && lists.iter().sum::<usize>() == listed
    });
    if fits {
        return Ok(());
    }
    let held = format!("{} bytes and {} numbers", raw_data.len(), lists.iter().sum::<usize>());
    refuse(place, format!("{held} for sides {dims:?}"), "as many as its sides say")
}

/// A description of a value: a tensor's kind and sides.
fn check_value(value: &ValueInfoProto) -> Checked {
    let ValueInfoProto { name: own_name, r#type, doc_string } = value;
    let place = format!("value `{own_name}`");
    name(&place, own_name)?;
    words(&place, doc_string)?;
    let Some(TypeProto { denotation, value: kind }) = r#type else { return Ok(()) };
    name(&place, denotation)?;
    let Some(type_proto::Value::TensorType(type_proto::Tensor { elem_type: _, shape })) = kind else {
        return refuse(place, "no tensor", ALLOWED);
    };
    let sides = shape.as_ref().map_or(&[][..], |s| &s.dim);
    few(&place, "sides", sides.len(), MOST_PARTS)?;
    for Dimension { denotation, value } in sides {
        name(&place, denotation)?;
        if let Some(tract_onnx::pb::tensor_shape_proto::dimension::Value::DimParam(text)) = value {
            name(&place, text)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
