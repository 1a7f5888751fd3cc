//! Small ONNX models for tests, written straight in protobuf wire format, so that no file and no writer is needed.
//! Field numbers are those of `onnx.proto` (IR version 9).

/// A field that holds bytes, text or a message.
fn field(number: u64, bytes: &[u8]) -> Vec<u8> {
    let mut out = varint(number << 3 | 2);
    out.extend(varint(bytes.len() as u64));
    out.extend(bytes);
    out
}

/// A field that holds an integer.
fn int(number: u64, value: u64) -> Vec<u8> {
    let mut out = varint(number << 3);
    out.extend(varint(value));
    out
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

fn tensor(name: &str, dims: &[u64], values: &[f32]) -> Vec<u8> {
    assert_eq!(dims.iter().product::<u64>(), values.len() as u64);
    let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    [dims.iter().flat_map(|&d| int(1, d)).collect(), int(2, 1), field(8, name.as_bytes()), field(9, &raw)].concat()
}

/// An attribute of type INTS.
fn ints(name: &str, values: &[u64]) -> Vec<u8> {
    [field(1, name.as_bytes()), values.iter().flat_map(|&v| int(8, v)).collect(), int(20, 7)].concat()
}

/// An attribute of type INT.
fn single(name: &str, value: u64) -> Vec<u8> {
    [field(1, name.as_bytes()), int(3, value), int(20, 2)].concat()
}

fn node(kind: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let inputs: Vec<u8> = inputs.iter().flat_map(|i| field(1, i.as_bytes())).collect();
    let attributes: Vec<u8> = attributes.iter().flat_map(|a| field(5, a)).collect();
    let named = [field(2, output.as_bytes()), field(3, output.as_bytes()), field(4, kind.as_bytes())].concat();
    [inputs, named, attributes].concat()
}

/// `[batch, 3, height, width]` of f32, all but the channels free.
fn value(name: &str) -> Vec<u8> {
    let free = |n: &str| field(1, &field(2, n.as_bytes()));
    let shape = [free("batch"), field(1, &int(1, 3)), free("height"), free("width")].concat();
    let kind = field(1, &[int(1, 1), field(2, &shape)].concat());
    [field(1, name.as_bytes()), field(2, &kind)].concat()
}

fn model(nodes: &[Vec<u8>], weights: &[Vec<u8>], metadata: &[(&str, &str)]) -> Vec<u8> {
    let mut graph: Vec<u8> = nodes.iter().flat_map(|n| field(1, n)).collect();
    graph.extend(field(2, b"test"));
    graph.extend(weights.iter().flat_map(|w| field(5, w)));
    graph.extend(field(11, &value("x")));
    graph.extend(field(12, &value("y")));
    let mut out = [int(1, 9), field(8, &int(2, 17)), field(7, &graph)].concat();
    for (key, text) in metadata {
        out.extend(field(14, &[field(1, key.as_bytes()), field(2, text.as_bytes())].concat()));
    }
    out
}

/// One 1×1 convolution.
pub(crate) fn pointwise(matrix: [[f32; 3]; 3], bias: [f32; 3]) -> Vec<u8> {
    let weights = [tensor("w", &[3, 3, 1, 1], matrix.as_flattened()), tensor("b", &[3], &bias)];
    model(&[node("Conv", &["x", "w", "b"], "y", &[ints("kernel_shape", &[1, 1])])], &weights, &[])
}

/// A U-Net of three scales (`width`, `2·width`, `4·width` channels; PReLU, max pooling, transposed convolution, skips by
/// concatenation, global skip) with random weights. It depends on no pixel further away than [`UNET_RADIUS`].
pub(crate) fn unet(width: u64, seed: u64, metadata: &[(&str, &str)]) -> Vec<u8> {
    let mut rng = fastrand::Rng::with_seed(seed);
    let (mut nodes, mut weights) = (Vec::new(), Vec::new());
    let mut random = |n: u64, scale: f32| -> Vec<f32> { (0..n).map(|_| scale * (rng.f32() - 0.5)).collect() };
    let mut block = |nodes: &mut Vec<Vec<u8>>, input: &str, name: &str, from: u64, to: u64, active: bool| {
        let scale = (12.0 / (9.0 * from as f32)).sqrt();
        weights.push(tensor(&format!("{name}.w"), &[to, from, 3, 3], &random(to * from * 9, scale)));
        weights.push(tensor(&format!("{name}.b"), &[to], &random(to, 0.1)));
        let shape = [ints("kernel_shape", &[3, 3]), ints("pads", &[1, 1, 1, 1])];
        let inputs = [input, &format!("{name}.w"), &format!("{name}.b")];
        nodes.push(node("Conv", &inputs, &format!("{name}.c"), &shape));
        if active {
            weights.push(tensor(&format!("{name}.s"), &[to, 1, 1], &vec![0.2; to as usize]));
            nodes.push(node("PRelu", &[&format!("{name}.c"), &format!("{name}.s")], name, &[]));
        }
    };
    let pool = [ints("kernel_shape", &[2, 2]), ints("strides", &[2, 2])];
    block(&mut nodes, "x", "e1", 3, width, true);
    nodes.push(node("MaxPool", &["e1"], "p1", &pool));
    block(&mut nodes, "p1", "e2", width, 2 * width, true);
    nodes.push(node("MaxPool", &["e2"], "p2", &pool));
    block(&mut nodes, "p2", "m1", 2 * width, 4 * width, true);
    block(&mut nodes, "m1", "m2", 4 * width, 4 * width, true);
    let up = |nodes: &mut Vec<Vec<u8>>, input: &str, name: &str, skip: &str| {
        nodes.push(node("ConvTranspose", &[input, &format!("{name}.w")], name, &pool));
        nodes.push(node("Concat", &[name, skip], &format!("{name}.k"), &[single("axis", 1)]));
    };
    up(&mut nodes, "m2", "u2", "e2");
    block(&mut nodes, "u2.k", "d2", 4 * width, 2 * width, true);
    up(&mut nodes, "d2", "u1", "e1");
    block(&mut nodes, "u1.k", "d1", 2 * width, width, true);
    block(&mut nodes, "d1", "out", width, 3, false);
    nodes.push(node("Add", &["x", "out.c"], "y", &[]));
    let mut rng = fastrand::Rng::with_seed(seed ^ 1);
    let mut transposed = |name: &str, from: u64, to: u64| {
        let values: Vec<f32> = (0..from * to * 4).map(|_| (3.0 / from as f32).sqrt() * (rng.f32() - 0.5)).collect();
        tensor(name, &[from, to, 2, 2], &values)
    };
    weights.extend([transposed("u2.w", 4 * width, 2 * width), transposed("u1.w", 2 * width, width)]);
    model(&nodes, &weights, metadata)
}

/// Radius of what a pixel of [`unet`] depends on: 1 + 2 (pool, 3×3) + 2·4 (pool, two 3×3) on the way down, 2 + 1 + 1 up,
/// and the cells of 2 and 4 pixels the pools join.
pub(crate) const UNET_RADIUS: usize = 24;
