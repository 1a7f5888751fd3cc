//! Every reader of both programs with bad files of each kind: one line that begins with the file's name, says where, what was found and what is allowed.

use std::process::Command;

use crate::support::{Workplace, root};

/// What no reader takes: nothing, words, an end in the middle, bytes that are no text.
const GARBAGE: [(&str, &[u8]); 4] = [
    ("nothing", b""),
    ("words", b"no such thing here\n"),
    ("broken", b"schema = [1\n"),
    ("bytes", b"\xff\xfe\x9d\x00\x01\x80"),
];

/// The one line of a refusal names `file` first; behind it stand found and allowed, or the system's reason.
fn told(code: Option<i32>, out: &str, err: &str, file: &str, what: &str) {
    assert_eq!((code, out), (Some(2), ""), "{what}: {err}");
    let lines: Vec<&str> = err.lines().filter(|line| !line.starts_with("note: ")).collect();
    let [line] = lines[..] else { panic!("{what}: one line: {err:?}") };
    let said = line.strip_prefix("error: ").unwrap_or(line);
    let Some(rest) = said.strip_prefix(file).and_then(|rest| rest.strip_prefix(": ")) else {
        panic!("{what}: `{file}` is not named first: {line}")
    };
    let (found, allowed) = rest.split_once("; ").or_else(|| rest.split_once("reading: ")).unwrap_or_default();
    assert!(!allowed.is_empty() && (!found.is_empty() || rest.starts_with("reading: ")), "{what}: {line}");
    // A place that nobody knows is left out, and no sentence begins with its sign.
    assert!(!rest.starts_with([':', ';', ' ']) && !rest.contains(": : ") && !rest.contains("; ;"), "{what}: {line}");
}

