//! Files of other programs: what they mean by what they leave out, and by names.

use super::{Form, Imported, Reading, load, parse, parse_as, text_of};
use crate::lens::catalogue::{Glasses, Naming};
use crate::lens::{Field, ImageSurface, Lens, builtin, paraxial};
use isoplanat_base::testing::{assert_abs, assert_rel, shared};

/// Focal length and sensor distance, mm.
fn measures(lens: &Lens) -> [f64; 2] {
    let first = paraxial::first_order(lens, lens.wavelengths.primary_nm);
    [first.effective_focal_length, lens.surfaces[lens.surfaces.len() - 1].thickness]
}

fn seq(text: &str, reading: Reading) -> isoplanat_base::error::Result<Imported> {
    parse_as(text, Form::Seq, "a.seq", Glasses::shipped(), reading)
}

fn read(text: &str) -> Imported {
    seq(text, Reading::default()).unwrap_or_else(|e| panic!("{text}: {e}"))
}

fn refusal(text: &str) -> String {
    seq(text, Reading::default()).expect_err(text).to_string()
}

/// A biconvex singlet of radii 40 and −60 mm, 3 mm of N-BK7; its closed form is the oracle.
const HEAD: &str = "EPD 5\nDIM M\nWL 587.5618\nYAN 0 3\nSO 0 1e13\n";
fn singlet(index: f64) -> [f64; 2] {
    let (r1, r2, t) = (40.0, -60.0, 3.0);
    let power = (index - 1.0) * (1.0 / r1 - 1.0 / r2 + (index - 1.0) * t / (index * r1 * r2));
    [1.0 / power, (1.0 - (index - 1.0) * t / (index * r1)) / power]
}
fn bk7() -> f64 {
    Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(587.5618)
}

/// Without `RDM` numbers are curvatures, and that is told.
#[test]
fn numbers_are_curvatures_where_the_file_does_not_say() {
    let c = |radii: &str| format!("{radii}{HEAD}S 0.025 3.0 NBK7_SCHOTT\nSTO\nS -0.0166666666666666667 60.0\nSI 0 0\n");
    for (radii, told) in [("LEN NEW\n", true), ("RDM N\n", false), ("RDM NO;LEN\n", false)] {
        let Imported { lens, notes } = read(&c(radii));
        assert_rel(measures(&lens)[0], singlet(bk7())[0], 1e-12, 0.0, radii);
        assert_eq!(notes.iter().any(|n| n.contains("taken as curvatures")), told, "{notes:?}");
    }
    // The same lens by radii: as curvatures its surfaces end before the light does.
    let radii = format!("LEN NEW\n{HEAD}S 40.0 3.0 NBK7_SCHOTT\nSTO\nS -60.0 60.0\nSI 0 0\n");
    let Imported { lens, notes } = read(&radii);
    assert_rel(measures(&lens)[0], singlet(bk7())[0], 1e-12, 0.0, "radii");
    assert!(notes.iter().any(|n| n.contains("taken as radii")), "{notes:?}");
    // Neither makes a lens: an image far from the file's own, as curvatures and as radii.
    for text in [c("LEN NEW\n").replace("60.0\nSI", "400.0\nSI"), radii.replace("60.0\nSI", "400.0\nSI")] {
        let why = refusal(&text);
        assert!(why.contains("taken as curvatures") && why.contains("`RDM N`"), "{why}");
        // Said, it is read.
        let said = if text.contains("0.025") { "RDM N\n" } else { "RDM\n" };
        read(&text.replace("LEN NEW\n", said));
    }
}

