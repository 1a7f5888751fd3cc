//! Small files and arguments that ask for more than there is, or speak to a terminal: one line, exit code 2, little time and memory, nothing written.

use std::process::Command;

use isoplanat::testing::shared;

use crate::support::Workplace;

/// Seconds of processor time, and KiB of addresses, that a refusal may take.
const LIMITS: (u32, u32) = (10, 4 << 20);

fn refused(place: &Workplace, arguments: &str, expected: &[&str]) {
    let (seconds, kib) = LIMITS;
    place.run_limited(arguments, seconds, kib).refused(expected);
    let left: Vec<String> = place.files().into_iter().filter(|f| f.contains("x.")).collect();
    assert!(left.is_empty(), "{arguments}: {left:?}");
}

#[test]
fn arguments_without_bounds_are_refused_at_once() {
    let place = Workplace::new();
    for texels in ["inf", "nan", "0", "-1", "1e300"] {
        let arguments =
            format!("render two_element text:1 -o x.png --columns 16 --rows 12 --texels-per-pixel={texels}");
        refused(&place, &arguments, &["--texels-per-pixel"]);
    }
    for pitch in ["1e-9", "inf", "0", "1e30"] {
        let arguments = format!("render two_element text:1 -o x.png --columns 16 --rows 12 --pitch-um={pitch}");
        refused(&place, &arguments, &["pitch_um"]);
    }
    for (arguments, told) in [
        ("optimize two_element -o x.toml --search 18446744073709551615", "--search"),
        ("optimize two_element -o x.toml --constraint focal_length=nan", "focal_length: NaN to NaN"),
        ("optimize two_element -o x.toml --constraint focal_length=nan..60", "focal_length: NaN to 60"),
        ("optimize two_element -o x.toml --bound surface[*].thickness=5..1", "surface[*].thickness: 5 to 1"),
        ("optimize two_element -o x.toml --target focal_length=nan@1", "focal_length: NaN"),
        ("render no_such_lens text:1 -o x.gif", "`.gif`"),
    ] {
        refused(&place, arguments, &[told]);
    }
    // More wavelengths than any file states; a folder of glasses without one.
    let two = include_str!("../../models/lenses/two_element.toml");
    let many = |what: &str, one: &str| format!("{what} = [{}]", vec![one; 101].join(", "));
    let waves = two.replace("nm = [486.1327, 587.5618, 656.2725]", &many("nm", "550.0"));
    place.write("waves.toml", waves.replace("weights = [1.0, 1.0, 1.0]", &many("weights", "1.0")));
    refused(&place, "spot waves.toml", &["waves.toml", "101 wavelengths", "at most 100"]);
    std::fs::create_dir(place.path("none")).expect("made");
    refused(&place, "inspect two_element --glass none", &["none", "no catalogue"]);
}

#[cfg(feature = "deploy")]
#[test]
fn threads_without_bound_are_refused() {
    let place = Workplace::new();
    for threads in ["1025", "18446744073709551615", "-1"] {
        let (code, _, err) = camera(&place, &["--kit", "none", "x.dng", &format!("--threads={threads}")]);
        assert!(code == 2 && err.contains("threads"), "{code} {err}");
    }
}

#[test]
fn files_that_promise_more_than_they_hold_are_refused() {
    let Some(folder) = shared("cases/hostile") else { return };
    let place = Workplace::new();
    let at = |name: &str| folder.join(name).display().to_string();
    for picture in ["png-65535-abort/hdr_65535.png", "png-65535-abort/huge.jpg"] {
        let file = at(picture);
        for arguments in [
            format!("render two_element {file} -o x.png --columns 32 --rows 24"),
            format!("capture two_element {file} -o x.dng --columns 32 --rows 24"),
            format!("accuracy two_element {file} --columns 32 --rows 24 -o x.html"),
            format!("slanted-edge {file}"),
        ] {
            // By what its pixels need, or by what the picture needs that is made of them.
            refused(&place, &arguments, &["memory", "pixels", "needed"]);
        }
    }
    let aliases = at("yaml-aliases/alias.yml");
    refused(&place, &format!("inspect two_element --glass {aliases}"), &["alias.yml", "anchors and aliases"]);
    #[cfg(feature = "train")]
    refused(&place, &format!("design {} --check --memory-gib 1", at("design-pitch-memory/p9.toml")), &["pitch_um"]);
}

