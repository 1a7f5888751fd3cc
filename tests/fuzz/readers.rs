//! One target a reader: bytes become changes of a valid file (cut, words exchanged, numbers replaced, bytes set, lines repeated), or are
//! the file themselves. A lens or one error, no panic, at most two seconds.
//!
//! `cargo test --release --manifest-path tests/fuzz/Cargo.toml` runs each for a moment; `.ci/slow fuzz` for ten minutes
//! (`BOLERO_RANDOM_TEST_TIME_MS`). `FUZZ_SEEDS` names a folder of further files to start from.

use std::path::Path;
use std::time::Instant;

use bolero::check;
use isoplanat::interchange::{Form, load, text_of};
use isoplanat::lens::builtin;
use isoplanat::lens::catalogue::Glasses;

const WORDS: [&str; 32] = [
    "nan",
    "inf",
    "-inf",
    "0",
    "-1",
    "1e308",
    "1e-308",
    "-0.0",
    "99999999999999999999",
    "1e17",
    "MIRROR",
    "INFINITY",
    "S",
    "SURF",
    "STO",
    "STOP",
    "\"",
    "'",
    ";",
    "{",
    "[",
    "&",
    "CD",
    "NM",
    "XASPHERE",
    "XOSPHERE",
    "XDAT",
    "MNUM",
    "THIC",
    "GLSS",
    "DBDT",
    "0,5",
];

/// Files to start from: the shipped lenses in this form, and those of `FUZZ_SEEDS`.
fn seeds(endings: &[&str], form: Option<Form>) -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> = Vec::new();
    if let Some(form) = form {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            all.extend(text_of(&lens, form, Glasses::shipped()).ok().map(|(text, _)| text.into_bytes()));
        }
    }
    let folders = std::env::var("FUZZ_SEEDS").unwrap_or_default();
    for folder in folders.split(':').filter(|f| !f.is_empty()) {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
            if endings.contains(&ending.as_str()) {
                all.extend(std::fs::read(&path).ok().filter(|b| b.len() < 60_000));
            }
        }
    }
    all
}

/// A file from the fuzzer's bytes.
fn file(bytes: &[u8], seeds: &[Vec<u8>]) -> Vec<u8> {
    let Some((kind, rest)) = bytes.split_first() else { return Vec::new() };
    if seeds.is_empty() || *kind < 16 {
        return rest.to_vec();
    }
    let mut out = seeds[usize::from(*kind) % seeds.len()].clone();
    for change in rest.chunks_exact(4) {
        if out.is_empty() {
            break;
        }
        let at = (usize::from(change[1]) * 256 + usize::from(change[2])) * out.len() / 65_536;
        let word = |from: usize| {
            let start = out[..from].iter().rposition(u8::is_ascii_whitespace).map_or(0, |i| i + 1);
            let end = out[from..].iter().position(u8::is_ascii_whitespace).map_or(out.len(), |i| from + i);
            start..end.max(start)
        };
        match change[0] % 6 {
            0 => out[at] = change[3],
            1 => {
                let range = word(at);
                out.splice(range, WORDS[usize::from(change[3]) % WORDS.len()].bytes());
            }
            2 => {
                let length = usize::from(change[3]).min(out.len() - at);
                out.drain(at..at + length);
            }
            3 => {
                let length = (8 * usize::from(change[3])).min(out.len() - at);
                let copy = out[at..at + length].to_vec();
                out.splice(at..at, copy);
            }
            4 if change[3] < 8 => out.truncate(at),
            _ => {
                let range = word(at);
                if let Some(x) = std::str::from_utf8(&out[range.clone()]).ok().and_then(|w| w.parse::<f64>().ok()) {
                    let factor = 10f64.powf((f64::from(change[3]) - 128.0) / 32.0);
                    out.splice(range, (x * factor).to_string().bytes());
                }
            }
        }
    }
    out
}

/// Writes each input to a file and reads it.
fn reads(ending: &str, endings: &[&str], form: Option<Form>) {
    let seeds = seeds(endings, form);
    let folder = std::env::temp_dir().join(format!("isoplanat-fuzz-{}-{ending}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(format!("a.{ending}"));
    check!().for_each(|bytes: &[u8]| {
        std::fs::write(&path, file(bytes, &seeds)).expect("writes");
        let start = seconds();
        read(&path, form.is_some());
        let taken = seconds() - start;
        if taken > 2.0 {
            let kept = std::env::temp_dir().join(format!("isoplanat-fuzz-slow.{ending}"));
            let _ = std::fs::copy(&path, &kept);
            panic!("{taken} s of processor time: {}", kept.display());
        }
    });
    let _ = std::fs::remove_dir_all(folder);
}

/// Processor time of this thread, seconds; elsewhere than on Linux time itself.
fn seconds() -> f64 {
    static BEGUN: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    let busy = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let busy = busy.and_then(|s| s.split_whitespace().next()?.parse::<f64>().ok());
    busy.map_or_else(|| BEGUN.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn read(path: &Path, lens: bool) {
    let error = if lens {
        load(path, Glasses::shipped()).err()
    } else {
        let mut all = Glasses::shipped().clone();
        all.add(path).err()
    };
    if let Some(error) = error {
        let text = error.to_string();
        assert!(!text.contains('\n') && error.exit_code() == 2, "{text}");
    }
}

#[test]
fn zmx() {
    reads("zmx", &["zmx"], Some(Form::Zmx));
}

#[test]
fn seq() {
    reads("seq", &["seq"], Some(Form::Seq));
}

#[test]
fn json() {
    reads("json", &["json"], Some(Form::Json));
}

#[test]
fn txt() {
    reads("txt", &["txt"], Some(Form::Txt));
}

#[test]
fn toml() {
    reads("toml", &["toml"], Some(Form::Toml));
}

#[test]
fn agf() {
    reads("agf", &["agf"], None);
}

#[test]
fn yml() {
    reads("yml", &["yml"], None);
}