/// Statements of CODE V that name what they are about, each against the same lens by `S` alone.
#[test]
fn statements_name_their_surface() {
    let body =
        |s2: &str, more: &str| format!("RDM;LEN\n{HEAD}S 40.0 3.0 NBK7_SCHOTT\nSTO\nS -60.0 {s2}\nSI 0 0\n{more}GO\n");
    let plain = read(&body("44.0", "")).lens;
    for text in [
        body("1.0", "THI S2 44.0\n"),
        body("1.0", "THI S1..2 44.0;THI S1 3.0\n"),
        body("1.0", "THI SI-1 44.0\n"),
        body("43.0", "THI SI 1.0\n"),
        body("44.0", "").replace("S 40.0", "S 1.0").replace("GO", "RDY S1 40.0"),
        body("44.0", "").replace("S 40.0", "S 1.0").replace("GO", "CUY S1 0.025"),
        body("44.0", "").replace("NBK7_SCHOTT", "F2_SCHOTT").replace("GO", "GLA S1 NBK7_SCHOTT"),
        body("44.0", "").replace("WL 587.5618", "WL& ! on\n587.5618"),
        body("44.0", "").replace("SO 0 1e13", "SO INF inf"),
        body("44.0", "").replace("STO\n", "STO\nASP\nK 0.0\nCUF 0.0\n"),
    ] {
        let lens = read(&text).lens;
        assert_eq!((lens.surfaces.len(), lens.stop), (2, 0));
        for (a, b) in measures(&lens).into_iter().zip(measures(&plain)) {
            assert_rel(a, b, 1e-14, 0.0, &text);
        }
    }
    assert_eq!(read(&body("44.0", "STO S2\n")).lens.stop, 1);
    let told =
        seq(&format!("{}ASP\nK 0.3\nA 1e-6\n", body("44.0", "RDY SI -70\n")), Reading::default()).expect("reads");
    assert_eq!(told.lens.image, ImageSurface { curvature: -1.0 / 70.0, conic: 0.3 });
    assert!(told.notes.iter().any(|n| n.contains("terms of the image's form")), "{:?}", told.notes);
    for (more, why) in [
        ("THI S4 1\n", "S1 to S2"),
        ("THI S2\n", "numbers"),
        ("CUY SO 0.1\n", "curved"),
        ("CUF S1 0.1\n", "Fresnel"),
        ("ADE SI 5\n", "ADE 5"),
    ] {
        assert!(refusal(&body("44.0", more)).contains(why), "{more}");
    }
}

/// `PIM` puts the image at the paraxial one, whatever distance is stated, and `SI`'s distance counts from there.
#[test]
fn the_image_solve_is_evaluated() {
    let back = singlet(bk7())[1];
    for (stated, defocus) in [(0.0, 0.0), (12.0, -0.25), (12.0, 0.5)] {
        let text = format!("RDM\n{HEAD}S 40 3 NBK7_SCHOTT\nSTO\nS -60 {stated}\nPIM\nSI 0 {defocus}\n");
        assert_abs(measures(&read(&text).lens)[1], back + defocus, 1e-10, "image");
        if stated == 0.0 {
            continue;
        }
        let off = text.replace("PIM", "PIM N");
        assert_abs(measures(&read(&off).lens)[1], stated + defocus, 1e-12, "without");
    }
    // A near object.
    let near = format!("RDM\n{HEAD}S 40 3 NBK7_SCHOTT\nSTO\nS -60 1\nPIM\nSI 0 0\n").replace("1e13", "200");
    let lens = read(&near).lens;
    let first = paraxial::first_order(&lens, 587.5618);
    assert_abs(measures(&lens)[1], first.paraxial_image_distance, 1e-9, "image of a near object");
}

/// What files of today write: solves in the place of a distance, identities of surfaces, titles of positions, two numbers for a glass, no
/// reference wavelength.
#[test]
fn statements_of_newer_sequences() {
    let back = singlet(bk7())[1];
    let text = |glass: &str, more: &str| format!("RDM\n{HEAD}S 40 3 {glass}\nSTO\nS -60 44\nSI 0 0\n{more}");
    for solve in ["PIM", "HMY 0", "HMY"] {
        let lens = read(&text("NBK7_SCHOTT", &format!("THI S2 {solve}\n"))).lens;
        assert_abs(measures(&lens)[1], back, 1e-10, solve);
    }
    for (more, told) in [
        ("THI S2 OAL S1..2 47\n", "THI OAL"),
        ("UID S1 \"6f1c\"\nUID S0 \"a\"\n", ""),
        ("ZOO 2\nZOO TIT\nTIT Z1 \"far\"\nTIT Z2 \"near\"\nZOO THI S2 44 50\n", "2 zoom positions"),
    ] {
        let Imported { lens, notes } = seq(&text("NBK7_SCHOTT", more), Reading::default()).expect(more);
        assert_abs(measures(&lens)[1], 44.0, 0.0, more);
        assert!(told.is_empty() || notes.iter().any(|n| n.contains(told)), "{notes:?}");
        assert!(!lens.name.contains("near"), "{}", lens.name);
    }
    let lens = read(&text("1.5168 64.17", "")).lens;
    assert_abs(lens.surfaces[0].medium.index(587.5618), 1.5168, 1e-9, "two numbers");
    let several = text("NBK7_SCHOTT", "").replace("WL 587.5618", "WL 650 550");
    let imported = seq(&several, Reading::default()).expect("reads");
    assert!(imported.notes.iter().any(|n| n.contains("(REF)") && n.contains("650 nm")), "{:?}", imported.notes);
    assert_abs(imported.lens.wavelengths.primary_nm, 650.0, 0.0, "the first");
    let stated = seq(&several.replace("WL 650", "REF 2\nWL 650"), Reading::default()).expect("reads");
    assert!(stated.notes.iter().all(|n| !n.contains("(REF)")) && stated.lens.wavelengths.primary_nm == 550.0);
}

