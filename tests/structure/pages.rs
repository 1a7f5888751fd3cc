//! README and manual as texts: their links lead somewhere, the checks that they name are there, and the README stays one that people finish.

use crate::manual::{pages, text};
use crate::root;

/// Pages, pictures and files that are linked are there.
#[test]
fn links_lead_somewhere() {
    let mut count = 0;
    for page in pages(root()) {
        let text = text(&page);
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let file = link.split('#').next().unwrap_or(link);
            if file.is_empty() || file.contains("://") {
                continue;
            }
            let at = page.parent().expect("a folder").join(file);
            assert!(at.exists(), "{}: {link}", page.display());
            count += 1;
        }
    }
    assert!(count > 40, "{count}");
}

/// What `docs/checks.md` names as the test of a figure is one: a function of a test, or a module of code or tests.
#[test]
fn checks_name_tests_that_are_there() {
    let mut names = std::collections::BTreeSet::new();
    let mut folders = ["src", "crates", "tests/integration"].map(|f| root().join(f)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder").flatten().map(|e| e.path()) {
            if entry.is_dir() {
                names.extend(entry.file_name().map(|n| n.to_string_lossy().into_owned()));
                folders.push(entry);
            } else if entry.extension().is_some_and(|e| e == "rs") {
                names.extend(entry.file_stem().map(|n| n.to_string_lossy().into_owned()));
                let code = text(&entry);
                let begins = ["fn ", "mod "].into_iter().flat_map(|word| code.split(word).skip(1));
                let word =
                    |rest: &str| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().map(str::to_owned);
                names.extend(begins.filter_map(word));
            }
        }
    }
    let page = text(&root().join("docs/checks.md"));
    let mut count = 0;
    for row in page.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| what |")) {
        for name in row.split('|').nth(2).expect("three cells").split('`').skip(1).step_by(2) {
            let there = if name.contains(['/', '.']) {
                root().join(name.split(' ').next().expect("a word")).exists()
            } else {
                name.split("::").all(|part| names.contains(part))
            };
            assert!(there, "{name} in {row}");
            count += 1;
        }
    }
    assert!(count > 60, "{count}");
    let decisions = std::fs::read_dir(root().join("docs/decisions")).expect("decisions").flatten();
    let index = text(&root().join("docs/decisions/README.md"));
    for name in decisions.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|n| n != "README.md") {
        assert!(index.contains(&format!("({name})")), "{name} is not in the index");
    }
}

/// At most 180 lines and 12 kB, paragraphs of at most 60 words, cells of at most 15.
#[test]
fn the_readme_is_one_that_people_finish() {
    let readme = text(&root().join("README.md"));
    let [lines, bytes] = [readme.lines().count(), readme.len()];
    assert!(lines <= 180 && bytes <= 12_000, "{lines} lines of 180, {bytes} bytes of 12,000");
    let words = |t: &str| t.split_whitespace().count();
    let mut in_block = false;
    for line in readme.lines() {
        in_block ^= line.starts_with("```");
        if in_block {
            continue;
        }
        if line.starts_with('|') {
            let long = line.split('|').find(|cell| words(cell) > 15);
            assert_eq!(long, None, "a long cell");
        } else {
            assert!(words(line) <= 60, "{} words: {line}", words(line));
        }
    }
}
