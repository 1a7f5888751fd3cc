//! What is refused, each by its name; what is kept.

use super::*;
use crate::test_model;
use tract_onnx::pb::{FunctionProto, SparseTensorProto, TensorAnnotation, TrainingInfoProto, tensor_proto::Segment};

fn model() -> ModelProto {
    read(&test_model::unet(4, 3, &[("isoplanat.name", "x")]), Path::new("m.onnx")).expect("allowed")
}

fn graph(model: &mut ModelProto) -> &mut GraphProto {
    model.graph.as_mut().expect("a graph")
}

fn outside(tensor: &mut TensorProto) {
    tensor.data_location = Some(DataLocation::External as i32);
    tensor.external_data = vec![StringStringEntryProto { key: "location".into(), value: "../secret.bin".into() }];
}

fn external(name: &str) -> TensorProto {
    let mut tensor = TensorProto { name: name.into(), data_type: DataType::Float as i32, ..TensorProto::default() };
    outside(&mut tensor);
    tensor
}

/// An attribute of the first node, with something that no operator of the list takes.
fn attribute(change: impl FnOnce(&mut AttributeProto)) -> impl FnOnce(&mut ModelProto) {
    move |model| change(&mut graph(model).node[0].attribute[0])
}

type Change = Box<dyn FnOnce(&mut ModelProto)>;
type AttributeChange = Box<dyn FnOnce(&mut AttributeProto)>;

