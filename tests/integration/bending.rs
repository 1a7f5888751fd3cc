//! Pictures by diffraction: the plan against everything, brightness, and the answer that they are not needed.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::Plane;
use isoplanat::imaging::render::{Diffraction, PlanOptions, Request, ScenePlan, Settings, plan};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Aperture, Lens, builtin};
use isoplanat::psf::Model;
use ndarray::Array3;

#[cfg(feature = "train")]
use crate::support::Workplace;

/// A lens at an f-number, a small frame of `pitch_um` whose middle lies `off_mm` to the right of the axis and as far above it, and `texture` before it, a texel a pixel.
fn case(name: &str, f_number: Option<f64>, pitch_um: f64, off_mm: f64, texture: Array3<f32>) -> (Lens, Frame, Plane) {
    let mut lens = builtin::lens(name).expect("shipped");
    if let Some(n) = f_number {
        lens = lens.changed(|l| l.aperture = Aperture::FNumber(n)).expect("closes");
    }
    let (_, h, w) = texture.dim();
    let pitch = pitch_um * 1e-3;
    let off = off_mm / pitch;
    let axis = [0.5 * w as f64 - off, 0.5 * h as f64 - off];
    let frame = Frame::centred(w, h, pitch).and_then(|f| f.with_axis(axis)).expect("valid");
    let scene = Placement::centred([h, w], &frame, Scale::There(1.0)).before(&lens, &frame, texture).expect("light");
    (lens, frame, scene)
}

fn planned(lens: &Lens, frame: &Frame, scene: &Plane, request: Request, diffraction: Diffraction) -> ScenePlan {
    let density = SpectralDensity::new(&Sensor::generic());
    let options = PlanOptions { explain: false, diffraction };
    plan(lens, std::slice::from_ref(scene), frame, &density, request, options).expect("plans")
}

fn picture(plan: &ScenePlan, scene: &Plane) -> Array3<f32> {
    plan.picture(scene, &|_| ()).expect("renders").0
}

fn decibel(a: &Array3<f32>, b: &Array3<f32>) -> f64 {
    let square = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64;
    -10.0 * square.log10()
}

/// Where diffraction shows, `auto` finds it, and its picture keeps what was promised against kernels at every sixteenth pixel, in finer colours and wider windows; pictures of
/// rays do not.
#[test]
fn pictures_by_diffraction_hold_their_promise() {
    let street = || generate(SceneKind::Facades, 3, 72, 96);
    for (name, f_number, pitch_um, off_mm) in
        [("double_gauss", Some(16.0), 3.0, 4.0), ("phone", None, 1.1, 1.2), ("cooke_triplet", Some(11.0), 3.0, 0.0)]
    {
        let (lens, frame, scene) = case(name, f_number, pitch_um, off_mm, street());
        let chosen = planned(&lens, &frame, &scene, Request::Psnr(45.0), Diffraction::Auto);
        assert!(chosen.renderer.optics.spec.diffraction.diffracts(), "{name}: needed");
        let fine = Settings {
            node_error: 0.02,
            wavelengths: 12,
            samples: 2,
            outside: 1e-4,
            diffraction: Model::Waves,
            ..Settings::FINE
        };
        let everything = planned(&lens, &frame, &scene, Request::Settings(fine), Diffraction::On);
        let of_rays = planned(&lens, &frame, &scene, Request::Psnr(45.0), Diffraction::Off);
        let exact = picture(&everything, &scene);
        let [found, rays] = [&chosen, &of_rays].map(|plan| decibel(&picture(plan, &scene), &exact));
        eprintln!(
            "{name}: {found:.1} dB, {:?} predicted, {:?}; of rays {rays:.1} dB",
            chosen.predicted_db, chosen.renderer.plan.settings
        );
        assert!(chosen.holds && found > 45.0, "{name}: {found}");
        assert!(rays < 45.0, "{name}: rays would do: {rays}");
        assert!(chosen.skips.iter().all(|s| s.what != "diffraction"));
    }
}

/// White stays white to a thousandth: light that bends out of windows is put back.
#[test]
fn white_stays_white_by_diffraction() {
    for (name, f_number, pitch_um, off_mm) in [("double_gauss", Some(16.0), 6.0, 3.0), ("phone", None, 1.4, 1.5)] {
        let (lens, frame, scene) = case(name, f_number, pitch_um, off_mm, Array3::from_elem((3, 96, 128), 1.0));
        let on = planned(&lens, &frame, &scene, Request::Psnr(45.0), Diffraction::On);
        let off = planned(&lens, &frame, &scene, Request::Psnr(45.0), Diffraction::Off);
        let (a, b) = (picture(&on, &scene), picture(&off, &scene));
        // Away from the border of the painted wall, where it is lit from one side alone.
        let middle = ndarray::s![.., 40..56, 50..78];
        let worst = (&a.slice(middle) / &b.slice(middle)).iter().fold(0.0f32, |m, v| m.max((v - 1.0).abs()));
        eprintln!("{name}: {worst:.1e}");
        assert!(worst < 1e-3, "{name}: {worst}");
    }
}

