//! A lens made better by damped least squares on real rays, its focal length held.
//!
//! `cargo run --release --example optimize [LENS [OUT.toml]]`: a shipped lens, where the better one goes.
use std::process::ExitCode;

use isoplanat::atomic::Target;
use isoplanat::lens::prescription;
use isoplanat::{Limits, Problem, Result, builtin, first_order, optimize};

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "cooke_triplet".into());
    let lens = builtin::lens(&name)?;

    // Curvatures and thicknesses move; focal length, length, glass and air at rims are held.
    let problem = Problem::standard(&lens);
    println!("{} numbers move, {} are held", problem.variables.parameters.len(), problem.constraints.len());
    let found = optimize(&problem, Limits { iterations: 60, ..Limits::default() }, &mut |_| true)?;
    let [before, after] = found.rms_mm.map(|mm| 1e3 * mm);
    println!("rms spot {before:.4} µm before, {after:.4} µm after {} steps ({:?})", found.iterations, found.stop);
    let focal_length = |lens| first_order(lens, problem.lens.wavelengths.primary_nm).effective_focal_length;
    println!("focal length {:.9} mm before, {:.9} mm after", focal_length(&lens), focal_length(&found.lens));
    for moved in &found.moved {
        println!("{:24} {:14.8} → {:14.8}", moved.name, moved.before, moved.after);
    }
    arguments.next().map_or(Ok(()), |path| prescription::save(&found.lens, Target::new(&path, false)))
}

fn main() -> ExitCode {
    run().map_or_else(|e| (eprintln!("error: {e}"), ExitCode::from(2)).1, |()| ExitCode::SUCCESS)
}
