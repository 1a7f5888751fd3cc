//! The camera program as it runs: formats, what stands beside the pixels, folders, captures that arrive.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use isoplanat::imaging::develop::color::{inverse, product};
use isoplanat::imaging::develop::gamut::Gamut;
use isoplanat::imaging::dng::{DngInfo, write_dng};
use isoplanat::imaging::files::{Encoding, read_picture};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::testing::shared;
use ndarray::{Array2, Array3};

use crate::support::{Workplace, repetitions, root};

/// A capture of smooth colours, none of them saturated.
fn capture(path: &Path, seed: u16) {
    let sensor = Sensor::generic();
    let mosaic = Array2::from_shape_fn((48, 64), |(r, c)| {
        let channel = sensor.cfa.channel(r, c) as f64;
        let wave = 0.3 + 0.08 * ((r as f64 / 9.0).sin() + (c as f64 / 11.0 + channel + f64::from(seed)).cos());
        (sensor.black_level + wave * sensor.neutral_response[channel as usize] * 3000.0).round() as u16
    });
    let info = DngInfo { lens: "Tessar 50".into(), model: "Virtual 3".into(), ..DngInfo::default() };
    write_dng(path, mosaic.view(), &sensor, &info).expect("writes");
}

fn program(place: &Workplace, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"));
    command.args(arguments.split_whitespace()).current_dir(place.path(""));
    command
}

