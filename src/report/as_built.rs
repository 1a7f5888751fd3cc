//! What tolerances cost: [`AsBuilt`] as table, CSV, JSON and page.

use std::fmt::Write;

use serde::Serialize;
use serde_json::Value;

use super::drawing::lens_svg;
use super::html::{Fact, Page};
use super::plot::{Mark, Plot, Scale, Series};
use super::table::{Table, numbered, significant};
use isoplanat_optics::analysis::scatter::{OfFace, Scatter};
use isoplanat_optics::analysis::tolerancing::{Alone, AsBuilt, Draw};
use isoplanat_optics::lens::Lens;

/// Shares of the draws that are told of.
const SHARES: [f64; 4] = [0.1, 0.5, 0.9, 0.98];

/// A lens and what its tolerances cost.
#[derive(Clone, Debug)]
pub struct AsBuiltReport<'a> {
    /// The lens.
    pub lens: &'a Lens,
    /// The file of tolerances.
    pub file: &'a str,
    /// Seed of the draws.
    pub seed: u64,
    /// Rms that a lens may have, mm, where somebody says.
    pub limit_mm: Option<f64>,
    /// The figures.
    pub figures: &'a AsBuilt,
}

/// Everything, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    lens: &'a str,
    lens_sha256: String,
    tolerances: &'a str,
    seed: u64,
    nominal_mm: f64,
    quantiles: Vec<Quantile>,
    lost: usize,
    limit_mm: Option<f64>,
    within_limit: Option<f64>,
    alone: &'a [Alone],
    draws: &'a [Draw],
    scatter: Option<&'a Scatter>,
    notes: &'a [String],
    seconds: [f64; 2],
}

/// Rms that a share of the draws does not exceed, for machines.
#[derive(Serialize)]
struct Quantile {
    share: f64,
    rms_mm: f64,
    by_jacobian_mm: f64,
}

fn um(mm: f64) -> String {
    if mm.is_finite() { significant(1e3 * mm, 4) } else { "lost".into() }
}

fn worst(a: &Alone) -> f64 {
    a.rms_mm.iter().map(|r| r.unwrap_or(f64::INFINITY)).fold(0.0, f64::max)
}