/// `MAZH 0 0` of Zemax files is the same solve; one at another height or pupil zone keeps its value.
#[test]
fn marginal_ray_height_solves_are_evaluated() {
    for (solve, distance) in [("MAZH 0 0", singlet(bk7())[1]), ("MAZH 0 0.7", 45.0), ("MAZH 0.1 0", 45.0)] {
        let text = zmx("SCHOTT", "N-BK7").replace("DISZ 45", &format!("DISZ 45\n  {solve}"));
        let lens = parse(&text, Form::Zmx, "a.zmx", Glasses::shipped()).expect(solve).lens;
        assert_abs(measures(&lens)[1], distance, 1e-10, solve);
    }
}

/// Zoom positions, by number.
#[test]
fn zoom_positions_are_read_by_their_number() {
    let text = format!(
        "RDM\n{HEAD}S 40 3 NBK7_SCHOTT\nSTO\nS -60 45\nSI 0 0\nZOO 2\nZOO THI S2 45 50\nZOO EPD 5 4\nZOO YAN F2 3 2\nZOO THC S2 0 0\n"
    );
    for (n, distance, pupil, field) in [(None, 45.0, 5.0, 3.0), (Some(1), 45.0, 5.0, 3.0), (Some(2), 50.0, 4.0, 2.0)] {
        let Imported { lens, notes } = seq(&text, Reading { configuration: n, ..Reading::default() }).expect("reads");
        let first = paraxial::first_order(&lens, 587.5618);
        assert_abs(measures(&lens)[1], distance, 0.0, "distance");
        assert_rel(first.entrance_pupil_diameter, pupil, 1e-12, 0.0, "pupil");
        assert_rel(lens.max_field_deg(), field, 1e-12, 0.0, "field");
        assert!(notes.iter().any(|n| n.contains("2 zoom positions")), "{notes:?}");
    }
    for n in [0, 3] {
        let why = seq(&text, Reading { configuration: Some(n), ..Reading::default() }).expect_err("none").to_string();
        assert!(why.contains("1 to 2"), "{why}");
    }
    assert!(refusal(&text.replace("ZOO THI S2 45 50", "ZOO THI 45")).contains("2 positions"));
    assert!(refusal(&text.replace("ZOO 2\n", "")).contains("first their number"));
}

/// An unknown statement is told of, refused on demand, and refused with a surface whose shape it may be.
#[test]
fn unknown_statements() {
    let text = format!("RDM\nFOO 1 2\n{HEAD}S 40 3 NBK7_SCHOTT\nSTO\nS -60 45\nSI 0 0\nBAR 3\n");
    let notes = read(&text).notes;
    assert!(notes.iter().any(|n| n.contains("FOO (line 2)") && n.contains("BAR")), "{notes:?}");
    assert!(
        seq(&text, Reading { strict: true, ..Reading::default() }).expect_err("strict").to_string().contains("FOO")
    );
    assert!(refusal(&text.replace("STO\n", "STO\nBAZ 1\n")).contains("BAZ"));
    assert!(refusal("FOO 1\nRDM\n").contains("CODE V sequence"));
}

