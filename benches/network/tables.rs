//! Time, processor time and memory of a step, one process a network.

use std::time::Instant;

use crate::cases::{self, CASES, Case};

const WARM_UPS: usize = 3;
const STEPS: usize = 10;

/// A line of the table for `case`, measured in this process.
pub(crate) fn measure(case: &Case) -> String {
    let mut run = case.build();
    let (parameters, pool) = (run.parameters(), cases::pool());
    let built = reset_peak();
    pool.install(|| {
        (0..WARM_UPS).for_each(|_| run.step());
        let before = processor_seconds();
        let mut seconds: Vec<f64> = (0..STEPS)
            .map(|_| {
                let start = Instant::now();
                run.step();
                start.elapsed().as_secs_f64()
            })
            .collect();
        let busy = (processor_seconds() - before) / STEPS as f64;
        seconds.sort_by(f64::total_cmp);
        let median = (seconds[STEPS / 2 - 1] + seconds[STEPS / 2]) / 2.0;
        format!(
            "| {} | {:.2} | {:.0} | {:.0} | {:.0} | {} |",
            case.name,
            parameters as f64 * 1e-6,
            median * 1e3,
            seconds[0] * 1e3,
            busy * 1e3,
            mebibytes(status("VmHWM:").map(|peak| peak - built.unwrap_or(0.0))),
        )
    })
}

/// Runs this program once for every network and prints the table.
pub(crate) fn print() {
    println!(
        "| network | 10^6 parameters | step, ms: median | least | processor time | peak above the built model, MiB |\n\
         |---|---|---|---|---|---|"
    );
    let program = std::env::current_exe().expect("this program");
    for case in CASES {
        let output = std::process::Command::new(&program).args(["measure", case.name]).output().expect("runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        print!("{}", String::from_utf8_lossy(&output.stdout));
    }
}

/// Sets the peak back to what is resident now, and gives that in KiB; `None` where the system keeps no such count.
fn reset_peak() -> Option<f64> {
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    status("VmHWM:")
}

/// A line of `/proc/self/status`, KiB.
fn status(key: &str) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    text.lines().find_map(|line| line.strip_prefix(key))?.split_whitespace().next()?.parse().ok()
}

fn mebibytes(kibibytes: Option<f64>) -> String {
    kibibytes.map_or("not known".into(), |k| format!("{:.0}", k / 1024.0))
}

/// Seconds this process has run on all processors, user and system; 0 where the system does not say.
pub(crate) fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // After the name in parentheses: state is the first field, user and system time the 12th and 13th, in 1/100 s.
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}