impl AsBuiltReport<'_> {
    /// Costs of each tolerance by itself.
    pub fn table(&self) -> Table {
        let mut table = Table::new(["deviation", "±", "unit", "rms µm at +", "at −", "by derivatives", "adds µm²"]);
        for a in &self.figures.alone {
            let [plus, minus] = a.rms_mm.map(|r| r.map_or_else(|| "lost".into(), um));
            let adds = 1e6 * (worst(a).powi(2) - self.figures.nominal_mm.powi(2));
            table.row([
                a.deviation.name.clone(),
                significant(a.deviation.size, 4),
                a.deviation.unit.to_owned(),
                plus,
                minus,
                um(a.model_mm),
                if adds.is_finite() { significant(adds, 3) } else { "–".into() },
            ]);
        }
        table
    }

    /// Rms that shares of the draws do not exceed.
    pub fn quantiles(&self) -> Table {
        let mut table = Table::new(["share of lenses", "rms µm, at most", "by derivatives"]);
        for share in SHARES.into_iter().filter(|_| !self.figures.draws.is_empty()) {
            let [rays, model] = self.figures.quantile(share);
            table.row([format!("{:.0} %", 100.0 * share), um(rays), um(model)]);
        }
        table
    }

    /// Remarks, a line each.
    pub fn remarks(&self) -> Vec<String> {
        let f = self.figures;
        let mut all = vec![format!(
            "nominal lens {} µm rms; {} draws, seed {}: {} s by rays, {} s for the derivatives and every cost by them",
            um(f.nominal_mm),
            f.draws.len(),
            self.seed,
            significant(f.seconds[1], 3),
            significant(f.seconds[0], 3)
        )];
        if let Some(limit) = self.limit_mm.filter(|_| !f.draws.is_empty()) {
            all.push(format!("within {} µm rms: {:.1} % of the draws", um(limit), 100.0 * f.within(limit)));
        }
        if f.lost() > 0 {
            all.push(format!(
                "{} draws that are no lens, in which a ray does not arrive, or half of a field point's light is lost",
                f.lost()
            ));
        }
        if let Some(s) = &f.scatter {
            let percent = |share: f64| format!("{} %", significant(100.0 * share, 3));
            let whole: Vec<String> = s
                .share
                .iter()
                .zip(&s.wavelengths_nm)
                .map(|(s, nm)| format!("{} at {} nm", percent(*s), significant(*nm, 4)))
                .collect();
            let of = |face: &OfFace| {
                let rough = face.roughness.iter().flatten().fold(0.0f64, |m, s| m.max(*s));
                format!("surface {} {}", face.surface, percent(rough + face.imperfections.unwrap_or(0.0)))
            };
            let faces: Vec<String> = s.faces.iter().map(of).collect();
            all.push(format!(
                "roughness and imperfections scatter about {} (at the worst of these {}): haze for `isoplanat capture --glare`; the draws do not know it",
                whole.join(", "),
                faces.join(", ")
            ));
        }
        all.extend(f.notes.iter().cloned());
        all
    }

    /// Every draw, a row each.
    pub fn csv(&self) -> String {
        let mut out = String::from("draw,rms_mm,rms_by_jacobian_mm,focus_mm\n");
        let text = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        for (k, d) in self.figures.draws.iter().enumerate() {
            let _ = writeln!(out, "{},{},{},{}", k + 1, text(d.rms_mm), d.model_mm, text(d.focus_mm));
        }
        out
    }

    /// Everything, for machines.
    pub fn json(&self) -> Value {
        let f = self.figures;
        let quantile = |share| {
            let [rms_mm, by_jacobian_mm] = f.quantile(share);
            Quantile { share, rms_mm, by_jacobian_mm }
        };
        numbered(&Figures {
            lens: &self.lens.name,
            lens_sha256: self.lens.sha256(),
            tolerances: self.file,
            seed: self.seed,
            nominal_mm: f.nominal_mm,
            quantiles: SHARES.into_iter().filter(|_| !f.draws.is_empty()).map(quantile).collect(),
            lost: f.lost(),
            limit_mm: self.limit_mm,
            within_limit: self.limit_mm.map(|l| f.within(l)),
            alone: &f.alone,
            draws: &f.draws,
            scatter: f.scatter.as_ref(),
            notes: &f.notes,
            seconds: f.seconds,
        })
    }

    /// The page.
    pub fn to_html(&self) -> String {
        let f = self.figures;
        let mut page = Page::new(&self.lens.name, &format!("As it will be built, within {}", self.file));
        let fact = |value: String, label: &str| Fact { value, label: label.to_owned() };
        let mut facts = vec![fact(format!("{} µm", um(f.nominal_mm)), "rms of the nominal lens")];
        if !f.draws.is_empty() {
            facts.push(fact(format!("{} µm", um(f.quantile(0.5)[0])), "half of the lenses at most"));
            facts.push(fact(format!("{} µm", um(f.quantile(0.9)[0])), "nine of ten at most"));
        }
        if let Some(limit) = self.limit_mm.filter(|_| !f.draws.is_empty()) {
            facts.push(fact(format!("{:.1} %", 100.0 * f.within(limit)), &format!("within {} µm", um(limit))));
        }
        page.facts(&facts);
        page.drawings(&[(lens_svg(self.lens), String::new())], 420);
        if !f.draws.is_empty() {
            let yields = [(self.plot().to_svg(), String::new())];
            page.section("Lenses drawn").table(&self.quantiles()).drawings(&yields, 420);
        }
        page.section("Each tolerance by itself").paragraph(
            "Rms spot over all sides of the field from the centroid, the sensor refocused, at both bounds; the costliest first. By derivatives: from those \
             of the nominal lens's rays alone.",
        );
        page.table(&self.table());
        page.section("Remarks").list(&self.remarks());
        page.finish_with_contents()
    }

    /// Share of lenses over the rms that they do not exceed.
    fn plot(&self) -> Plot {
        let steps = |of: &dyn Fn(usize) -> f64| {
            let mut all: Vec<f64> = (0..self.figures.draws.len()).map(of).filter(|v| v.is_finite()).collect();
            all.sort_by(f64::total_cmp);
            #[expect(clippy::cast_precision_loss, reason = "counts")]
            let n = self.figures.draws.len().max(1) as f64;
            #[expect(clippy::cast_precision_loss, reason = "counts")]
            let points = all.iter().enumerate().map(|(k, v)| [1e3 * v, 100.0 * (k + 1) as f64 / n]);
            points.collect::<Vec<_>>()
        };
        let draws = &self.figures.draws;
        let series = vec![
            Series {
                name: "by rays".into(),
                points: steps(&|k| draws[k].rms_mm.unwrap_or(f64::NAN)),
                mark: Mark::Line,
            },
            Series { name: "by derivatives".into(), points: steps(&|k| draws[k].model_mm), mark: Mark::Dashed },
        ];
        Plot {
            title: "Yield".into(),
            x_label: "rms spot, µm".into(),
            y_label: "lenses that are at most so, %".into(),
            x_scale: Scale::Linear,
            series,
            ..Plot::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;
    use isoplanat_optics::analysis::tolerancing::Settings;
    use isoplanat_optics::lens::builtin;

    #[test]
    fn table_csv_json_and_page_say_the_same() {
        let lens = builtin::lens("two_element").expect("shipped");
        let file =
            "schema = 1\n[surface.all]\nradius_percent = 0.5\nroughness_nm = 4\n[assembly]\ndecentre_mm = 0.02\n";
        let tolerances = Tolerances::parse(file, "t.toml").expect("reads");
        let settings = Settings { draws: 7, seed: 3, lenses: true };
        let (figures, lenses) = AsBuilt::new(&lens, &tolerances, settings, &mut |_| true).expect("passes light");
        assert_eq!(lenses.iter().flatten().count(), 1 + 7, "the lens itself and seven");
        let report = AsBuiltReport { lens: &lens, file: "t.toml", seed: 3, limit_mm: Some(1.0), figures: &figures };
        assert_eq!(report.csv().lines().count(), 8);
        assert_eq!(report.table().rows.len(), 4 + 2, "four radii and two elements");
        let json = report.json();
        assert_eq!(json["draws"].as_array().map(Vec::len), Some(7));
        assert_eq!(json["within_limit"], 1.0);
        let share = json["scatter"]["share"][0].as_f64().expect("a share");
        assert!((1e-4..1e-2).contains(&share), "{share}");
        assert!(report.remarks().iter().any(|r| r.contains("scatter about") && r.contains("surface 0")));
        let html = report.to_html();
        for part in ["Yield", "element 2, shift", "surface 0, radius", "100.0 %", "by derivatives"] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && report.remarks().iter().any(|r| r.contains("100.0 %")));
        // Costs alone.
        let alone = Settings { draws: 0, ..settings };
        let (none, _) = AsBuilt::new(&lens, &tolerances, alone, &mut |_| true).expect("passes light");
        let report = AsBuiltReport { figures: &none, ..report };
        assert!(report.quantiles().rows.is_empty() && !report.to_html().contains("lost"));
        assert!(!report.remarks().join(" ").contains("within"));
    }
}
