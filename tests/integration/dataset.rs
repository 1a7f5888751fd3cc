//! `isoplanat dataset`: pairs in every form, split, killed, judged; and one pair by `isoplanat render`.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use isoplanat::imaging::files::{read_linear, read_picture};
use isoplanat::lens::builtin;
use isoplanat::trace::aim::Aimer;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, System};
use isoplanat::{Encoding, Frame, SceneKind, generate, write_picture};
use ndarray::{Array3, Array4, Axis};
use ndarray_npy::{NpzReader, ReadNpyExt};

use crate::support::{Workplace, repetitions};

/// A frame that takes no time.
const FRAME: &str = "--columns 48 --rows 32 --whole-field";

/// A folder `photos` with pictures of three sizes: of 16 bits, of 8 bits, grey.
fn photographs() -> Workplace {
    let place = Workplace::new();
    let folder = place.path("photos");
    std::fs::create_dir(&folder).expect("made");
    let of = |kind, rows, cols| generate(kind, 3, rows, cols);
    write_picture(&folder.join("a.png"), &of(SceneKind::Facades, 64, 96), Encoding::Srgb).expect("writes");
    write_picture(&folder.join("b.jpg"), &of(SceneKind::DeadLeaves, 90, 60), Encoding::Srgb).expect("writes");
    let grey = of(SceneKind::Text, 40, 50).index_axis(Axis(0), 1).to_owned().insert_axis(Axis(0));
    write_picture(&folder.join("c.npy"), &grey, Encoding::Linear).expect("writes");
    place
}

/// Every file below a folder, by its path, without the list of the folder.
fn all(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, from: &Path, found: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).expect("lists") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                walk(&path, from, found);
            } else {
                let name = path.strip_prefix(from).expect("inside").to_string_lossy().into_owned();
                found.insert(name, std::fs::read(&path).expect("reads"));
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(folder, folder, &mut found);
    found
}

/// The lines of `pairs.csv` by the names of the columns.
fn lines(folder: &Path) -> Vec<BTreeMap<String, String>> {
    let text = std::fs::read_to_string(folder.join("pairs.csv")).expect("a table");
    // Commas within quotes are no ends of cells.
    let cells = |line: &str| -> Vec<String> {
        let parts = line.split('"').enumerate();
        let marked: String =
            parts.map(|(k, part)| if k % 2 == 0 { part.replace(',', "\n") } else { part.into() }).collect();
        marked.split('\n').map(str::to_owned).collect()
    };
    let mut lines = text.lines();
    let heads = cells(lines.next().expect("a heading"));
    lines.map(|l| heads.iter().cloned().zip(cells(l)).collect()).collect()
}

fn number(line: &BTreeMap<String, String>, column: &str) -> f64 {
    line[column].parse().unwrap_or_else(|_| panic!("{column}: `{}`", line[column]))
}

/// Pair `k` of an array `[pair, row, col, channel]` as `[channel, row, col]`.
fn pair_of(array: &Array4<f32>, k: usize) -> Array3<f32> {
    array.index_axis(Axis(0), k).permuted_axes([2, 0, 1]).as_standard_layout().into_owned()
}

