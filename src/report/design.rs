//! The page of a joint design: the lens over its steps, pictures it does not train on, losses and numbers. Written anew while it runs.

use ndarray::Array3;

use super::html::{Fact, Page, Picture};
use super::lens_view::{self, LensView};
use super::plot::{Mark, Plot, Scale, Series};
use super::table::{Table, significant};
use isoplanat_base::error::Result;

/// A lens on the way.
#[derive(Clone, Debug)]
pub(crate) struct Moment {
    /// Steps done.
    pub step: usize,
    /// Drawing (SVG).
    pub drawing: String,
    /// Judgement of pictures that are not trained on: the two PSNRs that [`Words::judged`] names, dB.
    pub held_out_db: [f64; 2],
    /// Value of every number that moves.
    pub values: Vec<f64>,
    /// Mean of its gradient since the moment before, in its own standard errors, where that is known.
    pub certainty: Vec<Option<f64>>,
}

/// A held-out picture: as captured, restored and as it is.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    /// Where it stands and how good it is.
    pub caption: String,
    /// What they are, and linear RGB `[3, row, col]`: capture, reconstruction, truth.
    pub pictures: Vec<(String, Array3<f32>)>,
}

/// What the page calls the figures that a design is judged by.
#[derive(Clone, Debug)]
pub(crate) struct Words {
    /// The two PSNRs of a judgement.
    pub judged: [String; 2],
    /// The loss.
    pub loss: String,
    /// The pictures of a row.
    pub shown: String,
}

/// What the page shows.
#[derive(Clone, Debug)]
pub(crate) struct DesignPage {
    /// The lens's name.
    pub title: String,
    /// Whether it is still under way, and since when.
    pub standing: String,
    /// What figures are called.
    pub words: Words,
    /// Figures on top.
    pub facts: Vec<Fact>,
    /// The lens it began with and the lens now; none where a lens loses the rays a picture of its kernels needs.
    pub lenses: [Option<LensView>; 2],
    /// Names of the numbers that move.
    pub variables: Vec<String>,
    /// The history.
    pub moments: Vec<Moment>,
    /// Step of the one that the result is of.
    pub result: Option<usize>,
    /// Loss over the steps.
    pub loss: Vec<[f64; 2]>,
    /// Movement of the lens's rays a step, µm.
    pub moved_um: Vec<[f64; 2]>,
    /// Agreement of gradients.
    pub signal: Vec<[f64; 2]>,
    /// What holds the lens back.
    pub active: Vec<String>,
    /// Pictures it does not train on.
    pub shown: Vec<Shown>,
    /// How it is done, by name and value.
    pub settings: Vec<[String; 2]>,
}

impl DesignPage {
    /// The page.
    ///
    /// # Errors
    /// Pictures that are none.
    pub(crate) fn to_html(&self) -> Result<String> {
        let mut page = Page::new(&self.title, &self.standing);
        page.facts(&self.facts);
        page.section("The lens over its steps");
        page.paragraph("The slider steps through the judgements; each drawing is as wide as the page, so that a longer lens is drawn smaller.");
        let stepped: Vec<(String, String)> = self
            .moments
            .iter()
            .map(|m| {
                let ([a, b], [before, after]) = (m.held_out_db, &self.words.judged);
                (m.drawing.clone(), format!("step {}: {before} {a:.2} dB, {after} {b:.2} dB", m.step))
            })
            .collect();
        page.stepped(&stepped, stepped.len(), "step");
        self.over_time(&mut page);
        let views = ["As it began", "Now"].into_iter().zip(&self.lenses);
        lens_view::section(&mut page, &views.filter_map(|(when, v)| Some((when, v.as_ref()?))).collect::<Vec<_>>())?;
        if !self.shown.is_empty() {
            page.section("Pictures it does not train on");
            page.paragraph(&self.words.shown);
            for shown in &self.shown {
                let pictures: Vec<Picture<'_>> = shown
                    .pictures
                    .iter()
                    .map(|(note, image)| Picture {
                        image,
                        caption: note.clone(),
                        notes: vec![shown.caption.clone()],
                        pixelated: false,
                    })
                    .collect();
                page.pictures(&pictures, 180)?;
            }
        }
        self.numbers(&mut page);
        page.how(&self.settings);
        Ok(page.finish_with_contents())
    }

