//! The model card: what a network expects and what it was made for, stored in the ONNX file's metadata.
//!
//! It is the whole contract between training and the camera, so it knows nothing of burn. Every entry is a string under
//! the prefix `isoplanat.`; unknown entries are left alone, a newer schema is refused by its number.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Blocks, Inputs};
use isoplanat_base::error::{Error, Result};

/// The newest form of a card, that of networks which see point spread functions or filters for other noise. Others have an older one: of other blocks than the
/// paper's the third, else the second, which says nothing of blocks, or, where they see the capture alone, the first, which says nothing of inputs either.
pub const SCHEMA: u32 = 4;

/// The demosaicking kernel that training and camera share.
pub const DEMOSAIC: &str = "malvar-he-cutler";

/// What the network takes, in one sentence.
pub const INPUT_CONVENTION: &str = "[batch, 3, row, col] f32 linear camera RGB, black at 0, white at 1, \
                                    white-balanced, demosaicked; output alike";

const PREFIX: &str = "isoplanat.";

/// How a file stores the network's weights; the computation is in f32 either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Weights {
    /// 32 bits, as trained.
    #[default]
    F32,
    /// 16 bits (IEEE 754 binary16), half the file; each weight is rounded to 11 significant bits.
    F16,
}

impl Weights {
    /// The name in a card: `f32`, `f16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}

/// What a network expects and what it was trained for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelCard {
    /// Version of this form, [`SCHEMA`].
    pub schema: u32,
    /// Name of the model, for people.
    pub name: String,
    /// Name of the lens it was trained for.
    pub lens_name: String,
    /// SHA-256 (hex) of the lens file.
    pub lens_sha256: String,
    /// SHA-256 (hex) of the calibration (sensor, colour, distortion).
    pub calibration_sha256: String,
    /// SHA-256 (hex) of the list of training pictures.
    pub training_sha256: String,
    /// Channels of the finest scale.
    pub base_width: usize,
    /// Number of scales of the U-Net.
    pub scales: usize,
    /// Height and width must be multiples of this many pixels.
    pub multiple: usize,
    /// Colour channels in and out.
    pub channels: usize,
    /// Demosaicking kernel before the network.
    pub demosaic: String,
    /// What the input means, [`INPUT_CONVENTION`].
    pub input: String,
    /// No input pixel further away than this (in rows or columns) changes an output pixel: the overlap of tiles, pixels.
    pub receptive_radius_px: usize,
    /// How the file stores the weights; a card that does not say means f32.
    #[serde(default)]
    pub weights: Weights,
    /// What the network sees beside the capture.
    #[serde(default)]
    pub inputs: Inputs,
    /// What the network is made of.
    #[serde(default, skip_serializing_if = "Blocks::is_paper")]
    pub blocks: Blocks,
}

impl ModelCard {
    /// The card of a network of the paper's blocks, `base_width` channels and `scales` scales; lens, hashes and training stay
    /// empty.
    ///
    /// ```
    /// use isoplanat_card::{Inputs, ModelCard};
    ///
    /// let card = ModelCard::for_unet("street", 16, 3).seeing(Inputs::GUIDED);
    /// // What a file's metadata says is the card again.
    /// assert_eq!(ModelCard::from_metadata(&card.to_metadata())?, card);
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    pub fn for_unet(name: impl Into<String>, base_width: usize, scales: usize) -> Self {
        Self {
            schema: 1,
            name: name.into(),
            lens_name: String::new(),
            lens_sha256: String::new(),
            calibration_sha256: String::new(),
            training_sha256: String::new(),
            base_width,
            scales,
            multiple: 1 << scales.saturating_sub(1),
            channels: 3,
            demosaic: DEMOSAIC.into(),
            input: INPUT_CONVENTION.into(),
            receptive_radius_px: receptive_radius_px(Blocks::Paper, scales),
            weights: Weights::F32,
            inputs: Inputs::BARE,
            blocks: Blocks::Paper,
        }
    }

