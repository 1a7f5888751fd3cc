//! `isoplanat design` and `isoplanat sweep`: killed and resumed, shipped tasks, starts that are no good.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{SMALL_DESIGN as TASK, Workplace, repetitions, tensors};

/// Killed at random and resumed: lens and network of a design in one go, bit for bit, and the same history.
#[test]
fn a_killed_design_ends_with_the_same_bits() {
    let place = Workplace::new();
    place.write("task.toml", TASK);
    place.run("design task.toml -o whole").done();
    let lens = |run: &str| std::fs::read_to_string(place.path(run).join("lens.toml")).expect("a lens");
    let start = std::fs::read_to_string(place.path("whole").join("lens-first.toml")).expect("a lens");
    assert_ne!(lens("whole"), start, "the lens moved");
    let rng = &mut fastrand::Rng::with_seed(5);
    let mut kills = 0;
    let most = repetitions(2, 12);
    for k in (0..most).rev() {
        let arguments: &[&str] = if place.path("killed/task.toml").is_file() { &["--resume"] } else { &["task.toml"] };
        let mut child = Command::new(env!("CARGO_BIN_EXE_isoplanat"))
            .arg("design")
            .args(arguments)
            .args(["-o", "killed"])
            .current_dir(place.path("."))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("starts");
        let checkpoint = place.path("killed/network.safetensors");
        let written = || std::fs::metadata(&checkpoint).and_then(|m| m.modified()).ok();
        let (before, end) = (written(), Instant::now() + Duration::from_secs(60));
        // Most lives see a checkpoint first.
        while k % 4 != 0 && written() == before && Instant::now() < end && child.try_wait().expect("waits").is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        std::thread::sleep(Duration::from_millis(rng.u64(0..150)));
        if child.try_wait().expect("waits").is_some() {
            break;
        }
        child.kill().expect("killed");
        child.wait().expect("reaped");
        kills += 1;
    }
    assert!(kills >= most.min(4), "only {kills} kills met a design under way");
    place.run("design --resume -o killed").done();
    assert_eq!(lens("killed"), lens("whole"));
    let network = |run: &str| tensors(&place.path(run).join("network.safetensors"));
    assert_eq!(network("killed"), network("whole"));
    let steps = |run: &str, file: &str| -> Vec<String> {
        let text = std::fs::read_to_string(place.path(run).join(file)).expect("written");
        text.lines()
            .map(|l| l.split("\"seconds\"").next().unwrap_or("").split(',').next().unwrap_or("").to_owned())
            .collect()
    };
    for file in ["log.csv", "history.jsonl"] {
        assert_eq!(steps("killed", file), steps("whole", file), "{file}");
    }
    let history = |run: &str| -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(place.path(run).join("history.jsonl")).expect("written");
        text.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect()
    };
    for (k, (a, b)) in history("killed").iter().zip(history("whole")).enumerate() {
        assert_eq!((&a["certainty"], &a["held_out_db"]), (&b["certainty"], &b["held_out_db"]), "judgement {k}");
        assert!(a["certainty"]["surface[0].conic"].is_f64(), "judgement {k}: {a}");
    }
    let page = std::fs::read_to_string(place.path("killed/report.html")).expect("a page");
    assert!(page.contains("Finished.") && page.matches("data-k=").count() == 3);
    // Nothing is left to do; another process may not work in the folder at the same time, and other commands read it.
    place.run("design --resume -o killed").done();
    place.run("evaluate killed --fields 2 --patch 32").done();
    place.run("design task.toml -o killed").refused(&["killed", "--force"]);
}