/// A page of a glass without anchors is read as before, with `&` and `*` in its texts.
#[test]
fn pages_of_glasses_may_have_any_text() {
    let place = Workplace::new();
    place.write(
        "own.yml",
        "REFERENCES: \"A & B, *the* paper\"\nCOMMENTS: 'a & b'\nDATA:\n  - type: formula 5\n    wavelength_range: 0.3 2.0\n    coefficients: 1.5\n",
    );
    let ran = place.run("inspect two_element --glass own.yml");
    assert_eq!(ran.code, 0, "{}", ran.err);
    place.write("shared.yml", "DATA: &a\n  - type: formula 5\n    wavelength_range: 0.3 2.0\n    coefficients: 1.5\n");
    place.run("inspect two_element --glass shared.yml").refused(&["shared.yml", "anchors"]);
}

/// The program of the camera in the folder, under the same limits.
#[cfg(feature = "deploy")]
fn camera(place: &Workplace, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new("sh");
    let (seconds, kib) = LIMITS;
    let limits = format!("ulimit -t {seconds} && ulimit -v {kib} && exec \"$0\" \"$@\"");
    command
        .arg("-c")
        .arg(limits)
        .arg(env!("CARGO_BIN_EXE_isoplanat-camera"))
        .args(arguments)
        .current_dir(place.path(""));
    let output = command.output().expect("starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (output.status.code().unwrap_or(-1), text(output.stdout), text(output.stderr))
}

/// Steps a terminal would take.
fn steering(text: &str) -> bool {
    text.chars().any(|c| c.is_control() && c != '\n' && c != '\t')
}

#[cfg(feature = "deploy")]
#[test]
fn a_distortion_far_from_its_frame_is_refused() {
    let Some(folder) = shared("cases/hostile") else { return };
    let place = Workplace::new();
    let file = folder.join("distortion-centre/distortion.toml");
    let capture = folder.join("seeds/small.dng");
    let text = std::fs::read_to_string(&file).expect("reads");
    for centre in ["999999999.0", "48000000.0", "-97.0", "193.0"] {
        place.write("distortion.toml", text.replace("999999999.0", centre));
        let capture = capture.display().to_string();
        let (code, out, err) = camera(&place, &[&capture, "--distortion", "distortion.toml", "-o", "x.png"]);
        let told = err.lines().filter(|l| l.contains("centre_px") && l.contains("distortion.toml")).count();
        assert!(code == 2 && out.is_empty() && told == 1, "{code} {err}");
    }
    assert_eq!(place.files(), ["distortion.toml"]);
}

#[test]
fn names_in_files_do_not_steer_a_terminal() {
    let Some(folder) = shared("cases/hostile/terminal-escape") else { return };
    let place = Workplace::new();
    for arguments in ["inspect", "check", "spot", "lenses"] {
        let ran = place.run(&format!("{arguments} {}", folder.join("esc.toml").display()));
        assert!(!steering(&ran.out) && !steering(&ran.err), "{arguments}: {:?} {:?}", ran.out, ran.err);
        assert!(ran.code == 0 && (ran.out.contains("\\u001b") || arguments != "inspect"), "{arguments}: {:?}", ran.out);
    }
    // JSON stays JSON, and says what the file says.
    let text = std::fs::read_to_string(folder.join("esc.toml")).expect("reads");
    let name = text.lines().find_map(|l| l.strip_prefix("name = ")).expect("a name");
    place.write("turned.toml", text.replacen(name, r#""a\u202eb\u007f\u009b""#, 1));
    let said = place.run("inspect turned.toml --json").done();
    let json: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert!(!steering(&said) && json["name"] == "a\u{202e}b\u{7f}\u{9b}", "{said:?}");
    place.run(&format!("lenses {} -o d", folder.join("csv.toml").display())).done();
    let csv = std::fs::read_to_string(place.path("d/lenses.csv")).expect("written");
    let line = csv.lines().nth(1).expect("a lens");
    assert!(line.contains("'=HYPERLINK") && line.contains("'+1+1"), "{line}");
    #[cfg(feature = "deploy")]
    {
        let capture = folder.join("esc.dng").display().to_string();
        let (code, out, err) = camera(&place, &[&capture, "-o", "y.png"]);
        assert!(code == 0 && !steering(&out) && !steering(&err), "{code} {out:?} {err:?}");
    }
}

/// What could not be printed is an error; a reader that has gone away is none.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_told() {
    let place = Workplace::new();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("there");
    let mut command = place.command("inspect cooke_triplet");
    let output = command.stdout(full).output().expect("runs");
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.starts_with("error: standard output: ") && said.lines().count() == 1, "{said}");
    let mut command = Command::new("sh");
    command.arg("-c").arg("\"$0\" inspect cooke_triplet | true; echo ${PIPESTATUS:-0}");
    let output = command.arg(env!("CARGO_BIN_EXE_isoplanat")).output().expect("runs");
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Where an estimate is too low, or there is none, the system's refusal is one line too, and `--memory-gib` is held by the system.
#[cfg(target_os = "linux")]
#[test]
fn refused_memory_is_one_line() {
    let place = Workplace::new();
    let arguments = "render two_element text:1 -o x.png --columns 2000 --rows 1500 --pitch-um 6";
    let mut seen = 0;
    // From what is too little to start with to what is enough.
    for mib in [150, 200, 300, 450, 700, 4000] {
        let ran = place.run_limited(&format!("{arguments} --force"), 600, mib << 10);
        if ran.code == 0 {
            continue;
        }
        assert!(
            ran.code == 2 && ran.err.lines().filter(|l| l.starts_with("error: ")).count() == 1,
            "{mib} MiB: {ran:?}"
        );
        seen += usize::from(ran.err.contains("memory"));
    }
    assert!(seen > 0, "no limit was met");
    place.run(&format!("{arguments} --memory-gib 4 --force")).done();
}

/// A picture that is not there is said not to be there, not to be a built-in scene's name.
#[test]
fn a_missing_picture_is_told() {
    let place = Workplace::new();
    for name in ["none.png", "none/none.JPG", "none.npy"] {
        let ran = place.run(&format!("render two_element {name} -o x.png"));
        assert!(ran.code == 2 && ran.err.contains(name) && ran.err.contains("no such file"), "{name}: {ran:?}");
    }
    place.run("render two_element cats -o x.png").refused(&["cats", "facades"]);
}

/// Names with ends of line and with what has no width stand within their line, in tables and headings.
#[cfg(unix)]
#[test]
fn names_stay_within_their_line() {
    let place = Workplace::new();
    place.run("convert two_element plain.toml").done();
    let text = std::fs::read_to_string(place.path("plain.toml")).expect("reads");
    let renamed = |line: &str| {
        let own = if line.starts_with("name = ") { r#"name = "a\nb\u2028c\u200bd\ufeff""# } else { line };
        format!("{own}\n")
    };
    let file = "x\ny.toml";
    place.write(file, text.lines().map(renamed).collect::<String>());
    for command in ["inspect", "lenses", "check"] {
        let said = place.command(command).arg(file).output().expect("runs");
        let out = String::from_utf8(said.stdout).expect("UTF-8");
        assert!(said.status.success(), "{command}: {}", String::from_utf8_lossy(&said.stderr));
        assert!(out.contains(r"a\u000ab\u2028c\u200bd\ufeff"), "{command}: {out}");
        assert!(!out.contains(['\u{2028}', '\u{200b}', '\u{feff}']), "{command}: {out}");
        assert!(command != "lenses" || (out.contains(r"x\u000ay") && out.lines().count() == 2), "{command}: {out}");
    }
}