    /// The card of a network of these blocks.
    #[must_use]
    pub fn made_of(mut self, blocks: Blocks) -> Self {
        (self.blocks, self.receptive_radius_px) = (blocks, receptive_radius_px(blocks, self.scales));
        self.schema = self.oldest_schema();
        self
    }

    /// The first form that can say what the card says.
    fn oldest_schema(&self) -> u32 {
        let second = Inputs { levels: false, psf: false, ..self.inputs };
        match (self.blocks.is_paper(), self.inputs.is_bare()) {
            _ if self.inputs != second => 4,
            (false, _) => 3,
            (true, false) => 2,
            (true, true) => 1,
        }
    }

    /// The card of a network that sees `inputs` beside the capture.
    #[must_use]
    pub fn seeing(mut self, inputs: Inputs) -> Self {
        (self.inputs, self.input) = (inputs, INPUT_CONVENTION.into());
        self.schema = self.oldest_schema();
        if !inputs.is_bare() {
            self.input = format!(
                "[batch, {}, row, col] f32: linear camera RGB, black at 0, white at 1, white-balanced, demosaicked, then {}; \
                 output [batch, 3, row, col] alike",
                inputs.channels(),
                inputs.names().join(", ")
            );
        }
        self
    }

    /// The card as metadata entries for an ONNX file.
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let entries = [
            ("schema", self.schema.to_string()),
            ("name", self.name.clone()),
            ("lens_name", self.lens_name.clone()),
            ("lens_sha256", self.lens_sha256.clone()),
            ("calibration_sha256", self.calibration_sha256.clone()),
            ("training_sha256", self.training_sha256.clone()),
            ("base_width", self.base_width.to_string()),
            ("scales", self.scales.to_string()),
            ("multiple", self.multiple.to_string()),
            ("channels", self.channels.to_string()),
            ("demosaic", self.demosaic.clone()),
            ("input", self.input.clone()),
            ("receptive_radius_px", self.receptive_radius_px.to_string()),
            ("weights", self.weights.name().to_owned()),
        ];
        let inputs = (self.schema >= 2).then(|| ("inputs", self.inputs.names().join(" ")));
        let blocks = (self.schema >= 3).then(|| ("blocks", self.blocks.name().to_owned()));
        entries.into_iter().chain(inputs).chain(blocks).map(|(key, value)| (format!("{PREFIX}{key}"), value)).collect()
    }

    /// Reads a card back from an ONNX file's metadata; refuses missing entries, a newer schema, and values that no
    /// network of this program can have.
    pub fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self> {
        let schema = number(metadata, "schema")?;
        let schema = u32::try_from(schema).unwrap_or(u32::MAX);
        if !(1..=SCHEMA).contains(&schema) {
            return Err(Error::bad(
                "",
                format!("metadata {PREFIX}schema"),
                schema.to_string(),
                format!("this version reads schemas 1 to {SCHEMA}"),
            ));
        }
        let card = Self {
            schema,
            name: text(metadata, "name")?,
            lens_name: text(metadata, "lens_name")?,
            lens_sha256: text(metadata, "lens_sha256")?,
            calibration_sha256: text(metadata, "calibration_sha256")?,
            training_sha256: text(metadata, "training_sha256")?,
            base_width: number(metadata, "base_width")?,
            scales: number(metadata, "scales")?,
            multiple: number(metadata, "multiple")?,
            channels: number(metadata, "channels")?,
            demosaic: text(metadata, "demosaic")?,
            input: text(metadata, "input")?,
            receptive_radius_px: number(metadata, "receptive_radius_px")?,
            weights: weights(metadata)?,
            inputs: inputs(metadata, schema)?,
            blocks: blocks(metadata, schema)?,
        };
        card.validate()?;
        Ok(card)
    }

    /// Refuses a card whose numbers contradict each other or that asks for another input than the camera makes.
    fn validate(&self) -> Result<()> {
        let bad = |key: &str, found: String, allowed: &str| {
            Err(Error::bad("", format!("metadata {PREFIX}{key}"), found, allowed))
        };
        if self.channels != 3 {
            return bad("channels", self.channels.to_string(), "3 colour channels");
        }
        if !(1..=12).contains(&self.scales) {
            return bad("scales", self.scales.to_string(), "1 to 12 scales");
        }
        if self.multiple != 1 << (self.scales - 1) {
            return bad("multiple", self.multiple.to_string(), "2^(scales − 1)");
        }
        if self.receptive_radius_px > 1 << 16 {
            return bad("receptive_radius_px", self.receptive_radius_px.to_string(), "at most 65536 pixels");
        }
        if self.demosaic != DEMOSAIC {
            return bad("demosaic", self.demosaic.clone(), "malvar-he-cutler, the one kernel the camera has");
        }
        Ok(())
    }
}