#[test]
fn every_form_holds_the_same_pairs() {
    let place = photographs();
    let common = format!(
        "dataset cooke_triplet two_element --photos photos {FRAME} --crop 24x16 --crops 3 --noise generic --noise-level 0.5,2 --depth-mm 2000,inf"
    );
    for form in ["png", "tiff", "npy", "npz"] {
        let said = place.run(&format!("{common} --form {form} --shard 5 -o {form} --json")).done();
        let value: serde_json::Value = serde_json::from_str(&said).expect("JSON");
        assert_eq!((value["pairs"].as_u64(), value["complete"].as_bool()), (Some(36), Some(true)), "{said}");
        assert_eq!(value["plans"].as_array().map(Vec::len), Some(4), "one plan a lens and distance: {said}");
    }
    let [png, tiff, npy, npz] = ["png", "tiff", "npy", "npz"].map(|f| place.path(f));
    let tables = [&png, &tiff, &npy, &npz].map(|f| lines(f));
    let without = |line: &BTreeMap<String, String>| {
        let mut line = line.clone();
        ["capture", "truth", "place"].iter().for_each(|name| drop(line.remove(*name)));
        line
    };
    assert_eq!(tables[0].len(), 36);
    let mut levels = Vec::new();
    let [in_png, in_tiff, in_npy, in_npz] = &tables;
    for (k, (((a, b), c), d)) in in_png.iter().zip(in_tiff).zip(in_npy).zip(in_npz).enumerate() {
        assert!([b, c, d].iter().all(|other| without(other) == without(a)), "{a:?}");
        assert_eq!((number(a, "pair") as usize, a["sensor"].as_str()), (k, "generic RGGB, 12 bit"));
        levels.push(number(a, "noise_level"));
        let place = number(c, "place") as usize;
        for which in ["capture", "truth"] {
            let float = read_linear(&tiff.join(&b[which])).expect("a TIFF");
            assert_eq!(float.dim(), (3, 16, 24));
            let array = Array4::<f32>::read_npy(std::fs::File::open(npy.join(&c[which])).expect("there"));
            assert_eq!(pair_of(&array.expect("an array"), place), float, "{which} {k}");
            let mut archive = NpzReader::new(std::fs::File::open(npz.join(&d[which])).expect("there")).expect("npz");
            let array: Array4<f32> = archive.by_name(which).expect("an array");
            assert_eq!(pair_of(&array, number(d, "place") as usize), float, "{which} {k}");
            let numbers: ndarray::Array1<f64> = archive.by_name("shot_variance").expect("numbers");
            assert!((numbers[number(d, "place") as usize] / number(d, "shot_variance") - 1.0).abs() < 1e-14);
            let seeds: ndarray::Array1<u64> = archive.by_name("seed").expect("numbers");
            assert_eq!(seeds[number(d, "place") as usize].to_string(), d["seed"]);
            // Half a step of 65,535 on the steepest part of the curve.
            let cut = read_picture(&png.join(&a[which]), Encoding::Srgb).expect("a PNG");
            let off = cut.iter().zip(&float).map(|(p, f)| (p - f.clamp(0.0, 1.0)).abs()).fold(0.0, f32::max);
            assert!(off < 2.28 * 0.51 / 65535.0, "{which} {k}: {off}");
        }
    }
    // Levels are drawn between the ends, each its own.
    assert!(levels.iter().all(|l| (0.5..=2.0).contains(l)));
    levels.sort_by(f64::total_cmp);
    assert!(levels.windows(2).all(|w| w[0] < w[1]) && levels[0] < 0.7 && levels[35] > 1.4, "{levels:?}");
    assert!(npy.join("capture/00000.npy").is_file() && !npy.join("capture/00012.npy").exists(), "3 pairs a shard");
}

#[test]
fn parts_make_the_same_bits_as_the_whole() {
    let place = photographs();
    for (name, more) in [("png", ""), ("npz", "--form npz --crop 16 --crops 2 --texels-per-pixel 1.2 --shard 4")] {
        let common = format!(
            "dataset cooke_triplet two_element double_gauss --photos photos {FRAME} --noise generic --judge 0.4 --judge-samples 8 --min-psnr-db 35 {more}"
        );
        place.run(&format!("{common} -o {name}-whole")).done();
        for index in [2, 0, 1] {
            let said = place.run(&format!("{common} -o {name}-parts --index {index} --of 3 --json")).done();
            assert!(said.contains(&format!("\"complete\":{}", index == 1)), "{said}");
            assert_eq!(place.path(&format!("{name}-parts/pairs.csv")).exists(), index == 1);
        }
        let (whole, parts) = (all(&place.path(&format!("{name}-whole"))), all(&place.path(&format!("{name}-parts"))));
        assert!(whole.keys().eq(parts.keys()), "{:?} {:?}", whole.keys(), parts.keys());
        assert!(whole.iter().zip(&parts).all(|(a, b)| a == b), "the same bits");
        // More parts than units: some have nothing to do.
        let said = place.run(&format!("{common} -o {name}-parts --index 400 --of 500 --json")).done();
        assert!(said.contains("\"made\":0"), "{said}");
        // Of another number of threads.
        let mut command = place.command(&format!("{common} -o {name}-one"));
        assert!(command.env("RAYON_NUM_THREADS", "1").output().expect("runs").status.success());
        assert_eq!(all(&place.path(&format!("{name}-one"))), whole);
    }
}

