//! Cameras beside each other: one lens and others in its place, each with its own network, judged alike. Table, curves over field and distance,
//! pictures; as a page, CSV and JSON.

mod edges;

use std::collections::BTreeMap;
use std::fmt::Write;

use ndarray::Array3;
use serde::Serialize;
use serde_json::Value;

use super::evaluation::{Evaluation, Figure, Row};
use super::html::{Fact, Page, Picture};
use super::paired::against;
use super::plot::{Mark, Plot, Series};
use super::table::{Table, csv_cell, numbered, significant};
use isoplanat_base::error::Result;

pub use edges::EdgesAt;

/// One camera.
#[derive(Clone, Debug)]
pub struct Entrant {
    /// Its lens.
    pub name: String,
    /// Its network.
    pub network: String,
    /// How it came here: scale, focus, field; steps and rate of its network.
    pub notes: Vec<String>,
    /// Drawing of its lens (SVG); empty where there is none.
    pub drawing: String,
    /// How it was judged, or why it could not be.
    pub outcome: std::result::Result<Evaluation, String>,
    /// Slanted edges before and after its network, at each distance; empty where they were not asked for.
    pub edges: Vec<EdgesAt>,
    /// Truth, capture and reconstruction of some pictures side by side, with what they show.
    pub sheets: Vec<(String, Array3<f32>)>,
}

/// All of them; margins are the first lens's over others behind the same network.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Heading.
    pub title: String,
    /// The cameras, the one that the others are compared with first.
    pub entrants: Vec<Entrant>,
    /// How, by name and value.
    pub settings: Vec<[String; 2]>,
}

/// Figures of a camera over all distances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Overall {
    /// PSNR of the reconstruction at the distance where it is lowest, dB.
    pub lowest_db: f64,
    /// The difference to the highest, dB.
    pub spread_db: f64,
    /// Captures, mean over distances, dB.
    pub capture_db: f64,
    /// Reconstructions, so too.
    pub network_db: f64,
    /// SSIM of the reconstructions, so too.
    pub ssim: f64,
}

/// The mean over the whole field at each distance: the last of its rows for zone 0.
fn means(evaluation: &Evaluation) -> Vec<&Row> {
    let mut found: Vec<&Row> = Vec::new();
    for row in evaluation.rows.iter().filter(|r| r.zone == 0) {
        match found.last_mut() {
            Some(last) if last.depth_mm == row.depth_mm => *last = row,
            _ => found.push(row),
        }
    }
    found
}

impl Overall {
    /// Of a camera that was judged; `None` without rows.
    #[expect(clippy::cast_precision_loss, reason = "a handful of distances")]
    pub(crate) fn of(evaluation: &Evaluation) -> Option<Self> {
        let rows = means(evaluation);
        if rows.is_empty() {
            return None;
        }
        let psnr = rows.iter().map(|r| r.reconstruction.psnr_db.mean);
        let lowest_db = psnr.clone().fold(f64::INFINITY, f64::min);
        let mean = |of: fn(&Row) -> f64| rows.iter().map(|r| of(r)).sum::<f64>() / rows.len() as f64;
        Some(Self {
            lowest_db,
            spread_db: psnr.fold(f64::NEG_INFINITY, f64::max) - lowest_db,
            capture_db: mean(|r| r.capture.psnr_db.mean),
            network_db: mean(|r| r.reconstruction.psnr_db.mean),
            ssim: mean(|r| r.reconstruction.ssim.mean),
        })
    }
}

/// How much better the first camera is than another, at the distance where the first is least ahead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Margin {
    /// Mean over distances, dB.
    pub mean_db: f64,
    /// Half the width of its 95 % interval over pictures, dB, where they could be paired.
    pub within_db: Option<f64>,
    /// SSIM, mean over distances.
    pub ssim: f64,
    /// Lowest distance against lowest distance, dB.
    pub lowest_db: f64,
}

impl Margin {
    /// `None` where one of them has no rows.
    pub(crate) fn of(first: &Evaluation, other: &Evaluation) -> Option<Self> {
        let (a, b) = (Overall::of(first)?, Overall::of(other)?);
        Some(Self {
            mean_db: a.network_db - b.network_db,
            within_db: paired(first, other),
            ssim: a.ssim - b.ssim,
            lowest_db: a.lowest_db - b.lowest_db,
        })
    }
}

