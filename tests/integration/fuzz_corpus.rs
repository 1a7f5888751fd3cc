//! Every fuzz target over its corpus, the inputs to start from and seeded changes of both: what readers promise, on every change of the program. For longer,
//! and guided by coverage: `.ci/slow fuzz`.
//!
//! `ISOPLANAT_REPEAT=N` makes N changes a target in place of 200, `ISOPLANAT_RANDOM_SEED` others.

#[path = "../fuzz/targets/mod.rs"]
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};

use self::targets::{TARGETS, Target};
use crate::support::{repetitions, root};

/// Files of a folder in the order of their names.
fn files(folder: &std::path::Path) -> Vec<Vec<u8>> {
    let mut paths: Vec<_> =
        std::fs::read_dir(folder).into_iter().flatten().map(|e| e.expect("an entry").path()).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).expect("reads")).collect()
}

/// The words of a dictionary of libFuzzer.
fn words(target: &Target) -> Vec<Vec<u8>> {
    let text = std::fs::read_to_string(root().join("tests/fuzz/dictionaries").join(format!("{}.dict", target.name)));
    let quoted = |line: &str| Some(line.strip_prefix('"')?.strip_suffix('"')?.to_owned());
    text.unwrap_or_default().lines().filter_map(|line| Some(unescaped(&quoted(line)?))).collect()
}

/// `\\`, `\"` and `\xAB` as the bytes that they stand for.
fn unescaped(text: &str) -> Vec<u8> {
    let (mut rest, mut all) = (text, Vec::new());
    while let Some(first) = rest.chars().next() {
        let hex = rest.strip_prefix("\\x").and_then(|r| u8::from_str_radix(r.get(..2)?, 16).ok());
        let (byte, length) = match (hex, rest.as_bytes()) {
            (Some(byte), _) => (byte, 4),
            (None, [b'\\', next, ..]) => (*next, 2),
            _ => (first as u8, 1),
        };
        all.push(byte);
        rest = &rest[length..];
    }
    all
}

/// A few changes: a byte set, a word exchanged or put in, a part taken out, doubled or left at the end, a number multiplied.
fn changed(rng: &mut fastrand::Rng, from: &[Vec<u8>], words: &[Vec<u8>]) -> Vec<u8> {
    let mut out = from[rng.usize(0..from.len())].clone();
    for _ in 0..rng.usize(1..8) {
        if out.is_empty() {
            break;
        }
        let at = rng.usize(0..out.len());
        let end = (at + rng.usize(1..64)).min(out.len());
        let start = out[..at].iter().rposition(u8::is_ascii_whitespace).map_or(0, |i| i + 1);
        let stop = out[at..].iter().position(u8::is_ascii_whitespace).map_or(out.len(), |i| at + i).max(start);
        match rng.u32(0..8) {
            0 => out[at] = rng.u8(..),
            1 => out[at] ^= 1 << rng.u32(0..8),
            2 => drop(out.drain(at..end)),
            3 => {
                let copy = out[at..end].to_vec();
                out.splice(at..at, copy);
            }
            4 if rng.u32(0..8) == 0 => out.truncate(at),
            5 | 6 if !words.is_empty() => {
                let range = if rng.bool() { at..at } else { start..stop };
                out.splice(range, words[rng.usize(0..words.len())].iter().copied());
            }
            _ => {
                if let Some(x) = std::str::from_utf8(&out[start..stop]).ok().and_then(|w| w.parse::<f64>().ok()) {
                    let other = (x * 10f64.powf(8.0 * (rng.f64() - 0.5))).to_string();
                    out.splice(start..stop, other.bytes());
                }
            }
        }
    }
    out
}

/// The first input on which a target breaks its promise, as text.
fn broken(target: &Target) -> Option<String> {
    let mut inputs = files(&root().join("tests/fuzz/corpus").join(target.name));
    assert!(!inputs.is_empty(), "{} has no corpus", target.name);
    inputs.extend((target.starts)());
    let words = words(target);
    let seed = std::env::var("ISOPLANAT_RANDOM_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let rng = &mut fastrand::Rng::with_seed(seed);
    let mutants: Vec<Vec<u8>> = (0..repetitions(200, 5000)).map(|_| changed(rng, &inputs, &words)).collect();
    let breaks = |input: &&Vec<u8>| catch_unwind(AssertUnwindSafe(|| (target.run)(input))).is_err();
    let input = inputs.iter().chain(&mutants).find(breaks)?;
    Some(format!("{}: {}", target.name, input.escape_ascii()))
}

/// A thread a target, so that the folders of all are gone at the end.
#[test]
fn readers_keep_their_promises() {
    let found: Vec<String> = std::thread::scope(|scope| {
        let all = TARGETS.each_ref().map(|target| scope.spawn(|| broken(target)));
        all.into_iter().filter_map(|thread| thread.join().expect("a corpus")).collect()
    });
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Each target has its program, and no other has one; a dictionary is a target's.
#[test]
fn programs_and_dictionaries_are_the_targets() {
    let manifest: toml::Table =
        std::fs::read_to_string(root().join("tests/fuzz/Cargo.toml")).expect("reads").parse().expect("TOML");
    let programs =
        manifest["bin"].as_array().expect("programs").iter().map(|bin| bin["name"].as_str().expect("a name"));
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    assert_eq!(programs.collect::<Vec<_>>(), names);
    for entry in std::fs::read_dir(root().join("tests/fuzz/dictionaries")).expect("lists") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().expect("a name").to_string_lossy();
        assert!(names.contains(&&*name), "{name}.dict");
    }
    assert_eq!(unescaped(r#"a\"\\\x0a"#), b"a\"\\\n");
}
