//! Lenses on the way from scratch: an f-number for one run, focus for a distance, clear semi-diameters left out, bounds that take in the sensor.

use serde_json::Value;

use crate::support::Workplace;

fn json(place: &Workplace, arguments: &str) -> Value {
    let ran = place.run(arguments);
    assert_eq!(ran.code, 0, "{arguments}: {}", ran.err);
    serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{arguments}: {e}: {}", ran.out))
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key}: {value}"))
}

/// `--f-number` is what the listing then says, and what a file with that stop gives; the lens's file is not touched.
#[test]
fn an_f_number_for_one_run() {
    let place = Workplace::new();
    for name in ["cooke_triplet", "double_gauss"] {
        let own = json(&place, &format!("inspect {name} --json"));
        for f_number in [8.0, 16.0] {
            let at = json(&place, &format!("inspect {name} --json --f-number {f_number}"));
            assert!((number(&at, "f_number") / f_number - 1.0).abs() < 1e-12, "{name}: {}", number(&at, "f_number"));
            let pupil = number(&own, "effective_focal_length_mm").abs() / f_number;
            assert!((number(&at, "entrance_pupil_diameter_mm") / pupil - 1.0).abs() < 1e-12, "{name}");
        }
        let told = place.run(&format!("spot {name} --f-number 8 --json"));
        assert!(told.code == 0 && told.err.contains("f/8 for this run"), "{}", told.err);
        let stop = number(&own, "stop_semi_diameter_mm") * number(&own, "f_number") / 8.0;
        place.run(&format!("convert {name} {name}.toml")).done();
        let text = std::fs::read_to_string(place.path(&format!("{name}.toml"))).expect("written");
        let (before, rest) = text.split_once("[aperture]\n").expect("a table");
        let (_, behind) = rest.split_once('\n').expect("one line");
        let other = format!("{before}[aperture]\nstop_semi_diameter_mm = {stop:?}\n{behind}");
        place.write("stopped.toml", &other);
        let [a, b] = [format!("{name} --f-number 8"), "stopped.toml".to_owned()]
            .map(|lens| json(&place, &format!("spot {lens} --json"))["fields"].clone());
        for (a, b) in a.as_array().expect("fields").iter().zip(b.as_array().expect("fields")) {
            let [a, b] = [a, b].map(|f| number(f, "rms_mm"));
            assert!((a - b).abs() < 1e-12, "{name}: {a} {b}");
        }
        for wrong in ["0", "-4", "nan", "0.1", "1e9"] {
            let ran = place.run(&format!("check {name} --f-number {wrong}"));
            assert!(ran.code == 2 && ran.err.contains("--f-number"), "{name} f/{wrong}: {}", ran.err);
        }
    }
}

/// The focused lens has its distance, its sensor where the axis's image lies within spherical aberration, and stays when focused again.
#[test]
fn focus_for_a_distance() {
    let place = Workplace::new();
    let name = "cooke_triplet";
    let mut found = Vec::new();
    for depth in ["inf", "2000", "700", "100"] {
        let file = format!("f{depth}.toml");
        let ran = json(&place, &format!("focus {name} --depth-mm {depth} -o {file} --fields 0 --json"));
        let at = json(&place, &format!("inspect {file} --json"));
        assert_eq!(at["object_distance_mm"].as_f64(), depth.parse().ok().filter(|d: &f64| d.is_finite()));
        let sensor = number(&at, "sensor_distance_mm");
        assert_eq!(ran["sensor_distance_mm"][1].as_f64(), Some(sensor));
        found.push([sensor, number(&at, "paraxial_image_distance_mm")]);
        let again = json(&place, &format!("focus {file} --depth-mm {depth} -o again.toml --fields 0 --json --force"));
        let moved = again["sensor_distance_mm"][1].as_f64().expect("a number") - sensor;
        assert!(moved.abs() < 1e-4, "{depth}: {moved}");
        assert!(again["rms_um"][0].as_f64() <= ran["rms_um"][0].as_f64());
    }
    for pair in found.windows(2) {
        let [moved, paraxial] = [0, 1].map(|k| pair[1][k] - pair[0][k]);
        assert!(moved > 0.0 && (moved / paraxial - 1.0).abs() < 0.05, "{moved} mm, paraxial {paraxial}");
    }
    // Without a distance it stays the lens's own.
    let own = json(&place, "focus f700.toml -o own.toml --fields 0 --json");
    assert_eq!(
        (own["object_distance_mm"].as_f64(), own["sensor_distance_mm"][1].as_f64()),
        (Some(700.0), Some(found[2][0]))
    );
    // Within the front focal length there is no image to focus.
    let ran = place.run(&format!("focus {name} --depth-mm 20 -o w.toml"));
    assert!(ran.code == 2 && ran.err.contains("image"), "{}", ran.err);
    for wrong in ["0", "-5", "nan"] {
        let ran = place.run(&format!("focus {name} --depth-mm {wrong} -o w.toml"));
        assert!(ran.code == 2 && ran.err.contains("--depth-mm"), "{}", ran.err);
    }
    let ran = place.run(&format!("focus {name} --depth-mm 900 -o finf.toml"));
    assert!(ran.code == 2 && ran.err.contains("finf.toml"), "{}", ran.err);
}

