//! Zemax files that are valid and rare: each kind with its right value.

use glam::DVec3;
use isoplanat::imaging::files::read_linear;
use isoplanat::interchange::{Form, Imported, Reading, load, parse, parse_as, text_of};
use isoplanat::lens::catalogue::{Glasses, Naming};
use isoplanat::lens::{Lens, Medium, paraxial};
use isoplanat::testing::{assert_abs, assert_rel, shared};
use isoplanat::trace::rims::overlapping_rims;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{Ray, System};

use crate::support::Workplace;

const NM: f64 = 587.561_8;

fn case(name: &str) -> Option<Imported> {
    let path = shared(&format!("cases/{name}.zmx"))?;
    Some(load(&path, Glasses::shipped()).unwrap_or_else(|e| panic!("{e}")))
}

fn read(text: &str) -> Imported {
    parse(text, Form::Zmx, "a.zmx", Glasses::shipped()).unwrap_or_else(|e| panic!("{e}"))
}

fn refused(text: &str) -> String {
    parse(text, Form::Zmx, "a.zmx", Glasses::shipped()).expect_err("no lens").to_string()
}

fn told(imported: &Imported, what: &str) {
    assert!(imported.notes.iter().any(|n| n.contains(what)), "{what}: {:?}", imported.notes);
}

fn efl(lens: &Lens) -> f64 {
    paraxial::first_order(lens, lens.wavelengths.primary_nm).effective_focal_length
}

/// Focal length of one lens in air of the shipped N-BK7, in closed form.
fn singlet(c1: f64, c2: f64, thickness: f64) -> f64 {
    let n = Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(NM);
    let (a, b) = ((n - 1.0) * c1, (1.0 - n) * c2);
    1.0 / (a + b - a * b * thickness / n)
}

/// Where a ray lands, and which way it goes.
fn landing(lens: &Lens, origin: DVec3, slope: DVec3) -> (DVec3, DVec3) {
    let system = System::new(lens, NM);
    let hit = trace(&system, Ray { origin, direction: slope.normalize() }, system.image(), &mut Vec::new());
    let hit = hit.unwrap_or_else(|f| panic!("{}: {f:?}", lens.name));
    (hit.at.point, hit.direction)
}

/// A file of an entrance pupil, a field and surfaces.
fn file(header: &str, surfaces: &str) -> String {
    format!(
        "VERS 1\nMODE SEQ\nNAME a\nUNIT MM X\nENPD 4\nFTYP 0 0 2 1\nYFLN 0 2\nWAVM 1 0.5875618 1\nPWAV 1\n{header}SURF 0\n  TYPE STANDARD\n  CURV 0\n  \
         DISZ INFINITY\n{surfaces}"
    )
}

fn surface(number: usize, lines: &str) -> String {
    format!("SURF {number}\n  {}\n", lines.replace("; ", "\n  "))
}

/// A stop on a biconvex lens.
fn lens_of(kind: &str, more: &str) -> String {
    let one = surface(1, &format!("STOP; TYPE {kind}; CURV 0.02; CONI -0.5; DISZ 3; GLAS N-BK7 0 0{more}"));
    file("", &(one + &surface(2, "TYPE STANDARD; CURV -0.01; DISZ 60") + &surface(3, "TYPE STANDARD; CURV 0; DISZ 0")))
}

#[test]
fn keywords_without_effect_and_unknown_ones_are_told() {
    for (name, keyword) in [("dbdt", "DBDT"), ("oema", "OEMA"), ("xfld", "XFLD")] {
        let Some(imported) = case(name) else { return };
        told(&imported, keyword);
        assert_rel(efl(&imported.lens), singlet(0.025, -0.016_666_666_666_666_666, 3.0), 1e-12, 0.0, name);
    }
    let text = lens_of("STANDARD", "").replace("PWAV 1\n", "PWAV 1\nHURZ 3\n") + "KNARZ 1\n";
    let imported = read(&text);
    told(&imported, "`HURZ` at line 10");
    assert_eq!(efl(&imported.lens), efl(&read(&lens_of("STANDARD", "")).lens));
    let strict = Reading { strict: true, ..Reading::default() };
    let error = parse_as(&text, Form::Zmx, "a.zmx", Glasses::shipped(), strict).expect_err("strict").to_string();
    assert!(error.contains("line 10: the keyword `HURZ`") && error.contains("--strict"), "{error}");
    // Within a surface it may be its shape.
    let within = refused(&text.replace("  CONI -0.5", "  HURZ 1\n  CONI -0.5"));
    assert!(within.contains("(SURF 1): the keyword `HURZ`"), "{within}");
    let place = Workplace::new();
    place.write("a.zmx", &text);
    for (command, code) in [("inspect a.zmx", 0), ("inspect a.zmx --strict", 2), ("convert a.zmx b.toml --strict", 2)] {
        assert_eq!(place.run(command).code, code, "{command}");
    }
    assert_eq!(place.files(), ["a.zmx"]);
}

