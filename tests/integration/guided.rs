//! Guided networks: the same in training, in a kit, and in the camera's tiles; and one clear refusal where
//! filters and model do not belong together.

use std::path::Path;

use isoplanat::atomic::sha256_hex;
use isoplanat::deploy::kit::{Kit, LensEntry};
use isoplanat::deploy::raw;
use isoplanat::deploy::reconstruct::{Camera, Steps};
use isoplanat::deploy::session::{Choice, Options, Session};
use isoplanat::deploy::tiles::{self, Tiling};
use isoplanat::imaging::develop::distortion::Distortion;
use isoplanat::imaging::develop::shading::Shading;
use isoplanat::imaging::develop::simulate::Electronics;
use isoplanat::imaging::files::{Encoding, read_picture};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::guide::{Guide, Inputs};
use isoplanat::imaging::plane::{Region, mirrored};
use isoplanat::imaging::render::{Renderer, Settings};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::builtin;
use isoplanat::network::card::{ModelCard, Weights};
use isoplanat::network::{Base, Blocks, Reconstructor, UnetConfig, onnx};
use ndarray::{Array3, Array4, ArrayView4, Axis, s};

use crate::support::Workplace;

const BOTH: Inputs = Inputs { wiener: true, field: true, ..Inputs::BARE };
const ALL: Inputs = Inputs { levels: true, psf: true, ..BOTH };

fn frame() -> Frame {
    Frame::centred(230, 150, 0.08).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid")
}

/// What a network behind the two-element lens is told.
fn guide(inputs: Inputs) -> Guide {
    let (lens, sensor) = (builtin::lens("two_element").expect("shipped"), Sensor::generic());
    let density = SpectralDensity::new(&sensor);
    let renderer = Renderer::planned(&lens, &frame(), &density, &[lens.object_vergence], Settings::TRAINING);
    Guide::new(inputs, &renderer.expect("traces"), &Electronics::from_sensor(&sensor)).expect("filters")
}

/// A network that is no identity any more and looks at all its channels.
fn trained(inputs: Inputs, blocks: Blocks) -> Reconstructor {
    trained_on(inputs, blocks, Base::NEW)
}

fn trained_on(inputs: Inputs, blocks: Blocks, base: Base) -> Reconstructor {
    let config = UnetConfig { blocks, base, ..UnetConfig::bare(6, 3).seeing(inputs) };
    let mut net = Reconstructor::new(config, 3).expect("valid");
    let rng = &mut fastrand::Rng::with_seed(5);
    for _ in 0..12 {
        let x = Array4::from_shape_simple_fn((1, inputs.channels(), 32, 32), || rng.f32());
        let y = x.slice(s![.., ..3, .., ..]).mapv(|v| v * v) + 0.3 * &x.slice(s![.., -3.., .., ..]);
        net.step_network_only(x.view(), y.view(), None, 1e-2).expect("trains");
    }
    net
}

fn picture(rows: usize, cols: usize) -> Array3<f32> {
    let rng = &mut fastrand::Rng::with_seed(6);
    Array3::from_shape_simple_fn((3, rows, cols), || rng.f32())
}

fn options(choice: Choice) -> Options {
    Options { choice, threads: 2, ..Options::default() }
}

/// A session, or `None` after a visible message where there is no ONNX Runtime and none is required.
fn open(model: &[u8], choice: Choice) -> Option<Session> {
    match Session::open(model, Path::new("model.onnx"), &options(choice)) {
        Ok(session) => Some(session),
        Err(e) => {
            let required = std::env::var_os("ISOPLANAT_REQUIRE_ONNXRUNTIME").is_some_and(|v| v == "1");
            assert!(choice == Choice::OnnxRuntime && !required, "{choice:?}: {e}");
            eprintln!("SKIPPED: {e}");
            None
        }
    }
}

