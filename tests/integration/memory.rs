//! What commands say they take of memory against what they take, and refusals of what does not fit.

use crate::support::Workplace;

#[test]
fn work_that_does_not_fit_is_refused_at_once() {
    let place = Workplace::new();
    let clock = std::time::Instant::now();
    for (command, words) in [
        ("render cooke_triplet text -o x.png --columns 200000 --rows 200000", ["columns", "200000", "65536"]),
        ("render cooke_triplet text -o x.png --columns 65536 --rows 65536", ["memory", "GiB needed", "--crop"]),
        (
            "render cooke_triplet text -o x.png --columns 65536 --rows 65536 --method monte-carlo",
            ["memory", "GiB", "--crop"],
        ),
        (
            "capture cooke_triplet text -o x.dng --columns 60000 --rows 60000 --memory-gib 2",
            ["memory", "2.0 GiB", "--crop"],
        ),
        ("accuracy cooke_triplet text --columns 60000 --rows 60000 --memory-gib 1", ["memory", "1.0 GiB", "--crop"]),
        (
            "psf cooke_triplet -o x.npz --size 2047 --fields 512 --memory-gib 8",
            ["512 kernels of 2047 × 2047", "8.0 GiB", "--size"],
        ),
        (
            "render cooke_triplet text -o x.png --columns 64 --rows 48 --memory-gib 0.001",
            ["memory", "1 MiB", "--memory-gib"],
        ),
        ("render cooke_triplet text -o x.png --memory-gib 0", ["--memory-gib", "0", "positive"]),
        ("inspect cooke_triplet --memory-gib nan", ["--memory-gib", "NaN", "positive"]),
    ] {
        place.run(command).refused(&words);
    }
    assert_eq!(place.files(), [""; 0], "nothing is written");
    let seconds = clock.elapsed().as_secs_f64();
    assert!(seconds < 30.0, "{seconds} s for nine refusals");
}

#[cfg(target_os = "linux")]
mod measured {
    use std::io::Read;
    use std::process::{Child, Stdio};

    use super::Workplace;

