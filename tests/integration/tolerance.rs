//! `isoplanat tolerance`: a lens as it will be built.

use serde_json::Value;

use crate::support::Workplace;

const FILE: &str = r#"
schema = 1
[element.all]
thickness_tolerance_mm = 0.05
[surface.all]
radius_percent = 0.2
centring_arcmin = 3.0
[assembly]
air_mm = 0.05
decentre_mm = 0.02
tilt_arcmin = 3.0
"#;

/// Sixty lenses with page, CSV, JSON and files that are lenses again; the same seed draws the same; bad input by name.
#[test]
fn lenses_are_drawn_and_told() {
    let place = Workplace::new();
    place.write("t.toml", FILE);
    let command = "tolerance cooke_triplet --tolerances t.toml";
    let text =
        place.run(&format!("{command} --draws 60 --limit-um 40 -o page.html --csv draws.csv --lenses drawn")).done();
    for part in ["share of lenses", "element 2, shift", "within 40 µm rms", "60 draws"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json = |more: &str| -> Value {
        let text = place.run(&format!("{command} --json {more}")).done();
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"))
    };
    let (first, again, other) = (json("--draws 20"), json("--draws 20"), json("--draws 20 --seed 2"));
    assert_eq!(first["draws"], again["draws"]);
    assert_ne!(first["draws"], other["draws"]);
    let nominal = first["nominal_mm"].as_f64().expect("a number");
    let half = first["quantiles"][1]["rms_mm"].as_f64().expect("a number");
    assert!(half > nominal, "{half} {nominal}");
    let page = std::fs::read_to_string(place.path("page.html")).expect("a page");
    assert!(page.contains("Yield") && !page.contains("NaN"));
    assert_eq!(std::fs::read_to_string(place.path("draws.csv")).expect("rows").lines().count(), 61);
    let inspected = place.run("inspect drawn/draw-000060.toml").done();
    assert!(inspected.contains("effective focal length"), "{inspected}");
    place.run(&format!("{command} --lenses drawn")).refused(&["drawn", "--force"]);
    place.run(&format!("{command} -o page.html")).refused(&["page.html", "--force"]);
    place.run(&format!("{command} --limit-um -1")).refused(&["--limit-um", "-1"]);
    place.run("tolerance cooke_triplet --tolerances none.toml").refused(&["none.toml"]);
    place.write("bad.toml", FILE.replace("air_mm", "gap_mm"));
    place.run("tolerance cooke_triplet --tolerances bad.toml").refused(&["bad.toml", "gap_mm"]);
    place.write("nothing.toml", "schema = 1\n");
    place.run("tolerance cooke_triplet --tolerances nothing.toml").refused(&["nothing.toml", "tolerances"]);
    // Tolerances with which no lens is left: an outcome, not a fault.
    place.write(
        "wild.toml",
        FILE.replace("radius_percent = 0.2", "radius_percent = 90.0")
            .replace("decentre_mm = 0.02", "decentre_mm = 20.0"),
    );
    let wild: Value =
        serde_json::from_str(&place.run("tolerance cooke_triplet --tolerances wild.toml --draws 20 --json").done())
            .expect("JSON");
    assert!(wild["lost"].as_u64().is_some_and(|n| n > 10), "{wild}");
    // No light is no sharpness.
    let sharp = |d: &Value| d["rms_mm"].as_f64().is_some_and(|r| r < 1e-3);
    assert!(!wild["draws"].as_array().expect("draws").iter().any(sharp), "{wild}");
}