/// Every set of inputs through the camera's tiles, on both runtimes, against the in-crate network on the whole mirrored picture.
#[test]
fn tiles_of_the_camera_see_what_the_network_was_told_in_training() {
    let cases = [
        (BOTH, Blocks::Paper, Base::Blend),
        (BOTH, Blocks::Paper, Base::Filtered),
        (Inputs { wiener: true, ..Inputs::BARE }, Blocks::Paper, Base::Blend),
        (Inputs { field: true, ..Inputs::BARE }, Blocks::Paper, Base::Blend),
        (Inputs { psf: true, ..Inputs::BARE }, Blocks::Paper, Base::Filtered),
        (Inputs::GUIDED, Blocks::Paper, Base::Blend),
        (ALL, Blocks::Paper, Base::Blend),
        (ALL, Blocks::Paper, Base::Filtered),
        (BOTH, Blocks::Separable, Base::Blend),
        (Inputs { wiener: true, ..Inputs::BARE }, Blocks::Gated, Base::Blend),
    ];
    for (inputs, blocks, base) in cases {
        let (guide, net) = (guide(inputs), trained_on(inputs, blocks, base));
        let card = ModelCard::for_unet("told", 6, 3).seeing(inputs).made_of(blocks);
        let model = onnx::encode(&net, &card).expect("encodes");
        let (rows, cols) = (150, 230);
        let image = picture(rows, cols);
        let whole = Region { row: 0, col: 0, rows, cols };
        let told = guide.over(image.view(), whole, whole);
        let place = |i: usize, n: usize| mirrored(i.cast_signed() - 24, n);
        let side = |n: usize| (n + 48).next_multiple_of(4);
        let around = Array4::from_shape_fn((1, inputs.channels(), side(rows), side(cols)), |(_, c, i, j)| {
            told[[c, place(i, rows), place(j, cols)]]
        });
        let ours = net.forward(around.view()).expect("runs");
        let ours = ours.slice(s![0, .., 24..24 + rows, 24..24 + cols]);
        let changed = (&ours - &image).iter().fold(0f32, |m, v| m.max(v.abs()));
        assert!(changed > 0.1, "the network does nothing: {changed}");
        for choice in [Choice::Tract, Choice::OnnxRuntime] {
            let Some(session) = open(&model, choice) else { continue };
            assert_eq!(ModelCard::from_metadata(session.metadata()).expect("a card"), card);
            let run = |tile: ArrayView4<'_, f32>| session.run(tile);
            let tiling = Tiling::new(96, 24, 4).expect("valid");
            let theirs = tiles::run(image.clone(), whole, &guide, tiling, 2, &run, &|_, _| ()).expect("runs");
            // One after the other tiles are written as early as can be: before others are filtered.
            let in_turn = tiles::run(image.clone(), whole, &guide, tiling, 1, &run, &|_, _| ()).expect("runs");
            assert_eq!(theirs, in_turn, "{choice:?}");
            let worst = (&theirs - &ours).iter().fold(0f32, |m, v| m.max(v.abs()));
            eprintln!(
                "{:?}, {blocks:?}, {base:?}, {choice:?}, {} tiles: {worst:e}",
                inputs.names(),
                tiling.count(rows, cols)
            );
            assert!(worst <= 2e-5, "{:?}, {blocks:?}, {base:?}, {choice:?}: {worst:e}", inputs.names());
        }
    }
}

/// The model of `inputs` in a kit with the filters of `guide`.
fn kit(inputs: Inputs, guide: &Guide, weights: Weights) -> isoplanat::Result<Kit> {
    let mut card = ModelCard::for_unet("told", 6, 3).seeing(inputs);
    (card.lens_sha256, card.weights) = (sha256_hex(b"lens"), weights);
    let max_slope = 0.6;
    Kit::new(
        "told",
        LensEntry { name: "lens".into(), sha256: sha256_hex(b"lens") },
        onnx::encode(&trained(inputs, Blocks::Paper), &card)?,
        96,
        Sensor::generic(),
        frame(),
        Distortion { max_slope, coefficients_mm: [50.0 * max_slope, 0.0, 0.0, 0.0], residual_mm: 0.0 },
        Shading::new(vec![0.0, 1.0], [vec![1.0, 0.9], vec![1.0, 0.9], vec![1.0, 0.9]])?,
        guide.facts(),
    )
}

