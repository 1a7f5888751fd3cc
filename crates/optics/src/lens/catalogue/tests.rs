use super::*;
use isoplanat_base::testing::{assert_abs, shared};

/// Every shipped glass is one, and gives the published index and Abbe number that its name stands for.
#[test]
fn shipped_glasses_have_their_published_indices() {
    let all = Glasses::shipped();
    assert!(all.catalogues.iter().map(|c| c.entries.len()).sum::<usize>() > 300);
    for c in &all.catalogues {
        for e in &c.entries {
            let medium = all.find(&format!("{}/{}", c.name, e.name), Naming::Exact).expect("shipped");
            let [a, b] = medium.range_nm();
            let indices: Vec<f64> = (0..=200).map(|k| medium.index(a + (b - a) * f64::from(k) / 200.0)).collect();
            assert!(indices.windows(2).all(|n| n[0] > n[1]), "{medium} falls with wavelength");
        }
    }
    // Data sheets: n_d, V_d.
    for (name, n_d, v_d) in [
        ("N-BK7", 1.5168, 64.17),
        ("N-SK16", 1.62041, 60.32),
        ("F2", 1.62004, 36.37),
        ("SF6", 1.80518, 25.43),
        ("S-FPL51", 1.49700, 81.54),
        ("S-LAH64", 1.78800, 47.37),
        ("BSC7", 1.51680, 64.20),
        ("SILICA", 1.45846, 67.82),
        ("CAF2", 1.43384, 94.99),
        ("PMMA", 1.49176, 57.44),
    ] {
        let medium = all.find(name, Naming::Exact).expect(name);
        let [d, f, c] = [587.5618, 486.1327, 656.2725].map(|nm| medium.index(nm));
        assert_abs(d, n_d, 2e-5, name);
        assert_abs((d - 1.0) / (f - c), v_d, 0.03, name);
    }
}

/// A page's rows that are of no lens are left out: what absorbs, what lies beyond the light of lenses. Vacuum has an index below that of air.
#[test]
fn what_is_known_is_kept() {
    let folder = tempfile::tempdir().expect("made");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let rows = ["0.3 5.1 4", "0.35 5.5 3", "0.4 4.9 1", "0.5 4.2 0.1", "1.3 3.5 0", "2.0 0.9 0", "3 1.5 0"];
    let page =
        |rows: &[&str]| format!("DATA:\n  - type: tabulated nk\n    data: |\n        {}\n", rows.join("\n        "));
    let mut glasses = Glasses::default();
    glasses.add(&write("si.yml", &page(&rows))).expect("reads");
    let si = glasses.find("si", Naming::Exact).expect("a glass");
    // Tables are known a little beyond their ends.
    assert_eq!(si.range_nm(), [395.0, 1305.0]);
    assert_abs(si.index(1300.0), 3.5, 0.0, "its row");
    let error = glasses.add(&write("gold.yml", &page(&["0.5 0.9 1", "0.6 0.2 3"]))).expect_err("a metal").to_string();
    assert!(error.contains("no row") && error.contains("from 1 to 5"), "{error}");
    // n² = 1/n_air² falls towards 1 from below: a Conrady formula near 0.9997.
    let agf = "NM VACUUM 5 0 0.99973 0 0 1\nCD 0.99973 -2e-6 0\nLD 0.2 5\n";
    glasses.add(&write("misc.agf", agf)).expect("reads");
    let vacuum = glasses.find("VACUUM", Naming::Exact).expect("a medium");
    assert_eq!(vacuum.range_nm(), [200.0, 5000.0]);
    assert_abs(vacuum.index(500.0), 0.999_726, 1e-9, "its formula");
}

