//! Kills and full disks at each system call that writes, put there by `strace`: no file is half there, and what goes on has the same bits.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{SMALL_DESIGN, Workplace, repetitions, tensors};

/// System calls by what they do; a question mark before those that a machine may not have.
const CALLS: [(&str, &str); 3] = [
    ("write", "write,pwrite64,?writev"),
    ("sync", "fsync,fdatasync"),
    ("name", "?rename,?renameat,renameat2,?link,linkat,?unlink,unlinkat,?mkdir,mkdirat,ftruncate"),
];

/// What is done to the call.
const FAULTS: [(&str, &str); 2] = [("a kill", "signal=KILL"), ("a full disk", "error=ENOSPC")];

/// What a task says of a training of some seconds.
const TRAINING: &str = r#"
[train]
base_width = 4
scales = 2
patch_px = 32
region_px = 48
pairs = 6
steps = 40
checkpoint_seconds = 0.02
sample_steps = 20
"#;

/// A command whose writing is disturbed.
struct Job {
    name: &'static str,
    /// What it is given: files and folders made by the commands of [`made`].
    inputs: &'static [&'static str],
    /// What stands in the output's place before; empty: nothing.
    before: &'static str,
    arguments: &'static str,
    /// The same once more after the fault, where it has begun: it goes on, or replaces what is there.
    again: &'static str,
    output: &'static str,
    /// Files of the output that say when or how long.
    timed: &'static [&'static str],
    /// Of an output that grows while the command runs, so that only its end is compared: the file that says that it has begun. Empty: it does not grow.
    grows: &'static str,
}

const JOBS: [Job; 8] = [
    Job {
        name: "pictures",
        inputs: &[],
        before: "",
        arguments: "render two_element text:2 fine_texture:8 -o out --columns 64 --rows 64",
        again: "render two_element text:2 fine_texture:8 -o out --columns 64 --rows 64 --force",
        output: "out",
        timed: &["pictures.json"],
        grows: "",
    },
    Job {
        name: "pictures in place of others",
        inputs: &["old"],
        before: "old",
        arguments: "render two_element text:2 fine_texture:8 -o out --columns 64 --rows 64 --force",
        again: "render two_element text:2 fine_texture:8 -o out --columns 64 --rows 64 --force",
        output: "out",
        timed: &["pictures.json"],
        grows: "",
    },
    Job {
        name: "kernels",
        inputs: &[],
        before: "",
        arguments: "psf two_element -o out --fields 2 --rays 300",
        again: "psf two_element -o out --fields 2 --rays 300 --force",
        output: "out",
        timed: &[],
        grows: "",
    },
    Job {
        name: "kit",
        inputs: &["run"],
        before: "",
        arguments: "export run -o out",
        again: "export run -o out --force",
        output: "out",
        timed: &[],
        grows: "",
    },
    Job {
        name: "kit in place of another",
        inputs: &["run", "kit"],
        before: "kit",
        arguments: "export run -o out --force --f16",
        again: "export run -o out --force --f16",
        output: "out",
        timed: &[],
        grows: "",
    },
    Job {
        name: "design",
        inputs: &["task.toml"],
        before: "",
        arguments: "design task.toml -o out",
        again: "design --resume -o out",
        output: "out",
        timed: &["log.csv", "history.jsonl", "report.html"],
        grows: "task.toml",
    },
    Job {
        name: "training",
        inputs: &["task.toml"],
        before: "",
        arguments: "train task.toml -o out",
        again: "train --resume -o out",
        output: "out",
        timed: &["log.csv"],
        grows: "task.toml",
    },
    Job {
        name: "comparison",
        inputs: &["task.toml"],
        before: "",
        arguments: "compare task.toml --against cooke_triplet --steps 4 --fields 1 --patch 32 -o out",
        again: "compare task.toml --against cooke_triplet --steps 4 --fields 1 --patch 32 --resume -o out",
        output: "out",
        // Tasks name their lens by its whole path.
        timed: &[
            "comparison.html",
            "01-task/network/task.toml",
            "01-task/network/log.csv",
            "02-cooke_triplet/network/task.toml",
            "02-cooke_triplet/network/log.csv",
        ],
        grows: "compare.json",
    },
];

/// What the commands start from, made once.
fn made() -> Workplace {
    let place = Workplace::new();
    let design = SMALL_DESIGN.replace("steps = 90", "steps = 12").replace("checks = 3", "checks = 2");
    place.write("task.toml", design + TRAINING);
    place.run("render two_element dead_leaves:1 text:4 facades:2 -o old --columns 64 --rows 64").done();
    place.run("train task.toml -o run").done();
    place.run("export run -o kit").done();
    place
}

fn copy(from: &Path, to: &Path) {
    let done = Command::new("cp").arg("-a").arg(from).arg(to).status().expect("cp");
    assert!(done.success(), "{}", from.display());
}

/// A place with the inputs of a job, and what stood there before.
fn ready(job: &Job, made: &Workplace) -> Workplace {
    let place = Workplace::new();
    for input in job.inputs.iter().filter(|i| **i != job.before) {
        copy(&made.path(input), &place.path(input));
    }
    if !job.before.is_empty() {
        copy(&made.path(job.before), &place.path(job.output));
    }
    place
}

