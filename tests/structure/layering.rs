//! The order of the modules, the places of the heavy crates, a test for every adjoint, the length of files.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use crate::root;

/// Modules of one crate in the order of the light; each uses only those before it. Between crates cargo holds the order.
const ORDER: [(&str, &[&str]); 3] = [
    ("crates/optics/src/", &["lens", "trace", "interchange", "optimize", "psf", "analysis"]),
    (
        "crates/imaging/src/",
        &[
            "frame",
            "plane",
            "exif",
            "sensor",
            "develop",
            "files",
            "dng",
            "scene",
            "metrics",
            "reference",
            "render",
            "capture",
            "guide",
            "calibrate",
        ],
    ),
    ("src/", &["report", "dataset", "design"]),
];

/// Crates, and the only places that may name them.
const CRATES: [(&[&str], &[&str]); 13] = [
    (&["pyo3", "numpy"], &["python/src"]),
    (&["calib_targets_chessboard"], &["crates/imaging/src/calibrate/chart.rs"]),
    (&["ort", "tract_onnx"], &["crates/camera/src/session"]),
    (&["rawler"], &["crates/camera/src/raw"]),
    (&["landlock", "seccompiler"], &["crates/camera/src/child"]),
    (&["prost"], &["crates/camera/src/session"]),
    (&["image"], &["crates/imaging/src/files"]),
    (&["png"], &["crates/imaging/src/files"]),
    (&["maud"], &["src/report/html.rs"]),
    (
        &["hyper", "hyper_util"],
        &["src/commands/view/server.rs", "src/commands/view/talk.rs", "src/commands/view/answer.rs"],
    ),
    (&["tokio"], &["src/commands/view/"]),
    (&["moxcms"], &["crates/imaging/src/develop/gamut.rs", "crates/imaging/src/develop/profile.rs"]),
    (&["tiff"], &["crates/imaging/src/files", "crates/imaging/src/exif.rs", "crates/imaging/src/dng.rs"]),
];

/// Files over 600 lines, each with its reason.
const LONG: [(&str, &str); 1] = [("crates/network/src/reconstructor.rs", "400 lines of one type, the rest its tests")];

/// Files that may hold unsafe code: vector instructions, columns of one output for several threads, a shared library, the programs' allocator.
const UNSAFE: [&str; 7] = [
    "crates/base/src/math/simd/avx2.rs",
    "crates/base/src/math/simd/avx512.rs",
    "crates/base/src/math/simd/hint.rs",
    "crates/base/src/math/simd.rs",
    "crates/network/src/kernels/panel.rs",
    "crates/camera/src/onnxruntime.rs",
    "crates/base/src/refusing.rs",
];

/// Methods called `vjp` whose test stands in `tests/`: their file, and the test.
const TESTED_ELSEWHERE: [(&str, &str); 2] = [
    ("crates/imaging/src/render/renderer.rs", "fn a_rendered_region_pulls_back_to_the_lens()"),
    ("crates/optics/src/psf/illumination.rs", "fn throughput_follows_clear_apertures()"),
];

