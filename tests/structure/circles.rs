//! Files that use each other in a circle, inside modules too.

use std::collections::{BTreeMap, BTreeSet};

use crate::layering::{code, own_sources, spelled};

type Graph = BTreeMap<String, BTreeSet<String>>;

/// Paths that `text` names behind `crate` and `super`, from the module `at`.
fn named(text: &str, at: &[&str]) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for start in ["crate::", "super::"] {
        for (i, _) in text.match_indices(start) {
            let before = &text[..i];
            // `super::super::x` is read from its first `super`.
            if before.ends_with(|c: char| c.is_alphanumeric() || c == '_') || before.ends_with("::") {
                continue;
            }
            let mut rest = &text[i..];
            let mut base = at;
            while let Some(behind) = rest.strip_prefix("super::") {
                (rest, base) = (behind, &base[..base.len().saturating_sub(1)]);
            }
            if let Some(behind) = rest.strip_prefix("crate::") {
                (rest, base) = (behind, &[]);
            }
            for path in spelled(rest) {
                let names = path.split("::").map(str::to_owned);
                found.push(base.iter().map(|s| (*s).to_owned()).chain(names).collect());
            }
        }
    }
    found
}

/// Which file's module uses which of its crate; not what a file has of the modules around it, nor they of it. Between crates there is no circle: cargo
/// refuses it.
fn graph() -> Graph {
    let mut crates: BTreeMap<String, BTreeMap<Vec<String>, String>> = BTreeMap::new();
    for (path, text) in own_sources() {
        // `crates/optics/src/lens.rs`, `src/design/mod.rs`; the program's commands are a crate of their own.
        let (of, inside) = path.split_once("src/").expect("below a crate's `src`");
        let (of, inside) =
            inside.strip_prefix("commands/").map_or((of.to_owned(), inside), |i| (format!("{of}commands/"), i));
        let name = inside.trim_end_matches(".rs").trim_end_matches("/mod");
        let parts: Vec<String> = name.split('/').map(str::to_owned).collect();
        if !parts.iter().any(|p| p.starts_with("test")) {
            let text = code(&text);
            let end = text.find("#[cfg(test)]\nmod tests").unwrap_or(text.len());
            crates.entry(of).or_default().insert(parts, text[..end].to_owned());
        }
    }
    let mut graph = Graph::new();
    for (of, files) in &crates {
        for (at, text) in files {
            let base: Vec<&str> = at.iter().map(String::as_str).collect();
            let uses = graph.entry(format!("{of}{}", at.join("::"))).or_default();
            for path in named(text, &base) {
                let known = (1..=path.len()).rev().find(|n| files.contains_key(&path[..*n])).map(|n| &path[..n]);
                if let Some(other) = known.filter(|o| !o.starts_with(at) && !at.starts_with(o)) {
                    uses.insert(format!("{of}{}", other.join("::")));
                }
            }
        }
    }
    graph
}

/// All that can be reached from `from`.
fn reached(graph: &Graph, from: &str) -> BTreeSet<String> {
    let (mut found, mut open) = (BTreeSet::new(), vec![from.to_owned()]);
    while let Some(at) = open.pop() {
        for next in graph.get(&at).into_iter().flatten() {
            if found.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    found
}

/// Sets of files each of which reaches the others.
fn circles(graph: &Graph) -> BTreeSet<Vec<String>> {
    let reach: BTreeMap<&String, BTreeSet<String>> = graph.keys().map(|k| (k, reached(graph, k))).collect();
    let in_circle = reach.iter().filter(|(k, r)| r.contains(**k));
    in_circle
        .map(|(k, r)| r.iter().filter(|o| reach.get(o).is_some_and(|b| b.contains(*k))).cloned().collect())
        .collect()
}

#[test]
fn files_use_each_other_in_no_circle() {
    let graph = graph();
    assert!(graph.values().map(BTreeSet::len).sum::<usize>() > 500, "the uses are read");
    let found = circles(&graph);
    assert!(found.is_empty(), "circles: {found:#?}");
}

/// A circle is seen.
#[test]
fn circles_are_found() {
    let uses = |all: &[&str]| all.iter().map(|s| (*s).to_owned()).collect();
    let graph = Graph::from([
        ("a".to_owned(), uses(&["b"])),
        ("b".to_owned(), uses(&["c"])),
        ("c".to_owned(), uses(&["b", "d"])),
        ("d".to_owned(), uses(&[])),
    ]);
    assert_eq!(circles(&graph), BTreeSet::from([vec!["b".to_owned(), "c".to_owned()]]));
    let text = "use super::{x::Y, z};\nuse super::super::up::V; fn f() { crate::lens::shape::g(); self_super::no(); }";
    let found: Vec<String> = named(text, &["imaging", "render", "plan"]).iter().map(|p| p.join("::")).collect();
    assert_eq!(found, ["lens::shape::g", "imaging::render::x::Y", "imaging::render::z", "imaging::up::V"]);
}
