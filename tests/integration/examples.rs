//! The programs in `examples/`: each says something true, refuses what is none by one line, and stays one that is read at a glance.
//!
//! `cargo test` builds them; beside `cargo test --test integration` it is `cargo build --examples` that does.

use std::path::PathBuf;
use std::process::Command;

use isoplanat::imaging::reference::halves::psnr_against_halves;
use isoplanat::imaging::reference::{Channels, Sampling, Settings as Rays, render_halves};
use isoplanat::lens::Kind;
use isoplanat::lens::prescription::{from_toml, to_toml};
use isoplanat::ndarray::{Array2, Array3, Array5, s};
use isoplanat::{
    Frame, Lens, Merit, Parameter, Region, Renderer, SceneKind, Sensor, Settings, SpectralDensity, builtin, fill_frame,
    first_order, generate, read_linear,
};

use crate::support::{Workplace, root};

/// Focal length of the shipped Cooke triplet, mm, as published.
const FOCAL_LENGTH: f64 = 50.021_350_719_4;

/// The built example of that name.
fn built(name: &str) -> PathBuf {
    let own = std::env::current_exe().expect("a test");
    let folder = own.parent().and_then(|deps| deps.parent()).expect("a profile's folder").join("examples");
    let program = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(program.exists(), "{}: build it by `cargo build --release --examples`", program.display());
    program
}

