//! Every reader of both programs with bad files of each kind: one line that begins with the file's name, says where, what was found and what is allowed.

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
    // What is told while work goes on, before the fault is met, is no refusal.
    let other = |line: &str| {
        line.starts_with("note: ")
            || line.ends_with(" …")
            || line.contains(" done in ")
            || line.contains(": no --kit: ")
    };
    let lines: Vec<&str> = err.lines().filter(|line| !other(line)).collect();
    let [line] = lines[..] else { panic!("{what}: one line: {err:?}") };
    let said = line.strip_prefix("error: ").or_else(|| line.strip_prefix("isoplanat-camera: ")).unwrap_or(line);
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
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"));
    let output = command.args(arguments.split_whitespace()).current_dir(place.path("")).output().expect("runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let what = format!("isoplanat-camera {arguments} ({what})");
    told(output.status.code(), &text(&output.stdout), &text(&output.stderr), file, &what);
}

/// Readers of one file: its name, and the arguments that read it.
const READERS: [(&str, &str); 30] = [
    ("a.toml", "inspect a.toml"),
    ("a.zmx", "inspect a.zmx"),
    ("a.seq", "inspect a.seq"),
    ("a.json", "inspect a.json"),
    ("a.txt", "inspect a.txt"),
    ("a.toml", "check a.toml"),
    ("a.toml", "spot a.toml"),
    ("a.toml", "convert a.toml x.zmx"),
    ("a.toml", "focus a.toml --depth-mm 900 -o x.toml"),
    ("a.toml", "report cooke_triplet a.toml -o x.html"),
    ("a.toml", "view a.toml --export x.html"),
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
    ("a.toml", "tolerance two_element --tolerances a.toml"),
    ("a.toml", "sheets two_element -o x --tolerances a.toml"),
    ("a.toml", "optimize two_element -o x.toml --merit a.toml"),
    ("a.json", "trace two_element --rays a.json"),
    ("a.agf", "inspect two_element --glass a.agf"),
];

#[test]
fn no_reader_takes_garbage_and_each_names_its_file() {
    let place = Workplace::new();
    for (kind, bytes) in GARBAGE {
        for (file, arguments) in READERS {
            // What an optimiser is told may be left out, all of it.
            if kind != "nothing" || !arguments.contains("--merit") {
                place.write(file, bytes);
                refuses(&place, arguments, file, kind);
                std::fs::remove_file(place.path(file)).expect("removed");
            }
            refuses(&place, arguments, file, "not there");
        }
    }
    assert_eq!(place.files(), Vec::<String>::new(), "nothing is written");
}

