//! Catalogues of glasses: AGF, and pages of refractiveindex.info. What is listed has an index over all of its range.

use isoplanat::lens::Medium;
use isoplanat::lens::catalogue::{Glasses, Naming};

use super::{file, made, read};

pub(super) fn agf(bytes: &[u8]) {
    catalogue("a.agf", bytes);
}

pub(super) fn page(bytes: &[u8]) {
    catalogue("a.yml", bytes);
}

fn catalogue(name: &str, bytes: &[u8]) {
    let mut glasses = Glasses::default();
    if read(name, glasses.add(&file(name, bytes))).is_none() {
        return;
    }
    for glass in glasses.listed_all() {
        let [short, long] = glass.medium.range_nm();
        assert!(0.0 < short && short < long && long.is_finite(), "{}: {short} to {long} nm", glass.name);
        for k in 0..=16 {
            let nm = short + (long - short) * f64::from(k) / 16.0;
            let index = glass.medium.index(nm);
            // Past its ends a table goes on as it ends, a few nm.
            let is_known = matches!(glass.medium, Medium::Table { .. }) || (1.0..=5.0).contains(&index);
            assert!(index.is_finite() && is_known, "{}: {index} at {nm} nm", glass.name);
        }
        // It is found by its name, or said to be one of several.
        let _ = made(glasses.find(&format!("{}/{}", glass.catalogue, glass.name), Naming::Exact));
    }
}

/// A glass a formula.
pub(super) fn agf_starts() -> Vec<Vec<u8>> {
    let glass = |k: usize| {
        format!(
            "NM G{k} {k} 517642 1.5168 64.17 0 1\nGC made up\nED 7.1 8.3 2.51 -0.01 0\nCD 2.27 -0.01 0.01 2e-4 -1e-5 1e-6\nLD 0.4 0.7\n"
        )
    };
    let sellmeier = "CC mine\nNM F2 2 620364 1.62 36.4 0 2\nCD 1.34 0.01 0.21 0.05 0.94 112\nTD 0 0 0 0 0 0 20\nOD 1 1 1 1 1 1\nLD 0.4 2.0\nIT 0.5 0.9 10\n";
    vec![sellmeier.as_bytes().to_vec(), (1..=13).map(glass).collect::<String>().into_bytes()]
}

/// A formula, and a table.
pub(super) fn page_starts() -> Vec<Vec<u8>> {
    let head =
        "REFERENCES: \"made up\"\nCOMMENTS: \"none\"\nCONDITIONS:\n  temperature: 20.0\n  n_is_absolute: false\n";
    let formula = |n: usize| {
        format!(
            "{head}DATA:\n  - type: formula {n}\n    wavelength_range: 0.4 1.2\n    coefficients: 0 1.34 0.1 0.21 0.2 0.94 10\n"
        )
    };
    let table = format!(
        "{head}DATA:\n  - type: tabulated nk\n    data: |\n        0.4 1.53 1e-8\n        0.5 1.52 1e-8\n        0.7 1.51 0\n  - type: tabulated k\n    data: |\n        0.4 0\n"
    );
    let n = table.replace("nk", "n").replace(" 1e-8", "").replace(" 1.51 0", " 1.51");
    (1..=9).map(formula).chain([table, n]).map(String::into_bytes).collect()
}