/// The kept cases.
#[test]
fn cases() {
    let cases = [
        ("seq_curvature_mode_default.seq", Some(11.7448), None),
        ("seq_ampersand_joined.seq", None, Some(45.0)),
        ("seq_so_inf.seq", None, Some(45.0)),
        ("seq_cuf.seq", None, Some(45.0)),
        ("seq_thi_statement.seq", None, Some(44.0)),
        ("seq_zoo.seq", None, Some(45.0)),
        ("pim0.seq", None, Some(45.7202)),
    ];
    for (name, focal, distance) in cases {
        let Some(path) = shared(&format!("cases/{name}")) else { return };
        let [f, d] = measures(&load(&path, Glasses::shipped()).unwrap_or_else(|e| panic!("{name}: {e}")).lens);
        assert_abs(f, focal.unwrap_or(singlet(bk7())[0]), 5e-5, name);
        assert_abs(d, distance.unwrap_or(d), 5e-5, name);
    }
}

/// A Zemax file of the singlet with the line `GLAS`.
fn zmx(catalogues: &str, glas: &str) -> String {
    format!(
        "VERS 1\nMODE SEQ\nUNIT MM\nENPD 5\nGCAT {catalogues}\nFTYP 0 0 1 1\nYFLN 3\nWAVM 1 0.5875618 1\nPWAV 1\nSURF 0\n  DISZ INFINITY\n\
         SURF 1\n  STOP\n  CURV 0.025\n  DISZ 3\n  GLAS {glas}\nSURF 2\n  CURV -0.016666666666666666\n  DISZ 45\nSURF 3\n  DISZ 0\n"
    )
}

fn of_glass(catalogues: &str, glas: &str, glasses: &Glasses) -> std::result::Result<(f64, Vec<String>), String> {
    let read = parse(&zmx(catalogues, glas), Form::Zmx, "a.zmx", glasses).map_err(|e| e.to_string())?;
    Ok((read.lens.surfaces[0].medium.index(587.5618), read.notes))
}

/// What a Zemax file states once and states again with another value is refused with both; the same statement again is one.
#[test]
fn statements_of_zemax_files_that_differ_are_refused() {
    let plain = zmx("SCHOTT", "N-BK7 0 0 1.5168 64.17");
    let after = |line: &str, more: &str| plain.replacen(&format!("{line}\n"), &format!("{line}\n{more}\n"), 1);
    let read = |text: &str| parse(text, Form::Zmx, "a.zmx", Glasses::shipped());
    let lens = read(&plain).expect("reads").lens;
    for (line, again, other, why) in [
        (
            "  CURV 0.025",
            "  CURV 2.5e-2 0 0 0 0 \"\"",
            "  CURV 0.03",
            "CURV 0.03 beside 0.025 at line 14 (SURF 1); one",
        ),
        ("  DISZ 3", "  DISZ 3.0", "  DISZ 4", "DISZ 4 beside 3 at line 15 (SURF 1); one"),
        ("  STOP", "  CONI 0\n  CONI 0.0", "  CONI 0\n  CONI 1", "CONI 1 beside 0 at line 14 (SURF 1); one"),
        ("  STOP", "  PARM 1 0\n  PARM 1 0.0", "  PARM 1 0\n  PARM 1 1", "PARM 1 1 beside 0 at"),
        (
            "  STOP",
            "  TYPE STANDARD\n  TYPE STANDARD",
            "  TYPE STANDARD\n  TYPE EVENASPH",
            "TYPE EVENASPH beside STANDARD",
        ),
        ("  GLAS N-BK7 0 0 1.5168 64.17", "  GLAS N-BK7 0 0 1.5168 64.17 0", "  GLAS F2", "GLAS F2 beside N-BK7 0 0"),
        (
            "WAVM 1 0.5875618 1",
            "WAVM 1 0.5875618 1.0",
            "WAVM 1 0.65 1",
            "WAVM 1 0.65 1 beside 0.5875618 1 at line 8; one",
        ),
        ("UNIT MM", "UNIT MM", "UNIT IN", "UNIT IN beside MM at line 3; one"),
    ] {
        assert_eq!(read(&after(line, again)).expect(again).lens.surfaces, lens.surfaces, "{again}");
        let error = read(&after(line, other)).expect_err(other).to_string();
        assert!(error.contains(why), "{error}");
    }
    // Other parameters, and those of other surfaces, are other statements.
    let text = after("  STOP", "  PARM 1 0\n  PARM 2 0").replace("SURF 2\n", "SURF 2\n  PARM 1 0.0\n");
    assert_eq!(read(&text).expect("reads").lens.surfaces, lens.surfaces);
}