/// Every file of an output by name; of weights what stands behind their header, which says when.
fn contents(job: &Job, at: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut walk = vec![at.to_owned()];
    while let Some(path) = walk.pop() {
        if path.is_dir() {
            walk.extend(std::fs::read_dir(&path).expect("lists").flatten().map(|e| e.path()));
            continue;
        }
        let name = path.strip_prefix(at).expect("inside").to_string_lossy().into_owned();
        let bytes = if name.ends_with(".safetensors") {
            tensors(&path)
        } else if job.timed.contains(&name.as_str()) {
            Vec::new()
        } else {
            std::fs::read(&path).expect("reads")
        };
        found.insert(name, bytes);
    }
    found
}

/// The command under `strace`, on one thread, so that calls come in one order; what calls it makes goes to `log`.
fn traced(place: &Workplace, arguments: &str, calls: &str, fault: Option<&str>, log: &str) -> std::process::Output {
    let mut command = Command::new("strace");
    command.args(["-f", "-qq", "-o", log, "-e", &format!("trace={calls}")]);
    // Signals are not injected where calls are filtered.
    if fault.is_none_or(|f| f.starts_with("error")) {
        command.arg("--seccomp-bpf");
    }
    if let Some(fault) = fault {
        command.args(["-e", &format!("inject={calls}:{fault}")]);
    }
    command.arg(env!("CARGO_BIN_EXE_isoplanat")).args(arguments.split_whitespace()).current_dir(place.path("."));
    command.env("RAYON_NUM_THREADS", "1").stdout(Stdio::null()).stderr(Stdio::piped());
    command.output().expect("strace runs")
}

/// How often the busiest thread makes one of the calls.
fn counted(log: &Path) -> usize {
    let text = std::fs::read_to_string(log).expect("a log");
    let mut calls: HashMap<&str, usize> = HashMap::new();
    for line in text.lines().filter(|l| l.contains('(') && !l.contains("resumed>")) {
        *calls.entry(line.split_whitespace().next().unwrap_or("")).or_default() += 1;
    }
    calls.into_values().max().unwrap_or(0)
}

/// The first fault, in an order that does not change, where `FAULTS_FROM` says it: a long run can be made in parts.
fn from() -> usize {
    std::env::var("FAULTS_FROM").map_or(0, |text| text.parse().expect("FAULTS_FROM: a number"))
}

#[test]
#[ignore = "runs under strace"]
fn faults_at_each_call_leave_the_old_or_the_new() {
    if Command::new("strace").arg("-V").stdout(Stdio::null()).status().is_err() {
        eprintln!("skipped: no strace on this machine");
        return;
    }
    let made = made();
    let mut all = Vec::new();
    let mut references = Vec::new();
    for (j, job) in JOBS.iter().enumerate() {
        let mut reference = None;
        for (c, (_, calls)) in CALLS.iter().enumerate() {
            let place = ready(job, &made);
            let ran = traced(&place, job.arguments, calls, None, "calls");
            let log = place.path("calls");
            assert!(ran.status.success(), "{}: {}", job.name, String::from_utf8_lossy(&ran.stderr));
            let count = counted(&log);
            all.extend((0..FAULTS.len()).flat_map(|f| (1..=count).map(move |n| (j, c, f, n))));
            reference = Some(contents(job, &place.path(job.output)));
        }
        references.push(reference.expect("some calls"));
    }
    fastrand::Rng::with_seed(7).shuffle(&mut all);
    let most = repetitions(30, 1000);
    let possible = all.len();
    all.drain(..from().min(possible));
    all.truncate(most);
    let mut met = 0;
    for (done, (j, c, f, n)) in all.into_iter().enumerate() {
        // A run that is ended says how far it came.
        if done > 0 && done % 25 == 0 {
            eprintln!("{done} of {most} from {} on, all as they are to be", from());
        }
        let (job, (kind, calls), (what, fault)) = (&JOBS[j], CALLS[c], FAULTS[f]);
        let told = format!("{}: {what} at {kind} {n}", job.name);
        let place = ready(job, &made);
        let old = (!job.before.is_empty()).then(|| contents(job, &place.path(job.output)));
        let ran = traced(&place, job.arguments, calls, Some(&format!("{fault}:when={n}")), "/dev/null");
        met += usize::from(!ran.status.success());
        let stderr = String::from_utf8_lossy(&ran.stderr);
        assert!(!stderr.contains("panicked"), "{told}: {stderr}");
        let output = place.path(job.output);
        let there = output.symlink_metadata().is_ok();
        assert!(there || old.is_none(), "{told}: neither the old nor the new: {stderr}");
        if there && job.grows.is_empty() {
            let found = contents(job, &output);
            assert!(found == references[j] || old.as_ref() == Some(&found), "{told}: a mixture, {:?}", found.keys());
        }
        if ran.status.success() && job.grows.is_empty() {
            assert!(there && contents(job, &output) == references[j], "{told}: done without its result");
        }
        // A design or a training goes on where it has begun.
        let begun = if job.grows.is_empty() { there } else { output.join(job.grows).is_file() };
        place.run(if begun { job.again } else { job.arguments }).done();
        assert_eq!(
            contents(job, &output).keys().collect::<Vec<_>>(),
            references[j].keys().collect::<Vec<_>>(),
            "{told}"
        );
        for (name, bytes) in contents(job, &output) {
            assert!(bytes == references[j][&name], "{told}: {name} is another than without the fault");
        }
        let mut expected: Vec<&str> =
            job.inputs.iter().copied().filter(|i| *i != job.before).chain([job.output]).collect();
        expected.sort_unstable();
        assert_eq!(place.files(), expected, "{told}: leftovers");
    }
    eprintln!(
        "{most} of {possible} possible faults from {} on, {met} of them ended the run; all were mended by the next one",
        from()
    );
    assert!(met * 2 > most.min(possible), "{met}");
}