/// A photograph is known by what is in it: another of the same name and length is not taken into a data set that was begun. One of before, which does not say what was in
/// its photographs, goes on.
#[test]
fn another_photograph_of_the_same_length_is_refused() {
    let place = photographs();
    let common = format!("dataset cooke_triplet --photos photos {FRAME} --min-psnr-db 30 -o data");
    place.run(&format!("{common} --index 0 --of 3")).done();
    let photo = place.path("photos/c.npy");
    let kept = std::fs::read(&photo).expect("reads");
    let mut other = kept.clone();
    let last = other.len() - 2;
    other[last] ^= 1;
    std::fs::write(&photo, &other).expect("writes");
    place.run(&common).refused(&["dataset.json", "photos[c.npy].sha256"]);
    std::fs::write(&photo, &kept).expect("writes");
    place.run(&common).done();
    let marker = place.path("data/dataset.json");
    let mut value: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&marker).expect("reads")).expect("JSON");
    for photo in value["photos"].as_array_mut().expect("a list") {
        assert!(photo.as_object_mut().expect("an object").remove("sha256").is_some());
    }
    std::fs::write(&marker, format!("{value:#}\n")).expect("writes");
    let said = place.run(&format!("{common} --json")).done();
    assert!(said.contains("\"made\":0"), "{said}");
}

#[test]
fn slurms_array_is_a_part() {
    let place = photographs();
    let common = format!("dataset cooke_triplet --photos photos {FRAME} --min-psnr-db 30 -o data --index slurm --json");
    let mut made = 0;
    for id in [1, 2] {
        let mut command = place.command(&common);
        command.env("SLURM_ARRAY_TASK_ID", id.to_string()).env("SLURM_ARRAY_TASK_COUNT", "2");
        let output = command.env("SLURM_ARRAY_TASK_MIN", "1").output().expect("runs");
        let value: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        made += value["made"].as_u64().expect("a number");
        assert_eq!(value["complete"].as_bool(), Some(id == 2));
    }
    assert_eq!(made, 3);
    place.run(&common).refused(&["SLURM_ARRAY_TASK_ID", "not set"]);
}

#[test]
fn killed_and_damaged_sets_end_with_the_same_bits() {
    let place = photographs();
    for k in 0..9u64 {
        let image = generate(SceneKind::Mixed, k, 60, 80);
        write_picture(&place.path(&format!("photos/m{k}.png")), &image, Encoding::Srgb).expect("writes");
    }
    let frame = "--columns 96 --rows 64 --whole-field";
    let common = format!("dataset cooke_triplet two_element --photos photos {frame} --noise generic --judge 0.5 -o");
    let clock = Instant::now();
    place.run(&format!("{common} whole")).done();
    let time = clock.elapsed();
    let whole = all(&place.path("whole"));
    let rng = &mut fastrand::Rng::with_seed(8);
    let (mut met, kills) = (0, repetitions(8, 60));
    for kill in 0..kills {
        let (mut child, target) = (place.command(&format!("{common} killed")), place.path("killed"));
        let records = || std::fs::read_dir(target.join("records")).map_or(0, Iterator::count);
        let before = records();
        let mut child =
            child.stderr(std::process::Stdio::null()).stdout(std::process::Stdio::null()).spawn().expect("starts");
        let end = Instant::now() + time.mul_f64(0.1 + 0.4 * rng.f64());
        // Every other life ends soon after it has got further.
        while Instant::now() < end
            && !(kill % 2 == 1 && records() > before)
            && child.try_wait().expect("waits").is_none()
        {
            std::thread::sleep(Duration::from_millis(1));
        }
        let running = child.try_wait().expect("waits").is_none();
        child.kill().expect("killed");
        child.wait().expect("reaped");
        met += usize::from(running && target.join("dataset.json").exists() && !target.join("pairs.csv").exists());
        if target.join("pairs.csv").exists() {
            std::fs::remove_dir_all(&target).expect("removed");
        }
    }
    assert!(met > 0, "no kill met work under way");
    place.run(&format!("{common} killed")).done();
    let same = |name: &str| {
        let mut now = all(&place.path(name));
        now.retain(|path, _| !path.contains(".partial"));
        assert!(now.keys().eq(whole.keys()), "{:?}", now.keys());
        now.iter().zip(&whole).for_each(|(a, b)| assert!(a == b, "{}", a.0));
    };
    same("killed");
    // What is damaged, cut off or gone is made again, and nothing else is.
    let [first, second, third] = ["capture/000003.png", "truth/000011.png", "capture/000020.png"];
    let at = |name: &str| place.path("killed").join(name);
    let mut bytes = std::fs::read(at(first)).expect("there");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(at(first), bytes).expect("written");
    std::fs::write(at(second), b"short").expect("written");
    std::fs::remove_file(at(third)).expect("removed");
    std::fs::write(at("records/00005.json"), b"{").expect("written");
    let ran = place.run(&format!("{common} killed --json"));
    assert!(ran.err.contains("4 units"), "{}", ran.err);
    assert!(ran.done().contains("\"made\":4"));
    same("killed");
    assert!(place.run(&format!("{common} killed --json")).done().contains("\"made\":0"), "all is there");
    eprintln!("{met} of {kills} kills met work under way");
}

