//! Lens files of a folder through the readers: `cargo bench --bench files [-- FOLDER [GLASSES]]` prints `benches/results/files.md`.
//!
//! Focal lengths stand beside those of a second computation: recorded facts of the folder where it has a file `first_order_facts.json`
//! (another program's), and always a real ray close to the axis.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::DVec3;
use isoplanat::interchange::{Form, load};
use isoplanat::lens::catalogue::Glasses;
use isoplanat::lens::{Lens, Medium, paraxial};
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{Ray, System};

/// Focal length by a real ray close to the axis, mm.
fn by_ray(lens: &Lens) -> f64 {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let y = 1e-4 * paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_diameter;
    let ray = Ray { origin: DVec3::new(0.0, y, -1.0), direction: DVec3::Z };
    trace(&system, ray, system.image(), &mut Vec::new()).map_or(f64::NAN, |h| -y / (h.direction.y / h.direction.z))
}

fn main() {
    // `cargo bench` passes `--bench`.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let folder = PathBuf::from(arguments.first().map_or("../shared/data/lenses", String::as_str));
    let catalogues = PathBuf::from(arguments.get(1).map_or("../shared/data/glass/agf", String::as_str));
    if !folder.is_dir() {
        eprintln!("SKIPPED: {} is not there", folder.display());
        return;
    }
    let mut glasses = Glasses::shipped().clone();
    let instead = [("SSK4", "SSK4A"), ("L-TIM28_MOLD", "L-TIM28")];
    if catalogues.is_dir() {
        glasses.add(&catalogues).expect("catalogues");
    }
    for (name, glass) in instead {
        glasses.take_instead(name, glass).expect("a glass");
    }
    let facts = std::fs::read(folder.join("first_order_facts.json")).unwrap_or_default();
    let facts: serde_json::Value = serde_json::from_slice(&facts).unwrap_or_default();
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(&folder).expect("lists").map(|e| e.expect("entry").path()).collect();
    paths.extend(
        std::fs::read_dir(folder.join("least_squares")).into_iter().flatten().map(|e| e.expect("entry").path()),
    );
    paths.retain(|p| p.is_file() && Form::from_path(p).is_ok());
    paths.retain(|p| !["first_order_facts.json", "baselines.json"].iter().any(|f| p.ends_with(f)));
    paths.sort();
    println!("# Lens files of other programs\n");
    println!(
        "`cargo bench --bench files`: every file of the folder of published lenses, with the catalogues beside it and SSK4 = SSK4A,"
    );
    println!(
        "L-TIM28_MOLD = L-TIM28 (`--glass-for`), which no catalogue at hand has. Focal length and back focal length in mm; difference: the"
    );
    println!(
        "largest relative one of the focal length to the facts recorded with the files, and to a real ray close to the axis.\n"
    );
    println!(
        "| file | surfaces | glasses | focal length | back | f-number | half field/° | facts | ray | ms | refused |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let (mut read, mut refused) = (0, 0);
    for path in &paths {
        let name = path.strip_prefix(&folder).unwrap_or(path).display().to_string();
        let start = Instant::now();
        match load(path, &glasses) {
            Ok(imported) => {
                let ms = 1e3 * start.elapsed().as_secs_f64();
                println!("{}", row(&name, &imported.lens, &facts[name.as_str()], ms));
                read += 1;
            }
            Err(error) => {
                let text = error.to_string();
                let file = path.display().to_string();
                let why = text.strip_prefix(&format!("{file}: ")).unwrap_or(&text);
                println!("| {name} | | | | | | | | | | {} |", why.split("; ").next().unwrap_or(why));
                refused += 1;
            }
        }
    }
    println!("\n{read} read, {refused} refused.");
}

fn row(name: &str, lens: &Lens, facts: &serde_json::Value, ms: f64) -> String {
    let f = paraxial::first_order(lens, lens.wavelengths.primary_nm);
    let glasses = lens.surfaces.iter().filter(|s| s.medium != Medium::Air).count();
    // Facts are in the file's unit.
    let unit = if facts["header"]["UNIT"].as_str().is_some_and(|u| u.starts_with("IN")) { 25.4 } else { 1.0 };
    let difference = |other: f64| format!("{:.0e}", ((f.effective_focal_length - other) / other).abs());
    let fact = facts["efl_mm"].as_f64().map_or_else(|| "–".into(), |efl| difference(efl * unit));
    format!(
        "| {} | {} | {glasses} | {:.5} | {:.5} | {:.3} | {:.2} | {fact} | {} | {ms:.0} | |",
        Path::new(name).display(),
        lens.surfaces.len(),
        f.effective_focal_length,
        f.back_focal_length,
        f.f_number,
        lens.max_field_deg(),
        difference(by_ray(lens)),
    )
}
