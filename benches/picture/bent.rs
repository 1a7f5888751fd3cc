//! Pictures by diffraction: what `auto` decides, what that costs, and whether the promise holds, judged at places of the frame by kernels of their own.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::node_grid::NodeGrid;
use isoplanat::imaging::render::{Channels, Diffraction, PlanOptions, Renderer, Request, ScenePlan, Settings, plan};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::lens::Aperture;
use isoplanat::psf::Model;
use ndarray::{Array3, s};

use super::cases::{Case, place};

const LENSES: [&str; 6] = ["double_gauss", "cooke_triplet", "two_element", "phone", "tessar", "heliar"];
const STOPS: [f64; 3] = [2.8, 8.0, 16.0];
const SIZE: [usize; 2] = [160, 120];
/// Places that are judged, of three by three pixels.
const PLACES: u64 = 16;
const ASKED_DB: f64 = 45.0;

fn planned(case: &Case, diffraction: Diffraction) -> (ScenePlan, f64) {
    let clock = Instant::now();
    let options = PlanOptions { explain: false, diffraction };
    let scenes = std::slice::from_ref(&case.scene);
    let made = plan(&case.lens, scenes, &case.frame, &case.density, Request::Psnr(ASKED_DB), options).expect("plans");
    (made, clock.elapsed().as_secs_f64())
}

/// What the pixels about a place show by the kernel of that place: twelve wavelengths, four samples a pixel, wide windows, no nodes between.
fn exact(judge: &mut Renderer, scene: &Plane, region: Region) -> Array3<f32> {
    judge.plan.depths[0].grid = NodeGrid::single(region.row + 1, region.col + 1);
    judge.picture::<f32>(scene, 0, region, &Channels::all(), &|_| ()).0
}

/// The first `count` photographs of the shared folder.
fn photographs(count: usize) -> Vec<(String, Array3<f32>)> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos/eval");
    let entries = std::fs::read_dir(&root).into_iter().flatten().flatten();
    let mut all: Vec<PathBuf> =
        entries.map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "png")).collect();
    all.sort();
    if all.is_empty() && count > 0 {
        eprintln!("no photographs in {}: judged without them", root.display());
    }
    let name = |p: &PathBuf| p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    all.iter().take(count).map(|p| (name(p), read_linear(p).expect("a photograph"))).collect()
}

/// The table, with so many photographs beside the built-in scenes, and how many of its pictures hold what was asked for. A place's kernel stands for its nine pixels.
pub(crate) fn table(count: usize) -> String {
    let street = ("street".to_owned(), generate(SceneKind::Facades, 3, SIZE[1], SIZE[0]));
    let grey = ("grey".to_owned(), Array3::from_elem((3, SIZE[1], SIZE[0]), 0.5));
    let scenes: Vec<(String, Array3<f32>)> = [street, grey].into_iter().chain(photographs(count)).collect();
    let mut misses = Vec::new();
    let mut out = String::from(
        "| lens | f-number | scene | diffraction | predicted, dB | found, dB | of rays, dB | plan auto / off, s | picture auto / off, s |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for name in LENSES {
        for stop in STOPS {
            for (what, texture) in &scenes {
                let mut case = place(name, SIZE, texture.clone());
                let Ok(lens) = case.lens.changed(|l| l.aperture = Aperture::FNumber(stop)) else { continue };
                // Stops do not open beyond what rays get through.
                if isoplanat::psf::Optics::even(&lens, 0.1, vec![lens.object_vergence], one(), 8).is_err() {
                    continue;
                }
                case.lens = lens;
                let ((auto, planning), (off, planning_off)) =
                    (planned(&case, Diffraction::Auto), planned(&case, Diffraction::Off));
                let timed = |plan: &ScenePlan| {
                    let clock = Instant::now();
                    let picture = case.picture(plan);
                    (picture, clock.elapsed().as_secs_f64())
                };
                let ((picture, seconds), (of_rays, seconds_off)) = (timed(&auto), timed(&off));
                let fine = Settings { diffraction: Model::Waves, ..Settings::FINE };
                let vergence = [case.scene.vergence];
                let mut judge =
                    Renderer::planned(&case.lens, &case.frame, &case.density, &vergence, fine).expect("traces");
                let rng = &mut fastrand::Rng::with_seed(4);
                let mut squares = [0.0; 2];
                let mut count = 0.0;
                for _ in 0..PLACES {
                    let [row, col] = [SIZE[1], SIZE[0]].map(|n| rng.usize(0..n - 3));
                    let region = Region { row: row.cast_signed(), col: col.cast_signed(), rows: 3, cols: 3 };
                    let exact = exact(&mut judge, &case.scene, region);
                    for (square, picture) in squares.iter_mut().zip([&picture, &of_rays]) {
                        let here = picture.slice(s![.., row..row + 3, col..col + 3]);
                        *square += (&here - &exact).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
                    }
                    count += 27.0;
                }
                let [found, rays] = squares.map(|v| -10.0 * (v / count).log10());
                let bent = match auto.renderer.optics.spec.diffraction {
                    Model::Rays => "no",
                    Model::Approximate => "approximate",
                    Model::Waves => "yes",
                };
                if auto.holds {
                    misses.push(ASKED_DB - found);
                }
                let predicted = auto.predicted_db.unwrap_or(f64::NAN);
                let line = format!(
                    "| {name} | {stop} | {what} | {bent} | {predicted:.1} | {found:.1} | {rays:.1} | {planning:.2} / {planning_off:.2} | {seconds:.2} / {seconds_off:.2} |"
                );
                eprintln!("{line}");
                let _ = writeln!(out, "{line}");
            }
        }
    }
    let held = misses.iter().filter(|m| **m <= 0.0).count();
    let worst = misses.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let _ = writeln!(
        out,
        "\n{held} of {} pictures that were promised hold {ASKED_DB} dB; the worst lacks {worst:.1} dB",
        misses.len()
    );
    out
}

fn one() -> isoplanat::psf::Quadrature {
    isoplanat::psf::Quadrature { nm: vec![550.0], weight: vec![vec![1.0]] }
}