/// Distance in rows or columns, pixels, beyond which an input pixel cannot change an output pixel of a U-Net of `scales`
/// scales: every 3×3 convolution at scale `s` adds `2^s` (those of a block going down, going up, and at the bottom, one at the
/// end), and pooling and unpooling align to blocks of `2^(scales − 1)`.
pub const fn receptive_radius_px(blocks: Blocks, scales: usize) -> usize {
    let coarsest = 1 << scales.saturating_sub(1);
    let down_and_up = 2 * blocks.convolutions() * (coarsest - 1);
    down_and_up + blocks.convolutions() * coarsest + 1 + (coarsest - 1)
}

fn text(metadata: &BTreeMap<String, String>, key: &str) -> Result<String> {
    metadata.get(&format!("{PREFIX}{key}")).cloned().ok_or_else(|| {
        Error::bad(
            "",
            format!("metadata {PREFIX}{key}"),
            "missing",
            "a model exported by `isoplanat export` carries it",
        )
    })
}

/// The only entry that may be missing: files written before it have f32.
fn weights(metadata: &BTreeMap<String, String>) -> Result<Weights> {
    let key = format!("{PREFIX}weights");
    match metadata.get(&key).map(String::as_str) {
        None | Some("f32") => Ok(Weights::F32),
        Some("f16") => Ok(Weights::F16),
        Some(other) => Err(Error::bad("", format!("metadata {key}"), other, "f32 or f16")),
    }
}

/// What the network sees; the first form of a card says nothing of it.
fn inputs(metadata: &BTreeMap<String, String>, schema: u32) -> Result<Inputs> {
    if schema == 1 {
        return Ok(Inputs::BARE);
    }
    let names = text(metadata, "inputs")?;
    Inputs::of_names(names.split_whitespace()).map_err(|e| placed(e, "inputs"))
}

/// The error of a bad entry `key`.
fn placed(error: Error, key: &str) -> Error {
    error.at(format!("metadata {PREFIX}{key}"))
}

/// What the network is made of; cards say so from the third form on.
fn blocks(metadata: &BTreeMap<String, String>, schema: u32) -> Result<Blocks> {
    if schema < 3 {
        return Ok(Blocks::Paper);
    }
    Blocks::of_name(&text(metadata, "blocks")?).map_err(|e| placed(e, "blocks"))
}

