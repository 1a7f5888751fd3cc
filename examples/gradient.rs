//! The gradient of one's own loss on a picture with respect to every number of the lens.
//!
//! `cargo run --release --example gradient [LENS]`: a shipped lens.
use std::process::ExitCode;

use isoplanat::ndarray::Array3;
use isoplanat::{Frame, Parameter, Region, Renderer, Result, SceneKind, Sensor, Settings, SpectralDensity};
use isoplanat::{builtin, fill_frame, generate};

fn run() -> Result<()> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "cooke_triplet".into());
    let lens = builtin::lens(&name)?;
    let frame = Frame::centred(96, 64, lens.sensor.radius_mm() / 48_f64.hypot(32.0))?;
    let scene = fill_frame(&lens, &frame, generate(SceneKind::Mixed, 1, 80, 120))?;
    let density = SpectralDensity::new(&Sensor::generic());
    let renderer = Renderer::planned(&lens, &frame, &density, &[scene.vergence], Settings::DESIGN)?;

    // What the lens shows of a region, and what it would show without blur.
    let region = Region { row: 8, col: 8, rows: 48, cols: 64 };
    let seen = renderer.record::<f64>(&scene, 0, region);

    // One's own loss, here the mean square of what the lens changes, and its cotangent.
    let error = &seen.image - &seen.truth;
    let loss = error.mapv(|e| e * e).mean().unwrap_or(0.0);
    let image_bar = &error * (2.0 / error.len() as f64);
    println!("loss {loss:.12e}");
    // Back through the renderer to the optics, and through the rays to the lens.
    let nothing = Array3::zeros(error.dim());
    let bar = renderer.vjp(&scene, &seen, image_bar.view(), (-&image_bar).view(), nothing.view());
    let gradient = renderer.lens_gradient(&lens, &bar);
    for number in Parameter::all(&lens) {
        let [value, slope] = [number.value(&*lens), number.value(&gradient)].map(Option::unwrap_or_default);
        println!("{:24} {value:14.8} {slope:16.9e}", number.name(&lens));
    }
    Ok(())
}

fn main() -> ExitCode {
    run().map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