fn run(place: &Workplace, arguments: &str) -> (i32, String, String) {
    let ran = program(place, arguments).output().expect("starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    (ran.status.code().unwrap_or(-1), text(ran.stdout), text(ran.stderr))
}

fn worst(a: &Array3<f32>, b: &Array3<f32>) -> f32 {
    assert_eq!(a.dim(), b.dim());
    (a - b).iter().fold(0.0, |m: f32, v| m.max(v.abs()))
}

/// Every format says its colours and carries the exposure's facts; a DNG developed again is the picture itself; equal runs are equal bytes.
#[test]
fn formats_hold_the_same_picture() {
    let place = Workplace::new();
    capture(&place.path("a.dng"), 0);
    for out in ["a.png", "again.png", "a.tif --linear", "a.jpg", "wide.tif --color display-p3", "c.dng"] {
        let (code, _, err) = run(&place, &format!("a.dng -o {out}"));
        assert_eq!(code, 0, "{out}: {err}");
    }
    let bytes = |name: &str| std::fs::read(place.path(name)).expect("reads");
    assert_eq!(bytes("a.png"), bytes("again.png"));
    let holds = |name: &str, part: &[u8]| bytes(name).windows(part.len()).any(|w| w == part);
    for name in ["a.png", "a.tif", "a.jpg", "wide.tif", "c.dng"] {
        assert!(holds(name, b"Tessar 50\0") && holds(name, b"Virtual 3\0"), "{name}: lens and camera");
        assert!(holds(name, b"isoplanat-camera "), "{name}: program");
    }
    assert!(holds("a.tif", b"mntrRGB XYZ ") && holds("a.jpg", b"ICC_PROFILE\0") && holds("a.png", b"iCCP"));
    assert!(holds("a.jpg", b"Exif\0\0") && holds("a.png", b"eXIf"));

    let linear = read_picture(&place.path("a.tif"), Encoding::Linear).expect("reads");
    let png = read_picture(&place.path("a.png"), Encoding::Srgb).expect("reads");
    assert!(worst(&linear, &png) < 2.28 * 0.51 / 255.0, "{}", worst(&linear, &png));
    // The wider space has the same light by other numbers.
    let wide = read_picture(&place.path("wide.tif"), Encoding::Srgb).expect("reads");
    let back = inverse(&Gamut::DisplayP3.from_srgb()).expect("an inverse");
    let same = product(&back, &Gamut::DisplayP3.from_srgb());
    assert!((same[0][0] - 1.0).abs() < 1e-9);
    let srgb = Array3::from_shape_fn(wide.dim(), |(k, r, c)| (0..3).map(|j| back[k][j] as f32 * wide[[j, r, c]]).sum());
    assert!(worst(&srgb, &linear) < 1e-4 && worst(&wide, &linear) > 1e-3, "{}", worst(&srgb, &linear));

    let (code, _, err) = run(&place, "c.dng -o developed.tif --linear");
    assert_eq!(code, 0, "{err}");
    let developed = read_picture(&place.path("developed.tif"), Encoding::Linear).expect("reads");
    assert!(worst(&developed, &linear) < 2e-4, "{}", worst(&developed, &linear));
}

/// Two steps brighter: four times the light where it is not cut; drawn in, it is less, and no pixel is lost.
#[test]
fn exposure_is_in_steps() {
    let place = Workplace::new();
    capture(&place.path("a.dng"), 0);
    for (name, more) in
        [("plain", ""), ("bright", "--exposure 1"), ("dark", "--exposure -2"), ("soft", "--exposure 2 --tone soft")]
    {
        let (code, _, err) = run(&place, &format!("a.dng -o {name}.tif --linear {more}"));
        assert_eq!(code, 0, "{err}");
    }
    let read = |name: &str| read_picture(&place.path(&format!("{name}.tif")), Encoding::Linear).expect("reads");
    let plain = read("plain");
    assert!(worst(&read("bright"), &plain.mapv(|v| (2.0 * v).min(1.0))) < 1e-4);
    assert!(worst(&read("dark"), &(&plain / 4.0)) < 1e-4);
    let soft = read("soft");
    assert!(soft.iter().zip(&plain).all(|(s, p)| *s < 4.0 * p && *s > *p && *s < 1.0), "between");
}

/// What contradicts itself is refused with one sentence, and nothing is written.
#[test]
fn contradictions_are_refused() {
    let place = Workplace::new();
    capture(&place.path("a.dng"), 0);
    for folder in ["empty", "in"] {
        std::fs::create_dir(place.path(folder)).expect("a folder");
    }
    capture(&place.path("in/a.dng"), 0);
    for (arguments, words) in [
        ("a.dng -o b.dng --exposure 1", "--exposure: a DNG holds the camera's own light"),
        ("a.dng -o b.dng --color display-p3", "--color"),
        ("a.dng -o b.dng --linear", "linear already"),
        ("in -o out.dng", "one picture"),
        ("in -o in --watch --format dng", "a folder that is watched"),
        ("in -o out --watch --linear --format jpg", "JPEG has 8 bits"),
        ("a.dng -o b.jpg --linear", "JPEG has 8 bits"),
        ("a.dng -o b.png --format tif", "--format"),
        ("a.dng -o a.dng --force", "is read by the same command"),
        ("a.dng -o b.png --exposure 11", "steps from -10 to 10"),
        ("a.dng -o b.png --exposure NaN", "steps from -10 to 10"),
        ("a.dng -o b.gif", ".dng or .npy"),
        ("empty -o out", "no RAW file in it"),
        ("a.dng -o out --watch", "no folder"),
        ("a.dng --watch", "--out"),
    ] {
        let (code, out, err) = run(&place, arguments);
        assert!(code == 2 && out.is_empty() && err.contains(words), "{arguments}: {code} {err}");
    }
    assert_eq!(place.files(), ["a.dng", "empty", "in"]);
    // What agrees is none.
    for arguments in ["a.dng -o b.jpeg --format jpg", "a.dng -o b.tiff --format tif"] {
        assert_eq!(run(&place, arguments).0, 0, "{arguments}");
    }
}

/// A folder is its captures; one that is none is said, and the others are developed.
#[test]
fn folders_are_batches() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("in")).expect("a folder");
    for (k, name) in ["b", "a"].iter().enumerate() {
        capture(&place.path(&format!("in/{name}.dng")), k as u16);
    }
    place.write("in/broken.dng", "no picture").write("in/notes.txt", "none").write("in/._a.dng", "macOS");
    let (code, out, err) = run(&place, "in -o out --format jpg --json");
    assert!(code == 2 && err.contains("broken.dng"), "{code} {err}");
    let json: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let pictures = json["pictures"].as_array().expect("a list");
    assert_eq!(pictures.len(), 2);
    assert_eq!(pictures[0]["exposure"]["lens"], "Tessar 50");
    for name in ["out/a.jpg", "out/b.jpg"] {
        assert!(place.path(name).is_file(), "{name}");
    }
    let before = std::fs::read(place.path("out/a.jpg")).expect("reads");
    let (code, _, err) = run(&place, "in -o out --format jpg");
    assert!(code == 2 && err.contains("exists"), "{err}");
    assert_eq!(std::fs::read(place.path("out/a.jpg")).expect("reads"), before);
}

