//! Lens files of other programs: published ones by their focal lengths, round trips by their rays, spoilt ones by their refusals.

use std::path::{Path, PathBuf};

use glam::DVec3;
use isoplanat::interchange::{Form, Reading, load, parse, parse_as, text_of};
use isoplanat::lens::catalogue::Glasses;
use isoplanat::lens::{Aperture, Lens, builtin, paraxial, seidel};
use isoplanat::testing::{assert_abs, assert_rel, shared};
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{Ray, System};

use crate::support::Workplace;

/// The shipped glasses with the catalogues of the shared data, and the two that no catalogue has.
fn glasses() -> Option<Glasses> {
    let mut all = Glasses::shipped().clone();
    all.add(&shared("data/glass/agf")?).expect("catalogues");
    for (name, glass) in [("SSK4", "SSK4A"), ("L-TIM28_MOLD", "L-TIM28")] {
        all.take_instead(name, glass).expect("a glass");
    }
    Some(all)
}

fn files() -> Option<Vec<PathBuf>> {
    let listed = std::fs::read_dir(shared("data/lenses")?).expect("lists");
    let mut files: Vec<PathBuf> = listed.map(|e| e.expect("entry").path()).collect();
    let facts = ["first_order_facts.json", "baselines.json"];
    files.retain(|p| p.extension().is_some_and(|e| e != "tsv") && !facts.iter().any(|f| p.ends_with(f)));
    files.sort();
    Some(files)
}

fn name(path: &Path) -> String {
    path.file_name().expect("a file").to_string_lossy().into_owned()
}

/// Focal length by a real ray close to the axis: no paraxial formula in it.
fn by_rays(lens: &Lens) -> f64 {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let y = 1e-4 * paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_diameter;
    let ray = Ray { origin: DVec3::new(0.0, y, -1.0), direction: DVec3::Z };
    let landed =
        trace(&system, ray, system.image(), &mut Vec::new()).unwrap_or_else(|f| panic!("{}: {f:?}", lens.name));
    -y / (landed.direction.y / landed.direction.z)
}

const REFUSED: [(&str, &str); 3] =
    [("HoO-V2C18Ex03.zmx", "mirror"), ("US05331467-1_photo_prime.zmx", "mirror"), ("edmund_37992.zmx", "mirror")];

#[test]
fn published_files_have_their_focal_lengths() {
    let (Some(files), Some(glasses)) = (files(), glasses()) else { return };
    let facts = std::fs::read(shared("data/lenses/first_order_facts.json").expect("beside the files")).expect("reads");
    let facts: serde_json::Value = serde_json::from_slice(&facts).expect("JSON");
    let mut read = 0;
    for path in files.iter().filter(|p| p.is_file()) {
        let name = name(path);
        if let Some((_, why)) = REFUSED.iter().find(|(n, _)| *n == name) {
            let error = load(path, &glasses).expect_err(&name).to_string();
            assert!(error.contains(why) && error.contains("line "), "{error}");
            continue;
        }
        let imported = load(path, &glasses).unwrap_or_else(|e| panic!("{e}"));
        let lens = imported.lens;
        let first = paraxial::first_order(&lens, lens.wavelengths.primary_nm);
        let facts = &facts[name.as_str()];
        if let Some(efl) = facts["efl_mm"].as_f64() {
            // The facts are in the file's unit.
            let unit = if facts["header"]["UNIT"].as_str().is_some_and(|u| u.starts_with("IN")) { 25.4 } else { 1.0 };
            assert_rel(first.effective_focal_length, efl * unit, 1e-6, 1e-9, &name);
            assert_rel(
                first.back_focal_length,
                facts["bfl_paraxial_mm"].as_f64().expect("beside") * unit,
                1e-6,
                1e-9,
                &name,
            );
        }
        assert_rel(first.effective_focal_length, by_rays(&lens), 1e-6, 1e-9, &name);
        read += 1;
    }
    assert!(read >= 21, "{read}");
}