#[test]
fn kits_carry_their_filters_and_refuse_others() {
    let place = Workplace::new();
    let (folder, told) = (place.path("kit"), guide(BOTH));
    let whole = kit(BOTH, &told, Weights::F32).expect("a kit");
    whole.save(&folder, false).expect("saves");
    assert_eq!(std::fs::read_dir(&folder).expect("a folder").count(), 4, "with its list of entries");
    let back = Kit::load(&folder).expect("loads");
    assert_eq!((back.guide.clone(), back.to_toml().expect("text")), (told.clone(), whole.to_toml().expect("text")));
    assert!(back.to_toml().expect("text").contains("schema = 3"));
    let bare = kit(Inputs::BARE, &Guide::bare(&frame()), Weights::F32).expect("a kit").to_toml().expect("text");
    assert!(bare.contains("schema = 3") && !bare.contains("filters"));
    // Filters without a network for them, a network without filters.
    for (inputs, with) in [(Inputs::BARE, &told), (BOTH, &Guide::bare(&frame()))] {
        let error = kit(inputs, with, Weights::F32).expect_err("refused");
        assert!(error.exit_code() == 2 && error.to_string().contains("Wiener filters"), "{error}");
    }
    let toml = std::fs::read_to_string(folder.join("kit.toml")).expect("text");
    let file = folder.join("filters.npz");
    let bytes = std::fs::read(&file).expect("bytes");
    let refused = |what: &str| {
        let error = Kit::load(&folder).expect_err(what);
        assert!(error.exit_code() == 2 && error.to_string().contains(what), "{what}: {error}");
    };
    std::fs::write(&file, &bytes[..bytes.len() - 9]).expect("writes");
    refused("SHA-256");
    std::fs::remove_file(&file).expect("removes");
    refused("filters.npz");
    std::fs::write(&file, &bytes).expect("writes");
    let start = toml.find("[filters]").expect("a table");
    let end = toml[start + 1..].find("\n[").expect("another") + start + 2;
    std::fs::write(folder.join("kit.toml"), format!("{}{}", &toml[..start], &toml[end..])).expect("writes");
    refused("Wiener filters");
    std::fs::write(folder.join("kit.toml"), toml.replacen("filters.npz", "../filters.npz", 1)).expect("writes");
    refused("kit's folder");
    // All that a network can be told, and what point spread functions are like alone.
    for (k, inputs) in [ALL, Inputs { psf: true, ..Inputs::BARE }].into_iter().enumerate() {
        let (folder, told) = (place.path(&format!("kit{k}")), guide(inputs));
        kit(inputs, &told, Weights::F32).expect("a kit").save(&folder, false).expect("saves");
        assert_eq!(Kit::load(&folder).expect("loads").guide, told);
    }
    // The distances that the filters are for stand in the kit, and are those of the file.
    assert!(toml.contains("depths_mm = [1000.0]"), "{toml}");
    std::fs::write(folder.join("kit.toml"), toml.replacen("depths_mm = [1000.0]", "depths_mm = [500.0]", 1))
        .expect("writes");
    refused("filters.depths_mm");
}

/// A design of a guided network: the folder has the finished lens's filters, can be judged, and a training goes on from it.
#[test]
fn a_guided_network_is_designed_with_its_lens() {
    let place = Workplace::new();
    let sensor = "sensor = { columns = 96, rows = 64, pitch_um = 200.0, axis_px = [0.0, 0.0] }";
    let task = |more: &str| {
        format!(
            "schema = 1\nlens = \"two_element\"\nscenes = 2\n{sensor}\nbase_width = 4\npatch_px = 32\nbatch = 1\n{more}"
        )
    };
    place.write("design.toml", task("steps = 3\ninputs = [\"wiener\", \"field\"]\n"));
    let said = place.run("design design.toml -o run").done();
    assert!(said.contains("filters of the guided network made anew"), "{said}");
    let json: serde_json::Value =
        serde_json::from_str(&place.run("evaluate run --json --reference 4 --fields 2 --patch 32").done())
            .expect("JSON");
    assert!(json["rows"].as_array().is_some_and(|rows| !rows.is_empty()));
    let train =
        "[train]\nstart = \"run\"\nscales = 3\npatch_px = 32\nregion_px = 48\npairs = 4\nsteps = 2\nsample_steps = 0\n";
    place.write("train.toml", task(&format!("{train}inputs = [\"wiener\", \"field\"]\n")));
    place.run("train train.toml -o trained").done();
    // A network that was told is no network of the capture alone.
    place.write("bare.toml", task(train));
    place.run("train bare.toml -o bare").refused(&["starting network", "wiener"]);
    place.write("wrong.toml", task("steps = 3\ninputs = [\"smell\"]\n"));
    place.run("design wrong.toml -o none").refused(&["wrong.toml", "inputs", "wiener, levels, field, psf"]);
}

