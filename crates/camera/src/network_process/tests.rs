//! Children that answer, refuse, fail and hang.

use super::wire::MOST_SAMPLES;
use super::*;
use crate::session::Choice;
use crate::test_model;
use isoplanat_base::error::BadInput;
use std::path::PathBuf;

fn tile(columns: usize, seed: u64) -> Array4<f32> {
    let rng = &mut fastrand::Rng::with_seed(seed);
    Array4::from_shape_simple_fn((1, 3, 16, columns), || rng.f32())
}

fn asked(model: &[u8]) -> Vec<u8> {
    let file = PathBuf::from("k/model.onnx");
    let model_bytes = model.len() as u64;
    let (onnxruntime, candidates) = (None, Vec::new());
    let asked = Asked { file, model_bytes, onnxruntime, candidates, threads: 3, choice: Choice::Tract };
    let mut bytes = Vec::new();
    words(&mut bytes, &asked).expect("writes");
    bytes.extend_from_slice(model);
    bytes
}

fn open() -> std::result::Result<Confinement, String> {
    Ok(Confinement::default())
}

/// What a child says before it answers tiles.
fn said(out: &mut &[u8]) -> std::result::Result<Opened, Box<BadInput>> {
    assert!(matches!(line(out).expect("JSON"), Said::Ready(_)));
    let Said::Opened(opened) = line(out).expect("JSON") else { panic!("it is ready already") };
    opened.map_err(Box::new)
}

/// The child's side, fed with everything at once: what it answers is what a session says, whatever the order, a tile that the model cannot take among
/// them.
#[test]
fn a_child_answers_as_a_session_does() {
    let model = test_model::unet(4, 9, &[]);
    let mut input = asked(&model);
    let tiles: Vec<Array4<f32>> = (0..7).map(|k| tile(16 + 4 * k, k as u64)).collect();
    for (k, t) in tiles.iter().enumerate() {
        write_tile(&mut input, k as u64, t.view()).expect("writes");
    }
    let wrong = Array4::<f32>::zeros((1, 5, 16, 16));
    write_tile(&mut input, 7, wrong.view()).expect("writes");
    let mut out = Vec::new();
    serve(&mut &input[..], &mut out, open).expect("serves");
    let mut out = &out[..];
    assert_eq!(said(&mut out).expect("opens").workers, 3);
    let options = Options { choice: Choice::Tract, threads: 1, ..Options::default() };
    let session = Session::open(&model, Path::new("m"), &options).expect("opens");
    let mut seen = Vec::new();
    for _ in 0..8 {
        let (id, answer) = read_answer(&mut out, || MOST_SAMPLES).expect("an answer");
        seen.push(id);
        match tiles.get(usize::try_from(id).expect("small")) {
            Some(tile) => assert_eq!(answer.expect("runs").0, session.run(tile.view()).expect("runs")),
            None => assert!(answer.expect_err("five channels").to_string().contains("inference")),
        }
    }
    seen.sort_unstable();
    assert_eq!(seen, (0..8).collect::<Vec<u64>>());
    assert!(out.is_empty() && read_answer(&mut out, || MOST_SAMPLES).is_err());
}

#[test]
fn a_model_that_is_none_is_an_answer() {
    let mut out = Vec::new();
    serve(&mut &asked(b"no model")[..], &mut out, open).expect("serves");
    let error = said(&mut &out[..]).expect_err("refused").to_string();
    assert!(error.starts_with("k/model.onnx: model: cannot be read as ONNX"), "{error}");
    // A shape that overflows, a tile that is cut short, no first line.
    let mut cut = asked(&test_model::unet(4, 9, &[]));
    write_tile(&mut cut, 0, tile(16, 1).view()).expect("writes");
    cut.pop();
    for bad in [&cut[..], b"{}"] {
        assert!(serve(&mut &bad[..], &mut Vec::new(), open).is_err());
    }
    let vast: Vec<u8> = [1_u64, u64::MAX, 2, 3, 4].iter().flat_map(|n| n.to_ne_bytes()).collect();
    assert!(read_tile(&mut &vast[..]).is_err());
}

/// A child that cannot be held does not read the model; one that finds no runtime asks once for more places.
#[test]
fn a_child_is_held_before_it_reads_the_model() {
    let model = test_model::unet(4, 9, &[]);
    let mut out = Vec::new();
    let input = asked(&model);
    let mut input = &input[..];
    serve(&mut input, &mut out, || Err("no limits here".into())).expect("serves");
    assert!(matches!(line(&mut &out[..]).expect("JSON"), Said::Unheld(why) if why == "no limits here"));
    assert_eq!(input, model);
}