/// Cases that stand for kinds of files: black by rows, gain maps and crops give the light of `a_base`; what is left out is told; filters are named.
#[test]
fn kinds_of_dng_are_developed_or_refused_by_name() {
    let Some(cases) = shared("cases") else { return };
    let place = Workplace::new();
    let develop = |name: &str| {
        let file = cases.join(name);
        let (code, _, err) = run(&place, &format!("{} -o {name}.tif --linear", file.display()));
        assert_eq!(code, 0, "{name}: {err}");
        (read_picture(&place.path(&format!("{name}.tif")), Encoding::Linear).expect("reads"), err)
    };
    let (base, _) = develop("a_base.dng");
    assert!((0..3).all(|k| (base[[k, 4, 4]] - 0.25).abs() < 1e-4), "a quarter of white, grey");
    for name in ["b_deltaV.dng", "b_deltaV_const.dng", "o_op2gain.dng"] {
        let (picture, _) = develop(name);
        assert!((0..3).all(|k| (picture[[k, 4, 4]] - 0.25).abs() < 1.5e-4), "{name}");
        assert!(worst(&picture, &base) < 5e-4, "{name}: {}", worst(&picture, &base));
    }
    let (warped, err) = develop("o_op3warp.dng");
    assert!(err.contains("OpcodeList3: WarpRectilinear") && warped == base, "{err}");
    let (cropped, _) = develop("c_defaultcrop.dng");
    assert_eq!(cropped, base.slice(ndarray::s![.., 8..120, 8..184]));
    let (grey, _) = develop("e_mono.dng");
    assert!((0..3).all(|k| (grey[[k, 4, 4]] - 0.25).abs() < 1e-4));
    for (name, word) in [("g_quad.dng", "Quad Bayer"), ("g_xtrans.dng", "X-Trans")] {
        let (code, _, err) = run(&place, &format!("{} -o no.png", cases.join(name).display()));
        assert!(code == 2 && err.contains(word) && !place.path("no.png").exists(), "{name}: {err}");
    }
}

/// Pictures that are developed already have distortion and falling light taken out as captures have: a JPEG, a TIFF, an array of numbers; and floating
/// point out is the same light.
#[test]
fn developed_pictures_are_corrected_by_calibrations() {
    let place = Workplace::new();
    capture(&place.path("a.dng"), 0);
    place.write(
        "d.toml",
        "schema = 1\ncamera = \"\"\nlens = \"\"\nsource = \"test\"\ncolumns = 64\nrows = 48\nfocal_length_px = 60.0\n\
         centre_px = [30.0, 26.0]\nk = [-0.2, 0.01, 0.0]\nmax_slope = 0.7\nrms_px = 0.1\n",
    );
    let develop = |arguments: &str| {
        let (code, _, err) = run(&place, arguments);
        assert_eq!(code, 0, "{arguments}: {err}");
    };
    develop("a.dng -o a.tif");
    develop("a.dng -o a.jpg");
    develop("a.dng -o f.npy");
    develop("a.dng -o f.tif --float");
    develop("a.dng -o straight.tif --linear --distortion d.toml");
    let read = |name: &str| read_picture(&place.path(name), Encoding::Linear).expect("reads");
    assert_eq!(read("f.npy"), read("f.tif"));
    let straight = read("straight.tif");
    for (from, close) in [("a.tif", 1e-4), ("a.jpg", 0.03), ("f.npy", 1e-4), ("f.tif", 1e-4)] {
        develop(&format!("{from} -o out-{from}.tif --linear --distortion d.toml"));
        let found = read(&format!("out-{from}.tif"));
        assert!(worst(&found, &straight) < close, "{from}: {}", worst(&found, &straight));
    }
    for (arguments, words) in [
        ("a.tif -o x.png --float", "--float"),
        ("a.tif -o a.tif --force", "is read by the same command"),
        ("d.toml -o x.png", "d.toml"),
    ] {
        let (code, _, err) = run(&place, arguments);
        assert!(code == 2 && err.contains(words) && !place.path("x.png").exists(), "{arguments}: {err}");
    }
}