/// Half the 95 % interval of the mean over distances of differences picture by picture.
fn paired(first: &Evaluation, other: &Evaluation) -> Option<f64> {
    let (a, b) = (means(first), means(other));
    // Judged at the same places.
    against(first, other).ok()?;
    let pictures = a.iter().zip(&b).map(|(a, b)| a.each.len().min(b.each.len())).min()?;
    #[expect(clippy::cast_precision_loss, reason = "a handful of distances")]
    let over = a.len() as f64;
    let one = |i: usize| a.iter().zip(&b).map(|(a, b)| a.each[i][0] - b.each[i][0]).sum::<f64>() / over;
    let figure = Figure::from_values(&(0..pictures).map(one).collect::<Vec<_>>());
    let half = figure.half_width(pictures);
    half.is_finite().then_some(half)
}

/// All rows, for machines.
#[derive(Serialize)]
struct Everything<'a> {
    title: &'a str,
    settings: BTreeMap<&'a str, &'a str>,
    rows: Vec<EntrantRow<'a>>,
}

#[derive(Serialize)]
struct EntrantRow<'a> {
    lens: &'a str,
    network: &'a str,
    notes: &'a [String],
    overall: Option<Overall>,
    first_ahead: Option<Margin>,
    edges: &'a [EdgesAt],
    evaluation: Option<&'a Evaluation>,
    refused: Option<&'a str>,
}

impl Comparison {
    fn first(&self) -> Option<&Evaluation> {
        self.entrants.first()?.outcome.as_ref().ok()
    }

    /// How far the first lens is ahead of camera `k` behind the same network; `None` for the first lens itself and where one of them was not judged.
    fn margin(&self, k: usize) -> Option<Margin> {
        let of = self.entrants.iter().position(|e| e.network == self.entrants[k].network).filter(|first| *first < k)?;
        Margin::of(self.entrants[of].outcome.as_ref().ok()?, self.entrants[k].outcome.as_ref().ok()?)
    }

    /// Why cameras were not judged, a line each.
    pub fn refused(&self) -> Vec<String> {
        let why = |e: &Entrant| e.outcome.as_ref().err().map(|why| format!("{} was not judged: {why}", e.label()));
        self.entrants.iter().filter_map(why).collect()
    }

    fn several_distances(&self) -> bool {
        self.entrants.iter().filter_map(|e| e.outcome.as_ref().ok()).any(|e| means(e).len() > 1)
    }

    /// The cameras as a table.
    pub fn table(&self) -> Table {
        let several = self.several_distances();
        let mut head = vec!["lens", "network", "capture dB", "network dB", "SSIM"];
        if several {
            head.extend(["lowest dB", "spread dB"]);
        }
        head.extend(["first ahead, dB", "in SSIM"]);
        if several {
            head.push("lowest ahead, dB");
        }
        let columns = head.len();
        let mut table = Table::new(head);
        for (k, e) in self.entrants.iter().enumerate() {
            let mut row = vec![e.name.clone(), e.network.clone()];
            match e.outcome.as_ref().map(|o| (o, Overall::of(o))) {
                Ok((_, Some(o))) => {
                    row.extend([
                        format!("{:.2}", o.capture_db),
                        format!("{:.2}", o.network_db),
                        format!("{:.3}", o.ssim),
                    ]);
                    if several {
                        row.extend([format!("{:.2}", o.lowest_db), format!("{:.2}", o.spread_db)]);
                    }
                    if let Some(m) = self.margin(k) {
                        let within = m.within_db.map_or(String::new(), |w| format!(" ± {w:.2}"));
                        row.extend([format!("{:+.2}{within}", m.mean_db), format!("{:+.3}", m.ssim)]);
                        if several {
                            row.push(format!("{:+.2}", m.lowest_db));
                        }
                    }
                }
                Ok(_) => row.push("no patch was judged".into()),
                Err(_) => row.push("not judged".into()),
            }
            row.resize(columns, String::new());
            table.row(row);
        }
        table
    }

    /// Every row of every camera, with its name before it.
    pub fn csv(&self) -> String {
        let mut out = String::new();
        for e in &self.entrants {
            let Ok(evaluation) = &e.outcome else { continue };
            let csv = evaluation.csv();
            let mut lines = csv.lines();
            let heading = lines.next().unwrap_or("");
            if out.is_empty() {
                let _ = writeln!(out, "lens,network,{heading}");
            }
            for line in lines {
                let _ = writeln!(out, "{},{},{line}", csv_cell(&e.name), csv_cell(&e.network));
            }
        }
        out
    }

