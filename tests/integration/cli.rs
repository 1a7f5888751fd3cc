//! Every command of the program on good and on bad input: exit codes, one-line errors, nothing half-written.

use serde_json::json;

use crate::support::{Workplace, read_json, root};

const LENS: &str = include_str!("../../models/lenses/two_element.toml");

#[test]
fn help_and_version_are_no_errors_and_nonsense_is_bad_input() {
    let place = Workplace::new();
    assert!(place.run("--help").done().contains("Commands:"));
    assert!(place.run("--version").done().starts_with("isoplanat "));
    assert_eq!(place.run("frobnicate").code, 2);
    assert_eq!(place.run("inspect").code, 2);
    assert_eq!(place.run("inspect cooke_triplet --frobnicate").code, 2);
}

/// The published focal length of a shipped lens and of the same lens as a file.
#[test]
fn inspect_reports_first_order_data() {
    let place = Workplace::new();
    for lens in ["cooke_triplet".to_owned(), root().join("models/lenses/cooke_triplet.toml").display().to_string()] {
        let json = read_json(&place.run(&format!("inspect {lens} --json")).done());
        assert!((json["effective_focal_length_mm"].as_f64().expect("number") - 50.021_350_719_4).abs() < 1e-6);
        assert!((json["back_focal_length_mm"].as_f64().expect("number") - 42.436_440_197_5).abs() < 1e-6);
        assert!((json["f_number"].as_f64().expect("number") - 5.002_135_07).abs() < 1e-6);
        assert_eq!(json["surfaces"].as_array().expect("list").len(), 6);
    }
    let text = place.run("inspect double_gauss").done();
    assert!(text.contains("effective focal length") && text.contains("S_IV"), "{text}");
}

#[test]
fn every_shipped_lens_can_be_inspected() {
    let place = Workplace::new();
    for (name, _) in isoplanat::lens::builtin::LENSES {
        assert_eq!(read_json(&place.run(&format!("inspect {name} --json")).done())["schema"], json!(1), "{name}");
    }
}

/// Every shipped lens is healthy; the table and the JSON say the same.
#[test]
fn check_passes_the_shipped_lenses() {
    let place = Workplace::new();
    for (name, _) in isoplanat::lens::builtin::LENSES {
        let json = read_json(&place.run(&format!("check {name} --json")).done());
        assert_eq!(json["passes"], json!(true), "{name}");
        let figures = json["figures"].as_array().expect("list");
        assert!(figures.len() > 15 && figures.iter().all(|f| f["value"].is_number() || f["value"].is_null()), "{name}");
        assert!(json["variables"].as_array().expect("list").iter().all(|v| v["effect_mm"].is_number()), "{name}");
    }
    let text = place.run("check cooke_triplet").done();
    assert!(text.contains("aiming residual") && text.trim_end().ends_with("passes"), "{text}");
}

