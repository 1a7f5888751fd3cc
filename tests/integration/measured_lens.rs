//! A lens that was measured on its camera in place of a prescription: from its folder to a trained network, a judgement and a kit.

use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::calibrate::lens::MeasuredLens;
use isoplanat::imaging::develop::distortion::Distortion;
use isoplanat::imaging::files::{Encoding, read_picture, write_picture};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Channels, Renderer, Settings, frame_of};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::{SpectralDensity, Spectrum};
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::measured::{MeasuredPsf, Moves};
use isoplanat::psf::table::chief_slopes;
use isoplanat::psf::{Optics, Quadrature, SensorMap, SensorPoint};

use crate::calibrate::kernels::{self, photographed};
use crate::support::Workplace;

const SIZE: [usize; 2] = [192, 128];
/// Blue is some 1.4 pixels wide there.
const PITCH_MM: f64 = 0.0032;

fn lens() -> Lens {
    let sensor = |l: &mut isoplanat::lens::Prescription| {
        (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um) = (SIZE[0], SIZE[1], 1e3 * PITCH_MM);
        // The axis near a corner: the field is as wide as the frame allows.
        l.sensor.axis_px = [20.0, 16.0];
    };
    builtin::lens("landscape").and_then(|l| l.changed(sensor)).expect("valid")
}

/// The rays of a lens as a calibration without error would find them, relative to where `map` sees things: of pixels of `size` and `pitch_mm`, about
/// `centre_px`, at radii to the farthest corner.
fn exact(lens: &Lens, map: &SensorMap, frame: &Frame, reach_px: f64) -> MeasuredPsf {
    let pitch_mm = frame.pitch_mm;
    let spectrum = Spectrum::quadrature(&Sensor::generic(), 9);
    let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() };
    let far_mm = frame.max_radius_mm();
    let optics = Optics::even(lens, far_mm, vec![lens.object_vergence], quadrature, 64).expect("traces");
    let form = optics.form(3000, 3, 1, pitch_mm);
    let moves = Moves::within(reach_px, 0.25).expect("valid");
    let number: std::collections::HashMap<[i32; 2], usize> =
        moves.steps().iter().enumerate().map(|(i, s)| (*s, i)).collect();
    let radii_px: Vec<f64> = (0..=8).map(|i| far_mm / pitch_mm * f64::from(i) / 8.0).collect();
    let weights = radii_px
        .iter()
        .map(|r| {
            let point = SensorPoint::along([0.0, 1.0], r * pitch_mm);
            let levels = optics.illumination().at(point);
            let rays: Vec<_> = (0..levels.len()).map(|l| form.rays(optics.table(), map, l, point)).collect();
            let of_channel = |weight: &Vec<f64>| {
                let mut kernel = vec![0.0; moves.len()];
                for (rays, scale) in rays.iter().zip(weight.iter().zip(&levels).map(|(w, e)| w * e)) {
                    for ((x, y), share) in rays.x.iter().zip(&rays.y).zip(&rays.share) {
                        // Shared between the four moves around it; the other half of the stop is the mirror image.
                        let [a, b] = [y, x].map(|v| v / pitch_mm / moves.spacing_px);
                        for [i, j] in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                            let at = [a.floor() as i32 + i, b.floor() as i32 + j];
                            let part = (1.0 - (a - f64::from(at[0])).abs()) * (1.0 - (b - f64::from(at[1])).abs());
                            // Both halves fall on the half grid; a move on the meridian stands once. What goes farther is left out.
                            let twice = if at[1] == 0 { 2.0 } else { 1.0 };
                            if let Some(k) = number.get(&[at[0], at[1].abs()]) {
                                kernel[*k] += twice * share * scale * part;
                            }
                        }
                    }
                }
                let sum: f64 = moves.iter().zip(&kernel).map(|((_, n), w)| n * w).sum();
                kernel.iter_mut().for_each(|w| *w /= sum);
                kernel
            };
            optics.spec.quadrature.weight.iter().map(of_channel).collect()
        })
        .collect();
    MeasuredPsf::new([frame.columns, frame.rows], frame.axis_px, moves, radii_px, weights).expect("valid")
}

