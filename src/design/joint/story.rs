//! A design's history, from its judgements to the page that people look at.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::run::Stage;
use super::scenery::Entry;
use crate::design::data::Textures;
use crate::design::task::Task;
use crate::report::design::{DesignPage, Moment, Shown, Words};
use crate::report::drawing::lens_svg;
use crate::report::html::Fact;
use crate::report::lens_view::LensView;
use crate::report::table::significant;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::{Lens, prescription};

/// Kernels in a row of the page, and held-out patches it shows.
const FIELDS: usize = 7;
const SHOWN: usize = 4;

/// A final state must be worse than the best one by so much, dB, to give way to it: less is chance.
pub(in crate::design) const WORSE_DB: f64 = 0.1;

/// A judgement, as `history.jsonl` holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Judgement {
    /// Steps done.
    pub step: usize,
    /// Seconds so far.
    pub seconds: f64,
    /// The lens, a file in the run's folder.
    pub lens: String,
    /// PSNR before and after the network on pictures that are not trained on, dB; without a network, of sensor images, mean and lowest of the
    /// distances.
    pub held_out_db: [f64; 2],
    /// Their loss: L1, or without a network eq. 16.
    pub held_out_l1: f64,
    /// What states are ranked by, dB: PSNR behind the network, or of a lens judged by its images −20 log₁₀ of their loss.
    #[serde(default)]
    pub score_db: Option<f64>,
    /// Whether it was the best so far.
    pub best: bool,
    /// What held the lens back.
    pub active: Vec<String>,
    /// Every number that moves, by name.
    pub variables: BTreeMap<String, f64>,
    /// Mean of its gradient since the judgement before, in its own standard errors; empty where the lens was held.
    #[serde(default)]
    pub certainty: BTreeMap<String, f64>,
}

impl Judgement {
    /// What it is ranked by, dB.
    pub fn score(&self) -> f64 {
        self.score_db.unwrap_or(self.held_out_db[1])
    }

    /// The one that the result of a finished design is of: the last, or the best where the last is worse by more than chance. None without judgements.
    fn of_result(history: &[Self]) -> Option<&Self> {
        let (last, best) = (history.last()?, history.iter().rfind(|j| j.best));
        best.filter(|best| last.score().is_nan() || last.score() < best.score() - WORSE_DB).or(Some(last))
    }

    /// The judgements of a run's folder; none where there is no history yet.
    ///
    /// # Errors
    /// A history that cannot be read.
    pub fn read(folder: &Path) -> Result<Vec<Self>> {
        let path = folder.join("history.jsonl");
        let text = if path.exists() { atomic::read_text(&path, crate::design::log::LARGEST)? } else { String::new() };
        Self::of(&text, &path.display().to_string())
    }

    /// Those of a text; `file` names it.
    pub(in crate::design) fn of(text: &str, file: &str) -> Result<Vec<Self>> {
        let one = |(k, line): (usize, &str)| {
            serde_json::from_str(line).map_err(|e| {
                Error::bad(
                    file,
                    format!("line {}", k + 1),
                    e.to_string(),
                    "a judgement, as `isoplanat design` writes it",
                )
            })
        };
        text.lines().enumerate().map(one).collect()
    }

    /// Its lens.
    ///
    /// # Errors
    /// A lens that is not in the folder.
    pub fn lens(&self, folder: &Path) -> Result<Lens> {
        prescription::load(&folder.join(&self.lens))
    }
}

/// What a page tells beside the state of its design.
#[derive(Clone, Copy)]
pub(in crate::design) struct StoryFacts<'a> {
    pub(in crate::design) held_out: &'a Textures,
    pub(in crate::design) history: &'a [Judgement],
    pub(in crate::design) log: &'a [Entry],
    /// What the finished network is worth, a line a distance.
    pub(in crate::design) verdict: &'a [String],
}