/// A board that cannot be read is left out with a warning that names it.
#[cfg(feature = "calibrate")]
#[test]
fn charts_are_named() {
    let place = Workplace::new();
    for (kind, bytes) in GARBAGE {
        place.write("a.png", bytes);
        let ran = place.run("calibrate a.png -o x.toml");
        let named = ran.err.lines().filter(|line| line.starts_with("warning: left out: a.png: picture: ")).count();
        assert!(ran.code == 2 && named == 1 && ran.err.contains("error: CHART: "), "{kind}: {ran:?}");
    }
    assert_eq!(place.files(), ["a.png"], "nothing is written");
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
        place.write("a.dng", bytes);
        refuses(&place, "calibrate-sensor --darks a.dng a.dng --flats a.dng a.dng -o x.toml", "a.dng", kind);
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

/// A task, and the folder of a run whose parts are bad one after the other.
#[cfg(feature = "train")]
#[test]
fn readers_of_tasks_and_runs_name_their_files() {
    use isoplanat::network::{Reconstructor, UnetConfig};

    let place = Workplace::new();
    std::fs::create_dir(place.path("run")).expect("made");
    let task = std::fs::read_to_string(root().join("models/tasks/lfov-paper.toml")).expect("reads");
    let lens = std::fs::read_to_string(root().join("models/kits/lfov-paper/lens.toml")).expect("reads");
    let network = Reconstructor::new(UnetConfig::bare(1, 1), 1).expect("valid");
    for (kind, bytes) in GARBAGE {
        place.write("a.toml", bytes);
        for arguments in ["design a.toml --check", "train a.toml -o x", "sweep a.toml --index 0 --of 2 -o x"] {
            refuses(&place, arguments, "a.toml", kind);
        }
        let readers = ["evaluate run", "export run -o x", "report run --measure 2 -o x.html"];
        place.write("run/task.toml", bytes).write("run/lens.toml", &lens);
        for arguments in readers.iter().chain(&["train run -o x", "design --resume -o run"]) {
            refuses(&place, arguments, "run/task.toml", kind);
        }
        place.write("run/task.toml", &task).write("run/network.safetensors", bytes);
        for arguments in readers {
            refuses(&place, arguments, "run/network.safetensors", kind);
        }
        network.save(&place.path("run/network.safetensors")).expect("writes");
        place.write("run/lens.toml", bytes);
        for arguments in readers.iter().chain(&["train run -o x"]) {
            refuses(&place, arguments, "run/lens.toml", kind);
        }
    }
    assert_eq!(place.files(), ["a.toml", "run"], "nothing is written");
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
    place.run("convert two_element two.zmx").done();
    place.run("convert two_element two.seq").done();
    let [zmx, seq] = ["two.zmx", "two.seq"].map(|name| std::fs::read_to_string(place.path(name)).expect("reads"));
    for (file, text, said) in [
        ("a.toml", at("thickness_mm", "-5.0"), "surface[0].thickness_mm: -5; "),
        ("a.toml", at("radius_mm", "0.0"), "surface[0].radius_mm: 0; "),
        ("a.toml", at("radius_mm", "11.0"), "surface[0].semi_diameter_mm: 12; "),
        ("a.toml", at("semi_diameter_mm", "1e9"), "surface[0].semi_diameter_mm: 1000000000; "),
        ("a.toml", at("medium", "\"NBK77\""), "surface[0].medium: unknown glass `NBK77`; "),
        ("a.toml", toml.replace("rows = 512", "rows = 0"), "sensor: 4096 columns × 0 rows; "),
        ("a.toml", toml.replace("nm = [486.1327,", "nm = [1.0,"), "wavelengths.nm: 1; "),
        ("a.toml", at("schema", "7"), "schema: 7; "),
        ("a.zmx", zmx.replacen("CURV 0.0", "CURV x", 1), "line 20 (SURF 1): `x5405405405405406`; "),
        ("a.zmx", zmx.replacen("TYPE STANDARD", "TYPE WAVY", 2), "line 14 (SURF 0): a surface of type WAVY; "),
        ("a.seq", seq.replacen("\nS 0.05405405405405406", "\nS x", 1), "line 17: `x`; "),
        // What shows only when all is put together has the place in the file before that in the lens.
        ("a.zmx", zmx.replacen("DISZ 8\n", "DISZ 1e8\n", 1), "line 18 (SURF 1): surface[0].thickness_mm: 100000000; "),
        (
            "a.seq",
            seq.replacen("\nS 0.05405405405405406 8 ", "\nS 0.05405405405405406 1e8 ", 1),
            "line 17 (S 1): surface[0].thickness_mm: 100000000; ",
        ),
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
    let toml = std::fs::read_to_string(root().join("models/lenses/cooke_triplet.toml")).expect("reads");
    let name = toml.lines().find(|line| line.starts_with("name = ")).expect("a name");
    let named = toml.replacen(name, "name = \"another name\"", 1);
    let line = toml.lines().find(|line| line.starts_with("wavelengths = ")).expect("wavelengths");
    let infrared = "wavelengths = { nm = [900.0, 950.0], weights = [1.0, 1.0], primary_nm = 950.0 }";
    place.write("red.toml", named.replacen(line, infrared, 1));
    place.write("tilted.toml", named.replacen("semi_diameter_mm", "tilt_deg = [1.0, 0.0, 0.0]\nsemi_diameter_mm", 1));
    for arguments in [
        "render F text:1 -o x.png --columns 16 --rows 12",
        "render F text:1 -o x.png --columns 16 --rows 12 --method monte-carlo",
        "capture F text:1 -o x.dng --columns 16 --rows 12",
        "accuracy F text:1 -o x.html --columns 16 --rows 12",
        "psf F -o x.npz --png x.png",
        "report F -o x.html --measure 2",
    ] {
        refuses(&place, &arguments.replace('F', "red.toml"), "red.toml", "infrared");
    }
    for arguments in ["psf F -o x.npz", "convert F x.zmx", "sheets F -o x", "report F -o x.html --measure 1"] {
        refuses(&place, &arguments.replace('F', "tilted.toml"), "tilted.toml", "a tilt");
    }
    assert_eq!(place.files(), ["red.toml", "tilted.toml"], "nothing is written");
}

/// An aperture a thousandth of what was meant: pictures are not black, with exit code 0.
#[test]
fn a_lens_without_light_on_the_axis_makes_no_picture() {
    let place = Workplace::new();
    let text = std::fs::read_to_string(root().join("models/lenses/cooke_triplet.toml")).expect("the lens");
    let at = text.rfind("semi_diameter_mm = ").expect("a clear aperture");
    let line = text[at..].lines().next().expect("a line");
    place.write("tiny.toml", text.replacen(line, "semi_diameter_mm = 0.0079", text.matches(line).count()).into_bytes());
    let frame = "--columns 24 --rows 24 --pitch-um 900";
    let ran = place.run(&format!("render tiny.toml facades:3 -o t.npy {frame}"));
    assert!(ran.code == 2 && ran.err.contains("tiny.toml: semi_diameter: no ray that was tried"), "{}", ran.err);
    assert!(!place.path("t.npy").exists());
}
