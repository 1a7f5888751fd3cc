//! The tables of `benches/results/trace.md`: every figure is the best of many runs.

use std::fs;
use std::time::Instant;

use isoplanat::trace::lanes::{GROUPS, Level, TILE};

use crate::cases::{Case, RAYS, pool};
use crate::peak;

pub(crate) fn print() {
    peaks();
    lenses();
    surfaces();
    parameters();
    rays();
}

/// Seconds of the fastest of `runs`.
fn best(runs: u32, mut work: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn peaks() {
    println!("Peak of one thread, f64 multiply-adds:\n\n| instructions | per ns |\n|---|---|");
    for level in Level::available() {
        println!("| {level:?} | {:.1} |", peak::per_ns(level));
    }
}

/// Fewer runs for the slow levels.
fn runs(level: Level) -> u32 {
    if level == Level::Plain { 10 } else { 40 }
}

fn lenses() {
    println!("\nM ray-surfaces/s, {RAYS} rays:\n");
    println!("| lens | surfaces | instructions | threads | forward | forward + adjoint | time ratio |");
    println!("|---|---|---|---|---|---|---|");
    for case in Case::all() {
        let work = (RAYS * case.refracting()) as f64 * 1e-6;
        for level in Level::available() {
            for threads in [1, 2] {
                pool(threads).install(|| {
                    let forward = best(runs(level), || assert_eq!(case.forward(level, RAYS), RAYS));
                    let both = best(runs(level), || assert!(case.gradient(level, RAYS) > 0.0));
                    println!(
                        "| {} | {} | {level:?} | {threads} | {:.0} | {:.0} | {:.2} |",
                        case.name,
                        case.refracting(),
                        work / forward,
                        work / both,
                        both / forward,
                    );
                });
            }
        }
    }
}

fn surfaces() {
    println!("\nCost against the number of surfaces (weak even aspheres, 5 terms), one thread:\n");
    println!("| surfaces | forward, ns a ray-surface | forward + adjoint | ratio |\n|---|---|---|---|");
    for count in [1, 2, 4, 8, 16, 32] {
        scaling_row(&count.to_string(), &Case::stack(count, 5));
    }
}

fn parameters() {
    println!("\nCost against the number of parameters (8 surfaces), one thread:\n");
    println!(
        "| terms a surface: parameters | forward, ns a ray-surface | forward + adjoint | ratio |\n|---|---|---|---|"
    );
    for terms in [0, 2, 3, 4, 5, 6, 8, 10] {
        let case = Case::stack(8, terms);
        scaling_row(&format!("{terms}: {}", case.parameters()), &case);
    }
}

fn scaling_row(name: &str, case: &Case) {
    const COUNT: usize = 1 << 14;
    let level = Level::detect();
    let each = 1e9 / (COUNT * case.refracting()) as f64;
    pool(1).install(|| {
        let forward = best(60, || assert_eq!(case.forward(level, COUNT), COUNT)) * each;
        let both = best(60, || assert!(case.gradient(level, COUNT) > 0.0)) * each;
        println!("| {name} | {forward:.2} | {both:.2} | {:.2} |", both / forward);
    });
}

fn rays() {
    println!(
        "\nCost and peak memory against the number of rays (phone, streamed, two threads, {GROUPS} groups of tiles of {TILE}):\n"
    );
    println!("| rays | forward, M ray-surfaces/s | peak growth, KiB | forward + adjoint | peak growth, KiB |");
    println!("|---|---|---|---|---|");
    let [_, _, case] = Case::all();
    let level = Level::detect();
    pool(2).install(|| {
        for power in (10..=20).step_by(2) {
            let count = 1 << power;
            let work = (count * case.refracting()) as f64 * 1e-6;
            let (forward, forward_kib) = with_peak(|| best(10, || assert_eq!(case.forward(level, count), count)));
            let (both, both_kib) = with_peak(|| best(10, || assert!(case.gradient(level, count) > 0.0)));
            println!("| 2^{power} | {:.0} | {forward_kib} | {:.0} | {both_kib} |", work / forward, work / both);
        }
    });
}

/// A result, and by how much the process's peak memory lay above what it had before.
fn with_peak<T>(work: impl FnOnce() -> T) -> (T, String) {
    // 5 resets the peak (proc(5)); elsewhere than on Linux there is no figure.
    let reset = fs::write("/proc/self/clear_refs", "5").is_ok();
    let before = kib("VmRSS:");
    let result = work();
    let growth = kib("VmHWM:").zip(before).filter(|_| reset).map(|(peak, before)| peak.saturating_sub(before));
    (result, growth.map_or("-".into(), |kib| kib.to_string()))
}

fn kib(key: &str) -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|l| l.strip_prefix(key))?.trim().trim_end_matches(" kB").parse().ok()
}