/// From a task to a picture: trained from a network that sees the capture alone, judged, exported, and used on a capture by both runtimes.
#[test]
fn a_guided_network_goes_from_the_task_to_the_camera() {
    let place = Workplace::new();
    let task = |inputs: &str, start: &str| {
        format!(
            "schema = 1\nlens = \"two_element\"\nscenes = 2\n\
             sensor = {{ columns = 96, rows = 64, pitch_um = 200.0, axis_px = [0.0, 0.0] }}\n[train]\n{start}scales = 3\n\
             base_width = 4\npatch_px = 32\nregion_px = 48\npairs = 4\nsteps = 12\nsample_steps = 10\n{inputs}"
        )
    };
    place
        .write("bare.toml", task("", ""))
        .write("told.toml", task("inputs = [\"wiener\", \"field\"]", "start = \"bare\"\n"));
    place.write("smell.toml", task("inputs = [\"smell\"]", ""));
    place.run("train smell.toml -o none").refused(&["smell.toml", "inputs", "wiener, levels, field, psf"]);
    place.write("dense.toml", task("blocks = \"dense\"\n", ""));
    place.run("train dense.toml -o none").refused(&["dense.toml", "blocks", "dense", "paper, separable, gated"]);
    place.run("train bare.toml -o bare").done();
    let said = place.run("train told.toml -o told");
    assert_eq!(said.code, 0, "{said:?}");
    assert!(said.err.contains("sees wiener, field") && place.path("told/filters.npz").is_file(), "{}", said.err);
    assert!(!place.path("bare/filters.npz").is_file());
    place.run("train --resume -o told").done();
    let json: serde_json::Value = serde_json::from_str(&place.run("evaluate told --json").done()).expect("JSON");
    assert!(json["rows"].as_array().is_some_and(|rows| !rows.is_empty()));
    place.run("export told -o kit").done();
    place.run("export told -o half --f16").done();
    place.run("capture told/lens.toml facades:3 -o a.dng --samples 8").done();
    let kit = Kit::load(&place.path("kit")).expect("loads");
    assert_eq!(kit.guide.inputs(), BOTH);
    let mut pictures = Vec::new();
    for choice in [Choice::Tract, Choice::OnnxRuntime] {
        if open(&kit.model_bytes, choice).is_none() {
            continue;
        }
        let camera = Camera::with_kit(kit.clone(), Steps::default(), &options(choice)).expect("opens");
        let capture = raw::decode(&place.path("a.dng")).expect("decodes");
        let picture = camera.reconstruct(capture, Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert!(picture.image.iter().all(|v| v.is_finite()) && picture.tiles >= 1);
        pictures.push(picture.image);
    }
    for other in &pictures[1..] {
        let worst = (other - &pictures[0]).iter().fold(0f32, |m, v| m.max(v.abs()));
        assert!(worst < 1e-4, "{worst}");
    }
    the_program_runs_it_within_limits(&place, &pictures);
    it_is_judged_behind_lenses_as_built(&place);
    // Without its filters the run is refused by name.
    std::fs::remove_file(place.path("told/filters.npz")).expect("removes");
    for command in ["evaluate told", "export told -o other", "train --resume -o told"] {
        place.run(command).refused(&["filters.npz"]);
    }
    assert_eq!(pictures[0].index_axis(Axis(0), 0).dim(), (64, 96));
}

/// The camera program, whose network runs in a child, writes one of `pictures`; a child without time or memory is one sentence and no picture.
fn the_program_runs_it_within_limits(place: &Workplace, pictures: &[Array3<f32>]) {
    let run = |arguments: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"));
        let ran = command.args(arguments.split_whitespace()).current_dir(place.path("")).output().expect("starts");
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        (ran.status.code(), text(ran.stderr), text(ran.stdout))
    };
    let (code, err, out) = run("a.dng --kit kit --linear -o apart.tif --json");
    assert_eq!(code, Some(0), "{err}");
    // The network's child is held as the decoder's is, whichever runtime it has loaded, and its memory is limited by itself.
    let json: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let [decoder, network] = ["decoder", "network"].map(|name| &json["pictures"][0]["children"][name]);
    for part in ["no_new_privs", "landlock_abi", "seccomp"] {
        assert_eq!(decoder[part], network[part], "{part}: {json}");
    }
    assert_eq!(network["memory_bytes"].is_u64(), cfg!(target_os = "linux"), "{json}");
    let apart = read_picture(&place.path("apart.tif"), Encoding::Linear).expect("reads");
    let off = |here: &Array3<f32>| (here - &apart).iter().fold(0f32, |m, v| m.max(v.abs()));
    // 16 bits.
    assert!(
        pictures.iter().any(|here| off(here) <= 1.0 / 65_000.0),
        "{:?}",
        pictures.iter().map(off).collect::<Vec<_>>()
    );
    // (An address space without limit is the system's affair elsewhere.)
    let memory = cfg!(target_os = "linux").then_some(("--network-memory 16", "more than 16 MiB"));
    for (limit, said) in [("--tile-seconds 1e-7", "had not come to an end")].into_iter().chain(memory) {
        let (code, err, _) = run(&format!("a.dng --kit kit {limit} -o none.tif"));
        assert_eq!(code, Some(2), "{limit}: {err}");
        let last = err.lines().last().unwrap_or_default();
        assert!(last.contains("model.onnx: network") && last.contains(said), "{limit}: {err}");
        assert!(!place.path("none.tif").exists(), "{limit}");
    }
    assert_eq!(run("a.dng --kit kit --tile-seconds 0 -o none.tif").0, Some(2));
}

