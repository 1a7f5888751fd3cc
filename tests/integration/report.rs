//! `report`, `mtf`, `spot`, `distortion`: what they write, and what they say of lenses that lack something; spots against other programs.

use glam::{DVec2, DVec3};
use isoplanat::analysis::beam::{Beam, Landing};
use isoplanat::analysis::curves::over_field;
use isoplanat::analysis::spot::{best_focus, geometric_mtf, spot};
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, Ray};
use serde_json::Value;

use crate::golden::{LENSES, number, numbers, read, system};
use crate::support::Workplace;

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

/// A page without its pictures, whose letters mean nothing.
fn words(page: &str) -> String {
    let mut parts = page.split("base64,");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.find('"').map_or("", |end| &part[end..]))
}

/// The golden grid of rays of one field, traced.
fn landings(golden: &Value, field: &Value, wavelength: usize) -> Vec<Landing> {
    let s = system(golden, wavelength);
    let launch = &field["launch"];
    let [centre, direction] = ["center", "direction"].map(|k| DVec3::from_slice(&numbers(&launch[k])));
    let half = DVec2::new(number(&launch["half_width_x"]), number(&launch["half_width_y"]));
    let places = (0..20).map(|i| (f64::from(i) + 0.5) / 20.0 * 2.0 - 1.0).collect::<Vec<f64>>();
    let points =
        places.iter().flat_map(|x| places.iter().map(|y| DVec2::new(*x, *y))).filter(|u| u.length_squared() <= 1.0);
    points
        .map(|u| {
            let origin = centre + (u * half).extend(0.0);
            let hit = trace(&s, Ray { origin, direction }, s.image(), &mut Vec::new()).expect("lands");
            let slope = hit.direction.truncate() / hit.direction.z;
            Landing { stop: u, at: hit.at.point.truncate(), slope, weight: 1.0 }
        })
        .collect()
}

/// Centroids, rms radii, best foci and MTF of ray-optics, ray by ray.
#[test]
fn spots_agree_with_rayoptics() {
    let (mut count, mut worst) = (0, 0.0f64);
    for name in LENSES {
        let Some(golden) = read(name) else { return };
        let frequencies = numbers(&golden["spots"]["mtf_frequencies_cy_per_mm"]);
        for field in golden["spots"]["fields"].as_array().expect("list") {
            for (w, of) in field["per_wavelength"].as_array().expect("list").iter().enumerate() {
                let theirs = &of["rayoptics"];
                let rays = landings(&golden, field, w);
                let found = spot(&rays, 0.0).expect("light");
                let shift = best_focus(&rays).expect("rays that meet")[2];
                let mut differences = vec![
                    (found.centroid.y - number(&theirs["centroid_y"]), 1e-9),
                    (found.rms - number(&theirs["rms_nominal"]), 1e-9),
                    // The least of a parabola: known to the root of what its values are.
                    (shift - number(&theirs["best_focus_shift"]), 1e-6),
                    (spot(&rays, shift).expect("light").rms - number(&theirs["rms_best_focus"]), 1e-9),
                ];
                for (along, key) in [(DVec2::Y, "geometric_mtf_tangential"), (DVec2::X, "geometric_mtf_sagittal")] {
                    for (f, value) in frequencies.iter().zip(numbers(&theirs[key])) {
                        differences.push((geometric_mtf(&rays, along, *f, 0.0) - value, 1e-9));
                    }
                }
                for (k, (difference, limit)) in differences.iter().enumerate() {
                    assert!(difference.abs() <= *limit, "{name} {} {w} {k}: {difference:e}", field["field_deg"]);
                    worst = worst.max(difference.abs() / limit);
                }
                count += 1;
            }
        }
    }
    eprintln!("{count} golden spots: worst difference {worst:e} of what is allowed");
}

/// Distortion of every golden lens: chief rays, and per cent against `f tan θ`.
#[test]
fn distortion_agrees_with_the_golden_values() {
    let mut count = 0;
    for name in LENSES {
        let Some(golden) = read(name) else { return };
        let s = system(&golden, 1);
        let focal = number(&golden["paraxial_d_line"]["reference_40digit"]["efl"]);
        for field in golden["distortion_d_line"]["fields"].as_array().expect("list") {
            let angle = number(&field["field_deg"]).to_radians();
            let object = ObjectPoint::infinite(DVec3::new(0.0, angle.sin(), angle.cos()));
            let height = Beam::new(&s, object, &[]).chief.expect("lands").at.y;
            let off = height - number(&field["chief_image_y"]);
            assert!(off.abs() < 1e-9, "{name} {}: {off:e} mm", field["field_deg"]);
            let percent = 100.0 * (height / (focal * angle.tan()) - 1.0) - number(&field["distortion_percent"]);
            assert!(percent.abs() < 1e-7, "{name} {}: {percent:e} %", field["field_deg"]);
            count += 1;
        }
    }
    assert!(count >= 10, "{count}");
    // The program's own figure, of the one of them that is shipped.
    let Some(golden) = read("cooke_triplet") else { return };
    let lens = isoplanat::lens::builtin::lens("cooke_triplet").expect("shipped");
    for field in golden["distortion_d_line"]["fields"].as_array().expect("list") {
        let rows = over_field(&lens, &[], &[number(&field["field_deg"])]);
        let off = rows[0].distortion_of_focal_length - number(&field["distortion_percent"]);
        assert!(off.abs() < 1e-6, "{}: {off:e} %", field["field_deg"]);
    }
}

