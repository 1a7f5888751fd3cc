//! What a design, a training and an evaluation take of memory, estimated from above before it is taken.
//!
//! Three parts: the textures, the network's step ([`UnetConfig::step_bytes`]) and the rendering of patches or pairs, one a thread.
//! Discriminators and VGG-19 add their features.

use super::data::{LARGEST, TEXTURE};
use super::evaluate::verdict;
use super::evaluate::{CONTEXT, Pictures, SHEET, Settings};
use super::places::JUDGED;
use super::task::Task;
use isoplanat_base::error::Result;
use isoplanat_base::math::memory::{BASE, product, threads};
use isoplanat_imaging::guide::{Filters, Inputs};
use isoplanat_imaging::render::Diffraction;
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_network::UnetConfig;

/// Bytes a pixel of a region under way: scene, truth, illumination, image, their cotangents, spectra and kernels.
const REGION: usize = 700;

/// Bytes a pixel that a bank of filters adds to a region on its way, for the way back: spectra of its nodes' filters and of the blocks.
const RECORD: usize = 450;

/// Bytes of a design's page while it is written: kernels of two lenses, pictures, text.
const PAGE: u64 = 32 << 20;

fn textures(task: &Task) -> Result<u64> {
    // As much again as one picture takes while it is read and cut.
    Ok(match &task.pictures.photos {
        Some(folder) => product(&[Photos::open(folder)?.len() + 8, LARGEST, LARGEST, 3 * size_of::<f32>()]),
        None => product(&[task.pictures.scenes + threads(), TEXTURE, TEXTURE, 3 * size_of::<f32>()]),
    })
}

/// Bytes of Wiener filters, from above: as stored, as computed with, and while they are made.
fn guide(inputs: Inputs) -> u64 {
    3 * Filters::LARGEST * inputs.banks() as u64
}

/// Bytes of kernels that are convolved with an open pupil's diffraction, while the widest are made on all threads.
fn bending(task: &Task) -> u64 {
    match task.pictures.diffraction {
        Diffraction::Off => 0,
        _ => product(&[threads(), 800, 800, 64]),
    }
}

fn sum(parts: &[u64]) -> u64 {
    parts.iter().fold(BASE, |a, b| a.saturating_add(*b))
}

/// Bytes of `isoplanat design`: of the largest of its stages.
///
/// # Errors
/// A folder of photographs that cannot be listed; a stage that is none.
pub fn of_design(task: &Task) -> Result<u64> {
    task.parts("")?.iter().try_fold(0, |most, part| Ok(of_part(part)?.max(most)))
}

fn of_part(task: &Task) -> Result<u64> {
    let network =
        UnetConfig { base_width: task.network.base_width, ..UnetConfig::default() }.seeing(task.network.inputs);
    // Patches of a step, or those that settings are chosen with, which are rendered more finely.
    let side = task.pictures.patch_px.min(JUDGED.1);
    let judged = if task.lens.freeze { 0 } else { product(&[threads(), side, side, 4, REGION]) };
    // Rendered as far as the filters look.
    let seen = task.pictures.patch_px + if task.network.inputs.is_filtered() { 2 * Filters::WIDEST } else { 0 };
    // By its own images a scene is held at all its distances, one scene at a time, and no network works.
    let (count, batch) = match &task.loss.sensor {
        Some(_) => (task.pictures.depths_mm.len(), 0),
        None => (task.pictures.batch, task.pictures.batch),
    };
    // The textures of all of a step's patches are cut out beforehand.
    let cut = seen + seen / 4 + 160;
    let cuts = product(&[task.pictures.batch, task.pictures.depths_mm.len().max(1), cut, cut, 3 * size_of::<f32>()]);
    let each = REGION + RECORD * task.network.inputs.banks();
    let patches = product(&[count.max(threads()), seen, seen, each]).max(judged).saturating_add(cuts);
    let patches = patches.saturating_add(bending(task));
    let step = network.step_bytes(task.pictures.patch_px, batch);
    let (count, side) =
        if task.pictures.keep_first > 0 { (task.pictures.keep_first.min(24), LARGEST) } else { (8, TEXTURE) };
    let held_out = product(&[count, side, side, 3 * size_of::<f32>()]);
    let design = sum(&[textures(task)?, held_out, PAGE, step, patches, guide(task.network.inputs)]);
    let judged = if task.loss.sensor.is_none() { of_verdict(task, &network)?.saturating_add(held_out) } else { 0 };
    Ok(design.max(judged))
}