/// Names are exact; near ones are told, and different glasses of one name are not chosen from.
#[test]
fn names_are_found_or_refused() {
    let shipped = Glasses::shipped();
    for (name, expected) in
        [("N-BK8", "N-BK7"), ("N-BK77", "N-BK7"), ("nsk16", "N-SK16"), ("nothing at all", "--glass FILE")]
    {
        let error = shipped.find(name, Naming::Exact).expect_err(name).to_string();
        assert!(error.contains(&format!("unknown glass `{name}`")) && error.contains(expected), "{error}");
    }
    assert_eq!(shipped.find("AIR", Naming::Exact).expect("air"), Medium::Air);
    let folder = tempfile::tempdir().expect("made");
    let agf = |name: &str, first: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("CC mine\nNM F2 2 620364 1.62 36.4 0 1\nCD {first} 0.01 0.2 0.05 0.9 110 0 0 0 0\nLD 0.4 2.0\nNM X 99 0 0 0\nLD 1 2\n"))
            .expect("written");
        path
    };
    let mut more = shipped.clone();
    more.add(&agf("mine.agf", "1.3")).expect("read");
    let error = more.find("F2", Naming::Exact).expect_err("two").to_string();
    assert!(error.contains("`SCHOTT/F2` or `mine/F2`"), "{error}");
    let mine = more.find("mine/F2", Naming::Exact).expect("named");
    assert_eq!(more.find("F2", Naming::Foreign(&["nobody".into(), "MINE".into()])).expect("preferred"), mine);
    assert!(more.find("X", Naming::Exact).expect_err("no formula").to_string().contains("formula of number 99"));
    // A range beyond a pole of the formula (0.9 µm) is the part that holds the most.
    let text = "NM EP 2 0 0 0\nCD 1.49489608 0.0197146484 0.154736328 0.0885113938 -9.57877767e-06 0.811138467\nLD 0.404656 1.08303\n";
    std::fs::write(folder.path().join("pole.agf"), text).expect("written");
    let mut poles = Glasses::default();
    poles.add(&folder.path().join("pole.agf")).expect("read");
    let [short, long] = poles.find("EP", Naming::Exact).expect("a glass").range_nm();
    assert!(short == 404.656 && (880.0..900.6).contains(&long), "{short} to {long}");
    // Coefficients of another glass, and none at all, where the line says what they should make; of an infrared glass it says nothing.
    let text = "NM WRONG 2 0 1.7481 0\nCD 1.039 0.006 0.2318 0.02 1.0105 103.56\nLD 0.4 2\nNM NOUGHT 2 0 1.5168 0\nCD 0 0 0\nLD 0.4 2\n\
                NM IR 2 0 1.0 0\nCD 4.0 0.1\nLD 0.5 2\n";
    std::fs::write(folder.path().join("wrong.agf"), text).expect("written");
    poles.add(&folder.path().join("wrong.agf")).expect("read");
    for (name, made, says) in [("WRONG", "1.5166", "1.7481"), ("NOUGHT", "1.0000", "1.5168")] {
        let error = poles.find(name, Naming::Exact).expect_err("another glass").to_string();
        assert!(error.contains(&format!("n_d {made}, where the line says {says}")), "{error}");
    }
    poles.find("IR", Naming::Exact).expect("no index is stated");
    // The same glass in two catalogues is one.
    more.add(&agf("again.agf", "1.3")).expect("read");
    let [a, b] = ["mine/F2", "again/F2"].map(|n| more.find(n, Naming::Exact).expect("named").index(550.0));
    assert_eq!(a, b);
    // Of a table that begins among X-rays (found by fuzzing: a range that began below 0) the part that lenses take.
    let table = "DATA:\n  - type: tabulated n\n    data: |\n      0.0007 1.9\n      0.5 1.5\n      0.7 1.4\n";
    std::fs::write(folder.path().join("long.yml"), table).expect("written");
    poles.add(&folder.path().join("long.yml")).expect("read");
    let [short, long] = poles.find("page/long", Naming::Exact).expect("a glass").range_nm();
    assert!((490.0..=500.0).contains(&short) && (700.0..=710.0).contains(&long), "{short} to {long}");
    // What is no catalogue.
    for (name, text, expected) in [
        ("a.agf", "hello", "lines NM"),
        ("b.agf", "NM A 2\nCD 1 2 x\n", "line 2"),
        ("c.agf", "NM A 2\nHELLO\n", "line 2"),
        ("d.agf", "NM\n", "line 1"),
        ("e.yml", "DATA: 3", "a page of refractiveindex.info"),
        ("i.yml", "DATA: [", "a page of refractiveindex.info"),
        ("f.yml", "DATA:\n  - type: formula 11\n    wavelength_range: 0.4 1\n    coefficients: 1 2\n", "formula 11"),
        ("g.yml", "DATA:\n  - type: tabulated n\n    data: |\n      0.5 1.5\n      0.4 1.6\n", "DATA.data"),
        (
            "j.yml",
            "DATA:\n  - type: tabulated n\n    data: |\n      -0.4 1.5\n      0.07 1.4\n",
            "no row from 0.1 to 100",
        ),
        ("h.txt", "", "another ending"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        let error = shipped.clone().add(&path).expect_err(name).to_string();
        assert!(error.contains(name) && error.contains(expected), "{error}");
    }
}

