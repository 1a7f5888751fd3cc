use super::*;
use crate::design::task::TaskSensor;

/// A task small enough for a test: a coarse sensor behind the two-element lens.
fn task() -> Task {
    let mut task = Task::demo();
    task.frame.raster = Some(TaskSensor { columns: 96, rows: 64, pitch_um: 200.0, axis_px: Some([0.0, 0.0]) });
    task.pictures.scenes = 2;
    let train = &mut task.train;
    (train.network.base_width, train.network.scales, train.pairs.patch_px, train.pairs.region_px) =
        (Some(4), 3, 32, 48);
    (train.pairs.count, train.budget.steps, train.budget.sample_steps, train.budget.rate) = (3, Some(20), 10, 1e-3);
    task
}

fn weights(folder: &Path) -> Vec<Vec<f32>> {
    let network = Reconstructor::load(&folder.join(NETWORK)).expect("reads");
    network.parameters().into_iter().map(|p| p.values).collect()
}

/// Stopped after every few steps and resumed: the same bits as in one go, a whole log, no second trainer in the folder.
#[test]
fn a_training_in_pieces_is_the_training_in_one_go() {
    in_pieces(task);
    // What else a checkpoint must keep: averaged weights.
    in_pieces(|| {
        let mut task = task();
        (task.train.budget.average, task.train.budget.rise_steps) = (0.9, 5);
        task
    });
}

fn in_pieces(task: fn() -> Task) {
    let place = tempfile::tempdir().expect("temporary folder");
    let (whole, pieces) = (place.path().join("whole"), place.path().join("pieces"));
    let mut one = Training::create(task(), &whole, false, Compute::Cpu, Glasses::shipped()).expect("new");
    one.run(&mut |_| true).expect("trains");
    assert!(!whole.join("cache").exists() && whole.join("samples/step-0000010.png").is_file());
    let mut training = Training::create(task(), &pieces, false, Compute::Cpu, Glasses::shipped()).expect("new");
    let second = Training::resume(&pieces, Compute::Cpu).expect_err("locked").to_string();
    assert!(second.contains("another process"), "{second}");
    let replaced =
        Training::create(task(), &pieces, true, Compute::Cpu, Glasses::shipped()).expect_err("locked").to_string();
    assert!(replaced.contains("another process"), "{replaced}");
    fs::write(pieces.join("network.safetensors.1.part"), b"half a checkpoint").expect("written");
    for stop in [1, 3, 9, 10, 17] {
        let ended = training.run(&mut |s| s.step < stop).expect_err("stopped");
        assert!(matches!(ended, Error::Interrupted));
        drop(training);
        training = Training::resume(&pieces, Compute::Cpu).expect("resumes");
        assert_eq!(training.step(), stop);
    }
    training.run(&mut |_| true).expect("trains");
    assert_eq!(weights(&pieces), weights(&whole));
    assert!(!pieces.join("network.safetensors.1.part").exists(), "what a kill has left is swept");
    let log = fs::read_to_string(pieces.join("log.csv")).expect("written");
    assert_eq!(log.lines().skip(1).map(|l| l.split(',').next().unwrap_or("")).collect::<Vec<_>>(), ["10", "20"]);
    // Resumed once more it has nothing left to do.
    drop(training);
    let mut done = Training::resume(&pieces, Compute::Cpu).expect("resumes");
    done.run(&mut |_| panic!("no step is left")).expect("nothing to do");
}

#[test]
fn a_training_starts_from_another_and_refuses_what_it_cannot_do() {
    let place = tempfile::tempdir().expect("temporary folder");
    let (first, second) = (place.path().join("first"), place.path().join("second"));
    let create = |task: Task, folder: &Path| Training::create(task, folder, false, Compute::Cpu, Glasses::shipped());
    create(task(), &first).expect("new").run(&mut |_| true).expect("trains");
    let mut deeper = task();
    (deeper.train.start, deeper.train.network.scales, deeper.train.network.base_width) = (Some(first.clone()), 4, None);
    drop(create(deeper.clone(), &second).expect("deepens"));
    let (a, b) = (weights(&first), weights(&second));
    assert!(b.len() > a.len() && a.iter().all(|w| b.contains(w)), "every weight moved");
    let refused = |change: fn(&mut Task), what: &str| {
        let (mut task, folder) = (deeper.clone(), place.path().join("refused"));
        change(&mut task);
        let text = create(task, &folder).expect_err(what).to_string();
        assert!(text.contains(what) && !folder.exists(), "{text}");
    };
    refused(|t| t.train.network.base_width = Some(6), "starting network");
    refused(|t| t.train.pairs.region_px = 256, "train.pairs.region_px");
    refused(|t| t.train.start = Some("nowhere".into()), "nowhere");
    refused(|t| t.train.loss.vgg = Some("no-weights.safetensors".into()), "no-weights.safetensors");
    assert!(matches!(create(task(), &first).expect_err("there already"), Error::Exists(_)));
}