/// What an endless calibration would find of the lens: its rays on a grid of moves, its distortion's polynomial.
fn measured(lens: &Lens) -> MeasuredLens {
    let frame = frame_of(lens).expect("valid");
    let radii: Vec<f64> = (0..=32).map(|i| frame.max_radius_mm() * f64::from(i) / 32.0).collect();
    let slopes = chief_slopes(lens, 0.0, &radii).expect("light");
    let map = SensorMap::through(&radii, &slopes, 0.0, 0.0).expect("grows");
    let psf = exact(lens, &map, &frame, 6.0);
    let Distortion { max_slope: m, coefficients_mm: b, .. } =
        Distortion::of_map(&map, frame.max_radius_mm()).expect("monotonic");
    let distortion = MeasuredDistortion {
        schema: 1,
        camera: "reference".into(),
        lens: "landscape".into(),
        source: "its rays".into(),
        columns: SIZE[0],
        rows: SIZE[1],
        focal_length_px: b[0] / m / PITCH_MM,
        centre_px: frame.axis_px,
        k: [1, 2, 3].map(|j| b[j] / b[0] / m.powi(2 * j as i32)),
        max_slope: m,
        rms_px: 0.0,
    };
    MeasuredLens::new(psf, distortion, None).expect("of one camera")
}

fn scene(lens: &Lens) -> Plane {
    // A picture as large as the frame and a third more.
    let focal_px = 10.0 / PITCH_MM;
    let texture = generate(SceneKind::Facades, 5, 400, 600);
    Plane { texture, texels_per_slope: 2.0 * focal_px, axis_texel: [80.0, 70.0], vergence: lens.object_vergence }
}

/// The renderer makes the same picture of the measured lens as of the lens: where measurements are exact, only their grid is left.
#[test]
fn exact_measurements_make_the_lens_s_own_picture() {
    let lens = lens();
    let (measured, scene) = (measured(&lens), scene(&lens));
    let settings = Settings { node_error: 0.02, ..Settings::TRAINING };
    let density = SpectralDensity::new(&Sensor::generic());
    let frame = frame_of(&lens).expect("valid");
    let traced = Renderer::planned(&lens, &frame, &density, &[0.0], settings).expect("plans");
    let own: Frame = measured.frame().expect("valid");
    let stands = Renderer::measured(measured.optics().expect("a map"), &own, settings).expect("plans");
    let whole = Region::whole(&frame);
    let picture = |renderer: &Renderer| {
        let (image, _) = renderer.picture::<f64>(&scene, 0, whole, &Channels::all(), &|_| {});
        // Falling light was not measured here.
        image / renderer.light.over::<f64>(&renderer.plan.frame, whole, &[0, 1, 2])
    };
    let (a, b) = (picture(&traced), picture(&stands));
    let sharp = traced.truth::<f64>(&scene, 0, whole, &Channels::all());
    let off = |x: &ndarray::Array3<f64>, y: &ndarray::Array3<f64>| {
        (x.iter().zip(y).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / x.len() as f64).sqrt()
    };
    let (error, blur) = (off(&a, &b), off(&a, &sharp));
    eprintln!("measured against traced {error:.2e} rms, the blur itself {blur:.2e}");
    assert!(error < 0.05 * blur, "{error} of {blur}");
    let truths = off(&sharp, &stands.truth::<f64>(&scene, 0, whole, &Channels::all()));
    assert!(truths < 0.01 * blur, "ideal pictures differ by {truths}");
}