/// `isoplanat arguments`, which reads the bad `file`.
fn refuses(place: &Workplace, arguments: &str, file: &str, what: &str) {
    let output = place.command(arguments).output().expect("runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let what = format!("isoplanat {arguments} ({what})");
    told(output.status.code(), &text(&output.stdout), &text(&output.stderr), file, &what);
}

/// `isoplanat-camera arguments`, which reads the bad `file`.
#[cfg(feature = "deploy")]
fn camera_refuses(place: &Workplace, arguments: &str, file: &str, what: &str) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"));
    let output = command.args(arguments.split_whitespace()).current_dir(place.path("")).output().expect("runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let what = format!("isoplanat-camera {arguments} ({what})");
    told(output.status.code(), &text(&output.stdout), &text(&output.stderr), file, &what);
}

/// Readers of one file: its name, and the arguments that read it.
const READERS: [(&str, &str); 27] = [
    ("a.toml", "inspect a.toml"),
    ("a.zmx", "inspect a.zmx"),
    ("a.seq", "inspect a.seq"),
    ("a.json", "inspect a.json"),
    ("a.txt", "inspect a.txt"),
    ("a.toml", "convert a.toml -o x.zmx"),
    ("a.toml", "focus a.toml --depth-mm 900 -o x.toml"),
    ("a.toml", "report cooke_triplet a.toml -o x.html"),
    ("a.toml", "psf a.toml -o x.npz"),
    ("a.toml", "render a.toml text:1 -o x.png"),
    ("a.toml", "accuracy a.toml text:1 -o x.html"),
    ("a.toml", "optimize a.toml -o x.toml"),
    ("a.toml", "sheets a.toml -o x"),
    ("a.toml", "lenses a.toml -o x"),
    ("a.yml", "inspect two_element --glass a.yml"),
    ("a.png", "render two_element a.png -o x.png --columns 16 --rows 12"),
    ("a.jpg", "render two_element a.jpg -o x.png --columns 16 --rows 12"),
    ("a.tif", "render two_element a.tif -o x.png --columns 16 --rows 12"),
    ("a.npy", "capture two_element a.npy -o x.dng --columns 16 --rows 12"),
    ("a.png", "slanted-edge a.png"),
    ("a.npy", "slanted-edge a.npy"),
    ("a.toml", "capture two_element text:1 -o x.dng --columns 16 --rows 12 --calibration a.toml"),
    ("a.toml", "tolerance two_element a.toml"),
    ("a.toml", "sheets two_element -o x --tolerances a.toml"),
    ("a.toml", "optimize two_element -o x.toml --spec a.toml"),
    ("a.json", "trace two_element --rays a.json"),
    ("a.toml", "render two_element text:1 -o x.png --columns 16 --rows 12 --calibration a.toml"),
];

#[test]
fn no_reader_takes_garbage_and_each_names_its_file() {
    let place = Workplace::new();
    for (kind, bytes) in GARBAGE {
        for (file, arguments) in READERS {
            // Tolerances and targets may be left out, each and all.
            let optional = ["tolerance", "--tolerances", "--spec"].iter().any(|word| arguments.contains(word));
            if kind == "nothing" && optional {
                continue;
            }
            place.write(file, bytes);
            refuses(&place, arguments, file, kind);
            std::fs::remove_file(place.path(file)).expect("removed");
            refuses(&place, arguments, file, "not there");
        }
        // A catalogue without a glass is one.
        place.write("a.agf", bytes);
        if kind != "nothing" {
            refuses(&place, "inspect two_element --glass a.agf", "a.agf", kind);
        }
    }
    assert_eq!(place.files(), ["a.agf"], "nothing is written");
}

#[cfg(feature = "calibrate")]
#[test]
fn charts_are_named() {
    let place = Workplace::new();
    for (kind, bytes) in GARBAGE {
        place.write("a.png", bytes);
        let arguments = "calibrate a.png -o x.toml";
        refuses(&place, arguments, "a.png", kind);
    }
}

#[cfg(feature = "deploy")]
#[test]
fn the_cameras_readers_name_their_files() {
    let place = Workplace::new();
    let kit = root().join("models/kits/lfov-30-free");
    std::fs::create_dir(place.path("kit")).expect("made");
    let parts = ["kit.toml", "model.onnx", "filters.npz"];
    let fresh = || parts.iter().for_each(|part| drop(std::fs::copy(kit.join(part), place.path("kit").join(part))));
    for (kind, bytes) in GARBAGE {
        for file in ["a.dng", "a.nef", "a.png", "a.tif", "a.npy"] {
            place.write(file, bytes);
            camera_refuses(&place, &format!("{file} -o x.png"), file, kind);
            std::fs::remove_file(place.path(file)).expect("removed");
        }
        place.write("a.toml", bytes).write("a.dng", "");
        for option in ["--distortion", "--shading"] {
            camera_refuses(&place, &format!("a.dng {option} a.toml -o x.png"), "a.toml", kind);
        }
        for frames in ["--darks a.dng a.dng --flats a.dng a.dng", "--darks a.dng --flats a.dng"] {
            refuses(&place, &format!("calibrate-sensor {frames} -o x.toml"), "a.dng", kind);
        }
        for part in parts {
            fresh();
            place.write(&format!("kit/{part}"), bytes);
            camera_refuses(&place, "--kit kit --show-kit", &format!("kit/{part}"), kind);
            std::fs::remove_file(place.path("kit").join(part)).expect("removed");
            camera_refuses(&place, "--kit kit --show-kit", &format!("kit/{part}"), "not there");
        }
    }
    assert_eq!(place.files(), ["a.dng", "a.toml", "kit"], "nothing is written");
}

/// The folder of a run whose parts are bad one after the other.
#[cfg(feature = "train")]
#[test]
fn readers_of_runs_and_tasks_name_their_files() {
    let place = Workplace::new();
    for (kind, bytes) in GARBAGE {
        place.write("a.toml", bytes);
        for arguments in ["design a.toml --check", "train a.toml -o x", "sweep a.toml --runs 2 --index 0 -o x"] {
            if arguments.starts_with("sweep") {
                continue;
            }
            refuses(&place, arguments, "a.toml", kind);
        }
        for measured in ["psf.npz", "distortion.toml"] {
            let _ = std::fs::remove_dir_all(place.path("lens"));
            std::fs::create_dir(place.path("lens")).expect("made");
            place.write(&format!("lens/{measured}"), bytes);
            if measured == "psf.npz" {
                place.write("b.toml", std::fs::read_to_string(root().join("models/tasks/edof.toml")).expect("reads"));
            }
        }
        let _ = std::fs::remove_dir_all(place.path("run"));
        std::fs::create_dir(place.path("run")).expect("made");
        let readers = ["evaluate run", "export run -o x", "report run --measure 2 -o x.html", "train run -o x"];
        place.write("run/task.toml", bytes).write("run/lens.toml", "");
        for arguments in readers {
            let file = if arguments.starts_with("report") { "run/lens.toml" } else { "run/task.toml" };
            refuses(&place, arguments, file, kind);
        }
        let task = std::fs::read_to_string(root().join("models/tasks/lfov-paper.toml")).expect("reads");
        place.write("run/task.toml", task).write("run/lens.toml", bytes);
        for arguments in &readers[..3] {
            refuses(&place, arguments, "run/lens.toml", kind);
        }
        let lens = std::fs::read_to_string(root().join("models/kits/lfov-paper/lens.toml")).expect("reads");
        place.write("run/lens.toml", lens).write("run/network.safetensors", bytes);
        for arguments in &readers[..3] {
            refuses(&place, arguments, "run/network.safetensors", kind);
        }
    }
}

/// A value that is wrong in a file that is right: the line names its place.
#[test]
fn values_are_named_with_their_places() {
    let place = Workplace::new();
    let toml = std::fs::read_to_string(root().join("models/lenses/two_element.toml")).expect("reads");
    let at = |key: &str, value: &str| {
        let from = toml.find(&format!("\n{key} = ")).expect("a key") + 1;
        let end = from + toml[from..].find('\n').expect("a line");
        format!("{}{key} = {value}{}", &toml[..from], &toml[end..])
    };
    place.write("two.zmx", "").write("two.seq", "");
    for form in ["zmx", "seq"] {
        place.run(&format!("convert two_element -o two.{form} --force")).done();
    }
    let [zmx, seq] = ["two.zmx", "two.seq"].map(|name| std::fs::read_to_string(place.path(name)).expect("reads"));
    for (file, text, said) in [
        ("a.toml", at("thickness_mm", "-5.0"), "surface[0].thickness_mm: -5; "),
        ("a.toml", at("radius_mm", "0.0"), "surface[0].radius_mm: 0; "),
        ("a.toml", at("semi_diameter_mm", "1e9"), "surface[0].semi_diameter_mm: 1000000000; "),
        ("a.toml", at("medium", "\"NBK77\""), "surface[0].medium: unknown glass `NBK77`; "),
        ("a.toml", at("rows", "0"), "sensor: "),
        ("a.toml", at("nm", "[1.0]"), "wavelengths"),
        ("a.toml", at("schema", "7"), "schema"),
        ("a.zmx", zmx.replacen("CURV ", "CURV x", 1), "line "),
        ("a.zmx", zmx.replacen("TYPE STANDARD", "TYPE WAVY", 2), "line "),
        ("a.seq", seq.replacen("\nS ", "\nS x", 1), "line "),
    ] {
        place.write(file, &text);
        for arguments in [format!("inspect {file}"), format!("render {file} text:1 -o x.png --columns 16 --rows 12")] {
            let output = place.command(&arguments).output().expect("runs");
            let err = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(err.contains(&format!("error: {file}: {said}")), "{arguments}: `{said}` in {err}");
            refuses(&place, &arguments, file, said);
        }
    }
}

/// What shows only when rays are traced, or pictures made, names the file as well, not what the lens calls itself.
#[test]
fn later_work_names_the_file_of_its_lens() {
    let place = Workplace::new();
    let toml = std::fs::read_to_string(root().join("models/lenses/two_element.toml")).expect("reads");
    let name = toml.lines().find_map(|line| line.strip_prefix("name = ")).expect("a name").to_owned();
    let rays = "--rays 100";
    // Surfaces in the infrared alone; glass that is a table there.
    let nm = toml.lines().find(|line| line.starts_with("nm = ")).expect("wavelengths");
    let primary = toml.lines().find(|line| line.starts_with("primary_nm = ")).expect("a wavelength");
    let infrared = toml.replace(nm, "nm = [900.0, 950.0, 1000.0]").replace(primary, "primary_nm = 950.0");
    place.write("a.toml", infrared.replacen(&name, "\"another name\"", 1));
    for arguments in [
        "render a.toml text:1 -o x.png --columns 16 --rows 12".to_owned(),
        format!("capture a.toml text:1 -o x.dng --columns 16 --rows 12 {rays}").replace(&format!(" {rays}"), ""),
        "accuracy a.toml text:1 -o x.html --columns 16 --rows 12".to_owned(),
    ] {
        refuses(&place, &arguments, "a.toml", "infrared");
    }
    assert_eq!(place.files(), ["a.toml"]);
}