/// A rim at total reflection fails the check with exit code 1, after the report; a file that is no lens is bad input.
#[test]
fn check_fails_a_lens_at_its_limits() {
    let place = Workplace::new();
    // Collimated light in glass on a rear surface of radius 9: sin θ = r/9, critical at r = 6. The stop asks for more.
    let sick = LENS
        .replacen("radius_mm = 18.5", "radius_mm = inf", 1)
        .replacen("radius_mm = 27.5", "radius_mm = -9.0", 1)
        .replacen("entrance_pupil_diameter_mm = 12.5", "entrance_pupil_diameter_mm = 18.0", 1)
        .replacen("max_angle_deg = 30.0", "max_angle_deg = 0.0", 1)
        .replacen("semi_diameter_mm = 8.7", "semi_diameter_mm = 8.5", 1);
    assert_ne!(sick, LENS);
    place.write("sick.toml", sick);
    let ran = place.run("check sick.toml");
    assert_eq!(ran.code, 1, "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("FAIL") && ran.err.contains("check"), "{}{}", ran.out, ran.err);
    let failed = ran.out.lines().find(|l| l.contains("FAIL")).expect("a line");
    assert!(failed.starts_with("points of the stop that no clear ray from the axis reaches"), "{failed}");
    place.write("no.toml", "schema = 1");
    assert_eq!(place.run("check no.toml").code, 2);
}

/// Tilts, elements and freeform terms: read, traced with their derivatives, refused where symmetry is needed.
#[test]
fn displaced_and_freeform_surfaces_are_traced_and_not_imaged() {
    let place = Workplace::new();
    let lens = LENS.replacen(
        "radius_mm = 18.5",
        "radius_mm = 18.5\ntilt_deg = [0.2, 0.0, 0.0]\ndecentre_mm = [0.0, 0.05]\n\
         zernike = { radius_mm = 12.0, terms = [0.0, 0.0, 0.0, 0.001] }\n\
         xy = { radius_mm = 12.0, terms = { x1y2 = 0.002 } }\nasphere = { a3 = 1e-6 }",
        1,
    ) + "\n[[element]]\nfirst = 3\nlast = 4\ntilt_deg = [0.0, 0.1, 0.0]\n";
    place.write("lens.toml", lens);
    place.write(
        "rays.json",
        r#"{"wavelength_nm": 550.0, "rays": [{"origin_mm": [0.5, 1.0, -5.0], "direction": [0, 0, 1]}]}"#,
    );
    let json = read_json(&place.run("trace lens.toml --rays rays.json --gradient").done());
    let gradient = json["rays"][0]["gradient"].as_array().expect("list");
    for name in ["surface[0].a3", "surface[0].z4", "surface[0].x1y2", "surface[0].tilt_x", "element[0].decentre_y"] {
        let entry = gradient.iter().find(|g| g["parameter"] == name).unwrap_or_else(|| panic!("{name}"));
        assert!(entry["dy"].as_f64().expect("number") != 0.0, "{name}");
    }
    assert!(place.run("inspect lens.toml").done().contains("displaced"));
    assert_eq!(place.run("check lens.toml").code, 0);
    for command in ["psf lens.toml -o x.npz", "render lens.toml facades -o x.png"] {
        let ran = place.run(command);
        assert!(ran.code == 2 && ran.err.contains("rotationally symmetric"), "{command}: {}", ran.err);
    }
    // Spots are of rays alone, and that is told once.
    let spots = place.run("spot lens.toml");
    assert!(spots.code == 0 && spots.err.matches("encircled energy by diffraction").count() == 1, "{}", spots.err);
    for (from, to, said) in [
        ("x1y2", "x9y9", "x9y9"),
        ("a3", "a41", "a41"),
        ("last = 4", "last = 9", "element[0]"),
        ("tilt_deg = [0.2", "tilt_deg = [120.0", "tilt_deg"),
    ] {
        let text = std::fs::read_to_string(place.path("lens.toml")).expect("readable");
        place.write("bad.toml", text.replacen(from, to, 1));
        let ran = place.run("inspect bad.toml");
        assert!(ran.code == 2 && ran.err.contains(said), "{to}: {}", ran.err);
    }
}

/// The form other programs rely on: one entry per surface and the image plane, from a file or from stdin.
#[test]
fn trace_answers_in_the_documented_form() {
    let place = Workplace::new();
    let rays = r#"{"wavelength_nm": 587.5618, "rays": [
        {"origin_mm": [0.0, 0.0, -5.0], "direction": [0.0, 0.0, 2.0]},
        {"origin_mm": [0.0, 9.9, -5.0], "direction": [0.0, 0.0, 1.0]},
        {"origin_mm": [0.0, 90.0, -5.0], "direction": [0.0, 0.0, 1.0]}]}"#;
    place.write("rays.json", rays);
    let answer = read_json(&place.run("trace cooke_triplet --rays rays.json").done());
    let axial = &answer["rays"][0];
    assert_eq!(axial["status"], "ok");
    assert_eq!(axial["surfaces"].as_array().expect("list").len(), 7);
    assert_eq!(axial["surfaces"][6]["position_mm"], json!([0.0, 0.0, 0.0]));
    assert_eq!(axial["surfaces"][6]["direction"], json!([0.0, 0.0, 1.0]));
    assert_eq!(axial["surfaces"][0]["optical_path_mm"], json!(5.0));
    assert_eq!(answer["rays"][2]["status"], "missed");
    assert_eq!(answer["rays"][2]["surface"], json!(0));
    // Clear apertures count on request only.
    let clipped = read_json(&place.run_with_input("trace cooke_triplet --clip --gradient --rays -", rays).done());
    assert_eq!(clipped["rays"][1]["status"], "vignetted");
    assert!(clipped["rays"][1]["gradient"].is_null());
    let gradient = clipped["rays"][0]["gradient"].as_array().expect("list");
    let names: Vec<&str> = gradient.iter().map(|g| g["parameter"].as_str().expect("name")).collect();
    for name in ["surface[0].curvature", "surface[5].thickness", "surface[2].index", "surface[1].conic"] {
        assert!(names.contains(&name), "{name} in {names:?}");
    }
    place.run("trace cooke_triplet --rays rays.json -o out.json").done();
    let text = std::fs::read_to_string(place.path("out.json")).expect("written");
    assert_eq!(read_json(&text), answer);
}

