//! What a user names is written whole, once, and in nothing's place unless he says so.

use std::collections::HashSet;

use crate::support::Workplace;

/// One of four simultaneous pictures gets the name that all of them want; the others say that it is taken.
#[test]
fn one_of_four_renders_gets_a_new_name() {
    let place = Workplace::new();
    for output in ["new.png", "new.npz"] {
        let arguments = match output {
            "new.png" => {
                "render two_element fine_texture:8 -o new.png --columns 96 --rows 64 --method monte-carlo --samples 4"
            }
            _ => "psf two_element -o new.npz --fields 2 --rays 200",
        };
        let runs: Vec<_> = (0..4)
            .map(|_| {
                let mut command = place.command(arguments);
                command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::piped());
                command.spawn().expect("starts")
            })
            .collect();
        let ends: Vec<_> = runs.into_iter().map(|run| run.wait_with_output().expect("ends")).collect();
        let mut codes: Vec<_> = ends.iter().map(|end| end.status.code()).collect();
        codes.sort_unstable();
        assert_eq!(codes, [Some(0), Some(2), Some(2), Some(2)], "{ends:?}");
        for end in ends.iter().filter(|end| !end.status.success()) {
            assert!(String::from_utf8_lossy(&end.stderr).contains(output), "{end:?}");
        }
    }
    assert_eq!(place.files(), ["new.npz", "new.png"]);
}

/// Scenes of one name, and one that has the name which numbers would give, are as many pictures as scenes.
#[test]
fn scenes_of_one_name_lose_no_picture() {
    let place = Workplace::new();
    for folder in ["p", "q", "rr"] {
        std::fs::create_dir(place.path(folder)).expect("made");
    }
    let scene = "render two_element fine_texture:8 -o p/a.png --columns 64 --rows 64";
    place.run(scene).done();
    for other in ["q/a.png", "rr/001-a.png"] {
        std::fs::copy(place.path("p/a.png"), place.path(other)).expect("copied");
    }
    let told = place
        .run("render two_element p/a.png q/a.png rr/001-a.png text:2 text:2 -o out --columns 64 --rows 64 --json")
        .done();
    let told: serde_json::Value = serde_json::from_str(&told).expect("JSON");
    let named: HashSet<&str> =
        told["pictures"].as_array().expect("a list").iter().filter_map(|p| p["picture"].as_str()).collect();
    let pictures = std::fs::read_dir(place.path("out")).expect("there").flatten();
    let there: Vec<String> =
        pictures.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|n| n.ends_with(".png")).collect();
    assert_eq!((named.len(), there.len()), (5, 5), "{named:?} {there:?}");
    assert!(there.iter().all(|n| named.contains(n.as_str())), "{named:?} {there:?}");
}

/// A pipe is written into, with `--force` and without; it stays a pipe.
#[cfg(unix)]
#[test]
fn pipes_and_devices_stay_what_they_are() {
    use std::os::unix::fs::FileTypeExt;
    let place = Workplace::new();
    let pipe = place.path("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    for force in ["", "--force"] {
        let at = pipe.clone();
        let reader = std::thread::spawn(move || std::fs::read_to_string(at).expect("reads"));
        place.run(&format!("inspect two_element --csv pipe {force}")).done();
        assert!(reader.join().expect("read").contains("surface"));
        assert!(std::fs::metadata(&pipe).expect("there").file_type().is_fifo());
        place.run(&format!("inspect two_element --csv /dev/null {force}")).done();
        assert!(std::fs::metadata("/dev/null").expect("there").file_type().is_char_device());
    }
    assert_eq!(place.files(), ["pipe"]);
}

/// What cannot be written is refused before the work: here a trace of a lens that is not there comes second.
#[test]
fn places_where_nothing_can_be_written_are_refused_first() {
    let place = Workplace::new();
    place.write("there.csv", "kept");
    let long = "n".repeat(300);
    for (output, named) in [("there.csv", "there.csv"), ("none/a.csv", "none"), (long.as_str(), "nnn"), (".", ".")] {
        place.run(&format!("inspect no_such_lens --csv {output}")).refused(&[named]);
    }
    place.run("psf no_such_lens -o a --csv ./a").refused(&["a: output", "two outputs"]);
    assert_eq!(place.files(), ["there.csv"]);
    assert_eq!(std::fs::read_to_string(place.path("there.csv")).expect("reads"), "kept");
}

/// Outputs of one command that are one place, or one inside of the other, are refused before any work: files and folders alike.
#[test]
fn outputs_of_one_command_are_apart() {
    let place = Workplace::new();
    for (arguments, named) in [
        ("lenses cooke_triplet -o both --csv both", &["both: output: named for two outputs"][..]),
        ("lenses cooke_triplet -o ./both --csv both --force", &["both: output: named for two outputs"]),
        (
            "tolerance cooke_triplet --tolerances no.toml --lenses d.csv --csv d.csv",
            &["d.csv: output: named for two outputs"],
        ),
        ("optimize cooke_triplet -o o.toml --search 3 --best o.toml", &["o.toml: output: named for two outputs"]),
        (
            "lenses cooke_triplet -o all --csv all/lenses.csv",
            &["all/lenses.csv: output: lies in all, another output", "outside"],
        ),
        (
            "optimize cooke_triplet -o best/o.toml --search 3 --best best",
            &["best/o.toml: output: lies in best, another output"],
        ),
    ] {
        place.run(arguments).refused(named);
        assert!(place.files().is_empty(), "{arguments}: {:?}", place.files());
    }
}

/// What cannot be printed is no success, and a file where a folder is to be is named as that.
#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_put_out_is_told() {
    let place = Workplace::new();
    for arguments in ["--help", "--version", "inspect --help"] {
        let full = std::fs::File::options().write(true).open("/dev/full").expect("opens");
        let said = place.command(arguments).stdout(full).output().expect("runs");
        let err = String::from_utf8_lossy(&said.stderr);
        assert_eq!(said.status.code(), Some(1), "{arguments}: {err}");
        assert!(err.starts_with("error: standard output: ") && err.lines().count() == 1, "{arguments}: {err}");
    }
    place.write("file", "kept");
    for force in ["", "--force"] {
        place.run(&format!("lenses cooke_triplet -o file {force}")).refused(&["file: output: a file stands there"]);
    }
    assert_eq!(std::fs::read_to_string(place.path("file")).expect("reads"), "kept");
}

/// Where nobody can be told, the work goes on.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_ends_nothing() {
    let place = Workplace::new();
    let mut command = place.command("render two_element text:1 -o a.png --columns 64 --rows 64");
    let full = std::fs::File::options().write(true).open("/dev/full").expect("opens");
    let status = command.stdout(std::process::Stdio::null()).stderr(full).status().expect("runs");
    assert!(status.success(), "{status}");
    assert_eq!(place.files(), ["a.png"]);
}
