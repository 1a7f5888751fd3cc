//! VGG-19's first layers as a measure of content (paper eq. 12), with weights from a file.
//!
//! K. Simonyan, A. Zisserman, "Very deep convolutional networks for large-scale image recognition", ICLR 2015; as a loss:
//! J. Johnson, A. Alahi, L. Fei-Fei, "Perceptual losses for real-time style transfer and super-resolution", ECCV 2016. Two
//! kinds of file: torchvision's names (`features.0.weight` …; zeros around, ImageNet's mean and deviation) and the layers'
//! names with a preprocessing layer (`preprocess.weight`, `conv1_1.weight` …; reflected borders). The deepest layer
//! present counts, up to conv3_3, after its ReLU.

use std::path::Path;

use burn::tensor::activation::relu;
use burn::tensor::module::conv2d;
use burn::tensor::ops::{ConvOptions, PadMode};
use burn::tensor::{Device, Tensor, TensorData};

use super::layers::{Features, Way, convolve, pool};
use super::tensors::TensorFile;
use isoplanat_base::error::Result;

/// A layer: its name, its place in torchvision's list, channels in and out, whether a max-pooling stands before it.
type Shape = (&'static str, usize, usize, usize, bool);

const LAYERS: [Shape; 7] = [
    ("conv1_1", 0, 3, 64, false),
    ("conv1_2", 2, 64, 64, false),
    ("conv2_1", 5, 64, 128, true),
    ("conv2_2", 7, 128, 128, false),
    ("conv3_1", 10, 128, 256, true),
    ("conv3_2", 12, 256, 256, false),
    ("conv3_3", 14, 256, 256, false),
];

/// ImageNet's mean and standard deviation of RGB, which torchvision's weights expect to be taken off.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

const ALLOWED: &str = "VGG-19 weights as safetensors, torchvision's names (features.0.weight, …) or conv1_1.weight, …";

/// VGG-19 up to some layer, held fixed.
#[derive(Debug)]
pub(super) struct Vgg {
    way: Way,
    preprocess: (Tensor<4>, Tensor<1>),
    layers: Vec<Layer>,
    deepest: &'static str,
    reflect: bool,
}

#[derive(Debug)]
struct Layer {
    weight: Tensor<4>,
    bias: Tensor<1>,
    /// Slopes of zero: PReLU as ReLU.
    slope: Tensor<1>,
    pooled: bool,
}

impl Vgg {
    /// Reads the weights of all layers that the file has, from the first on without a gap.
    ///
    /// # Errors
    /// A file that is none of the two kinds, or whose tensors have other shapes.
    pub(super) fn load(path: &Path, way: impl Into<Way>, device: &Device) -> Result<Self> {
        let file = TensorFile::read(path, ALLOWED)?;
        let names = file.names()?;
        let has = |name: &str| names.iter().any(|n| n == name);
        let torchvision = has("features.0.weight");
        if !torchvision && !has("conv1_1.weight") {
            return Err(file.bad("tensors", "no first layer", ALLOWED));
        }
        let tensor = |values: Vec<f32>, shape: [usize; 4]| Tensor::from_data(TensorData::new(values, shape), device);
        let vector = |values: Vec<f32>| {
            let n = values.len();
            Tensor::<1>::from_data(TensorData::new(values, [n]), device)
        };
        let (matrix, offset) = if torchvision {
            let matrix = (0..9).map(|i| if i % 4 == 0 { 1.0 / DEVIATION[i / 3] } else { 0.0 }).collect();
            (matrix, MEAN.iter().zip(DEVIATION).map(|(m, d)| -m / d).collect())
        } else if has("preprocess.weight") {
            (file.tensor("preprocess.weight", &[3, 3, 1, 1])?, file.tensor("preprocess.bias", &[3])?)
        } else {
            return Err(file.bad("preprocess.weight", "missing", "the 1 x 1 layer before conv1_1"));
        };
        let mut layers = Vec::new();
        let mut deepest = "";
        for (name, place, inputs, outputs, pooled) in LAYERS {
            let stem = if torchvision { format!("features.{place}") } else { name.to_owned() };
            if !has(&format!("{stem}.weight")) {
                break;
            }
            let shape = [outputs, inputs, 3, 3];
            let weight = tensor(file.tensor(&format!("{stem}.weight"), &shape)?, shape);
            let bias = vector(file.tensor(&format!("{stem}.bias"), &[outputs])?);
            layers.push(Layer { weight, bias, slope: vector(vec![0.0; outputs]), pooled });
            deepest = name;
        }
        let preprocess = (tensor(matrix, [3, 3, 1, 1]), vector(offset));
        Ok(Self { way: way.into(), preprocess, layers, deepest, reflect: !torchvision })
    }

    /// Has other code run its operations.
    pub(super) fn set_way(&mut self, way: Way) {
        self.way = way;
    }

    /// The deepest layer, as `conv3_3`.
    pub(super) fn deepest(&self) -> &'static str {
        self.deepest
    }

    /// Features after the deepest layer's ReLU of an sRGB-encoded picture in `[0, 1]`.
    ///
    /// # Shapes
    /// `[batch, 3, row, col]` → `[batch, 256, row / 4, col / 4]` (conv3); rows and columns multiples of 4.
    pub(super) fn forward(&self, encoded: Tensor<4>) -> Tensor<4> {
        self.layers(encoded).pop().expect("a first layer")
    }

    /// Every layer's output after its ReLU.
    fn layers(&self, encoded: Tensor<4>) -> Vec<Tensor<4>> {
        let (matrix, offset) = self.preprocess.clone();
        let mut features =
            Features::plain(conv2d(encoded, matrix, Some(offset), ConvOptions::new([1, 1], [0, 0], [1, 1], 1)));
        let last = self.layers.len() - 1;
        let mut found = Vec::new();
        for (i, layer) in self.layers.iter().enumerate() {
            if layer.pooled {
                features = Features::plain(pool(self.way, &features));
            }
            let (weight, bias) = (layer.weight.clone(), layer.bias.clone());
            let values = if self.reflect {
                let [_, _, rows, columns] = features.values.dims();
                let activated = match features.slope {
                    Some(_) => relu(features.values),
                    None => features.values,
                };
                let around = Features::plain(activated.pad((1, 1, 1, 1), PadMode::Reflect));
                convolve(self.way, &[&around], weight, bias).narrow(2, 1, rows).narrow(3, 1, columns)
            } else {
                convolve(self.way, &[&features], weight, bias)
            };
            if cfg!(test) || i == last {
                found.push(relu(values.clone()));
            }
            features = Features { values, slope: Some(layer.slope.clone()) };
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Level;
    use super::super::tensors::{Named, write};
    use super::*;
    use isoplanat_base::testing::{assert_rel, shared};
    use isoplanat_imaging::files::{Encoding, read_picture};

    /// The partial file's layers against activations that another program recorded in f64.
    #[test]
    fn activations_are_those_that_were_recorded() {
        let Some(data) = shared("data") else { return };
        let path = data.join("vgg19/vgg19_normalised_to_relu3_1.safetensors");
        let device = Device::flex();
        let picture = read_picture(&data.join("photos/eval/23.png"), Encoding::Linear).expect("reads");
        let crop = picture.slice(ndarray::s![.., 100..164, 200..264]).to_owned();
        let values = crop.as_standard_layout().iter().copied().collect::<Vec<f32>>();
        let text = std::fs::read_to_string(data.join("vgg19/reference_activations.json")).expect("reads");
        let recorded: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        for level in [Level::detect(), Level::Plain] {
            let vgg = Vgg::load(&path, level, &device).expect("loads");
            assert_eq!(vgg.deepest(), "conv3_1");
            let input = Tensor::from_data(TensorData::new(values.clone(), [1, 3, 64, 64]), &device);
            for (layer, name) in
                vgg.layers(input).into_iter().zip(["conv1_1", "conv1_2", "conv2_1", "conv2_2", "conv3_1"])
            {
                let want = &recorded["relu_activations"][name];
                let shape: Vec<usize> = serde_json::from_value(want["shape"].clone()).expect("a shape");
                assert_eq!(layer.dims()[1..], shape[..], "{name}");
                let found = layer.into_data().try_into_vec::<f32>().expect("f32");
                let sum: f64 = found.iter().map(|&v| f64::from(v)).sum();
                assert_rel(sum, want["sum"].as_f64().expect("a number"), 1e-5, 1e-9, name);
                let largest = f64::from(found.iter().fold(0f32, |m, v| m.max(*v)));
                assert_rel(largest, want["max"].as_f64().expect("a number"), 1e-5, 1e-9, name);
                // The first channels at the first pixel.
                let plane = shape[1] * shape[2];
                for (i, v) in want["first"].as_array().expect("numbers").iter().enumerate() {
                    assert_rel(f64::from(found[i * plane]), v.as_f64().expect("a number"), 1e-6, largest, name);
                }
            }
        }
    }

    /// Random weights of both kinds: our layers against burn's own, with zeros around as torchvision has it, and the deepest
    /// layer is said.
    #[test]
    fn torchvision_files_go_as_deep_as_they_have_layers() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let device = Device::flex();
        let rng = &mut fastrand::Rng::with_seed(3);
        let mut tensors: Vec<Named<'static>> = Vec::new();
        for (_, place, inputs, outputs, _) in LAYERS {
            for (part, shape) in [("weight", vec![outputs, inputs, 3, 3]), ("bias", vec![outputs])] {
                let n: usize = shape.iter().product();
                let scale = (2.0 / (9.0 * inputs as f32)).sqrt();
                let values: Vec<f32> = (0..n).map(|_| scale * (3.0 * rng.f32() - 1.4)).collect();
                tensors.push(Named { name: format!("features.{place}.{part}"), shape, values: values.into() });
            }
        }
        let path = folder.path().join("vgg.safetensors");
        for (kept, deepest) in [(14, "conv3_3"), (12, "conv3_2"), (6, "conv2_1")] {
            tensors.truncate(kept);
            write(&path, &std::collections::BTreeMap::new(), &tensors).expect("written");
            let input: Vec<f32> = (0..3 * 16 * 24).map(|_| rng.f32()).collect();
            let run = |level| {
                let vgg = Vgg::load(&path, level, &device).expect("loads");
                assert_eq!(vgg.deepest(), deepest);
                let x = Tensor::from_data(TensorData::new(input.clone(), [1, 3, 16, 24]), &device);
                vgg.forward(x).into_data().try_into_vec::<f32>().expect("f32")
            };
            let (fast, plain) = (run(Level::detect()), run(Level::Plain));
            let scale = plain.iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(scale > 0.0);
            assert!(fast.iter().zip(&plain).all(|(a, b)| (a - b).abs() <= 1e-5 * scale));
        }
        // The first layer by hand: mean and deviation taken off, zeros around.
        let x = Tensor::<4>::full([1, 3, 4, 4], 0.5, &device);
        tensors.truncate(2);
        write(&path, &std::collections::BTreeMap::new(), &tensors).expect("written");
        let found = Vgg::load(&path, Level::detect(), &device).expect("loads").forward(x);
        let found = found.into_data().try_into_vec::<f32>().expect("f32");
        let mut corner = f64::from(tensors[1].values[7]);
        for c in 0..3 {
            let value = f64::from((0.5 - MEAN[c]) / DEVIATION[c]);
            for tap in [4, 5, 7, 8] {
                corner += value * f64::from(tensors[0].values[(7 * 3 + c) * 9 + tap]);
            }
        }
        assert_rel(f64::from(found[7 * 16]), corner.max(0.0), 1e-5, 1e-3, "corner of channel 7");
    }

    #[test]
    fn files_that_are_no_vgg_are_refused() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("vgg.safetensors");
        let device = Device::flex();
        let refused = |path: &Path| Vgg::load(path, Level::Plain, &device).expect_err("refused").to_string();
        assert!(refused(&path).contains("reading"));
        std::fs::write(&path, b"not a tensor file").expect("written");
        assert!(refused(&path).contains("header"));
        let one = |name: &str, shape: Vec<usize>| {
            let n = shape.iter().product();
            Named { name: name.into(), shape, values: vec![0.5f32; n].into() }
        };
        let none = std::collections::BTreeMap::new();
        write(&path, &none, &[one("classifier.weight", vec![4])]).expect("written");
        assert!(refused(&path).contains("no first layer"));
        write(&path, &none, &[one("features.0.weight", vec![64, 3, 5, 5])]).expect("written");
        assert!(refused(&path).contains("[64, 3, 3, 3]"));
        write(&path, &none, &[one("conv1_1.weight", vec![64, 3, 3, 3])]).expect("written");
        assert!(refused(&path).contains("preprocess.weight"));
    }
}
