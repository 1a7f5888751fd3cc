//! Damped least squares against scipy on the same residuals, and the global search from three plates: prints the tables of
//! `benches/results/optimize.md`. One thread for the comparison (`RAYON_NUM_THREADS` bounds the search).

use std::time::Instant;

use isoplanat::lens::{Aperture, Kind, Lens, Parameter, Prescription, builtin, prescription};
use isoplanat::optimize::search::{Plan, search};
use isoplanat::optimize::{
    Apertures, Constraint, Limits, Merit, Outcome, Problem, Quantity, light_of, merit_of, optimize,
};

const SINGLET: &str = r#"
schema = 1
name = "singlet"
source = "biconvex start of its own"
aperture = { entrance_pupil_diameter_mm = 10.0 }
object = { distance_mm = inf }
field = { max_angle_deg = 5.0 }
wavelengths = { nm = [486.1327, 587.5618, 656.2725], weights = [1.0, 1.0, 1.0], primary_nm = 587.5618 }
sensor = { columns = 1000, rows = 1000, pitch_um = 6.0 }
[[surface]]
radius_mm = 51.0
thickness_mm = 4.0
medium = "N-BK7"
semi_diameter_mm = 6.0
stop = true
[[surface]]
radius_mm = -51.0
thickness_mm = 48.0
medium = "air"
semi_diameter_mm = 6.0
"#;
const FACTORS: [f64; 6] = [1.031, 0.962, 0.957, 1.044, 0.951, 1.028];

fn shipped(name: &str) -> Lens {
    builtin::lens(name).expect("shipped")
}

/// The problem that `tests/peers/optimize_scipy.py` solves; the least thicknesses of glass and air, mm.
fn problem(lens: &Lens, conics: bool, [glass, air]: [f64; 2]) -> Problem {
    let n = lens.indices(lens.wavelengths.primary_nm);
    let chosen = |p: &Parameter| match p.kind {
        Kind::Curvature => n[p.of] != n[p.of + 1],
        Kind::Conic => conics && n[p.of] != n[p.of + 1],
        Kind::Thickness => true,
        _ => false,
    };
    let merit = Merit { apertures: Apertures::Automatic, ..Merit::default() };
    let mut problem =
        Problem::new(lens, Parameter::all(lens).filter(chosen).collect(), Problem::focal_length(lens), merit);
    for (p, bound) in problem.variables.parameters.iter().zip(&mut problem.bounds) {
        *bound = match p.kind {
            Kind::Thickness if p.of + 1 == lens.surfaces.len() => [20.0, 100.0],
            Kind::Thickness if n[p.of + 1] > 1.0 => [glass, 15.0],
            Kind::Thickness => [air, 30.0],
            Kind::Conic => [-20.0, 20.0],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        };
    }
    problem
}

fn against_scipy() {
    let text = include_str!("../../tests/peers/optimize_scipy.json");
    let scipy: serde_json::Value = serde_json::from_str(text).expect("the peer's results");
    println!(
        "| lens | start, µm | scipy, µm | s to 1 % | evaluations | here, µm | ms to scipy's + 1 % | ms in all | steps | time ratio |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let perturbed = shipped("cooke_triplet")
        .changed(|l| l.surfaces.iter_mut().zip(FACTORS).for_each(|(s, f)| s.shape.curvature /= f))
        .expect("a lens");
    let singlet = prescription::from_toml(SINGLET, "singlet").expect("a lens");
    let cases = [
        ("two_element", shipped("two_element"), false),
        ("three_element", shipped("three_element"), false),
        ("singlet", singlet, false),
        ("cooke_triplet_5_percent", perturbed, false),
        ("two_element_conics", shipped("two_element"), true),
    ];
    for (name, lens, conics) in cases {
        let peer = &scipy[name];
        let number = |key: &str| peer[key].as_f64().expect("a number");
        let least = [0, 1].map(|k| peer["least_mm"][k].as_f64().expect("a number"));
        let problem = problem(&lens, conics, least);
        let goal = 1.01 * number("rms_mm");
        let (mut best, mut all, mut last) = (f64::INFINITY, f64::INFINITY, None);
        for _ in 0..7 {
            let started = Instant::now();
            let mut reached = f64::INFINITY;
            let outcome = optimize(&problem, Limits { iterations: 2000, tolerance: 1e-7, until: None }, &mut |s| {
                if s.rms <= goal && s.violation < 1e-6 {
                    reached = reached.min(started.elapsed().as_secs_f64());
                }
                true
            });
            all = all.min(started.elapsed().as_secs_f64());
            best = best.min(reached);
            last = outcome.ok();
        }
        let found = last.expect("a lens");
        if let Some(refused) = &found.refused {
            println!("{name}: {:.4} µm is no lens: {}", refused.merit_mm * 1e3, refused.why);
        }
        println!(
            "| {name} | {:.3} | {:.4} | {:.3} | {} | {:.4} | {:.2} | {:.2} | {} | {:.0} |",
            number("rms_start_mm") * 1e3,
            number("rms_mm") * 1e3,
            number("seconds_to_one_percent"),
            peer["evaluations"],
            found.rms_mm[1] * 1e3,
            best * 1e3,
            all * 1e3,
            found.iterations,
            number("seconds_to_one_percent") / best
        );
    }
}

/// The shared two-element lens of scipy (17 s), whose full pupil does not get through it: both with the stated clear semi-diameters.
fn against_the_shared_lens() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/lenses/least_squares/two_element.toml");
    let Ok(reference) = prescription::load(std::path::Path::new(path)) else { return };
    let lens = shipped("two_element");
    let mut problem = problem(&lens, true, [1.0, 0.1]);
    problem.merit.apertures = Apertures::Stated;
    problem.constraints.extend(Problem::room(&lens));
    let started = Instant::now();
    let found = optimize(&problem, Limits::default(), &mut |_| true).expect("a lens");
    let seconds = started.elapsed().as_secs_f64();
    let rms = |lens: &Lens| merit_of(lens, &problem.merit).map_or(f64::NAN, |r| r * 1e3);
    println!(
        "\nleast_squares/two_element (scipy, 17 s): {:.3} µm; here, from the same coarse start with the same apertures: {:.3} µm in {seconds:.3} s ({:?})\n",
        rms(&reference),
        rms(&found.lens),
        found.stop
    );
    for (name, lens) in [("start", &lens), ("scipy", &reference), ("here", &found.lens)] {
        println!(
            "light through the stated apertures at 0, 0.35, 0.6, 0.8, 1 of the field, {name}: {:.2?}",
            light_of(lens, &problem.merit)
        );
    }
}

