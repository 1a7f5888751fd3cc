//! A kit on a capture: `cargo run --release --example develop [KIT RAW OUT.png]`. Without arguments it is a grey wall through a triplet.
use isoplanat::network::{card::ModelCard, onnx};
use isoplanat::{Camera, CaptureSettings, DngInfo, Encoding, Error, Kit, LensEntry, RawCapture, Reconstructor, Result};
use isoplanat::{Sensor, SpectralDensity, Subject, UnetConfig, atomic::Target, builtin, capture, decode, fill_frame};
use isoplanat::{frame_of, ndarray::Array3, write_dng, write_picture};
use std::{path::Path, process::ExitCode};

/// The wall, 0.5 of white at an exposure of 0.8, and a kit whose network has not learnt yet.
fn grey_wall() -> Result<(Kit, RawCapture)> {
    let smaller = |l: &mut isoplanat::Prescription| l.sensor.pitch_um *= l.sensor.columns as f64 / 96.0;
    let lens = builtin::lens("cooke_triplet")?.changed(smaller)?;
    let lens = lens.changed(|l| (l.sensor.columns, l.sensor.rows, l.sensor.axis_px) = (96, 64, [48.0, 32.0]))?;
    let (sensor, frame, sha256) = (Sensor::generic(), frame_of(&lens)?, lens.sha256());
    let card = ModelCard { lens_sha256: sha256.clone(), ..ModelCard::for_unet("untrained", 4, 2) };
    let model = onnx::encode(&Reconstructor::new(UnetConfig::bare(4, 2), 1)?, &card)?;
    let of = Subject::from(lens.clone()).calibration(&SpectralDensity::new(&sensor))?;
    let entry = LensEntry { name: lens.name.clone(), sha256 };
    let kit = Kit::new("k", entry, model, 96, sensor.clone(), frame.clone(), of.distortion, of.shading, None)?;
    let scene = fill_frame(&lens, &frame, Array3::from_elem((3, 2, 2), 0.5))?;
    let settings = CaptureSettings { samples: 64, exposure: 0.8, noise: false, ..CaptureSettings::default() };
    let taken = capture(&lens, &scene, &sensor, &frame, settings, None)?;
    let folder = tempfile::tempdir().map_err(|e| Error::writing(&std::env::temp_dir(), e))?;
    write_dng(&folder.path().join("wall.dng"), taken.dn.view(), &sensor, &DngInfo::default())?;
    Ok((kit, decode(&folder.path().join("wall.dng"))?))
}
fn run(arguments: &[String]) -> Result<()> {
    let (kit, raw) = match arguments {
        [kit, raw, _] => (Kit::load(kit.as_ref())?, decode(raw.as_ref())?),
        [] => grey_wall()?,
        other => return Err(Error::bad("arguments", "number", other.len().to_string(), "KIT RAW OUT.png, or none")),
    };
    let picture = Camera::with_kit(kit, Default::default(), &Default::default())?;
    let picture = picture.reconstruct(raw, Path::new("capture"), &|_, _| ())?;
    println!("{:?} by {} tiles, mean {:.4}", picture.image.dim(), picture.tiles, picture.image.mean().unwrap_or(0.0));
    arguments.get(2).map_or(Ok(()), |to| write_picture(Target::new(to, false), &picture.image, Encoding::Srgb))
}
fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    run(&arguments).map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