fn changes() -> Vec<(&'static str, Change)> {
    let mut all: Vec<(&'static str, Change)> = vec![
        ("ir_version: 3; 4 to 13", Box::new(|m| m.ir_version = 3)),
        ("opset_import: 12; 13 to 24", Box::new(|m| m.opset_import[0].version = 12)),
        ("opset_import: operators of `ai.onnx.ml`", Box::new(|m| m.opset_import[0].domain = "ai.onnx.ml".into())),
        ("opset_import: 0 sets", Box::new(|m| m.opset_import.clear())),
        ("doc_string: 65537 bytes", Box::new(|m| m.doc_string = "x".repeat(MOST_WORDS + 1))),
        ("metadata_props: 1048591 bytes", Box::new(|m| m.metadata_props[0].value = "x".repeat(MOST_METADATA + 1))),
        (
            "metadata_props: 300 entries",
            Box::new(|m| {
                let entry = |k: usize| StringStringEntryProto { key: k.to_string(), value: String::new() };
                m.metadata_props = (0..300).map(entry).collect();
            }),
        ),
        ("`isoplanat.name` twice", Box::new(|m| m.metadata_props.push(m.metadata_props[0].clone()))),
        ("training_info: steps of a training", Box::new(|m| m.training_info.push(TrainingInfoProto::default()))),
        (
            "functions: a function `PRelu`",
            Box::new(|m| {
                m.functions.push(FunctionProto { name: Some("PRelu".into()), ..FunctionProto::default() });
            }),
        ),
        ("holds no graph", Box::new(|m| m.graph = None)),
        ("operator: Loop; the operators that", Box::new(|m| graph(m).node[0].op_type = "Loop".into())),
        ("operator: Constant; ", Box::new(|m| graph(m).node[0].op_type = "Constant".into())),
        ("operator: Conv of `com.microsoft`", Box::new(|m| graph(m).node[0].domain = "com.microsoft".into())),
        ("initializer `e1.w`: its data lies in `../secret.bin`", Box::new(|m| outside(&mut graph(m).initializer[0]))),
        (
            "initializer `e1.w`: its data lies in `another file`",
            Box::new(|m| {
                graph(m).initializer[0].data_location = Some(DataLocation::External as i32);
            }),
        ),
        (
            "initializer `e1.w`: its data lies in `another file`",
            Box::new(|m| {
                // A place that no version knows.
                graph(m).initializer[0].data_location = Some(7);
            }),
        ),
        (
            "sparse_initializer `s`, values: its data lies in `../secret.bin`",
            Box::new(|m| {
                let sparse = SparseTensorProto { values: Some(external("s")), ..SparseTensorProto::default() };
                graph(m).sparse_initializer.push(sparse);
            }),
        ),
        (
            "sparse_initializer `s`, indices: its data lies in `../secret.bin`",
            Box::new(|m| {
                let values = TensorProto { name: "s".into(), ..TensorProto::default() };
                let sparse = SparseTensorProto { values: Some(values), indices: Some(external("i")), dims: vec![1] };
                graph(m).sparse_initializer.push(sparse);
            }),
        ),
        (
            "sparse_initializer ``: a sparse tensor",
            Box::new(|m| {
                graph(m).sparse_initializer.push(SparseTensorProto::default());
            }),
        ),
        (
            "quantization_annotation",
            Box::new(|m| {
                graph(m).quantization_annotation.push(TensorAnnotation::default());
            }),
        ),
        (
            "initializer `e1.b`: no name, or that of another",
            Box::new(|m| {
                let again = graph(m).initializer[1].clone();
                graph(m).initializer.push(again);
            }),
        ),
        ("numbers of type 8", Box::new(|m| graph(m).initializer[0].data_type = DataType::String as i32)),
        (
            "for sides [2147483648, 2147483648, 2147483648]",
            Box::new(|m| graph(m).initializer[0].dims = vec![1 << 31; 3]),
        ),
        ("for sides [-1, 3, 3, 3]", Box::new(|m| graph(m).initializer[0].dims[0] = -1)),
        ("for sides [4, 3, 3, 3]", Box::new(|m| graph(m).initializer[0].raw_data.truncate(400))),
        ("432 bytes and 1 numbers", Box::new(|m| graph(m).initializer[0].float_data.push(0.0))),
        ("initializer `e1.w`: texts", Box::new(|m| graph(m).initializer[0].string_data.push(vec![1]))),
        (
            "initializer `e1.w`: a part of a tensor",
            Box::new(|m| {
                graph(m).initializer[0].segment = Some(Segment { begin: 0, end: 1 });
            }),
        ),
        (
            "has 2 inputs and 1 outputs",
            Box::new(|m| {
                let more = ValueInfoProto { name: "z".into(), ..ValueInfoProto::default() };
                graph(m).input.push(more);
            }),
        ),
        ("value `x`: no tensor", Box::new(|m| graph(m).input[0].r#type = Some(TypeProto::default()))),
    ];
    let attributes: Vec<(&'static str, AttributeChange)> = vec![
        ("attribute `kernel_shape`: its data lies in `../secret.bin`", Box::new(|a| a.t = Some(external("t")))),
        ("attribute `kernel_shape`: its data lies in `../secret.bin`", Box::new(|a| a.tensors.push(external("t")))),
        (
            "attribute `kernel_shape`: its data lies in `../secret.bin`",
            Box::new(|a| {
                a.sparse_tensor =
                    Some(SparseTensorProto { indices: Some(external("t")), ..SparseTensorProto::default() });
            }),
        ),
        ("attribute `kernel_shape`: a tensor", Box::new(|a| a.t = Some(TensorProto::default()))),
        ("attribute `kernel_shape`: a graph", Box::new(|a| a.g = Some(GraphProto::default()))),
        ("attribute `kernel_shape`: a graph", Box::new(|a| a.graphs.push(GraphProto::default()))),
        (
            "attribute `kernel_shape`: a sparse tensor",
            Box::new(|a| a.sparse_tensors.push(SparseTensorProto::default())),
        ),
        ("attribute `kernel_shape`: a type", Box::new(|a| a.type_protos.push(TypeProto::default()))),
        ("attribute `kernel_shape`: an attribute of a function", Box::new(|a| a.ref_attr_name = "k".into())),
        ("attribute `kernel_shape`: a value of kind 5", Box::new(|a| a.r#type = AttributeType::Graph as i32)),
        ("attribute `kernel_shape`: 2000 numbers", Box::new(|a| a.ints = vec![1; 2000])),
    ];
    all.extend(attributes.into_iter().map(|(words, change)| (words, Box::new(attribute(change)) as Change)));
    all
}

#[test]
fn whatever_is_not_allowed_is_refused_by_its_name() {
    for (words, change) in changes() {
        let mut changed = model();
        change(&mut changed);
        let error = read(&bytes(&changed), Path::new("m.onnx")).expect_err(words);
        let said = error.to_string();
        assert!(said.starts_with("m.onnx: ") && said.contains(words) && !said.contains('\n'), "{words}: {said}");
        assert_eq!(error.exit_code(), 2);
    }
}

/// Fields that the reader does not know (of a newer version, say) do not reach a runtime, wherever they stand.
#[test]
fn unknown_fields_are_left_out() {
    let plain = bytes(&model());
    let field = |number: u32, text: &[u8]| {
        let mut out = Vec::new();
        prost::encoding::encode_key(number, prost::encoding::WireType::LengthDelimited, &mut out);
        prost::encoding::encode_varint(text.len() as u64, &mut out);
        out.extend(text);
        out
    };
    // Of the model; and of the graph (field 7), which readers put together from its parts.
    for more in [field(26, b"configuration"), field(7, &field(16, b"metadata")), field(1 << 20, b"secret.bin")] {
        let mut longer = plain.clone();
        longer.extend(&more);
        assert_eq!(bytes(&read(&longer, Path::new("m.onnx")).expect("allowed")), plain);
    }
}