/// A design in stages: each from the lens of the one before, killed in every stage and resumed to the same bits; what a stage may not say is refused by its name.
#[test]
fn stages_follow_each_other_through_kills() {
    let place = Workplace::new();
    let staged = format!(
        "{}depths_mm = [800.0, 1000.0]\nfocus_all = true\nwarm_start = false\ndepth_power = 4.0\n[[stages]]\nsteps = 40\ndepth_power = 1.0\n[[stages]]\nsteps = 30\nlens_rate_um = 1.0\ninputs = [\"field\"]\n",
        TASK.replace("steps = 90", "steps = 50")
    );
    place.write("task.toml", staged.clone());
    let told = place.run("design task.toml -o whole --json");
    assert_eq!(told.code, 0, "{told:?}");
    assert_eq!(told.out.lines().count(), 1, "JSON is of the result alone: {}", told.out);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&told.out).expect("JSON")["steps"], 50);
    for k in 1..=3 {
        assert!(told.err.contains(&format!("stage {k} of 3")), "{}", told.err);
    }
    let read = |path: &str| std::fs::read_to_string(place.path(path)).unwrap_or_else(|e| panic!("{path}: {e}"));
    // Each begins with what the one before found; the first with the sensor moved, and every one moves the lens.
    let last = |lens: &isoplanat::lens::Lens| lens.surfaces.last().expect("surfaces").thickness;
    let placed = isoplanat::lens::prescription::load(&place.path("whole/stages/1/lens-start.toml")).expect("a lens");
    let shipped = isoplanat::lens::builtin::lens("two_element").expect("shipped");
    assert!((last(&placed) - last(&shipped)).abs() > 1e-3, "{} mm", last(&placed));
    let surfaces = |path: &str| read(path)[read(path).find("[[surface]]").expect("surfaces")..].to_owned();
    for (before, after) in [("whole/stages/1", "whole/stages/2"), ("whole/stages/2", "whole")] {
        assert_eq!(surfaces(&format!("{before}/lens.toml")), surfaces(&format!("{after}/lens-first.toml")));
        assert_ne!(surfaces(&format!("{after}/lens-first.toml")), surfaces(&format!("{after}/lens.toml")));
        // What is held counts from the first one's lens.
        assert_eq!(read(&format!("{after}/lens-start.toml")), read("whole/stages/1/lens-start.toml"));
    }
    // Killed in every stage, and once more at random, each time soon after its first checkpoint.
    let rng = &mut fastrand::Rng::with_seed(8);
    for checkpoint in ["stages/1", "stages/2", "stages/2", "."] {
        let arguments: &[&str] = if place.path("killed/task.toml").is_file() { &["--resume"] } else { &["task.toml"] };
        let mut command = Command::new(env!("CARGO_BIN_EXE_isoplanat"));
        command.arg("design").args(arguments).args(["-o", "killed"]).current_dir(place.path("."));
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
        let checkpoint = place.path("killed").join(checkpoint).join("network.safetensors");
        let end = Instant::now() + Duration::from_secs(120);
        while !checkpoint.exists() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(rng.u64(0..40)));
        assert!(child.try_wait().expect("waits").is_none(), "the design was still at work: {}", checkpoint.display());
        child.kill().expect("killed");
        child.wait().expect("reaped");
    }
    place.run("design --resume -o killed").done();
    let network = |run: &str| tensors(&place.path(run).join("network.safetensors"));
    for part in ["stages/1", "stages/2", "."] {
        assert_eq!(network(&format!("killed/{part}")), network(&format!("whole/{part}")), "{part}");
    }
    // Other commands take the folder as any design's; a fresh design in its place has no stages of the old one.
    place.run("evaluate whole --fields 2 --patch 32").done();
    place.write("plain.toml", TASK.replace("steps = 90", "steps = 3"));
    place.run("design plain.toml -o whole --force").done();
    assert!(!place.path("whole/stages").exists());
    place.run("sweep task.toml --index 1 --of 2 -o runs").done();
    assert!(place.path("runs/00001/stages/2/lens.toml").is_file() && place.path("runs/00001/lens.toml").is_file());
    let looked = place.run("design task.toml --check --json --steps 7").done();
    let looked: serde_json::Value = serde_json::from_str(&looked).expect("JSON");
    assert_eq!(looked["stages"].as_array().map(Vec::len), Some(3));
    for (was, is, said) in [
        ("lens_rate_um = 1.0", "lens = \"heliar\"", "stages[1]"),
        ("lens_rate_um = 1.0", "lens_rate_um = -1.0", "stages[1].lens_rate_um"),
        ("lens_rate_um = 1.0", "minutes = 3.0", "stages[1].steps, minutes"),
        ("steps = 40", "steps = \"many\"", "stages[0]"),
        ("warm_start = false\n", "warm_start = false\nworst_of = 3\n", "worst_of"),
        ("warm_start = false\n", "warm_start = false\nfreeze_lens = true\n", "freeze_lens"),
        ("lens_rate_um = 1.0", "optics = { vary = [\"surface[9].conic\"] }", "surface[9].conic"),
        ("checks = 3", "checks = 5000", "bad.toml: checks"),
    ] {
        let bad = staged.replacen(was, is, 1);
        assert_ne!(bad, staged);
        place.write("bad.toml", bad);
        place.run("design bad.toml -o none").refused(&["bad.toml", said]);
    }
    assert!(!place.path("none").exists());
}