    /// The high-water mark of a process's resident memory, bytes, while it runs.
    fn peak(child: &Child) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
        let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
    }

    /// Runs a command: what it tells on the way, and its largest resident memory.
    #[cfg(all(feature = "train", feature = "deploy"))]
    fn run_telling(place: &Workplace, arguments: &str) -> (String, u64) {
        let told = place.path("told.txt");
        let file = std::fs::File::create(&told).expect("written");
        let child = place.command(arguments).stdout(Stdio::piped()).stderr(file).spawn().expect("starts");
        let (_, most) = watch(child, arguments);
        (std::fs::read_to_string(told).expect("UTF-8"), most)
    }

    /// Runs a command: its output, and its largest resident memory.
    fn run(place: &Workplace, arguments: &str) -> (String, u64) {
        let child = place.command(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("starts");
        watch(child, arguments)
    }

    fn watch(mut child: Child, arguments: &str) -> (String, u64) {
        let mut most = 0;
        let status = loop {
            most = most.max(peak(&child).unwrap_or(0));
            if let Some(status) = child.try_wait().expect("waits") {
                break status;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        };
        let mut text = String::new();
        child.stdout.take().expect("piped").read_to_string(&mut text).expect("UTF-8");
        assert!(status.success(), "{arguments}: {text}");
        (text, most)
    }

    /// The estimate holds for the whole process, and is no more than three times what it took.
    fn judge(what: &str, estimate: u64, peak: u64) {
        let mib = |b: u64| b as f64 / f64::from(1 << 20);
        eprintln!("{what}: {:.1} MiB taken, {:.1} MiB estimated", mib(peak), mib(estimate));
        assert!(peak <= estimate && estimate <= 3 * peak, "{what}: {peak} taken, {estimate} estimated");
    }

    /// What a command says that it takes at most, bytes.
    fn stated(text: &str) -> u64 {
        let from = text.find("memory: at most ").expect("stated") + "memory: at most ".len();
        let mut words = text[from..].split_whitespace();
        let number: f64 = words.next().expect("a number").parse().expect("a number");
        let unit = if words.next() == Some("GiB") { 1024.0 } else { 1.0 };
        (number * unit * f64::from(1 << 20)) as u64
    }

    #[test]
    fn estimates_of_pictures_and_kernels_hold() {
        let place = Workplace::new();
        for (what, arguments) in [
            ("small", "cooke_triplet facades:3 --columns 128 --rows 96 --pitch-um 40"),
            ("wide kernels", "two_element facades:3 --min-psnr-db 45"),
            ("a micrometre, 120 mm", "double_gauss facades:3 --columns 100 --rows 100 --pitch-um 1 --depth-mm 120"),
        ] {
            let (text, peak) = run(&place, &format!("render {arguments} -o x.png --force --json"));
            let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            judge(what, json["figures"]["memory_bytes"].as_u64().expect("a number"), peak);
        }
        let (text, peak) = run(&place, "psf three_element -o k.npz --fields 9 --size 301");
        judge("kernels", stated(&text), peak);
    }

    #[cfg(all(feature = "train", feature = "deploy"))]
    const SMALL: &str = "schema = 1\nlens = \"two_element\"\nscenes = 1\nsteps = 2\npatch_px = 64\nbatch = 1\nbase_width = 16\n\
                         sensor = { columns = 96, rows = 64, pitch_um = 60.0, axis_px = [0.0, 0.0] }\n";
    #[cfg(all(feature = "train", feature = "deploy"))]
    const WIDE: &str = "[train]\nscales = 3\nbase_width = 32\npatch_px = 256\nregion_px = 320\nsteps = 3\npairs = 2\nsample_steps = 0\n";

    /// The small task with a sensor of 512 × 384.
    #[cfg(all(feature = "train", feature = "deploy"))]
    fn large() -> String {
        SMALL.replace("columns = 96, rows = 64, pitch_um = 60.0", "columns = 512, rows = 384, pitch_um = 20.0")
    }

    #[cfg(all(feature = "train", feature = "deploy"))]
    fn judge_training(place: &Workplace, what: &str, train: &str) {
        place.write("train.toml", format!("{}{train}", large()));
        let (text, peak) = run_telling(place, "train train.toml -o trained --force");
        judge(what, stated(&text), peak);
    }

    #[cfg(all(feature = "train", feature = "deploy"))]
    #[test]
    fn estimates_of_designs_and_trainings_hold() {
        let place = Workplace::new();
        place.write("task.toml", SMALL);
        let (text, peak) = run_telling(&place, "design task.toml -o run");
        judge("design", stated(&text), peak);
        let gan = "[train]\nscales = 3\nbase_width = 16\npatch_px = 128\nregion_px = 192\nsteps = 3\npairs = 2\nsample_steps = 0\nadversarial = true\n";
        judge_training(&place, "discriminators", gan);
        for (what, arguments) in [("evaluation", ""), ("sheets", "--patch 128 --fields 3 --pictures sheets")] {
            let (text, peak) = run_telling(&place, &format!("evaluate trained {arguments}"));
            judge(what, stated(&text), peak);
        }
        for (what, arguments) in [("export", "-o kit"), ("export of halves", "-o half --f16")] {
            let (text, peak) = run(&place, &format!("export run {arguments}"));
            judge(what, stated(&text), peak);
        }
    }

    #[cfg(all(feature = "train", feature = "deploy"))]
    #[test]
    #[ignore = "two minutes: by .ci/slow measurements"]
    fn estimates_of_large_networks_hold() {
        let place = Workplace::new();
        place.write("task.toml", large().replace("patch_px = 64\nbatch = 1", "patch_px = 256\nbatch = 4"));
        let (text, peak) = run_telling(&place, "design task.toml -o run");
        judge("design of large patches", stated(&text), peak);
        let of = |blocks: &str| WIDE.replace("[train]\n", &format!("[train]\nblocks = \"{blocks}\"\n"));
        let seven =
            "[train]\nbase_width = 16\npatch_px = 256\nregion_px = 256\nsteps = 3\npairs = 2\nsample_steps = 0\n";
        for (what, train) in [
            ("separable blocks", of("separable").as_str()),
            ("gated blocks", &of("gated")),
            ("training", WIDE),
            ("seven scales", seven),
        ] {
            judge_training(&place, what, train);
        }
        let (text, peak) = run_telling(&place, "demo --quick");
        judge("demo", stated(&text), peak);
    }
}
