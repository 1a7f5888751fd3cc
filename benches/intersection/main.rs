//! Error against run time of ray ∩ asphere: tolerance, starting point, f32 and f64.
//!
//! `cargo bench --bench intersection` writes `benches/results/intersection.md` and `.svg`. One thread, plain scalar code
//! (the same loop for both arithmetics), so that the ratios count; the error is that of the distance along the ray
//! against double-double. The lenses' own rays, from f64 traces over the stop and two field angles.

use std::fmt::Write as _;
use std::hint::black_box;
use std::time::Instant;

use glam::{DVec2, DVec3};
use isoplanat::lens::builtin;
use isoplanat::report::plot::{Mark, Plot, Scale, Series};
use isoplanat::trace::precise::{DoubleDouble, PreciseSystem, Scalar, Start};
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, Ray, System};

/// One intersection to solve: surface, ray in its frame, true distance.
struct Case {
    surface: usize,
    ray: Ray,
    exact: f64,
}

fn cases(system: &System, slopes: [f64; 2]) -> Vec<Case> {
    let precise = PreciseSystem::<DoubleDouble>::new(system);
    let mut hits = Vec::new();
    let mut cases = Vec::new();
    for slope in slopes {
        let object = ObjectPoint::from_slope(DVec2::new(0.0, slope), 0.0);
        for i in 0..400 {
            // Low-discrepancy points of the beam.
            let radius = 0.9 * system.stop_semi_diameter * ((f64::from(i) + 0.5) / 400.0).sqrt();
            let e = radius * DVec2::from_angle(f64::from(i) * 2.399_963_229_728_653);
            let ray = Ray::from_object(object, e.extend(0.0));
            if trace(system, ray, system.image(), &mut hits).is_err() {
                continue;
            }
            let mut before = ray.origin;
            for (surface, s) in system.surfaces.iter().enumerate() {
                let origin = before - DVec3::new(0.0, 0.0, s.distance);
                let hit = &hits[surface];
                if s.aspheric {
                    let of = |v: DVec3| v.to_array().map(DoubleDouble::of);
                    let (d, o) = (of(hit.incoming), of(origin));
                    if let Some((t, _)) = precise.newton(surface, o, d, Start::BaseConic, 1e-25) {
                        cases.push(Case { surface, ray: Ray { origin, direction: hit.incoming }, exact: t.to_f64() });
                    }
                }
                before = hit.at.point;
            }
        }
    }
    cases
}

struct Row {
    iterations: f64,
    worst: f64,
    rms: f64,
    nanoseconds: f64,
    lost: usize,
}

fn measure<S: Scalar>(system: &System, cases: &[Case], start: Start, tolerance: f64) -> Row {
    let precise = PreciseSystem::<S>::new(system);
    let rounded: Vec<(usize, [S; 3], [S; 3])> = cases
        .iter()
        .map(|c| (c.surface, c.ray.origin.to_array().map(S::of), c.ray.direction.to_array().map(S::of)))
        .collect();
    let (mut worst, mut sum, mut steps, mut lost) = (0.0f64, 0.0, 0u32, 0);
    for ((surface, o, d), case) in rounded.iter().zip(cases) {
        match precise.newton(*surface, *o, *d, start, tolerance) {
            Some((t, n)) => {
                let error = (t.to_f64() - case.exact).abs();
                worst = worst.max(error);
                sum += error * error;
                steps += n;
            }
            None => lost += 1,
        }
    }
    // The best of several passes: other programs only ever add time.
    let mut best = f64::INFINITY;
    for _ in 0..9 {
        let from = Instant::now();
        for (surface, o, d) in &rounded {
            black_box(precise.newton(*surface, black_box(*o), *d, start, tolerance));
        }
        best = best.min(from.elapsed().as_secs_f64());
    }
    #[expect(clippy::cast_precision_loss, reason = "counts")]
    let (solved, all) = ((cases.len() - lost).max(1) as f64, cases.len() as f64);
    Row {
        iterations: f64::from(steps) / solved,
        worst,
        rms: (sum / solved).sqrt(),
        nanoseconds: best / all * 1e9,
        lost,
    }
}

fn main() {
    // `cargo test` runs benches too, with --test: nothing to measure then.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    let mut text = String::from(
        "# Ray ∩ asphere: error against run time\n\n\
         Newton until the step is at most the tolerance, one thread, plain scalar code; error of the distance along the ray\n\
         against double-double. `cargo bench --bench intersection` writes this page.\n\n",
    );
    let _ = writeln!(text, "{}\n", machine());
    let mut series = Vec::new();
    for (name, slopes) in [("phone", [0.0, 0.35]), ("three_element", [0.0, 0.02])] {
        let lens = builtin::lens(name).expect("shipped");
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let cases = cases(&system, slopes);
        let _ = writeln!(
            text,
            "## `{name}`: {} intersections\n\n\
             | arithmetic | start | tolerance/mm | iterations | worst error/mm | rms error/mm | ns | lost |\n\
             |---|---|---|---|---|---|---|---|",
            cases.len()
        );
        for start in [Start::VertexPlane, Start::BaseConic] {
            let begin = if start == Start::VertexPlane { "vertex plane" } else { "base conic" };
            for single in [false, true] {
                let mut points = Vec::new();
                for exponent in (1..=if single { 7 } else { 15 }).step_by(2) {
                    let tolerance = 10f64.powi(-exponent);
                    let row = if single {
                        measure::<f32>(&system, &cases, start, tolerance)
                    } else {
                        measure::<f64>(&system, &cases, start, tolerance)
                    };
                    let _ = writeln!(
                        text,
                        "| {} | {begin} | {:.0e} | {:.2} | {:.1e} | {:.1e} | {:.0} | {} |",
                        if single { "f32" } else { "f64" },
                        tolerance,
                        row.iterations,
                        row.worst,
                        row.rms,
                        row.nanoseconds,
                        row.lost
                    );
                    if row.lost == 0 && row.rms > 0.0 {
                        points.push([row.nanoseconds, row.rms]);
                    }
                }
                // The plot shows the lens of many strong aspheres; its legend has room for four.
                if name == "phone" {
                    let from = if start == Start::VertexPlane { "plane" } else { "conic" };
                    let label = format!("{from}, {}", if single { "f32" } else { "f64" });
                    series.push(Series { name: label, points, mark: Mark::Both });
                }
            }
        }
        text.push('\n');
    }
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results");
    std::fs::create_dir_all(&folder).expect("makes the folder");
    std::fs::write(folder.join("intersection.md"), &text).expect("writes");
    let plot = Plot {
        title: "Ray ∩ asphere (phone lens): error against run time".into(),
        x_label: "time per intersection, ns".into(),
        y_label: "rms error, mm".into(),
        x_scale: Scale::Linear,
        y_scale: Scale::Log,
        series,
        keys: Vec::new(),
    };
    std::fs::write(folder.join("intersection.svg"), plot.to_svg()).expect("writes");
    println!("{text}");
}

/// Processor and date, for the head of the page.
fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model =
        cpu.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(": ").nth(1)).unwrap_or("unknown");
    let date = std::process::Command::new("date").arg("+%Y-%m-%d").output().ok();
    let date = date.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    let commit = std::process::Command::new("git").args(["rev-parse", "--short", "HEAD"]).output().ok();
    let commit = commit.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    format!("{model}, {date}, commit {commit}")
}
