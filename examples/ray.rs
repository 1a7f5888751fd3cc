//! A ray through a shipped lens, and how its landing answers to the lens.
//!
//! `cargo run --release --example ray [LENS [HEIGHT_MM]]`: a lens file or a shipped lens, how far above the axis the ray is.
use std::process::ExitCode;

use isoplanat::glam::DVec3;
use isoplanat::{Error, Glasses, HitBar, Imported, LensGradient, Ray, Result, System, SystemGradient};
use isoplanat::{lens_or_file, trace, trace_vjp};

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "cooke_triplet".into());
    let height = arguments.next().unwrap_or_else(|| "1".into());
    let y: f64 = height.parse().map_err(|_| Error::bad("HEIGHT_MM", "argument", height, "a number of mm"))?;
    let Imported { lens, notes } = lens_or_file(&name, Glasses::shipped(), Default::default())?;
    notes.iter().for_each(|note| eprintln!("{note}"));
    let (system, nm) = (System::new(&lens, lens.wavelengths.primary_nm), lens.wavelengths.primary_nm);

    // Along the axis, from 10 mm before the first vertex, through every surface to the image plane.
    let ray = Ray { origin: DVec3::new(0.0, y, -10.0), direction: DVec3::Z };
    let (mut hits, failed) = (Vec::new(), |f| Error::bad(&name, "ray", format!("{f:?}"), "a ray that gets through"));
    let landing = trace(&system, ray, system.image(), &mut hits).map_err(failed)?;
    println!("lands {:.12} mm from the axis", landing.at.point.y);
    println!("focal length by this ray: {:.6} mm", -y * landing.direction.z / landing.direction.y);

    // A cotangent of 1 on its height, pulled back to every number of the lens.
    let mut bars = vec![HitBar::default(); hits.len()];
    bars[system.image()].point = DVec3::Y;
    let (mut back, mut gradient) = (SystemGradient::zeros(&system), LensGradient::zeros(&lens));
    trace_vjp(&system, &hits, &bars, &mut back);
    back.add_to(&lens, nm, &mut gradient);
    for (i, s) in gradient.surfaces.iter().enumerate() {
        println!("surface {i}: by curvature {:.9e} mm², by thickness {:.9e}", s.shape.curvature, s.thickness);
    }
    Ok(())
}

fn main() -> ExitCode {
    run().map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
