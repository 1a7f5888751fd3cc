//! Captures to pictures, with kits and without.

use super::*;
use crate::kit::tests::kit;
use crate::orientation::Orientation;
use crate::raw;
use crate::session::{Choice, Session};
use isoplanat_base::testing::shared;
use ndarray::Array2;

fn capture(columns: usize, rows: usize) -> RawCapture {
    let rng = &mut fastrand::Rng::with_seed(2);
    let samples = Array2::from_shape_fn((rows, columns), |(r, c)| {
        (800.0 + 500.0 * (r as f32 / 9.0).sin() * (c as f32 / 7.0).cos() + 20.0 * rng.f32()).round()
    });
    RawCapture {
        pixels: RawPixels::Mosaic { samples, cfa: Cfa::RGGB },
        black: [256.0; 4],
        white: [4095.0; 4],
        corrected: false,
        crop: Area { row: 0, column: 0, rows, columns },
        neutral: None,
        camera_from_xyz: None,
        orientation: Orientation::from_exif(6),
        make: "Test".into(),
        model: "Test".into(),
        exif: Exif::default(),
        notes: Vec::new(),
    }
}

fn tract() -> Options {
    Options { choice: Choice::Tract, threads: 2, ..Options::default() }
}

/// A measured distortion is taken out of a capture of its own size as a kit's is; another size is refused, another camera told.
#[test]
fn a_measured_distortion_is_taken_out() {
    let text = "schema = 1\ncamera = \"Other 5\"\nlens = \"\"\nsource = \"test\"\ncolumns = 150\nrows = 110\n\
        focal_length_px = 120.0\ncentre_px = [70.0, 60.0]\nk = [-0.2, 0.01, 0.0]\nmax_slope = 0.7\nrms_px = 0.1\n";
    let measured = MeasuredDistortion::parse(text, "d.toml").expect("valid");
    let camera = Camera::plain().straightening(&measured).expect("a frame");
    let straight = camera.reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
    assert!(straight.notes.iter().any(|n| n.contains("Other 5")), "{:?}", straight.notes);
    let bent = Camera::plain().reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
    assert_eq!(bent.outside_fraction, 0.0);
    // Barrel distortion taken out: the corners of the straight picture lie beyond nothing, the centre stays.
    let centre = |p: &Picture| p.image[[1, 70, 110 - 60]];
    assert!((centre(&straight) - centre(&bent)).abs() < 0.02, "{} {}", centre(&straight), centre(&bent));
    let off = (&straight.image - &bent.image).mapv(f32::abs).mean().expect("pixels");
    assert!(off > 0.01, "{off}");
    let error = camera.reconstruct(capture(152, 110), Path::new("a.dng"), &|_, _| ()).expect_err("another size");
    assert!(error.to_string().contains("150 × 110") && error.exit_code() == 2, "{error}");
}

#[test]
fn the_whole_path_equals_its_steps_in_order() {
    let (kit, capture) = (kit(150, 110), capture(150, 110));
    let camera = Camera::with_kit(kit.clone(), Steps::default(), &tract()).expect("opens");
    let picture = camera.reconstruct(capture.clone(), Path::new("a.dng"), &|_, _| ()).expect("develops");
    assert_eq!(picture.image.dim(), (3, 150, 110), "turned upright");
    // The same by the pure functions, the network in one piece.
    let RawPixels::Mosaic { samples, cfa } = &capture.pixels else { panic!("a mosaic") };
    let development = Development {
        balance: Balance::from_sensor(&kit.sensor),
        flat_field: Some((&kit.frame, &kit.shading)),
        distortion: Some((&kit.frame, &kit.distortion)),
        srgb_from_camera: kit.sensor.srgb_from_camera,
        rendering: Rendering::default(),
    };
    let session = Session::open(&kit.model_bytes, Path::new("m"), &tract()).expect("opens");
    let network = |input: Array3<f32>| {
        let tiling = tiles::Tiling::new(256, 24, 4).expect("valid");
        tiles::run(
            input,
            Region::whole(&kit.frame),
            &kit.guide,
            tiling,
            1,
            &|t: ArrayView4<'_, f32>| session.run(t),
            &|_, _| (),
        )
    };
    let expected = develop::develop(samples.view(), *cfa, &development, network).expect("develops");
    let expected = Orientation::from_exif(6).apply(expected.image);
    let worst = (&picture.image - &expected).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    assert!(worst <= 2e-6, "{worst}");
}