/// Drawn lenses, tilts and all: photographed, and judged behind the run's network; a draw that was no lens counts.
fn it_is_judged_behind_lenses_as_built(place: &Workplace) {
    let tolerances = "schema = 1\n[surface.all]\ncentring_arcmin = 5.0\n[assembly]\ndecentre_mm = 0.1\n";
    place.write("t.toml", tolerances);
    place.run("tolerance told/lens.toml --tolerances t.toml --draws 3 --lenses drawn").done();
    let text = place.run("evaluate told --drawn drawn --reference 4 --fields 1 --patch 32 --csv drawn.csv").done();
    for part in ["the lens itself", "refocused as the draws are", "90 % of the draws reach", "3 draws in"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert_eq!(std::fs::read_to_string(place.path("drawn.csv")).expect("rows").lines().count(), 4);
    std::fs::remove_file(place.path("drawn/draw-000002.toml")).expect("removes");
    let json = place.run("evaluate told --drawn drawn --reference 4 --fields 1 --patch 32 --json").done();
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["draws"][1]["why"], "no lens was found there");
    assert!(json["draws"][2]["shown"]["aligned"]["reconstruction_db"].is_f64(), "{json}");
    let command = "evaluate told --drawn drawn --reference 4 --fields 1 --patch 32";
    // (Beside the line that says that scenes are built in.)
    for (more, said) in [("--depths-mm 500,1000", "drawn: drawn lenses: 2 distances"), ("--drawn none", "none")] {
        let ran = match more {
            "--drawn none" => place.run("evaluate told --drawn none --reference 4"),
            _ => place.run(&format!("{command} {more}")),
        };
        assert!(ran.code == 2 && ran.err.contains(said), "{ran:?}");
    }
    assert_eq!(place.run("evaluate told --drawn drawn").code, 2);
    place.run("capture drawn/draw-000001.toml facades:3 -o tilted.dng --samples 4").done();
    place.run("render drawn/draw-000001.toml facades:3 -o tilted.png").refused(&["rotationally symmetric"]);
}
