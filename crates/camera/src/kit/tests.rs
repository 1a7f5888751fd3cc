//! The kit folder: what is written and read again, what is refused.

use super::*;
use crate::test_model;

/// A kit whose network is the small U-Net of the tests.
pub(crate) fn kit(columns: usize, rows: usize) -> Kit {
    let mut card = ModelCard::for_unet("test", 4, 3);
    card.lens_name = "Cooke triplet".into();
    card.lens_sha256 = sha256_hex(b"lens");
    let metadata = card.to_metadata();
    let entries: Vec<(&str, &str)> = metadata.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
    let frame = Frame::centred(columns, rows, 0.006).expect("valid");
    let max_slope = 1.2 * frame.max_radius_mm() / 50.0;
    Kit::new(
        "test kit",
        LensEntry { name: card.lens_name.clone(), sha256: card.lens_sha256.clone() },
        test_model::unet(4, 3, &entries),
        96,
        Sensor::generic(),
        frame,
        Distortion { max_slope, coefficients_mm: [50.0 * max_slope, -2.0 * max_slope, 0.0, 0.0], residual_mm: 1e-4 },
        Shading::new(vec![0.0, 1.0], [vec![1.0, 0.9], vec![1.0, 0.9], vec![1.0, 0.9]]).expect("valid"),
        None,
    )
    .expect("valid")
}

#[test]
fn a_saved_kit_loads_again_and_is_not_overwritten() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (folder, mut kit) = (dir.path().join("kit"), kit(64, 48));
    kit.glare = Some(0.08);
    kit.save(&folder, false).expect("saves");
    let text = std::fs::read_to_string(folder.join(FILE)).expect("text");
    std::fs::write(folder.join(FILE), text.replace("glare = 0.08", "glare = 0.8")).expect("writes");
    let error = Kit::load(&folder).expect_err("too much").to_string();
    assert!(error.contains("kit.toml") && error.contains("glare") && error.contains("0.8"), "{error}");
    std::fs::write(folder.join(FILE), text).expect("writes");
    let back = Kit::load(&folder).expect("loads");
    assert_eq!(back.to_toml().expect("writes"), kit.to_toml().expect("writes"));
    assert_eq!((back.card, back.model_bytes), (kit.card.clone(), kit.model_bytes.clone()));
    assert!(matches!(kit.save(&folder, false), Err(Error::Exists(_))));
    kit.save(&folder, true).expect("replaces");
    let other = dir.path().join("other");
    std::fs::create_dir(&other).expect("creates");
    std::fs::write(other.join("notes"), "mine").expect("writes");
    assert!(matches!(kit.save(&other, true), Err(Error::BadInput { .. })), "a folder that is no kit stays");
    assert_eq!(std::fs::read_dir(dir.path()).expect("lists").count(), 2, "nothing half-written is left");
}

/// Every kit that is shipped has all its hashes, and the lens beside it is its own.
#[test]
fn shipped_kits_are_bound() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/kits");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).expect("kits").flatten().filter(|e| e.path().is_dir()) {
        let kit = Kit::load(&entry.path()).expect("loads");
        assert_eq!(kit.doubt(), None, "{}", kit.name);
        let lens = entry.path().join("lens.toml");
        kit.require(&isoplanat_optics::lens::prescription::load(&lens).expect("reads"), &lens).expect("the kit's");
        seen += 1;
    }
    assert!(seen >= 3, "{seen}");
    // A calibration without its hash is taken, and told.
    let dir = tempfile::tempdir().expect("temporary folder");
    let folder = dir.path().join("kit");
    kit(64, 48).save(&folder, false).expect("saves");
    let text = std::fs::read_to_string(folder.join(FILE)).expect("text");
    let without: String =
        text.lines().filter(|l| !l.starts_with("calibration_sha256")).map(|l| format!("{l}\n")).collect();
    std::fs::write(folder.join(FILE), without).expect("writes");
    assert!(Kit::load(&folder).expect("loads").doubt().is_some());
}

/// Every network a run can have gets tiles that keep something, on small frames and large ones, within memory.
#[test]
fn tiles_follow_the_network_and_the_frame() {
    let tile = |width: usize, scales: usize, columns: usize, rows: usize| {
        let card = ModelCard::for_unet("x", width, scales);
        let frame = Frame::centred(columns, rows, 0.006).expect("valid");
        let tile = tile_px(&card, &frame).expect("fits");
        let tiling = Tiling::new(tile, overlap_px(&card), card.multiple).expect("keeps something");
        assert!(tiling.efficiency() >= 0.1 && tile >= 3 * card.receptive_radius_px, "{width} {scales}: {tile}");
        tile
    };
    assert_eq!((tile(16, 3, 6000, 4000), tile(32, 3, 960, 640)), (320, 320));
    // Four times 448; a large frame of a wide network has to do with less.
    assert_eq!((tile(32, 7, 4096, 512), tile(16, 7, 6000, 4000)), (1792, 1664));
    assert_eq!(tile(32, 7, 6000, 4000), 1344);
    for scales in 1..=7 {
        tile(128, scales, 6000, 4000);
        tile(1, scales, 1, 1);
    }
}

