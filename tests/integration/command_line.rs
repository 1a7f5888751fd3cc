//! What both programs make of their command lines, of signals, and of files that they may not write.

use std::ffi::OsStr;
use std::process::Command;

use crate::support::Workplace;

const LENS: &str = include_str!("../../models/lenses/cooke_triplet.toml");

/// No command overwrites what it reads, by whatever name; the input is as it was.
#[test]
fn inputs_are_not_overwritten() {
    let place = Workplace::new();
    place.write("lens.toml", LENS).write("table", LENS);
    std::fs::create_dir(place.path("scenes")).expect("made");
    place.run("render cooke_triplet text -o scenes/a.png --columns 48 --rows 32").done();
    let before = std::fs::read(place.path("scenes/a.png")).expect("there");
    for arguments in [
        "convert lens.toml lens.toml",
        "convert lens.toml none/../lens.toml",
        "convert lens.toml scenes/../lens.toml",
        "focus lens.toml --depth-mm 1000 -o lens.toml",
        "optimize lens.toml -o lens.toml",
        "optimize cooke_triplet --merit lens.toml -o lens.toml",
        "spot table --csv table",
        "inspect table --csv table",
        "render lens.toml scenes/a.png -o scenes/a.png",
        "render lens.toml scenes/a.png text -o scenes",
        "sheets scenes/a.png -o scenes",
    ] {
        place.run(&format!("{arguments} --force")).refused(&["read by the same command"]);
    }
    assert_eq!(std::fs::read_to_string(place.path("lens.toml")).expect("there"), LENS);
    assert_eq!(std::fs::read_to_string(place.path("table")).expect("there"), LENS);
    assert_eq!(std::fs::read(place.path("scenes/a.png")).expect("there"), before);
    place.run("convert lens.toml other.toml --force").done();
}

/// Endings of other forms are refused before the work, with those that are taken.
#[test]
fn endings_of_other_forms_are_refused_at_once() {
    let place = Workplace::new();
    for (arguments, allowed) in [
        ("psf cooke_triplet -o x.foo", ".npz"),
        ("capture cooke_triplet text -o x.raw", ".dng"),
        ("render cooke_triplet text -o x.gif", ".png"),
        ("mtf cooke_triplet --svg x.png", ".svg"),
        ("report cooke_triplet -o x.pdf", ".html"),
        ("convert cooke_triplet x.lens", ".zmx"),
    ] {
        place.run(arguments).refused(&["x.", allowed]);
    }
    assert!(place.files().is_empty());
}

/// Whatever is wrong with a command line is one line and exit code 2.
#[test]
fn a_wrong_command_line_is_one_line() {
    let place = Workplace::new();
    for (arguments, words) in [
        ("spot", "<LENS>"),
        ("spot cooke_triplet --depht-mm 5", "--depth-mm"),
        ("spot cooke_triplet --depth-mm far", "far"),
        ("spot cooke_triplet --depth-mm -5", "a positive distance"),
        ("spot cooke_triplet --depth-mm -1e-300", "a positive distance"),
        ("render cooke_triplet text -o x.png --depth-mm -5", "a positive distance"),
        ("capture cooke_triplet text -o x.dng --samples -4", "-4"),
        ("nothing", "'nothing'"),
        ("inspect cooke_triplet --wavelength-nm 1e300", "1e300; 200 to 20000 nm"),
    ] {
        place.run(arguments).refused(&[words]);
    }
    place
        .run_with_input(
            "trace cooke_triplet --rays -",
            r#"{"wavelength_nm": 550, "rays": [{"origin_mm": [0, 0, 1], "direction": [0, 0, 0]}]}"#,
        )
        .refused(&["rays[0].direction: 0, 0, 0; three finite numbers"]);
    let mut empty = place.command("inspect");
    let output = empty.arg("").output().expect("starts");
    assert!(String::from_utf8_lossy(&output.stderr).contains("an empty name"), "{output:?}");
}