/// A sequence that takes in another file, or scales the lens, is not the lens that stands in its text: refused by name, wherever it stands.
#[test]
fn included_files_and_scales_are_refused() {
    let text = |more: &str| format!("RDM\n{HEAD}S 40 3 NBK7_SCHOTT\nSTO\nS -60 45\nSI 0 0\n{more}GO\n");
    for (more, why) in [
        ("IN \"other.seq\"\n", "the file `other.seq` is included (IN); all statements in one file"),
        ("in other.seq\n", "`other.seq`"),
        ("SCA 2\n", "the lens is to be scaled: SCA 2; a lens that was saved scaled"),
        ("SCA EFL 1\n", "SCA EFL 1"),
        ("SCA\n", "to be scaled"),
    ] {
        let first = format!("RDM\n{more}{}", text(""));
        for text in [text(more), first, text("").replace("STO\n", &format!("STO\n{more}"))] {
            let error = refusal(&text);
            assert!(error.contains(why), "{error}");
        }
    }
    assert!(refusal("IN other.seq\nRDM\n").contains("is included"));
    assert!(refusal("In the beginning was the word\n").contains("CODE V sequence"));
    assert_eq!(read(&text("SCA 1\n")).lens.surfaces, read(&text("")).lens.surfaces);
}

/// Another maker's glass of the same name is not taken; numbers that a line only keeps are no statement.
#[test]
fn glasses_are_held_against_their_lines() {
    let own = Glasses::shipped();
    // N-BK7 as it is, as files have it where nothing is known, and as what a line keeps.
    for numbers in
        ["1.5168 64.17 0 0 0 0 0 0", "1.51685 64.2 0 0 0 0", "1.5 40 0 0", "0 0 0", "1.50E+00 4.00E+01 0 1 1 1 0 0"]
    {
        let (n, notes) = of_glass("SCHOTT", &format!("N-BK7 0 0 {numbers}"), own).expect(numbers);
        assert_abs(n, bk7(), 0.0, numbers);
        assert!(notes.iter().all(|n| !n.contains("glass")), "{notes:?}");
    }
    // SCHOTT's F4 has 1.61659; the line is CDGM's.
    let why = of_glass("CDGM", "F4 0 0 1.62004 36.35 0 0", own).expect_err("another glass");
    assert!(why.contains("1.62004") && why.contains("1.61659") && why.contains("--glass-for F4=model"), "{why}");
    for (asked, index, within) in [("model", 1.62004, 1e-12), ("SCHOTT/F4", 1.61659, 5e-6)] {
        let mut glasses = own.clone();
        glasses.take_instead("F4", asked).expect("taken");
        let (n, _) = of_glass("CDGM", "F4 0 0 1.62004 36.35 0 0", &glasses).expect(asked);
        assert_abs(n, index, within, asked);
    }
    // Left over: picked up, a former model with a partial dispersion, one that varied.
    for glas in [
        "SF1 2 5 1.5723 57.5 0 0",
        "SF1 3 0 1.5723 57.5 0",
        "SF1 0 0 1.5723 57.5 -9.E-4 1 1 1 0 0",
        "SF1 0 0 1.5168 64.17 0",
    ] {
        let (n, notes) = of_glass("SCHOTT", glas, own).expect(glas);
        assert_abs(n, 1.71736, 5e-6, glas);
        assert!(notes.iter().any(|n| n.contains("left from another glass")), "{notes:?}");
    }
    // With the maker's catalogue at hand the line's numbers choose, and the file's catalogues come first.
    let Some(cdgm) = shared("data/glass/agf/cdgm.agf") else { return };
    let mut glasses = own.clone();
    glasses.add(&cdgm).expect("a catalogue");
    for (catalogues, glas, index) in [
        ("CDGM", "F4 0 0 1.62004 36.35 0", 1.62004),
        ("CDGM SCHOTT", "F4 0 0 1.5 40 0", 1.62004),
        ("SCHOTT CDGM", "F4 0 0 1.62004 36.35 0", 1.62004),
        ("CDGM", "F4 0 0 1.61659 36.6 0", 1.61659),
    ] {
        assert_abs(of_glass(catalogues, glas, &glasses).expect(glas).0, index, 1e-5, &format!("{catalogues}: {glas}"));
    }
    // Written and read again without that catalogue: the same glass, or an error.
    let lens = parse(&zmx("CDGM", "F4 0 0 1.62004 36.35 0"), Form::Zmx, "a.zmx", &glasses).expect("reads").lens;
    for form in [Form::Toml, Form::Seq] {
        let text = text_of(&lens, form, &glasses).expect("writes").0;
        let again = parse(&text, form, "a", own).expect("reads again").lens;
        assert_abs(again.surfaces[0].medium.index(587.5618), 1.62004, 1e-5, "kept");
    }
    let text = text_of(&lens, Form::Zmx, &glasses).expect("writes").0;
    assert!(parse(&text, Form::Zmx, "a", own).expect_err("SCHOTT's").to_string().contains("--glass-for F4=model"));
}