#[test]
fn each_fault_has_its_own_error() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let good = kit(64, 48).to_toml().expect("writes");
    let with = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}\n{good}");
        good.replacen(from, to, 1)
    };
    let slope = good.lines().find(|l| l.starts_with("max_slope")).expect("a slope").to_owned();
    let cases = [
        ("unknown key", with("name = \"test kit\"", "name = \"test kit\"\ncolour = 3"), "colour"),
        ("unknown distortion key", with("residual_mm", "k9 = 1.0\nresidual_mm"), "k9"),
        ("newer schema", with("schema = 3", "schema = 5\nnews = 1"), "newer isoplanat-camera"),
        ("no schema", with("schema = 3", ""), "schema"),
        ("white level", with("white_level = 4095.0", "white_level = 4000.0"), "calibration_sha256"),
        ("distortion", with("residual_mm = 0.0001", "residual_mm = 0.0002"), "calibration_sha256"),
        ("lens", with(&sha256_hex(b"lens"), &sha256_hex(b"other")), "trained for"),
        ("model elsewhere", with("file = \"model.onnx\"", "file = \"../model.onnx\""), "kit's folder"),
        ("model missing", with("file = \"model.onnx\"", "file = \"none.onnx\""), "none.onnx"),
        ("demosaic", with(DEMOSAIC, "ahd"), "demosaic"),
        ("overlap", with("overlap_px = 24", "overlap_px = 8"), "receptive radius"),
        ("multiple", with("multiple = 4", "multiple = 8"), "multiple"),
        ("tile", with("tile_px = 96", "tile_px = 40"), "overlap_px"),
        ("frame", with("columns = 64", "columns = 0"), "columns"),
        ("sensor", with("bits = 12", "bits = 99"), "bits"),
        (
            "axis",
            with("axis_px = [32.0, 24.0]", "axis_px = [1e300, 24.0]"),
            "axis_px: [1e300, 24.0]; two numbers of pixels",
        ),
        ("pitch", with("pitch_mm = 0.006", "pitch_mm = 1e-300"), "pitch_mm"),
        ("pitch", with("pitch_mm = 0.006", "pitch_mm = 1e6"), "pitch_mm: 1000000; 1e-5 to 1000 mm"),
        ("slope", with(&slope, "max_slope = 5e-324"), "distortion.max_slope: 5e-324; at least 1e-12"),
        ("slope", with(&slope, "max_slope = 1e-310"), "distortion.max_slope"),
        ("slope", with(&slope, "max_slope = inf"), "distortion.max_slope"),
        (
            "coefficients",
            with("coefficients_mm = [", "coefficients_mm = [1e300, 0.0, 0.0, 0.0] #"),
            "distortion.coefficients_mm",
        ),
        ("folds", with("coefficients_mm = [", "coefficients_mm = [1.0, -1.0, 0.0, 0.0] #"), "stops growing"),
        ("residual", with("residual_mm = 0.0001", "residual_mm = -1.0"), "distortion.residual_mm: -1.0; 0 or more"),
        ("no TOML", "= 3".into(), "line 1"),
    ];
    for (what, text, words) in cases {
        let folder = dir.path().join("kit");
        let _ = std::fs::remove_dir_all(&folder);
        kit(64, 48).save(&folder, false).expect("saves");
        std::fs::write(folder.join(FILE), text).expect("writes");
        let error = Kit::load(&folder).expect_err(what);
        assert_eq!(error.exit_code(), 2, "{what}");
        let message = error.to_string();
        assert!(message.contains(words) && message.contains("kit") && !message.contains('\n'), "{what}: {message}");
    }
}

#[test]
fn a_changed_model_is_refused_by_its_hash() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let folder = dir.path().join("kit");
    kit(64, 48).save(&folder, false).expect("saves");
    let model = folder.join("model.onnx");
    let mut bytes = std::fs::read(&model).expect("reads");
    *bytes.last_mut().expect("not empty") ^= 1;
    std::fs::write(&model, bytes).expect("writes");
    assert!(Kit::load(&folder).expect_err("changed").to_string().contains("SHA-256"));
    assert_eq!(Kit::load(dir.path()).expect_err("no kit").exit_code(), 2);
    assert_eq!(Kit::load(&dir.path().join("none")).expect_err("no folder").exit_code(), 2);
}