/// From a program: it hears how far the work is and may end it; what was made stays.
#[test]
fn a_watcher_ends_the_work_and_it_goes_on() {
    use isoplanat::dataset::{Crops, Form, Settings, make};
    let place = photographs();
    let lens = builtin::lens("cooke_triplet").and_then(|l| {
        l.changed(|l| {
            (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um, l.sensor.axis_px) = (48, 32, 750.0, [24.0, 16.0]);
        })
    });
    let settings = Settings {
        crops: Some(Crops { size: [16, 16], count: 2 }),
        form: Form::Npy,
        noise: true,
        min_psnr_db: 35.0,
        ..Settings::new(vec![("lens".into(), lens.expect("valid"))], place.path("photos"))
    };
    let shares = std::sync::Mutex::new(Vec::new());
    let ended = make(&settings, &place.path("data"), &|share, _| {
        shares.lock().expect("whole").push(share);
        share < 0.4
    });
    assert!(matches!(ended, Err(isoplanat::Error::Interrupted)), "{ended:?}");
    assert!(place.path("data/dataset.json").exists() && !place.path("data/pairs.csv").exists());
    let made = make(&settings, &place.path("data"), &|_, _| true).expect("goes on");
    assert!(made.complete && made.pairs == 6 && made.rows.len() == 6, "{made:?}");
    make(&settings, &place.path("whole"), &|_, _| true).expect("at once");
    assert_eq!(all(&place.path("data")), all(&place.path("whole")));
    let nothing = make(&settings, &place.path("none"), &|_, _| false);
    assert!(matches!(nothing, Err(isoplanat::Error::Interrupted)) && !place.path("none").exists());
}

/// The loaders that the manual prints read what its commands make.
#[cfg(unix)]
#[test]
fn the_manuals_loaders_run() {
    use std::process::Command;
    let page = std::fs::read_to_string(crate::support::root().join("docs/datasets.md")).expect("a page");
    let blocks = |language: &str| -> Vec<String> {
        let start = format!("\n```{language}\n");
        page.split(&start).skip(1).map(|rest| rest.split("\n```").next().unwrap_or(rest).to_owned()).collect()
    };
    let (shell, python) = (&blocks("sh")[0], blocks("python"));
    assert_eq!(python.len(), 2);
    let needs = ["import numpy", "import numpy, cv2, tifffile"];
    let has = |what: &str| Command::new("python3").args(["-c", what]).output().is_ok_and(|o| o.status.success());
    let there = needs.map(has);
    needs
        .iter()
        .zip(there)
        .filter(|(_, there)| !there)
        .for_each(|(what, _)| eprintln!("skipped: python3 cannot {what}"));
    if !there[0] {
        return;
    }
    let place = Workplace::new();
    let programs = Path::new(env!("CARGO_BIN_EXE_isoplanat")).parent().expect("a folder");
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap_or_default());
    let made = Command::new("sh").args(["-e", "-c", shell]).current_dir(place.path(".")).env("PATH", &path).output();
    assert!(made.expect("a shell").status.success());
    for (text, _) in python.iter().zip(there).filter(|(_, there)| *there) {
        let ran = Command::new("python3").args(["-c", text]).current_dir(place.path(".")).output().expect("runs");
        assert!(ran.status.success(), "{text}\n{}", String::from_utf8_lossy(&ran.stderr));
    }
}

