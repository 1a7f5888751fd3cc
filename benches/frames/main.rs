//! Whole frames against the reference: `cargo bench --bench frames -- [LENS…] [--photographs N] [--samples N]`.
//!
//! Every lens images photographs and a grey frame on 300 × 200 pixels whose pitch is enlarged so that the frame's corner
//! sees the lens's whole field, planned for 40, 45 and 50 dB; prediction and promise are compared with what two
//! independent halves of the reference say. `-- corners`: instead of whole frames, the 1024 × 1024 pixels in the corner of the lens's
//! own sensor (or of as much of it as the field covers) at its own pitch.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::halves::psnr_against_halves;
use isoplanat::imaging::reference::{Channels, Rendered, Sampling, Settings, render_halves};
use isoplanat::imaging::render::{PlanOptions, Request, frame_of, plan};
use isoplanat::imaging::scene::placement::Placement;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, builtin, prescription};
use isoplanat::psf::table::chief_slopes;
use ndarray::Array3;

const COLUMNS: usize = 300;
const ROWS: usize = 200;
const REQUESTS: [f64; 3] = [40.0, 45.0, 50.0];

fn lens(name: &str) -> Lens {
    if name == "wide_100" {
        let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("benches/lenses/wide_100.toml");
        return prescription::load(&file).expect("valid");
    }
    builtin::lens(name).expect("shipped")
}

/// The sensor radius that sees the end of the field, as far as there is light, mm.
fn edge_mm(lens: &Lens) -> f64 {
    let edge = lens.max_field_deg().to_radians().tan();
    let radii: Vec<f64> = (1..=400).map(|i| lens.sensor.radius_mm() * f64::from(i) / 200.0).collect();
    let slopes = chief_slopes(lens, lens.object_vergence, &radii).expect("light");
    radii[slopes.partition_point(|s| *s < edge).min(slopes.len()) - 1]
}

/// The frame whose corner sees the end of the field.
fn frame(lens: &Lens) -> Frame {
    let corner = 0.5 * (COLUMNS as f64).hypot(ROWS as f64);
    Frame::centred(COLUMNS, ROWS, edge_mm(lens) / corner).expect("valid")
}

/// The corner of the lens's own sensor, or of as much of it as the field covers.
fn corner(lens: &Lens) -> Frame {
    const SIDE: usize = 1024;
    let whole = frame_of(lens).expect("valid");
    let covered = (edge_mm(lens) / whole.max_radius_mm()).min(1.0);
    let last = |axis: f64, n: usize| axis + covered * (n as f64 - axis);
    let axis = [
        whole.axis_px[0] - last(whole.axis_px[0], whole.columns) + SIDE as f64,
        whole.axis_px[1] - last(whole.axis_px[1], whole.rows) + SIDE as f64,
    ];
    Frame::centred(SIDE, SIDE, whole.pitch_mm).and_then(|f| f.with_axis(axis)).expect("valid")
}

/// The texture over the frame: its middle in the frame's.
fn scene(lens: &Lens, frame: &Frame, texture: Array3<f32>) -> Plane {
    let (_, rows, cols) = texture.dim();
    let Placement { scale, .. } = Placement::filling([rows, cols], frame);
    Placement::centred([rows, cols], frame, scale).before(lens, frame, texture).expect("light")
}

fn photographs(count: usize) -> Vec<(String, Array3<f32>)> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/photos/eval");
    let mut all = vec![("grey".to_owned(), Array3::from_elem((3, 200, 300), 0.5))];
    for k in 1..=count {
        let path = root.join(format!("{k:02}.png"));
        if path.exists() {
            all.push((format!("{k:02}"), read_linear(&path).expect("a photograph")));
        }
    }
    all
}

struct Tally {
    cases: usize,
    held: usize,
    worst_miss: f64,
    optimistic: f64,
    within: [usize; 2],
    predicted: usize,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let value = |name: &str, default: usize| {
        let at = arguments.iter().position(|a| a == name);
        at.and_then(|k| arguments.get(k + 1)).and_then(|v| v.parse().ok()).unwrap_or(default)
    };
    let all = ["cooke_triplet", "double_gauss", "al2550_a", "two_element", "phone", "wide_100"];
    let named: Vec<&str> = all.into_iter().filter(|l| arguments.iter().any(|a| a == l)).collect();
    let lenses = if named.is_empty() { all.to_vec() } else { named };
    let density = SpectralDensity::new(&Sensor::generic());
    let corners = arguments.iter().any(|a| a == "corners");
    let samples = value("--samples", 128);
    let mut out = std::io::stdout();
    writeln!(out, "| lens | scene | asked, dB | predicted | measured (95 %) | planning, s | rendering, s |\n|---|---|---|---|---|---|---|")
        .expect("stdout");
    let mut tally = Tally { cases: 0, held: 0, worst_miss: 0.0, optimistic: 0.0, within: [0; 2], predicted: 0 };
    for name in lenses {
        let lens = lens(name);
        let frame = if corners { corner(&lens) } else { frame(&lens) };
        let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
        for (title, texture) in photographs(value("--photographs", 24)) {
            let scene = scene(&lens, &frame, texture);
            let rays = Settings { samples, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
            let halves: [Rendered; 2] =
                render_halves(&lens, &scene, &density, &frame, whole, rays, None).expect("renders");
            for asked in REQUESTS {
                let clock = Instant::now();
                let scenes = std::slice::from_ref(&scene);
                let plan =
                    plan(&lens, scenes, &frame, &density, Request::Psnr(asked), PlanOptions::RAYS).expect("plans");
                let planning = clock.elapsed().as_secs_f64();
                let clock = Instant::now();
                let (image, _) = plan.picture::<f32>(&scene, &|_| ()).expect("renders");
                let rendering = clock.elapsed().as_secs_f64();
                let found = psnr_against_halves(image.view(), &halves);
                let predicted = plan.predicted_db.unwrap_or(f64::NAN);
                let [low, high] = found.psnr_db_interval;
                writeln!(
                    out,
                    "| {name} | {title} | {asked} | {predicted:.1}{} | {:.2} ({low:.2} to {high:.2}) | {planning:.2} | {rendering:.3} |",
                    if plan.holds { "" } else { " (does not hold)" },
                    found.psnr_db
                )
                .expect("stdout");
                tally.cases += 1;
                tally.held += usize::from(found.psnr_db >= asked || !plan.holds);
                tally.worst_miss = tally.worst_miss.max(if plan.holds { asked - found.psnr_db } else { 0.0 });
                if predicted < 60.0 {
                    tally.predicted += 1;
                    tally.optimistic = tally.optimistic.max(predicted - found.psnr_db);
                    let off = (predicted - found.psnr_db).abs();
                    tally.within[0] += usize::from(off <= 3.0);
                    tally.within[1] += usize::from(off <= 6.0);
                }
            }
        }
    }
    writeln!(
        out,
        "\n{} of {} held (or said that they would not), worst miss {:.2} dB; of {} predictions below 60 dB the most optimistic by \
         {:.2} dB, {} within 3 dB, {} within 6",
        tally.held, tally.cases, tally.worst_miss, tally.predicted, tally.optimistic, tally.within[0], tally.within[1]
    )
    .expect("stdout");
}
