//! `isoplanat compare`, and designs by sensor images: what they write, refuse, and go on with.

use serde_json::Value;

use crate::support::Workplace;

/// A design by images of some seconds.
const TASK: &str = r#"
schema = 1
lens = "three_element"
sensor = { columns = 48, rows = 48, pitch_um = 32.0 }
scenes = 2
patch_px = 32
batch = 1
steps = 6
checks = 2
base_width = 4
warm_start = false
depths_mm = [700.0, 1000.0, 1500.0]
sensor_loss = { reference_mm = 1000.0, weights = [3.0, 0.3, 1.0] }
[train]
scales = 2
base_width = 4
patch_px = 32
region_px = 40
batch = 2
pairs = 4
loss = "l1"
steps = 4
sample_steps = 0
"#;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A lens by its images at three distances, then its network for all of them: a run that other commands read, whose page names the distances.
#[test]
fn a_lens_by_its_images_is_a_run_like_any_other() {
    let place = Workplace::new();
    place.write("task.toml", TASK);
    let said = place.run("design task.toml -o run").done();
    assert!(said.contains("the lowest distance"), "{said}");
    let page = std::fs::read_to_string(place.path("run/report.html")).expect("a page");
    for part in ["from 700 mm", "from 1500 mm", "none: the lens is judged by its own images", "the lowest of them"] {
        assert!(page.contains(part), "{part}");
    }
    let text = |file: &str| std::fs::read_to_string(place.path(file)).expect("a file");
    assert_ne!(text("run/lens.toml"), text("run/lens-first.toml"), "the lens moved");
    place.run("design --resume -o run").done();
    place.run("train run -o net").done();
    // The design itself has no network.
    for command in ["evaluate run", "export run -o kit-of-run"] {
        place.run(command).refused(&["run", "loss.sensor", "isoplanat train"]);
    }
    // The distances of the task, where nobody says more; one of them where somebody does.
    let rows = |command: &str| {
        let value = json(&place.run(command).done());
        let rows = value["rows"].as_array().expect("rows").clone();
        let mut all: Vec<f64> = rows.iter().filter_map(|r| r["depth_mm"].as_f64()).collect();
        all.dedup();
        all
    };
    assert_eq!(rows("evaluate net --fields 1 --patch 32 --json"), [700.0, 1000.0, 1500.0]);
    #[cfg(feature = "deploy")]
    {
        place.run("export net -o kit").done();
        let kit = text("kit/kit.toml");
        assert!(kit.contains("distance_m") && kit.contains("0.7") && kit.contains("1.5"), "{kit}");
    }
    place.run("train run -o near --depths-mm 700").done();
    assert_eq!(rows("evaluate near --fields 1 --patch 32 --json"), [700.0]);
    place.run("train run -o none --depths-mm 0").refused(&["depths_mm", "0"]);
    for (more, said) in [
        (("reference_mm = 1000.0", "reference_mm = 900.0"), "reference_mm"),
        (("weights = [3.0, 0.3, 1.0]", "weights = [3.0]"), "weights"),
        (("weights = [3.0, 0.3, 1.0]", "weights = [3.0, 0.3, 1.0], ssim = 0.0"), "ssim"),
        (("depths_mm = [700.0, 1000.0, 1500.0]", "depths_mm = [1000.0]"), "depths_mm"),
        (("batch = 1\n", "batch = 1\nfreeze_lens = true\n"), "freeze_lens"),
        (("batch = 1\n", "batch = 1\ninputs = [\"field\"]\n"), "inputs"),
    ] {
        let bad = TASK.replacen(more.0, more.1, 1);
        assert_ne!(bad, TASK);
        place.write("bad.toml", bad);
        place.run("design bad.toml -o none").refused(&["bad.toml", said]);
    }
    place.run("design task.toml -o none --validate run").refused(&["--validate", "network"]);
    place.run("design --check edof --json").done();
}

/// A page without its pictures, whose base64 may spell anything.
fn told_of(page: &str) -> String {
    let mut parts = page.split("base64,");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.split_once('"').map_or("", |p| p.1))
}

/// The text of a shipped lens.
fn lens_of(name: &str) -> &'static str {
    isoplanat::lens::builtin::text(name).expect("shipped")
}

