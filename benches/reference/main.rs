//! The reference renderer: `cargo bench --bench reference` for criterion's figures, `cargo bench --bench reference --
//! table` for the table (of one lens: its name after `table`) of `benches/results/reference.md`, `-- surfaces` for
//! nanoseconds a ray and surface.
//!
//! 512 × 384 pixels over a lens's frame look at a painted scene of about a texel a pixel. Seconds a megapixel include
//! the preparation of the whole picture. Shares of time: the trace is timed on stored tiles of the same rays, the
//! look-up is what the painted scene costs above a scene of one texel, the rest draws and sums.

use std::hint::black_box;
use std::time::Instant;

use criterion::{Criterion, Throughput};
use glam::DVec2;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::bounds::Footprints;
use isoplanat::imaging::reference::rear::RearView;
use isoplanat::imaging::reference::{Channels, Rendered, Sampling, Settings, render};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, builtin};
use isoplanat::trace::lanes::{TILE, Tile};
use ndarray::Array3;

const COLS: usize = 512;
const ROWS: usize = 384;
const SAMPLES: usize = 64;
const LENSES: [&str; 3] = ["two_element", "cooke_triplet", "phone"];

struct Case {
    lens: Lens,
    density: SpectralDensity,
    frame: Frame,
    painted: Plane,
    flat: Plane,
}

impl Case {
    fn new(name: &str) -> Self {
        let lens = builtin::lens(name).expect("shipped");
        // The corner of the frame at the corner of the lens's own.
        let pitch = lens.sensor.radius_mm() / (COLS as f64 / 2.0).hypot(ROWS as f64 / 2.0);
        let frame = Frame::centred(COLS, ROWS, pitch).expect("valid");
        let half_field = lens.max_field_deg().to_radians().tan();
        let texels_per_slope = 0.5 * (COLS as f64).hypot(ROWS as f64) / half_field;
        let (rows, cols) = (ROWS + ROWS / 2, COLS + COLS / 2);
        let painted = Plane {
            texture: generate(SceneKind::Facades, 3, rows, cols),
            texels_per_slope,
            axis_texel: [cols as f64 / 2.0, rows as f64 / 2.0],
            vergence: lens.object_vergence,
        };
        let flat = Plane { texture: Array3::from_elem((1, 1, 1), 0.3), ..painted.clone() };
        Self { lens, density: SpectralDensity::new(&Sensor::generic()), frame, painted, flat }
    }

    fn render(&self, scene: &Plane, rows: usize) -> Rendered {
        let region = Region { row: ((ROWS - rows) / 2).cast_signed(), col: 0, rows, cols: COLS };
        let how = Settings { samples: SAMPLES, seed: 1, channels: Channels::All, sampling: Sampling::Bounded };
        render(&self.lens, scene, &self.density, &self.frame, region, how, None).expect("renders")
    }

    /// What a rendering finds out before its first ray counts.
    fn prepare(&self) -> (RearView, Footprints) {
        let radius = self.frame.max_radius_mm();
        let rear = RearView::new(&self.lens, &self.density, radius).expect("a view");
        let footprints = Footprints::probe(&rear, [0.0, radius]);
        (rear, footprints)
    }

    /// Seconds of preparation alone, and nanoseconds a ray of the trace alone, one thread.
    fn parts(&self) -> (f64, f64) {
        let start = Instant::now();
        let (rear, footprints) = self.prepare();
        let seconds = start.elapsed().as_secs_f64();
        let radius = self.frame.max_radius_mm();
        let rng = &mut fastrand::Rng::with_seed(1);
        let tiles: Vec<Tile> = (0..256)
            .map(|_| {
                let mut tile = Tile::new();
                tile.resize(TILE);
                for lane in 0..TILE {
                    let p = DVec2::new(0.0, 0.7 * radius * rng.f64());
                    let e = footprints.at(p.y);
                    let (angle, r) = (std::f64::consts::TAU * rng.f64(), rng.f64().sqrt());
                    let target = DVec2::new(e.across * r * angle.cos(), e.centre + e.along * r * angle.sin());
                    let colour = rear.colour(lane % 3, rng.f64());
                    tile.rays.set(lane, rear.ray(p, target, colour).1);
                    tile.colour[lane] = colour.number;
                }
                tile
            })
            .collect();
        let mut work = Tile::new();
        work.resize(TILE);
        let mut best = f64::INFINITY;
        for _ in 0..20 {
            let start = Instant::now();
            for tile in &tiles {
                work.rays.clone_from(&tile.rays);
                work.colour = tile.colour;
                rear.program.trace_tile(&mut work);
                black_box(&work.rays);
            }
            best = best.min(start.elapsed().as_secs_f64());
        }
        (seconds, best * 1e9 / (tiles.len() * TILE) as f64)
    }
}