#[test]
fn psf_writes_kernels_and_a_picture_and_overwrites_only_with_force() {
    let place = Workplace::new();
    let command =
        "psf three_element -o k.npz --png k.png --depth-mm 700,inf --fields 2 --size 21 --pitch-um 12 --rays 200";
    let text = place.run(command).done();
    assert!(text.contains("21 × 21 pixels of 12 µm"), "{text}");
    assert_eq!(place.files(), ["k.npz", "k.png"]);
    let mut npz = ndarray_npy::NpzReader::new(std::fs::File::open(place.path("k.npz")).expect("opens")).expect("npz");
    let kernels: ndarray::Array5<f32> = npz.by_name("kernels").expect("kernels");
    assert_eq!(kernels.shape(), [2, 2, 3, 21, 21]);
    let depth: ndarray::Array1<f64> = npz.by_name("depth_mm").expect("depths");
    assert_eq!(depth.to_vec(), [700.0, f64::INFINITY]);
    let outside: ndarray::Array3<f64> = npz.by_name("outside").expect("outside");
    for d in 0..2 {
        let sum: f64 = kernels.slice(ndarray::s![d, 0, 1, .., ..]).iter().map(|v| f64::from(*v)).sum();
        assert!((sum + outside[[d, 0, 1]] - 1.0).abs() < 1e-5);
    }
    let before = std::fs::metadata(place.path("k.npz")).expect("there").modified().expect("time");
    place.run(command).refused(&["k.npz", "--force"]);
    assert_eq!(std::fs::metadata(place.path("k.npz")).expect("there").modified().expect("time"), before);
    place.run(&format!("{command} --force")).done();
    assert_eq!(place.files(), ["k.npz", "k.png"]);
}

/// File, place, value and what is allowed, in one line; nothing is written.
#[test]
fn bad_lenses_are_refused_by_file_place_and_value() {
    let cases = [
        ("radius_mm = 18.5", "radius_mm = 18.5\ncolour = 3", vec!["line 14", "colour"]),
        ("thickness_mm = 8.0", "thickness = 8.0", vec!["line", "thickness"]),
        ("semi_diameter_mm = 12.0", "semi_diameter_mm = 19.0", vec!["surface[0]", "semi_diameter_mm", "19", "18.5"]),
        ("thickness_mm = 8.0", "thickness_mm = 0.1", vec!["surface[0] and surface[1]", "cross"]),
        ("radius_mm = 18.5", "radius_mm = 0.0", vec!["surface[0]", "radius_mm", "0"]),
        ("schema = 1", "schema = 9", vec!["schema", "9"]),
        ("schema = 1", "schema = ", vec!["line"]),
        ("\"air\"", "\"N-BK8\"", vec!["surface[1]", "N-BK8"]),
    ];
    for (from, to, mut expected) in cases {
        let place = Workplace::new();
        assert!(LENS.contains(from));
        place.write("bad.toml", LENS.replacen(from, to, 1)).write("rays.json", "{}");
        expected.push("bad.toml");
        place.run("inspect bad.toml").refused(&expected);
        place.run("psf bad.toml -o out.npz").refused(&expected);
        place.run("trace bad.toml --rays rays.json -o out.json").refused(&expected);
        assert_eq!(place.files(), ["bad.toml", "rays.json"], "nothing is written");
    }
}