/// From the folder to the picture: `train`, stopped and resumed, `evaluate` behind its own kernels and through the lens that was measured, `export`, and
/// the camera program. What a measured lens has none of is refused by name.
#[test]
fn a_measured_lens_goes_from_its_folder_to_a_picture() {
    let place = Workplace::new();
    let lens = lens();
    let folder = place.path("mine");
    std::fs::create_dir(&folder).expect("writes");
    measured(&lens).save(&folder).expect("writes");
    isoplanat::lens::prescription::save(&lens, &place.path("lens.toml")).expect("writes");
    std::fs::create_dir(place.path("photos")).expect("writes");
    for seed in 0..3 {
        let picture = generate(SceneKind::Mixed, seed, 300, 400);
        write_picture(&place.path(&format!("photos/{seed}.png")), &picture, Encoding::Srgb).expect("writes");
    }
    let task = "schema = 1\nlens = \"mine\"\nphotos = \"photos\"\n[train]\nbase_width = 4\nscales = 3\ninputs = [\"wiener\"]\npatch_px = 64\n\
                region_px = 96\npairs = 6\nsteps = 30\nrate = 1e-3\nloss = \"l1\"\nsample_steps = 0\n";
    place.write("task.toml", task);
    let ran = place.run("train task.toml -o run");
    assert!(ran.err.contains("shading.toml"), "what is left out is told: {}", ran.err);
    ran.done();
    assert!(!place.path("run/lens.toml").exists() && MeasuredLens::is_at(&place.path("run/lens")));
    // A run is whole without the folder that it came from.
    std::fs::rename(&folder, place.path("elsewhere")).expect("moves");
    place.run("train --resume -o run").done();
    let rows = |arguments: &str| {
        let text = place.run(&format!("evaluate run {arguments} --fields 2 --patch 64 --json")).done();
        let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let mean = value["rows"].as_array().expect("rows").iter().find(|r| r["zone"] == 0).cloned().expect("the mean");
        let db = |of: &str| mean[of]["psnr_db"]["mean"].as_f64().expect("a number");
        (db("capture"), db("reconstruction"), value["lens"].as_str().expect("a name").to_owned())
    };
    let (own, through) = (rows(""), rows("--through lens.toml"));
    let scale: f64 =
        through.2.split("slopes x ").nth(1).and_then(|t| t.trim_end_matches(')').parse().ok()).expect("a scale");
    assert!((scale - 1.0).abs() < 1e-3, "{}", through.2);
    eprintln!("{own:?} {through:?}");
    assert!(own.2.contains("landscape on reference") && through.2.contains("through Landscape lens"), "{}", through.2);
    // Whether the capture comes from its kernels or from the lens's rays is nearly the same.
    assert!((own.0 - through.0).abs() < 0.3 && (own.1 - through.1).abs() < 0.3, "{own:?} {through:?}");
    let by_rays = rows("--through lens.toml --reference 64");
    assert!((by_rays.0 - through.0).abs() < 0.5, "{by_rays:?} {through:?}");
    // Notes may come before.
    let refused = |arguments: &str, words: &[&str]| {
        let ran = place.run(arguments);
        let last = ran.err.lines().last().unwrap_or_default();
        assert!(ran.code == 2 && words.iter().all(|w| last.contains(w)), "{arguments}: {ran:?}");
    };
    refused("evaluate run --reference 16", &["measured lens", "prescription"]);
    refused("evaluate run --depths-mm 500", &["distance", "inf"]);
    refused("evaluate run --through two_element", &["192 x 128"]);
    // A kit needs the pictures no more; to go on training does, and those that it began with.
    std::fs::rename(place.path("photos/2.png"), place.path("photos/3.png")).expect("renames");
    refused("train --resume -o run", &["run", "scenes.sha256", "have changed"]);
    std::fs::remove_dir_all(place.path("photos")).expect("removes");
    refused("train --resume -o run", &["photos"]);
    place.run("export run -o kit").done();
    let kit = std::fs::read_to_string(place.path("kit/kit.toml")).expect("a kit");
    assert!(kit.contains("landscape on reference") && place.path("kit/filters.npz").is_file(), "{kit}");
    place.run("capture lens.toml facades:3 -o capture.dng --samples 16").done();
    let camera = std::process::Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"))
        .current_dir(place.path("."))
        .args(["capture.dng", "--kit", "kit", "-o", "picture.png"])
        .output()
        .expect("starts");
    assert!(camera.status.success(), "{}", String::from_utf8_lossy(&camera.stderr));
    let picture = read_picture(&place.path("picture.png"), Encoding::Srgb).expect("a picture");
    assert_eq!(picture.dim(), (3, SIZE[1], SIZE[0]));
    // What needs surfaces, or a raster of its own.
    let wrong = |change: &str| {
        place.write("wrong.toml", task.replace("\"mine\"", "\"elsewhere\"").replace("photos = \"photos\"", change))
    };
    wrong("scenes = 3");
    refused("design wrong.toml -o design", &["elsewhere", "measured", "isoplanat train"]);
    wrong("asphere_power = 4");
    refused("train wrong.toml -o other", &["elsewhere", "asphere_power"]);
    wrong("sensor = { columns = 9, rows = 9, pitch_um = 1.0 }");
    refused("train wrong.toml -o other", &["elsewhere", "raster"]);
    wrong("scenes = 3").write("elsewhere/distortion.toml", "schema = 1");
    refused("train wrong.toml -o other", &["distortion.toml"]);
    assert!(!place.path("other").exists() && !place.path("design").exists());
}

