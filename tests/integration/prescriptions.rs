//! Prescriptions that contradict themselves or ask for what is not known: refused in one line, or said on stderr.

use serde_json::{Value, json};

use crate::support::{Ran, Workplace};

const TWO: &str = include_str!("../../models/lenses/two_element.toml");
const COOKE: &str = include_str!("../../models/lenses/cooke_triplet.toml");
const PHONE: &str = include_str!("../../models/lenses/phone.toml");
const GAUSS: &str = include_str!("../../models/lenses/double_gauss.toml");
const RAYS: &str = r#"{"wavelength_nm": 550.0, "rays": [{"origin_mm": [0.0, 0.2, -5.0], "direction": [0, 0, 1]}]}"#;
const FRAME: &str = "--columns 24 --rows 16 --pitch-um 60";

/// `text` with every replacement made, each of which has something to replace.
fn with(text: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

fn json_of(ran: Ran) -> Value {
    serde_json::from_str(&ran.done()).expect("JSON")
}

/// Catalogues and pages that the command line gives: on every command, by `ISOPLANAT_GLASSES` too; a lens file that the program writes holds
/// such a glass whole; bad ones and unknown names are one line.
#[test]
fn glasses_come_from_catalogues_of_the_command_line() {
    let place = Workplace::new();
    // N-SK16 and F2 under other names, the one by its maker's formula, the other as a table.
    let agf = "CC a catalogue\nNM CROWN 2 620603 1.62041 60.32 0 1\nCD 1.34317774 0.00704687339 0.241144399 0.0229005 0.994317969 92.7508526 0 0\nLD 0.31 2.5\n";
    let page = "DATA:\n  - type: tabulated nk\n    data: |\n        0.40 1.652 0\n        0.4861327 1.63208 0\n        0.5875618 1.62004 0\n        0.6562725 1.61503 0\n        0.71 1.6121 0\n";
    let utf16: Vec<u8> = std::iter::once(0xfeff).chain(agf.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    place.write("mine.agf", utf16).write("flint.yml", page).write("rays.json", RAYS);
    place
        .write("cooke.toml", COOKE)
        .write("own.toml", with(COOKE, &[("\"N-SK16\"", "\"CROWN\""), ("\"F2\"", "\"page/flint\"")]));
    place.run("inspect own.toml").refused(&["own.toml", "surface[0].medium", "unknown glass `CROWN`", "--glass FILE"]);
    let given = "--glass mine.agf --glass flint.yml";
    let [own, shipped] = ["own.toml", "cooke.toml"].map(|l| json_of(place.run(&format!("inspect {l} --json {given}"))));
    assert_eq!(own["surfaces"][0]["index"], shipped["surfaces"][0]["index"]);
    assert_eq!(own["surfaces"][0]["medium_source"], "mine.agf, formula sellmeier");
    let focal = |v: &Value| v["effective_focal_length_mm"].as_f64().expect("a number");
    assert!((focal(&own) - focal(&shipped)).abs() < 2e-3, "{} and {}", focal(&own), focal(&shipped));
    let text = place.run(&format!("inspect own.toml {given}")).done();
    assert!(text.contains("mine.agf, formula sellmeier") && text.contains("a table of 5 indices"), "{text}");
    place.run(&format!("{given} check own.toml")).done();
    place.run(&format!("trace own.toml --rays rays.json --gradient {given}")).done();
    // A folder, on the command line and in the environment.
    std::fs::create_dir(place.path("glasses")).expect("made");
    for file in ["mine.agf", "flint.yml"] {
        std::fs::copy(place.path(file), place.path("glasses").join(file)).expect("copied");
    }
    place.run("inspect own.toml --glass glasses").done();
    let configured =
        place.command("inspect own.toml").env("ISOPLANAT_GLASSES", place.path("glasses")).output().expect("runs");
    assert!(configured.status.success(), "{}", String::from_utf8_lossy(&configured.stderr));
    // Bad ones.
    place.write("bad.agf", "NM A 2\nCD 1 2 x\n").write("a.txt", "");
    place.run("inspect cooke.toml --glass bad.agf").refused(&["bad.agf", "line 2", "CD 1 2 x"]);
    place.run("inspect cooke.toml --glass a.txt").refused(&["a.txt", ".agf"]);
    place.run("inspect cooke.toml --glass none.agf").refused(&["none.agf"]);
    let near = with(COOKE, &[("\"F2\"", "\"N-F3\"")]);
    place.write("near.toml", near);
    place.run("inspect near.toml").refused(&["near.toml", "unknown glass `N-F3`", "near names: F3, KF3, N-F2"]);
}

/// A wavelength at which an index is not known, in a file or on the command line: glass, wavelength and range are named.
#[test]
fn wavelengths_outside_a_glass_are_refused() {
    let place = Workplace::new();
    place.write("cooke.toml", COOKE).write("rays.json", RAYS.replace("550.0", "9000"));
    let expected = ["cooke.toml", "surface[0]", "N-SK16 at 9000 nm", "310 to 2500 nm"];
    place.run("inspect cooke.toml --wavelength-nm 9000").refused(&expected);
    place.run("trace cooke.toml --rays rays.json").refused(&expected);
    place.run("psf cooke.toml -o k.npz --wavelength-nm 550,9000").refused(&expected);
    // In the file: every command refuses it; 9.6 µm lies inside the resonance, where the formula still gives a number.
    for nm in ["9000", "9600"] {
        place.write("far.toml", COOKE.replace("656.2725]", &format!("{nm}]")));
        for command in ["inspect", "check", "psf -o k.npz", "trace --rays rays.json"] {
            place.run(&format!("{command} far.toml")).refused(&["far.toml", "surface[0].medium", nm, "310 to 2500 nm"]);
        }
    }
    // Tables end 5 nm past their entries, the two-number glass at 350 and 1100 nm.
    place.write("gauss.toml", GAUSS).write("two.toml", TWO);
    place.run("inspect gauss.toml --wavelength-nm 704.9").done();
    place.run("inspect gauss.toml --wavelength-nm 705.1").refused(&["gauss.toml", "705.1", "395 to 705 nm"]);
    place.run("inspect two.toml --wavelength-nm 1100").done();
    place.run("inspect two.toml --wavelength-nm 1101").refused(&["two.toml", "n_d 1.4914, v_d 57.4", "350 to 1100 nm"]);
    // A table of the visible lines alone is no glass for 400 to 700 nm.
    let lines = with(GAUSS, &[("[400.0, ", "[470.0, "), (", 700.0]", ", 690.0]")]);
    place.write("lines.toml", lines);
    for method in ["psf-grid", "monte-carlo"] {
        place.run(&format!("render lines.toml text -o a.png {FRAME} --method {method}")).refused(&[
            "lines.toml",
            "400 nm",
            "465 to 695 nm",
        ]);
    }
    assert!(!place.path("k.npz").exists() && !place.path("a.png").exists());
}

/// A lens for other light than the picture's is refused by every renderer; one that reaches beyond it is rendered with a word.
#[test]
fn lenses_for_other_light_are_not_rendered_in_the_visible() {
    let place = Workplace::new();
    let infrared = "nm = [850.0, 900.0, 950.0], weights = [1.0, 1.0, 1.0], primary_nm = 900.0";
    let visible = "nm = [486.1327, 587.5618, 656.2725], weights = [1.0, 1.0, 1.0], primary_nm = 587.5618";
    place.write("infrared.toml", with(COOKE, &[(visible, infrared)]));
    for command in [
        "render infrared.toml text -o a.png",
        "render infrared.toml text -o a.png --method monte-carlo",
        "capture infrared.toml text -o a.dng",
        "accuracy infrared.toml text",
    ] {
        place.run(&format!("{command} {FRAME}")).refused(&[
            "infrared.toml",
            "wavelengths.nm",
            "850 to 950 nm",
            "400 to 700 nm",
        ]);
    }
    // A sensor that responds there takes the capture.
    let sensor = include_str!("../../calibration/generic-rggb/sensor.toml");
    let start = sensor.find("wavelength_nm").expect("a table");
    let response = "wavelength_nm = [800, 900, 1000]\nred = [0, 1, 0]\ngreen = [0, 1, 0]\nblue = [0, 1, 0]\n";
    place.write("sensor.toml", format!("{}{response}", &sensor[..start]));
    place.run(&format!("capture infrared.toml text -o b.dng --samples 2 --calibration sensor.toml {FRAME}")).done();
    let wide = "nm = [486.1327, 587.5618, 850.0], weights = [1.0, 1.0, 1.0], primary_nm = 587.5618";
    place.write("wide.toml", with(COOKE, &[(visible, wide)]));
    let ran = place.run(&format!("render wide.toml text -o c.png {FRAME} --min-psnr-db 30"));
    let said = "warning: wide.toml: wavelengths.nm: 850 nm: the picture shows 400 to 700 nm";
    assert!(ran.code == 0 && ran.err.contains(said), "{ran:?}");
    // A wavelength without weight is none.
    place.write("wide.toml", with(COOKE, &[(visible, &wide.replace("1.0]", "0.0]"))]));
    let ran = place.run(&format!("render wide.toml text -o c.png {FRAME} --min-psnr-db 30 --force"));
    assert!(ran.code == 0 && !ran.err.contains("850"), "{ran:?}");
    assert!(!place.path("a.png").exists() && !place.path("a.dng").exists());
}

/// Weights of the wavelengths decide polychromatic kernels and illumination; the sums are made again by hand.
#[test]
fn weights_count_in_polychromatic_figures() {
    let place = Workplace::new();
    place.write("lens.toml", with(COOKE, &[("weights = [1.0, 1.0, 1.0]", "weights = [1.0, 5.0, 2.0]")]));
    let json = json_of(place.run("psf lens.toml -o k.npz --fields 3 --size 15 --pitch-um 20 --rays 400 --json"));
    let mut npz = ndarray_npy::NpzReader::new(std::fs::File::open(place.path("k.npz")).expect("opens")).expect("npz");
    let kernels: ndarray::Array5<f32> = npz.by_name("kernels").expect("kernels");
    let mean: ndarray::Array4<f32> = npz.by_name("polychromatic").expect("polychromatic");
    let light: ndarray::Array3<f64> = npz.by_name("relative_illumination").expect("light");
    let weight: ndarray::Array1<f64> = npz.by_name("weight").expect("weights");
    assert_eq!(weight.map(|w| (w * 8.0).round()).to_vec(), [1.0, 5.0, 2.0]);
    for f in 0..3 {
        let parts: Vec<f64> = (0..3).map(|c| [1.0, 5.0, 2.0][c] * light[[0, f, c]]).collect();
        let sum: f64 = parts.iter().sum();
        let row = &json["rows"][f]["relative_illumination"];
        assert!((row.as_f64().expect("number") - sum / 8.0).abs() < 1e-12, "{json}");
        for (r, c) in [(7, 7), (6, 8), (9, 7)] {
            let by_hand: f64 = (0..3).map(|k| parts[k] / sum * f64::from(kernels[[0, f, k, r, c]])).sum();
            assert!((f64::from(mean[[0, f, r, c]]) - by_hand).abs() < 1e-6);
        }
    }
    let spread = |f: usize| light[[0, f, 0]] - light[[0, f, 2]];
    assert!(spread(2).abs() > 1e-6, "the weights matter at the border");
    let inspected = json_of(place.run("inspect lens.toml --json"));
    assert_eq!(
        (&inspected["weights"], &inspected["colour_nm"]),
        (&json!([1.0, 5.0, 2.0]), &json!([486.1327, 656.2725]))
    );
    assert!(place.run("inspect lens.toml").done().contains("weights 1, 5, 2"));
}

/// The last surface stands before the sensor with all of its clear aperture: refused where the file is read, by its name.
#[test]
fn a_surface_behind_the_sensor_is_refused_by_every_command() {
    let place = Workplace::new();
    // The rear surface of the triplet, turned round: its rim is 1.9 mm nearer to the sensor than its vertex.
    let rear = &COOKE[COOKE.rfind("radius_mm").expect("surfaces")..];
    let near =
        COOKE.replacen(rear, "radius_mm = 18.0\nthickness_mm = 1.0\nmedium = \"air\"\nsemi_diameter_mm = 7.9\n", 1);
    place.write("behind.toml", near).write("rays.json", RAYS);
    for command in [
        "inspect behind.toml".to_owned(),
        "check behind.toml".to_owned(),
        "trace behind.toml --rays rays.json".to_owned(),
        "psf behind.toml -o k.npz".to_owned(),
        format!("render behind.toml text -o a.png {FRAME}"),
        format!("render behind.toml text -o a.png {FRAME} --method monte-carlo"),
    ] {
        place.run(&command).refused(&["behind.toml: surface[5]", "sensor", "thickness_mm", "semi_diameter_mm"]);
    }
    assert_eq!(place.files(), ["behind.toml", "rays.json"]);
}

/// The published semi-diameters of the phone lens: rims that overlap by 7 and 18 µm are said, beyond the light and where light
/// goes; an overlap of more than prescriptions are rounded by is refused.
#[test]
fn rims_may_overlap_by_micrometres() {
    let place = Workplace::new();
    let published = with(PHONE, &[("semi_diameter_mm = 2.04", "semi_diameter_mm = 2.095"), ("= 2.065", "= 2.095")]);
    place.write("published.toml", &published).write("rays.json", RAYS);
    for command in ["inspect published.toml", "trace published.toml --rays rays.json", "check published.toml"] {
        let ran = place.run(command);
        assert_eq!(ran.code, 0, "{ran:?}");
        let said: Vec<&str> = ran.err.lines().filter(|l| l.starts_with("warning: published.toml: surface[")).collect();
        assert!(
            said.len() == 2
                && said[0].contains("surface[5] and surface[6]")
                && said[0].contains("overlap by 0.0073 mm"),
            "{ran:?}"
        );
        assert!(
            said[1].contains("surface[6] and surface[7]")
                && said[1].contains("0.0178 mm")
                && said[1].contains("the beam ends"),
            "{ran:?}"
        );
    }
    // A wider field takes the light there: said too, and traced as the surfaces stand.
    place.write("wide.toml", published.replace("max_angle_deg = 32.0", "max_angle_deg = 40.0"));
    let ran = place.run("inspect wide.toml");
    assert!(
        ran.code == 0 && ran.err.contains("wide.toml: surface[5] and surface[6]: they overlap by 0.0073 mm"),
        "{ran:?}"
    );
    assert!(ran.err.contains("light goes there"), "{ran:?}");
    // Near the axis, and deep.
    place.write("deep.toml", published.replace("thickness_mm = 0.634", "thickness_mm = 0.5"));
    place.run("inspect deep.toml").refused(&["deep.toml: surface[6] and surface[7]", "they cross"]);
}

/// Radii and terms of freeforms that no surface has: refused when read, within a moment.
#[test]
fn freeform_terms_are_held_within_bounds() {
    let place = Workplace::new();
    let lens = |terms: &str| with(TWO, &[("radius_mm = 18.5", &format!("radius_mm = 18.5\n{terms}"))]);
    for (terms, said) in [
        ("xy = { radius_mm = 1e-155, terms = { x2y0 = 1e-6 } }", "xy.radius_mm"),
        ("xy = { radius_mm = 1e-300, terms = { x1y0 = 1e-303 } }", "xy.radius_mm"),
        ("xy = { radius_mm = 1e300, terms = { x2y0 = 1e-6 } }", "xy.radius_mm"),
        ("zernike = { radius_mm = 1e-3, terms = [0.0, 0.0, 0.0, 1e-3] }", "zernike.radius_mm"),
        ("xy = { radius_mm = 0.1, terms = { x10y0 = 1.0 } }", "slope"),
        ("asphere = { a20 = 1e100 }", "slope"),
    ] {
        place.write("bad.toml", lens(terms));
        let started = std::time::Instant::now();
        place.run("check bad.toml").refused(&["bad.toml", "surface[0]", said]);
        assert!(started.elapsed().as_secs() < 10, "{terms}");
    }
    for terms in
        ["xy = { radius_mm = 1.0, terms = { x2y0 = 1e-5 } }", "zernike = { radius_mm = 100.0, terms = [0.0, 0.01] }"]
    {
        place.write("good.toml", lens(terms));
        place.run("check good.toml").done();
    }
}