#[test]
fn unreadable_and_unwritable_files_are_named() {
    let place = Workplace::new();
    place.write("bytes.toml", [0xff, 0xfe, 0x00, 0x80]).write("rays.json", "{\"wavelength_nm\": 550}");
    place.run("inspect none.toml").refused(&["none.toml"]);
    place.run("inspect no_such_lens").refused(&["no_such_lens", "cooke_triplet"]);
    place.run("inspect bytes.toml").refused(&["bytes.toml"]);
    place.run("inspect .").refused(&["."]);
    place.run("trace cooke_triplet --rays rays.json").refused(&["rays.json", "line 1", "rays"]);
    place.run("trace cooke_triplet --rays none.json").refused(&["none.json"]);
    let bad = r#"{"wavelength_nm": 587.5618, "rays": [{"origin_mm": [0, 0, 0], "direction": [0, 0, 0]}]}"#;
    place.run_with_input("trace cooke_triplet --rays -", bad).refused(&["<stdin>", "rays[0]", "direction"]);
    place.run("psf cooke_triplet -o none/k.npz").refused(&["none/k.npz"]);
    place.run("psf cooke_triplet -o k.npz --size 20").refused(&["--size", "20", "odd"]);
    place.run("psf cooke_triplet -o k.npz --depth-mm -5").refused(&["--depth-mm"]);
    place.run("psf cooke_triplet -o k.npz --depth-mm 5,0").refused(&["--depth-mm", "0"]);
    place.run("psf cooke_triplet -o k.npz --wavelength-nm 5").refused(&["--wavelength-nm", "5"]);
    assert_eq!(place.files(), ["bytes.toml", "rays.json"]);
}

/// A field that the sensor does not see ends where it does; a lens whose picture folds is bad input, not a fault of the program.
#[test]
fn a_lens_that_cannot_image_its_field_is_refused() {
    let place = Workplace::new();
    place.write("wide.toml", LENS.replacen("max_angle_deg = 30.0", "max_angle_deg = 85.0", 1));
    let shown = place.run("psf wide.toml -o k.npz --size 31").done();
    let last =
        shown.lines().nth(5).and_then(|l| l.split_whitespace().nth(1)).map(|v| v.parse::<f64>().expect("degrees"));
    // The corner of 4096 x 512 pixels of 6 µm.
    assert!(last.is_some_and(|v| (26.0..27.5).contains(&v)), "{shown}");
    // A stop two focal lengths before a lens of 50 mm: chief rays cross the axis before a sensor 150 mm behind it.
    let surface = |curvature: f64, thickness: f64, medium: &str| {
        format!(
            "[[surface]]\ncurvature_per_mm = {curvature}\nthickness_mm = {thickness}\nmedium = {medium}\nsemi_diameter_mm = 20\n"
        )
    };
    let head = &LENS[..LENS.find("[[surface]]").expect("surfaces")];
    let glass = "{ n_d = 1.5, v_d = 60.0 }";
    let rest = [surface(0.02, 10.0, glass), surface(-0.02, 150.0, "\"air\"")].concat();
    let stop = "[[surface]]\ncurvature_per_mm = 0\nthickness_mm = 100\nmedium = \"air\"\nsemi_diameter_mm = 6.25\nstop = true\n";
    place.write("folded.toml", format!("{head}{stop}{rest}"));
    place.run("psf folded.toml -o l.npz").refused(&["folded.toml", "height"]);
    assert_eq!(place.files(), ["folded.toml", "k.npz", "wide.toml"]);
}

