//! Lens and network → kit: what `demo` and `export` write for the camera.

use isoplanat::Result;
use isoplanat::deploy::kit::{Kit, LensEntry};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::patches::NodeRaster;
use isoplanat::imaging::render::{Optics, RenderPlan};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::warp::Region;
use isoplanat::lens::Lens;
use isoplanat::network::card::{ModelCard, sha256_hex};
use isoplanat::network::{Reconstructor, onnx};

/// Traces the whole frame at nodes `spacing` pixels apart.
pub(crate) fn whole_frame(lens: &Lens, render: &RenderPlan, spacing: usize) -> Result<Optics> {
    let frame = &render.frame;
    let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
    Optics::compute(lens, lens.object_vergence, render, NodeRaster::over(whole.grown(render.margin()), spacing))
}

/// What the file of `network`, trained for `lens`, says of itself.
pub(crate) fn card(
    name: &str,
    lens: &Lens,
    network: &Reconstructor,
    sensor: &Sensor,
    training_sha256: String,
) -> ModelCard {
    let config = network.config();
    let mut card = ModelCard::for_unet(name, config.base_width, config.scales);
    card.lens_name.clone_from(&lens.name);
    card.lens_sha256 = lens.sha256();
    card.calibration_sha256 = sha256_hex(toml::to_string(sensor).unwrap_or_default().as_bytes());
    card.training_sha256 = training_sha256;
    card
}

/// The kit around `model`, an ONNX file with a card for `lens`; `optics` gives distortion and illumination.
pub(crate) fn around(
    model: Vec<u8>,
    card: &ModelCard,
    lens: &Lens,
    sensor: &Sensor,
    frame: &Frame,
    optics: &Optics,
    tile: usize,
) -> Result<Kit> {
    Kit::new(
        card.name.clone(),
        LensEntry { name: lens.name.clone(), sha256: lens.sha256() },
        model,
        tile,
        sensor.clone(),
        frame.clone(),
        optics.distortion.clone(),
        optics.shading()?,
    )
}

/// The kit of `network`, trained for `lens`, weights as trained.
#[expect(clippy::too_many_arguments, reason = "the parts of a kit")]
pub(crate) fn build(
    name: &str,
    lens: &Lens,
    network: &Reconstructor,
    sensor: &Sensor,
    frame: &Frame,
    optics: &Optics,
    training_sha256: String,
    tile: usize,
) -> Result<Kit> {
    let card = card(name, lens, network, sensor, training_sha256);
    around(onnx::encode(network, &card)?, &card, lens, sensor, frame, optics, tile)
}