/// Older names of field lists count where the newer ones are not there.
#[test]
fn older_lists_of_fields_are_read() {
    let text = lens_of("STANDARD", "");
    let older = read(&text.replace("YFLN 0 2", "YFLD 0 7")).lens;
    assert_rel(older.max_field_deg(), 7.0, 1e-12, 0.0, "YFLD alone");
    let both = read(&text.replace("YFLN 0 2", "YFLN 0 2\nYFLD 0 7"));
    assert_rel(both.lens.max_field_deg(), 2.0, 1e-12, 0.0, "YFLN beside");
    told(&both, "YFLD");
}

/// Extended aspheres are the plain ones with the same terms, whatever their radius; powers up to 40, in inches too.
#[test]
fn extended_aspheres_have_their_terms() {
    let data = |entries: &[f64]| -> String {
        entries.iter().enumerate().map(|(i, x)| format!("; XDAT {} {x:e} 0 0 0 0 \"\"", i + 1)).collect()
    };
    let rays = [(0.0, 1.5, 0.0), (1.1, -0.9, 0.02), (-0.7, 1.6, -0.03)];
    let same = |a: &Lens, b: &Lens, what: &str| {
        for (x, y, slope) in rays {
            let start = |l: &Lens| landing(l, DVec3::new(x, y, -5.0), DVec3::new(0.0, slope, 1.0));
            assert!((start(a).0 - start(b).0).length() < 1e-12, "{what}");
        }
    };
    for unit in ["UNIT MM", "UNIT IN"] {
        let read = |text: &str| read(&text.replace("UNIT MM", unit)).lens;
        let even = read(&lens_of("EVENASPH", "; PARM 2 2e-5; PARM 3 -3e-7"));
        let radius: f64 = 2.5;
        let normalised = [3.0, radius, 0.0, 2e-5 * radius.powi(4), -3e-7 * radius.powi(6)];
        same(&even, &read(&lens_of("XASPHERE", &data(&normalised))), unit);
        let odd = read(&lens_of("ODDASPHE", "; PARM 2 1e-4; PARM 3 4e-5; PARM 4 2e-5; PARM 5 1e-6"));
        let terms: Vec<f64> = [0.0, 1e-4, 4e-5, 2e-5, 1e-6].iter().zip(1..).map(|(a, i)| a * radius.powi(i)).collect();
        same(&odd, &read(&lens_of("XOSPHERE", &data(&[[5.0, radius].as_slice(), &terms].concat()))), unit);
        // Terms beyond the count say nothing.
        same(&even, &read(&lens_of("XASPHERE", &data(&[normalised.as_slice(), &[1.0]].concat()))), unit);
    }
    let mut high = vec![20.0, 10.0];
    high.resize(22, 0.0);
    high[21] = 1e-3;
    let lens = read(&lens_of("XASPHERE", &data(&high))).lens;
    let sag = lens.surfaces[0].shape.at(9.0, 0.0).expect("reaches").h;
    let conic = 0.02 * 81.0 / (1.0 + (1.0 - 0.5 * 0.02 * 0.02 * 81.0f64).sqrt());
    assert_abs(sag, conic + 1e-3 * 0.9f64.powi(40), 1e-15, "r^40");
    // Written again, even terms alone and with odd ones.
    let mixed = lens.changed(|l| l.surfaces[1].shape.odd = vec![1e-6, 0.0, 0.0, 0.0, 3e-9]).expect("a lens");
    for lens in [&lens, &mixed] {
        let (text, _) = text_of(lens, Form::Zmx, Glasses::shipped()).expect("writes");
        let again = read(&text).lens;
        for (a, b) in again.surfaces.iter().zip(&lens.surfaces) {
            assert_eq!((&a.shape.asphere, &a.shape.odd), (&b.shape.asphere, &b.shape.odd));
        }
    }
    for (entries, expected) in [
        (vec![1.0, 0.0, 1e-5], "normalising radius"),
        (vec![1.5, 1.0, 1e-5], "whole number"),
        (vec![-1.0, 1.0], "whole number"),
    ] {
        let error = refused(&lens_of("XASPHERE", &data(&entries)));
        assert!(error.contains(expected) && error.contains("SURF 1"), "{error}");
    }
    assert!(refused(&lens_of("XOSPHERE", &data(&[1.0, 1.0, 0.1]))).contains("a term 0.1 r"));
    let mut beyond = vec![21.0, 1.0];
    beyond.resize(23, 0.0);
    beyond[22] = 1e-9;
    assert!(refused(&lens_of("XASPHERE", &data(&beyond))).contains("r^42"));
    if let Some(imported) = case("xasphere") {
        let terms = &imported.lens.surfaces[0].shape.asphere;
        assert_eq!(terms.as_slice(), [0.0, 2e-6]);
        assert_rel(efl(&imported.lens), singlet(0.025, -0.016_666_666_666_666_666, 3.0), 1e-12, 0.0, "xasphere");
    }
}