/// To the bit, whole frames without noise and with it.
#[test]
fn pairs_are_what_render_makes() {
    let place = photographs();
    let lens = format!("cooke_triplet {}", "--columns 48 --rows 32 --pitch-um 750 --depth-mm 3000 --min-psnr-db 42");
    place.run(&format!("dataset {lens} --photos photos -o clean --form tiff")).done();
    place
        .run(&format!("render {} photos {} -o rendered --float", "cooke_triplet", &lens["cooke_triplet".len()..]))
        .done();
    for (line, name) in lines(&place.path("clean")).iter().zip(["a", "b", "c"]) {
        let [ours, theirs] = [place.path("clean").join(&line["capture"]), place.path(&format!("rendered/{name}.tif"))]
            .map(|p| read_linear(&p).unwrap_or_else(|e| panic!("{e}")));
        assert_eq!(ours, theirs, "{name}");
    }
    std::fs::create_dir(place.path("one")).expect("made");
    std::fs::copy(place.path("photos/a.png"), place.path("one/a.png")).expect("copied");
    for more in ["", "--flat-field", "--noise generic", "--noise generic --flat-field"] {
        place.run(&format!("dataset {lens} --photos one -o pair --form tiff --force {more}")).done();
        let line = &lines(&place.path("pair"))[0];
        let render = format!("render cooke_triplet one/a.png {}", &lens["cooke_triplet".len()..]);
        place.run(&format!("{render} -o c.tif --truth t.tif --float --seed {} --force {more}", line["seed"])).done();
        for (which, file) in [("capture", "c.tif"), ("truth", "t.tif")] {
            let ours = read_linear(&place.path("pair").join(&line[which])).expect("reads");
            assert_eq!(ours, read_linear(&place.path(file)).expect("reads"), "{which} {more}");
        }
    }
    // On pixels so small, by diffraction as well; of rays where that is asked for.
    let fine = "--columns 48 --rows 32 --pitch-um 4 --depth-mm 3000 --min-psnr-db 42";
    let [mut captures, mut pictures] = [Vec::new(), Vec::new()];
    for how in ["", "--diffraction off"] {
        let told = crate::support::read_json(
            &place
                .run(&format!("dataset cooke_triplet {fine} --photos one -o fine --form tiff --force --json {how}"))
                .done(),
        );
        assert_eq!(told["plans"][0]["diffraction"] != false, how.is_empty(), "{told}");
        place.run(&format!("render cooke_triplet one/a.png {fine} -o fine.tif --float --force {how}")).done();
        captures.push(read_linear(&place.path("fine").join(&lines(&place.path("fine"))[0]["capture"])).expect("reads"));
        pictures.push(read_linear(&place.path("fine.tif")).expect("reads"));
    }
    assert_eq!(captures, pictures);
    assert_ne!(captures[0], captures[1]);
    // A crop is the whole frame's part, but for how blocks are cut.
    place.run(&format!("dataset {lens} --photos one -o crop --form tiff --crop 20x12 --crops 4")).done();
    place.run(&format!("dataset {lens} --photos one -o frame --form tiff")).done();
    let read = |folder: &str, name: &str| read_linear(&place.path(folder).join(name)).expect("reads");
    for line in lines(&place.path("crop")) {
        let (r, c) = (number(&line, "row") as usize, number(&line, "column") as usize);
        for which in ["capture", "truth"] {
            let whole = read("frame", &format!("{which}/000000.tif"));
            let part = read("crop", &line[which]);
            let off =
                (&whole.slice(ndarray::s![.., r..r + 12, c..c + 20]) - &part).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(off < 2e-6, "{which} at {r}, {c}: {off}");
        }
    }
}

