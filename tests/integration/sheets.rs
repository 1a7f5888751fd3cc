//! `isoplanat sheets`: what it writes, that its numbers are those of the prescription, what it refuses.

use isoplanat::testing::shared;
use serde_json::Value;
use twofloat::TwoFloat;

use crate::support::Workplace;

const TOLERANCES: &str = "schema = 1\ntest_wavelength_nm = 632.8\n[surface.all]\nradius_percent = 0.1\nirregularity_fringes = 1.0\n\
                          imperfections = \"5×0.16\"\n[element.all]\nthickness_tolerance_mm = 0.05\n";

fn read(place: &Workplace, name: &str) -> String {
    std::fs::read_to_string(place.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Columns of comma-separated numbers, by the heading.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let mut lines = csv.lines();
    let at = lines.next().expect("heading").split(',').position(|c| c == name).expect(name);
    lines.map(|l| cells(l).nth(at).expect(name).parse().expect("a number")).collect()
}

/// The cells of a line; commas between quotes divide none.
fn cells(line: &str) -> impl Iterator<Item = &str> {
    let mut inside = false;
    line.split(move |c| {
        inside ^= c == '"';
        c == ',' && !inside
    })
}

/// The numbers of a surface in a lens file, read as TOML and by nothing else.
struct Stated {
    curvature: f64,
    conic: f64,
    /// Power of h, coefficient.
    terms: Vec<(i32, f64)>,
}

fn stated(toml_text: &str) -> Vec<Stated> {
    let table: toml::Table = toml_text.parse().expect("TOML");
    let number = |v: &toml::Value| {
        v.as_float().or_else(|| v.as_integer().map(|i| f64::from(i32::try_from(i).expect("small")))).expect("number")
    };
    let of = |s: &toml::Value| Stated {
        curvature: s.get("curvature_per_mm").map_or_else(|| number(&s["radius_mm"]).recip(), number),
        conic: s.get("conic").map_or(0.0, number),
        terms: s
            .get("asphere")
            .and_then(toml::Value::as_table)
            .into_iter()
            .flatten()
            .map(|(k, a)| (k[1..].parse().expect("power"), number(a)))
            .collect(),
    };
    table["surface"].as_array().expect("surfaces").iter().map(of).collect()
}

/// `h(ρ) = cρ/(1 + √(1 − (1+κ)c²ρ)) + Σ aᵢ hⁱ` in double-double.
fn sag(s: &Stated, height: f64) -> f64 {
    let one = TwoFloat::from(1.0);
    let (c, h) = (TwoFloat::from(s.curvature), TwoFloat::from(height));
    let rho = h * h;
    let root = (one - (one + TwoFloat::from(s.conic)) * c * c * rho).sqrt();
    // The library's own division keeps 16 digits; the quotient is corrected by its remainder.
    let (above, below) = (c * rho, one + root);
    let rough = TwoFloat::from(f64::from(above) / f64::from(below));
    let conic = rough + TwoFloat::from(f64::from(above - rough * below) / f64::from(below));
    let terms = s.terms.iter().map(|(power, a)| (0..*power).fold(TwoFloat::from(*a), |x, _| x * h));
    f64::from(terms.fold(conic, |sum, t| sum + t))
}

/// Every file of sags of a folder against the prescription that lies beside it.
fn sags_are_those_of(place: &Workplace, folder: &str, faces: &[usize]) {
    let surfaces = stated(&read(place, &format!("{folder}/lens.toml")));
    for i in faces {
        let csv = read(place, &format!("{folder}/sag-surface-{i}.csv"));
        let (heights, sags, slopes) = (column(&csv, "height_mm"), column(&csv, "sag_mm"), column(&csv, "slope"));
        assert_eq!(heights.len(), 201);
        for ((h, z), slope) in heights.iter().zip(&sags).zip(&slopes) {
            let exact = sag(&surfaces[*i], *h);
            assert!((z - exact).abs() <= 1e-14 * (1.0 + h.abs()), "{folder}, face {i}, {h}: {z} {exact}");
            let d = 1e-4 * heights[200];
            let inside = (h - d).max(0.0).min(heights[200] - 2.0 * d) + d;
            if (inside - h).abs() < 1e-12 {
                let difference = (sag(&surfaces[*i], h + d) - sag(&surfaces[*i], h - d)) / (2.0 * d);
                assert!(
                    (slope - difference).abs() < 1e-5 * (1.0 + slope.abs()),
                    "{folder}, face {i}, {h}: {slope} {difference}"
                );
            }
        }
        assert!(column(&csv, "best_fit_departure_mm")[0] == 0.0);
    }
}

#[test]
fn a_folder_holds_what_a_workshop_needs() {
    let place = Workplace::new();
    place.write("t.toml", TOLERANCES);
    let text = place.run("sheets two_element -o made/ --tolerances t.toml --mount c --json").done();
    let json: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(json["elements"].as_array().map(Vec::len), Some(2));
    assert_eq!(json["mount"]["mount"]["flange_mm"], 17.526);
    for name in ["lens.toml", "lens.zmx", "lens.seq", "sheets.html", "surfaces.csv"] {
        assert!(place.path(&format!("made/{name}")).is_file(), "{name}");
    }
    sags_are_those_of(&place, "made", &[0, 1, 3, 4]);
    assert!(!place.path("made/sag-surface-2.csv").exists(), "the stop is no face");
    let page = read(&place, "made/sheets.html");
    for expected in ["3/ –(1)", "5/ 5×0.16", "±0.05 mm", "C-mount", "Element 2: faces 3, 4", "632.8 nm"] {
        assert!(page.contains(expected), "{expected}");
    }
    assert!(!page.contains("src=") && !page.contains("href=\"http"), "nothing comes from elsewhere");
    // What was written is the same lens again.
    for name in ["lens.zmx", "lens.seq"] {
        let a: Value = serde_json::from_str(&place.run("inspect two_element --json").done()).expect("JSON");
        let b: Value = serde_json::from_str(&place.run(&format!("inspect made/{name} --json")).done()).expect("JSON");
        let [a, b] = [a, b].map(|v| v["effective_focal_length_mm"].as_f64().expect("number"));
        assert!((a / b - 1.0).abs() < 1e-9, "{name}: {a} {b}");
    }
    place.run("sheets two_element -o made/").refused(&["made", "--force"]);
    place.run("sheets cooke_triplet -o made/ --force").done();
    assert!(place.path("made/sag-surface-5.csv").is_file() && read(&place, "made/sheets.html").contains("3/ –"));
    // A folder of something else is never replaced.
    std::fs::create_dir(place.path("mine")).expect("made");
    place.write("mine/notes.txt", "mine");
    place.run("sheets two_element -o mine --force").refused(&["mine"]);
}

/// The conics of a least-squares design.
#[test]
fn sheets_of_a_designed_lens() {
    let Some(lens) = shared("data/lenses/least_squares/two_element.toml") else { return };
    let place = Workplace::new();
    place.run(&format!("sheets {} -o made", lens.display())).done();
    sags_are_those_of(&place, "made", &[0, 1, 3, 4]);
}

/// Terms above r^20 stand in the table of surfaces, too.
#[test]
fn every_term_that_a_file_states_has_a_column() {
    let place = Workplace::new();
    let text = isoplanat::lens::builtin::text("two_element").expect("shipped");
    let text =
        text.replacen("radius_mm = 18.5", "radius_mm = 18.5\nasphere = { a4 = 1e-6, a23 = -2e-28, a24 = 3e-30 }", 1);
    place.write("high.toml", &text);
    place.run("sheets high.toml -o high").done();
    let csv = read(&place, "high/surfaces.csv");
    assert_eq!(
        ["a4_mm-3", "a22_mm-21", "a23_mm-22", "a24_mm-23"].map(|name| column(&csv, name)[0]),
        [1e-6, 0.0, -2e-28, 3e-30]
    );
    assert!(!csv.contains("a25_"), "no further columns");
    place.run("sheets two_element -o low").done();
    assert!(read(&place, "low/surfaces.csv").lines().next().is_some_and(|l| l.ends_with("a20_mm-19")));
}

/// Every shipped lens, aspheres with odd and even terms, cemented groups, stops in glass: all files, no number that is none.
#[test]
fn every_shipped_lens_has_sheets() {
    let place = Workplace::new();
    for (name, _) in isoplanat::lens::builtin::LENSES {
        let json: Value =
            serde_json::from_str(&place.run(&format!("sheets {name} -o {name} --json --mount cs")).done())
                .expect("JSON");
        let faces: Vec<usize> = json["of_faces"]
            .as_array()
            .expect("list")
            .iter()
            .map(|f| usize::try_from(f["surface"].as_u64().expect("number")).expect("small"))
            .collect();
        sags_are_those_of(&place, name, &faces);
        let page = read(&place, &format!("{name}/sheets.html"));
        assert!(!page.contains("NaN") && !page.contains(">nan") && !page.contains(">inf"), "{name}");
        let written = |file: &str| place.path(&format!("{name}/{file}")).is_file();
        for file in json["files"].as_array().expect("list") {
            let (file, what) = (file["file"].as_str().expect("name"), file["what"].as_str().expect("words"));
            assert_eq!(written(file), !what.starts_with("not written"), "{name}: {file}: {what}");
        }
    }
}

#[test]
fn bad_input_is_one_line_with_file_and_key() {
    let place = Workplace::new();
    let run = |tolerances: &str, lens: &str| {
        place.write("t.toml", format!("schema = 1\n{tolerances}\n"));
        place.run(&format!("sheets {lens} -o out --tolerances t.toml"))
    };
    run("[surface.all]\nfrobnicate = 1", "two_element").refused(&["t.toml", "frobnicate"]);
    run("[surface.0]\nradius_percent = -2", "two_element").refused(&["t.toml", "surface.0.radius_percent", "-2"]);
    run("[surface.2]\nroughness_nm = 2", "two_element").refused(&["t.toml", "surface.2", "0, 1, 3, 4"]);
    run("[element.0]\ndiameter_mm = 2", "two_element").refused(&["t.toml", "element.0.diameter_mm", "clear"]);
    run("[surface.0]\nradius_fringes = 2", "two_element").refused(&["t.toml", "test_wavelength_nm"]);
    place.run("sheets two_element -o out --mount pl").refused(&["--mount", "`pl`", "leica-m"]);
    place.run("sheets two_element -o out --tolerances none.toml").refused(&["none.toml"]);
    let lens = include_str!("../../models/lenses/two_element.toml");
    place.write("tilted.toml", lens.replacen("thickness_mm = ", "tilt_deg = [0.1, 0.0, 0.0]\nthickness_mm = ", 1));
    place.run("sheets tilted.toml -o out").refused(&["tilted.toml", "surface[0]", "tilt"]);
    let freeform = "zernike = { radius_mm = 10.0, terms = [0.0, 0.0, 0.0, 0.001] }\nthickness_mm = ";
    place.write("freeform.toml", lens.replacen("thickness_mm = ", freeform, 1));
    place.run("sheets freeform.toml -o out").refused(&["freeform.toml", "surface[0]", "freeform"]);
    assert!(!place.path("out").exists(), "nothing is left: {:?}", place.files());
}

/// A knife edge is said on the page, in JSON and on stderr.
#[test]
fn knife_edges_are_said_everywhere() {
    let place = Workplace::new();
    place.write("t.toml", "schema = 1\n[element.0]\ndiameter_mm = 25.0\n");
    let ran = place.run("sheets cooke_triplet -o made --tolerances t.toml --json");
    assert!(ran.code == 0 && ran.err.contains("a knife edge"), "{}", ran.err);
    let json: Value = serde_json::from_str(&ran.out).expect("JSON");
    assert!(json["faults"][0].as_str().expect("one").contains("a knife edge"), "{json:#}");
    assert!(read(&place, "made/sheets.html").contains("a knife edge"));
}
