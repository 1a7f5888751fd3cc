//! The page of `isoplanat demo`, and the same figures for machines.
//!
//! [`DemoReport`] is plain data: whoever runs the chain fills it in, [`DemoReport::to_html`] and
//! [`DemoReport::summary_json`] show it.

use std::collections::BTreeMap;

use ndarray::{Array3, s};
use serde::Serialize;
use serde_json::Value;

use super::html::{Fact, Page, Picture};
use super::lens_view::{self, LensView};
use super::plot::{Mark, Plot, Scale, Series};
use super::table::{Table, numbered, significant};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::metrics::delta_e::{colour_shift, delta_e};
use isoplanat_imaging::metrics::{SSIM_WINDOW, psnr, ssim};

/// Everything the page shows.
#[derive(Clone, Debug, Default)]
pub struct DemoReport {
    /// Heading.
    pub title: String,
    /// What was done, in a sentence or two.
    pub summary: String,
    /// Machine, threads, inference runtime: what run times belong to.
    pub runtime: String,
    /// Settings of the run: name and value.
    pub settings: Vec<(String, String)>,
    /// The lens the design began with.
    pub before: Option<LensView>,
    /// The designed lens.
    pub after: Option<LensView>,
    /// Losses over steps; each curve gets its own plot.
    pub loss: Vec<LossCurve>,
    /// Pictures through the designed lens.
    pub scenes: Vec<SceneResult>,
    /// Ways of rendering, fast and reference, with error and run time.
    pub methods: Vec<MethodResult>,
    /// PSNR of the fast renderer against the reference renderer, dB, linear light.
    pub psnr_fast_vs_reference_db: f64,
    /// Rendering one picture by the fast path, s.
    pub seconds_fast: f64,
    /// Rendering the same picture by the reference renderer, s.
    pub seconds_reference: f64,
    /// The whole run, s.
    pub seconds_total: f64,
    /// Stages of the run and their duration, s.
    pub stages: Vec<(String, f64)>,
    /// What the plan left out and why, and what the demonstration does not show.
    pub left_out: Vec<String>,
}

/// One loss over the steps of its stage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LossCurve {
    /// What was trained.
    pub name: String,
    /// `(step, loss)`.
    pub points: Vec<(f64, f64)>,
}

/// One picture: as captured, restored and as it is.
#[derive(Clone, Debug)]
pub struct SceneResult {
    /// Name.
    pub name: String,
    /// Capture, demosaicked, linear RGB `[3, row, col]`.
    pub capture: Array3<f32>,
    /// Classical restoration.
    pub wiener: Array3<f32>,
    /// Output of a network that sees the capture alone.
    pub bare: Array3<f32>,
    /// Output of the guided network.
    pub reconstruction: Array3<f32>,
    /// The scene as an ideal camera sees it.
    pub truth: Array3<f32>,
    /// Agreement of the four with the truth.
    pub capture_quality: Quality,
    /// Of the classical restoration.
    pub wiener_quality: Quality,
    /// Of the output of the network that sees the capture alone.
    pub bare_quality: Quality,
    /// Of the output of the guided one.
    pub reconstruction_quality: Quality,
    /// Parts that are shown enlarged.
    pub crops: Vec<Crop>,
}

/// Agreement of a picture with the truth, both as seen (sRGB).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// PSNR, dB.
    pub psnr_db: f64,
    /// SSIM.
    pub ssim: f64,
    /// Mean CIE ΔE 2000 of the pixels.
    pub delta_e: f64,
    /// The same of means over blocks of 32 × 32 pixels, which blur hardly moves.
    pub colour_shift: f64,
}

/// A square part of a picture, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First row.
    pub row: usize,
    /// First column.
    pub column: usize,
    /// Side.
    pub size: usize,
}

/// One way of rendering the same picture.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodResult {
    /// Name and settings.
    pub name: String,
    /// Run time, s.
    pub seconds: f64,
    /// PSNR against the converged reference, dB, linear light.
    pub psnr_db: f64,
    /// Relative L2 error.
    pub relative_l2: f64,
    /// Anything to say.
    pub note: String,
}

