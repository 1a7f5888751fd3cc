//! One run: the camera that is asked for, and the loop over captures.

use std::path::PathBuf;
use std::time::Duration;

use crate::child::Helper;
use crate::kit::Kit;
use crate::network_process::Apart;
use crate::reconstruct::{Camera, Steps, Target, Veil};
use crate::session::{Options, Runtime};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::Limit;
use isoplanat_imaging::calibrate::file::MeasuredDistortion;
use isoplanat_imaging::calibrate::shading::MeasuredShading;
use serde_json::json;

use crate::program::arguments::{Arguments, Shoulder, Space};
use crate::program::batch::{Batch, Means, Told};
use crate::program::say::{complain, say};
use crate::program::{output, show, watch};

/// Runs the program; the result is its exit code.
pub(crate) fn run(arguments: &Arguments) -> u8 {
    match work(arguments) {
        Ok(code) => code,
        Err(error) => complain(&error),
    }
}

fn work(arguments: &Arguments) -> Result<u8> {
    isoplanat_base::math::simd::check_environment()?;
    isoplanat_base::threads::start_pool(arguments.running.threads)?;
    let memory = arguments.running.memory_gib.map_or_else(|| Ok(Limit::of_process()), Limit::gib)?;
    memory.hold();
    let means = Means { helper: Helper::current()?, memory };
    let kit = arguments.kit.as_deref().map(Kit::load).transpose()?;
    if let (Some(folder), Some(doubt)) = (&arguments.kit, kit.as_ref().and_then(Kit::doubt)) {
        crate::program::tell!("isoplanat-camera: {}: {doubt}", folder.display());
    }
    if let (true, Some(kit)) = (arguments.show_kit, &kit) {
        show::show_kit(kit, arguments.json)?;
        return Ok(0);
    }
    let pictures = arguments.pictures();
    let told = Told { json: arguments.json, bench: arguments.bench };
    if arguments.watch {
        let out = watch::folders(&pictures)?;
        let camera = camera(arguments, kit, &means)?
            .making(target(arguments, &[out.join(output::named("a", pictures.format))])?);
        return watch::run(&Batch::new(&pictures, told, &camera, means), out);
    }
    let captures = output::captures(&arguments.captures)?;
    let outputs = pictures.plan(&captures)?;
    let camera = camera(arguments, kit, &means)?.making(target(arguments, &outputs)?);
    let batch = Batch::new(&pictures, told, &camera, means);
    let mut code = 0;
    let mut results = Vec::new();
    for (k, (capture, out)) in captures.iter().zip(&outputs).enumerate() {
        match batch.develop((k, captures.len()), capture, out) {
            Ok(result) => results.push(result),
            Err(error) => code = code.max(batch.complain(&error)),
        }
    }
    batch.finish();
    if arguments.json {
        let runtime = camera.network().map(|n| n.runtime().to_string());
        say(&format!("{:#}", json!({ "schema": 1, "runtime": runtime, "pictures": results })));
    }
    Ok(code)
}

/// What captures are made into: all outputs of a run have one format.
fn target(arguments: &Arguments, outputs: &[PathBuf]) -> Result<Target> {
    let Some(dng) = outputs.iter().find(|o| output::is_dng(o)) else {
        return Ok(Target::Rendered(arguments.look.rendering()));
    };
    let rendered = [
        ("--color", arguments.look.color != Space::Srgb),
        ("--exposure", arguments.look.exposure != 0.0),
        ("--tone", arguments.look.tone != Shoulder::Cut),
    ];
    match rendered.iter().find(|(_, asked)| *asked) {
        Some((name, _)) => {
            let found = "a DNG holds the camera's own light";
            Err(Error::bad(
                dng.display().to_string(),
                *name,
                found,
                "another format, or none of it: the program that develops it decides",
            ))
        }
        None => Ok(Target::Camera),
    }
}

fn camera(arguments: &Arguments, kit: Option<Kit>, means: &Means) -> Result<Camera> {
    let Some(kit) = kit else {
        crate::program::tell!("isoplanat-camera: no --kit: the RAW is developed, no network is applied");
        let mut camera = Camera::plain();
        if let Some(path) = &arguments.corrections.distortion {
            camera = camera.straightening(&MeasuredDistortion::load(path)?)?;
        }
        if let Some(path) = &arguments.corrections.shading {
            camera = camera.evening(&MeasuredShading::load(path)?)?;
        }
        return camera.without(arguments.corrections.glare.unwrap_or(Veil::Keep));
    };
    let steps = Steps { network: !arguments.corrections.no_network, undistort: !arguments.corrections.no_undistort };
    let options = Options {
        onnxruntime: arguments.running.onnxruntime.clone(),
        threads: arguments.running.threads,
        ..Options::default()
    };
    let apart = Apart {
        memory_bytes: arguments.running.network_memory.map(|mib| mib << 20),
        time: Duration::from_secs_f64(arguments.running.tile_seconds),
        hint: "; --network-memory and --tile-seconds set them",
        ..Apart::new(means.helper.clone())
    };
    let camera = Camera::with_kit_apart(kit, steps, &options, &apart)?;
    let camera = camera.without(arguments.corrections.glare.unwrap_or_default())?;
    match camera.network() {
        None => crate::program::tell!("isoplanat-camera: --no-network: no network is applied"),
        Some(network) if matches!(network.runtime(), Runtime::Tract { .. }) => {
            crate::program::tell!("isoplanat-camera: the network runs in {}", network.runtime());
        }
        Some(_) => {}
    }
    Ok(camera)
}