#[test]
fn a_report_has_its_sections_and_says_the_same_in_all_forms() {
    let place = Workplace::new();
    let found = json(&place.run("report cooke_triplet -o page.html --csv rows.csv --json").done());
    assert_eq!(place.files(), ["page.html", "rows.csv"]);
    let text = |name: &str| std::fs::read_to_string(place.path(name)).expect("reads");
    let page = text("page.html");
    for section in [
        "layout",
        "third-order-sums",
        "spots",
        "ray-and-path-fans",
        "wavefronts",
        "over-the-field",
        "point-spread-functions",
        "modulation-transfer",
        "numerical-check",
        "accuracy-and-time",
    ] {
        assert!(page.contains(&format!("<section id=\"{section}\">")), "{section}");
    }
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    assert!(!words(&page).contains("NaN") && !page.contains("src=\"http"));
    assert_eq!(found["missing"], serde_json::json!([]));
    // What a page shows under the pointer are the numbers of the JSON form, which are those of the table.
    let curve = &found["plots"]["distortion"]["series"][1]["points"];
    let last = numbers(&curve[curve.as_array().expect("points").len() - 1]);
    let shown = format!(
        "{},{}",
        isoplanat::report::table::significant(last[0], 6),
        isoplanat::report::table::significant(last[1], 6)
    );
    assert!(page.contains(&shown), "{shown}");
    assert!(text("rows.csv").contains(&format!("distortion,against f tan θ,{},{}", last[0], last[1])));
    // Distortion of the golden file.
    assert!((last[0] - 20.0).abs() < 1e-6 && (last[1] + 0.374_134_557).abs() < 1e-6, "{last:?}");
    let fields = found["fields"].as_array().expect("fields");
    assert_eq!(fields.len(), 5);
    for f in fields {
        let (rms, change) = (number(&f["rms_mm"]), number(&f["rms_change_mm"]));
        assert!(rms > 1e-3 && change < 0.02 * rms, "{f}");
    }
    place.run("report cooke_triplet -o page.html").refused(&["page.html", "--force"]);
}

#[test]
fn two_lenses_stand_side_by_side() {
    let place = Workplace::new();
    let found = json(&place.run("report two_element ac254_050_a --rays 200 -o page.html --json").done());
    assert_eq!(found["lenses"].as_array().map(Vec::len), Some(2));
    let page = std::fs::read_to_string(place.path("page.html")).expect("reads");
    for lens in found["lenses"].as_array().expect("two") {
        let name = lens["lens"]["name"].as_str().expect("a name");
        assert!(page.matches(&isoplanat::report::svg::escape(name)).count() > 5, "{name}");
    }
}

#[test]
fn lenses_that_lack_something_get_a_page_that_says_so() {
    let place = Workplace::new();
    let text = std::fs::read_to_string(crate::support::root().join("models/lenses/cooke_triplet.toml")).expect("reads");
    let lines: Vec<&str> = text.lines().collect();
    let last = lines.iter().rposition(|l| l.starts_with("semi_diameter_mm")).expect("a rim");
    // Tilted: no curves over a radius.
    let mut tilted: Vec<String> = lines.iter().map(|l| (*l).to_owned()).collect();
    tilted.insert(last + 1, "tilt_deg = [0.5, 0.0, 0.0]".into());
    place.write("tilted.toml", tilted.join("\n"));
    // Plane plates: no focus anywhere.
    place.write(
        "afocal.toml",
        "schema = 1\nname = \"plate\"\nsource = \"test\"\naperture = { entrance_pupil_diameter_mm = 5.0 }\nobject = { distance_mm = inf }\n\
         field = { max_angle_deg = 50.0 }\nwavelengths = { nm = [587.5618], weights = [1], primary_nm = 587.5618 }\n\
         sensor = { columns = 600, rows = 400, pitch_um = 20.0 }\n[[surface]]\nradius_mm = inf\nthickness_mm = 3.0\nmedium = \"N-BK7\"\n\
         semi_diameter_mm = 30.0\nstop = true\n[[surface]]\nradius_mm = inf\nthickness_mm = 5.0\nmedium = \"air\"\nsemi_diameter_mm = 30.0\n",
    );
    // At 60° no rim of the triplet lets light through; a plate makes no image.
    for (lens, angle, says) in [
        ("cooke_triplet", "--max-angle-deg 60", "at 60° no light"),
        ("tilted.toml", "", "symmetr"),
        ("afocal.toml", "", "one direction"),
    ] {
        let ran = place.run(&format!("report {lens} --rays 100 {angle} -o {lens}.html --json"));
        let found = json(&ran.done());
        let missing = found["missing"].to_string();
        assert!(missing.contains(says), "{lens}: {missing}");
        let page = std::fs::read_to_string(place.path(&format!("{lens}.html"))).expect("reads");
        let page = words(&page);
        let series = found["plots"]["distortion"]["series"].as_array().map(Vec::len);
        assert_eq!(series, Some(if lens == "afocal.toml" { 1 } else { 2 }), "{lens}");
        assert!(page.contains("modulation-transfer") && !page.contains("NaN"), "{lens}");
    }
}