/// Noise of the generic sensor (full well 6000 electrons, read noise 4) on a grey wall, at the pixels that each colour has on the mosaic: its variance
/// in white-balanced units is (n E/6000 + (4/6000)²) / n², E the irradiance and n the response to white.
#[test]
fn noise_has_the_sensors_variance() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("grey")).expect("made");
    let grey = Array3::from_elem((3, 8, 12), 0.4f32);
    write_picture(&place.path("grey/a.npy"), &grey, Encoding::Linear).expect("writes");
    let frame = "--columns 240 --rows 160 --pitch-um 30 --form tiff";
    place.run(&format!("dataset cooke_triplet --photos grey {frame} -o clean")).done();
    for (level, name) in [(1.0, "one"), (3.0, "three")] {
        let noise = format!("--noise generic --noise-level {level}");
        place.run(&format!("dataset cooke_triplet --photos grey {frame} {noise} -o {name}")).done();
        let line = &lines(&place.path(name))[0];
        let (shot, read) = (level * level / 6000.0, level * 4.0 / 6000.0);
        assert!((number(line, "shot_variance") / shot - 1.0).abs() < 1e-12);
        assert!((number(line, "read_deviation") / read - 1.0).abs() < 1e-12);
        let at = |folder: &str| read_linear(&place.path(folder).join("capture/000000.tif")).expect("reads");
        let (clean, noisy) = (at("clean"), at(name));
        for (channel, n) in [0.55, 1.0, 0.7].into_iter().enumerate() {
            let (mut sum, mut square, mut count) = (0.0, 0.0, 0.0);
            for ((k, r, c), v) in noisy.indexed_iter() {
                // RGGB.
                if k != channel || (r & 1) + (c & 1) != channel {
                    continue;
                }
                let light = f64::from(clean[[k, r, c]]);
                let sigma = (n * light * shot + read * read).sqrt() / n;
                let z = (f64::from(*v) - light) / sigma;
                (sum, square, count) = (sum + z, square + z * z, count + 1.0);
            }
            // Five standard errors of each.
            assert!((sum / count).abs() < 5.0 / f64::sqrt(count), "channel {channel}: mean {}", sum / count);
            assert!(
                (square / count - 1.0).abs() < 5.0 * f64::sqrt(2.0 / count),
                "channel {channel}: {}",
                square / count
            );
        }
    }
}

/// The truth shows a texel where the chief ray of its object point lands; of fine scenes it shows means, not single texels.
#[test]
fn truth_is_the_distorted_scene() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("ramp")).expect("made");
    let (rows, cols) = (64, 96);
    let ramp = Array3::from_shape_fn((3, rows, cols), |(_, r, c)| 0.1 + 0.005 * c as f32 + 0.003 * r as f32);
    write_picture(&place.path("ramp/a.npy"), &ramp, Encoding::Linear).expect("writes");
    let lens = builtin::lens("two_element").expect("shipped");
    place.run("dataset two_element --photos ramp --columns 96 --rows 64 --pitch-um 300 --form tiff -o data").done();
    let truth = read_linear(&place.path("data/truth/000000.tif")).expect("reads");
    let frame = Frame::centred(96, 64, 0.3).expect("valid");
    let system = System::new(&lens, lens.wavelengths.primary_nm);
    // Texels a unit of slope: one a pixel next to the axis.
    let landing = |slope: [f64; 2]| {
        let object = ObjectPoint::from_slope(-glam::DVec2::from(slope), lens.object_vergence);
        let aimed = Aimer::new(&system).and_then(|a| a.aim(object, glam::DVec2::ZERO, None)).expect("light");
        let hit = trace(&system, aimed.ray, system.image(), &mut Vec::new()).expect("lands");
        frame.pixel_from_sensor_mm([hit.at.point.x, hit.at.point.y])
    };
    let per_slope = (landing([1e-4, 0.0])[0] - 48.0) / 1e-4;
    let mut farthest = 0.0f64;
    for texel in [[50.0, 30.0], [70.0, 40.0], [30.0, 10.0], [85.0, 55.0], [8.0, 7.0]] {
        let slope = [(texel[0] - 48.0) / per_slope, -(texel[1] - 32.0) / per_slope];
        let [x, y] = landing(slope);
        farthest = farthest.max((x - texel[0]).hypot(y - texel[1]));
        // Bilinear between pixel centres: the ramp is smooth, and so is the distortion.
        let (c, r) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (fx, fy) = ((x - 0.5 - c) as f32, (y - 0.5 - r) as f32);
        let at = |dr: usize, dc: usize| truth[[1, r as usize + dr, c as usize + dc]];
        let seen = (1.0 - fy) * ((1.0 - fx) * at(0, 0) + fx * at(0, 1)) + fy * ((1.0 - fx) * at(1, 0) + fx * at(1, 1));
        let meant = 0.1 + 0.005 * (texel[0] - 0.5) as f32 + 0.003 * (texel[1] - 0.5) as f32;
        assert!((seen - meant).abs() < 2e-5, "{texel:?} at {x:.3}, {y:.3}: {seen} for {meant}");
    }
    assert!(farthest > 0.2, "the lens distorts by {farthest} pixels: too little to tell");
    // Stripes of a texel at four texels a pixel: half of white and nothing else, where single texels would show moiré.
    let stripes = Array3::from_shape_fn((3, 4 * 64, 4 * 96), |(_, _, c)| (c % 2) as f32);
    std::fs::create_dir(place.path("fine")).expect("made");
    write_picture(&place.path("fine/a.npy"), &stripes, Encoding::Linear).expect("writes");
    place.run("dataset two_element --photos fine --columns 96 --rows 64 --pitch-um 100 --form tiff -o means").done();
    let truth = read_linear(&place.path("means/truth/000000.tif")).expect("reads");
    assert!(truth.iter().all(|v| (v - 0.5).abs() < 1e-6), "{truth}");
}

