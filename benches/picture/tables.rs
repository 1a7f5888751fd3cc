//! The fast renderer judged by the reference; what `--min-psnr-db` holds and costs; what plans save.

use std::fmt::Write as _;
use std::time::Instant;

use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::halves::psnr_against_halves;
use isoplanat::imaging::reference::{Channels, Rendered, Sampling, Settings as Rays, render as trace, render_halves};
use isoplanat::imaging::render::{Request, Settings, frame_of};
use isoplanat::lens::builtin;
use ndarray::{Array3, s};

use crate::cases::{Case, LENSES, photograph, place, points};

/// A picture, its plan's numbers, its seconds from the lens on.
struct Made {
    image: Array3<f32>,
    seconds: f64,
    planning: f64,
    settings: Settings,
    nodes: usize,
    kernel: usize,
    predicted: f64,
}

fn make(case: &Case, request: Request) -> Made {
    let clock = Instant::now();
    let plan = case.plan(request, false);
    let planning = clock.elapsed().as_secs_f64();
    let image = case.picture(&plan);
    let (seconds, depth) = (clock.elapsed().as_secs_f64(), &plan.renderer.plan.depths[0]);
    Made {
        image,
        seconds,
        planning,
        settings: plan.renderer.plan.settings,
        nodes: depth.grid.len(),
        kernel: depth.size() * depth.bin,
        predicted: plan.predicted_db.unwrap_or(f64::NAN),
    }
}

fn whole(case: &Case) -> Region {
    Region { row: 0, col: 0, rows: case.frame.rows, cols: case.frame.columns }
}

