//! A lens that was measured on its camera in place of a prescription: from its folder to a trained network, a judgement and a kit.

use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::calibrate::lens::MeasuredLens;
use isoplanat::imaging::develop::distortion::Distortion;
use isoplanat::imaging::files::{Encoding, read_picture};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Channels, Renderer, Settings};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::{SpectralDensity, Spectrum};
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::measured::{MeasuredPsf, Moves};
use isoplanat::psf::{Optics, Quadrature};

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

/// What an endless calibration would find of the lens: its rays on a grid of moves, its distortion's polynomial.
fn measured(lens: &Lens) -> MeasuredLens {
    let frame = isoplanat::imaging::render::frame_of(lens).expect("valid");
    let spectrum = Spectrum::quadrature(&Sensor::generic(), 9);
    let quadrature = Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() };
    let far_mm = frame.max_radius_mm();
    let optics = Optics::even(lens, far_mm, vec![0.0], quadrature, 64).expect("traces");
    let form = optics.form(3000, 3, 1, PITCH_MM);
    let moves = Moves::within(6.0, 0.25).expect("valid");
    let number: std::collections::HashMap<[i32; 2], usize> =
        moves.steps().iter().enumerate().map(|(i, s)| (*s, i)).collect();
    let radii_px: Vec<f64> = (0..=6).map(|i| far_mm / PITCH_MM * f64::from(i) / 6.0).collect();
    let weights = radii_px
        .iter()
        .map(|r| {
            let radius_mm = r * PITCH_MM;
            let levels = optics.illumination().at(radius_mm);
            let rays: Vec<_> =
                (0..levels.len()).map(|l| form.rays(optics.table(), &optics.maps[0], l, radius_mm)).collect();
            let of_channel = |weight: &Vec<f64>| {
                let mut kernel = vec![0.0; moves.len()];
                for (rays, scale) in rays.iter().zip(weight.iter().zip(&levels).map(|(w, e)| w * e)) {
                    for ((x, y), share) in rays.x.iter().zip(&rays.y).zip(&rays.share) {
                        // Shared between the four moves around it; the other half of the stop is the mirror image.
                        let [a, b] = [y, x].map(|v| v / PITCH_MM / moves.spacing_px);
                        for [i, j] in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                            let at = [a.floor() as i32 + i, b.floor() as i32 + j];
                            let part = (1.0 - (a - f64::from(at[0])).abs()) * (1.0 - (b - f64::from(at[1])).abs());
                            // Both halves fall on the half grid; a move on the meridian stands once.
                            let twice = if at[1] == 0 { 2.0 } else { 1.0 };
                            kernel[number[&[at[0], at[1].abs()]]] += twice * share * scale * part;
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
    let psf = MeasuredPsf::new(SIZE, frame.axis_px, moves, radii_px, weights).expect("valid");
    let Distortion { max_slope: m, coefficients_mm: b, .. } =
        Distortion::of_map(&optics.maps[0], far_mm).expect("monotonic");
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
    let frame = isoplanat::imaging::render::frame_of(&lens).expect("valid");
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
    let task = "schema = 1\nlens = \"mine\"\nscenes = 3\n[train]\nbase_width = 4\nscales = 3\ninputs = [\"wiener\"]\npatch_px = 64\n\
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
        place.write("wrong.toml", task.replace("\"mine\"", "\"elsewhere\"").replace("scenes = 3", change))
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