#[test]
fn the_share_that_is_judged_holds_the_promise() {
    let place = photographs();
    for k in 0..5u64 {
        let image = generate(SceneKind::Facades, 20 + k, 96, 128);
        write_picture(&place.path(&format!("photos/f{k}.png")), &image, Encoding::Srgb).expect("writes");
    }
    let frame = "--columns 96 --rows 64 --whole-field";
    let run = format!(
        "dataset cooke_triplet two_element double_gauss --photos photos {frame} --judge 0.5 --min-psnr-db 42 -o data --json"
    );
    let value: serde_json::Value = serde_json::from_str(&place.run(&run).done()).expect("JSON");
    let lines = lines(&place.path("data"));
    let judged: Vec<_> = lines.iter().filter(|l| !l["judged_psnr_db"].is_empty()).collect();
    assert_eq!((lines.len(), judged.len()), (24, 12), "half of them");
    assert_eq!(value["judged"].as_u64(), Some(12));
    let mut held = 0;
    for line in &judged {
        let [db, low, high] = ["judged_psnr_db", "judged_low_db", "judged_high_db"].map(|c| number(line, c));
        assert!(low <= db && db <= high && number(line, "predicted_psnr_db") >= 42.0, "{line:?}");
        held += u64::from(high >= 42.0);
    }
    assert_eq!((value["held"].as_u64(), held), (Some(held), 12), "{judged:?}");
    // All together they leave little open.
    let ends: Vec<f64> = (0..2).map(|k| value["judged_psnr_db_interval"][k].as_f64().expect("a number")).collect();
    assert!(ends[0] >= 42.0 && ends[1] - ends[0] < 1.0, "{ends:?}");
    // What is worse than promised is seen: the same pictures against a promise that they cannot hold.
    let worst = judged.iter().map(|l| number(l, "judged_high_db")).fold(f64::INFINITY, f64::min);
    assert!(worst < 70.0, "no judgement says anything: {worst}");
}

