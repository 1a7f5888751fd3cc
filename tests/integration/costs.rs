//! What hostile inputs cost: up to a megabyte of anything, to any command that reads it, ends in a plan or one line within ten seconds and two gibibytes.

use std::io::Write;
use std::process::Stdio;
use std::time::{Duration, Instant};

use isoplanat::testing::shared;

use crate::support::Workplace;

/// Bounds of the promise.
const SECONDS: f64 = 10.0;
const GIB: f64 = 2.0;

/// The largest file.
const MOST: usize = 1 << 20;

/// What a run took.
struct Cost {
    arguments: String,
    seconds: f64,
    mib: f64,
    code: Option<i32>,
    said: String,
}

/// Runs the program and looks at its memory until it ends; a run that goes on beyond the bound is ended once it has shown a plan or is late.
fn cost(place: &Workplace, arguments: &str) -> Cost {
    let mut command = place.command(&format!("{arguments} --memory-gib {GIB}"));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("starts");
    let status = format!("/proc/{}/status", child.id());
    let (start, mut mib) = (Instant::now(), 0f64);
    let mut late = false;
    while child.try_wait().expect("waits").is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let peak =
            text.lines().find_map(|l| l.strip_prefix("VmHWM:")).and_then(|l| l.trim().split(' ').next()?.parse().ok());
        mib = mib.max(peak.unwrap_or(0.0) / 1024.0);
        if start.elapsed().as_secs_f64() > 2.0 * SECONDS {
            late = true;
            child.kill().expect("ended");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let seconds = start.elapsed().as_secs_f64();
    let output = child.wait_with_output().expect("ended");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let code = if late { None } else { output.status.code() };
    Cost { arguments: arguments.to_owned(), seconds, mib, code, said }
}

/// A PNG that states a size and holds almost nothing; its checksums are right.
fn png(width: u32, height: u32) -> Vec<u8> {
    let crc = |bytes: &[u8]| {
        !bytes.iter().fold(!0u32, |c, b| {
            (0..8).fold(c ^ u32::from(*b), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
        })
    };
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |name: &[u8], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        let body = [name, data].concat();
        out.extend(&body);
        out.extend(crc(&body).to_be_bytes());
    };
    let [w, h] = [width, height].map(u32::to_be_bytes);
    chunk(b"IHDR", &[&w[..], &h[..], &[16, 6, 0, 0, 0]].concat());
    // A stored block of deflate without end.
    chunk(b"IDAT", &[0x78, 0x01, 0x00, 0x05, 0x00, 0xfa, 0xff, 0, 0, 0, 0, 0]);
    chunk(b"IEND", &[]);
    out
}

/// A JPEG of such a size, without samples.
fn jpeg(width: u16, height: u16) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
    out.extend([1u8; 64]);
    let ([a, b], [c, d]) = (height.to_be_bytes(), width.to_be_bytes());
    out.extend([0xff, 0xc2, 0, 17, 8, a, b, c, d, 3, 1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0]);
    out.extend([0xff, 0xda, 0, 12, 3, 1, 0, 2, 0, 3, 0, 0, 0, 0, 0xff, 0xd9]);
    out
}

fn npy(shape: &str, bytes: usize) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    header.extend(std::iter::repeat_n(' ', 117usize.saturating_sub(header.len())));
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(std::iter::repeat_n(0u8, bytes));
    out
}