/// Thicknesses and edges that both triplets keep; distortion within `d` where it is given.
fn triplet(lens: &Lens, d: Option<f64>, track: f64) -> Problem {
    let mut p = Problem::standard(lens);
    p.merit.apertures = Apertures::Automatic;
    for (q, b) in p.variables.parameters.iter().zip(&mut p.bounds) {
        match (q.kind, q.of) {
            (Kind::Thickness, 0 | 2 | 4) => *b = [1.0, 15.0],
            (Kind::Thickness, 5) => *b = [35.0, 100.0],
            (Kind::Thickness, _) => *b = [0.1, 30.0],
            _ => {}
        }
    }
    p.constraints.retain(|c| c.quantity != Quantity::FocalLength);
    for c in &mut p.constraints {
        if let Quantity::Edge(i) = c.quantity {
            c.bounds[0] = if i % 2 == 0 { 0.75 } else { 0.1 };
        }
    }
    p.constraints.push(Constraint { quantity: Quantity::FocalLength, bounds: [50.0, 50.0] });
    p.constraints.push(Constraint { quantity: Quantity::Track, bounds: [0.0, track] });
    p.constraints.push(Constraint { quantity: Quantity::BackFocus, bounds: [35.0, 200.0] });
    for k in 1..p.merit.fields.len() {
        let d = d.unwrap_or(0.9);
        p.constraints.push(Constraint { quantity: Quantity::Distortion(k), bounds: [-d, d] });
    }
    p
}

fn distortion(o: &Outcome) -> f64 {
    let held = o.held.iter().filter(|h| matches!(h.of.quantity, Quantity::Distortion(_)));
    held.map(|h| h.value.abs()).fold(0.0, f64::max)
}

fn from_three_plates() {
    let f4 = |l: &mut Prescription| l.aperture = Aperture::EntrancePupilDiameter(12.5);
    let cooke = shipped("cooke_triplet").changed(f4).expect("a lens");
    let reference = optimize(&triplet(&cooke, None, 1e3), Limits::default(), &mut |_| true).expect("a lens");
    let (track, d) = (reference.lens.length(), distortion(&reference));
    println!(
        "\n| triplet | minutes | rms, µm | track, mm | back focus, mm | distortion | different minima |\n|---|---|---|---|---|---|---|"
    );
    let line = |name: &str, seconds: f64, o: &Outcome, minima: usize| {
        let back = o.lens.surfaces.last().map_or(0.0, |s| s.thickness);
        println!(
            "| {name} | {:.3} | {:.3} | {:.2} | {back:.2} | {:.2} % | {minima} |",
            seconds / 60.0,
            o.rms_mm[1] * 1e3,
            o.lens.length(),
            100.0 * distortion(o)
        );
    };
    line("Cooke, f/4, re-optimised", reference.seconds, &reference, 1);
    let plates = cooke
        .changed(|l| {
            l.surfaces.iter_mut().for_each(|s| s.shape.curvature = 0.0);
            for (s, t) in l.surfaces.iter_mut().zip([3.0, 5.0, 2.0, 5.0, 3.0, 42.0]) {
                s.thickness = t;
            }
        })
        .expect("a lens");
    for seed in 1..=3 {
        let started = Instant::now();
        let problem = triplet(&plates, Some(d + 0.01), 1.1 * track);
        let found = search(&problem, &Plan { seed, ..Plan::default() }, &mut |_| true).expect("a search");
        match found.first() {
            Some(best) => {
                line(&format!("three plates, seed {seed}"), started.elapsed().as_secs_f64(), best, found.len())
            }
            None => println!("| seed {seed}: nothing |"),
        }
    }
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread").install(against_scipy);
    against_the_shared_lens();
    from_three_plates();
}