#[test]
fn bad_input_is_refused_in_a_line_and_nothing_is_written() {
    let place = photographs();
    place.write("photo.png", "no picture").write("no-lens.toml", "schema = 1\n");
    for (name, file) in [("none", None), ("text", Some("a.png")), ("cut", Some("b.png"))] {
        std::fs::create_dir(place.path(name)).expect("made");
        let png = std::fs::read(place.path("photos/a.png")).expect("there");
        if let Some(file) = file {
            let bytes = if name == "cut" { &png[..png.len() / 2] } else { b"no picture" };
            std::fs::write(place.path(name).join(file), bytes).expect("written");
        }
    }
    // A lens with a tilt.
    let text = std::fs::read_to_string(crate::support::root().join("models/lenses/two_element.toml")).expect("there");
    place.write("tilted.toml", text.replacen("[[surface]]", "[[surface]]\ntilt_deg = [1.0, 0.0, 0.0]", 1));
    std::fs::create_dir(place.path("other")).expect("made");
    std::fs::write(place.path("other/mine.txt"), "mine").expect("written");
    let before = all(&place.path("."));
    let good = format!("dataset cooke_triplet --photos photos {FRAME} -o data");
    for (words, expected) in [
        (good.replace("photos photos", "photos none"), vec!["none", "no pictures"]),
        (good.replace("photos photos", "photos nowhere"), vec!["nowhere"]),
        (good.replace("photos photos", "photos text"), vec!["a.png"]),
        (good.replace("photos photos", "photos cut"), vec!["b.png"]),
        (good.replace("cooke_triplet", "no-lens.toml"), vec!["no-lens.toml"]),
        (good.replace("cooke_triplet", "cooke_triplet nothing"), vec!["nothing"]),
        (good.replace("cooke_triplet", "tilted.toml"), vec!["tilted.toml"]),
        (format!("{good} --depth-mm 20"), vec!["cooke_triplet"]),
        (format!("{good} --depth-mm 1000,-5"), vec!["--depth-mm", "-5"]),
        (format!("{good} --depth-mm 1000,1000"), vec!["--depth-mm", "twice"]),
        (format!("{good} --index 3 --of 3"), vec!["--index", "0 to 2"]),
        (format!("{good} --index 0 --of 0"), vec!["--of"]),
        (format!("{good} --index 1"), vec!["--of"]),
        (format!("{good} --of 2"), vec!["--index"]),
        (format!("{good} --index 0 --of 2 --force"), vec!["--force", "--of 2"]),
        (format!("{good} --crop 49"), vec!["--crop", "49x49", "48 × 32"]),
        (format!("{good} --crop 8 --crops 0"), vec!["--crops", "0"]),
        (format!("{good} --judge 1.5"), vec!["--judge", "1.5"]),
        (format!("{good} --judge -0.1"), vec!["--judge"]),
        (format!("{good} --judge 1 --judge-samples 2"), vec!["--judge-samples"]),
        (format!("{good} --min-psnr-db 100"), vec!["--min-psnr-db"]),
        (format!("{good} --noise nowhere.toml"), vec!["nowhere.toml"]),
        (format!("{good} --judge 0.5 --diffraction on"), vec!["--diffraction", "--judge 0.5", "off"]),
        (format!("{good} --noise generic --noise-level 2,1"), vec!["--noise-level"]),
        (format!("{good} --noise generic --noise-level -1"), vec!["--noise-level"]),
        (format!("{good} --texels-per-pixel 0"), vec!["--texels-per-pixel"]),
        (format!("{good} --shard 0"), vec!["--shard"]),
        (format!("{good} --memory-gib 0.001"), vec!["memory"]),
        (good.replace("-o data", "-o other"), vec!["other", "exists"]),
        (format!("{} --force", good.replace("-o data", "-o other")), vec!["other", "dataset.json"]),
        (good.replace("-o data", "-o photo.png"), vec!["photo.png"]),
        (good.replace("-o data", "-o photos"), vec!["photos"]),
    ] {
        place.run(&words).refused(&expected);
        assert!(all(&place.path(".")) == before, "{words} left something behind");
    }
    place.run(&good).done();
    place.run(&format!("{good} --seed 2")).refused(&["dataset.json", "seed", "1", "2"]);
    place.run(&format!("{good} --form tiff")).refused(&["dataset.json", "form"]);
    place.run(&format!("{good} --diffraction off")).refused(&["dataset.json", "diffraction", "auto"]);
    std::fs::remove_file(place.path("photos/c.npy")).expect("removed");
    place.run(&good).refused(&["dataset.json"]);
    place.run(&format!("{good} --force")).done();
    assert_eq!(lines(&place.path("data")).len(), 2);
    for (words, expected) in [
        ("render cooke_triplet photos -o out --truth t.png", "--truth"),
        ("render cooke_triplet mixed -o a.png --truth a.png", "a.png"),
        ("render cooke_triplet mixed -o a.png --truth t.xyz", "xyz"),
        ("render cooke_triplet mixed -o a.png --truth t.png --method monte-carlo", "--truth"),
        ("render cooke_triplet mixed -o a.png --noise generic --method monte-carlo", "--noise"),
    ] {
        place.run(words).refused(&[expected]);
    }
}