#[test]
fn without_a_stop_the_pupil_is_at_the_first_surface() {
    let Some(imported) = case("nostop") else { return };
    told(&imported, "pupil is taken at the first surface");
    let first = paraxial::first_order(&imported.lens, NM);
    assert_eq!((imported.lens.stop, first.entrance_pupil_position, first.entrance_pupil_diameter), (0, 0.0, 5.0));
    assert_rel(first.effective_focal_length, singlet(0.025, -0.016_666_666_666_666_666, 3.0), 1e-12, 0.0, "nostop");
}

/// Surfaces alone: the object at infinity, the image behind the last distance, the stop as large as the surfaces let light in.
#[test]
fn a_list_of_surfaces_alone_is_a_lens() {
    let text = "NAME a\nMODE SEQ\nUNIT MM\nSURF 1\n  TYPE STANDARD\n  CURV 0.02\n  DISZ 3\n  DIAM 5\n  GLAS N-BK7 0 0\nSURF 2\n  CURV -0.01\n  DISZ 1\n  \
                DIAM 5\nSURF 2AS\n  STOP\n  DISZ 60\n  DIAM 3";
    let imported = read(text);
    for what in ["begin with SURF 1", "2AS", "no wavelength is stated", "no aperture is stated"] {
        told(&imported, what);
    }
    let lens = imported.lens;
    assert_eq!((lens.surfaces.len(), lens.stop, lens.surfaces[2].thickness), (3, 2, 60.0));
    assert_eq!(lens.object_vergence, 0.0);
    assert_rel(efl(&lens), singlet(0.02, -0.01, 3.0), 1e-12, 0.0, "efl");
    assert_rel(paraxial::stop_semi_diameter(&lens), 3.0, 1e-12, 0.0, "its own size limits it");
    // The first surface limits where it is the narrower one.
    let narrow = read(&text.replacen("DIAM 5", "DIAM 1", 1)).lens;
    assert_rel(paraxial::first_order(&narrow, NM).entrance_pupil_diameter, 2.0, 1e-12, 0.0, "narrow");
    assert!(refused(&text.replace("SURF 2AS", "SURF 4")).contains("SURF 4"));
    assert!(refused(&text.replace("SURF 2\n", "SURF 3\n")).contains("SURF 3; SURF 2"));
}

/// A decimal comma, a mirror written as an index of −1, an infinite distance as a number.
#[test]
fn numbers_are_read_as_they_are_meant() {
    let glass = lens_of("STANDARD", "").replace("GLAS N-BK7 0 0", "GLAS ___BLANK 1 0 1,5168 64.2");
    let imported = read(&glass);
    told(&imported, "1,5168");
    assert_eq!(efl(&imported.lens), efl(&read(&glass.replace(',', ".")).lens));
    let mirror = refused(&lens_of("STANDARD", "").replace("GLAS N-BK7 0 0", "GLAS ___BLANK 1 0 -1 0"));
    assert!(mirror.contains("(SURF 1): a mirror"), "{mirror}");
    let far = read(&lens_of("STANDARD", "").replace("DISZ INFINITY", "DISZ 10000000000")).lens;
    assert_eq!(far.object_vergence, 0.0);
}