#[test]
fn single_analyses_print_tables_json_arrays_and_drawings() {
    let place = Workplace::new();
    for (command, heading, key) in
        [("mtf", "cycles/mm", "mtf"), ("spot", "rms/µm", "rms_focus"), ("distortion", "distortion/%", "distortion")]
    {
        let ran = place.run(&format!("{command} cooke_triplet --rays 200"));
        assert_eq!(ran.err.contains("warning: it does nothing: --rays"), command == "distortion", "{}", ran.err);
        assert!(ran.done().contains(heading));
        let found = json(
            &place
                .run(&format!("{command} cooke_triplet --rays 200 --json --svg {command}.svg --npz {command}.npz --csv {command}.csv"))
                .done(),
        );
        assert!(
            found["plots"][key]["series"][0]["points"].as_array().is_some_and(|p| p.len() > 5),
            "{command}: {found}"
        );
        let text = |end: &str| std::fs::read(place.path(&format!("{command}.{end}"))).expect("reads");
        assert!(
            text("svg").starts_with(b"<svg")
                && text("npz").starts_with(b"PK")
                && text("csv").starts_with(b"plot,series")
        );
        place.run(&format!("{command} cooke_triplet --svg {command}.svg")).refused(&["svg", "--force"]);
    }
}

/// Fields that a lens file states are looked at, and stay in what is written.
#[test]
fn stated_fields_are_looked_at() {
    let place = Workplace::new();
    place.run("convert cooke_triplet a.zmx").done();
    let file = std::fs::read_to_string(place.path("a.zmx")).expect("there");
    let file =
        file.replace("FTYP 0 0 3 3\nXFLN 0 0 0\nYFLN 0 14 20", "FTYP 0 0 5 3\nXFLN 0 0 0 0 0\nYFLN 0 6 13 -13 20");
    place.write("b.zmx", &file);
    let angles = |arguments: &str| -> Vec<f64> {
        let found = json(&place.run(&format!("spot {arguments} --rays 200 --json")).done());
        found["fields"].as_array().expect("fields").iter().map(|f| f["angle_deg"].as_f64().expect("an angle")).collect()
    };
    assert_eq!(angles("b.zmx"), [0.0, 6.0, 13.0, 20.0]);
    assert_eq!(angles("b.zmx --max-angle-deg 8"), [0.0, 2.0, 4.0, 6.0, 8.0]);
    assert_eq!(angles("b.zmx --fields-deg 3,1"), [1.0, 3.0]);
    place.run("optimize b.zmx -o c.zmx --iterations 2").done();
    assert_eq!(angles("c.zmx"), [0.0, 6.0, 13.0, 20.0]);
    place.run("convert c.zmx d.seq").done();
    assert_eq!(angles("d.seq"), [0.0, 6.0, 13.0, 20.0]);
    place.run("convert d.seq e.toml").done();
    let text = std::fs::read_to_string(place.path("e.toml")).expect("there");
    assert!(text.contains("angles_deg = [") && text.contains("its sensor is assumed"), "{text}");
    // On a sensor that ends before them fields go as far as it does.
    let place_of = |key: &str| text.lines().find(|l| l.starts_with(key)).expect("a key").to_owned();
    place.write("f.toml", text.replace(&place_of("pitch_um"), "pitch_um = 5.0"));
    let seen = angles("f.toml");
    assert!(seen.len() == 5 && seen[4] < 15.0, "{seen:?}");
}