    fn over_time(&self, page: &mut Page) {
        let line = |name: &str, points: &[[f64; 2]], mark: Mark| Series {
            name: name.to_owned(),
            points: points.to_vec(),
            mark,
        };
        let plot = |title: &str, y: &str, y_scale: Scale, series: Vec<Series>| {
            let plot = Plot {
                title: title.to_owned(),
                x_label: "steps".to_owned(),
                y_label: y.to_owned(),
                x_scale: Scale::Linear,
                y_scale,
                series,
                keys: vec![],
            };
            // A dot is no course.
            plot.is_telling().then(|| (plot.to_svg(), String::new()))
        };
        #[expect(clippy::cast_precision_loss, reason = "step counts")]
        let judged = |k: usize| self.moments.iter().map(|m| [m.step as f64, m.held_out_db[k]]).collect::<Vec<_>>();
        let [before, after] = self.words.judged.clone();
        let drawings = [
            plot("Loss of training patches", &self.words.loss, Scale::Log, vec![line("", &self.loss, Mark::Line)]),
            plot(
                "Pictures it does not train on",
                "PSNR, dB",
                Scale::Linear,
                vec![line(&after, &judged(1), Mark::Both), line(&before, &judged(0), Mark::Both)],
            ),
            plot("How far a step moves rays", "rms, µm", Scale::Log, vec![line("", &self.moved_um, Mark::Line)]),
            plot("Agreement of gradients", "0 to 1", Scale::Linear, vec![line("", &self.signal, Mark::Line)]),
        ];
        let drawings: Vec<(String, String)> = drawings.into_iter().flatten().collect();
        if !drawings.is_empty() {
            page.section("Over time");
            page.drawings(&drawings, 420);
        }
        if !self.active.is_empty() {
            page.paragraph(&format!("Holding the lens back now: {}.", self.active.join(", ")));
        }
    }

    fn numbers(&self, page: &mut Page) {
        let result = self.moments.iter().rfind(|m| Some(m.step) == self.result).or(self.moments.last());
        let (Some(first), Some(last)) = (self.moments.first(), result) else { return };
        page.section("What moved");
        page.paragraph(
            "Gradient: its mean between two judgements in its own standard errors, when the lens last moved. Patches are a sample; \
             below about 2 they do not agree on a direction.",
        );
        let mut table = Table::new(["number", "first judgement", "now", "gradient"]);
        for (k, name) in self.variables.iter().enumerate() {
            let value = |m: &Moment| m.values.get(k).map_or(String::new(), |v| significant(*v, 6));
            let known = self.moments.iter().rev().find_map(|m| m.certainty.get(k).copied().flatten());
            let certainty = known.map_or(String::new(), |t| format!("{t:+.1}"));
            table.row([name.clone(), value(first), value(last), certainty]);
        }
        page.table(&table);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_shows_every_moment_once() {
        let moment = |step: usize| Moment {
            step,
            drawing: format!("<svg><title>s{step}</title></svg>"),
            held_out_db: [20.0, 21.0 + step as f64],
            values: vec![step as f64],
            certainty: vec![(step == 10).then_some(3.25)],
        };
        let image = Array3::from_elem((3, 8, 8), 0.5);
        let page = DesignPage {
            title: "a & b".into(),
            standing: "under way".into(),
            words: Words { judged: ["capture".into(), "behind".into()], loss: "L1".into(), shown: "in turn".into() },
            facts: vec![Fact { value: "1".into(), label: "l".into() }],
            lenses: [None, None],
            variables: vec!["surface[0].conic".into()],
            moments: vec![moment(10), moment(20)],
            result: Some(20),
            loss: vec![[10.0, 0.1], [20.0, 0.05]],
            moved_um: vec![[10.0, 1.0]],
            signal: vec![[10.0, 0.3]],
            active: vec!["track".into()],
            shown: vec![Shown {
                caption: "c".into(),
                pictures: vec![("n1".into(), image.clone()), ("n2".into(), image)],
            }],
            settings: vec![["steps".into(), "rays".into()]],
        };
        let text = page.to_html().expect("a page");
        for step in [10, 20] {
            assert_eq!(text.matches(&format!("<title>s{step}</title>")).count(), 1);
        }
        assert!(text.contains("type=\"range\" min=\"0\" max=\"1\"") && text.contains("a &amp; b"));
        assert!(text.contains("track") && text.contains("+3.2") && text.contains("n2"));
        assert!(text.contains("step 10: capture 20.00 dB, behind 31.00 dB"));
        assert!(!text.contains("src=\"http") && !text.contains("href=\"http"));
        assert_eq!(text.matches("<script").count(), 1, "the page's own");
    }
}