#[cfg(unix)]
#[test]
fn children_that_fail_hang_or_babble_become_one_sentence() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let opened = Opened { runtime: Runtime::Tract { reason: String::new() }, workers: 1 };
    let ready = serde_json::to_string(&Said::Ready(Confinement::default())).expect("JSON");
    let look = serde_json::to_string(&Said::Look).expect("JSON");
    let early = serde_json::to_string(&Said::Opened(Ok(opened.clone()))).expect("JSON");
    let opened = format!("{ready}\n{early}");
    let busy = "f=$0.times; echo >> \"$f\"; [ $(wc -l < \"$f\") -gt 1 ] && exec sleep 30;";
    let scripts = [
        ("dies", "kill -9 $$".to_owned(), "broke off"),
        ("babbles", "echo hello".to_owned(), "broke off"),
        ("hangs", "exec sleep 30".to_owned(), "opening the model had not come to an end after 0.5 s"),
        ("opens what it has not", format!("echo '{early}'; exec sleep 30"), "broke off"),
        ("asks again", format!("echo '{ready}'; echo '{look}'; exec sleep 30"), "broke off"),
        ("opens and dies", format!("echo '{opened}'; sleep 0.1"), "broke off"),
        ("opens and hangs", format!("echo '{opened}'; exec sleep 30"), "a tile had not come to an end after 0.5 s"),
        ("opens and babbles", format!("echo '{opened}'; echo abcdefghijklmnopq; exec sleep 30"), "broke off"),
        ("opens once", format!("{busy} echo '{opened}'; exec sleep 30"), "a tile had not come to an end after 0.5 s"),
    ];
    for (name, script, said) in scripts {
        let program = dir.path().join(name);
        crate::child::tests::script(&program, &script);
        let apart = Apart { time: Duration::from_millis(500), hint: "; --more", ..Apart::new(Helper::at(program)) };
        let network = Network::open(&[0; 1 << 20], Path::new("m.onnx"), &Options::default(), Some(&apart));
        // More than a pipe holds, to a child that does not read.
        let large = Array4::<f32>::zeros((1, 3, 256, 256));
        let error = match network {
            Err(error) => error,
            Ok(network) => {
                let first = network.run(large.view()).expect_err("no answer").to_string();
                // Whoever comes later hears the same, at once; for the next capture a child is started anew.
                let clock = Instant::now();
                assert_eq!(network.run(large.view()).expect_err("gone").to_string(), first, "{name}");
                assert!(clock.elapsed() < Duration::from_millis(400), "{name}");
                let again = network.ready().and_then(|()| network.run(large.view()).map(|_| ()));
                let again = again.expect_err("no answer again").to_string();
                let other = if name == "opens once" { "opening the model had not" } else { said };
                assert!(again.contains(other), "{name}: {again}");
                Error::bad("m.onnx", "network", first, "")
            }
        };
        assert!(error.to_string().contains(said) && error.exit_code() == 2, "{name}: {error}");
        assert!(error.to_string().contains("; --more"), "{name}: {error}");
    }
    // A child that is stopped while nobody asks it anything: the next tile is told at once.
    let program = dir.path().join("idle");
    crate::child::tests::script(&program, &format!("echo '{opened}'"));
    let network =
        Network::open(&[0; 8], Path::new("m.onnx"), &Options::default(), Some(&Apart::new(Helper::at(program))));
    std::thread::sleep(Duration::from_millis(300));
    let clock = Instant::now();
    let error = network.expect("opens").run(Array4::zeros((1, 3, 4, 4)).view()).expect_err("gone");
    assert!(error.to_string().contains("broke off") && clock.elapsed() < Duration::from_secs(5), "{error}");
}

/// Names that are no text reach the child as they are; a result shows them with a mark in their place.
#[cfg(unix)]
#[test]
fn names_of_any_bytes_reach_the_child() {
    let named = |bytes: &[u8]| PathBuf::from(<std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(bytes));
    let (file, library) = (named(b"k\xff/model.onnx"), named(b"/l\xfe.so"));
    let candidates = vec![Candidate::new(&library, "VIRTUAL_ENV")];
    let onnxruntime = Some(Candidate::new(&library, "--onnxruntime"));
    let asked = Asked { file: file.clone(), model_bytes: 0, onnxruntime, candidates, threads: 1, choice: Choice::Best };
    let mut bytes = Vec::new();
    words(&mut bytes, &asked).expect("writes");
    let heard: Asked = line(&mut &bytes[..]).expect("reads");
    assert_eq!((heard.file, heard.onnxruntime, heard.candidates), (file, asked.onnxruntime, asked.candidates));
    let runtime = crate::session::Runtime::OnnxRuntime { version: "1.24.0".into(), library, origin: "a".into() };
    let shown = serde_json::to_value(runtime).expect("a text");
    assert_eq!(shown["OnnxRuntime"]["library"], "/l\u{fffd}.so");
}