#[test]
fn a_glass_may_touch_the_image() {
    let Some(imported) = case("coverglass0") else { return };
    let lens = imported.lens;
    assert_eq!((lens.surfaces.len(), lens.surfaces[3].thickness), (4, 0.0));
    assert_rel(efl(&lens), singlet(0.025, -0.016_666_666_666_666_666, 3.0), 1e-12, 0.0, "efl");
    // Where light meets the glass's last face it lands, and the image behind a little air is next to it.
    let apart = lens.changed(|l| l.surfaces[3].thickness = 1e-6).expect("a lens");
    for y in [0.3, -2.0] {
        let at = |l: &Lens| landing(l, DVec3::new(0.2, y, -1.0), DVec3::new(0.0, 0.04, 1.0)).0;
        assert!((at(&lens) - at(&apart)).length() < 1e-7);
    }
    let place = Workplace::new();
    let path = shared("cases/coverglass0.zmx").expect("beside");
    place.write("a.zmx", std::fs::read(path).expect("reads"));
    assert_eq!(place.run("convert a.zmx b.toml").code, 0);
    // Work that goes from the sensor through the glass gives what it gives across a little air.
    let text = std::fs::read_to_string(place.path("b.toml")).expect("reads");
    place.write("c.toml", text.replacen("thickness_mm = 0.0", "thickness_mm = 1e-4", 1));
    for command in ["check L", "psf L -o L.npz --fields 2", "render L slanted_edges -o L.png --columns 60 --rows 40"] {
        for lens in ["b.toml", "c.toml"] {
            let ran = place.run(&command.replace('L', lens));
            assert_eq!(ran.code, 0, "{command} of {lens}: {}", ran.err);
        }
    }
    let [a, b] = ["b.toml.png", "c.toml.png"].map(|p| read_linear(&place.path(p)).expect("a picture"));
    let far = a.iter().zip(&b).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max);
    // One step of 8 bits.
    assert!(far < 0.01 && a.iter().any(|x| *x > 0.3) && a.iter().any(|x| *x < 0.2), "{far}");
    // Beyond the plane it may not reach.
    let deeper = lens.changed(|l| l.surfaces[3].shape.curvature = 0.01).expect_err("deeper").to_string();
    assert!(deeper.contains("sensor's plane"), "{deeper}");
}

/// A ball's rim lies at its radius; rims beyond it end there.
#[test]
fn rims_reach_to_the_radius() {
    let Some(imported) = case("ball") else { return };
    told(&imported, "edge of its conic");
    let n = Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(NM);
    assert_rel(efl(&imported.lens), n * 4.0 / (2.0 * (n - 1.0)), 1e-12, 0.0, "ball");
    assert!(imported.lens.surfaces.iter().all(|s| s.semi_diameter == 4.0));
    // A ray close to the rim of the ball still passes as Snell's law has it: deflected by twice the difference of its angles.
    let y: f64 = 3.9;
    let (_, direction) = landing(&imported.lens, DVec3::new(0.0, y, -1.0), DVec3::Z);
    let bent = 2.0 * ((y / 4.0).asin() - (y / 4.0 / n).asin());
    assert_abs((-direction.y).atan2(direction.z), bent, 1e-12, "deflection");
    let larger = lens_of("STANDARD", "; DIAM 80 1").replace("CONI -0.5", "CONI 0");
    told(&read(&larger), "lies beyond the edge");
    let toml = imported.lens.changed(|l| l.surfaces[0].semi_diameter = 4.000_001).expect_err("beyond").to_string();
    assert!(toml.contains("reach"), "{toml}");
}

/// A stop that stands across a face is met on the ray's straight way.
#[test]
fn planes_may_touch_and_cross_a_face() {
    let Some(imported) = case("stopcontact") else { return };
    assert_rel(efl(&imported.lens), singlet(-1.0 / 30.0, -1.0 / 15.0, 3.0), 1e-12, 0.0, "efl");
    // Without the plane, the ray is the same.
    let bare = imported.lens.changed(|l| {
        l.surfaces.remove(0);
        l.stop = 0;
    });
    let bare = bare.expect("a lens");
    for (x, y, slope) in [(0.0, 3.9, 0.0), (2.0, -3.0, 0.08), (1.0, 1.0, -0.08)] {
        let at = |l: &Lens| landing(l, DVec3::new(x, y, -9.0), DVec3::new(0.0, slope, 1.0));
        let (a, b) = (at(&imported.lens), at(&bare));
        assert!((a.0 - b.0).length() < 1e-12 && (a.1 - b.1).length() < 1e-14, "{a:?} {b:?}");
    }
    // Two faces with such a plane between them may not cross each other.
    let deep = imported.lens.changed(|l| {
        let mut plane = l.surfaces[0].clone();
        plane.thickness = 0.0;
        let mut glass = l.surfaces[1].clone();
        (glass.shape.curvature, glass.thickness) = (0.02, 0.1);
        l.surfaces.splice(0..0, [glass, plane.clone()]);
        l.surfaces[1].medium = Medium::Air;
        l.stop = 2;
    });
    assert!(deep.is_err());
}