    /// Everything, for machines.
    pub fn json(&self) -> Value {
        let row = |(k, e)| {
            let Entrant { name, network, notes, edges, outcome, .. }: &Entrant = e;
            let evaluation = outcome.as_ref().ok();
            let (overall, first_ahead) = (evaluation.and_then(Overall::of), self.margin(k));
            let refused = outcome.as_ref().err().map(String::as_str);
            EntrantRow { lens: name, network, notes, overall, first_ahead, edges, evaluation, refused }
        };
        numbered(&Everything {
            title: &self.title,
            settings: self.settings.iter().map(|[k, v]| (k.as_str(), v.as_str())).collect(),
            rows: self.entrants.iter().enumerate().map(row).collect(),
        })
    }

    /// PSNR of reconstructions over the field, at distance `depth` of the judged ones, captures dashed.
    fn over_field(&self, depth: usize) -> Option<Plot> {
        let mut series = Vec::new();
        let mut title = String::new();
        for e in &self.entrants {
            let Ok(evaluation) = &e.outcome else { continue };
            let Some(depth_mm) = means(evaluation).get(depth).map(|r| r.depth_mm) else { continue };
            title = format!("Over the field, from {} mm", significant(depth_mm, 5));
            let points = |of: fn(&Row) -> f64| -> Vec<[f64; 2]> {
                let zones = evaluation.rows.iter().filter(|r| r.depth_mm == depth_mm && r.zone > 0);
                zones.map(|r| [0.5 * (r.angle_deg[0] + r.angle_deg[1]), of(r)]).collect()
            };
            series.push(Series {
                name: e.label(),
                points: points(|r| r.reconstruction.psnr_db.mean),
                mark: Mark::Both,
            });
            series.push(Series { name: String::new(), points: points(|r| r.capture.psnr_db.mean), mark: Mark::Dashed });
        }
        let plot = Plot {
            title,
            x_label: "half field angle, degrees".into(),
            y_label: "PSNR as seen, dB".into(),
            series,
            ..Plot::default()
        };
        (plot.series.iter().any(|s| s.points.len() > 1)).then_some(plot)
    }

    /// PSNR of reconstructions over the distance, captures dashed.
    fn over_distance(&self) -> Option<Plot> {
        let mut series = Vec::new();
        for e in &self.entrants {
            let Ok(evaluation) = &e.outcome else { continue };
            let rows = means(evaluation);
            let points = |of: fn(&Row) -> f64| -> Vec<[f64; 2]> {
                // Evenly in what defocus goes by.
                rows.iter().map(|r| [1e3 / r.depth_mm, of(r)]).collect()
            };
            series.push(Series {
                name: e.label(),
                points: points(|r| r.reconstruction.psnr_db.mean),
                mark: Mark::Both,
            });
            series.push(Series { name: String::new(), points: points(|r| r.capture.psnr_db.mean), mark: Mark::Dashed });
        }
        let plot = Plot {
            title: "Over the distance".into(),
            x_label: "1/distance, 1/m".into(),
            y_label: "PSNR as seen, dB".into(),
            series,
            ..Plot::default()
        };
        (plot.series.iter().any(|s| s.points.len() > 1)).then_some(plot)
    }

    /// Slanted edges before and after the network, as a table; nothing where none were asked for.
    pub fn edges(&self) -> Option<Table> {
        self.entrants.iter().any(|e| !e.edges.is_empty()).then(|| edges::table(&self.entrants))
    }

    fn add_edges(&self, page: &mut Page) {
        let Some(table) = self.edges() else { return };
        page.section("MTF before and after reconstruction").paragraph(
            "Slanted edges in captures by rays, green pixels, mean of the two directions: at the place nearest the axis, and where the field ends; capture → network, and in the plots captures dashed. A curve that rises again behind its lowest \
             point shows contrast of a turned sign, or a network that draws what it expects. A network may sharpen edges more than fine texture.",
        );
        page.table(&table);
        let plots: Vec<(String, String)> =
            edges::plots(&self.entrants).iter().map(|p| (p.to_svg(), String::new())).collect();
        page.drawings(&plots, 420);
        let missing = edges::missing(&self.entrants);
        if !missing.is_empty() {
            page.list(&missing);
        }
    }

