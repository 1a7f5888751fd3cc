//! `isoplanat train`, killed and resumed: the folder always holds a training that goes on to the same bits.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{self, Workplace, repetitions};

const KILLS: [usize; 2] = [3, 20];

/// A training of some seconds: tiny network and discriminators, checkpoints all the time.
const TASK: &str = r#"
schema = 1
lens = "two_element"
sensor = { columns = 96, rows = 64, pitch_um = 200.0, axis_px = [0.0, 0.0] }
scenes = 2
[train]
base_width = 4
scales = 3
patch_px = 32
region_px = 48
pairs = 6
steps = 600
adversarial = true
discriminator_width = 2
checkpoint_seconds = 0.02
sample_steps = 200
"#;

fn train(arguments: &[&str], folder: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_isoplanat"))
        .arg("train")
        .args(arguments)
        .arg("-o")
        .arg(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts")
}

fn to_the_end(arguments: &[&str], folder: &Path) {
    let output = train(arguments, folder).wait_with_output().expect("ends");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Every tensor of a training's checkpoint.
fn tensors(folder: &Path) -> Vec<u8> {
    support::tensors(&folder.join("network.safetensors"))
}

/// When the last checkpoint was written.
fn written(folder: &Path) -> Option<std::time::SystemTime> {
    std::fs::metadata(folder.join("network.safetensors")).and_then(|m| m.modified()).ok()
}

/// The checkpoint as a file: its bytes, where there is one.
fn checkpoint(folder: &Path) -> Option<Vec<u8>> {
    std::fs::read(folder.join("network.safetensors")).ok()
}

#[test]
fn a_killed_training_ends_with_the_same_bits() {
    let most = repetitions(KILLS[0], KILLS[1]);
    let place = tempfile::tempdir().expect("a temporary folder");
    let task = place.path().join("task.toml");
    std::fs::write(&task, TASK).expect("writes");
    let task = task.to_str().expect("UTF-8");
    let (whole, killed) = (place.path().join("whole"), place.path().join("killed"));

    let clock = Instant::now();
    to_the_end(&[task], &whole);
    let whole_time = clock.elapsed();
    // A finished run that is resumed only starts up, and clears what a kill as the folder was put there has left beside it.
    let left = place.path().join(".whole.abcdefghijkl.lock");
    std::fs::write(&left, "").expect("writes");
    let clock = Instant::now();
    to_the_end(&["--resume"], &whole);
    let startup = clock.elapsed();
    assert!(!left.exists(), "a dead writer's");
    let work = whole_time.saturating_sub(startup);

    let rng = &mut fastrand::Rng::with_seed(20);
    let (mut kills, mut in_training, mut last) = (0, 0, None);
    while kills < most {
        let arguments = if killed.join("task.toml").is_file() { vec!["--resume"] } else { vec![task] };
        let mut child = train(&arguments, &killed);
        // Two of three lives end some time after their first checkpoint, however busy the machine; the others at any moment before.
        let before = written(&killed);
        let after_progress = kills % 3 != 0;
        let wait = |child: &mut Child, end: Instant, progress: bool| {
            while Instant::now() < end && child.try_wait().expect("waits").is_none() {
                if progress && written(&killed) != before {
                    break;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        if after_progress {
            wait(&mut child, Instant::now() + Duration::from_secs(60), true);
        }
        let life = if after_progress { work / 40 } else { startup };
        wait(&mut child, Instant::now() + life.mul_f64(rng.f64()), false);
        if child.try_wait().expect("waits").is_some() {
            let output = child.wait_with_output().expect("ended");
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            panic!("ended by itself after {kills} kills: the training is too short for this machine");
        }
        child.kill().expect("killed");
        child.wait().expect("reaped");
        kills += 1;
        // A kill met a training under way where that life has got further than the one before.
        let now = checkpoint(&killed);
        in_training += usize::from(now.is_some() && now != last);
        last = now;
    }
    assert!(in_training > most / 2, "only {in_training} kills met a training under way");
    to_the_end(&["--resume"], &killed);
    assert_eq!(tensors(&killed), tensors(&whole));
    let steps = |folder: &Path| -> Vec<String> {
        let text = std::fs::read_to_string(folder.join("log.csv")).expect("a log");
        text.lines().map(|l| l.split(',').next().unwrap_or("").to_owned()).collect()
    };
    assert_eq!(steps(&killed), steps(&whole));
    assert!(!killed.join("cache").exists(), "kept pairs go with the end");
    eprintln!(
        "{kills} kills, {in_training} of them during training; {whole_time:.1?} in one go, {startup:.1?} to start"
    );
}

#[cfg(unix)]
#[test]
fn an_interrupt_writes_a_checkpoint_and_says_how_to_go_on() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let task = place.path().join("task.toml");
    std::fs::write(&task, TASK.replace("checkpoint_seconds = 0.02", "checkpoint_seconds = 600")).expect("writes");
    let run = place.path().join("run");
    let mut child = train(&[task.to_str().expect("UTF-8")], &run);
    // Kept pairs appear with the first steps.
    let deadline = Instant::now() + Duration::from_secs(60);
    while !run.join("cache/0000000.f32").is_file() && Instant::now() < deadline {
        assert!(child.try_wait().expect("waits").is_none(), "ended early");
        std::thread::sleep(Duration::from_millis(2));
    }
    let signal = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
    assert!(signal.success());
    let output = child.wait_with_output().expect("ends");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{text}");
    assert!(text.contains("--resume") && text.contains("interrupted"), "{text}");
    assert!(run.join("log.csv").is_file(), "the checkpoint's log");
}

#[test]
fn bad_trainings_are_refused_with_one_line() {
    let place = Workplace::new();
    let refused = |task: &str, arguments: &str, what: &str| {
        place.write("task.toml", task);
        place.run(&format!("train {arguments} -o run")).refused(&[what]);
        assert_eq!(place.files(), ["task.toml"], "nothing is written");
    };
    refused(&TASK.replace("patch_px = 32", "patch_px = 33"), "task.toml", "train.patch_px");
    refused(&TASK.replace("steps = 600", "stepz = 600"), "task.toml", "stepz");
    refused(TASK, "task.toml --vgg nowhere.safetensors", "nowhere.safetensors");
    refused(TASK, "task.toml --start nowhere", "nowhere");
    refused(TASK, "--resume", "task.toml");
    if !cfg!(feature = "cuda") {
        refused(TASK, "task.toml --device cuda", "--features cuda");
    }
    assert_eq!(place.run("train task.toml -o run --device tpu").code, 2);
    assert_eq!(place.run("train -o run").code, 2);
}

/// Photographs in place of the task's scenes; the run keeps where they are, and a training that goes on has its own.
#[test]
fn photographs_are_named_on_the_command_line() {
    let place = Workplace::new();
    place.write("task.toml", TASK.replace("steps = 600", "steps = 2"));
    let photo = ndarray::Array3::from_shape_fn((3, 90, 120), |(k, r, c)| ((7 * k + r * c) % 23) as f32 / 23.0);
    std::fs::create_dir(place.path("photos")).expect("created");
    isoplanat::imaging::files::write_png8(&place.path("photos/a.png"), &photo).expect("written");
    let ran = place.run("train task.toml -o run --photos photos");
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("from 1 scenes") && ran.err.contains("2 steps of "), "{}", ran.err);
    let task = std::fs::read_to_string(place.path("run/task.toml")).expect("kept");
    let photos = place.path("photos").display().to_string();
    assert!(task.contains(&format!("photos = \"{photos}\"")), "{task}");
    place.run("train task.toml -o other --photos nowhere").refused(&["nowhere"]);
    place.run("train --resume -o run --photos photos").refused(&["--photos"]);
}
