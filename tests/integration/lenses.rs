//! `isoplanat lenses`: what it lists, writes and leaves out.

use serde_json::json;

use crate::support::{Workplace, read_json};

/// Table, JSON and folder hold every shipped lens; a file from the folder is the lens of that name; nothing foreign is replaced.
#[test]
fn lenses_lists_and_writes_the_shipped_lenses() {
    let place = Workplace::new();
    let text = place.run("lenses").done();
    let json = read_json(&place.run("lenses -o all --json --csv all.csv").done());
    let list = json["lenses"].as_array().expect("list");
    assert_eq!(list.len(), isoplanat::lens::builtin::LENSES.len());
    for (entry, (name, toml)) in list.iter().zip(isoplanat::lens::builtin::LENSES) {
        assert_eq!(entry["name"], json!(name));
        assert!(text.lines().any(|l| l.starts_with(name)), "{name}: {text}");
        let inspected = read_json(&place.run(&format!("inspect all/{name}.toml --json")).done());
        for key in ["effective_focal_length_mm", "back_focal_length_mm", "f_number", "length_mm", "sha256"] {
            assert_eq!(entry[key], inspected[key], "{name} {key}");
        }
        assert_eq!(std::fs::read_to_string(place.path(&format!("all/{name}.toml"))).expect("reads"), toml);
        let svg = std::fs::read_to_string(place.path(&format!("all/{name}.svg"))).expect("reads");
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{name}");
    }
    let page = std::fs::read_to_string(place.path("all/index.html")).expect("reads");
    assert_eq!(page.matches("<svg").count(), list.len());
    let csv = std::fs::read_to_string(place.path("all.csv")).expect("reads");
    assert_eq!(csv.lines().count(), list.len() + 1);
    place.run("lenses -o all").refused(&["all", "--force"]);
    place.run("lenses --csv all.csv").refused(&["all.csv", "--force"]);
    std::fs::write(place.path("all/mine.txt"), "x").expect("writes");
    // What is not ours is named, and stays.
    place.run("lenses -o all --force").refused(&["all", "mine.txt"]);
    std::fs::remove_file(place.path("all/mine.txt")).expect("still there");
    place.run("lenses -o all --force").done();
    // A folder that this command did not write stays.
    std::fs::create_dir(place.path("foreign")).expect("a folder");
    std::fs::write(place.path("foreign/index.html"), "x").expect("writes");
    place.run("lenses -o foreign --force").refused(&["foreign"]);
    assert_eq!(place.files(), ["all", "all.csv", "foreign"]);
}

/// A shell that stands in an empty folder keeps it; another empty folder is as good as none.
#[test]
fn the_folder_one_stands_in_is_not_replaced() {
    let place = Workplace::new();
    place.run("lenses cooke_triplet -o .").refused(&[".: output: the folder that the program was started in"]);
    assert_eq!(place.files(), [""; 0]);
    std::fs::create_dir(place.path("all")).expect("made");
    place.run("lenses cooke_triplet -o all").done();
    assert!(place.path("all/cooke_triplet.toml").is_file());
}

/// A folder of files with some that cannot be read: the others are listed, each of these has its line, and the run says that it is not all.
#[test]
fn lenses_leaves_out_what_cannot_be_read() {
    let place = Workplace::new();
    place.write("no.toml", "schema = 1");
    let ran = place.run("lenses cooke_triplet no.toml none.zmx two_element -o all --json");
    assert_eq!(ran.code, 2, "{ran:?}");
    let lines: Vec<&str> = ran.err.lines().collect();
    assert_eq!(lines.len(), 3, "{ran:?}");
    let json = read_json(&ran.out);
    let names: Vec<_> = json["lenses"].as_array().expect("list").iter().map(|l| l["name"].clone()).collect();
    assert_eq!(names, ["cooke_triplet", "two_element"]);
    for (k, file) in ["no.toml", "none.zmx"].into_iter().enumerate() {
        let why = json["left_out"][k].as_str().expect("a sentence");
        assert!(why.starts_with(file) && lines[k] == format!("left out: {why}"), "{lines:?}");
    }
    assert_eq!(lines[2], "error: lenses: 2 of 4 left out; the others are listed");
    assert!(place.path("all/two_element.svg").is_file());
    // Where there is nothing to list it is an ordinary refusal.
    place.run("lenses no.toml").refused(&["no.toml"]);
    place.run("lenses no.toml none.zmx -o none").refused(&["no.toml"]);
    assert_eq!(place.files(), ["all", "no.toml"]);
}