fn number(metadata: &BTreeMap<String, String>, key: &str) -> Result<usize> {
    let value = text(metadata, key)?;
    value.parse().map_err(|_| Error::bad("", format!("metadata {PREFIX}{key}"), value, "a whole number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_brings_the_card_back() {
        let mut card = ModelCard::for_unet("triplet", 16, 3);
        card.lens_name = "Cooke triplet, 50 mm f/5".into();
        card.lens_sha256 = "5a1e".repeat(16);
        assert_eq!(ModelCard::from_metadata(&card.to_metadata()).expect("own card"), card);
        assert_eq!((card.multiple, card.receptive_radius_px), (4, 24));
        let full = ModelCard::for_unet("full", 32, 7);
        assert_eq!((full.multiple, full.receptive_radius_px), (64, 444));
    }

    #[test]
    fn a_card_that_does_not_speak_of_its_weights_means_f32() {
        let mut card = ModelCard::for_unet("x", 16, 3);
        card.weights = Weights::F16;
        let mut metadata = card.to_metadata();
        assert_eq!(ModelCard::from_metadata(&metadata).expect("own card").weights, Weights::F16);
        metadata.insert("isoplanat.weights".into(), "int8".into());
        let message = ModelCard::from_metadata(&metadata).expect_err("unknown").to_string();
        assert!(message.contains("weights") && message.contains("int8"), "{message}");
        metadata.remove("isoplanat.weights");
        assert_eq!(ModelCard::from_metadata(&metadata).expect("an older card").weights, Weights::F32);
    }

    #[test]
    fn what_a_network_sees_stands_in_the_second_form() {
        let inputs = Inputs { wiener: true, field: true, ..Inputs::BARE };
        let card = ModelCard::for_unet("x", 16, 3).seeing(inputs);
        let mut metadata = card.to_metadata();
        assert_eq!((ModelCard::from_metadata(&metadata).expect("own card"), card.schema), (card.clone(), 2));
        metadata.insert("isoplanat.inputs".into(), "wiener smell".into());
        let message = ModelCard::from_metadata(&metadata).expect_err("unknown").to_string();
        assert!(message.contains("isoplanat.inputs") && message.contains("smell"), "{message}");
        metadata.remove("isoplanat.inputs");
        assert!(ModelCard::from_metadata(&metadata).is_err());
        assert_eq!(ModelCard::for_unet("x", 16, 3).seeing(Inputs::BARE).schema, 1);
    }

    #[test]
    fn point_spread_functions_and_levels_stand_in_the_fourth_form() {
        for inputs in [Inputs { psf: true, ..Inputs::BARE }, Inputs { field: true, ..Inputs::GUIDED }] {
            let card = ModelCard::for_unet("x", 16, 3).seeing(inputs);
            assert_eq!(
                (ModelCard::from_metadata(&card.to_metadata()).expect("own card"), card.schema),
                (card.clone(), 4)
            );
        }
    }

    #[test]
    fn other_blocks_stand_in_the_third_form() {
        for inputs in [Inputs::BARE, Inputs { wiener: true, ..Inputs::BARE }] {
            let card = ModelCard::for_unet("x", 16, 3).made_of(Blocks::Gated).seeing(inputs);
            assert_eq!((card.schema, card.receptive_radius_px), (3, 14));
            let mut metadata = card.to_metadata();
            assert_eq!(ModelCard::from_metadata(&metadata).expect("own card"), card);
            metadata.insert("isoplanat.blocks".into(), "dense".into());
            let message = ModelCard::from_metadata(&metadata).expect_err("unknown").to_string();
            assert!(message.contains("isoplanat.blocks") && message.contains("separable"), "{message}");
            metadata.remove("isoplanat.blocks");
            assert!(ModelCard::from_metadata(&metadata).is_err());
        }
        let paper = ModelCard::for_unet("x", 16, 3);
        assert_eq!(paper.clone().made_of(Blocks::Gated).made_of(Blocks::Paper), paper);
        assert_eq!(paper.made_of(Blocks::Separable).receptive_radius_px, 24);
    }

    #[test]
    fn bad_metadata_is_refused_by_key() {
        let good = ModelCard::for_unet("x", 16, 3).to_metadata();
        for (key, value) in [
            ("schema", "5"),
            ("channels", "4"),
            ("scales", "0"),
            ("multiple", "3"),
            ("demosaic", "ahd"),
            ("base_width", "-1"),
        ] {
            let mut metadata = good.clone();
            metadata.insert(format!("isoplanat.{key}"), value.into());
            let message = ModelCard::from_metadata(&metadata).expect_err(key).to_string();
            assert!(message.contains(key), "{message}");
            metadata.remove(&format!("isoplanat.{key}"));
            assert!(ModelCard::from_metadata(&metadata).is_err(), "{key} missing");
        }
    }
}