/// The CODE V sample: first order and third order to the digits that CODE V prints.
#[test]
fn the_double_gauss_of_code_v_has_its_printed_numbers() {
    let Some(path) = shared("data/lenses/ag_dblgauss.seq") else { return };
    let lens = load(&path, Glasses::shipped()).expect("reads").lens;
    let first = paraxial::first_order(&lens, 587.6);
    for (value, printed) in [
        (first.effective_focal_length, 100.0038),
        (first.back_focal_length, 61.4875),
        (first.front_focal_length, -29.3208),
        (first.exit_pupil_position, -53.1569),
    ] {
        assert_abs(value, printed, 0.5001e-4, "first order");
    }
    let s = seidel::total(&seidel::per_surface(&lens, 587.6));
    // Transverse third-order aberrations: sums over 2 n' u', with the image-side slope negative.
    let slope = 2.0 * -0.5 * first.entrance_pupil_diameter / first.effective_focal_length;
    let [s1, s2, s3, s4, s5] = [s.spherical, s.coma, s.astigmatism, s.petzval, s.distortion];
    for (sum, printed) in [
        (s1, -0.306_954),
        (3.0 * s2, 0.037_071),
        (3.0 * s3 + s4, -0.074_910),
        (s3 + s4, -0.160_505),
        (s4, -0.203_302),
        (s5, -0.232_420),
    ] {
        assert_abs(sum / slope, printed, 0.5001e-6, "third order");
    }
}

/// Rays of two lenses: landing points and directions of a few rays through each.
fn same_rays(a: &Lens, b: &Lens, what: &str) {
    let nm = a.wavelengths.primary_nm;
    let (sa, sb) = (System::new(a, nm), System::new(b, nm));
    let first = paraxial::first_order(a, nm);
    let reach = 0.45 * first.entrance_pupil_diameter;
    let size = a.length().abs() + 1.0;
    for (x, y, slope) in [(0.0, 0.3, 0.0), (0.2, -0.4, 0.05), (0.5, 0.5, -0.03), (0.0, 1.0, 0.1)] {
        let direction = DVec3::new(0.3 * slope, slope, 1.0).normalize();
        let origin = DVec3::new(x * reach, y * reach, -1.0);
        let landed = |s: &System| {
            trace(s, Ray { origin, direction }, s.image(), &mut Vec::new()).map(|h| (h.at.point, h.direction))
        };
        match (landed(&sa), landed(&sb)) {
            (Ok((p, d)), Ok((q, e))) => {
                assert!((p - q).length() <= 1e-11 * size && (d - e).length() <= 1e-12, "{what}: {p} {q}");
            }
            (a, b) => assert_eq!(a.err(), b.err(), "{what}"),
        }
    }
    assert_eq!(a.stop, b.stop, "{what}");
    let stop = |l: &Lens| paraxial::stop_semi_diameter(l);
    assert_rel(stop(a), stop(b), 1e-9, 1e-12, what);
    assert_rel(a.max_field_deg() + 1.0, b.max_field_deg() + 1.0, 1e-12, 1e-12, what);
}

#[test]
fn written_files_give_the_same_rays() {
    let shipped = builtin::LENSES.iter().map(|(n, _)| ((*n).to_owned(), builtin::lens(n).expect("shipped")));
    let mut lenses: Vec<(String, Lens)> = shipped.collect();
    let catalogues = glasses();
    if let (Some(files), Some(glasses)) = (files(), &catalogues) {
        lenses.extend(files.iter().filter_map(|p| Some((name(p), load(p, glasses).ok()?.lens))));
    }
    let glasses = catalogues.unwrap_or_else(|| Glasses::shipped().clone());
    let mut written = [0; 3];
    for (name, lens) in &lenses {
        for (k, form) in [Form::Toml, Form::Zmx, Form::Seq].into_iter().enumerate() {
            match text_of(lens, form, &glasses) {
                Ok((text, _)) => {
                    let again = parse(&text, form, "again", &glasses).unwrap_or_else(|e| panic!("{name}: {e}\n{text}"));
                    same_rays(lens, &again.lens, &format!("{name} as {form:?}"));
                    written[k] += 1;
                }
                // What a form cannot say is refused with a reason: r² and odd terms in CODE V, in Zemax tables and two glasses that
                // bear the names of two catalogues crosswise.
                Err(e) => {
                    let reasons = ["a term of r^", "no tables", "one list of catalogues"];
                    assert!(reasons.iter().any(|r| e.to_string().contains(r)), "{name}: {e}");
                    eprintln!("{e}");
                }
            }
        }
    }
    eprintln!("{} lenses; written as TOML, zmx, seq: {written:?}", lenses.len());
    assert!(
        written[0] == lenses.len() && written[1] + 3 >= lenses.len() && written[2] + 4 >= lenses.len(),
        "{written:?}"
    );
}

