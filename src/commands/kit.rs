//! Lens and network → kit: what `demo` and `export` write for the camera.

use isoplanat::Result;
use isoplanat::deploy::kit::{Kit, LensEntry};
use isoplanat::design::subject::Calibration;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::network::card::ModelCard;
use isoplanat::network::{Reconstructor, onnx};

/// What the file of `network`, trained for `lens`, says of itself.
pub(crate) fn card(
    name: &str,
    lens: &LensEntry,
    network: &Reconstructor,
    sensor: &Sensor,
    training_sha256: String,
) -> ModelCard {
    let config = network.config();
    let bare = ModelCard::for_unet(name, config.base_width, config.scales);
    let mut card = bare.seeing(config.inputs).made_of(config.blocks);
    card.lens_name.clone_from(&lens.name);
    card.lens_sha256.clone_from(&lens.sha256);
    card.calibration_sha256 = sensor.sha256();
    card.training_sha256 = training_sha256;
    card
}

/// The kit around `model`, an ONNX file with a card for `lens`; `calibration` gives distortion and illumination.
#[expect(clippy::too_many_arguments, reason = "the parts of a kit")]
pub(crate) fn around(
    model: Vec<u8>,
    card: &ModelCard,
    lens: &LensEntry,
    sensor: &Sensor,
    frame: &Frame,
    calibration: &Calibration,
    guide: &Guide,
    tile: usize,
) -> Result<Kit> {
    Kit::new(
        card.name.clone(),
        lens.clone(),
        model,
        tile,
        sensor.clone(),
        frame.clone(),
        calibration.distortion.clone(),
        calibration.shading.clone(),
        guide.facts(),
    )
}

/// The kit of `network`, trained for `lens`, weights as trained.
#[expect(clippy::too_many_arguments, reason = "the parts of a kit")]
pub(crate) fn build(
    name: &str,
    lens: &LensEntry,
    network: &Reconstructor,
    sensor: &Sensor,
    frame: &Frame,
    calibration: &Calibration,
    guide: &Guide,
    training_sha256: String,
    tile: usize,
) -> Result<Kit> {
    let card = card(name, lens, network, sensor, training_sha256);
    around(onnx::encode(network, &card)?, &card, lens, sensor, frame, calibration, guide, tile)
}