/// Every source file: path from the root, text.
pub(crate) fn sources(folder: &str) -> BTreeMap<String, String> {
    fn walk(folder: &Path, found: &mut BTreeMap<String, String>) {
        for entry in std::fs::read_dir(folder).expect("lists") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                walk(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let name = path.strip_prefix(root()).expect("inside").to_string_lossy().replace('\\', "/");
                found.insert(name, std::fs::read_to_string(&path).expect("readable"));
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(&root().join(folder), &mut found);
    found
}

/// The program's and its crates' own sources.
pub(crate) fn own_sources() -> BTreeMap<String, String> {
    let mut all = sources("src");
    all.append(&mut sources("crates"));
    all
}

/// [`own_sources`] and those of the Python package.
fn all_sources() -> BTreeMap<String, String> {
    let mut all = own_sources();
    all.append(&mut sources("python/src"));
    all
}

/// Source without comments and without the contents of strings, line by line as it was.
pub(crate) fn code(text: &str) -> String {
    let (mut out, mut chars) = (String::new(), text.chars().peekable());
    while let Some(c) = chars.next() {
        match (c, chars.peek()) {
            ('/', Some('/')) => {
                for c in chars.by_ref() {
                    if c == '\n' {
                        out.push('\n');
                        break;
                    }
                }
            }
            ('"', _) => {
                // Raw strings end at their own hashes.
                let hashes = out.chars().rev().take_while(|c| *c == '#').count();
                let raw = out[..out.len() - hashes].ends_with('r');
                let end = format!("\"{}", "#".repeat(if raw { hashes } else { 0 }));
                let (mut inside, mut escaped) = (String::new(), false);
                for c in chars.by_ref() {
                    inside.push(c);
                    if inside.ends_with(&end) && !escaped {
                        break;
                    }
                    escaped = !raw && c == '\\' && !escaped;
                }
                out.push_str("\"\"");
                out.extend(inside.chars().filter(|c| *c == '\n'));
            }
            // Characters such as '"' and lifetimes.
            ('\'', Some(_)) => {
                let ahead: Vec<char> = chars.clone().take(3).collect();
                let skip = match ahead[..] {
                    ['\\', ..] => ahead.iter().skip(2).position(|c| *c == '\'').map(|i| i + 3),
                    [_, '\'', ..] => Some(2),
                    _ => None,
                };
                if let Some(last) = skip.unwrap_or(0).checked_sub(1) {
                    chars.nth(last);
                }
                out.push('\'');
            }
            _ => out.push(c),
        }
    }
    out
}

/// Paths behind each `prefix::`, groups in braces taken apart: first and second name, line.
fn paths(code: &str, prefix: &str) -> Vec<(String, String, usize)> {
    let start = format!("{prefix}::");
    let mut found = Vec::new();
    for (at, _) in code.match_indices(&start) {
        if code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let line = code[..at].lines().count().max(1);
        for path in spelled(&code[at + start.len()..]) {
            let mut names = path.split("::").map(str::to_owned);
            found.push((names.next().unwrap_or_default(), names.next().unwrap_or_default(), line));
        }
    }
    found
}

/// `a::b`, `{a::{b, c}, d}` → `a::b`; `a::b`, `a::c`, `d`.
pub(crate) fn spelled(text: &str) -> Vec<String> {
    let text = text.trim_start();
    let Some(group) = text.strip_prefix('{') else {
        let name: String = text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        let rest = text[name.len()..].trim_start();
        return match rest.strip_prefix("::") {
            Some(rest) => spelled(rest).into_iter().map(|r| format!("{name}::{r}")).collect(),
            None => vec![name],
        };
    };
    let (mut depth, mut from, mut all) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            '}' | ',' if depth == 0 => {
                if !group[from..i].trim().is_empty() {
                    all.extend(spelled(&group[from..i]));
                }
                from = i + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    all
}

#[test]
fn the_reader_of_this_test_takes_paths_apart() {
    let text = "use crate::lens::{Lens, glass::{Medium, named}}; // crate::design\nlet s = \"crate::deploy\"; \
                crate::psf::table::x(r#\"crate::\"network\"#, '\"', 'a'); use crate::{imaging::sensor::cfa, units};";
    let found: Vec<String> = paths(&code(text), "crate").into_iter().map(|(a, b, _)| format!("{a}.{b}")).collect();
    assert_eq!(found, ["lens.Lens", "lens.glass", "lens.glass", "psf.table", "imaging.sensor", "units."]);
    assert_eq!(code("a // b\n'\\n' \"x\\\"y\" 'l"), "a \n' \"\" 'l");
}

#[test]
fn a_module_uses_only_modules_before_it() {
    let mut wrong = Vec::new();
    let all = own_sources();
    for (folder, order) in ORDER {
        let rank = |module: &str| order.iter().position(|m| *m == module);
        for (file, text) in all.iter().filter(|(file, _)| file.starts_with(folder)) {
            let module = file.trim_start_matches(folder).split(['/', '.']).next().unwrap_or_default();
            let Some(own) = rank(module) else { continue };
            // Tests may use what judges their module.
            let code = code(text);
            let code = code.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
            let tests = file.ends_with("tests.rs") || file.contains("/tests/");
            for (used, _, line) in paths(if tests { "" } else { code }, "crate") {
                if rank(&used).is_some_and(|other| other > own) {
                    wrong.push(format!("{file}:{line}: {module} uses {used}, which stands after it"));
                }
            }
        }
        let seen = order.iter().filter(|m| all.keys().any(|f| f.starts_with(&format!("{folder}{m}")))).count();
        assert_eq!(seen, order.len(), "{folder} has the modules {order:?}");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Crates by place; the code of tests is left out.
#[test]
fn heavy_crates_are_named_only_in_their_places() {
    let mut wrong = Vec::new();
    for (file, text) in all_sources() {
        // Tests may name the crate that judges.
        let code = code(&text);
        let code = code.split("#[cfg(test)]").next().unwrap_or_default();
        for (names, places) in CRATES {
            if places.iter().any(|p| file.starts_with(p)) {
                continue;
            }
            for name in names {
                let used = paths(code, name).first().map(|p| p.2);
                let imported = code.lines().position(|l| l.trim() == format!("use {name};"));
                if let Some(line) = used.or(imported) {
                    wrong.push(format!("{file}:{line}: names the crate {name}; only {places:?} may"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_adjoint_has_a_test_that_names_it() {
    let tests: String = sources("tests").into_values().map(|t| code(&t)).collect();
    let mut missing = Vec::new();
    let sources = own_sources();
    for (file, text) in &sources {
        let code = code(text);
        let (body, own_tests) = code.split_once("#[cfg(test)]").unwrap_or((&code, ""));
        // Tests in a file of their own are the module's too.
        let beside = sources.get(&file.replace(".rs", "/tests.rs")).map_or("", String::as_str);
        let own_tests = format!("{own_tests}{beside}");
        for line in body.lines() {
            let line = line.trim().replacen("pub(crate) fn ", "pub fn ", 1);
            let Some((_, rest)) = line.split_once("pub fn ") else { continue };
            let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            let call = if name == "vjp" { ".vjp(".to_owned() } else { format!("{name}(") };
            let generic = call.replace('(', "::<");
            let named = |text: &str| text.contains(&call) || text.contains(&generic);
            // A method called `vjp` must be called in its own file: elsewhere the call may be another type's.
            let listed = || TESTED_ELSEWHERE.iter().any(|(f, test)| f == file && tests.contains(test));
            let tested = named(&own_tests) || if name == "vjp" { listed() } else { named(&tests) };
            if (name == "vjp" || name.ends_with("_vjp")) && !tested {
                missing.push(format!("{file}: {name}"));
            }
        }
    }
    assert!(missing.is_empty(), "adjoints without a test:\n{}", missing.join("\n"));
}

/// What makes a lens without its check is named by tests alone: everything else that is a lens is valid.
#[test]
fn only_tests_leave_the_check_of_a_lens_out() {
    let named = |(file, text): (String, String)| {
        let code = code(&text);
        let body = code.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        let tests = file.ends_with("tests.rs") || file.contains("/tests/") || file.ends_with("test_lenses.rs");
        (!tests && body.contains("unchecked")).then_some(file)
    };
    let found: Vec<String> = own_sources().into_iter().filter_map(named).collect();
    assert_eq!(found, ["crates/optics/src/lens.rs"], "the function itself and no other");
}

/// Files have no end that their name tells: whole ones are read up to a size, by `atomic`'s readers.
#[test]
fn files_are_read_up_to_a_size() {
    // What the system says of itself.
    let own = ["crates/base/src/math/memory.rs", "src/commands/peak.rs"];
    let named = |(file, text): (String, String)| {
        let code = code(&text);
        let body = code.split("#[cfg(test)]").next().unwrap_or_default();
        let tests = file.ends_with("tests.rs") || file.contains("/tests/") || own.contains(&file.as_str());
        (!tests && (body.contains("fs::read(") || body.contains("fs::read_to_string("))).then_some(file)
    };
    let found: Vec<String> = all_sources().into_iter().filter_map(named).collect();
    assert!(found.is_empty(), "read by `atomic::read_bounded` or `read_text`: {found:?}");
}

#[test]
fn no_file_is_long_without_a_reason() {
    let all = all_sources().into_iter().chain(sources("tests")).chain(sources("benches"));
    let long: Vec<String> = all
        .map(|(file, text)| (file, text.lines().count()))
        .filter(|(file, lines)| *lines > 600 && !LONG.iter().any(|(f, _)| f == file))
        .map(|(file, lines)| format!("{file}: {lines} lines"))
        .collect();
    assert!(long.is_empty(), "split these, or list them with a reason:\n{}", long.join("\n"));
}

/// Clippy holds that each block has its note.
#[test]
fn unsafe_code_is_little_and_in_its_places() {
    let mut blocks = 0;
    let mut wrong = Vec::new();
    for (file, text) in all_sources() {
        let code = code(&text);
        let unsafe_here = |line: &str| line.split(|c: char| !c.is_alphanumeric() && c != '_').any(|w| w == "unsafe");
        if let Some(line) = code.lines().position(unsafe_here)
            && !UNSAFE.contains(&file.as_str())
        {
            wrong.push(format!("{file}:{}: unsafe code; only {UNSAFE:?} may", line + 1));
        }
        blocks += code.matches("unsafe {").count();
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!((1..=40).contains(&blocks), "{blocks} unsafe blocks");
}

/// The camera binary's dependencies, as cargo resolves them.
#[test]
fn the_camera_side_has_no_training_code_in_its_dependencies() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let arguments =
        "tree --locked --offline -e normal --package isoplanat --no-default-features --features deploy --prefix none";
    let output = Command::new(cargo).args(arguments.split(' ')).current_dir(root()).output().expect("cargo runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("rawler"), "{}", String::from_utf8_lossy(&output.stderr));
    let training: Vec<&str> =
        text.lines().filter(|l| ["burn", "cubecl", "onnx-rs"].iter().any(|c| l.starts_with(c))).collect();
    assert!(training.is_empty(), "{training:?}");
}