/// Lenses of a megabyte: many surfaces, deep nesting, long words, numbers beyond all measure.
fn lenses(place: &Workplace) -> Vec<String> {
    let two = include_str!("../../models/lenses/two_element.toml");
    let (head, surfaces) = two.split_at(two.find("[[surface]]").expect("surfaces"));
    let many = surfaces.repeat(79);
    let mut files: Vec<(&str, String)> = vec![
        (
            "many.toml",
            head.to_owned()
                + &many.replace("stop = true\n", "").replacen(
                    "semi_diameter_mm = 12.0",
                    "semi_diameter_mm = 12.0\nstop = true",
                    1,
                ),
        ),
        ("crowd.toml", head.to_owned() + &surfaces.repeat(2000)),
        ("nested.toml", format!("schema = 1\nname = {}{}", "[".repeat(MOST / 2), "]".repeat(MOST / 2))),
        ("word.toml", two.replace("Two elements", &"w".repeat(MOST - 4000))),
        ("keys.toml", (0..60_000).map(|k| format!("k{k} = 1\n")).collect()),
        (
            "pixels.toml",
            two.replace("columns = 4096", "columns = 2000000000").replace("pitch_um = 6.0", "pitch_um = 1e-9"),
        ),
        (
            "waves.toml",
            two.replace(
                "nm = [486.1327, 587.5618, 656.2725]",
                &format!("nm = [{}587.5618]", "500.0, ".repeat(100_000)),
            ),
        ),
        ("huge.toml", two.replace("18.5", "1e300").replace("83.94", "1e-300")),
        ("nested.json", "[".repeat(MOST)),
        ("objects.json", "{\"surfaces\":".repeat(80_000)),
        ("blanks.zmx", " \n".repeat(MOST / 2)),
        ("names.seq", "RDM;LEN\n".to_owned() + &"TITLE 'x'\n".repeat(90_000)),
        ("one_line.seq", "S 1 2 3;".repeat(MOST / 8)),
        ("many.txt", "1 2 3 4 5\n".repeat(MOST / 10)),
    ];
    let surf: String = (0..20_000).map(|k| format!("SURF {k}\n  CURV 0.01\n  DISZ 1\n  GLAS N-BK7 0 0\n")).collect();
    files.push(("many.zmx", format!("VERS 1\nMODE SEQ\nUNIT MM\nENPD 5\nWAVM 1 0.55 1\n{surf}")));
    let aspheres: String = (0..40)
        .map(|k| format!("SURF {k}\n  TYPE XASPHERE\n  CURV 0.01\n  XDAT 1 2e9\n{}", "  XDAT 2 1\n".repeat(2000)))
        .collect();
    files.push(("terms.zmx", format!("VERS 1\nMODE SEQ\nUNIT MM\nENPD 5\nWAVM 1 0.55 1\n{aspheres}")));
    for (name, text) in &files {
        place.write(name, &text.as_bytes()[..text.len().min(MOST)]);
    }
    files.iter().map(|(name, _)| (*name).to_owned()).collect()
}

/// Pictures and arrays that promise more than they hold.
fn pictures(place: &Workplace) -> Vec<String> {
    let files: Vec<(&str, Vec<u8>)> = vec![
        ("square.png", png(65_535, 65_535)),
        ("wide.png", png(2_000_000_000, 2)),
        ("square.jpg", jpeg(65_500, 65_500)),
        ("promise.npy", npy("(60000, 60000, 3)", 1000)),
        ("overflow.npy", npy("(4611686018427387904, 4, 3)", 1000)),
        ("line.npy", npy("(1, 80000, 3)", 960_000)),
        ("noise.tif", [b"II*\0".to_vec(), vec![0xff; MOST - 4]].concat()),
        ("noise.png", [b"\x89PNG\r\n\x1a\n".to_vec(), vec![0xff; MOST - 8]].concat()),
    ];
    for (name, bytes) in &files {
        place.write(name, bytes);
    }
    files.iter().map(|(name, _)| (*name).to_owned()).collect()
}

/// Tasks whose numbers have no measure.
fn tasks(place: &Workplace) -> Vec<String> {
    let task = "schema = 1\nlens = \"two_element\"\nsteps = 3\n";
    let files = [
        ("patch.toml", format!("{task}patch_px = 4000000000\n")),
        ("batch.toml", format!("{task}batch = 4000000000\n")),
        ("width.toml", format!("{task}base_width = 4000000000\n")),
        ("scenes.toml", format!("{task}scenes = 4000000000\n")),
        ("deep.toml", format!("{task}[train]\nscales = 60\n")),
        ("depths.toml", format!("{task}depths_mm = [{}1000.0]\n", "1000.0, ".repeat(100_000))),
        ("raster.toml", format!("{task}sensor = {{ columns = 60000, rows = 60000, pitch_um = 0.001 }}\n")),
        ("draws.toml", format!("{task}worst_of = 4000000000\ntolerances = \"none.toml\"\n")),
    ];
    for (name, text) in &files {
        place.write(name, text);
    }
    files.iter().map(|(name, _)| (*name).to_owned()).collect()
}