impl Quality {
    /// Measures `image` against `truth`.
    ///
    /// # Errors
    /// Pictures of different shapes, or smaller than SSIM's window.
    pub fn of(image: &Array3<f32>, truth: &Array3<f32>) -> Result<Self> {
        if image.dim() != truth.dim() {
            let found = format!("{:?} against {:?}", image.dim(), truth.dim());
            return Err(Error::bad("", "pictures compared", found, "pictures of one shape"));
        }
        let (image, truth) = (image.view(), truth.view());
        Ok(Self {
            psnr_db: psnr(image, truth),
            ssim: ssim(image, truth)?,
            delta_e: delta_e(image, truth),
            colour_shift: colour_shift(image, truth),
        })
    }

    fn notes(self) -> Vec<String> {
        vec![
            format!("{} · SSIM {:.3}", decibels(self.psnr_db), self.ssim),
            format!("ΔE {:.1} · colour shift {:.2}", self.delta_e, self.colour_shift),
        ]
    }
}

impl SceneResult {
    /// Measures the four pictures against `truth`; crops are moved and cut so that they lie inside.
    ///
    /// # Errors
    /// Pictures of different shapes, or smaller than SSIM's window.
    pub fn measure(
        name: &str,
        capture: Array3<f32>,
        wiener: Array3<f32>,
        bare: Array3<f32>,
        reconstruction: Array3<f32>,
        truth: Array3<f32>,
        crops: &[Crop],
    ) -> Result<Self> {
        let (_, rows, columns) = truth.dim();
        let inside = |crop: &Crop| {
            let size = crop.size.max(SSIM_WINDOW).min(rows).min(columns);
            Crop { row: crop.row.min(rows - size), column: crop.column.min(columns - size), size }
        };
        Ok(Self {
            name: name.to_owned(),
            capture_quality: Quality::of(&capture, &truth)?,
            wiener_quality: Quality::of(&wiener, &truth)?,
            bare_quality: Quality::of(&bare, &truth)?,
            reconstruction_quality: Quality::of(&reconstruction, &truth)?,
            crops: crops.iter().map(inside).collect(),
            capture,
            wiener,
            bare,
            reconstruction,
            truth,
        })
    }

    /// The five pictures in the order they are shown.
    fn pictures(&self) -> [(&'static str, &Array3<f32>); 5] {
        [
            ("Capture", &self.capture),
            ("Wiener", &self.wiener),
            ("Network, capture alone", &self.bare),
            ("Guided network", &self.reconstruction),
            ("Truth", &self.truth),
        ]
    }

    /// Every figure of every picture under its name.
    fn numbers(&self) -> BTreeMap<String, f64> {
        let all = [
            ("capture", self.capture_quality),
            ("wiener", self.wiener_quality),
            ("bare", self.bare_quality),
            ("reconstruction", self.reconstruction_quality),
        ];
        let named = all.map(|(of, q)| {
            [
                (format!("psnr_{of}_db"), q.psnr_db),
                (format!("ssim_{of}"), q.ssim),
                (format!("delta_e_{of}"), q.delta_e),
                (format!("colour_shift_{of}"), q.colour_shift),
            ]
        });
        named.into_iter().flatten().collect()
    }
}

/// Figures of one picture, or the means of all with each one's; those of the run in both.
#[derive(Serialize)]
struct Summary<'a> {
    #[serde(flatten)]
    numbers: BTreeMap<String, f64>,
    runtime: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scenes: Option<Vec<Self>>,
}

impl DemoReport {
    /// The figures for machines: one entry a scene in `scenes`, means over scenes and run times at the top; numbers that
    /// are not finite are `null`.
    pub fn summary_json(&self) -> Value {
        let run = [
            ("psnr_fast_vs_reference_db", self.psnr_fast_vs_reference_db),
            ("seconds_fast", self.seconds_fast),
            ("seconds_reference", self.seconds_reference),
            ("seconds_total", self.seconds_total),
        ];
        let summary = |mut numbers: BTreeMap<String, f64>, name, scenes| {
            numbers.extend(run.map(|(key, number)| (key.to_owned(), number)));
            Summary { numbers, runtime: &self.runtime, name, scenes }
        };
        let scenes: Vec<_> = self.scenes.iter().map(|s| summary(s.numbers(), Some(s.name.as_str()), None)).collect();
        let mut means = self.scenes.first().map(SceneResult::numbers).unwrap_or_default();
        for (key, number) in &mut means {
            *number = mean(scenes.iter().map(|s| s.numbers[key]).filter(|v| v.is_finite()));
        }
        numbered(&summary(means, None, Some(scenes)))
    }