/// A Zemax file in UTF-16, UTF-8 with and without its mark, Latin-1; in inches; with planes out of order.
const TRIPLE: &str = "VERS 1\r\nMODE SEQ\r\nNAME Ärger\r\nUNIT MM X\r\nENPD 4\r\nFTYP 0 0 2 1\r\nYFLN 0 5\r\nWAVM 1 0.5876 1\r\nPWAV 1\r\n\
    SURF 0\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ INFINITY\r\nSURF 1\r\n  STOP\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ 3\r\n\
    SURF 2\r\n  TYPE EVENASPH\r\n  CURV 0.04\r\n  PARM 2 1e-6\r\n  DISZ 2\r\n  GLAS N-BK7 0 0\r\n\
    SURF 3\r\n  TYPE STANDARD\r\n  CURV -0.02\r\n  DISZ 30\r\nSURF 4\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ 0\r\n";

#[test]
fn encodings_and_units_are_understood() {
    let place = Workplace::new();
    let read = |bytes: &[u8]| {
        place.write("a.zmx", bytes);
        load(&place.path("a.zmx"), Glasses::shipped()).expect("reads").lens
    };
    let plain = read(TRIPLE.as_bytes());
    assert_eq!(plain.name, "Ärger");
    let wide: Vec<u8> = [0xff, 0xfe].into_iter().chain(TRIPLE.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    let marked: Vec<u8> = [0xef, 0xbb, 0xbf].into_iter().chain(TRIPLE.bytes()).collect();
    let latin: Vec<u8> = TRIPLE.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect();
    for bytes in [wide, marked, latin] {
        assert_eq!(read(&bytes), plain);
    }
    // A lens in inches is the lens in mm, 25.4 times as large.
    let inches = read(TRIPLE.replace("UNIT MM", "UNIT IN").as_bytes());
    let efl = |l: &Lens| paraxial::first_order(l, 587.6).effective_focal_length;
    assert_rel(efl(&inches), 25.4 * efl(&plain), 1e-12, 1e-12, "inches");
    assert_rel(inches.surfaces[1].shape.asphere[1], 1e-6 / 25.4f64.powi(3), 1e-12, 0.0, "r⁴ in inches");
}

/// A stop behind the lens in the file's order, before it in space; and one that lies within glass.
#[test]
fn planes_reached_by_negative_distances_are_put_in_order() {
    let moved = TRIPLE
        .replace("SURF 1\r\n  STOP\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ 3", "SURF 1\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ -4\r\nSURF 2\r\n  STOP\r\n  TYPE STANDARD\r\n  CURV 0\r\n  DISZ 7")
        .replace("SURF 4\r\n", "SURF 5\r\n")
        .replace("SURF 3\r\n  TYPE STANDARD\r\n  CURV -0.02", "SURF 4\r\n  TYPE STANDARD\r\n  CURV -0.02")
        .replace("SURF 2\r\n  TYPE EVEN", "SURF 3\r\n  TYPE EVEN");
    let lens = parse(&moved, Form::Zmx, "a.zmx", Glasses::shipped()).expect("reads").lens;
    // The stop stands 4 mm before the plane that the file names first, 7 mm before the glass.
    assert_eq!(lens.stop, 0);
    let thicknesses: Vec<f64> = lens.surfaces.iter().map(|s| s.thickness).collect();
    assert_eq!(thicknesses, [4.0, 3.0, 2.0, 30.0]);
    let within = TRIPLE.replace("DISZ 3\r\n", "DISZ -1\r\n");
    let error = parse(&within, Form::Zmx, "a.zmx", Glasses::shipped()).expect_err("within glass").to_string();
    assert!(error.contains("SURF 1") && error.contains("negative distance"), "{error}");
}

/// A surface that is to be ignored does something to rays all the same; a glass is its name's, and an Abbe number that is not its own is told.
#[test]
fn what_a_line_says_beside_its_glass_is_looked_at() {
    let file = |glass: &str, more: &str| {
        let text = format!(
            "MODE SEQ\nUNIT MM\nENPD 4\nWAVM 1 0.5875618 1\nPWAV 1\nFTYP 0 0 1 1\nXFLN 0\nYFLN 0\nSURF 0\n  TYPE STANDARD\n  CURV 0\n  DISZ INFINITY\n\
             SURF 1\n  STOP\n  TYPE STANDARD\n  CURV 0.02\n{more}  DISZ 3\n  GLAS {glass}\n  DIAM 5\nSURF 2\n  TYPE STANDARD\n  CURV -0.02\n  DISZ 47\n  DIAM 5\n\
             SURF 3\n  TYPE STANDARD\n  CURV 0\n  DISZ 0\n"
        );
        parse(&text, Form::Zmx, "a.zmx", Glasses::shipped())
    };
    let plain = file("N-BK7 0 0 1.5168 64.17 0 0", "").expect("reads");
    let other = file("N-BK7 0 0 1.5168 50 0 0", "").expect("reads");
    assert!(plain.lens == other.lens && plain.notes.iter().all(|n| !n.contains("V_d")), "{:?}", plain.notes);
    assert!(other.notes.iter().any(|n| n.contains("its V_d is 64.17, the line's 50 is not used")), "{:?}", other.notes);
    assert_eq!(file("N-BK7 0 0", "  IGNR 0\n").expect("reads").lens, plain.lens);
    let error = file("N-BK7 0 0", "  IGNR 1\n").expect_err("ignored").to_string();
    assert!(error.contains("to be ignored") && error.contains("(SURF 1)"), "{error}");
    let error = file("XK99 0 0 1.5 40 0 0", "").expect_err("unknown").to_string();
    assert!(error.contains("--glass-for XK99=GLASS"), "{error}");
}

/// The medium before the first surface, of each form that states one: light of an object at infinity in it has another focal length, which the first face's power says.
#[test]
fn objects_in_glass_are_read_from_every_form() {
    let Some(glasses) = glasses() else { return };
    let Some(path) = shared("data/lenses/optiland_Cooke_triplet.json") else { return };
    // JSON has no infinities, these files do.
    let quoted = [("-Infinity", "\"-inf\""), ("Infinity", "\"inf\"")];
    let optiland = |n: f64| {
        let text = std::fs::read_to_string(&path).expect("reads");
        let text = quoted.iter().fold(text, |text, (bare, named)| text.replace(bare, named));
        let mut file: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        file["surface_group"]["surfaces"][0]["material_post"]["index"] = n.into();
        let text = quoted.iter().fold(file.to_string(), |text, (bare, named)| text.replace(named, bare));
        parse(&text, Form::Json, "a.json", &glasses)
    };
    let seq = |medium: &str| {
        let text = format!(
            "RDM;LEN\nEPD 4\nDIM M\nWL 587.5618\nYAN 0\nSO 0 1e13{medium}\nS 50 3 NBK7_SCHOTT\n STO\nS -50 95\nSI 0 0\nGO\n"
        );
        parse(&text, Form::Seq, "a.seq", &glasses)
    };
    let [n_glass, radius] = [1.516_800_034_505_588_5, 50.0];
    let n = seq("").expect("reads").lens.indices(587.5618)[1];
    assert_abs(n, n_glass, 1e-9, "N-BK7");
    for (what, index, read) in [("Optiland", 1.02, optiland(1.02)), ("two numbers", 1.333, seq(" 1.333 55"))] {
        let lens = read.unwrap_or_else(|e| panic!("{what}: {e}")).lens;
        assert_abs(lens.indices(lens.wavelengths.primary_nm)[0], index, 1e-6, what);
    }
    let unknown = seq(" NOGLASS_SCHOTT").expect_err("unknown").to_string();
    assert!(unknown.starts_with("a.seq: line 6") && unknown.contains("NOGLASS"), "{unknown}");
    let efl = |medium: &str| {
        let lens = seq(medium).expect("reads").lens;
        paraxial::first_order(&lens, 587.5618).effective_focal_length
    };
    // Thick lens in closed form; in its own glass the rear face is alone.
    let power = |n0: f64| {
        let (a, b) = ((n - n0) / radius, (1.0 - n) / -radius);
        a + b - a * b * 3.0 / n
    };
    assert_rel(efl(""), 1.0 / power(1.0), 1e-12, 0.0, "in air");
    assert_rel(efl(" NBK7_SCHOTT"), radius / (n - 1.0), 1e-12, 0.0, "in glass");
    assert!(optiland(1.0).expect("reads").notes.iter().all(|n| !n.contains("lies within")));
}

#[test]
fn what_is_not_supported_is_refused_by_name_and_line() {
    for (from, to, expected) in [
        ("GLAS N-BK7", "GLAS MIRROR", "line 24 (SURF 2): a mirror"),
        ("GLAS N-BK7", "GLAS N-BK8", "N-BK7"),
        ("TYPE EVENASPH", "TYPE BINARY_2", "line 19 (SURF 2): a surface of type BINARY_2"),
        ("PARM 2 1e-6", "PARM 2 nan", "line 22 (SURF 2): `nan`"),
        ("CURV 0.04", "CURV inf", "`inf`"),
        ("MODE SEQ", "MODE NSC", "line 2: mode NSC"),
        ("UNIT MM", "UNIT FT", "line 4: the unit `FT`"),
        ("ENPD 4", "ENPD 4\r\nFNUM 3 0", "line 6: FNUM beside ENPD"),
        ("ENPD 4", "", "aperture"),
        ("  STOP\r\n", "  STOP\r\n  HURZ 1\r\n", "line 16 (SURF 1): the keyword `HURZ`"),
        ("SURF 3", "SURF 7", "SURF 7"),
        ("DISZ 2\r\n", "DISZ 2\r\n  OBSC 0 1\r\n", "obscuration"),
        ("DISZ 2\r\n", "DISZ 2\r\n  CLAP 1 2\r\n", "annular"),
        ("WAVM 1 0.5876 1", "WAVM 1 5.876 1", "5876"),
        ("WAVM 1 0.5876 1", "WAVM 1 nan 1", "`nan`"),
    ] {
        let text = TRIPLE.replacen(from, to, 1);
        assert_ne!(text, TRIPLE, "{from}");
        let error = parse(&text, Form::Zmx, "a.zmx", Glasses::shipped()).expect_err(to).to_string();
        assert!(error.contains("a.zmx: ") && error.contains(expected), "{to}: {error}");
    }
    for (text, form) in [
        ("", Form::Zmx),
        ("", Form::Seq),
        ("", Form::Json),
        ("", Form::Txt),
        ("{}", Form::Json),
        ("hello world", Form::Zmx),
        ("hello world", Form::Seq),
        ("\u{0}\u{1}", Form::Seq),
        ("[[[[", Form::Json),
    ] {
        let error = parse(text, form, "a.file", Glasses::shipped()).expect_err("no lens").to_string();
        assert!(error.starts_with("a.file: "), "{form:?}: {error}");
    }
    // A million surfaces: refused at the first that is too many.
    let many: String = (0..1_000_000).map(|i| format!("SURF {i}\n")).collect();
    let error = parse(&many, Form::Zmx, "a.zmx", Glasses::shipped()).expect_err("too many").to_string();
    assert!(error.contains("at most 400"), "{error}");
    let many = format!("SO 0 1e13\n{}", "S 0 1\n".repeat(1_000_000));
    assert!(parse(&many, Form::Seq, "a.seq", Glasses::shipped()).is_err());
}

/// Files cut at random places and with random bytes: a lens or one line, no panic.
#[test]
fn spoilt_files_are_read_or_refused() {
    let mut texts: Vec<(Form, Vec<u8>)> = vec![(Form::Zmx, TRIPLE.into())];
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    for form in [Form::Toml, Form::Zmx, Form::Seq] {
        texts.push((form, text_of(&lens, form, Glasses::shipped()).expect("writes").0.into_bytes()));
    }
    if let Some(files) = files() {
        texts.extend(
            files
                .iter()
                .filter(|p| p.is_file())
                .map(|p| (Form::from_path(p).expect("a form"), std::fs::read(p).expect("reads"))),
        );
    }
    // Lines that a Zemax file may have anywhere.
    let lines = [
        "XDAT 1 1e9",
        "XDAT 2 0",
        "XDAT 4 1e300",
        "XDAT 299 1",
        "  TYPE XOSPHERE",
        "  TYPE XASPHERE",
        "MNUM 3 9",
        "THIC 2 1 1e10",
        "THIC 99 1 0",
        "GLSS 2 1 MIRROR",
        "STPS 0 1 900",
        "WAVE 0 1 0.5",
        "YFIE 70 1 3",
        "PAR8 1 1 nan",
        "APER 0 1 -3",
        "SURF 5AS",
        "DBDT 0",
        "HURZ",
        "  CURV 0,5",
        "FTYP 3 0 2 1",
        "  DISZ -1E+10",
        "  DIAM 1E300 1",
        "GLAS ___BLANK 1 0 -1",
    ];
    let rng = &mut fastrand::Rng::with_seed(13);
    let place = Workplace::new();
    for (form, bytes) in &texts {
        for _ in 0..if *form == Form::Zmx { 40 } else { 0 } {
            let text = String::from_utf8_lossy(bytes);
            let mut spoilt: Vec<&str> = text.lines().collect();
            for _ in 0..rng.usize(1..4) {
                spoilt.insert(rng.usize(0..=spoilt.len()), lines[rng.usize(0..lines.len())]);
            }
            let reading = Reading {
                strict: rng.bool(),
                configuration: [None, Some(rng.usize(0..4))][rng.usize(0..2)],
                ..Reading::default()
            };
            if let Err(error) = parse_as(&spoilt.join("\n"), Form::Zmx, "a.zmx", Glasses::shipped(), reading) {
                let text = error.to_string();
                assert!(text.contains("a.zmx") && !text.contains('\n'), "{text}");
            }
        }
        for _ in 0..20 {
            let mut spoilt = bytes.clone();
            if rng.bool() {
                spoilt.truncate(rng.usize(0..bytes.len()));
            }
            for _ in 0..rng.usize(0..4) {
                if let Some(at) = (!spoilt.is_empty()).then(|| rng.usize(0..spoilt.len())) {
                    spoilt[at] = rng.u8(..);
                }
            }
            let file = format!("a.{}", format!("{form:?}").to_ascii_lowercase());
            place.write(&file, &spoilt);
            if let Err(error) = load(&place.path(&file), Glasses::shipped()) {
                let text = error.to_string();
                assert!(text.contains(&file) && !text.contains('\n'), "{text}");
            }
        }
    }
}

#[test]
fn commands_take_any_file_and_convert_writes_them() {
    let place = Workplace::new();
    place.write("a.zmx", TRIPLE);
    // Scaled, by a factor and to a focal length: all lengths, and the pixels stay.
    let first = |file: &str| -> serde_json::Value {
        serde_json::from_str(&place.run(&format!("inspect {file} --json")).done()).expect("JSON")
    };
    for (how, file) in [("--scale 2", "twice.toml"), ("--focal-length-mm 100", "hundred.toml")] {
        place.run(&format!("convert cooke_triplet {file} {how}")).done();
        let (a, b) = (first("cooke_triplet"), first(file));
        let factor = b["length_mm"].as_f64().expect("mm") / a["length_mm"].as_f64().expect("mm");
        let focal = b["effective_focal_length_mm"].as_f64().expect("mm");
        assert!(
            if how.contains("scale") { factor == 2.0 } else { (focal - 100.0).abs() < 1e-9 },
            "{how}: {factor} {focal}"
        );
        let [own, scaled] = [&a, &b].map(|l| l["f_number"].as_f64().expect("a number"));
        assert!((own - scaled).abs() < 1e-9 * own, "{how}: {own} {scaled}");
    }
    place.run("convert cooke_triplet no.toml --scale 0").refused(&["--scale", "0", "a positive number"]);
    assert!(!place.path("no.toml").exists());
    let ran = place.run("convert a.zmx b.seq");
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(
        ran.err.contains("note: a.zmx: ") && ran.err.contains("clear semi-diameters follow from the beam"),
        "{}",
        ran.err
    );
    assert_eq!(place.run("convert b.seq c.toml").code, 0);
    assert_eq!(place.run("convert b.seq c.toml").code, 2);
    assert_eq!(place.run("convert b.seq c.toml --force --json").code, 0);
    assert_eq!(place.run("convert b.seq c.json").code, 2);
    let efl = |file: &str| {
        let ran = place.run(&format!("inspect {file} --json"));
        assert_eq!(ran.code, 0, "{}", ran.err);
        serde_json::from_str::<serde_json::Value>(&ran.out).expect("JSON")["effective_focal_length_mm"]
            .as_f64()
            .expect("a number")
    };
    let expected = efl("a.zmx");
    for file in ["b.seq", "c.toml"] {
        assert_rel(efl(file), expected, 1e-12, 1e-12, file);
    }
    for command in
        ["check a.zmx", "psf b.seq -o k.npz --fields 2", "render a.zmx slanted_edges -o p.png --columns 60 --rows 40"]
    {
        let ran = place.run(command);
        assert!(ran.code < 2, "{command}: {}", ran.err);
    }
    // Another glass only where somebody says so.
    place.write("s.zmx", TRIPLE.replace("N-BK7", "SSK4"));
    let ran = place.run("inspect s.zmx");
    assert!(ran.code == 2 && ran.err.contains("SSK4") && ran.err.contains("line 19"), "{}", ran.err);
    let ran = place.run("inspect s.zmx --glass-for SSK4=SSK4A");
    assert!(ran.code == 0 && ran.out.contains("SSK4A"), "{}", ran.err);
    let ran = place.run("inspect s.zmx --glass-for SSK4");
    assert!(ran.code == 2 && ran.err.contains("--glass-for"), "{}", ran.err);
    // In every form of a file, of a shipped lens too, and however the name is spelled; a name that no surface has is refused.
    place.run("convert cooke_triplet c.zmx").done();
    place.run("convert cooke_triplet c.seq").done();
    let focal_length = |ran: &crate::support::Ran| {
        ran.out.lines().find(|l| l.starts_with("effective focal length")).map(str::to_owned)
    };
    let wanted = focal_length(&place.run("inspect cooke_triplet --glass-for N-SK16=N-BK7"));
    assert!(wanted.as_ref().is_some_and(|l| l.contains("100.09")), "{wanted:?}");
    for file in ["cooke_triplet", "c.zmx", "c.seq"] {
        for name in ["N-SK16", "SCHOTT/N-SK16", "NSK16_SCHOTT", "nsk16"] {
            let ran = place.run(&format!("inspect {file} --glass-for {name}=N-BK7"));
            assert_eq!(focal_length(&ran), wanted, "{file} {name}: {}", ran.err);
        }
        let ran = place.run(&format!("inspect {file} --glass-for N-SK1=N-BK7"));
        assert!(ran.code == 2 && ran.err.contains("`N-SK1`") && ran.err.contains("SK16"), "{file}: {}", ran.err);
    }
    let ran = place.run("lenses c.zmx cooke_triplet --glass-for N-SK1=N-BK7");
    assert!(ran.code == 2 && ran.err.contains("`N-SK1`"), "{}", ran.err);
}

/// What the stop of a file's aperture is, by each way of stating it.
#[test]
fn apertures_are_understood() {
    let finite = TRIPLE.replace("DISZ INFINITY", "DISZ 200");
    let pupil = |text: &str| {
        let lens = parse(text, Form::Zmx, "a.zmx", Glasses::shipped()).unwrap_or_else(|e| panic!("{e}")).lens;
        (paraxial::first_order(&lens, 587.6), lens.aperture)
    };
    let (first, aperture) = pupil(TRIPLE);
    assert_eq!(aperture, Aperture::EntrancePupilDiameter(4.0));
    let f_number = first.effective_focal_length / 4.0;
    assert_rel(
        pupil(&TRIPLE.replace("ENPD 4", &format!("FNUM {f_number} 0"))).0.entrance_pupil_diameter,
        4.0,
        1e-12,
        0.0,
        "FNUM",
    );
    let (near, _) = pupil(&finite);
    for text in [
        finite.replace("ENPD 4", &format!("FNUM {} 1", near.working_f_number)),
        finite.replace("ENPD 4", &format!("OBNA {} 0", (2.0 / 200.0f64).atan().sin())),
        finite.replace("ENPD 4", "FLOA").replace("  STOP\r\n", "  STOP\r\n  DIAM 2 1\r\n"),
    ] {
        assert_rel(pupil(&text).0.entrance_pupil_diameter, 4.0, 1e-9, 0.0, &text[..80]);
    }
    // A field of image heights is the field whose chief rays land there.
    let lens = |text: &str| parse(text, Form::Zmx, "a.zmx", Glasses::shipped()).expect("reads").lens;
    let paraxial_height = first.effective_focal_length * 5f64.to_radians().tan();
    let by_height = lens(&TRIPLE.replace("FTYP 0", "FTYP 2").replace("YFLN 0 5", &format!("YFLN 0 {paraxial_height}")));
    assert_rel(by_height.max_field_deg(), 5.0, 1e-12, 0.0, "paraxial image height");
    let object = (200.0 + near.entrance_pupil_position) * 5f64.to_radians().tan();
    let by_object = lens(&finite.replace("FTYP 0", "FTYP 1").replace("YFLN 0 5", &format!("YFLN 0 {object}")));
    assert_rel(by_object.max_field_deg(), 5.0, 1e-12, 0.0, "object height");
}
