//! The camera's child processes: limits without a shell, sandbox, what is told of them; kits that point out of their files; memory of the program itself.

use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use isoplanat::deploy::child::Helper;
use isoplanat::deploy::raw_process;
use isoplanat::math::memory::{GIB, Limit};
use isoplanat::testing::shared;

use crate::support::Workplace;

fn camera(place: &Workplace, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"));
    command.args(arguments).current_dir(place.path(""));
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A capture of the virtual camera, 96 × 64 pixels.
fn capture(place: &Workplace) {
    place.run("capture two_element facades:3 -o a.dng --columns 96 --rows 64 --pitch-um 200 --samples 4").done();
}

/// What Linux is asked to hold a child to and says that it does, with nothing on the path: no shell is there to set it.
#[cfg(target_os = "linux")]
#[test]
fn children_are_held_without_a_shell() {
    let place = Workplace::new();
    capture(&place);
    let output = camera(&place, &["a.dng", "-o", "a.png", "--json"])
        .env_clear()
        .env("PATH", "/nonexistent")
        .output()
        .expect("starts");
    assert!(output.status.success(), "{}", said(&output));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let children = &json["pictures"][0]["children"];
    assert!(children["network"].is_null());
    let decoder = &children["decoder"];
    let memory = decoder["memory_bytes"].as_u64().expect("a limit");
    assert!(memory > 0 && memory <= 2 * GIB && decoder["processor_s"].as_u64().is_some_and(|s| s > 0), "{decoder}");
    assert_eq!(decoder["no_new_privs"], true, "{decoder}");
    assert!(decoder["landlock_abi"].is_u64() || decoder["landlock_abi"].is_null(), "{decoder}");
    assert!(decoder["seccomp"].is_boolean(), "{decoder}");
}

/// The same by the kernel's own word, of a decoder that is at work: limits of `/proc`, mode 2 (filters), no new rights.
#[cfg(target_os = "linux")]
#[test]
fn the_kernel_says_the_same() {
    let Some(file) = shared("cases/hostile/camera-memory/tiles_20k.dng") else { return };
    let place = Workplace::new();
    let file = file.display().to_string();
    let mut program = camera(&place, &[&file, "-o", "x.png"])
        .env_clear()
        .env("PATH", "/nonexistent")
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("starts");
    let parent = program.id();
    let began = Instant::now();
    let mut seen = None;
    while seen.is_none() && began.elapsed() < Duration::from_secs(30) && program.try_wait().expect("asks").is_none() {
        seen = std::fs::read_dir("/proc").expect("lists").flatten().find_map(|entry| held(&entry.path(), parent));
        std::thread::sleep(Duration::from_millis(2));
    }
    let _ = program.kill();
    let _ = program.wait();
    let (limits, status) = seen.expect("a decoder behind its sandbox");
    let limit = |name: &str| {
        let line = limits.lines().find(|l| l.starts_with(name)).expect("a line").to_owned();
        let numbers: Vec<u64> = line[name.len()..].split_whitespace().filter_map(|w| w.parse().ok()).collect();
        numbers
    };
    let memory = limit("Max address space");
    assert!(memory.len() == 2 && memory[0] == memory[1] && memory[0] <= 2 * GIB, "{limits}");
    assert_eq!(limit("Max core file size"), [0, 0], "{limits}");
    let processor = limit("Max cpu time");
    assert!(processor.len() == 2 && processor[0] == processor[1], "{limits}");
    assert!(status.contains("NoNewPrivs:\t1"), "{status}");
}

/// Limits and status of a process, if it is a decoder of `parent` that has entered its sandbox.
#[cfg(target_os = "linux")]
fn held(process: &Path, parent: u32) -> Option<(String, String)> {
    let read = |name: &str| std::fs::read(process.join(name)).ok().map(|b| String::from_utf8_lossy(&b).into_owned());
    let (command, status) = (read("cmdline")?, read("status")?);
    let ours = command.contains(raw_process::COMMAND) && status.contains(&format!("PPid:\t{parent}\n"));
    let inside = status.contains("NoNewPrivs:\t1");
    (ours && inside).then_some((read("limits")?, status))
}

/// A frame beyond the program's memory is refused before the memory is taken: by its decoder, or for the picture that its samples make.
#[test]
fn frames_beyond_the_memory_are_refused() {
    let Some(folder) = shared("cases/hostile/camera-memory") else { return };
    let place = Workplace::new();
    for (file, gib, words) in [
        ("tiles_18k.dng", "1", ["the decoder broke off", "more than 1.0 GiB of memory"]),
        ("tiles_18k.dng", "3", ["18000 × 18000 pixels", "needed; at most 3.0 GiB here (--memory-gib)"]),
        ("tiles_jxl.dng", "2", ["16000 × 16000 pixels", "needed; at most 2.0 GiB here (--memory-gib)"]),
    ] {
        let path = folder.join(file).display().to_string();
        let output = camera(&place, &[&path, "-o", "x.png", "--memory-gib", gib]).output().expect("starts");
        let told = said(&output);
        let lines: Vec<&str> = told.lines().filter(|l| l.contains(file)).collect();
        assert!(output.status.code() == Some(2) && lines.len() == 1, "{file}: {:?} {told}", output.status);
        assert!(words.iter().all(|w| lines[0].contains(w)), "{file}: {told}");
    }
    assert!(place.files().is_empty());
    let output = camera(&place, &["a.dng", "--memory-gib", "0"]).output().expect("starts");
    assert!(output.status.code() == Some(2) && said(&output).contains("--memory-gib"), "{}", said(&output));
}

/// Weights that lie outside of the model's file are refused by file and tensor, however the file points there.
#[test]
fn kits_that_point_out_of_their_files_are_refused() {
    let (Some(folder), Some(capture)) =
        (shared("cases/hostile/kit-sparse-external"), shared("cases/hostile/seeds/small.dng"))
    else {
        return;
    };
    let place = Workplace::new();
    // What the file points to lies where a runtime would look for it.
    std::fs::copy(folder.join("secret.bin"), place.path("secret.bin")).expect("copies");
    for kit in ["sparse_rel", "sparse_up"] {
        let (kit, capture) = (folder.join(kit).display().to_string(), capture.display().to_string());
        let output = camera(&place, &[&capture, "--kit", &kit, "-o", "o.png"]).output().expect("starts");
        let told = said(&output);
        assert_eq!(output.status.code(), Some(2), "{told}");
        assert!(told.lines().count() == 1 && told.contains("model.onnx") && told.contains("secret.bin"), "{told}");
        assert!(told.contains("sparse_initializer `encoder.0.conv1.bias`"), "{told}");
    }
    assert_eq!(place.files(), ["secret.bin"]);
}

/// A caller of the library is no program of ours: it names one. What is none is one sentence.
#[test]
fn a_caller_of_the_library_names_the_program() {
    let place = Workplace::new();
    capture(&place);
    let memory = Limit { bytes: GIB };
    let file = place.path("a.dng");
    for program in [env!("CARGO_BIN_EXE_isoplanat-camera"), env!("CARGO_BIN_EXE_isoplanat")] {
        let (capture, held) = raw_process::decode(&Helper::at(program), &file, memory).expect("decodes");
        assert_eq!(capture.size(), (64, 96));
        assert_eq!(held.memory_bytes.is_some(), cfg!(target_os = "linux"), "{held:?}");
        assert_eq!(capture, isoplanat::deploy::raw::decode(&file).expect("decodes"));
    }
    let error = raw_process::decode(&Helper::at(place.path("none")), &file, memory).expect_err("no program");
    assert!(
        error.to_string().contains("none") && error.to_string().contains("starting it") && error.exit_code() == 2,
        "{error}"
    );
}