/// A name that nobody has: the line's own numbers serve when asked; six digits say them themselves.
#[test]
fn missing_glasses_and_codes() {
    let own = Glasses::shipped();
    let why = of_glass("SCHOTT", "MYGLASS7 0 0 1.5168 64.17 0", own).expect_err("unknown");
    assert!(why.contains("--glass-for MYGLASS7=model") && why.contains("1.5168"), "{why}");
    let mut glasses = own.clone();
    glasses.take_instead("MYGLASS7", "model").expect("taken");
    assert_abs(of_glass("SCHOTT", "MYGLASS7 0 0 1.5168 64.17 0", &glasses).expect("reads").0, 1.5168, 1e-12, "model");
    // Without numbers nothing is offered, and nothing taken.
    assert!(!of_glass("SCHOTT", "MYGLASS7 0 0 1.5 40 0", own).expect_err("unknown").contains("=model for"));
    assert!(of_glass("SCHOTT", "MYGLASS7 0 0 1.5 40 0", &glasses).expect_err("no numbers").contains("no index"));
    assert_abs(of_glass("SCHOTT", "517642 0 0 1.517 64.2 0", own).expect("a code").0, 1.517, 1e-12, "code");
}

/// A glass of one index for all wavelengths: from a catalogue, and as a model without dispersion.
#[test]
fn constant_indices_are_read_and_written() {
    let (Some(file), Some(catalogue)) = (shared("cases/const_glass.zmx"), shared("cases/const.agf")) else { return };
    let mut glasses = Glasses::shipped().clone();
    glasses.add(&catalogue).expect("a catalogue");
    let plain = parse(&zmx("", "___BLANK 1 0 1.5 0 0"), Form::Zmx, "a.zmx", &glasses).expect("reads").lens;
    for lens in [load(&file, &glasses).expect("reads").lens, plain] {
        assert_rel(measures(&lens)[0], singlet(1.5)[0], 1e-12, 0.0, "focal length");
        for form in [Form::Toml, Form::Seq, Form::Zmx] {
            let text = text_of(&lens, form, &glasses).unwrap_or_else(|e| panic!("{form:?}: {e}")).0;
            let again = parse(&text, form, "again", &glasses).unwrap_or_else(|e| panic!("{form:?}: {e}\n{text}")).lens;
            for nm in [450.0, 587.5618, 650.0] {
                assert_abs(again.surfaces[0].medium.index(nm), 1.5, 1e-15, "index");
            }
        }
    }
}

/// A term of any power is written and read again, or refused by its power: none is left out.
#[test]
fn no_term_of_an_asphere_is_lost() {
    let lens = crate::lens::builtin::lens("cooke_triplet").expect("shipped");
    for form in [Form::Toml, Form::Zmx, Form::Seq] {
        for power in 2..=crate::lens::shape::HIGHEST_POWER {
            let terms = lens.changed(|l| {
                let shape = &mut l.surfaces[1].shape;
                let (terms, k) = if power % 2 == 0 {
                    (&mut shape.asphere, power / 2 - 1)
                } else {
                    (&mut shape.odd, (power - 3) / 2)
                };
                terms.resize(terms.len().max(k + 1), 0.0);
                terms[k] = 1e-3 * 5f64.powi(-(power as i32));
            });
            let Ok(terms) = terms else { continue };
            match text_of(&terms, form, Glasses::shipped()) {
                Ok((text, _)) => {
                    let read = parse(&text, form, "a", Glasses::shipped()).expect("what was written").lens;
                    let used =
                        |t: &[f64]| t.iter().rposition(|a| *a != 0.0).map_or(Vec::new(), |last| t[..=last].to_vec());
                    let (a, b) = (&read.surfaces[1].shape, &terms.surfaces[1].shape);
                    assert_eq!(
                        (used(&a.asphere), used(&a.odd)),
                        (used(&b.asphere), used(&b.odd)),
                        "{form:?}, r^{power}"
                    );
                }
                Err(e) => assert!(e.to_string().contains(&format!("r^{power}")), "{form:?}: {e}"),
            }
        }
    }
}