/// A user's way from photographs to a network, with the reference renderer as his camera, for a lens at its own distance: boards, flats and darks by rays
/// from the sensor; kernels, distortion and falling light measured on them; a network trained on those; and one on kernels that are traced relative to the
/// same distortion, all else alike. Both restore captures by rays through the lens: what the network of measured kernels adds in PSNR, of what the other adds.
fn gained(name: &str, pitch_mm: f64, options: &str, seed: u64) -> f64 {
    let place = Workplace::new();
    photographed(&place, name, pitch_mm, options);
    let [columns, rows] = kernels::SIZE;
    for (what, level, count, samples) in [("dark", 0.0, 2, 8), ("flat", 0.7, 4, 96)] {
        let even = ndarray::Array3::from_elem((3, 64, 96), level);
        write_picture(&place.path("even.png"), &even, Encoding::Srgb).expect("writes");
        for k in 0..count {
            let frame = format!("--columns {columns} --rows {rows} --pitch-um {}", 1e3 * pitch_mm);
            let more = format!("--samples {samples} --texels-per-pixel 0.1 --exposure 0.9 --seed {k}");
            place.run(&format!("capture {name} even.png -o {what}{k}.dng {frame} {more}")).done();
        }
    }
    let frames = "--darks dark0.dng dark1.dng --flats flat0.dng flat1.dng flat2.dng flat3.dng";
    place.run(&format!("calibrate-sensor {frames} --shading shading.toml")).done();
    for (folder, psf) in [("mine", true), ("exact", false)] {
        std::fs::create_dir(place.path(folder)).expect("writes");
        let copy = |from: &str, to: &str| std::fs::copy(place.path(from), place.path(folder).join(to)).expect("copies");
        copy("d.toml", "distortion.toml");
        copy("shading.toml", "shading.toml");
        if psf {
            copy("psf.npz", "psf.npz");
        }
    }
    let lens = builtin::lens(name).and_then(|l| {
        l.changed(|l| {
            (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um) = (columns, rows, 1e3 * pitch_mm);
            l.sensor.axis_px = [columns as f64 / 2.0, rows as f64 / 2.0];
        })
    });
    let lens = lens.expect("valid");
    isoplanat::lens::prescription::save(&lens, &place.path("lens.toml")).expect("writes");
    let judged = |folder: &str| {
        let train = "base_width = 16\nscales = 3\ninputs = [\"wiener\"]\npatch_px = 128\nregion_px = 192\npairs = 300\nsteps = 1500\n\
                     constant_epochs = 50\ndecay_epochs = 50\nrate = 5e-4\nloss = \"l1\"\nnoise = [1.0, 1.0]\nhaze = 0.0\nsample_steps = 0\n";
        let task = format!("schema = 1\nlens = \"{folder}\"\nseed = {seed}\n[train]\n{train}");
        place.write("task.toml", task).run(&format!("train task.toml -o run-{folder}")).done();
        let photos = isoplanat::testing::shared("data/photos/eval")
            .map_or_else(String::new, |p| format!("--photos {}", p.display()));
        let how = format!("--through lens.toml --reference 128 --fields 4 --patch 128 {photos} --json");
        let text = place.run(&format!("evaluate run-{folder} {how}")).done();
        let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let mean = value["rows"].as_array().expect("rows").iter().find(|r| r["zone"] == 0).cloned().expect("the mean");
        let db = |of: &str| mean[of]["psnr_db"]["mean"].as_f64().expect("a number");
        eprintln!("{name}, {folder}: capture {:.2} dB, network {:.2} dB", db("capture"), db("reconstruction"));
        let scale =
            value["lens"].as_str().and_then(|t| t.split("slopes x ").nth(1)).map(|t| t.trim_end_matches(')').parse());
        (db("reconstruction") - db("capture"), scale.expect("told").expect("a number"))
    };
    let (gain, scale): (f64, f64) = judged("mine");
    // The lens's own rays, where the measured distortion sees things.
    let measured = isoplanat::psf::measured::MeasuredPsf::load(&place.path("psf.npz")).expect("reads");
    let frame = frame_of(&lens).and_then(|f| f.with_axis(measured.centre_px)).expect("valid");
    let distortion = MeasuredDistortion::load(&place.path("d.toml")).expect("reads").distortion();
    let radii: Vec<f64> = (0..=64).map(|i| frame.max_radius_mm() * f64::from(i) / 64.0).collect();
    let slopes: Vec<f64> = radii.iter().map(|r| scale * distortion.slope_from_sensor(r / pitch_mm)).collect();
    let map = SensorMap::through(&radii, &slopes, 0.0, lens.object_vergence).expect("grows");
    let npz = exact(&lens, &map, &frame, measured.moves.reach_px.max(12.0)).to_npz().expect("packs");
    place.write("exact/psf.npz", npz);
    let (whole, _) = judged("exact");
    eprintln!("{name}: {gain:.3} of {whole:.3} dB, {:.1} %", 100.0 * gain / whole);
    gain / whole
}

#[test]
#[ignore = "trains four networks: a quarter of an hour"]
fn networks_of_measured_kernels_gain_what_those_of_true_ones_do() {
    for (name, pitch_mm, options, seed) in
        [("landscape", 0.0032, "--terms 1 --reach 7", 1), ("heliar", 0.1, "--reach 9", 3)]
    {
        let share = gained(name, pitch_mm, options, seed);
        assert!(share > 0.9, "{name}: {share}");
    }
}