/// Every AGF catalogue and page there is: all are read, and indices are those of an independent evaluation (which is rounded to 1e-7).
#[test]
fn catalogues_agree_with_reference_indices() {
    let Some(path) = shared("data/glass/reference_indices.json") else { return };
    let all: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).expect("readable")).expect("JSON");
    let folder = path.parent().expect("a folder");
    let (mut compared, mut worst) = (0, 0.0f64);
    for (key, entry) in all.as_object().expect("object") {
        let (file, name) = key.split_once('/').expect("file and glass");
        let mut glasses = Glasses::default();
        glasses.add(&folder.join("agf").join(file)).expect(file);
        let medium = glasses.find(name, Naming::Exact).expect(key);
        for (um, n) in entry["n"].as_object().expect("object") {
            let n = n.as_f64().expect("number");
            worst = worst.max((medium.index(um.parse::<f64>().expect("number") * 1e3) - n).abs());
            compared += 1;
        }
    }
    eprintln!("{compared} indices, off by {worst:.1e} at most");
    assert!(compared > 600 && worst < 5.1e-8, "{compared} indices, {worst:e}");
    let (mut glasses, mut refused) = (Glasses::default(), Vec::new());
    glasses.add(&folder.join("agf")).expect("all catalogues");
    glasses.add(&folder.join("refractiveindex_info")).expect("all pages");
    for c in &glasses.catalogues {
        refused.extend(
            c.entries.iter().filter_map(|e| Some(format!("{}/{}: {}", c.name, e.name, e.medium.as_ref().err()?))),
        );
    }
    let count: usize = glasses.catalogues.iter().map(|c| c.entries.len()).sum();
    eprintln!("{count} glasses, refused: {refused:#?}");
    assert!(count > 2000 && refused.len() < 40, "{count} glasses, refused: {refused:#?}");
    // A page of a maker's glass and the maker's catalogue say the same.
    let page = glasses.find("page/specs_schott_N-BK7", Naming::Exact).expect("a page");
    let catalogue = glasses.find("schott/N-BK7", Naming::Exact).expect("a glass");
    for nm in [365.0, 587.5618, 1014.0] {
        assert_abs(page.index(nm), catalogue.index(nm), 1e-12, "N-BK7");
    }
}

/// Catalogues and pages cut and changed at random: an answer or one error, never a panic, and no glass without sense.
#[test]
fn mutated_catalogues_are_read_or_refused() {
    let agf = "CC made\nNM CROWN 2 620603 1.62 60.3 0 1\nGC\nED 7 0 2.5 0\nCD 1.34 0.007 0.24 0.023 0.99 92.8 0 0\nLD 0.31 2.5\nIT 0.4 0.99 10\n\
               NM HEAVY 13 0 0 0\nCD 3.2 -0.013 -1e-4 0.03 6e-4 1e-5 1e-6 0 0 0\nLD 0.38 1.5\n";
    let page = "REFERENCES: |\n    somebody\nDATA:\n  - type: formula 2\n    wavelength_range: 0.44 1.05\n    coefficients: 0 1.18 0.0113\n\
                \x20 - type: tabulated nk\n    data: |\n        0.4 1.5 0\n        0.5 1.49 0\nCONDITIONS:\n    temperature: 293\n";
    let folder = tempfile::tempdir().expect("made");
    let rng = &mut fastrand::Rng::with_seed(11);
    let (mut read, mut refused) = (0, 0);
    for i in 0..4000 {
        let (text, name) = if i % 2 == 0 { (agf, "a.agf") } else { (page, "p.yml") };
        let mut bytes = text.as_bytes().to_vec();
        for _ in 0..rng.usize(1..6) {
            let at = rng.usize(..bytes.len());
            match rng.u8(..5) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes[at] = rng.u8(..),
                2 => drop(bytes.drain(at..(at + rng.usize(..9)).min(bytes.len()))),
                3 => bytes.splice(at..at, *b" 1e999 ").for_each(drop),
                _ => bytes
                    .splice(
                        at..at,
                        rng.choice([&b"-"[..], b"nan", b"\n", b"NM X 5\n", b"0", b": ["]).expect("some").to_vec(),
                    )
                    .for_each(drop),
            }
            if bytes.is_empty() {
                bytes.push(b'\n');
            }
        }
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).expect("written");
        let mut glasses = Glasses::default();
        match glasses.add(&path) {
            Err(e) => {
                refused += 1;
                assert!(e.exit_code() == 2 && e.to_string().contains(name), "{e}");
            }
            Ok(()) => {
                read += 1;
                for entry in glasses.catalogues.iter().flat_map(|c| &c.entries) {
                    let Ok(medium) = &entry.medium else { continue };
                    let ([a, b], middle) = (medium.range_nm(), |a: f64, b: f64| medium.index(0.5 * (a + b)));
                    assert!(INDICES.contains(&middle(a, b)), "{medium}: {} in {a} to {b}", middle(a, b));
                }
            }
        }
    }
    assert!(read > 500 && refused > 500, "{read} read, {refused} refused");
}