    /// How the guided network stands to the others, in a sentence; nothing without pictures.
    pub fn verdict(&self) -> Option<String> {
        let lead = |of: fn(&SceneResult) -> Quality| {
            let own = self.scenes.iter().map(|s| s.reconstruction_quality.psnr_db - of(s).psnr_db);
            own.filter(|v| v.is_finite()).collect::<Vec<f64>>()
        };
        let words = |name: &str, leads: Vec<f64>| {
            let (least, most) =
                leads.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
            format!("{:+.2} dB against {name} ({least:+.2} to {most:+.2})", mean(leads.iter().copied()))
        };
        let all = [
            words("the capture", lead(|s| s.capture_quality)),
            words("a Wiener filter that is tuned on the truth", lead(|s| s.wiener_quality)),
            words("the network of the capture alone", lead(|s| s.bare_quality)),
        ];
        let count = self.scenes.len();
        (count > 0).then(|| format!("The guided network, mean of {count} scenes (least to most): {}.", all.join(", ")))
    }

    /// The page.
    ///
    /// # Errors
    /// A picture without pixels.
    pub fn to_html(&self) -> Result<String> {
        let lead = self.verdict().map_or_else(|| self.summary.clone(), |verdict| format!("{verdict} {}", self.summary));
        let mut page = Page::new(&self.title, &lead);
        page.facts(&self.facts());
        self.scene_section(&mut page)?;
        self.lens_section(&mut page)?;
        self.loss_section(&mut page);
        self.method_section(&mut page);
        self.run_section(&mut page);
        Ok(page.finish_with_contents())
    }

    fn facts(&self) -> Vec<Fact> {
        let average = |f: fn(&SceneResult) -> f64| mean(self.scenes.iter().map(f).filter(|v| v.is_finite()));
        let fact = |value: String, label: &str| Fact { value, label: label.into() };
        let mut facts = Vec::new();
        if !self.scenes.is_empty() {
            facts.push(fact(decibels(average(|s| s.capture_quality.psnr_db)), "capture, mean PSNR"));
            facts.push(fact(decibels(average(|s| s.wiener_quality.psnr_db)), "Wiener, mean PSNR"));
            facts.push(fact(decibels(average(|s| s.bare_quality.psnr_db)), "network of the capture alone, mean PSNR"));
            facts.push(fact(decibels(average(|s| s.reconstruction_quality.psnr_db)), "guided network, mean PSNR"));
            facts.push(fact(format!("{:.3}", average(|s| s.reconstruction_quality.ssim)), "guided network, mean SSIM"));
            facts.push(fact(
                format!("{:.2}", average(|s| s.reconstruction_quality.colour_shift)),
                "guided network, mean colour shift (ΔE)",
            ));
        }
        facts.push(fact(decibels(self.psnr_fast_vs_reference_db), "fast against reference renderer"));
        if self.seconds_fast > 0.0 {
            facts.push(fact(
                format!("{} ×", significant(self.seconds_reference / self.seconds_fast, 3)),
                "faster than the reference",
            ));
        }
        facts.push(fact(seconds(self.seconds_total), "whole run"));
        facts
    }

    fn lens_section(&self, page: &mut Page) -> Result<()> {
        let views: Vec<(&str, &LensView)> = [("Before", &self.before), ("After", &self.after)]
            .into_iter()
            .filter_map(|(n, v)| Some((n, v.as_ref()?)))
            .collect();
        lens_view::section(page, &views)
    }

    fn loss_section(&self, page: &mut Page) {
        if self.loss.is_empty() {
            return;
        }
        page.section("Training");
        let plots = self.loss.iter().map(|curve| {
            let points: Vec<[f64; 2]> = curve.points.iter().map(|(x, y)| [*x, *y]).collect();
            // Losses that fall by much are read better in decades.
            let (low, high) = points.iter().fold((f64::INFINITY, 0.0f64), |(a, b), p| (a.min(p[1]), b.max(p[1])));
            let plot = Plot {
                title: curve.name.clone(),
                x_label: "step".into(),
                y_label: "loss".into(),
                y_scale: if low > 0.0 && high > 8.0 * low { Scale::Log } else { Scale::Linear },
                series: vec![Series { name: String::new(), points, mark: Mark::Line }],
                ..Plot::default()
            };
            plot.is_telling().then(|| (plot.to_svg(), String::new()))
        });
        page.drawings(&plots.flatten().collect::<Vec<_>>(), 440);
    }