/// The page of a design in `folder`.
pub(in crate::design) fn page(
    folder: &Path,
    task: &Task,
    stage: &Stage,
    told: &StoryFacts<'_>,
    first: &Lens,
) -> Result<String> {
    let StoryFacts { held_out, history, log, verdict } = *told;
    let lens = &stage.joint.lens;
    let distance = 1.0 / lens.object_vergence;
    let view = |lens: &Lens| LensView::new(lens, distance, FIELDS, false).ok();
    let mut names: Vec<String> = history.last().map(|j| j.variables.keys().cloned().collect()).unwrap_or_default();
    names.sort();
    let mut moments = Vec::new();
    for j in history {
        moments.push(Moment {
            step: j.step,
            drawing: lens_svg(&j.lens(folder)?),
            held_out_db: j.held_out_db,
            values: names.iter().map(|n| j.variables.get(n).copied().unwrap_or(f64::NAN)).collect(),
            certainty: names.iter().map(|n| j.certainty.get(n).copied()).collect(),
        });
    }
    #[expect(clippy::cast_precision_loss, reason = "step counts")]
    let over = |f: fn(&Entry) -> f64| log.iter().map(|e| [e.step as f64, f(e)]).collect::<Vec<_>>();
    let moving = |f: fn(&Entry) -> f64| over(f).into_iter().filter(|p| p[1] > 0.0).collect::<Vec<_>>();
    let (words, notes) = words(task);
    let shown =
        stage.camera().shown(held_out, task.pictures.patch_px, SHOWN)?.into_iter().enumerate().map(|(k, pictures)| {
            Shown {
                caption: format!("held-out patch {} from the axis outwards", k + 1),
                pictures: notes.iter().cloned().zip(pictures).collect(),
            }
        });
    let fact = |value: String, label: &str| Fact { value, label: label.to_owned() };
    let mut facts = Vec::new();
    let over_share = stage.used() >= 1.0;
    let told = if over_share { Judgement::of_result(history) } else { history.last() };
    if let Some(told) = told {
        let [before, after] = told.held_out_db;
        if task.loss.sensor.is_none() {
            facts.push(fact(format!("{:+.2} dB", after - before), "held-out pictures: network less capture"));
        }
        facts.push(fact(format!("{after:.2} dB"), &words.judged[1]));
    }
    facts.extend([
        fact(stage.total().map_or(stage.steps().to_string(), |n| format!("{} of {n}", stage.steps())), "steps"),
        fact(format!("{:.1} min", stage.seconds() / 60.0), "so far"),
    ]);
    let standing = match told.filter(|j| over_share && Some(j.step) != history.last().map(|last| last.step)) {
        Some(j) => format!("Finished. The result is the state of step {}: later ones were judged worse.", j.step),
        None if over_share => "Finished.".into(),
        None => format!("Under way: {:.0} %.", 100.0 * stage.used()),
    };
    let verdict = verdict.iter().map(|line| format!("{}. ", sentence(line)));
    let standing = verdict.chain([standing]).collect();
    if let Some(e) = log.last() {
        facts.push(fact(format!("{:.2} s", e.step_seconds), "a step"));
        facts.push(fact(
            format!("{:.0} %", 100.0 * (1.0 - e.network_seconds / e.step_seconds.max(1e-9))),
            "of it optics",
        ));
    }
    let page = DesignPage {
        title: lens.name.clone(),
        standing,
        words,
        facts,
        lenses: [view(first), view(lens)],
        variables: names,
        moments,
        result: told.map(|j| j.step),
        loss: over(|e| e.loss),
        moved_um: moving(|e| e.moved_um),
        signal: moving(|e| e.signal),
        active: history.last().map(|j| j.active.clone()).unwrap_or_default(),
        shown: shown.collect(),
        settings: settings(task, stage),
    };
    page.to_html()
}