/// A part with what the network sees around it is what it is in the whole: at a corner, at an edge, in the middle.
#[test]
fn a_part_is_what_it_is_in_the_whole() {
    let (kit, capture) = (kit(230, 210), capture(230, 210));
    let RawPixels::Mosaic { samples, .. } = &capture.pixels else { panic!("a mosaic") };
    let camera = Camera::with_kit(kit.clone(), Steps::default(), &tract()).expect("opens");
    let [all, restored] = camera.part(samples.view(), Region::whole(&kit.frame)).expect("develops");
    for (row, col) in [(0, 0), (170, 96), (88, 101)] {
        let region = Region { row, col, rows: 40, cols: 32 };
        let at = camera.around(region).expect("a kit");
        assert!(at.rows < 150 && at.cols < 150, "a part: {at:?}");
        let within = |r: Region, a: &Array3<f32>| {
            let (i, j) = ((region.row - r.row).unsigned_abs(), (region.col - r.col).unsigned_abs());
            a.slice(ndarray::s![.., i..i + region.rows, j..j + region.cols]).to_owned()
        };
        let of = |r: Region| {
            let (i, j) = (r.row.unsigned_abs(), r.col.unsigned_abs());
            camera.part(samples.slice(ndarray::s![i..i + r.rows, j..j + r.cols]), r).expect("develops")
        };
        for (part, whole) in of(at).iter().zip([&all, &restored]) {
            let off = (&within(at, part) - &within(Region::whole(&kit.frame), whole)).mapv(f32::abs);
            let worst = off.iter().fold(0.0_f32, |m, v| m.max(*v));
            assert!(worst <= 2e-6, "{row}, {col}: {worst}");
        }
    }
}

#[test]
fn steps_can_be_left_out() {
    let (kit, capture) = (kit(150, 110), capture(150, 110));
    let steps = Steps { network: false, undistort: false };
    let camera = Camera::with_kit(kit, steps, &tract()).expect("opens");
    let picture = camera.reconstruct(capture, Path::new("a.dng"), &|_, _| ()).expect("develops");
    assert!(camera.network().is_none() && picture.tiles == 0 && picture.outside_fraction == 0.0);
    assert!(picture.notes.iter().any(|n| n.contains("white balance")));
}

#[test]
fn other_cameras_are_told_of() {
    assert!(same_camera("NIKON CORPORATION NIKON D50", "Nikon D50") && same_camera("", "generic"));
    assert!(same_camera("Isoplanat generic 12-bit RGB sensor", "generic 12-bit RGB sensor"));
    assert!(!same_camera("Canon EOS 6D", "Nikon D50") && !same_camera("Nikon D60", "Nikon D50"));
    let camera = Camera::with_kit(kit(150, 110), Steps { network: false, undistort: true }, &tract()).expect("opens");
    let picture = camera.reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
    assert!(picture.notes.iter().any(|n| n.contains("of Test Test")), "{:?}", picture.notes);
}

