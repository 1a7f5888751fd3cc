//! Mutated prescriptions through `inspect`, `check`, `trace`, `sheets` and `psf`: an answer or one clear error; no panic, no number that is none,
//! at most ten seconds of processor time and two gibibytes of addresses each. What `inspect` refuses goes to one of the others only: all
//! of them read a lens by the same function.
//!
//! `ISOPLANAT_REPEAT=N` takes N lenses in place of 40, `ISOPLANAT_RANDOM_SEED` another first seed.

use rayon::prelude::*;
use toml::Value;

use crate::support::{Ran, Workplace, repetitions, root};

const LENSES: [usize; 2] = [40, 500];

const RAYS: &str = r#"{"wavelength_nm": 587.5618, "rays": [
    {"origin_mm": [0.0, 0.5, -1.0], "direction": [0.0, 0.0, 1.0]},
    {"origin_mm": [0.3, -4.0, -20.0], "direction": [0.1, 0.3, 0.9]},
    {"origin_mm": [0.0, 0.0, 0.0], "direction": [0.6, 0.0, 0.8]}]}"#;

/// The shipped lenses and those of the benches.
fn seeds() -> Vec<String> {
    let folders = ["models/lenses", "benches/lenses"].map(|f| root().join(f));
    let mut paths: Vec<_> = folders
        .iter()
        .flat_map(|f| std::fs::read_dir(f).expect("lists"))
        .map(|e| e.expect("an entry").path())
        .filter(|p| p.extension().is_some_and(|e| e == "toml"))
        .collect();
    paths.sort();
    paths.iter().map(|p| std::fs::read_to_string(p).expect("reads")).collect()
}

/// Tells `visit` every number of a document.
fn numbers(value: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
    match value {
        Value::Integer(_) | Value::Float(_) => visit(value),
        Value::Array(all) => all.iter_mut().for_each(|v| numbers(v, visit)),
        Value::Table(all) => all.iter_mut().for_each(|(_, v)| numbers(v, visit)),
        _ => {}
    }
}

/// Another number in place of one: mostly close by, sometimes wild.
fn mutated(value: &Value, rng: &mut fastrand::Rng) -> Value {
    let old = match value {
        Value::Integer(n) => *n as f64,
        Value::Float(v) => *v,
        _ => 0.0,
    };
    let wild = [
        0.0,
        -old,
        1e-300,
        1e-155,
        1e300,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        old * 1e6,
        old * 1e-6,
        1.0,
        -1.0,
    ];
    let new = match rng.u32(0..10) {
        0..5 => old * (1.0 + 0.1 * (rng.f64() - 0.5)),
        5..8 => old * 10f64.powf(4.0 * (rng.f64() - 0.5)),
        _ => wild[rng.usize(0..wild.len())],
    };
    match value {
        // A count stays one, mostly: few pixels make no more work than many.
        Value::Integer(_) if rng.u32(0..8) > 0 => Value::Integer(new.clamp(-10.0, 5000.0) as i64),
        _ => Value::Float(new),
    }
}

/// A lens file with some numbers changed, and now and then surfaces dropped, doubled or exchanged, or a key gone.
fn lens(seed: u64, seeds: &[String]) -> String {
    let rng = &mut fastrand::Rng::with_seed(seed);
    let mut document: toml::Table = seeds[rng.usize(0..seeds.len())].parse().expect("TOML");
    if let Some(Value::Array(surfaces)) = document.get_mut("surface") {
        let n = surfaces.len();
        let (i, j) = (rng.usize(0..n), rng.usize(0..n));
        match rng.u32(0..12) {
            0 if n > 1 => drop(surfaces.remove(i)),
            1 => surfaces.insert(i, surfaces[j].clone()),
            2 => surfaces.swap(i, j),
            3 => {
                if let Value::Table(surface) = &mut surfaces[i] {
                    let keys: Vec<String> = surface.keys().cloned().collect();
                    surface.remove(&keys[rng.usize(0..keys.len())]);
                }
            }
            _ => {}
        }
    }
    let mut whole = Value::Table(document);
    let mut count = 0;
    numbers(&mut whole, &mut |_| count += 1);
    let chosen: Vec<usize> = (0..rng.usize(1..5)).map(|_| rng.usize(0..count)).collect();
    let mut at = 0;
    numbers(&mut whole, &mut |v| {
        if chosen.contains(&at) {
            *v = mutated(v, rng);
        }
        at += 1;
    });
    toml::to_string(&whole).expect("TOML")
}

/// What is wrong with a run, if anything.
fn fault(ran: &Ran) -> Option<&'static str> {
    let number = |text: &str| text.split(|c: char| !c.is_alphanumeric()).any(|word| word == "NaN");
    match ran.code {
        0 | 1 if number(&ran.out) => Some("prints NaN"),
        0 | 1 => None,
        2 if ran.err.lines().filter(|l| l.starts_with("error: ")).count() == 1 => None,
        2 => Some("not one line of error"),
        101 => Some("panics"),
        _ => Some("is killed: too long, or too much memory"),
    }
}

#[test]
fn random_lenses_are_answered_or_refused() {
    let number = |name: &str, default: u64| std::env::var(name).map_or(default, |v| v.parse().expect("a number"));
    let (count, first) = (repetitions(LENSES[0], LENSES[1]) as u64, number("ISOPLANAT_RANDOM_SEED", 0));
    let seeds = seeds();
    let faults: Vec<(String, usize)> = (first..first + count)
        .into_par_iter()
        .map(|seed| {
            let text = lens(seed, &seeds);
            let place = Workplace::new();
            place.write("lens.toml", &text).write("rays.json", RAYS);
            let mut answered = 0;
            let more = [
                "check lens.toml",
                "trace lens.toml --rays rays.json --gradient",
                "psf lens.toml -o k.npz --fields 3",
                "sheets lens.toml -o sheets --mount c",
            ];
            let other = (seed % more.len() as u64) as usize;
            for (k, command) in std::iter::once("inspect lens.toml").chain(more).enumerate() {
                if answered == 0 && k > 0 && k != other + 1 {
                    continue;
                }
                // Seconds of processor time; KiB of addresses, stacks and what the allocator sets aside included.
                let ran = place.run_limited(command, 10, 2 << 20);
                if let Some(fault) = fault(&ran) {
                    return (format!("seed {seed}: `{command}` {fault}: {}\n{}\n{text}", ran.code, ran.err), answered);
                }
                let page = std::fs::read_to_string(place.path("sheets/sheets.html")).unwrap_or_default();
                if page.contains("NaN") || page.contains(">nan") {
                    return (format!("seed {seed}: `{command}` prints NaN on its page\n{text}"), answered);
                }
                answered += usize::from(ran.code != 2);
            }
            (String::new(), answered)
        })
        .collect();
    let answered = faults.iter().filter(|f| f.1 > 0).count();
    let bad: Vec<&str> = faults.iter().map(|f| f.0.as_str()).filter(|f| !f.is_empty()).collect();
    eprintln!("{count} lenses, {answered} of them answered by a command, {} with a fault", bad.len());
    assert!(bad.is_empty(), "{}", bad[..bad.len().min(5)].join("\n----\n"));
    assert!(answered as u64 >= count / 4, "only {answered} of {count} lenses are lenses");
}