#[test]
fn a_training_without_finite_gradients_ends_and_keeps_what_it_had() {
    let place = tempfile::tempdir().expect("temporary folder");
    let run = place.path().join("run");
    let mut long = task();
    (long.train.budget.steps, long.train.budget.checkpoint_seconds) = (Some(100), 0.0);
    let mut training = Training::create(long, &run, false, Compute::Cpu, Glasses::shipped()).expect("new");
    let ended = training.run(&mut |s| s.step < 5);
    assert!(matches!(ended, Err(Error::Interrupted)));
    let before = weights(&run);
    training.trainer.poison(f32::NAN);
    let ended = training.run(&mut |_| true);
    // Nothing that is not finite reaches the disk: the first checkpoint is refused, or twenty steps in a row are.
    let text = ended.expect_err("no finite loss").to_string();
    assert!(text.contains("not finite"), "{text}");
    assert_eq!(weights(&run), before);
    drop(training);
    let mut again = Training::resume(&run, Compute::Cpu).expect("resumes");
    assert_eq!(again.step(), 5);
    again.run(&mut |s| s.step < 8).expect_err("stopped");
    // With checkpoints far apart it is the steps that end it, with what to do.
    again.task.train.budget.checkpoint_seconds = 1e4;
    again.trainer.poison(f32::NAN);
    let ended = again.run(&mut |_| true).expect_err("no finite loss");
    assert!(matches!(&ended, Error::Stopped(text) if text.contains("20 times in a row")), "{ended}");
    assert_eq!((ended.exit_code(), again.skipped()), (1, 20));
}

/// Weights that are thrown far away, as by a rate that is too large: back to the last sound checkpoint, half the rate from there on, the log
/// without what was lost; and where that happens again and again, an end with the reason.
#[test]
fn a_training_that_loses_itself_goes_back() {
    let place = tempfile::tempdir().expect("temporary folder");
    let run = place.path().join("run");
    let mut long = task();
    (long.train.budget.steps, long.train.budget.checkpoint_seconds) = (Some(120), 0.0);
    let mut training = Training::create(long, &run, false, Compute::Cpu, Glasses::shipped()).expect("new");
    training.run(&mut |s| s.step < 60).expect_err("stopped");
    let before = weights(&run);
    training.trainer.poison(1e4);
    training.run(&mut |s| s.step < 80).expect_err("stopped");
    assert_eq!((training.returned(), training.step()), (1, 80));
    assert_ne!(weights(&run), before);
    drop(training);
    let mut training = Training::resume(&run, Compute::Cpu).expect("resumes");
    assert_eq!(training.returned(), 1, "kept");
    training.run(&mut |_| true).expect("trains");
    assert_eq!((training.returned(), training.step()), (1, 120));
    let log = fs::read_to_string(run.join("log.csv")).expect("written");
    let rows: Vec<Vec<f64>> =
        log.lines().skip(1).map(|l| l.split(',').map(|v| v.parse().unwrap_or(f64::NAN)).collect()).collect();
    assert_eq!(
        rows.iter().map(|r| r[0]).collect::<Vec<_>>(),
        (1..=12).map(|k| 10.0 * f64::from(k)).collect::<Vec<_>>()
    );
    assert!(rows.iter().all(|r| r[3] < 1.0), "{log}");
    // Rates of the schedule before, and half of them after.
    let schedule = training.task.train.schedule();
    for (row, rate) in [(5, schedule.at(59)), (6, schedule.at(69).map(|r| 0.5 * r))] {
        assert!((rows[row][2] / rate.expect("not over") - 1.0).abs() < 1e-3, "{log}");
    }
    drop(training);
    // Over and over.
    let mut endless = task();
    (endless.train.budget.steps, endless.train.budget.checkpoint_seconds) = (Some(2000), 0.0);
    let mut training =
        Training::create(endless, &place.path().join("endless"), false, Compute::Cpu, Glasses::shipped());
    let training = training.as_mut().expect("new");
    let mut stop = 40;
    let text = loop {
        match training.run(&mut |s| s.step < stop) {
            Err(Error::Interrupted) => training.trainer.poison(1e4),
            other => break other.expect_err("lost").to_string(),
        }
        stop += 40;
    };
    assert!(text.contains("7 times") && text.contains("half the rate"), "{text}");
}