/// Rows for everybody, one of them a lens that has no place; figures that are read again, and a folder that is asked for in the same words or not at all.
#[test]
fn a_comparison_goes_on_where_it_was() {
    let place = Workplace::new();
    place.write("task.toml", TASK);
    let window = r#"
schema = 1
name = "window"
source = "made for this test"
aperture = { stop_semi_diameter_mm = 5.0 }
object = { distance_mm = 1000.0 }
field = { max_angle_deg = 1.0 }
wavelengths = { nm = [587.5618], weights = [1.0], primary_nm = 587.5618 }
sensor = { columns = 48, rows = 48, pitch_um = 32.0 }
[[surface]]
radius_mm = inf
thickness_mm = 3.0
medium = "N-BK7"
semi_diameter_mm = 10.0
stop = true
[[surface]]
radius_mm = inf
thickness_mm = 50.0
medium = "air"
semi_diameter_mm = 10.0
"#;
    place.write("window.toml", window);
    let command = "compare task.toml --against ac254_050_a,window.toml --fields 1 --patch 32 -o cmp";
    let first = json(&place.run(&format!("{command} --json")).done());
    let rows = first["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 3);
    assert!(rows[0]["overall"]["lowest_db"].as_f64().is_some_and(|v| v > 5.0));
    assert!(rows[1]["first_ahead"]["mean_db"].as_f64().is_some());
    assert!(rows[1]["first_ahead"]["within_db"].as_f64().is_some(), "judged at the same places");
    assert!(rows[2]["refused"].as_str().is_some_and(|t| t.contains("focal length")), "{}", rows[2]);
    let page = std::fs::read_to_string(place.path("cmp/comparison.html")).expect("a page");
    assert!(page.contains("not judged") && page.contains("Over the distance") && !told_of(&page).contains("NaN"));
    // Of the task's focal length and aperture.
    let inspect = |lens: &str| json(&place.run(&format!("inspect {lens} --json")).done());
    let (own, other) = (inspect("three_element"), inspect("cmp/02-ac254_050_a/lens.toml"));
    for key in ["effective_focal_length_mm", "f_number"] {
        let [a, b] = [&own, &other].map(|v| v[key].as_f64().expect("a number"));
        assert!((a / b - 1.0).abs() < 1e-9, "{key}: {a} {b}");
    }
    place.run(command).refused(&["cmp", "--force"]);
    place.run(&format!("{command} --resume --seed 2")).refused(&["compare.json", "another protocol"]);
    // What is lost is done again, the rest is read: the same figures.
    std::fs::remove_file(place.path("cmp/02-ac254_050_a/evaluation.toml")).expect("there");
    let again = json(&place.run(&format!("{command} --resume --json")).done());
    assert_eq!(again["rows"], first["rows"]);
    // Slanted edges: curves at every distance, or the reason why there are none; another comparison than the one without them.
    place.run(&format!("{command} --resume --edges 1")).refused(&["compare.json", "another edges"]);
    let wide = TASK.replace("columns = 48, rows = 48, pitch_um = 32.0", "columns = 160, rows = 160, pitch_um = 10.0");
    place.write("wide.toml", wide);
    let edges = "compare wide.toml --against ac254_050_a --fields 1 --patch 32 --edges 1 --edge-rays 32 -o edges";
    let told = place.run(edges).done();
    assert!(told.contains("MTF at 1/4 cy/px"), "{told}");
    let found = json(&place.run(&format!("{edges} --resume --json")).done());
    let mut measured = 0;
    for row in found["rows"].as_array().expect("rows") {
        let all = row["edges"].as_array().expect("distances");
        assert_eq!(
            all.iter().map(|e| e["depth_mm"].as_f64()).collect::<Vec<_>>(),
            [Some(700.0), Some(1000.0), Some(1500.0)]
        );
        for at in all {
            let curves = at["curves"].as_array().expect("curves");
            let whole = |c: &&Value| {
                ["capture", "reconstruction"].iter().all(|k| c[*k].as_array().is_some_and(|p| p.len() > 8))
            };
            let full = curves.iter().filter(whole).count();
            assert!(full == 2 || at["missing"].as_array().is_some_and(|m| !m.is_empty()), "{at}");
            measured += full;
        }
    }
    assert!(measured >= 4, "{measured}");
    let page = std::fs::read_to_string(place.path("edges/comparison.html")).expect("a page");
    assert!(page.contains("MTF before and after") && !told_of(&page).contains("NaN"));
    place.run("compare task.toml --against nolens -o other").refused(&["nolens"]);
    place.run("compare task.toml --rates 2 -o other").refused(&["--rates", "2"]);
    // What nobody can be judged by is told before anybody is trained.
    place.run("compare task.toml --fields 0 -o other").refused(&["zones", "0"]);
    place.run("compare task.toml --depths-mm 0 -o other").refused(&["depth", "0"]);
    // Another lens under the same name is another comparison; lenses of one name are told apart.
    place.write("l.toml", lens_of("al2550_a"));
    let twice = "compare task.toml --against l.toml,al2550_a --fields 1 --patch 32 -o twice";
    let page = place.run(twice).done();
    assert!(page.contains("(02-l)") && page.contains("(03-al2550_a)"), "{page}");
    place.write("l.toml", lens_of("cooke_triplet"));
    place.run(&format!("{twice} --resume")).refused(&["compare.json", "cameras"]);
    place.run("compare window.toml two_element -o other").refused(&["focal length"]);
    assert!(!place.path("other").exists());
    // Two networks a lens, and a rate of two for each.
    let networks = format!("{} -o two --networks paper,guided --rates 1e-3,2e-3", command.replace(" -o cmp", ""));
    let text = place.run(&networks).done();
    assert!(text.contains("paper") && text.contains("guided"), "{text}");
    assert!(place.path("two/04-ac254_050_a-guided/network/filters.npz").is_file());
}