#[test]
fn captures_of_another_camera_are_refused() {
    let kit = kit(150, 110);
    let camera = Camera::with_kit(kit, Steps { network: false, undistort: true }, &tract()).expect("opens");
    let refused = |capture: RawCapture| {
        let error = camera.reconstruct(capture, Path::new("a.dng"), &|_, _| ()).expect_err("refused");
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    assert!(refused(capture(148, 110)).contains("148 × 110"));
    let mut other = capture(150, 110);
    other.pixels = RawPixels::Mosaic { samples: Array2::zeros((110, 150)), cfa: Cfa::BGGR };
    assert!(refused(other).contains("BGGR"));
    let mut linear = capture(150, 110);
    linear.pixels = RawPixels::Linear(Array3::zeros((3, 110, 150)));
    assert!(refused(linear).contains("demosaicked"));
}

#[test]
fn balanced_captures_have_libraws_colour() {
    for (name, balanced) in [
        ("nikon_crop_gbrg_u16.dng", true),
        ("nikon_crop_rggb_lj92.dng", true),
        ("canon_eos_6d_linear_lossy.dng", true),
        ("RAW_NIKON_D1.NEF", false),
    ] {
        let Some(path) = shared(&format!("data/raw/{name}")) else { return };
        let Some(facts) = shared(&format!("data/raw/{name}.json")) else { return };
        let facts: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(facts).expect("readable")).expect("JSON");
        let capture = raw::decode(&path).expect("decodes");
        let mut balance = plain_development(&capture, &mut Vec::new()).balance;
        if !balanced {
            balance.neutral = [1.0; 3];
        }
        let camera = match capture.pixels {
            RawPixels::Mosaic { samples, cfa } => develop::network_input(samples.clone(), cfa, &balance, None),
            RawPixels::Linear(mut samples) => {
                develop::colour_input(&mut samples, &balance, None);
                samples
            }
            RawPixels::Grey(_) => panic!("{name} has colours"),
        };
        for c in 0..3 {
            // LibRaw cuts at white, on 16 bits.
            let plane = camera.index_axis(ndarray::Axis(0), c);
            let mean = plane.iter().map(|v| f64::from(v.clamp(0.0, 1.0))).sum::<f64>() / plane.len() as f64;
            let expected = facts["linear_demosaic_camera_rgb16"]["mean_rgb"][c].as_f64().expect("mean") / 65_535.0;
            // The demosaicking kernels differ.
            assert!((mean / expected - 1.0).abs() < 4e-3, "{name} {c}: {mean} {expected}");
        }
    }
}

#[test]
fn the_same_scene_from_both_layouts_is_the_same_picture() {
    // The two DNG hold the same samples, arranged differently within each cell of the mosaic.
    let (Some(a), Some(b)) = (shared("data/raw/nikon_crop_gbrg_u16.dng"), shared("data/raw/nikon_crop_rggb_lj92.dng"))
    else {
        return;
    };
    let develop = |path: &Path| {
        let capture = raw::decode(path).expect("decodes");
        Camera::plain().reconstruct(capture, path, &|_, _| ()).expect("develops").image
    };
    let (a, b) = (develop(&a), develop(&b));
    let mean = |i: &Array3<f32>, c: usize| i.index_axis(ndarray::Axis(0), c).mean().expect("pixels");
    for c in 0..3 {
        assert!((mean(&a, c) / mean(&b, c) - 1.0).abs() < 0.01, "channel {c}");
    }
}

/// A kit that states its ISO comes back from its folder, is refused where the statement was changed, and tells of captures at another.
#[test]
fn a_kit_tells_of_captures_that_it_is_not_for() {
    use isoplanat_imaging::exif::{Directory, Value, tags};
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path().join("kit");
    let mut made = kit(150, 110);
    made.valid.put("iso=100..200").expect("a range");
    made.save(&at, false).expect("writes");
    let loaded = Kit::load(&at).expect("loads");
    assert_eq!(loaded.valid, made.valid);
    let text = std::fs::read_to_string(at.join("kit.toml")).expect("reads");
    assert!(text.starts_with("schema = 4") && text.contains("iso = [100.0, 200.0]"), "{text}");
    std::fs::write(at.join("kit.toml"), text.replace("200.0]", "900.0]")).expect("writes");
    assert!(Kit::load(&at).expect_err("changed").to_string().contains("calibration_sha256"));
    let steps = Steps { network: false, ..Steps::default() };
    let camera = Camera::with_kit(loaded, steps, &tract()).expect("opens");
    let notes = |iso: u16| {
        let mut taken = capture(150, 110);
        taken.exif.set(Directory::Exposure, tags::ISO, Value::Short(iso));
        camera.reconstruct(taken, Path::new("a.dng"), &|_, _| ()).expect("develops").notes
    };
    assert!(notes(1600).iter().any(|n| n == "taken at ISO 1600; the kit is for 100 to 200"), "{:?}", notes(1600));
    assert!(!notes(200).iter().any(|n| n.contains("ISO")));
}
