//! A picture through a lens, its error promised: the renderer takes the cheapest settings that hold 45 dB.
//!
//! `cargo run --release --example picture [LENS [SCENE [OUT]]]`: a shipped lens, a picture file or a kind of scene, a .png, .tif or .npy.
use std::process::ExitCode;

use isoplanat::atomic::Target;
use isoplanat::{Encoding, Error, Frame, PlanOptions, Request, Result, SceneKind, Sensor, SpectralDensity};
use isoplanat::{builtin, fill_frame, generate, plan, read_linear, write_picture};

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "cooke_triplet".into());
    let scene = arguments.next().unwrap_or_else(|| "facades".into());
    let lens = builtin::lens(&name)?;

    // 240 × 160 pixels over the lens's own field, and a scene that fills them.
    let pitch_mm = lens.sensor.radius_mm() / 120_f64.hypot(80.0);
    let frame = Frame::centred(240, 160, pitch_mm)?;
    let texture = match SceneKind::from_name(&scene) {
        Some(kind) => generate(kind, 1, 200, 300),
        None => read_linear(scene.as_ref())?,
    };
    let scene = fill_frame(&lens, &frame, texture)?;
    let density = SpectralDensity::new(&Sensor::generic());
    let plan =
        plan(&lens, std::slice::from_ref(&scene), &frame, &density, Request::Psnr(45.0), PlanOptions::default())?;
    let promised = plan.predicted_db.filter(|_| plan.holds);
    let promised = promised.ok_or_else(|| Error::bad(&name, "picture", "less than 45 dB", "a lens that images"))?;

    let (picture, _) = plan.picture::<f32>(&scene, &|_| ())?;
    println!("{} × {} pixels, {promised:.1} dB promised", frame.columns, frame.rows);
    let [mean, of_scene] = [&picture, &scene.texture].map(|p| p.mean().unwrap_or(0.0));
    println!("mean light {mean:.4}, of the scene {of_scene:.4}");
    arguments.next().map_or(Ok(()), |path| write_picture(Target::new(&path, false), &picture, Encoding::Srgb))
}

fn main() -> ExitCode {
    run().map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