/// Faces that cross where light goes by no more than prescriptions are rounded: told, and traced as they stand. Beyond it they are refused.
#[test]
fn faces_may_cross_by_less_than_a_bound() {
    // Two faces on the axis whose sags differ by 0.5 (c1 − c2) r² up to the rim at 5 mm.
    let text = |depth: f64| {
        let c = 2.0 * depth / 25.0;
        let one = surface(1, "STOP; TYPE STANDARD; CURV 0.01; DISZ 2; GLAS N-BK7 0 0; DIAM 5 1");
        let two =
            surface(2, &format!("TYPE PARAB; CURV {c:e}; CONI -1; DISZ 0; DIAM 5 1")).replace("PARAB", "STANDARD");
        let three = surface(3, "TYPE STANDARD; CURV 0; DISZ 2; GLAS F2 0 0; DIAM 5 1");
        file(
            "",
            &(one
                + &two
                + &three
                + &surface(4, "TYPE STANDARD; CURV 0; DISZ 90; DIAM 5 1")
                + &surface(5, "TYPE STANDARD; CURV 0; DISZ 0")),
        )
    };
    for depth in [0.002, 0.043, 0.0499] {
        let lens = read(&text(depth)).lens;
        let lines = overlapping_rims(&lens, "a.zmx");
        assert!(lines.len() == 1 && lines[0].contains(&format!("overlap by {depth:.4}")), "{lines:?}");
        assert!(lines[0].contains("light goes there"), "{lines:?}");
        // Snell's law at a point of each face, whichever comes first along the ray.
        let (n, m) = (
            Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(NM),
            Glasses::shipped().find("F2", Naming::Exact).expect("shipped").index(NM),
        );
        let system = System::new(&lens, NM);
        let mut hits = Vec::new();
        let ray = Ray { origin: DVec3::new(0.0, 1.9, -1.0), direction: DVec3::Z };
        trace(&system, ray, system.image(), &mut hits).expect("arrives");
        assert!(hits[2].at.t < 0.0 && hits[2].at.point.z.abs() < 1e-15, "{:?}", hits[2].at);
        let slope = 2.0 * depth / 25.0 * hits[1].at.point.y;
        let normal = DVec3::new(0.0, -slope, 1.0).normalize();
        let snell = |a: DVec3, b: DVec3, from: f64, to: f64, k: DVec3| (from * a.cross(k) - to * b.cross(k)).length();
        assert!(snell(hits[1].incoming, hits[1].direction, n, 1.0, normal) < 1e-14);
        assert!(snell(hits[2].incoming, hits[2].direction, 1.0, m, DVec3::Z) < 1e-14);
    }
    let error = refused(&text(0.06));
    assert!(error.contains("cross") && error.contains("no overlap above 0.05 mm"), "{error}");
}

/// Image heights beyond a right angle. The angle is that of a tracer of a few lines, written for this alone, at which the chief ray through the stop's
/// centre lands at 4.2 mm: 99.65466169713°.
#[test]
fn image_heights_are_reached_beyond_a_right_angle() {
    let Some(imported) = case("fisheye_real_height_MIT_amegahed-OpticsDatabase") else { return };
    assert_abs(imported.lens.max_field_deg(), 99.654_661_697_13, 1e-8, "field");
    // A height that none reaches: the field ends at the farthest, told.
    let text = lens_of("STANDARD", "; DIAM 12 1").replace("FTYP 0", "FTYP 3").replace("YFLN 0 2", "YFLN 0 5000");
    told(&read(&text), "no chief ray lands at the image height of 5000 mm");
}

/// A virtual image: first-order data are the file's own; a plane behind the lens takes the rays.
#[test]
fn a_virtual_image_has_its_first_order_data() {
    if let Some(imported) = case("negative") {
        assert_rel(efl(&imported.lens), singlet(-0.02, 0.02, 2.0), 1e-12, 0.0, "negative");
    }
    let one = surface(1, "STOP; TYPE STANDARD; CURV -0.02; DISZ 2; GLAS N-BK7 0 0; DIAM 6 1");
    let text = file(
        "",
        &(one
            + &surface(2, "TYPE STANDARD; CURV 0.02; DISZ -48.7; DIAM 6 1")
            + &surface(3, "TYPE STANDARD; CURV 0; DISZ 0")),
    );
    let imported = read(&text);
    told(&imported, "virtual image");
    let first = paraxial::first_order(&imported.lens, NM);
    assert_rel(first.effective_focal_length, singlet(-0.02, 0.02, 2.0), 1e-12, 0.0, "efl");
    // Back focal length of a thick lens: f (1 − (n − 1) c₁ t / n).
    let n = Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(NM);
    let expected = first.effective_focal_length * (1.0 - (n - 1.0) * -0.02 * 2.0 / n);
    assert_rel(first.paraxial_image_distance, expected, 1e-12, 0.0, "image");
    assert!(expected < -48.0);
    let place = Workplace::new();
    place.write("a.zmx", &text);
    let ran = place.run("inspect a.zmx");
    assert!(ran.code == 0 && ran.err.contains("virtual image"), "{}", ran.err);
}