    /// The page.
    ///
    /// # Errors
    /// Pictures that are none.
    pub fn to_html(&self) -> Result<String> {
        let judged = self.entrants.iter().filter(|e| e.outcome.is_ok()).count();
        let line = format!("{} cameras, {judged} of them judged; each with a network of its own", self.entrants.len());
        let mut page = Page::new(&self.title, &line);
        let fact = |value: String, label: String| Fact { value, label };
        let mut facts = Vec::new();
        if let Some(first) = self.first() {
            if let Some(o) = Overall::of(first) {
                facts.push(fact(format!("{:.2} dB", o.network_db), "the first, behind its network".into()));
                if self.several_distances() {
                    facts.push(fact(format!("{:.2} dB", o.lowest_db), "at its lowest distance".into()));
                    facts.push(fact(format!("{:.2} dB", o.spread_db), "from its lowest to its highest".into()));
                }
            }
            for (k, e) in self.entrants.iter().enumerate() {
                if let Some(m) = self.margin(k) {
                    facts.push(fact(format!("{:+.2} dB", m.mean_db), format!("over {}", e.label())));
                }
            }
        }
        page.facts(&facts);
        page.section("Table").table(&self.table());
        if !self.refused().is_empty() {
            page.list(&self.refused());
        }
        page.paragraph(
            "PSNR and SSIM as seen (sRGB-encoded, range 1), against the ideal picture of each lens, over the judged field. The first lens is ahead by the mean \
             over pictures and distances, behind the same network; ± is half the 95 % interval of differences picture by picture, where they were judged at the same places.",
        );
        let distances = self.entrants.iter().filter_map(|e| e.outcome.as_ref().ok()).map(|e| means(e).len()).max();
        let plots: Vec<(String, String)> = (0..distances.unwrap_or(0))
            .filter_map(|d| self.over_field(d))
            .chain(self.over_distance())
            .filter(Plot::is_telling)
            .map(|p| (p.to_svg(), String::new()))
            .collect();
        if !plots.is_empty() {
            page.section("Curves").paragraph("Behind the network; captures dashed.").drawings(&plots, 420);
        }
        self.add_edges(&mut page);
        page.section("Lenses");
        let drawings: Vec<(String, String, Vec<String>)> = self
            .entrants
            .iter()
            .filter(|e| !e.drawing.is_empty())
            .map(|e| (e.drawing.clone(), e.label(), e.notes.clone()))
            .collect();
        page.noted_drawings(&drawings, 420);
        if self.entrants.iter().any(|e| !e.sheets.is_empty()) {
            page.section("Pictures").paragraph(
                "Rows of truth, capture and reconstruction; the same parts of the same pictures at the same places.",
            );
            for e in self.entrants.iter().filter(|e| !e.sheets.is_empty()) {
                page.heading(&e.label());
                let pictures: Vec<Picture<'_>> = e
                    .sheets
                    .iter()
                    .map(|(caption, image)| Picture {
                        image,
                        caption: caption.clone(),
                        notes: Vec::new(),
                        pixelated: false,
                    })
                    .collect();
                page.pictures(&pictures, 420)?;
            }
        }
        page.how(&self.settings);
        Ok(page.finish_with_contents())
    }
}