/// A disk that is full in the middle of a design ends it with the file's name; the last checkpoint stands, and the design goes on from it to
/// the same bits.
#[test]
fn a_full_disk_loses_no_checkpoint() {
    let place = Workplace::new();
    place.write("task.toml", TASK.replace("checks = 3", "checks = 12"));
    place.run("design task.toml -o whole").done();
    let size = |file: &str| std::fs::metadata(place.path("whole").join(file)).expect("written").len();
    // The page grows with every judgement.
    let (page, network) = (size("report.html"), size("network.safetensors"));
    assert!(page > network + 8192, "{page} {network}");
    let ended = place.run_with_small_files("design task.toml -o full", (page - 4096) / 512);
    assert!(ended.code > 0 && ended.err.contains("report.html"), "{ended:?}");
    let reached = std::fs::read_to_string(place.path("full/history.jsonl")).expect("a history").lines().count();
    assert!((1..12).contains(&reached), "{reached} judgements");
    place.run("design --resume -o full").done();
    let network = |run: &str| tensors(&place.path(run).join("network.safetensors"));
    assert_eq!(network("full"), network("whole"));
    // Full from the start: no folder.
    let ended = place.run_with_small_files("design task.toml -o none", 2);
    assert!(ended.code > 0 && !ended.err.contains("panicked"), "{ended:?}");
    assert_eq!(place.files(), ["full", "task.toml", "whole"]);
}

/// A folder is one design's: while that runs, or one of its stages, nobody goes on in it or writes over it.
#[test]
fn two_designs_do_not_share_a_folder() {
    let place = Workplace::new();
    place.write("short.toml", TASK);
    for (stages, checkpoint) in
        [("", "run/network.safetensors"), ("[[stages]]\ndepth_power = 1.0\n", "run/stages/1/network.safetensors")]
    {
        place.write("task.toml", TASK.replace("steps = 90", "steps = 100000") + stages);
        let mut command = place.command("design task.toml -o run --force");
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
        let end = Instant::now() + Duration::from_secs(60);
        while !place.path(checkpoint).exists() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(5));
        }
        let second = [place.run("design --resume -o run"), place.run("design short.toml -o run --force --steps 3")];
        let alive = child.try_wait().expect("waits").is_none();
        child.kill().expect("killed");
        child.wait().expect("reaped");
        assert!(alive, "the first one was still at work");
        for ran in second {
            ran.refused(&["run", "another process"]);
        }
        // It ended; now there is nobody.
        place.run("design short.toml -o run --force --steps 3").done();
        assert!(!place.path("run/stages").exists());
    }
}