/// Seconds of processor time of this process so far; `None` where the system does not tell.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name may hold spaces and ends in a bracket; user and system time in hundredths are entries 14 and 15.
    let mut rest = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || rest.next()?.parse::<f64>().ok();
    Some((next()? + next()?) / 100.0)
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool")
}

/// Wall and processor seconds of the best of three.
fn best(mut work: impl FnMut() -> Rendered) -> (f64, f64, Rendered) {
    let mut found: Option<(f64, f64, Rendered)> = None;
    for _ in 0..3 {
        let (wall, cpu) = (Instant::now(), processor_seconds().unwrap_or(f64::NAN));
        let rendered = work();
        let (wall, cpu) = (wall.elapsed().as_secs_f64(), processor_seconds().unwrap_or(f64::NAN) - cpu);
        if found.as_ref().is_none_or(|f| wall < f.0) {
            found = Some((wall, cpu, rendered));
        }
    }
    found.expect("three runs")
}

fn table() {
    println!("{COLS} × {ROWS} pixels, R, G and B, {SAMPLES} rays each; best of 3:\n");
    println!(
        "| lens | threads | s/Mpixel | processor s/Mpixel | M rays/s | passed | noise rms | preparation, s | trace | look-up | drawing and the rest |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mpixel = (COLS * ROWS) as f64 * 1e-6;
    let wanted: Vec<String> = std::env::args().collect();
    let named = LENSES.iter().any(|name| wanted.iter().any(|a| a == name));
    for name in LENSES.into_iter().filter(|name| !named || wanted.iter().any(|a| a == name)) {
        let case = Case::new(name);
        for threads in [1, 2] {
            pool(threads).install(|| {
                let (wall, cpu, rendered) = best(|| case.render(&case.painted, ROWS));
                let (_, cpu_flat, _) = best(|| case.render(&case.flat, ROWS));
                let (preparation, trace_ns) = case.parts();
                let trace = trace_ns * 1e-9 * rendered.rays as f64;
                println!(
                    "| {name} | {threads} | {:.1} | {:.1} | {:.1} | {:.3} | {:.5} | {preparation:.2} | {:.0} % ({trace_ns:.0} ns a ray) | {:.0} % | {:.0} % |",
                    wall / mpixel,
                    cpu / mpixel,
                    rendered.rays as f64 / wall * 1e-6,
                    rendered.passed as f64 / rendered.rays as f64,
                    rendered.noise_rms(),
                    100.0 * trace / cpu,
                    100.0 * (cpu - cpu_flat) / cpu,
                    100.0 * (cpu_flat - trace) / cpu,
                );
            });
        }
    }
}

/// One thread, processor time: preparation, and nanoseconds a ray and surface of the trace alone and of some rows'
/// rendering without its preparation.
fn surfaces() {
    const BAND: usize = 24;
    println!(
        "| lens | surfaces | passed | preparation, s | trace, ns a ray | a ray and surface | rendering, ns a ray and surface |"
    );
    println!("|---|---|---|---|---|---|---|");
    let clock = || processor_seconds().unwrap_or(f64::NAN);
    for name in LENSES {
        let case = Case::new(name);
        let count = case.lens.surfaces.len() as f64;
        pool(1).install(|| {
            let (_, trace) = case.parts();
            let (mut preparation, mut whole) = (f64::INFINITY, f64::INFINITY);
            let (mut rays, mut passed) = (1.0, 0.0);
            for _ in 0..3 {
                let before = clock();
                black_box(case.prepare());
                let between = clock();
                let rendered = case.render(&case.painted, BAND);
                preparation = preparation.min(between - before);
                whole = whole.min(clock() - between);
                (rays, passed) = (rendered.rays as f64, rendered.passed as f64);
            }
            println!(
                "| {name} | {count} | {:.3} | {preparation:.2} | {trace:.1} | {:.2} | {:.2} |",
                passed / rays,
                trace / count,
                (whole - preparation) * 1e9 / rays / count
            );
        });
    }
}

fn lenses(c: &mut Criterion) {
    let mut group = c.benchmark_group("reference");
    group.sample_size(10);
    for name in LENSES {
        let case = Case::new(name);
        let rows = 32;
        group.throughput(Throughput::Elements(case.render(&case.painted, rows).rays));
        for threads in [1, 2] {
            let pool = pool(threads);
            group.bench_function(format!("{name}/{COLS}x{rows}/{threads}"), |b| {
                pool.install(|| b.iter(|| case.render(&case.painted, rows)));
            });
        }
    }
    group.finish();
}

fn main() {
    if std::env::args().any(|a| a == "table") {
        table();
        return;
    }
    if std::env::args().any(|a| a == "surfaces") {
        surfaces();
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    lenses(&mut criterion);
    criterion.final_summary();
}