/// Bytes of a file cut short, changed at random places, mostly near its head, or with a run of them overwritten.
fn mutated(bytes: &[u8], rng: &mut fastrand::Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    match rng.u32(0..4) {
        0 => bytes.truncate(rng.usize(0..bytes.len())),
        1 => {
            let from = rng.usize(0..bytes.len());
            let to = (from + rng.usize(1..256)).min(bytes.len());
            bytes[from..to].fill([0, 0xff, rng.u8(..)][rng.usize(0..3)]);
        }
        _ => {
            let head = if rng.bool() { bytes.len().min(4096) } else { bytes.len() };
            for _ in 0..rng.usize(1..17) {
                bytes[rng.usize(0..head)] = rng.u8(..);
            }
        }
    }
    bytes
}

/// RAW files and kits with random damage: a picture or one clear refusal, within limits of time and memory, and no partial output.
/// `ISOPLANAT_REPEAT=N` takes N in place of 24.
#[cfg(unix)]
#[test]
fn damaged_files_are_developed_or_refused() {
    use rayon::prelude::*;
    let count = repetitions(24, 200) as u64;
    let own = Workplace::new();
    capture(&own.path("own.dng"), 0);
    let mut raws = vec![own.path("own.dng")];
    for name in
        ["nikon_crop_gbrg_u16.dng", "nikon_crop_rggb_lj92.dng", "canon_eos_6d_linear_lossy.dng", "RAW_NIKON_D1.NEF"]
    {
        raws.extend(shared(&format!("data/raw/{name}")));
    }
    let raws: Vec<(String, Vec<u8>)> = raws
        .iter()
        .map(|p| (p.extension().expect("an ending").to_string_lossy().into_owned(), std::fs::read(p).expect("reads")))
        .collect();
    let kit = root().join("models/kits/lfov-30-free");
    let parts: Vec<(String, Vec<u8>)> = std::fs::read_dir(&kit)
        .expect("lists")
        .map(|e| e.expect("an entry").path())
        .filter(|p| p.is_file())
        .map(|p| (p.file_name().expect("a name").to_string_lossy().into_owned(), std::fs::read(&p).expect("reads")))
        .collect();
    let hash = |bytes: &[u8]| isoplanat::atomic::sha256_hex(bytes);
    let faults: Vec<String> = (0..count)
        .into_par_iter()
        .filter_map(|seed: u64| {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let place = Workplace::new();
            let arguments = if !seed.is_multiple_of(4) {
                let (ending, bytes) = &raws[rng.usize(0..raws.len())];
                place.write(&format!("a.{ending}"), mutated(bytes, rng));
                format!("a.{ending} -o out.png")
            } else {
                // Every other one with the hash of the damaged part, as somebody who means it would write it.
                std::fs::create_dir(place.path("kit")).expect("a folder");
                let damaged = rng.usize(0..parts.len());
                let mut all = parts.clone();
                all[damaged].1 = mutated(&parts[damaged].1, rng);
                if rng.bool() {
                    let (old, new) = (hash(&parts[damaged].1), hash(&all[damaged].1));
                    for (_, bytes) in all.iter_mut().filter(|(name, _)| name == "kit.toml") {
                        if let Ok(text) = std::str::from_utf8(bytes) {
                            *bytes = text.replace(&old, &new).into_bytes();
                        }
                    }
                }
                for (name, bytes) in &all {
                    place.write(&format!("kit/{name}"), bytes);
                }
                place.write("a.dng", &raws[0].1);
                "a.dng --kit kit -o out.png".to_owned()
            };
            let before = place.files();
            let limits = "ulimit -v 6291456 && ulimit -t 60";
            let ran = Command::new("sh")
                .args(["-c", &format!("{limits} && exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_isoplanat-camera")])
                .args(arguments.split_whitespace())
                .current_dir(place.path(""))
                .output()
                .expect("starts");
            let (err, mut after) = (String::from_utf8_lossy(&ran.stderr).into_owned(), place.files());
            let wrong = match ran.status.code() {
                Some(0) => {
                    let whole = read_picture(&place.path("out.png"), Encoding::Srgb).is_ok();
                    after.retain(|name| name != "out.png");
                    (!whole).then_some("no whole picture")
                }
                Some(2) => (!err.lines().any(|l| l.starts_with("isoplanat-camera: "))).then_some("no word of why"),
                Some(_) => Some("an internal error"),
                None => Some("killed"),
            };
            let wrong = wrong.or_else(|| (before != after).then_some("something is left behind"));
            wrong.map(|what| format!("seed {seed}: {what}: {arguments}: {:?} {err}", ran.status))
        })
        .collect();
    assert!(faults.is_empty(), "{} of {count}:\n{}", faults.len(), faults[..faults.len().min(8)].join("\n"));
}