/// Clear semi-diameters that a file leaves out are told and found; bounds on all thicknesses say that the sensor's distance is one.
#[test]
fn what_is_taken_in_is_told() {
    let place = Workplace::new();
    place.run("convert cooke_triplet own.toml").done();
    let text = std::fs::read_to_string(place.path("own.toml")).expect("written");
    let without: Vec<&str> = text.lines().filter(|l| !l.starts_with("semi_diameter_mm")).collect();
    place.write("without.toml", without.join("\n"));
    let ran = place.run("spot without.toml");
    assert!(ran.code == 0 && ran.err.contains("clear semi-diameters are left out"), "{}", ran.err);
    let last = text.matches("[[surface]]").count() - 1;
    let sensor = format!("surface[{last}].thickness");
    for (bound, told) in [("surface[*].thickness=0.5..60", true), ("surface[0].thickness=1..8", false)] {
        let ran = place.run(&format!("optimize cooke_triplet -o o.toml --bound {bound} --iterations 2 --force"));
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert_eq!(ran.err.contains(&format!("takes in {sensor}")), told, "{bound}: {}", ran.err);
    }
}

/// Plane plates with an f-number, and without clear semi-diameters: `optimize` takes the f-number with the focal length that is held; every other command refuses, and says so.
#[test]
fn plates_with_an_f_number_become_a_lens() {
    let place = Workplace::new();
    place.run("convert cooke_triplet own.toml").done();
    let text = std::fs::read_to_string(place.path("own.toml")).expect("written");
    let plane = |line: &str| {
        let curved = line.starts_with("radius_mm") || line.starts_with("curvature_per_mm");
        if curved { "radius_mm = inf".to_owned() } else { line.to_owned() }
    };
    let lines: Vec<String> = text.lines().filter(|l| !l.starts_with("semi_diameter_mm")).map(plane).collect();
    let (head, rest) =
        lines.join("\n").split_once("[aperture]\n").map(|(a, b)| (a.to_owned(), b.to_owned())).expect("a table");
    let (_, behind) = rest.split_once('\n').expect("one line");
    place.write("plates.toml", format!("{head}[aperture]\nf_number = 4.0\n{behind}"));
    let ran = place.run("check plates.toml");
    assert!(ran.code == 2 && ran.err.contains("no power") && ran.err.lines().count() == 1, "{}", ran.err);
    let ran = place.run("optimize plates.toml -o a.toml");
    assert!(ran.code == 2 && !place.path("a.toml").exists(), "{}", ran.err);
    let ran =
        place.run("optimize plates.toml -o lens.toml --constraint focal_length=50 --constraint track=..60 --search 8");
    assert!(ran.code == 0 && ran.err.contains("an entrance pupil of 12.5 mm"), "{}", ran.err);
    let ran = place.run("optimize plates.toml -o b.toml --constraint focal_length=50 --quality wavefront");
    assert!(ran.code == 2 && ran.err.contains("out of focus on the axis"), "{}", ran.err);
    let ran = place.run("optimize lens.toml -o c.toml --quality wavefront --iterations 3");
    assert_eq!(ran.code, 0, "{}", ran.err);
    let lens = json(&place, "inspect lens.toml --json");
    assert!((number(&lens, "effective_focal_length_mm") - 50.0).abs() < 1e-3, "{lens}");
    assert!((number(&lens, "f_number") - 4.0).abs() < 1e-3, "{lens}");
}

/// A curved sensor, as another program's file states it: told, drawn, listed; fields are in focus on it that are not on its plane; captures by rays from it are refused.
#[test]
fn a_curved_sensor_is_landed_on() {
    let place = Workplace::new();
    place.run("convert cooke_triplet flat.zmx").done();
    let text = std::fs::read_to_string(place.path("flat.zmx")).expect("written");
    let (before, image) = text.rsplit_once("CURV 0").expect("the image");
    place.write("curved.zmx", format!("{before}CURV -0.02{image}"));
    let ran = place.run("spot curved.zmx --json");
    assert!(ran.code == 0 && ran.err.contains("the image is curved, with a radius of -50 mm"), "{}", ran.err);
    let listed = json(&place, "inspect curved.zmx --json");
    assert_eq!(listed["image"]["radius_mm"].as_f64(), Some(-50.0), "{listed}");
    assert!(json(&place, "inspect flat.zmx --json")["image"].is_null());
    let foci = |lens: &str| -> Vec<f64> {
        let spot = json(&place, &format!("spot {lens} --json"));
        spot["fields"].as_array().expect("fields").iter().map(|f| number(f, "rms_mm")).collect()
    };
    let (flat, curved) = (foci("flat.zmx"), foci("curved.zmx"));
    // On the axis the blur alone reaches over the form.
    assert!((flat[0] - curved[0]).abs() < 1e-5 * flat[0], "{flat:?} {curved:?}");
    assert!((flat.last().expect("fields") - curved.last().expect("fields")).abs() > 1e-3, "{flat:?} {curved:?}");
    place.run("render curved.zmx dead_leaves:1 -o c.png --columns 96 --rows 64").done();
    let ran = place.run("capture curved.zmx dead_leaves:1 -o c.dng --samples 2");
    assert!(ran.code == 2 && ran.err.contains("a curved sensor"), "{}", ran.err);
    // Nothing is written before that is known.
    std::fs::create_dir(place.path("photos")).expect("made");
    std::fs::copy(place.path("c.png"), place.path("photos/c.png")).expect("copied");
    let ran = place.run("dataset curved.zmx --photos photos --columns 48 --rows 32 -o set --diffraction off --judge 1");
    assert!(ran.code == 2 && ran.err.contains("a curved sensor") && !place.path("set").exists(), "{}", ran.err);
    // A frame beyond the sensor's own form.
    let ran = place.run("psf curved.zmx --form heights --columns 40000 --rows 40000 -o h.npz");
    assert!(ran.code == 2 && ran.err.contains("where the image surface ends"), "{}", ran.err);
    let page = place.run("report curved.zmx -o page.html");
    assert_eq!(page.code, 0, "{}", page.err);
    assert!(
        std::fs::read_to_string(place.path("page.html"))
            .expect("written")
            .contains("The sensor is curved: radius -50 mm")
    );
}