/// Names are bytes: those that are no UTF-8 are files as all others.
#[cfg(target_os = "linux")]
#[test]
fn names_of_any_bytes_are_read() {
    use std::os::unix::ffi::OsStrExt;
    let place = Workplace::new();
    let name = OsStr::from_bytes(b"n\xff.toml");
    std::fs::write(place.path("").join(name), LENS).expect("writes");
    for arguments in ["inspect", "spot --rays 100", "check", "distortion", "view --export page.html"] {
        let output = place.command(arguments).arg(name).output().expect("starts");
        assert!(output.status.success(), "{arguments}: {output:?}");
    }
    // Outputs of any bytes, in results that name them.
    let (made, folder) = (OsStr::from_bytes(b"o\xff.dng"), OsStr::from_bytes(b"o\xff"));
    std::fs::create_dir(place.path("photos")).expect("made");
    place.run("render cooke_triplet text -o photos/a.png --columns 96 --rows 96").done();
    for (arguments, output) in [
        ("capture cooke_triplet text --columns 48 --rows 32", made),
        ("dataset cooke_triplet --photos photos --crop 32 --crops 1 --columns 48 --rows 48", folder),
    ] {
        let ran = place.command(&format!("{arguments} --json -o")).arg(output).output().expect("starts");
        assert!(ran.status.success(), "{arguments}: {ran:?}");
        let shown: serde_json::Value = serde_json::from_slice(&ran.stdout).expect("JSON");
        let name = shown["capture"].as_str().or(shown["dataset"].as_str()).expect("a name");
        assert!(name.starts_with("o\u{fffd}"), "{name}");
    }
    let missing = place.command("inspect").arg(OsStr::from_bytes(b"m\xff.toml")).output().expect("starts");
    let told = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(missing.status.code() == Some(2) && told.lines().count() == 1 && told.contains("m\u{fffd}.toml"), "{told}");
}

/// A file that may not grow is an error of its writing, and leaves nothing.
#[cfg(target_os = "linux")]
#[test]
fn a_file_that_may_not_grow_is_told() {
    let place = Workplace::new();
    place.run_with_small_files("psf cooke_triplet -o x.npz --fields 2 --rays 200", 1).refused(&["x.npz: writing"]);
    assert!(place.files().is_empty(), "{:?}", place.files());
}

/// The first signal ends a program whose work does not listen, with the signal's code, and what it was writing is cleared away.
#[cfg(target_os = "linux")]
#[test]
fn signals_end_a_program_and_leave_nothing() {
    for (signal, code) in [("INT", 130), ("TERM", 143), ("HUP", 129)] {
        let place = Workplace::new();
        let scenes = "text:1 text:2 text:3 text:4 text:5 text:6 text:7 text:8";
        let arguments = format!("render cooke_triplet {scenes} -o many --columns 1600 --rows 1200 --everything");
        let mut child = place.command(&arguments).stderr(std::process::Stdio::null()).spawn().expect("starts");
        let begun = || place.files().iter().any(|n| n.ends_with(".partial"));
        for _ in 0..600 {
            if begun() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        assert!(begun(), "{:?}", place.files());
        let sent = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().expect("starts");
        assert!(sent.success());
        assert_eq!(child.wait().expect("ends").code(), Some(code), "{signal}");
        assert!(place.files().is_empty(), "{signal}: {:?}", place.files());
    }
}

/// `--quiet` leaves notes and progress out; results and warnings stay.
#[test]
fn quiet_leaves_notes_out() {
    let place = Workplace::new();
    let of = |arguments: &str| {
        let ran = place.run(arguments);
        assert_eq!(ran.code, 0, "{ran:?}");
        (ran.out, ran.err)
    };
    let (told, notes) = of("convert cooke_triplet a.zmx");
    assert!(notes.contains("note: a.zmx: a Zemax file states no sensor"), "{notes}");
    assert_eq!(of("convert cooke_triplet a.zmx --force --quiet"), (told, String::new()));
    let (told, notes) = of("spot a.zmx");
    assert!(notes.contains("note: a.zmx: no sensor is stated"), "{notes}");
    assert_eq!(of("-q spot a.zmx"), (told, String::new()));
    let (_, notes) = of("render cooke_triplet text -o a.png --columns 48 --rows 32");
    assert!(
        notes.contains("done in") && notes.contains("see the middle of the sensor, 1 % of its diagonal"),
        "{notes}"
    );
    assert_eq!(of("render -q cooke_triplet text -o b.png --columns 48 --rows 32").1, "");
    // A warning is no note.
    let (_, doubt) = of("distortion cooke_triplet --fields-deg 5 --quiet");
    assert!(doubt.starts_with("warning: ") && doubt.lines().count() == 1, "{doubt}");
}