/// A design says beforehand what it would do, and writes nothing.
#[test]
fn a_task_is_checked_before_it_runs() {
    let place = Workplace::new();
    place.write("task.toml", TASK);
    let said = place.run("design task.toml --check").done();
    for part in ["surface[0].conic", "focal_length", "a step takes", "nothing was written"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let json: serde_json::Value =
        serde_json::from_str(&place.run("design task.toml --check --json").done()).expect("JSON");
    assert!(json["seconds_a_step"].as_f64().is_some_and(|s| s > 0.0));
    assert_eq!(place.files(), ["task.toml"]);
    for (more, said) in [
        ("optics = { vary = [\"surface[9].conic\"] }", "surface[9].conic"),
        ("optics = { constraints = { lenth = 3.0 } }", "lenth"),
        ("lens_share = [0.5, 0.5]", "lens_share"),
        ("lens_rate_um = 0.0", "lens_rate_um"),
        ("asphere_power = 5", "asphere_power"),
        ("lens_steps = \"leaps\"", "rays"),
        ("keep_first = 3", "keep_first"),
        ("least_illumination = 1.5", "least_illumination"),
        ("[sweep]\nradii = 2.0", "sweep.radii"),
    ] {
        place.write("bad.toml", format!("{TASK}{more}\n"));
        place.run("design bad.toml -o none").refused(&["bad.toml", said]);
    }
    place.run("design lfov-31 -o none").refused(&["lfov-31", "lfov-30"]);
    assert_eq!(place.files(), ["bad.toml", "task.toml"]);
}

/// Pictures through lenses as they may be built: the task of the run holds the tolerances itself, it goes on from where it was left to the same bits, and
/// tolerances that are none are refused.
#[test]
fn a_design_across_lenses_as_built() {
    let place = Workplace::new();
    let task = TASK.replace("steps = 90", "steps = 12");
    place.write("task.toml", &task);
    place.write(
        "t.toml",
        "schema = 1\n[surface.all]\nradius_percent = 0.5\ncentring_arcmin = 3.0\n[assembly]\nair_mm = 0.05\n",
    );
    let said = place.run("design task.toml --tolerance-aware t.toml -o run").done();
    assert!(said.contains("lenses as built") && said.contains(" 0 showed nothing"), "{said}");
    place.run("design task.toml -o plain").done();
    let lens = |run: &str| std::fs::read_to_string(place.path(run).join("lens.toml")).expect("a lens");
    assert_ne!(lens("run"), lens("plain"));
    // A network is trained on for a lens by the run's own pictures, or not at all.
    place.run("tolerance run/lens.toml --tolerances t.toml --draws 2 --lenses drawn").done();
    place.write("plain/scenes.sha256", "0".repeat(64));
    let ran = place.run("evaluate plain --drawn drawn --retrain 2 --reference 4 --patch 32 --fields 1");
    assert!(ran.code == 2 && ran.err.contains("scenes.sha256"), "{ran:?}");
    std::fs::remove_file(place.path("t.toml")).expect("there");
    let kept = std::fs::read_to_string(place.path("run/task.toml")).expect("a task");
    assert!(kept.contains("radius_percent = 0.5"), "{kept}");
    place.write("again.toml", &kept);
    place.run("design again.toml -o again").done();
    assert_eq!(lens("again"), lens("run"));
    place.run("design --resume -o run").done();
    place.run("design task.toml --tolerance-aware t.toml -o none").refused(&["t.toml"]);
    place.write("t.toml", "schema = 1\n[assembly]\ndecentre_mm = 0.05\n");
    place
        .run("design task.toml --tolerance-aware t.toml -o none")
        .refused(&["t.toml: tolerances: tilts and shifts alone"]);
    for (text, said) in [
        ("tolerances = \"none.toml\"\n", "none.toml"),
        (
            "[tolerances]\nschema = 1\n[tolerances.surface.all]\nradius = 0.5\n",
            "bad.toml: tolerances: unknown key `radius`",
        ),
        (
            "[tolerances]\nschema = 1\n[tolerances.surface.all]\nradius_percent = -1\n",
            "bad.toml: tolerances.surface.all.radius_percent: -1",
        ),
        ("[tolerances]\nschema = 1\n[tolerances.surface.9]\nradius_percent = 0.5\n", "bad.toml: surface.9"),
        ("tolerances = 3\n", "tolerances"),
    ] {
        place.write("bad.toml", format!("{task}{text}"));
        place.run("design bad.toml -o none").refused(&[said]);
    }
    assert!(!place.path("none").exists());
}

/// Starts that are no good, and rates far too large: a run folder with a lens that stands, or the reason and no folder.
#[test]
fn bad_starts_and_wild_rates_end_with_a_lens_or_a_reason() {
    let place = Workplace::new();
    let run = |name: &str, more: &str| {
        place.write("task.toml", TASK.replace("steps = 90", "steps = 24").replace("lens = \"two_element\"", more));
        place.run(&format!("design task.toml -o {name}"))
    };
    for seed in 1..=repetitions(1, 3) {
        for (steps, rate) in
            [("rays", "lens_rate_um = 200.0"), ("scaled", "lens_rate = 0.9"), ("plain", "lens_rate = 0.9")]
        {
            let name = format!("wild-{steps}-{seed}");
            let more = format!("lens = \"two_element\"\nseed = {seed}\nlens_steps = \"{steps}\"\n{rate}");
            run(&name, &more).done();
            place.run(&format!("inspect {name}/lens.toml")).done();
        }
    }
    // Out of focus by far: found again by spots, and without those, designed from where it stands.
    let start = place.run("convert two_element far.toml");
    start.done();
    let text = std::fs::read_to_string(place.path("far.toml")).expect("written");
    let far = text.replace("29.929", "36.0");
    assert_ne!(far, text);
    place.write("far.toml", far);
    run("far", "lens = \"far.toml\"").done();
    run("far-cold", "lens = \"far.toml\"\nwarm_start = false").done();
    // No steps at all: the lens by spots, a network as it was made.
    place.write("none.toml", TASK.replace("steps = 90", "steps = 0"));
    place.run("design none.toml -o none").done();
    // A lens that vignettes all of its field.
    place.write("dark.toml", text.replace("semi_diameter_mm = 14.8", "semi_diameter_mm = 0.02"));
    let dark = run("dark", "lens = \"dark.toml\"");
    assert!(dark.code == 0 || dark.code == 2 && !place.path("dark").exists(), "{dark:?}");
}

/// Two designs by number, one of them resumed, and their table.
#[test]
fn a_sweep_is_designs_by_number() {
    let place = Workplace::new();
    place.write("task.toml", format!("{}[sweep]\nradii = 0.03\n", TASK.replace("steps = 90", "steps = 12")));
    place.run("sweep task.toml --index 0 --of 2 -o runs").done();
    place.run("sweep task.toml --index 1 --of 2 -o runs").done();
    place.run("sweep task.toml --index 1 --of 2 -o runs --resume").done();
    place.run("sweep task.toml --index 2 --of 2 -o runs").refused(&["--index", "0 to 1"]);
    let start = |k: &str| std::fs::read_to_string(place.path("runs").join(k).join("lens-start.toml")).expect("a lens");
    assert_ne!(start("00000"), start("00001"));
    let table = place.run("sweep report runs -o page.html").done();
    assert!(table.contains("00000") && table.contains("00001"), "{table}");
    let page = std::fs::read_to_string(place.path("page.html")).expect("a page");
    assert!(page.contains("run 00001"));
    place.run("sweep report runs -o again.html --json").done();
    assert_eq!(std::fs::read_to_string(place.path("again.html")).expect("a page"), page);
    place.run("sweep report nothing").refused(&["nothing"]);
}