/// How the design was done, name and value.
fn settings(task: &Task, stage: &Stage) -> Vec<[String; 2]> {
    let mut settings: Vec<[String; 2]> = stage
        .fineness
        .iter()
        .map(|(step, chosen)| [format!("rendered from step {step} on"), chosen.describe()])
        .collect();
    let pair = |name: &str, value: String| [name.to_owned(), value];
    let frame = &stage.renderer().plan.frame;
    settings
        .push(pair("frame", format!("{} × {} pixels of {:.2} µm", frame.columns, frame.rows, 1e3 * frame.pitch_mm)));
    settings.push(pair("steps of the lens", format!("{:?}, taken back {}", task.lens.steps_by, stage.joint.rejected)));
    if task.loss.depth_power > 1.0 {
        let said =
            "losses of the distances, as running means; judged by the distance with the lowest PSNR behind the network";
        settings.push(pair("distances", format!("power mean ({}) of the {said}", task.loss.depth_power)));
    }
    let each = task.loss.sensor.as_ref().map_or("", |_| ", each at every distance");
    settings
        .push(pair("patches", format!("{} of {} pixels a step{each}", task.pictures.batch, task.pictures.patch_px)));
    settings.push(match task.loss.sensor {
        Some(_) => {
            pair("network", "none: the lens is judged by its own images; `isoplanat train` makes one for it".into())
        }
        None => pair("network", format!("{} channels at the finest of three scales", task.network.base_width)),
    });
    settings.push(pair("left out", left_out(stage)));
    settings
}

/// With a capital.
fn sentence(line: &str) -> String {
    let mut letters = line.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// What figures and the pictures of a row are called.
fn words(task: &Task) -> (Words, Vec<String>) {
    if task.loss.sensor.is_none() {
        let words = Words {
            judged: ["held-out captures".into(), "behind the network".into()],
            loss: "L1".into(),
            shown: "Capture, reconstruction, truth.".into(),
        };
        return (words, ["capture", "reconstruction", "truth"].map(str::to_owned).to_vec());
    }
    let words = Words {
        judged: ["held-out sensor images, mean of the distances".into(), "the lowest of them".into()],
        loss: "loss on sensor images".into(),
        shown: "Sensor images of one scene from each distance, without noise and network, and the ideal picture."
            .into(),
    };
    let at = task.pictures.depths_mm.iter().map(|d| format!("from {} mm", significant(*d, 6)));
    (words, at.chain(["ideal".to_owned()]).collect())
}

/// What the plan does not need.
fn left_out(stage: &Stage) -> String {
    let plan = &stage.renderer().plan;
    let light = stage.renderer().optics.table();
    let apertures = light.clips.len();
    let depth = &plan.depths[0];
    format!(
        "fields off the meridian and half of every pupil (the lens is symmetric; exact), all but {apertures} clear apertures (no ray comes \
         near them; exact), light beyond {} × {} cells of {} pixels around a place ({:.0e} of a kernel's at most)",
        depth.size(),
        depth.size(),
        depth.bin,
        plan.settings.outside
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history(scores: &[f64]) -> Vec<Judgement> {
        let mut best = f64::NEG_INFINITY;
        let of = |(k, score): (usize, &f64)| {
            let better = *score > best;
            best = best.max(*score);
            let value = serde_json::json!({ "step": 10 * (k + 1), "seconds": 1.0, "lens": "l.toml", "held_out_db": [20.0, score],
                "held_out_l1": 0.1, "score_db": score, "best": better, "active": [], "variables": {} });
            serde_json::from_value(value).expect("a judgement")
        };
        scores.iter().enumerate().map(of).collect()
    }

    /// The page tells what the folder holds: the best state where the last one gave way to it, as at a design's end, and else the last.
    #[test]
    fn the_result_is_the_last_state_or_the_best_one() {
        for (scores, step) in
            [(&[20.0, 22.5, 22.0][..], 20), (&[20.0, 22.5, 22.45], 30), (&[20.0, 21.0], 20), (&[22.0, 20.0, 21.0], 10)]
        {
            assert_eq!(Judgement::of_result(&history(scores)).map(|j| j.step), Some(step), "{scores:?}");
        }
        assert!(Judgement::of_result(&[]).is_none());
    }
}
