//! Point spread functions over field and colour, as NumPy arrays.
//!
//! `cargo run --release --example psf [LENS [OUT.npz]]`: a shipped lens, where the arrays go.
use std::process::ExitCode;

use isoplanat::{KernelRequest, KernelSet, Result, atomic::Target, builtin, ndarray::s};

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "cooke_triplet".into());
    let lens = builtin::lens(&name)?;

    // Four places from the axis to the corner, three colours; pixels of 10 µm.
    let request = KernelRequest {
        wavelength_nm: vec![460.0, 540.0, 620.0],
        weights: vec![1.0; 3],
        fields: 4,
        pitch_mm: 0.01,
        ..KernelRequest::for_lens(&lens)
    };
    let set = KernelSet::compute(&lens, &request)?;
    println!("[depth, field, wavelength, row, col] = {:?}", set.kernels.shape());
    println!("field/deg  radius/mm  light  peak at 460, 540, 620 nm");
    for field in 0..set.radius_mm.dim().1 {
        let kernel = |colour| set.kernels.slice(s![0, field, colour, .., ..]);
        let peaks = [0, 1, 2].map(|c| format!("{:.4}", kernel(c).iter().fold(0.0, |m: f32, v| m.max(*v))));
        let (angle, radius) = (set.angle_deg[[0, field]], set.radius_mm[[0, field]]);
        println!("{angle:9.4}  {radius:9.5}  {:.3}  {}", set.relative_illumination[[0, field, 1]], peaks.join(", "));
    }
    if let Some(path) = arguments.next() {
        set.save(Target::new(&path, false))?;
        println!("written to {path}");
    }
    Ok(())
}

fn main() -> ExitCode {
    run().map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