/// Runs an example in `place`: exit code, output, errors.
fn ran(place: &Workplace, name: &str, arguments: &str) -> (i32, String, String) {
    let mut command = Command::new(built(name));
    let out = command.args(arguments.split_whitespace()).current_dir(place.path("")).output().expect("starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    (out.status.code().unwrap_or(-1), text(out.stdout), text(out.stderr))
}

/// What an example says that succeeds.
fn said(place: &Workplace, name: &str, arguments: &str) -> String {
    let (code, out, err) = ran(place, name, arguments);
    assert_eq!((code, err.as_str()), (0, ""), "{name} {arguments}");
    out
}

/// The numbers of the first line that begins with `start`.
fn numbers(text: &str, start: &str) -> Vec<f64> {
    let line =
        text.lines().find_map(|l| l.trim_start().strip_prefix(start)).unwrap_or_else(|| panic!("{start}: {text}"));
    line.split([' ', ',']).filter_map(|word| word.parse().ok()).collect()
}

/// A central difference over the relative step `h` of what `value` makes of the number `of` of `lens`.
fn difference(lens: &Lens, of: Parameter, h: f64, value: impl Fn(&Lens) -> f64) -> f64 {
    let at = |step: f64| {
        let moved = lens.changed(|l| *of.value_mut(l).expect("a number") += step);
        value(&moved.expect("a lens"))
    };
    (at(h) - at(-h)) / (2.0 * h)
}

#[test]
fn a_ray_has_the_focal_length_and_its_derivatives_are_differences() {
    let (place, lens) = (Workplace::new(), builtin::lens("cooke_triplet").expect("shipped"));
    let near = numbers(&said(&place, "ray", "cooke_triplet 0.05"), "focal length by this ray:")[0];
    assert!((near - FOCAL_LENGTH).abs() < 1e-4, "{near}");
    let out = said(&place, "ray", "");
    let landing = |lens: &Lens| {
        place.write("moved.toml", to_toml(lens));
        numbers(&said(&place, "ray", "moved.toml"), "lands")[0]
    };
    for surface in [0, 2, 5] {
        let told = numbers(&out, &format!("surface {surface}: by"));
        for (kind, h, slope) in [(Kind::Curvature, 1e-6, told[0]), (Kind::Thickness, 1e-4, told[1])] {
            let seen = difference(&lens, kind.at(surface), h, landing);
            assert!((seen - slope).abs() < 1e-5 * slope.abs().max(1e-2), "{surface} {kind:?}: {seen} {slope}");
        }
    }
}

#[test]
fn point_spread_functions_hold_their_light_where_the_field_is() {
    let place = Workplace::new();
    let out = said(&place, "psf", "cooke_triplet psf.npz");
    let file = std::fs::File::open(place.path("psf.npz")).expect("written");
    let mut npz = ndarray_npy::NpzReader::new(file).expect("an archive");
    let kernels: Array5<f32> = npz.by_name("kernels").expect("kernels");
    let outside: Array3<f64> = npz.by_name("outside").expect("light outside");
    let [angle, radius]: [Array2<f64>; 2] =
        ["field_angle_deg", "sensor_radius_mm"].map(|name| npz.by_name(name).expect("places"));
    assert_eq!(kernels.shape()[..3], [1, 4, 3]);
    for (field, line) in out.lines().skip(2).take(4).enumerate() {
        let told: Vec<f64> = line.split([' ', ',']).filter_map(|w| w.parse().ok()).collect();
        // Object at infinity: f tan θ, with the triplet's distortion and focus.
        let (angle, radius) = (angle[[0, field]], radius[[0, field]]);
        let ideal = FOCAL_LENGTH * angle.to_radians().tan();
        assert!((radius - ideal).abs() <= 0.02 * ideal && (told[0] - angle).abs() < 1e-3, "{field}: {radius} {ideal}");
        for colour in 0..3 {
            let kernel = kernels.slice(s![0, field, colour, .., ..]);
            let sum: f64 = kernel.iter().map(|v| f64::from(*v)).sum();
            assert!((sum + outside[[0, field, colour]] - 1.0).abs() < 1e-4, "{field} {colour}: {sum}");
            let peak = kernel.iter().fold(0f32, |m, v| m.max(*v));
            assert!((told[3 + colour] - f64::from(peak)).abs() < 1e-4, "{line}");
        }
    }
    // A file that is there stays.
    let (code, _, err) = ran(&place, "psf", "cooke_triplet psf.npz");
    assert!(code == 2 && err.lines().count() == 1 && err.contains("psf.npz"), "{code} {err}");
}

#[test]
fn a_picture_has_the_error_it_was_promised() {
    let place = Workplace::new();
    let out = said(&place, "picture", "cooke_triplet facades picture.npy");
    let promised = numbers(out.split("pixels, ").nth(1).expect("a promise"), "")[0];
    assert!(promised >= 45.0, "{out}");
    let picture = read_linear(&place.path("picture.npy")).expect("an array");
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let frame = Frame::centred(240, 160, lens.sensor.radius_mm() / 120_f64.hypot(80.0)).expect("valid");
    let scene = fill_frame(&lens, &frame, generate(SceneKind::Facades, 1, 200, 300)).expect("light");
    let density = SpectralDensity::new(&Sensor::generic());
    // By rays from the sensor, all of it: the promise is the whole picture's.
    let how = Rays { samples: 96, seed: 1, channels: Channels::All, sampling: Sampling::Bounded };
    let halves = render_halves(&lens, &scene, &density, &frame, Region::whole(&frame), how, None).expect("renders");
    let agreement = psnr_against_halves(picture.view(), &halves);
    eprintln!("promised {promised} dB, {agreement:?}");
    assert!(agreement.psnr_db >= 45.0, "{agreement:?}");
}

#[test]
fn gradients_of_a_loss_are_its_differences() {
    let (place, lens) = (Workplace::new(), builtin::lens("cooke_triplet").expect("shipped"));
    let out = said(&place, "gradient", "");
    let frame = Frame::centred(96, 64, lens.sensor.radius_mm() / 48_f64.hypot(32.0)).expect("valid");
    let scene = fill_frame(&lens, &frame, generate(SceneKind::Mixed, 1, 80, 120)).expect("light");
    let density = SpectralDensity::new(&Sensor::generic());
    let start = Renderer::planned(&lens, &frame, &density, &[scene.vergence], Settings::DESIGN).expect("plans");
    let region = Region { row: 8, col: 8, rows: 48, cols: 64 };
    let loss = |lens: &Lens| {
        let seen = Renderer::new(lens, &start.plan).expect("traces").record::<f64>(&scene, 0, region);
        (&seen.image - &seen.truth).mapv(|e| e * e).mean().expect("pixels")
    };
    let told = numbers(&out, "loss")[0];
    assert!((loss(&lens) - told).abs() < 1e-8 * told, "{told}");
    for (kind, surface, h) in
        [(Kind::Curvature, 0, 1e-7), (Kind::Curvature, 4, 1e-7), (Kind::Thickness, 1, 1e-5), (Kind::Thickness, 5, 1e-5)]
    {
        let number = kind.at(surface);
        let slope = numbers(&out, &number.name(&lens))[1];
        let seen = difference(&lens, number, h, loss);
        assert!((seen - slope).abs() < 1e-4 * slope.abs(), "{}: {seen:e} {slope:e}", number.name(&lens));
    }
}

#[test]
fn an_optimised_lens_is_better_at_the_same_focal_length() {
    let place = Workplace::new();
    let out = said(&place, "optimize", "cooke_triplet better.toml");
    let text = std::fs::read_to_string(place.path("better.toml")).expect("written");
    let better = from_toml(&text, "better.toml").expect("a lens");
    let focal_length = first_order(&better, better.wavelengths.primary_nm).effective_focal_length;
    assert!((focal_length - FOCAL_LENGTH).abs() < 1e-6, "{focal_length}");
    let rms = |lens: &Lens| 1e3 * isoplanat::optimize::merit_of(lens, &Merit::default()).expect("light");
    let seen = [rms(&builtin::lens("cooke_triplet").expect("shipped")), rms(&better)];
    let told = numbers(&out, "rms spot");
    assert!(
        (0..2).all(|k| (seen[k] - told[k]).abs() < 1e-4 * told[k]) && seen[1] < 0.95 * seen[0],
        "{seen:?} {told:?}"
    );
}

/// Half of white at an exposure of 0.8 is 0.4 all over, the corners' falling light taken out.
#[cfg(all(feature = "train", feature = "deploy"))]
#[test]
fn a_grey_wall_is_developed_grey() {
    let place = Workplace::new();
    let out = said(&place, "develop", "");
    assert!(out.starts_with("(3, 64, 96) by "), "{out}");
    let mean = numbers(out.split("tiles, ").nth(1).expect("a mean"), "mean")[0];
    assert!((mean - 0.4).abs() < 0.01, "{out}");
    let (code, said, err) = ran(&place, "develop", "kit");
    assert!(code == 2 && said.is_empty() && err.lines().count() == 1 && err.contains("KIT RAW OUT"), "{code} {err}");
}

#[test]
fn examples_are_short_and_refuse_what_is_no_lens() {
    let all = std::fs::read_dir(root().join("examples")).expect("a folder").map(|e| e.expect("an entry").path());
    let mut names: Vec<String> = Vec::new();
    for file in all {
        let lines = std::fs::read_to_string(&file).expect("readable").lines().count();
        assert!(lines <= 40, "{}: {lines} lines", file.display());
        names.push(file.file_stem().expect("a name").to_string_lossy().into_owned());
    }
    names.sort();
    assert_eq!(names, ["develop", "gradient", "optimize", "picture", "psf", "ray"]);
    let place = Workplace::new();
    for name in names.iter().filter(|n| *n != "develop") {
        let (code, out, err) = ran(&place, name, "no_lens");
        assert!(code == 2 && out.is_empty() && err.lines().count() == 1, "{name}: {code} {err}");
        assert!(err.contains("`no_lens`") && err.contains("cooke_triplet"), "{name}: {err}");
    }
}