/// What is written in a form of another program is read again, or not written (found by fuzzing: an Abbe number below 1 that DeepLens may state and a
/// model glass of Zemax may not; a pupil smaller than any that CODE V's reader takes).
#[test]
fn what_could_not_be_read_again_is_not_written() {
    let deeplens = |medium: &str| {
        format!(
            r#"{{"info":"a","fnum":5.0,"r_sensor":8.0,"d_sensor":60.0,"surfaces":[
            {{"type":"Spheric","r":6.0,"roc":40.0,"d":0.0,"d_next":3.0,"mat2":"{medium}"}},
            {{"type":"Spheric","r":6.0,"roc":-60.0,"d":3.0,"d_next":1.0,"mat2":"air"}},
            {{"type":"Aperture","r":3.0,"d":4.0,"d_next":55.0}}]}}"#
        )
    };
    let written = |medium: &str| {
        let lens = parse(&deeplens(medium), Form::Json, "a.json", Glasses::shipped()).expect(medium).lens;
        text_of(&lens, Form::Zmx, Glasses::shipped())
    };
    assert!(written("1.516468/64.2").is_ok());
    let error = written("1.516468/.2").expect_err("no glass").to_string();
    assert!(error.contains("could not be read again") && error.contains("V_d") && !error.contains('\n'), "{error}");
}

/// More wavelengths than another program reads are told, the reference one of no weight among them; what is written is all of them.
#[test]
fn more_wavelengths_than_a_program_reads_are_told() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    for (form, program, most) in [(Form::Zmx, "OpticStudio", 24), (Form::Seq, "CODE V", 21)] {
        for (count, apart, told) in
            [(most, false, false), (most, true, true), (most + 1, false, true), (100, false, true)]
        {
            let many = lens.changed(|l| {
                l.wavelengths.nm = (0..count).map(|k| 450.0 + 200.0 * k as f64 / count as f64).collect();
                l.wavelengths.weights = vec![1.0; count];
                l.wavelengths.primary_nm = if apart { 587.5618 } else { l.wavelengths.nm[3] };
            });
            let many = many.expect("a lens");
            let (text, notes) = text_of(&many, form, Glasses::shipped()).expect("writes");
            let said = notes.iter().any(|n| n.contains(&format!("{program} reads {most} at most")));
            assert_eq!(said, told, "{form:?} {count} {apart}: {notes:?}");
            let read = parse(&text, form, "a", Glasses::shipped()).expect("reads").lens;
            assert_eq!(read.wavelengths.nm.len(), count + usize::from(apart));
        }
    }
}

/// A glass of two numbers goes out to CODE V as a table and from there to Zemax as two numbers again; a table of its own stays refused, with a way out.
#[test]
fn model_glasses_come_back_from_tables() {
    let lens = builtin::lens("tessar").expect("shipped");
    let again = |lens: &Lens, form: Form| {
        let text = text_of(lens, form, Glasses::shipped()).expect("written").0;
        parse(&text, form, "again", Glasses::shipped()).expect("reads").lens
    };
    let table = again(&lens, Form::Seq);
    assert!(matches!(table.surfaces[0].medium, crate::lens::Medium::Table { .. }));
    let back = again(&table, Form::Zmx);
    for nm in [486.1327, 540.0, 587.5618, 656.2725] {
        for (a, b) in lens.surfaces.iter().zip(&back.surfaces) {
            assert_abs(b.medium.index(nm), a.medium.index(nm), 1e-9, "index");
        }
    }
    let bent = table.changed(|l| {
        if let crate::lens::Medium::Table { index, .. } = &mut l.surfaces[0].medium {
            index[1] += 1e-6;
        }
    });
    let why = text_of(&bent.expect("a lens"), Form::Zmx, Glasses::shipped()).expect_err("a table").to_string();
    assert!(why.contains("surface[0].medium") && why.contains("{ n_d, v_d }, as its `medium` in a .toml"), "{why}");
}