/// The MTF at frequencies of one's own is that at the same frequencies of another look, in table, arrays and curves over the field.
#[test]
fn mtf_is_told_at_frequencies_that_are_asked_for() {
    let place = Workplace::new();
    let table = |options: &str| -> Vec<Vec<f64>> {
        let text = place.run(&format!("mtf cooke_triplet --fields-deg 0,12 {options}")).done();
        let rows = text.lines().map(|l| l.split_whitespace().filter_map(|v| v.parse().ok()).collect::<Vec<f64>>());
        rows.filter(|r| r.len() == 5).collect()
    };
    // Of rays, then by diffraction; even frequencies to 40 are its multiples.
    let (asked, even) = (table("--cycles-per-mm 33,17.5,10"), table("--max-cycles-per-mm 40"));
    assert_eq!(asked.iter().map(|r| r[0]).collect::<Vec<_>>(), [10.0, 17.5, 33.0, 10.0, 17.5, 33.0]);
    for row in &asked {
        for other in even.iter().filter(|o| (o[0] - row[0]).abs() < 1e-9) {
            let near = |of: &[f64]| of[1..].iter().zip(&row[1..]).all(|(a, b)| (a - b).abs() < 2e-4);
            assert!(even.iter().filter(|o| o[0] == other[0]).any(|o| near(o)), "{row:?}");
        }
    }
    assert_eq!(even.iter().filter(|r| r[0] == 33.0).count(), 2, "the frequencies meet");
    // Beyond the sensor's Nyquist frequency curves go as far.
    let json = place.run("mtf cooke_triplet --fields-deg 0 --cycles-per-mm 200,30 --json").done();
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let points = json["plots"]["mtf"]["series"][0]["points"].as_array().expect("points");
    assert_eq!(points.last().expect("some")[0], 200.0);
    let over_field = json["plots"]["mtf_field"]["series"].as_array().expect("series");
    assert_eq!(over_field[0]["name"], "30/mm T");
    place.run("mtf cooke_triplet --cycles-per-mm 10,-3").refused(&["--cycles-per-mm", "-3", "0 to 100000"]);
}

#[test]
fn bad_input_of_reports_is_named() {
    let place = Workplace::new();
    place.run("report cooke_triplet").refused(&["output", "-o"]);
    place.run("report cooke_triplet -o a.html --depth-mm -5").refused(&["--depth-mm", "-5"]);
    place.run("report cooke_triplet -o a.html --max-angle-deg nan").refused(&["--max-angle-deg", "NaN"]);
    place.run("mtf cooke_triplet --max-cycles-per-mm 0").refused(&["--max-cycles-per-mm", "0.001"]);
    place.run("report none_such -o a.html").refused(&["none_such"]);
    place.run("report cooke_triplet two_element --csv a.csv").refused(&["--csv", "one lens"]);
    assert!(place.files().is_empty());
}

/// Slanted edges in the reference renderer's captures show what rays predict, and every form says the same.
#[test]
fn a_measured_report_closes_the_loop() {
    let place = Workplace::new();
    let found =
        json(&place.run("report cooke_triplet --rays 100 --measure=1 --measure-rays 256 -o page.html --json").done());
    assert_eq!(found["missing"], serde_json::json!([]));
    let edges = found["measured"]["places"][0]["edges"].as_array().expect("edges");
    assert_eq!(edges.len(), 2);
    for edge in edges {
        assert!(edge["reconstruction"].is_null(), "no network: {edge}");
        let [design, capture] = [&edge["design_cy_per_mm_value"], &edge["capture"]["mtf_cy_per_mm_value_uncertainty"]]
            .map(|c| numbers(&c[10]));
        assert_eq!(design[0], capture[0]);
        assert!((design[1] - capture[1]).abs() < 0.01 && design[1] > 0.9, "{design:?} {capture:?}");
        assert!(number(&edge["capture"]["mtf50_cy_per_px"]) > 0.2);
    }
    let page = std::fs::read_to_string(place.path("page.html")).expect("reads");
    assert!(page.contains("<section id=\"measured-mtf\">") && !words(&page).contains("NaN"));
    let many = place.run("report cooke_triplet --measure=9 --json");
    assert!(many.code == 2 && many.err.contains("--measure") && many.err.contains("1 to 6"), "{many:?}");
    // A frame too small for an edge leaves no place; one that the sensor cannot see at all is refused by name.
    let text = std::fs::read_to_string(crate::support::root().join("models/lenses/cooke_triplet.toml")).expect("reads");
    let small = text.lines().map(|l| match l.split_once('=') {
        Some((key, _)) if key.trim() == "sensor" => "sensor = { columns = 20, rows = 20, pitch_um = 6.0 }".to_owned(),
        _ => l.to_owned(),
    });
    place.write("small.toml", small.collect::<Vec<_>>().join("\n"));
    let found = json(&place.run("report small.toml --rays 100 --measure --json").done());
    assert!(found["missing"].to_string().contains("24 × 24"), "{}", found["missing"]);
    std::fs::create_dir(place.path("empty")).expect("creates");
    place.run("report empty --json").refused(&["empty"]);
}