struct Watching(Child);

impl Drop for Watching {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Captures are developed as they arrive, whole; what has a picture is left alone; Ctrl-C ends it.
#[cfg(unix)]
#[test]
fn captures_that_arrive_are_developed() {
    let place = Workplace::new();
    for folder in ["in", "out"] {
        std::fs::create_dir(place.path(folder)).expect("a folder");
    }
    capture(&place.path("in/old.dng"), 0);
    place.write("out/old.png", "mine");
    capture(&place.path("new.dng"), 1);
    let err = std::fs::File::create(place.path("err.txt")).expect("a file");
    let mut command = program(&place, "in -o out --watch");
    let mut child = Watching(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(err).spawn().expect("starts"));
    let wait = |what: &dyn Fn() -> bool| {
        let until = Instant::now() + Duration::from_secs(60);
        while !what() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(50));
        }
        what()
    };
    // In two parts, as a card is copied.
    let bytes = std::fs::read(place.path("new.dng")).expect("reads");
    place.write("in/new.dng", &bytes[..bytes.len() / 2]);
    std::thread::sleep(Duration::from_millis(200));
    place.write("in/new.dng", &bytes);
    place.write("in/broken.dng", "no picture");
    assert!(wait(&|| place.path("out/new.png").is_file()), "it is developed");
    let first = std::fs::read(place.path("out/new.png")).expect("reads");
    // Another capture of that name does not take its picture.
    std::fs::create_dir(place.path("other")).expect("a folder");
    capture(&place.path("other/new.dng"), 5);
    std::fs::rename(place.path("other/new.dng"), place.path("in/new.DNG")).expect("moves");
    assert!(
        wait(&|| std::fs::read_to_string(place.path("err.txt")).is_ok_and(|t| t.contains("both be written"))),
        "told"
    );
    assert_eq!(std::fs::read(place.path("out/new.png")).expect("reads"), first);
    let interrupted = Command::new("kill").args(["-INT", &child.0.id().to_string()]).status().expect("starts");
    assert!(interrupted.success());
    let status = child.0.wait().expect("ends");
    assert!(matches!(status.code(), Some(0 | 2)), "{status}");
    assert_eq!(std::fs::read(place.path("out/old.png")).expect("reads"), b"mine");
}