fn reference(case: &Case, samples: usize) -> [Rendered; 2] {
    let how = Rays { samples, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
    render_halves(&case.lens, &case.scene, &case.density, &case.frame, whole(case), how, None).expect("renders")
}

fn energy(image: &Array3<f32>, halves: &[Rendered; 2]) -> f64 {
    let sum = |a: &Array3<f32>| a.iter().map(|v| f64::from(*v)).sum::<f64>();
    2.0 * sum(image) / (sum(&halves[0].mean) + sum(&halves[1].mean)) - 1.0
}

fn rms(a: &Array3<f32>, b: &Array3<f32>) -> f64 {
    (a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

/// Writes `benches/results/picture.md`.
pub(crate) fn write(quick: bool) {
    let mut page = String::from("# Pictures: error against run time\n\n");
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let _ = writeln!(
        page,
        "`cargo bench --bench picture -- tables{}`, {threads} threads.\n",
        if quick { " quick" } else { "" }
    );
    let mut section = |name: &str, text: String| {
        println!("## {name}\n\n{text}");
        let _ = write!(page, "## {name}\n\n{text}\n");
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/results/picture.md");
        std::fs::write(path, &page).expect("writes");
    };
    section("The fast renderer against the reference", against_reference(quick));
    section("What a plan leaves out", plans());
    section("Run time at equal error", equal_error(quick));
    section("--min-psnr-db", chosen(quick));
}

/// Three lenses, three photographs and a field of points.
fn against_reference(quick: bool) -> String {
    let mut out = String::from(
        "Finest settings, 384 × 256 pixels half way to the corner; reference 256 rays a pixel and channel in two halves.\n\n\
         | lens | scene | PSNR dB | 95 % interval | energy | seam / local step | fast s | reference s |\n|---|---|---|---|---|---|---|---|\n",
    );
    for lens in LENSES {
        let photographs: &[usize] = if quick { &[5] } else { &[5, 13, 23] };
        let mut scenes: Vec<(String, Array3<f32>)> =
            photographs.iter().filter_map(|n| Some((format!("photograph {n:02}"), photograph(*n)?))).collect();
        scenes.push(("points".into(), points()));
        for (what, texture) in scenes {
            let case = place(lens, [384, 256], texture);
            let fast = make(&case, Request::Settings(Settings::FINE));
            let clock = Instant::now();
            let halves = reference(&case, 256);
            let seconds = clock.elapsed().as_secs_f64();
            let a = psnr_against_halves(fast.image.view(), &halves);
            let _ = writeln!(
                out,
                "| {lens} | {what} | {:.1} | {:.1} to {:.1} | {:+.1e} | {:.2} | {:.2} | {seconds:.1} |",
                a.psnr_db,
                a.psnr_db_interval[0],
                a.psnr_db_interval[1],
                energy(&fast.image, &halves),
                seams(&case),
                fast.seconds
            );
        }
    }
    out
}

/// A white scene's largest second difference between neighbouring pixels at knots, over its largest elsewhere.
fn seams(case: &Case) -> f64 {
    let white = Plane { texture: Array3::ones((1, 2, 2)), ..case.scene.clone() };
    let plan = case.plan(Request::Settings(Settings::FINE), false);
    let image = plan.picture::<f64>(&white, &|_| ()).expect("renders").0;
    let depth = &plan.renderer.plan.depths[0];
    let (mut at, mut elsewhere) = (0.0f64, 0.0f64);
    for row in [0, case.frame.rows / 2] {
        for j in 1..case.frame.columns - 1 {
            let v = |k: usize| image[[1, row, k]];
            let step = (v(j + 1) - 2.0 * v(j) + v(j - 1)).abs();
            let local = 0.5 * (v(j + 1) - v(j - 1)).abs();
            let near = depth.grid.col_knots.iter().any(|k| (k * depth.bin.cast_signed() - j.cast_signed()).abs() <= 1);
            if near {
                at = at.max(step);
            }
            elsewhere = elsewhere.max(local);
        }
    }
    at / elsewhere.max(1e-9)
}

/// Scenes that need little: planned against everything.
fn plans() -> String {
    let mut out = String::from(
        "1536 × 512 pixels, planned at 50 dB against everything (finest settings, nodes every 16 pixels, all channels, whole frame), both from the \
         lens on. The bound is the sum of the plan's own.\n\n\
         | case | planned s | everything s | saving | rms difference | stated bound |\n|---|---|---|---|---|---|\n",
    );
    let photo = photograph(5).unwrap_or_else(|| {
        isoplanat::imaging::scene::generate(isoplanat::imaging::scene::SceneKind::Facades, 3, 512, 768)
    });
    // As wide as the frame: the photograph and its mirror image.
    let (_, _, half) = photo.dim();
    let photo = Array3::from_shape_fn((3, photo.dim().1, 2 * half), |(c, i, j)| {
        photo[[c, i, if j < half { j } else { 2 * half - 1 - j }]]
    });
    let grey = {
        let green = photo.slice(s![1, .., ..]).to_owned();
        Array3::from_shape_fn(photo.dim(), |(_, i, j)| green[[i, j]])
    };
    let (_, rows, cols) = photo.dim();
    let corner = Array3::from_shape_fn(photo.dim(), |(c, i, j)| {
        let lit = (8..rows / 5).contains(&i) && (8..cols / 5).contains(&j);
        if lit { photo[[c, i, j]] } else { 0.0 }
    });
    let size = [1536, 512];
    let mut small = place("cooke_triplet", size, photo.clone());
    let centre = isoplanat::imaging::frame::Frame::centred(size[0], size[1], small.frame.pitch_mm).expect("valid");
    small.scene.axis_texel = [cols as f64 / 2.0, rows as f64 / 2.0];
    small.frame = centre;
    let cases = [
        ("single depth (two_element)", place("two_element", size, photo.clone())),
        ("grey scene (two_element)", place("two_element", size, grey)),
        ("one lit corner (two_element)", place("two_element", size, corner)),
        ("phone lens in focus", place("phone", size, photo)),
        ("small central field (cooke_triplet)", small),
    ];
    for (what, case) in cases {
        let full = make(&case, Request::Everything);
        let best = (0..3).map(|_| make(&case, Request::Psnr(50.0)).seconds).fold(f64::INFINITY, f64::min);
        let told = case.plan(Request::Psnr(50.0), true);
        let image = case.picture(&told);
        let bound: f64 = told.skips.iter().map(|s| s.bound).sum();
        let _ = writeln!(
            out,
            "| {what} | {best:.2} | {:.2} | {:.1} × | {:.1e} | {bound:.1e} |",
            full.seconds,
            full.seconds / best,
            rms(&image, &full.image)
        );
    }
    out
}

/// The paper's large-field frame: the fast renderer and the reference at the same error.
fn equal_error(quick: bool) -> String {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = frame_of(&lens).expect("valid");
    let Some(photo) = photograph(5) else { return "No photographs here.\n".into() };
    // The photograph, repeated in mirror images, over the paper's texture: 437 × 54.5 mm at 1 m.
    let (_, rows, cols) = photo.dim();
    let (wide, high) = (4096, 512);
    let mirrored = |k: usize, n: usize| if (k / n).is_multiple_of(2) { k % n } else { n - 1 - k % n };
    let texture = Array3::from_shape_fn((3, high, wide), |(c, i, j)| photo[[c, mirrored(i, rows), mirrored(j, cols)]]);
    let scene =
        Plane { texture, texels_per_slope: 4096.0 / 0.437, axis_texel: [0.0, 0.0], vergence: lens.object_vergence };
    let density =
        isoplanat::imaging::sensor::spectrum::SpectralDensity::new(&isoplanat::imaging::sensor::Sensor::generic());
    let case = Case { lens, frame, scene, density };
    // Judged on bands of columns over the field.
    let bands: Vec<Region> =
        [200, 1400, 2600, 3800].into_iter().map(|col| Region { row: 200, col, rows: 64, cols: 64 }).collect();
    let halves: Vec<[Rendered; 2]> = bands
        .iter()
        .map(|b| {
            let how = Rays { samples: 4096, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
            render_halves(&case.lens, &case.scene, &case.density, &case.frame, *b, how, None).expect("renders")
        })
        .collect();
    let mut out = format!(
        "`lfov-paper`, {} × {} pixels RGB, two_element, photograph 05. The error is the mean over four regions of 64² pixels; \
         the reference's run time for the same error follows from its measured time per ray and its variance, which falls as \
         1/samples (measured at 64 samples on the same regions, plain and bounded).\n\n\
         | asked | PSNR dB | settings | planning s | fast s | reference, plain: samples, s | ratio | reference, bounded: samples, s | ratio |\n|---|---|---|---|---|---|---|---|---|\n",
        case.frame.columns, case.frame.rows
    );
    // Noise and time of the reference a pixel and sample.
    let cost = |sampling: Sampling| {
        let how = Rays { samples: 64, seed: 9, channels: Channels::All, sampling };
        let (mut variance, mut seconds, mut pixels) = (0.0, 0.0, 0.0);
        for b in &bands {
            let r = trace(&case.lens, &case.scene, &case.density, &case.frame, *b, how, None).expect("renders");
            variance += r.noise_rms().powi(2) / bands.len() as f64;
            seconds += r.seconds;
            pixels += (b.rows * b.cols) as f64;
        }
        (variance * 64.0, seconds / pixels / 64.0)
    };
    let (plain, bounded) = (cost(Sampling::RearAperture), cost(Sampling::Bounded));
    let all = (case.frame.columns * case.frame.rows) as f64;
    for db in if quick { vec![45.0] } else { vec![40.0, 45.0, 50.0] } {
        let fast = make(&case, Request::Psnr(db));
        let mean: f64 = bands
            .iter()
            .zip(&halves)
            .map(|(b, h)| {
                let (r, c) = (b.row.unsigned_abs(), b.col.unsigned_abs());
                let part = fast.image.slice(s![.., r..r + b.rows, c..c + b.cols]);
                psnr_against_halves(part, h).mean_square / bands.len() as f64
            })
            .sum();
        let samples = |(variance, seconds): (f64, f64)| (variance / mean, variance / mean * seconds * all);
        let (p, b) = (samples(plain), samples(bounded));
        let _ = writeln!(
            out,
            "| {db} dB | {:.1} | {} | {:.2} | {:.2} | {:.0}, {:.0} | 1/{:.0} | {:.0}, {:.0} | 1/{:.0} |",
            -10.0 * mean.log10(),
            words(&fast),
            fast.planning,
            fast.seconds,
            p.0,
            p.1,
            p.1 / fast.seconds,
            b.0,
            b.1,
            b.1 / fast.seconds
        );
    }
    out
}

fn words(m: &Made) -> String {
    let s = m.settings;
    format!("m {}, {} λ, {} points, {} nodes, {}²", s.samples, s.wavelengths, s.dense, m.nodes, m.kernel)
}

/// Photographs × lenses: does the request hold, and what does it cost beside the cheapest that would have?
pub(crate) fn chosen(quick: bool) -> String {
    let size = [768, 512];
    let targets = [40.0, 45.0, 50.0];
    let numbers: Vec<usize> = if quick { vec![2, 5, 9, 13, 18, 23] } else { (1..=24).collect() };
    let mut out = String::from(
        "768 × 512 pixels half way to the corner; reference 32 rays a pixel and channel (phone: 16). The cheapest: the least run time of a ladder of nine settings (without planning) that held, and of the chosen settings themselves.\n\n",
    );
    let mut lines = String::from(
        "\n| lens | photograph | asked | PSNR dB | predicted | settings | planning s | s | cheapest s | ratio |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let mut counts = [[0usize; 3]; 3];
    let mut worst = [0.0f64; 3];
    let mut ratios: Vec<f64> = Vec::new();
    for lens in LENSES {
        for number in &numbers {
            let Some(photo) = photograph(*number) else { continue };
            // Upright ones are turned.
            let photo = if photo.dim().1 > photo.dim().2 {
                photo.permuted_axes([0, 2, 1]).as_standard_layout().to_owned()
            } else {
                photo
            };
            let case = place(lens, size, photo);
            let halves = reference(&case, if lens == "phone" { 16 } else { 32 });
            let judge = |image: &Array3<f32>| psnr_against_halves(image.view(), &halves).psnr_db;
            let ladder: Vec<(f64, f64)> = ladder()
                .into_iter()
                .map(|s| {
                    let made = make(&case, Request::Settings(s));
                    (judge(&made.image), made.seconds)
                })
                .collect();
            for (t, db) in targets.into_iter().enumerate() {
                let made = make(&case, Request::Psnr(db));
                let again = make(&case, Request::Settings(made.settings));
                let psnr = judge(&made.image);
                let mut held: Vec<f64> = ladder.iter().filter(|(p, _)| *p >= db).map(|(_, s)| *s).collect();
                if judge(&again.image) >= db {
                    held.push(again.seconds);
                }
                let cheapest = held.into_iter().fold(f64::INFINITY, f64::min);
                let ratio = made.seconds / cheapest;
                counts[t][0] += 1;
                counts[t][1] += usize::from(psnr >= db);
                counts[t][2] += usize::from(ratio <= 4.0);
                if ratio.is_finite() {
                    worst[t] = worst[t].max(ratio);
                    ratios.push(ratio);
                }
                let _ = writeln!(
                    lines,
                    "| {lens} | {number:02} | {db} | {psnr:.1} | {:.1} | {} | {:.2} | {:.2} | {cheapest:.2} | {ratio:.1} |",
                    made.predicted,
                    words(&made),
                    made.planning,
                    made.seconds
                );
                println!(
                    "{lens} {number:02} {db}: {psnr:.1} dB (predicted {:.1}), {:.2} s, ratio {ratio:.1}",
                    made.predicted, made.seconds
                );
            }
        }
    }
    for (t, db) in targets.into_iter().enumerate() {
        let [all, held, cheap] = counts[t];
        let _ = writeln!(
            out,
            "- {db} dB: held on {held} of {all}; at most 4 × the cheapest on {cheap}, largest ratio {:.1}.",
            worst[t]
        );
    }
    out + &lines
}

/// From coarse to fine, all approximations together and the scene's samples apart.
fn ladder() -> Vec<Settings> {
    let steps = [(3, 200, 0.4, 2e-2), (4, 200, 0.2, 5e-3), (5, 500, 0.2, 2e-3), (7, 1200, 0.1, 5e-4)];
    let with = |m: usize| {
        steps.map(|(wavelengths, dense, node_error, outside)| Settings {
            samples: m,
            wavelengths,
            dense,
            node_error,
            outside,
            ..Settings::FINE
        })
    };
    [1, 2].into_iter().flat_map(with).chain([with(4)[3]]).collect()
}