/// Objects within glass, near and at infinity; curved objects and images are taken on their planes.
#[test]
fn objects_within_glass_and_curved_images_are_told() {
    let text = lens_of("STANDARD", "");
    let water = "DISZ INFINITY\n  GLAS ___BLANK 1 0 1.33306 53.98";
    let imported = read(&text.replace("DISZ INFINITY", water));
    told(&imported, "the object lies within n_d 1.33");
    let n0 = 1.33306;
    let (n, c1, c2) = (Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped").index(NM), 0.02, -0.01);
    let (a, b) = ((n - n0) * c1, (1.0 - n) * c2);
    assert_rel(efl(&imported.lens), 1.0 / (a + b - a * b * 3.0 / n), 1e-12, 0.0, "efl");
    assert_rel(imported.lens.max_field_deg(), 2.0, 1e-12, 0.0, "field");
    // 100 mm of glass before the first surface, which is of that glass: the rear surface alone images.
    let near = read(&text.replace("DISZ INFINITY", "DISZ 100\n  GLAS N-BK7 0 0")).lens;
    let image = 1.0 / (b - n / (100.0 + 3.0));
    assert_rel(paraxial::first_order(&near, NM).paraxial_image_distance, image, 1e-12, 0.0, "image");
    let plain = read(&text).lens;
    for (from, to, what) in [
        (
            "SURF 3\n  TYPE STANDARD\n  CURV 0",
            "SURF 3\n  TYPE STANDARD\n  CURV -0.01",
            "the image is curved, with a radius of -100 mm",
        ),
        ("SURF 0\n  TYPE STANDARD\n  CURV 0", "SURF 0\n  TYPE STANDARD\n  CURV 0.01", "the object is curved"),
    ] {
        let curved = read(&text.replace(from, to));
        told(&curved, what);
        assert_eq!(curved.lens.surfaces, plain.surfaces, "{what}");
    }
}

/// Each operand of a configuration puts its value where a file of that one configuration has it.
#[test]
fn configurations_are_those_of_their_operands() {
    let base = lens_of("EVENASPH", "; PARM 2 1e-6; DIAM 9 1");
    let operands = "MNUM 2 1\nTHIC   2   1 60 0 0 0 1 1 1 0 0\nTHIC   2   2 55.5 0 0 0 1 1 1 0 0\nCRVT   1   1 0.02 0\nCRVT   1   2 0.03 0\nGLSS   1   1 N-BK7 0\n\
                    GLSS   1   2 F2 0\nYFIE   2   1 2 0\nYFIE   2   2 3.5 0\nWAVE   1   1 0.5875618 0\nWAVE   1   2 0.55 0\nAPER   0   1 4 0\nAPER   0   2 3 0\n\
                    CONN   1   2 -0.2 0\nPAR2   1   2 2e-6 0\nSDIA   1   2 8 0\nMOFF   0   1 0 0\n";
    let text = format!("{base}{operands}");
    let read = |n: Option<usize>| {
        let reading = Reading { configuration: n, ..Reading::default() };
        parse_as(&text, Form::Zmx, "a.zmx", Glasses::shipped(), reading)
    };
    let second = base
        .replace("DISZ 60", "DISZ 55.5")
        .replace("CURV 0.02", "CURV 0.03")
        .replace("N-BK7", "F2")
        .replace("YFLN 0 2", "YFLN 0 3.5")
        .replace("0.5875618", "0.55")
        .replace("ENPD 4", "ENPD 3")
        .replace("CONI -0.5", "CONI -0.2")
        .replace("PARM 2 1e-6", "PARM 2 2e-6")
        .replace("DIAM 9 1", "DIAM 8 1");
    let first = read(None).expect("reads");
    told(&first, "configuration 1 of 2");
    assert_eq!(first.lens, self::read(&base).lens);
    assert_eq!(read(Some(1)).expect("reads").lens, first.lens);
    let other = read(Some(2)).expect("reads");
    told(&other, "configuration 2 of 2");
    assert_eq!(other.lens, self::read(&second).lens);
    let stop = text.replace("MOFF   0   1 0 0\n", "STPS   0   2 2 0\n");
    let reading = Reading { configuration: Some(2), ..Reading::default() };
    assert_eq!(parse_as(&stop, Form::Zmx, "a.zmx", Glasses::shipped(), reading).expect("reads").lens.stop, 1);
    for (n, expected) in [(3, "1 to 2"), (0, "1 to 2")] {
        let error = read(Some(n)).expect_err("none").to_string();
        assert!(error.contains(expected), "{error}");
    }
    // An operand that is not known matters where it says something else.
    let unknown = format!("{text}IGNR   1   1 0 0\nIGNR   1   2 1 0\n");
    assert!(parse(&unknown, Form::Zmx, "a.zmx", Glasses::shipped()).is_ok());
    let error = parse_as(&unknown, Form::Zmx, "a.zmx", Glasses::shipped(), reading).expect_err("unknown").to_string();
    assert!(error.contains("the operand IGNR in configuration 2"), "{error}");
    // The program's own suggestions work.
    let place = Workplace::new();
    place.write("a.zmx", &text).write("b.zmx", &second);
    let ran = place.run("inspect a.zmx");
    assert!(ran.code == 0 && ran.err.contains("--configuration N"), "{}", ran.err);
    assert_eq!(place.run("convert a.zmx two.toml --configuration 2").code, 0);
    let focal = |arguments: &str| {
        let ran = place.run(&format!("inspect {arguments} --json"));
        serde_json::from_str::<serde_json::Value>(&ran.out).expect("JSON")["effective_focal_length_mm"].clone()
    };
    assert_eq!(focal("two.toml"), focal("b.zmx"));
    for (command, expected) in [
        ("inspect a.zmx --configuration 7", "configuration: 7; 1 to 2"),
        ("inspect b.zmx --configuration 2", "the file has one configuration"),
        ("inspect two.toml --configuration 2", "configuration: 2"),
        ("inspect cooke_triplet --configuration 2", "configuration: 2"),
    ] {
        let ran = place.run(command);
        assert!(ran.code == 2 && ran.err.contains(expected), "{command}: {}", ran.err);
    }
}

/// An ideal lens: light of any direction meets at `f tan θ`, files of both kinds keep it, and every way from lens to picture takes it.
#[test]
fn an_ideal_lens_images_as_first_order_optics_says() {
    let text = file(
        "",
        "SURF 1\n  STOP\n  TYPE PARAXIAL\n  CURV 0\n  PARM 1 50\n  PARM 2 1\n  DISZ 50\n  DIAM 6\nSURF 2\n  CURV 0\n  DISZ 0\n",
    );
    let imported = read(&text);
    told(&imported, "an ideal lens of 50 mm");
    let mut lenses = vec![imported.lens];
    lenses.extend(case("paraxial").map(|i| i.lens));
    for lens in &lenses {
        let first = paraxial::first_order(lens, NM);
        assert_eq!((first.effective_focal_length, first.back_focal_length), (50.0, 50.0));
        for tangent in [0.0, 0.05, 1.3] {
            for (x, y) in [(0.0, 4.9), (-3.0, 2.0), (4.0, -1.0)] {
                let back = DVec3::new(x, y - 9.0 * tangent, -9.0);
                let (at, _) = landing(lens, back, DVec3::new(0.0, tangent, 1.0));
                assert_abs((at - DVec3::new(0.0, 50.0 * tangent, 0.0)).length(), 0.0, 1e-12, "one point");
            }
        }
        for form in [Form::Zmx, Form::Toml] {
            let (text, _) = text_of(lens, form, Glasses::shipped()).expect("writes");
            let again = parse(&text, form, "again", Glasses::shipped()).expect("reads").lens;
            assert_eq!((&again.surfaces, again.stop, again.aperture), (&lens.surfaces, lens.stop, lens.aperture));
        }
        let error = text_of(lens, Form::Seq, Glasses::shipped()).expect_err("no form in a sequence").to_string();
        assert!(error.contains("surface[0].ideal_focal_length_mm: 50"), "{error}");
    }
    for (from, to, why) in [
        ("  PARM 1 50\n", "", "PARM 1"),
        ("PARM 1 50", "PARM 1 0", "PARM 1"),
        ("DISZ 50", "DISZ 50\n  GLAS N-BK7 0 0", "air on both sides"),
    ] {
        let error = refused(&text.replacen(from, to, 1));
        assert!(error.contains(why) && error.contains("SURF 1"), "{error}");
    }
    let place = Workplace::new();
    place.write("a.zmx", text);
    assert_eq!(place.run("convert a.zmx a.toml").code, 0);
    let toml = std::fs::read_to_string(place.path("a.toml")).expect("reads");
    place.write(
        "near.toml",
        toml.replacen("distance_mm = inf", "distance_mm = 150.0", 1).replacen(
            "thickness_mm = 50.0",
            "thickness_mm = 75.0",
            1,
        ),
    );
    place.write("bent.toml", toml.replacen("radius_mm = inf", "radius_mm = 80.0", 1));
    let bent = place.run("inspect bent.toml");
    assert!(bent.code == 2 && bent.err.contains("an ideal lens is a plane"), "{}", bent.err);
    for lens in ["a.toml", "near.toml"] {
        assert_eq!(place.run(&format!("check {lens}")).code, 0, "{lens}");
        let spots = place.run(&format!("spot {lens} --json"));
        let spots: serde_json::Value = serde_json::from_str(&spots.out).expect("JSON");
        for field in spots["fields"].as_array().expect("fields") {
            let [rms, strehl] = ["rms_mm", "strehl"].map(|key| field[key].as_f64().expect("a number"));
            assert!(rms < 1e-9, "{lens}: {rms}");
            assert_abs(strehl, 1.0, 1e-3, lens);
        }
        // Both ways to a picture, and kernels by diffraction.
        for command in [
            "render L facades -o a.png --force --columns 90 --rows 60",
            "render L facades -o b.png --force --columns 90 --rows 60 --diffraction on",
            "capture L facades -o c.dng --force --columns 90 --rows 60 --samples 256",
        ] {
            let ran = place.run(&command.replace('L', lens));
            assert_eq!(ran.code, 0, "{command} of {lens}: {}", ran.err);
        }
    }
}

/// Planes that negative distances put beyond their air space do nothing, a plane that the object stands on is none, and an operand of the air's state
/// is told. The lens is that of the file without them.
#[test]
fn planes_beyond_their_space_and_states_of_the_air_are_told() {
    let text = lens_of("STANDARD", "");
    let plain = read(&text).lens;
    let again = |text: &str, what: &str| {
        let imported = read(text);
        told(&imported, what);
        assert_eq!(imported.lens.surfaces, plain.surfaces, "{what}");
        assert_eq!(imported.lens.stop, plain.stop);
        imported.lens
    };
    // Behind the first face, reached backwards through the glass.
    let bare = |number: usize, distance: &str| surface(number, &format!("TYPE STANDARD; CURV 0; DISZ {distance}"));
    let beyond = text.replace("DISZ 60", "DISZ -7.5").replace("SURF 3\n", &format!("{}SURF 4\n", bare(3, "67.5")));
    again(&beyond, "(SURF 3)");
    // By picometres: it stands at the face.
    let touching =
        text.replace("DISZ 60", "DISZ -2e-9").replace("SURF 3\n", &format!("{}SURF 4\n", bare(3, "60.000000002")));
    let lens = read(&touching).lens;
    assert_eq!(lens.surfaces.len(), 3);
    assert_abs(lens.surfaces[1].thickness, 0.0, 0.0, "at the face");
    // The stop is no mark.
    let stop = beyond.replace("  STOP\n", "").replace("SURF 3\n", "SURF 3\n  STOP\n");
    let error = refused(&stop);
    assert!(error.contains("-7.5 mm") && error.contains("SURF 3"), "{error}");
    // An object on a plane in air.
    let near = text.replace("DISZ INFINITY", "DISZ 250");
    let on = text
        .replace("DISZ INFINITY", "DISZ 0")
        .replace("SURF 3", "SURF 4")
        .replace("SURF 2", "SURF 3")
        .replace("SURF 1\n", &format!("{}SURF 2\n", bare(1, "250")));
    let imported = read(&on);
    told(&imported, "the object stands on");
    let expected = read(&near).lens;
    assert_eq!(
        (&imported.lens.surfaces, imported.lens.object_vergence),
        (&expected.surfaces, expected.object_vergence)
    );
    // One configuration, in a vacuum.
    again(&(text.clone() + "MNUM 1 1\nPRES 0 1 0.0 0 0 1 1 1.0 0.0 0\n"), "PRES 0.0 is not used");
    let usual = read(&(text.clone() + "MNUM 1 1\nTEMP 0 1 20.0 0 0 1 1 1.0 0.0 0\n"));
    assert!(usual.notes.iter().all(|n| !n.contains("TEMP")), "{:?}", usual.notes);
    // Names in quotes.
    let quoted = text + "MNUM 2 1\nGLSS 1 1 \"N-BK7\" 0 0\nGLSS 1 2 \"F2\" 0 0\n";
    again(&quoted, "configuration 1 of 2");
}

/// A model glass is offered where it is known: not in the infrared.
#[test]
fn what_is_offered_works() {
    let text = lens_of("STANDARD", "").replace("GLAS N-BK7 0 0", "GLAS NOSUCH 0 0 1.58 60");
    assert!(refused(&text).contains("--glass-for NOSUCH=model"), "{}", refused(&text));
    let infrared = text.replace("WAVM 1 0.5875618 1", "WAVM 1 1.55 1");
    assert!(!refused(&infrared).contains("=model"), "{}", refused(&infrared));
}