#[test]
#[ignore = "a minute; its figures are printed"]
fn hostile_inputs_cost_little() {
    let place = Workplace::new();
    let mut runs: Vec<String> = Vec::new();
    for lens in lenses(&place) {
        for command in [
            "inspect",
            "check",
            "spot",
            "mtf",
            "lenses",
            "psf -o k.npz --force",
            "convert",
            "tolerance",
            "view --export v.html --force",
        ] {
            let (verb, rest) = command.split_once(' ').unwrap_or((command, ""));
            runs.push(match verb {
                "convert" => format!("convert {lens} c.toml --force"),
                "tolerance" => format!("tolerance {lens} --tolerances t.toml"),
                _ => format!("{verb} {lens} {rest}"),
            });
        }
    }
    place.write("t.toml", "schema = 1\n[element.all]\nthickness_tolerance_mm = 0.1\n");
    for picture in pictures(&place) {
        for command in [
            "render two_element IT -o r.png --force --columns 64 --rows 64",
            "slanted-edge IT",
            "calibrate IT IT IT -o d.toml --force",
        ] {
            runs.push(command.replace("IT", &picture));
        }
    }
    for task in tasks(&place) {
        runs.push(format!("design {task} --check"));
        runs.push(format!("train {task} -o run-{task}"));
    }
    let mut glass = std::fs::File::create(place.path("many.agf")).expect("made");
    for k in 0..8000 {
        writeln!(glass, "NM G{k} 2 000000 1.5 60 0 1\nCD 1 0.1 0.2 0.01 0.02 100 0 0 0 0").expect("written");
    }
    place.write("deep.yml", "a:\n".to_owned() + &"- ".repeat(MOST / 2));
    place.write("flow.yml", "[".repeat(MOST));
    for file in ["many.agf", "deep.yml", "flow.yml"] {
        runs.push(format!("inspect two_element --glass {file}"));
    }
    if let Some(folder) = shared("cases/hostile") {
        let at = |name: &str| folder.join(name).display().to_string();
        runs.push(format!("inspect two_element --glass {}", at("yaml-aliases/alias.yml")));
        runs.push(format!("design {} --check", at("design-pitch-memory/p9.toml")));
        for name in ["tiles_18k.dng", "tiles_20k.dng", "tiles_jxl.dng"] {
            runs.push(format!("slanted-edge {}", at(&format!("camera-memory/{name}"))));
        }
        for name in std::fs::read_dir(folder.join("png-65535-abort")).into_iter().flatten().flatten() {
            let path = name.path();
            if path.extension().is_some_and(|e| e == "png") {
                runs.push(format!("slanted-edge {}", path.display()));
            }
        }
    }
    for arguments in [
        "psf two_element -o k.npz --force --fields 255 --size 4000",
        "render two_element text:2 -o r.png --force --columns 60000 --rows 60000",
        "render two_element text:2 -o r.png --force --columns 64 --rows 64 --texels-per-pixel 1e9",
        "capture two_element text:2 -o c.dng --force --samples 4000000000",
        "spot two_element --rays 4000000000",
        "optimize two_element -o o.toml --force --search 4000000000",
    ] {
        runs.push(arguments.to_owned());
    }
    let mut costs: Vec<Cost> = runs.iter().map(|arguments| cost(&place, arguments)).collect();
    costs.sort_by(|a, b| {
        (b.seconds / SECONDS).max(b.mib / GIB / 1024.0).total_cmp(&(a.seconds / SECONDS).max(a.mib / GIB / 1024.0))
    });
    for c in costs.iter().take(20) {
        let name = c.arguments.chars().take(70).collect::<String>();
        let said = c.said.lines().last().unwrap_or_default().chars().take(100).collect::<String>();
        eprintln!("| {name} | {:.2} s | {:.0} MiB | {:?} | {said} |", c.seconds, c.mib, c.code);
    }
    eprintln!("{} runs", costs.len());
    for c in &costs {
        let told = format!("{}: {:.1} s, {:.0} MiB, {:?}: {}", c.arguments, c.seconds, c.mib, c.code, c.said);
        assert!(c.mib <= GIB * 1024.0, "{told}");
        match c.code {
            // At work for longer: it has said what it does.
            None | Some(0) if c.said.contains('…') => {}
            Some(0..=2) => assert!(c.seconds <= SECONDS, "{told}"),
            None => panic!("{told}"),
            Some(_) => panic!("{told}"),
        }
        assert!(
            !c.said.contains("panicked") && !c.said.contains("overflowed its stack"),
            "{}: {}",
            c.arguments,
            c.said
        );
        if c.code == Some(2) {
            let errors = c.said.lines().filter(|l| l.starts_with("error")).count();
            assert_eq!(errors, 1, "{}: {}", c.arguments, c.said);
        }
    }
}