    fn scene_section(&self, page: &mut Page) -> Result<()> {
        if self.scenes.is_empty() {
            return Ok(());
        }
        page.section("Pictures");
        page.paragraph(
            "PSNR and SSIM against the truth, both as seen (sRGB). ΔE is the mean CIE ΔE 2000 of the pixels, mostly that of edges; the colour \
             shift is that of means over blocks of 32 × 32 pixels. About 1 is just seen.",
        );
        for scene in &self.scenes {
            page.heading(&scene.name);
            let quality =
                [scene.capture_quality, scene.wiener_quality, scene.bare_quality, scene.reconstruction_quality];
            let whole = scene.pictures().into_iter().enumerate().map(|(i, (name, image))| Picture {
                image,
                caption: name.into(),
                notes: quality.get(i).map_or_else(Vec::new, |q| q.notes()),
                pixelated: false,
            });
            page.pictures(&whole.collect::<Vec<_>>(), 180)?;
            for crop in &scene.crops {
                let cut = |image: &Array3<f32>| {
                    let (r, c) = (crop.row, crop.column);
                    image.slice(s![.., r..r + crop.size, c..c + crop.size]).to_owned()
                };
                let truth = cut(&scene.truth);
                let cuts: Vec<(&str, Array3<f32>)> = scene.pictures().map(|(name, image)| (name, cut(image))).into();
                let mut enlarged = Vec::new();
                for (i, (name, image)) in cuts.iter().enumerate() {
                    let notes = if i < 4 { Quality::of(image, &truth)?.notes() } else { vec![] };
                    enlarged.push(Picture { image, caption: format!("{name}, enlarged"), notes, pixelated: true });
                }
                page.pictures(&enlarged, 180)?;
            }
        }
        Ok(())
    }

    fn method_section(&self, page: &mut Page) {
        page.section("Error against run time");
        let (fast, reference) = (seconds(self.seconds_fast), seconds(self.seconds_reference));
        page.paragraph(&format!(
            "The fast renderer takes {fast} for one picture, the reference renderer {reference}; they agree to {} in linear light.",
            decibels(self.psnr_fast_vs_reference_db)
        ));
        if self.methods.is_empty() {
            return;
        }
        let mut table = Table::new(["method", "run time/s", "PSNR/dB", "relative L2", "note"]);
        for m in &self.methods {
            let psnr = if m.psnr_db.is_finite() { format!("{:.1}", m.psnr_db) } else { "–".into() };
            table.row([m.name.clone(), significant(m.seconds, 3), psnr, significant(m.relative_l2, 2), m.note.clone()]);
        }
        page.table(&table);
        let series = self.methods.iter().map(|m| Series {
            name: m.name.clone(),
            points: vec![[m.seconds, m.psnr_db]],
            mark: Mark::Dots,
        });
        let plot = Plot {
            title: "PSNR against run time".into(),
            x_label: "run time / s".into(),
            y_label: "PSNR / dB".into(),
            x_scale: Scale::Log,
            series: series.collect(),
            ..Plot::default()
        };
        // The reference itself has no error to be drawn.
        if plot.is_telling() {
            page.drawings(&[(plot.to_svg(), String::new())], 440);
        }
    }

    fn run_section(&self, page: &mut Page) {
        page.section("This run");
        let mut table = Table::new(["setting", "value"]);
        table.row(["runtime", &self.runtime]);
        for (name, value) in &self.settings {
            table.row([name, value]);
        }
        page.table(&table);
        if !self.stages.is_empty() {
            let mut table = Table::new(["stage", "s"]);
            for (name, duration) in &self.stages {
                table.row([name.clone(), format!("{duration:.1}")]);
            }
            page.table(&table);
        }
        if !self.left_out.is_empty() {
            page.heading("Left out");
            page.list(&self.left_out);
        }
    }
}

/// The mean, or NaN of nothing.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    sum / count
}

fn decibels(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.1} dB")
    } else if value > 0.0 {
        "equal".into()
    } else {
        "–".into()
    }
}

fn seconds(value: f64) -> String {
    if value < 100.0 {
        format!("{} s", significant(value, 3))
    } else {
        format!("{:.0} min {:02.0} s", (value / 60.0).floor(), value % 60.0)
    }
}

#[cfg(test)]
mod tests;