impl Entrant {
    /// Lens and network.
    pub fn label(&self) -> String {
        if self.network.is_empty() { self.name.clone() } else { format!("{}, {}", self.name, self.network) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::evaluation::Closeness;
    use isoplanat_base::testing::assert_abs;
    use serde_json::json;

    /// Three pictures a row, `psnr` at each distance, differing by picture.
    fn judged(psnr: [f64; 2]) -> Evaluation {
        let row = |depth_mm: f64, zone: usize, db: f64| {
            let figure = |mean: f64| Figure { mean, standard_error: 0.1 };
            let close = |db: f64| Closeness {
                psnr_db: figure(db),
                ssim: figure(db / 50.0),
                delta_e: figure(1.0),
                colour_shift: figure(1.0),
                best_gain_psnr_db: figure(db),
            };
            Row {
                depth_mm,
                zone,
                field: [0.0, 1.0],
                angle_deg: [0.0, 10.0 * zone as f64],
                patches: 3,
                patch_px: 64,
                capture: close(db - 2.0),
                reconstruction: close(db),
                gain_db: figure(2.0),
                wiener: close(db - 1.0),
                over_wiener_db: figure(1.0),
                each: vec![[db - 3.0, 0.5], [db, 0.5], [db + 3.0, 0.5]],
            }
        };
        let of = |d: f64, db: f64| [row(d, 1, db + 1.0), row(d, 2, db - 1.0), row(d, 0, db + 9.0), row(d, 0, db)];
        Evaluation::of_rows([of(500.0, psnr[0]), of(1500.0, psnr[1])].concat())
    }

    fn comparison() -> Comparison {
        let entrant = |name: &str, outcome| Entrant {
            name: name.into(),
            network: "n".into(),
            notes: vec!["scaled".into()],
            drawing: format!("<svg><title>{name}</title></svg>"),
            outcome,
            edges: edges_of(name),
            sheets: vec![("field 1".into(), Array3::from_elem((3, 8, 8), 0.5))],
        };
        Comparison {
            title: "a".into(),
            entrants: vec![
                entrant("first", Ok(judged([24.0, 26.0]))),
                entrant("second", Ok(judged([20.0, 25.0]))),
                entrant("third", Err("no light".into())),
            ],
            settings: vec![["seed".into(), "1".into()]],
        }
    }

    /// Curves on the axis and at the end, of two distances.
    fn edges_of(name: &str) -> Vec<EdgesAt> {
        let curves = |height_mm: f64, low: f64| crate::report::measured::Curves {
            height_mm,
            tangential: true,
            design: vec![[0.0, 1.0], [0.5, low]],
            capture: vec![[0.0, 1.0], [0.25, low], [0.5, low / 2.0]],
            reconstruction: vec![[0.0, 1.0], [0.25, low + 0.3], [0.5, low]],
        };
        let at = |depth_mm: f64| EdgesAt {
            depth_mm,
            missing: vec!["no edge in the corner".into()],
            curves: vec![curves(0.0, 0.4), curves(5.0, 0.2)],
        };
        if name == "third" { Vec::new() } else { vec![at(500.0), at(1500.0)] }
    }

    /// Lowest distance, spread, margins: of the rows for the whole field, with the interval of equal differences 0.
    #[test]
    fn margins_are_those_of_the_whole_field() {
        let c = comparison();
        let (a, b) = (judged([24.0, 26.0]), judged([20.0, 25.0]));
        let overall = Overall::of(&b).expect("has rows");
        assert_eq!((overall.lowest_db, overall.spread_db), (20.0, 5.0));
        assert_eq!([overall.capture_db, overall.network_db, overall.ssim], [20.5, 22.5, 22.5 / 50.0]);
        let margin = Margin::of(&a, &b).expect("both judged");
        assert_abs(margin.mean_db, 2.5, 1e-12, "mean of 4 and 1");
        assert_abs(margin.lowest_db, 4.0, 1e-12, "24 less 20");
        assert_abs(margin.within_db.expect("paired"), 0.0, 1e-9, "every picture differs alike");
        let other = Evaluation { seed: 2, ..b };
        assert_eq!(Margin::of(&a, &other).expect("both judged").within_db, None, "other places are not paired");
        let text = c.table().to_string();
        for part in ["+2.50", "+4.00", "20.00", "5.00", "not judged"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("NaN"));
        assert_eq!(c.refused(), ["third, n was not judged: no light"]);
        let mut two = c;
        two.entrants[1].network = "other".into();
        assert_eq!(two.margin(1), None, "no first lens behind that network");
    }

    #[test]
    fn page_csv_and_json_hold_every_camera() {
        let c = comparison();
        let html = c.to_html().expect("a page");
        for part in [
            "MTF before and after",
            "Nearest the axis, from 500 mm",
            "no edge in the corner",
            "first, n",
            "second, n",
            "third",
            "no light",
            "Over the distance",
            "from 1500 mm",
            "1/distance",
        ] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && !html.contains("src=\"http"));
        let csv = c.csv();
        assert_eq!(csv.lines().count(), 1 + 2 * 8);
        let columns = csv.lines().next().expect("a heading").split(',').count();
        assert!(csv.lines().all(|l| l.split(',').count() == columns));
        let json = c.json();
        assert_eq!(json["rows"][1]["first_ahead"]["lowest_db"], json!(4.0));
        assert_eq!(json["rows"][2]["refused"], json!("no light"));
        assert!(json["rows"][0]["first_ahead"].is_null());
        assert_eq!(json["rows"][1]["edges"][1]["curves"][0]["reconstruction"][1], json!([0.25, 0.7]));
        let edges = c.edges().expect("asked for").to_string();
        assert_eq!(
            edges.lines().filter(|l| l.starts_with("first, n")).count(),
            4,
            "two places at two distances: {edges}"
        );
        assert!(edges.contains("0.70") && edges.contains("0.50"), "{edges}");
    }
}
