//! What a file of judgements says: gains over the bare network and over the capture, by smoothness.

use std::collections::BTreeMap;
use std::path::Path;

/// What is told of a network on a frame.
#[derive(Clone, Copy)]
struct Judged {
    detail: f64,
    capture: [f64; 2],
    output: [f64; 2],
}

/// Of a network and a seed, by frame; and its processor seconds.
type Run = (f64, BTreeMap<String, Judged>);

/// By steps, kind and seed.
type Runs = BTreeMap<(u64, String, u64), Run>;

/// Prints the table.
pub(crate) fn print(file: &Path) {
    let runs = read(file);
    let groups = groups(&runs);
    let names: Vec<&str> = groups.iter().map(|(name, _)| name.as_str()).collect();
    println!(
        "| steps | network | seeds | processor s | {} | worst third − bare, a seed | worst third − capture, a seed | photographs − bare |",
        names.join(" | ")
    );
    println!("|---|---|---|---|{}---|---|---|", "---|".repeat(groups.len()));
    let mut rows: Vec<(u64, String)> = runs.keys().map(|(steps, kind, _)| (*steps, kind.clone())).collect();
    rows.dedup();
    for (steps, kind) in rows {
        let of_kind: Vec<(u64, &Run)> = runs
            .iter()
            .filter(|((s, k, _), _)| (*s, k) == (steps, &kind))
            .map(|((_, _, seed), run)| (*seed, run))
            .collect();
        let count = of_kind.len() as f64;
        let mean = |of: &dyn Fn(&Run) -> f64| of_kind.iter().map(|(_, run)| of(run)).sum::<f64>() / count;
        let cells = groups.iter().map(|(_, frames)| {
            let [psnr, ssim] = [0, 1].map(|k| mean(&|run| over(run, frames, |j| j.output[k])));
            let capture = mean(&|run| over(run, frames, |j| j.capture[0]));
            format!("{psnr:.2} ({:+.2}), {ssim:.3}", psnr - capture)
        });
        let cells: Vec<String> = cells.collect();
        let bare = |seed: u64| runs.get(&(steps, "bare".to_owned(), seed));
        let thirds = || groups.iter().filter(|(name, _)| name.contains("third"));
        let worst = |against: &dyn Fn(u64, &[String]) -> Option<f64>| {
            let all = of_kind.iter().flat_map(|(seed, run)| {
                thirds().filter_map(|(_, frames)| Some(over(run, frames, |j| j.output[0]) - against(*seed, frames)?))
            });
            all.fold(f64::INFINITY, f64::min)
        };
        let to_bare = worst(&|seed, frames| Some(over(bare(seed)?, frames, |j| j.output[0])));
        let to_capture = worst(&|seed, frames| {
            let run = of_kind.iter().find(|(s, _)| *s == seed)?.1;
            Some(over(run, frames, |j| j.capture[0]))
        });
        let photos: Vec<String> = thirds().flat_map(|(_, frames)| frames.clone()).collect();
        let ahead: Vec<f64> = of_kind
            .iter()
            .filter_map(|(seed, run)| {
                Some(over(run, &photos, |j| j.output[0]) - over(bare(*seed)?, &photos, |j| j.output[0]))
            })
            .collect();
        // Without a bare network of that length there is nothing to be held against.
        let worst = |v: f64| if v.is_finite() { format!("{v:+.2}") } else { "–".into() };
        let told: Vec<String> = ahead.iter().map(|v| format!("{v:+.2}")).collect();
        println!(
            "| {steps} | {kind} | {} | {:.0} | {} | {} | {} | {} |",
            of_kind.len(),
            mean(&|run| run.0),
            cells.join(" | "),
            worst(to_bare),
            worst(to_capture),
            told.join(", ")
        );
    }
}

/// Mean of `of` over `frames`.
fn over(run: &Run, frames: &[String], of: impl Fn(&Judged) -> f64) -> f64 {
    frames.iter().map(|name| of(&run.1[name])).sum::<f64>() / frames.len() as f64
}

/// Built-in scenes, and the photographs in thirds, the smoothest first.
fn groups(runs: &Runs) -> Vec<(String, Vec<String>)> {
    let Some((_, frames)) = runs.values().next() else { return Vec::new() };
    let (photos, built): (Vec<_>, Vec<_>) = frames.iter().partition(|(name, _)| name.starts_with("photo"));
    let mut photos: Vec<(f64, String)> = photos.into_iter().map(|(name, j)| (j.detail, name.clone())).collect();
    photos.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut groups = vec![("built-in".to_owned(), built.into_iter().map(|(name, _)| name.clone()).collect())];
    let third = photos.len().div_ceil(3).max(1);
    for (name, part) in ["smooth third", "middle third", "detailed third"].into_iter().zip(photos.chunks(third)) {
        groups.push((name.to_owned(), part.iter().map(|(_, name)| name.clone()).collect()));
    }
    groups
}

fn read(file: &Path) -> Runs {
    let mut runs = Runs::new();
    for line in std::fs::read_to_string(file).expect("a file of judgements").lines() {
        let fields: Vec<&str> = line.split(',').collect();
        let [kind, steps, seed, busy, name, rest @ ..] = fields.as_slice() else { panic!("{line}") };
        let number = |text: &str| text.parse::<f64>().expect("a number");
        let values: Vec<f64> = rest.iter().map(|v| number(v)).collect();
        let [detail, a, b, c, d] = values[..] else { panic!("{line}") };
        let key = (steps.parse().expect("steps"), (*kind).to_owned(), seed.parse().expect("a seed"));
        let run = runs.entry(key).or_insert_with(|| (number(busy), BTreeMap::new()));
        run.1.insert((*name).to_owned(), Judged { detail, capture: [a, b], output: [c, d] });
    }
    runs
}
