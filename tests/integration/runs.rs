//! A run's folder holds one checkpoint's network, lens and filters: what a kill between two renames leaves, or a hand, is refused, and a design mends itself.

use crate::support::{SMALL_DESIGN, Workplace, tensors};

/// A guided network of some seconds.
const TRAIN: &str = r#"
[train]
inputs = ["wiener", "field", "psf"]
base_width = 4
scales = 2
patch_px = 32
region_px = 48
pairs = 4
loss = "l1"
steps = 8
checkpoint_seconds = 0.02
sample_steps = 0
"#;

/// What reads a run's network, or its lens alone.
const NETWORK: [&str; 4] = [
    "report run --rays 64 -o page.html",
    "export run -o kit",
    "evaluate run --fields 1 --patch 32 --json",
    "report run --rays 64 --measure=1 --measure-rays 64 -o page.html",
];
const LENS: [&str; 2] = ["train run -o net --steps 1", "compare run --against cooke_triplet --steps 1 -o cmp"];

#[test]
fn the_network_of_one_checkpoint_beside_the_lens_of_another_is_refused() {
    let place = Workplace::new();
    let design = SMALL_DESIGN.replace("steps = 90", "steps = 12");
    let told = format!("inputs = [\"wiener\", \"field\"]\n{design}");
    place.write("task.toml", told + TRAIN);
    place.run("design task.toml -o run").done();
    let file = |name: &str| std::fs::read(place.path(name)).expect("a file");
    let (lens, filters, network) =
        (file("run/lens.toml"), file("run/filters.npz"), tensors(&place.path("run/network.safetensors")));
    let refused = |what: &str, commands: &[&str]| {
        for command in commands {
            let ran = place.run(command);
            assert_eq!(ran.code, 2, "{command}: {}", ran.err);
            for word in ["run", what, "network.safetensors", "--resume"] {
                assert!(ran.err.contains(word), "{command}: {word}: {}", ran.err);
            }
        }
        for left in ["kit", "page.html", "net", "cmp"] {
            assert!(!place.path(left).exists(), "{left}");
        }
    };
    // As a kill leaves them between the checkpoint and what stands beside it: the files of a checkpoint before, or none at all.
    place.write("run/lens.toml", file("run/lens-first.toml"));
    refused("lens.toml", &NETWORK);
    refused("lens.toml", &LENS);
    place.run("design --resume -o run").done();
    assert!(file("run/lens.toml") == lens, "mended");
    place.run("design task.toml -o other").done();
    let mut task = String::from_utf8(file("task.toml")).expect("text");
    task = task.replace("steps = 12", "steps = 30");
    place.write("longer.toml", task);
    place.run("design longer.toml -o longer").done();
    place.write("run/filters.npz", file("longer/filters.npz"));
    assert!(file("run/filters.npz") != filters, "a design of other steps has other filters");
    refused("filters.npz", &NETWORK);
    for file in ["run/lens.toml", "run/filters.npz"] {
        std::fs::remove_file(place.path(file)).expect("removes");
    }
    place.run("design --resume -o run").done();
    assert!(file("run/lens.toml") == lens && file("run/filters.npz") == filters);
    assert!(tensors(&place.path("run/network.safetensors")) == network);
    #[cfg(feature = "deploy")]
    place.run("export run -o kit").done();
    place.run("evaluate run --fields 1 --patch 32 --json").done();
}

/// A training writes its lens once: another in its place is a hand's, and nothing mends it.
#[test]
fn a_training_whose_lens_was_exchanged_does_not_go_on() {
    let place = Workplace::new();
    place.write("task.toml", SMALL_DESIGN.to_owned() + TRAIN);
    place.run("train task.toml -o run").done();
    let own = std::fs::read_to_string(place.path("run/lens.toml")).expect("a lens");
    let thickness = own.lines().find(|l| l.starts_with("thickness_mm")).expect("a thickness");
    place.write("run/lens.toml", own.replacen(thickness, "thickness_mm = 6.25", 1));
    for command in ["train --resume -o run", NETWORK[1], NETWORK[2], LENS[0]] {
        let ran = place.run(command);
        assert_eq!(ran.code, 2, "{command}: {}", ran.err);
        assert!(ran.err.contains("lens.toml") && ran.err.contains("network.safetensors"), "{command}: {}", ran.err);
    }
    place.write("run/lens.toml", own);
    place.run("train --resume -o run").done();
    // A bit of a weight.
    let path = place.path("run/network.safetensors");
    let mut bytes = std::fs::read(&path).expect("a checkpoint");
    let last = bytes.len() - 3;
    bytes[last] ^= 4;
    std::fs::write(&path, bytes).expect("writes");
    for command in ["train --resume -o run", NETWORK[2], LENS[0]] {
        place.run(command).refused(&["network.safetensors", "sha256"]);
    }
}

/// Pairs that are not as they were written are rendered again, and it is told: the network is the same.
#[test]
fn damaged_pairs_are_rendered_again() {
    let place = Workplace::new();
    let train = TRAIN.replace("steps = 8", "steps = 400");
    place.write("task.toml", SMALL_DESIGN.to_owned() + &train);
    place.run("train task.toml -o whole").done();
    let child = place.command("train task.toml -o run").spawn().expect("starts");
    let cache = place.path("run/cache");
    let kept = || {
        let files = std::fs::read_dir(&cache).into_iter().flatten().flatten().map(|e| e.path());
        files.filter(|p| p.extension().is_some_and(|e| e == "f32")).collect::<Vec<_>>()
    };
    let begun = std::time::Instant::now();
    while kept().len() < 4 && begun.elapsed().as_secs() < 120 {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let mut child = child;
    child.kill().expect("kills");
    child.wait().expect("ends");
    let files = kept();
    assert_eq!(files.len(), 4, "killed on its way");
    for (k, file) in files.iter().enumerate() {
        let mut bytes = std::fs::read(file).expect("reads");
        let (n, at) = (bytes.len(), [0, 20_000, 40_004, 60_000][k]);
        match k {
            0 => bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes()),
            1 => bytes[n - 28..n - 24].copy_from_slice(&f32::NAN.to_le_bytes()),
            2 => bytes[n - 24..n - 8].copy_from_slice(&[1; 16]),
            _ => bytes.truncate(n / 2),
        }
        std::fs::write(file, bytes).expect("writes");
    }
    let said = place.run("train --resume -o run");
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(said.err.contains("4 kept pairs were damaged"), "{}", said.err);
    let network = |run: &str| tensors(&place.path(run).join("network.safetensors"));
    assert!(network("run") == network("whole"), "another network than without damage");
}