/// Bytes of `isoplanat train`.
///
/// # Errors
/// A folder of photographs that cannot be listed, or a network to start from that cannot be read.
pub fn of_training(task: &Task) -> Result<u64> {
    let t = &task.train;
    let network = t.config()?;
    let pairs = product(&[threads(), t.pairs.region_px, t.pairs.region_px, REGION]).saturating_add(bending(task));
    let pixels = product(&[t.pairs.batch, t.pairs.patch_px, t.pairs.patch_px, size_of::<f32>()]);
    // Two discriminators on two pictures: features of layers that halve both sides, kept for the way back; their weights with
    // moments. VGG-19 as far as conv3_3, on two pictures.
    let d = t.loss.discriminator_width;
    let critics =
        if t.loss.adversarial { pixels.saturating_mul(12 * d as u64) + product(&[d, d, 16 * 200, 24]) } else { 0 };
    let vgg = if t.loss.vgg.is_some() { pixels.saturating_mul(1000) + (64 << 20) } else { 0 };
    let step = network.step_bytes(t.pairs.patch_px, t.pairs.batch);
    let training = sum(&[textures(task)?, step, pairs, critics, vgg, guide(network.inputs)]);
    Ok(training.max(of_verdict(task, &network)?))
}

/// Bytes of what is said of a network at the end, beside the textures that are still held.
fn of_verdict(task: &Task, network: &UnetConfig) -> Result<u64> {
    let frame = task.frame.raster.as_ref().map(|s| [s.columns, s.rows]);
    let settings = verdict::settings(vec![f64::INFINITY]);
    let judged = of_evaluation(network, &verdict::held_out(task)?, &settings, frame, false)?;
    Ok(judged.saturating_add(textures(task)?))
}

/// Bytes that networks trained on for drawn lenses take beside a judgement: the pictures of `task`, captures and a step by `how` many of which side.
///
/// # Errors
/// A folder of photographs that cannot be listed.
pub fn of_retraining(network: &UnetConfig, task: &Task, [captures, side, batch]: [usize; 3]) -> Result<u64> {
    let side = side.next_multiple_of(network.multiple());
    let pairs = product(&[captures, side, side, network.inputs.channels() + 3, size_of::<f32>()]);
    let all = [textures(task)?, pairs, product(&[side, side, REGION]), network.step_bytes(side, batch)];
    Ok(all.iter().fold(0, |a, b| a.saturating_add(*b)))
}

/// Bytes of `isoplanat evaluate` on a frame of `[columns, rows]`, where that is known; with `sheets`, of the pictures it shows too.
///
/// # Errors
/// A photograph that cannot be read.
pub fn of_evaluation(
    network: &UnetConfig,
    pictures: &Pictures,
    settings: &Settings,
    frame: Option<[usize; 2]>,
    sheets: bool,
) -> Result<u64> {
    // Around a patch lies what the network sees, and what the lens's own filters look at, as far as the frame goes.
    let seen = settings.patch + 2 * CONTEXT;
    let side = seen + 2 * Filters::WIDEST;
    let [columns, rows] = frame.unwrap_or([usize::MAX; 2]).map(|most| side.min(most));
    // A picture as it is read: its samples, its planes, and the scene made of it.
    let picture = product(&[pictures.largest()?, 3 * (2 * size_of::<f32>() + 4)]);
    let region = product(&[columns, rows, REGION]);
    // Truth, capture, filtered capture and reconstruction; as strips, as sheets, and as one of them is written.
    let shown = product(&[settings.depths_mm.len(), settings.fields, SHEET, 4 * 3 * 2 * size_of::<f32>()]);
    let shown = if sheets { shown.saturating_mul(product(&[settings.patch, settings.patch])) } else { 0 };
    let inputs = Inputs { wiener: true, ..network.inputs };
    Ok(sum(&[picture, region, network.forward_bytes(seen), shown, guide(inputs)]))
}