/// Whoever reads our output may stop reading.
#[test]
fn a_closed_pipe_is_no_error() {
    let place = Workplace::new();
    let mut command = place.command("inspect phone --json");
    let mut child =
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().expect("starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("ends");
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
}

/// Both renderers through the program on a small frame: the same picture, to what few rays can show.
#[test]
fn render_writes_the_picture_of_either_method() {
    let place = Workplace::new();
    let frame = "--columns 48 --rows 32 --pitch-um 60";
    place.run(&format!("render two_element leaves_are_no_scene -o a.png {frame}")).refused(&["SCENE", "dead_leaves"]);
    let json = read_json(&place.run(&format!("render two_element dead_leaves:3 -o a.tif {frame} --json")).done());
    assert!(json["figures"]["largest_energy_outside"].as_f64().expect("number") < 0.01, "{json}");
    let slow = "--method monte-carlo --samples 16";
    place.run(&format!("render two_element dead_leaves:3 -o b.tif {frame} {slow}")).done();
    assert_eq!(place.files(), ["a.tif", "b.tif"]);
    let [a, b] = ["a.tif", "b.tif"].map(|f| isoplanat::imaging::files::read_linear(&place.path(f)).expect("reads"));
    assert_eq!(a.dim(), (3, 32, 48));
    let psnr = isoplanat::imaging::metrics::psnr_linear(a.view(), b.view());
    assert!(psnr > 25.0, "{psnr:.1} dB");
    place.run(&format!("render two_element dead_leaves -o a.tif {frame}")).refused(&["a.tif", "--force"]);
    // A picture of one's own as the scene.
    place.run(&format!("render two_element a.tif -o c.png {frame}")).done();
}

/// A plan that is explained, a part of a frame that equals the same part of the whole, and values out of range.
#[test]
fn render_plans_and_explains() {
    let place = Workplace::new();
    let frame = "--columns 64 --rows 48 --pitch-um 40";
    let asked = format!("render cooke_triplet facades:3 -o a.tif {frame} --min-psnr-db 45 --explain");
    let text = place.run(&asked).done();
    for word in ["predicted ", "kernels ", "work left", "bound", "PSF nodes", "wavelengths", "apertures"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let json = read_json(&place.run(&format!("{asked} --json --force")).done());
    assert!(json["figures"]["predicted_psnr_db"].as_f64().expect("number") >= 45.0, "{json}");
    let skips = json["figures"]["skips"].as_array().expect("list");
    assert!(skips.iter().all(|s| s["bound"].as_f64().is_some_and(|b| b < 0.02)), "{json}");
    place.run(&format!("render cooke_triplet facades:3 -o all.tif {frame} --everything")).done();
    place.run(&format!("render cooke_triplet facades:3 -o part.tif {frame} --everything --crop 20,10,24,16")).done();
    let [a, all, part] = ["a.tif", "all.tif", "part.tif"]
        .map(|f| isoplanat::imaging::files::read_linear(&place.path(f)).expect("reads"));
    let psnr = isoplanat::imaging::metrics::psnr_linear(a.view(), all.view());
    assert!(psnr > 45.0, "{psnr:.1} dB");
    let cut = all.slice(ndarray::s![.., 10..26, 20..44]);
    let psnr = isoplanat::imaging::metrics::psnr_linear(part.view(), cut);
    assert!(psnr > 55.0, "{psnr:.1} dB");
    for (option, words) in [
        ("--min-psnr-db nan", ["--min-psnr-db", "10 to 80"]),
        ("--min-psnr-db 500", ["--min-psnr-db", "500"]),
        ("--crop 0,0,65,48", ["--crop", "64 × 48"]),
        ("--crop 60,0,5,1", ["--crop", "60,0,5,1"]),
    ] {
        place.run(&format!("render cooke_triplet facades:3 -o x.tif {frame} {option}")).refused(&words);
    }
    assert_eq!(place.run(&format!("render cooke_triplet facades:3 -o x.tif {frame} --crop 1,2,3")).code, 2);
    assert_eq!(place.files(), ["a.tif", "all.tif", "part.tif"]);
}

/// Every row in every form; rays cost what they cost.
#[test]
fn accuracy_reports_error_beside_run_time() {
    let place = Workplace::new();
    let command = "accuracy cooke_triplet facades:3 --columns 24 --rows 16 --pitch-um 60 --reference-samples 64";
    let json = read_json(&place.run(&format!("{command} -o page.html --svg plot.svg --csv rows.csv --json")).done());
    let rows = json["rows"].as_array().expect("list");
    for row in rows {
        assert!(row["seconds"].as_f64().is_some_and(|s| s > 0.0), "{row}");
        assert!(row["relative_l2"].as_f64().is_some() && row["worst_pixel"].as_f64().is_some(), "{row}");
        for key in ["method", "settings", "psnr_db", "peak_bytes", "pareto"] {
            assert!(row.get(key).is_some(), "{key}: {row}");
        }
    }
    assert!(rows.iter().any(|r| r["pareto"] == true));
    let of = |method: &str| rows.iter().filter(|r| r["method"] == method).count();
    assert!(of("psf-grid") > 20 && of("monte-carlo") == 3 && of("monte-carlo, plain") == 3);
    assert_eq!(place.files(), ["page.html", "plot.svg", "rows.csv"]);
    let text = |f: &str| std::fs::read_to_string(place.path(f)).expect("reads");
    assert_eq!(text("rows.csv").lines().count(), rows.len() + 1);
    assert!(text("page.html").contains("<svg") && text("plot.svg").starts_with("<svg"));
    place.run(&format!("{command} -o page.html")).refused(&["page.html", "--force"]);
}

#[test]
fn capture_writes_a_raw_file_that_holds_its_sensor() {
    let place = Workplace::new();
    let command = "capture three_element text -o x.dng --columns 32 --rows 24 --pitch-um 30 --samples 4";
    place.run(command).done();
    assert_eq!(place.files(), ["x.dng"]);
    let bytes = std::fs::read(place.path("x.dng")).expect("reads");
    assert!(bytes.starts_with(b"II*\0") || bytes.starts_with(b"MM\0*"), "a TIFF");
    place.run(command).refused(&["x.dng", "--force"]);
}

#[test]
fn bad_scenes_and_rasters_are_refused_and_nothing_is_written() {
    let place = Workplace::new();
    place.write("scene.png", b"no picture").write("sensor.toml", "schema = 1\nname = 3\n");
    for (arguments, expected) in [
        ("render cooke_triplet scene.png -o a.png", ["scene.png", "picture"]),
        ("render cooke_triplet text:x -o a.png", ["SCENE", "seed"]),
        ("render cooke_triplet text -o none/a.png", ["none/a.png", "folder"]),
        ("render cooke_triplet text -o a.png --depth-mm 0 --columns 16 --rows 16", ["--depth-mm", "0"]),
        ("render cooke_triplet text -o a.png --columns 0 --rows 16", ["columns", "0"]),
        ("render cooke_triplet text -o a.png --columns 16 --rows 16 --pitch-um 0", ["pitch", "0"]),
        ("capture cooke_triplet text -o a.dng --calibration sensor.toml", ["sensor.toml", "line 2"]),
        ("capture no_such_lens text -o a.dng", ["no_such_lens", "cooke_triplet"]),
    ] {
        place.run(arguments).refused(&expected);
    }
    assert_eq!(place.files(), ["scene.png", "sensor.toml"]);
}

/// A run of two steps, its kit, and what each refuses.
#[cfg(all(feature = "train", feature = "deploy"))]
#[test]
fn design_and_export_make_a_run_and_a_kit() {
    let place = Workplace::new();
    let task = "schema = 1\nlens = \"two_element\"\nscenes = 1\nsteps = 2\npatch_px = 32\nbatch = 1\nbase_width = 4\n\
                sensor = { columns = 96, rows = 64, pitch_um = 60.0, axis_px = [0.0, 0.0] }\n";
    place.write("task.toml", task).write("bad.toml", task.replace("scenes", "scnes"));
    place.run("design bad.toml -o run").refused(&["bad.toml", "line 3", "scnes"]);
    place.run("design none.toml -o run").refused(&["none.toml"]);
    place.run("export run -o kit").refused(&["run"]);
    assert_eq!(place.files(), ["bad.toml", "task.toml"]);
    place.run("design task.toml -o run").done();
    place.run("design task.toml -o run").refused(&["run", "--force"]);
    place.run("export run -o kit").done();
    place.run("export run -o kit").refused(&["kit", "--force"]);
    assert_eq!(place.files(), ["bad.toml", "kit", "run", "task.toml"]);
    for file in ["kit/kit.toml", "kit/model.onnx", "run/lens.toml", "run/network.safetensors", "run/log.csv"] {
        assert!(place.path(file).is_file(), "{file}");
    }
    // Half the bytes, and what that costs; a tile that keeps nothing is refused.
    let said = place.run("export run -o half --f16").done();
    assert!(said.contains("weights as f16") && said.contains("rms") && said.contains(" dB"), "{said}");
    let size = |file: &str| std::fs::metadata(place.path(file)).expect("there").len();
    assert!(size("half/model.onnx") < size("kit/model.onnx") * 3 / 4);
    place.run("export run -o none --tile 48").refused(&["overlap_px", "48"]);
    assert!(!place.path("none").exists());
}

/// The kit of `run`, through the camera's own steps, shows the edges that the run showed; a kit of another lens is refused.
#[cfg(all(feature = "train", feature = "deploy"))]
fn edges_through_a_kit(place: &Workplace, by_run: &[serde_json::Value]) {
    place.run("export run -o kit").done();
    let report = "report run/lens.toml --rays 64 --measure=2 --measure-rays 256 --kit kit";
    let found = read_json(&place.run(&format!("{report} -o kit.html --json")).done());
    let by = found["measured"]["reconstruction_by"].as_str().expect("named");
    assert!(by.contains("ONNX Runtime") || by.contains("tract"), "{by}");
    assert!(std::fs::read_to_string(place.path("kit.html")).expect("written").contains(by));
    let by_kit = found["measured"]["places"].as_array().expect("places");
    assert_eq!(by_kit.len(), by_run.len());
    for (ours, theirs) in by_kit.iter().zip(by_run) {
        for k in 0..2 {
            let curve = |of: &serde_json::Value| -> Vec<f64> {
                let points = of["edges"][k]["reconstruction"]["mtf_cy_per_mm_value_uncertainty"].as_array();
                points.expect("a curve").iter().map(|p| p[1].as_f64().expect("a number")).collect()
            };
            // Rays and noise are others.
            let off = curve(ours).iter().zip(curve(theirs)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 0.08, "{off}: {ours} {theirs}");
        }
    }
    // A kit's folder with its lens, as the shipped ones are.
    std::fs::copy(place.path("run/lens.toml"), place.path("kit/lens.toml")).expect("copied");
    let own = read_json(&place.run("report kit --rays 64 --measure=1 --measure-rays 64 --json").done());
    assert_eq!(own["measured"]["reconstruction_by"], *by);
    // From another distance it is still the kit's lens.
    place.run("report run/lens.toml --rays 64 --depth-mm 900 --kit kit --measure=1 -o far.html").done();
    place.run("report cooke_triplet --rays 64 --kit kit -o no.html").refused(&["cooke_triplet", "the kit's"]);
    place.run("report run/lens.toml --kit none -o no.html").refused(&["none", "kit.toml"]);
    place.run("report run/lens.toml cooke_triplet --kit kit -o no.html").refused(&["--kit"]);
    place.run("report cooke_triplet --onnxruntime x -o no.html").refused(&["--onnxruntime", "kit"]);
    assert!(!place.path("no.html").exists());
}

/// A run of two steps, judged on built-in scenes and on photographs; what is refused before any work, and what stays.
#[cfg(feature = "train")]
#[test]
fn evaluate_judges_a_run_by_field_and_depth() {
    let place = Workplace::new();
    let task = "schema = 1\nlens = \"two_element\"\nscenes = 1\nsteps = 2\npatch_px = 32\nbatch = 1\nbase_width = 4\n\
                sensor = { columns = 96, rows = 64, pitch_um = 60.0, axis_px = [0.0, 0.0] }\n";
    place.write("task.toml", task).write("old.csv", "kept").write("old.svg", "kept");
    std::fs::create_dir(place.path("empty")).expect("made");
    std::fs::create_dir(place.path("photos")).expect("made");
    place.write("photos/mine.txt", "not a picture");
    place.run("design task.toml -o run").done();
    place.run("evaluate nothing").refused(&["nothing", "task.toml"]);
    place.run("evaluate run --photos nowhere").refused(&["nowhere"]);
    place.run("evaluate run --photos empty").refused(&["empty", "no pictures"]);
    place.run("evaluate run --csv old.csv").refused(&["old.csv", "--force"]);
    place.run("evaluate run --plot old.svg").refused(&["old.svg", "--force"]);
    place.run("evaluate run --pictures photos").refused(&["photos", "--force"]);
    place.run("evaluate run --pictures photos --force").refused(&["photos"]);
    place.run("evaluate run --csv none/a.csv").refused(&["none/a.csv"]);
    for (bad, said) in [
        ("--fields 0", "zones"),
        ("--patch 30", "patch"),
        ("--depths-mm 500,-1", "depth"),
        ("--scene cats", "color_chart"),
    ] {
        let ran = place.run(&format!("evaluate run {bad}"));
        assert!(ran.code == 2 && ran.out.is_empty() && ran.err.contains(said), "{bad}: {ran:?}");
    }
    assert_eq!(std::fs::read(place.path("old.csv")).expect("there"), b"kept");

    // The run's page: what slanted edges show before and after its network.
    let said = place.run("report run --rays 64 --measure=2 --measure-rays 256 -o page.html --json").done();
    let found: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    let places = found["measured"]["places"].as_array().expect("places");
    assert_eq!(places.len(), 2);
    for edge in places.iter().flat_map(|p| p["edges"].as_array().expect("edges")) {
        // Two steps leave the network near the capture: it has an edge, in the same place.
        let [before, after] = [&edge["capture"], &edge["reconstruction"]];
        let first = after["mtf_cy_per_mm_value_uncertainty"][0][1].as_f64().expect("a curve");
        assert!((first - 1.0).abs() < 1e-9, "{edge}");
        let normal = |of: &serde_json::Value| of["edge_normal_deg"].as_f64().expect("an angle");
        assert!((normal(before) - normal(after)).abs() < 2.0, "{edge}");
    }
    assert!(std::fs::read_to_string(place.path("page.html")).expect("written").contains("T, reconstruction"));

    #[cfg(feature = "deploy")]
    edges_through_a_kit(&place, places);

    let photo = ndarray::Array3::from_shape_fn((3, 90, 120), |(k, r, c)| ((7 * k + r * c) % 23) as f32 / 23.0);
    for name in ["a.png", "b.png"] {
        isoplanat::imaging::files::write_png8(&place.path("photos").join(name), &photo).expect("written");
    }
    let command = "evaluate run --photos photos --fields 2 --depths-mm 800,1000 --patch 32 --json";
    let ran = place.run(&format!("{command} --csv a.csv --plot a.svg --pictures sheets"));
    let json = read_json(&ran.done());
    let rows = json["rows"].as_array().expect("list");
    assert_eq!((rows.len(), &json["count"], &json["context_px"]), (6, &json!(2), &json!(24)));
    for row in rows {
        for of in ["capture", "reconstruction"] {
            let db = row[of]["psnr_db"]["mean"].as_f64().expect("number");
            let ssim = row[of]["ssim"]["mean"].as_f64().expect("number");
            assert!((5.0..60.0).contains(&db) && (-0.1..=1.0).contains(&ssim), "{row}");
            let [delta_e, shift] =
                ["delta_e", "colour_shift"].map(|key| row[of][key]["mean"].as_f64().expect("number"));
            assert!((0.0..100.0).contains(&delta_e) && shift >= 0.0 && shift < delta_e, "{row}");
        }
    }
    let csv = std::fs::read_to_string(place.path("a.csv")).expect("written");
    assert_eq!((csv.lines().count(), csv.lines().next().map(|l| l.split(',').count())), (7, Some(36)), "{csv}");
    assert!(std::fs::read_to_string(place.path("a.svg")).expect("written").contains("800 mm"));
    let sheet = place.path("sheets").join("depth-800mm-field-2.png");
    let sheet = isoplanat::imaging::files::read_linear(&sheet).expect("a picture");
    // Two pictures below the names of four columns.
    assert_eq!(sheet.dim(), (3, 20 + 2 * 32 + 6, 4 * 32 + 3 * 6));
    let verdicts = json["verdicts"].as_array().expect("a verdict a distance");
    assert!(verdicts.len() == 2 && verdicts.iter().all(|v| v["over_wiener"]["psnr_db"]["mean"].is_number()), "{json}");
    // The same numbers again; built-in scenes say so.
    assert_eq!(read_json(&place.run(command).done()), json);
    // Against itself nothing differs; of two pictures no interval is known. By field angle, with means to some.
    let paired = read_json(&place.run(&format!("{command} --against run --to-degrees 6 --means-degrees 2,4")).done());
    let differences = paired["differences"].as_array().expect("list");
    assert_eq!((differences.len(), paired["rows"].as_array().map(Vec::len)), (10, Some(10)));
    assert!(differences.iter().all(|d| d["psnr_db"]["mean"] == json!(0.0) && d["psnr_interval_db"][0].is_null()));
    place.run("evaluate run --photos photos --to-degrees 50").refused(&["field angle", "50", "corner"]);
    place.run("evaluate run --photos photos --against nothing").refused(&["nothing"]);
    let ran = place.run("evaluate run --fields 1 --patch 32");
    assert!(ran.err.contains("street scenes") && ran.out.contains("mean") && ran.code == 0, "{ran:?}");
    let ran = place.run("evaluate run --fields 1 --patch 32 --scene color-chart");
    assert!(ran.err.contains("color_chart scenes") && ran.out.contains("network ΔE") && ran.code == 0, "{ran:?}");
}

#[cfg(not(feature = "train"))]
#[test]
fn commands_of_a_missing_feature_say_how_to_get_it() {
    let place = Workplace::new();
    for command in
        ["demo --quick", "design task.toml -o run", "train task.toml -o run", "evaluate run", "export run -o kit"]
    {
        place.run(command).refused(&["this build lacks the feature `train`; build with --features train"]);
    }
}