/// Where pixels hide what bends, the plan says so and its bound, and the picture is that of rays to the bit.
#[test]
fn what_pixels_hide_is_left_out() {
    let (lens, frame, scene) = case("two_element", None, 60.0, 2.0, generate(SceneKind::Mixed, 2, 64, 80));
    let auto = planned(&lens, &frame, &scene, Request::Psnr(40.0), Diffraction::Auto);
    let off = planned(&lens, &frame, &scene, Request::Psnr(40.0), Diffraction::Off);
    assert_eq!(auto.renderer.optics.spec.diffraction, Model::Rays);
    let left = auto.skips.iter().find(|s| s.what == "diffraction").expect("told");
    assert!(left.bound > 0.0 && left.bound < 3.2e-3, "{}", left.bound);
    assert!(off.skips.iter().all(|s| s.what != "diffraction"), "what was asked for lacks nothing");
    let asked = planned(&lens, &frame, &scene, Request::Psnr(40.0), Diffraction::Approximate);
    assert!(asked.skips.iter().all(|s| !s.what.starts_with("diffraction")), "nor does an approximation");
    let on = planned(&lens, &frame, &scene, Request::Psnr(40.0), Diffraction::On);
    let (a, b) = (picture(&auto, &scene), picture(&on, &scene));
    let rms = 10f64.powf(-0.05 * decibel(&a, &b));
    eprintln!("bound {:.1e}, found {rms:.1e}", left.bound);
    // Both pictures hold 40 dB by themselves.
    assert!(rms < 1e-2, "{rms}");
    if auto.renderer.plan.settings == off.renderer.plan.settings {
        assert_eq!(a, picture(&off, &scene));
    }
}

/// A task that says nothing leaves it to its scenes: of a lens that moves whenever settings are chosen, of one that is held at once. Files of before stay with rays, other words are
/// refused.
#[cfg(feature = "train")]
#[test]
fn tasks_ask_their_scenes() {
    let place = Workplace::new();
    let task = |schema: u32, said: &str, lens: &str, pitch_um: f64| {
        format!(
            "schema = {schema}\n[lens]\nfile = \"{lens}\"\nwarm_start = false\n[pictures]\nscenes = 2\npatch_px = 32\nbatch = 1\n{said}\n\
             [network]\nbase_width = 4\n[budget]\nsteps = 1\n[frame.raster]\ncolumns = 96\nrows = 64\npitch_um = {pitch_um}\n\
             [train.network]\nscales = 2\nbase_width = 4\n[train.pairs]\ncount = 2\npatch_px = 32\nregion_px = 40\nbatch = 1\n\
             [train.loss]\ncontent = \"l1\"\n[train.budget]\nsteps = 1\nsample_steps = 0\n"
        )
    };
    let asked = |name: &str| {
        let own = std::fs::read_to_string(place.path(name).join("task.toml")).expect("written");
        let line = own.lines().find_map(|l| l.strip_prefix("diffraction = "));
        line.expect("said").trim_matches('"').to_owned()
    };
    // Of its last pictures, as whoever reads the run has it.
    let had = |name: &str| isoplanat::Run::open(&place.path(name)).expect("a run").task.pictures.diffraction;
    place.write("word.toml", task(3, "diffraction = \"maybe\"", "phone", 1.1));
    place.run("design word.toml -o run").refused(&["word.toml", "line 9", "maybe", "auto"]);
    let auto = "diffraction = \"auto\"";
    for (name, schema, said, lens, pitch_um, needed) in [
        ("fine", 3, "", "phone", 1.1, true),
        ("large", 3, "", "two_element", 60.0, false),
        ("before", 2, "", "phone", 1.1, false),
        ("asked", 2, auto, "phone", 1.1, true),
    ] {
        place.write(&format!("{name}.toml"), task(schema, said, lens, pitch_um));
        let told = place.run(&format!("design {name}.toml -o {name}")).done();
        let words = ["by diffraction, ", "with the open pupil's diffraction, "];
        assert_eq!(words.iter().any(|words| told.contains(words)), needed, "{name}: {told}");
        assert_eq!(asked(name), if schema == 2 && said.is_empty() { "false" } else { "auto" }, "{name}");
        assert_eq!(had(name) != Diffraction::Off, needed, "{name}");
        place.run(&format!("design --resume -o {name}")).done();
    }
    // What is trained for the finished lens asks that lens.
    place.run("train fine -o net").done();
    assert!(!["false", "auto"].contains(&&*asked("net")), "{}", asked("net"));
    // One that is held does not become sharp: what its run's task says is settled.
    let held = task(3, "", "two_element", 6.0).replace("warm_start", "freeze = true\nwarm_start");
    place.write("held.toml", held);
    place.run("design held.toml -o held").done();
    assert_eq!(asked("held"), "false");
    // In stages each lens is asked.
    let stages = "[[stages]]\n[stages.budget]\nsteps = 1\n[[stages]]\n[stages.budget]\nsteps = 1\n";
    place.write("stages.toml", task(3, "", "phone", 1.1) + stages);
    place.run("design stages.toml -o stages").done();
    assert!(had("stages") != Diffraction::Off);
    let said = place.run("design --resume -o stages").done();
    assert!(!said.contains("of rays"), "{said}");
}