/// A page whose table has a word that is no number: one line that names the word (found by fuzzing).
#[test]
fn a_page_with_a_word_among_its_numbers_is_one_line() {
    let folder = tempfile::tempdir().expect("made");
    let path = folder.path().join("a.yml");
    std::fs::write(&path, "DATA:\n  - type: tabulated n\n    data: |\n        0.40 1.50\n        0.41 1x4\n")
        .expect("written");
    let error = Glasses::default().add(&path).expect_err("a word").to_string();
    assert!(error.contains("DATA.data: `1x4`; finite numbers") && !error.contains('\n'), "{error}");
}

/// A glass of an AGF file without its one line of coefficients is refused by name and line: what was read was a medium of index 1, or another glass's
/// numbers. Fewer coefficients than the formula has stay what they are.
#[test]
fn glasses_without_their_coefficients_are_refused() {
    let folder = tempfile::tempdir().expect("made");
    let add = |text: &str| {
        let path = folder.path().join("a.agf");
        std::fs::write(&path, text).expect("written");
        let mut glasses = Glasses::default();
        glasses.add(&path).map(|()| glasses).map_err(|e| e.to_string())
    };
    let (cd, ld) = ("CD 1 0.006\n", "LD 0.3 2.5\n");
    for (text, line, why) in [
        (format!("NM A 2\n{ld}"), 1, "glass `A` without coefficients; one line CD"),
        (format!("NM A 2\n{ld}NM B 2\n{cd}{ld}"), 1, "glass `A` without coefficients; one line CD"),
        (format!("NM A 2\n{cd}{ld}NM B 2\n{ld}"), 4, "glass `B` without coefficients; one line CD"),
        (format!("NM A 2\nCD\n{ld}"), 2, "glass `A` with a line CD without numbers; one line CD"),
        (format!("NM A 2\n{cd}{cd}{ld}"), 3, "glass `A` with a second line CD; one line CD"),
        (format!("NM A 2\n{cd}{ld}LD 0.4 0.7\n"), 4, "glass `A` with a second line LD; one line LD"),
        (format!("CC mine\n{cd}NM A 2\n{ld}"), 2, "CD before the first glass; one line CD"),
        (format!("{ld}NM A 2\n{cd}"), 1, "LD before the first glass; one line LD"),
        (format!("NM A 2.9\n{cd}{ld}"), 1, "glass `A` with a dispersion formula of number 2.9; a whole number"),
    ] {
        let error = add(&text).expect_err(&text);
        assert!(error.contains(&format!("a.agf: line {line}: {why}")), "{text}{error}");
    }
    let glasses = add(&format!("NM A 2.0\n{cd}{ld}")).expect("reads");
    let index = glasses.find("A", Naming::Exact).expect("a glass").index(500.0);
    assert_abs(index, (1.0 + 0.25 / (0.25 - 0.006_f64)).sqrt(), 1e-12, "one term");
}