/// Fields that a file states stay: as angles and as heights, through each form. Points on both sides of the axis, or all around it, are one.
#[test]
fn stated_fields_are_kept() {
    let file = |kind: u8, object: &str, x: &str, y: &str| {
        let count = y.split(' ').count();
        format!(
            "MODE SEQ\nNAME fields\nUNIT MM X W X CM MR CPMM\nENPD 4\nFTYP {kind} 0 {count} 1\nXFLN {x}\nYFLN {y}\nWAVM 1 0.5875618 1\nPWAV 1\n\
             SURF 0\n  TYPE STANDARD\n  CURV 0\n  DISZ {object}\nSURF 1\n  STOP\n  TYPE STANDARD\n  CURV 0.02\n  DISZ 3\n  GLAS N-BK7 0 0 1.5168 64.17\n\
             SURF 2\n  TYPE STANDARD\n  CURV -0.01\n  DISZ 60\nSURF 3\n  TYPE STANDARD\n  CURV 0\n  DISZ 0\n"
        )
    };
    let angle = (3_f64.to_radians().tan().hypot(4_f64.to_radians().tan())).atan().to_degrees();
    let cases = [
        (file(0, "INFINITY", "0 0 0 0", "0 7 -7 10"), vec![0.0, 7.0, 10.0]),
        (file(0, "INFINITY", "0 0 3 -3 6", "0 2 4 4 0"), vec![0.0, 2.0, angle, 6.0]),
        (file(1, "200", "0 0 0 3", "5 0 -5 4"), vec![0.0, 5.0]),
        (file(0, "INFINITY", "0 0 0", "0 0 0"), vec![]),
    ];
    for (text, wanted) in cases {
        let lens = parse(&text, Form::Zmx, "a.zmx", Glasses::shipped()).unwrap_or_else(|e| panic!("{text}: {e}")).lens;
        let near = |lens: &Lens, of: Form| {
            assert_eq!(lens.field_points.len(), wanted.len(), "{of:?}: {:?}", lens.field_points);
            lens.field_points.iter().zip(&wanted).for_each(|(a, b)| assert_abs(*a, *b, 1e-12, "a field"));
        };
        near(&lens, Form::Zmx);
        for form in [Form::Toml, Form::Zmx, Form::Seq] {
            let (written, _) = text_of(&lens, form, Glasses::shipped()).unwrap_or_else(|e| panic!("{form:?}: {e}"));
            let again = parse(&written, form, "", Glasses::shipped()).unwrap_or_else(|e| panic!("{written}: {e}")).lens;
            match (form, wanted.is_empty()) {
                (Form::Toml, _) => assert_eq!(again.field_points, lens.field_points),
                (_, false) => near(&again, form),
                // The axis alone, three times.
                (_, true) => assert!(again.field_points.is_empty()),
            }
            assert_eq!(again.field, lens.field, "{form:?}");
        }
        // A smaller field leaves out what lies beyond.
        if let [.., before, last] = lens.field_points[..] {
            let half = lens.changed(|l| {
                l.field = if l.object_vergence > 0.0 {
                    Field::ObjectHeight(f64::midpoint(before, last))
                } else {
                    Field::Angle(f64::midpoint(before, last))
                }
            });
            let points = half.expect("a lens").field_points_deg();
            assert_eq!(points.len(), wanted.len() - 1, "{points:?}");
        }
    }
    let own = |field: &str| {
        let text = builtin::text("cooke_triplet")
            .expect("shipped")
            .replace("field = { max_angle_deg = 20.0 }", &format!("field = {{ {field} }}"));
        parse(&text, Form::Toml, "a.toml", Glasses::shipped())
    };
    assert_eq!(
        own("max_angle_deg = 20.0, angles_deg = [0, 14, 20]").expect("reads").lens.field_points,
        [0.0, 14.0, 20.0]
    );
    for (field, told) in [
        ("max_angle_deg = 20.0, angles_deg = [0, 21]", "field.angles_deg: 21; up to the largest field, 20"),
        ("max_angle_deg = 20.0, angles_deg = [14, 0]", "rising numbers"),
        ("max_angle_deg = 20.0, angles_deg = [-1, 0]", "rising numbers"),
        ("max_angle_deg = 20.0, object_heights_mm = [0, 1]", "field.object_heights_mm"),
    ] {
        let why = own(field).expect_err(field).to_string();
        assert!(why.contains(told), "{why}");
    }
}
