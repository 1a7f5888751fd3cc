//! Every command answers to the same flags: `--json`, and `--force` where it writes files.

use serde_json::Value;

use crate::support::{Workplace, root};

/// Commands of this build, from the program's own help.
fn commands(place: &Workplace) -> Vec<String> {
    let help = place.run("--help").done();
    let listed = help.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.trim().is_empty());
    let names = listed.filter(|l| !l.contains("(needs the feature")).filter_map(|l| l.split_whitespace().next());
    names.filter(|n| *n != "help").map(str::to_owned).collect()
}

/// The line of `--help` that starts with an option, and whether it is there.
fn has(help: &str, option: &str) -> bool {
    help.lines().any(|l| l.split([' ', ',']).any(|word| word == option) && l.trim_start().starts_with('-'))
}

#[test]
fn every_command_has_help_json_and_force() {
    let place = Workplace::new();
    let commands = commands(&place);
    assert!(commands.len() >= 7, "{commands:?}");
    for command in &commands {
        let help = place.run(&format!("{command} --help")).done();
        assert!(help.contains(&format!("isoplanat {command}")), "{help}");
        for option in ["--json", "--force", "--memory-gib", "--help"] {
            assert!(has(&help, option), "{command} {option}:\n{help}");
        }
        // What prints rows of a table writes them as well.
        let analyses = ["mtf", "spot", "distortion", "report", "slanted-edge", "calibrate", "calibrate-sensor"];
        let rows = ["inspect", "lenses", "check", "psf", "accuracy", "evaluate", "tolerance"]
            .contains(&command.as_str())
            || analyses.contains(&command.as_str());
        assert_eq!(has(&help, "--csv"), rows, "{command} --csv");
        assert_eq!(place.run(&format!("{command} --frobnicate")).code, 2, "{command}");
    }
}

/// A command is found: in the table of the README and on a page of the manual.
#[test]
fn every_command_stands_in_readme_and_manual() {
    let page = |path: &str| std::fs::read_to_string(root().join(path)).expect("a page");
    let table: String = page("README.md").lines().filter(|l| l.starts_with("| `isoplanat")).collect();
    let manual: String = std::fs::read_dir(root().join("docs"))
        .expect("a manual")
        .flatten()
        .filter(|e| e.path().extension().is_some_and(|end| end == "md"))
        .map(|e| std::fs::read_to_string(e.path()).expect("a page"))
        .collect();
    for command in commands(&Workplace::new()) {
        assert!(
            [format!("`{command}`"), format!("`isoplanat {command}`")].iter().any(|c| table.contains(c)),
            "{command} in the README"
        );
        let named = format!("isoplanat {command}");
        let ends = |rest: &str| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '-');
        assert!(manual.split(&named).skip(1).any(ends), "{named} in docs/");
    }
}

/// Commands that take long, or ask for more than a lens: the tests that run them.
const ELSEWHERE: [(&str, &str); 15] = [
    ("accuracy", "memory"),
    ("calibrate", "calibrate"),
    ("calibrate-sensor", "calibrate_sensor"),
    ("compare", "comparing"),
    ("dataset", "dataset"),
    ("demo", "cli"),
    ("design", "designing"),
    ("evaluate", "runs"),
    ("export", "runs"),
    ("sheets", "sheets"),
    ("slanted-edge", "slanted_edge"),
    ("sweep", "designing"),
    ("tolerance", "tolerance"),
    ("train", "runs"),
    ("view", "view"),
];

/// One JSON object on stdout, whatever the command; files appear where they are named, and are not overwritten. A new command has a line here.
#[test]
fn json_is_one_object_and_files_need_force() {
    let place = Workplace::new();
    let ray = r#"{"wavelength_nm": 550.0, "rays": [{"origin_mm": [0.0, 0.2, -5.0], "direction": [0, 0, 1]}]}"#;
    place.write("rays.json", ray);
    let frame = "--columns 24 --rows 16 --pitch-um 60";
    let psf = "--fields 2 --size 9 --pitch-um 30 --rays 100";
    let lines = [
        ("inspect cooke_triplet --csv s.csv".to_owned(), vec!["s.csv"]),
        ("lenses --csv l.csv".to_owned(), vec!["l.csv"]),
        ("check cooke_triplet --csv f.csv".to_owned(), vec!["f.csv"]),
        ("trace cooke_triplet --rays rays.json".to_owned(), vec![]),
        ("optimize cooke_triplet -o o.toml --svg o.svg".to_owned(), vec!["o.toml", "o.svg"]),
        (format!("psf cooke_triplet -o k.npz --csv k.csv {psf}"), vec!["k.npz", "k.csv"]),
        (format!("render cooke_triplet text -o a.png --min-psnr-db 30 {frame}"), vec!["a.png"]),
        (format!("capture cooke_triplet text -o a.dng --samples 2 {frame}"), vec!["a.dng"]),
        ("mtf cooke_triplet --csv m.csv --svg m.svg --npz m.npz".to_owned(), vec!["m.svg", "m.csv", "m.npz"]),
        ("spot cooke_triplet --csv p.csv --svg p.svg --npz p.npz".to_owned(), vec!["p.svg", "p.csv", "p.npz"]),
        ("distortion cooke_triplet --csv d.csv --svg d.svg".to_owned(), vec!["d.svg", "d.csv"]),
        ("report cooke_triplet -o r.html".to_owned(), vec!["r.html"]),
        ("convert cooke_triplet c.zmx".to_owned(), vec!["c.zmx"]),
        ("focus cooke_triplet --depth-mm 1000 -o f.toml".to_owned(), vec!["f.toml"]),
    ];
    for command in commands(&place) {
        let here = lines.iter().any(|(line, _)| line.split(' ').next() == Some(&*command));
        assert!(here != ELSEWHERE.iter().any(|(c, _)| *c == command), "a line for {command}, here or of another test");
    }
    let help = place.run("--help").done();
    for command in lines.iter().filter_map(|(line, _)| line.split(' ').next()).chain(ELSEWHERE.map(|(c, _)| c)) {
        assert!(help.lines().any(|l| l.split_whitespace().next() == Some(command)), "{command} in {help}");
    }
    for (_, file) in ELSEWHERE {
        assert!(root().join(format!("tests/integration/{file}.rs")).is_file(), "{file}");
    }
    for (command, files) in lines {
        let text = place.run(&format!("{command} --json")).done();
        let value: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{command}: {e}: {text}"));
        assert!(value.is_object(), "{command}: {value}");
        for file in &files {
            assert!(place.path(file).is_file(), "{command}: {file}");
        }
        if let Some(first) = files.first() {
            place.run(&command).refused(&[first, "--force"]);
            place.run(&format!("{command} --force")).done();
        }
        for csv in files.iter().filter(|f| f.ends_with(".csv")) {
            let text = std::fs::read_to_string(place.path(csv)).expect("written");
            let columns: Vec<usize> = text.lines().map(|l| l.split(',').count()).collect();
            // Curves are points; tables have more.
            let curves = text.starts_with("plot,series,x,y\n");
            assert!(columns.len() > 2 && (curves || columns[0] > 4), "{text}");
        }
    }
    // Rays have one form.
    let plain = place.run("trace cooke_triplet --rays rays.json").done();
    assert_eq!(place.run("trace cooke_triplet --rays rays.json --json").done(), plain);
}
