//! Networks that are told of their lens beside ones that see the capture alone, by length of training: the table of `benches/results/guided.md`.
//!
//! `cargo bench --bench guided -- train FILE.csv LENS.toml NETWORKS STEPS SEEDS` trains a network of every kind, length and seed on built-in scenes, judges it on whole
//! frames of scenes that it never met, and adds a line a frame to the file; `-- try …` judges every third frame only; `-- table FILE.csv` prints what such a file says. `NETWORKS`: any of `bare`, `filtered`
//! and `blend`, with commas between, `+levels` behind a name for filters of three noise levels, `+field` for the place in the field; `STEPS`, `SEEDS`: numbers.

mod frames;
mod tables;

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use isoplanat::design::subject::Subject;
use isoplanat::design::task::Task;
use isoplanat::design::training::Training;
use isoplanat::imaging::guide::Inputs;
use isoplanat::interchange;
use isoplanat::lens::catalogue::Glasses;
use isoplanat::network::{Base, Reconstructor, UnetConfig};

use frames::{Frames, Told};

/// One network of the comparison.
struct Kind<'a> {
    name: &'a str,
    inputs: Inputs,
    base: Base,
}

impl<'a> Kind<'a> {
    fn of(name: &'a str) -> Self {
        let mut words = name.split('+');
        let base = words.next().unwrap_or_default();
        let told = words.fold(Inputs { wiener: true, ..Inputs::BARE }, |inputs, word| match word {
            "levels" => Inputs { levels: true, ..inputs },
            "field" => Inputs { field: true, ..inputs },
            other => panic!("{other}: levels or field"),
        });
        let (inputs, base) = match base {
            "bare" => (Inputs::BARE, Base::default()),
            "filtered" => (told, Base::Filtered),
            "blend" => (told, Base::Blend),
            other => panic!("{other}: bare, filtered or blend"),
        };
        Self { name, inputs, base }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [how @ ("train" | "try"), file, lens, networks, steps, seeds] => {
            let numbers = |text: &str| text.split(',').map(|n| n.parse::<u64>().expect("a number")).collect::<Vec<_>>();
            let kinds: Vec<Kind<'_>> = networks.split(',').map(Kind::of).collect();
            let every = if how == "try" { 3 } else { 1 };
            train(Path::new(file), Path::new(lens), &kinds, [&numbers(steps), &numbers(seeds)], every);
        }
        ["table", file] => tables::print(Path::new(file)),
        _ => println!(
            "train FILE.csv LENS.toml NETWORKS STEPS SEEDS, or table FILE.csv: see the first lines of this bench"
        ),
    }
}

fn train(file: &Path, lens: &Path, kinds: &[Kind<'_>], [steps, seeds]: [&[u64]; 2], every: usize) {
    let lens = interchange::load(lens, Glasses::shipped()).expect("a lens").lens;
    let subject = Subject::from(lens);
    let mut base = Task::demo();
    base.frame.raster = None;
    let frames = Frames::of(&subject, &base.sensor().expect("generic"), every);
    let mut out = OpenOptions::new().create(true).append(true).open(file).expect("writable");
    for &seed in seeds {
        for &steps in steps {
            for kind in kinds {
                let mut task = base.clone();
                task.seed = seed;
                let train = &mut task.train;
                (train.network.inputs, train.network.base, train.budget.steps) = (kind.inputs, kind.base, Some(steps));
                (train.budget.constant_epochs, train.budget.decay_epochs) = (1.0, 2.0);
                (train.network.scales, train.pairs.count, train.pairs.region_px, train.pairs.patch_px) =
                    (3, 160, 256, 192);
                (train.budget.rate, train.loss.content, train.pairs.noise, train.pairs.haze) =
                    (2e-3, "l1".into(), [1.0, 1.0], 0.0);
                (train.budget.sample_steps, train.budget.checkpoint_seconds) = (0, 3600.0);
                let config =
                    UnetConfig { base: kind.base, inputs: kind.inputs, ..UnetConfig::bare(task.network.base_width, 3) };
                let network = Reconstructor::new(config, seed).expect("valid");
                let place = tempfile::tempdir().expect("a temporary folder");
                let textures = task.textures().expect("built in");
                let run = place.path().join("run");
                let mut training = Training::begin(task, &subject, network, textures, &run, false).expect("a task");
                let (clock, before) = (Instant::now(), processor_seconds());
                training.run(&mut |_| true).expect("trains");
                let (wall, busy) = (clock.elapsed().as_secs_f64(), processor_seconds() - before);
                let told = Told { network: training.network(), guide: training.guide().clone() };
                eprintln!("{} {steps} steps, seed {seed}: {wall:.1} s, {busy:.1} s of processors", kind.name);
                for line in frames.judged(&told) {
                    writeln!(out, "{},{steps},{seed},{busy:.2},{line}", kind.name).expect("written");
                }
                out.flush().expect("written");
            }
        }
    }
}

/// Processor time of this process so far, s.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").expect("Linux");
    let fields: Vec<&str> = stat.rsplit(')').next().expect("fields").split_whitespace().collect();
    let ticks: f64 = fields[11..13].iter().map(|t| t.parse::<f64>().expect("ticks")).sum();
    ticks / 100.0
}
