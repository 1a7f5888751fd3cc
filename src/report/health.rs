//! The numerical check of a lens, as text and as JSON.

use std::fmt;

use serde_json::{Value, json};

use super::columns::{Column, csv, table};
use super::table::{Table, significant};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::trace::health::{Figure, Health, Verdict};

/// What `isoplanat check` shows.
#[derive(Clone, Debug)]
pub struct HealthReport<'a> {
    lens: &'a Lens,
    health: Health,
}

const COLUMNS: [Column<Figure>; 5] = [
    Column::both("check", "key", |f| f.what.to_owned(), |f| f.key.to_owned()),
    Column::figure("worst", "value", 3, |f| f.value),
    Column::both("limit", "limit", limit, |f| f.limit.map_or(String::new(), |l| l.to_string())),
    Column::both("verdict", "verdict", verdict, |f| format!("{:?}", f.verdict).to_lowercase()),
    Column::text("where", "place", |f| f.place.clone()),
];

fn limit(figure: &Figure) -> String {
    let sign = if figure.at_most { "≤" } else { "≥" };
    figure.limit.map_or(String::new(), |l| format!("{sign} {}", significant(l, 3)))
}

fn verdict(figure: &Figure) -> String {
    match figure.verdict {
        Verdict::Pass => "pass",
        Verdict::Fail => "FAIL",
        Verdict::Info => "",
    }
    .to_owned()
}

impl<'a> HealthReport<'a> {
    /// The check of `lens`.
    pub fn new(lens: &'a Lens) -> Self {
        Self { lens, health: isoplanat_optics::trace::health::check(lens) }
    }

    /// What was measured.
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// The same as one JSON object; numbers that are not finite are `null`.
    pub fn json(&self) -> Value {
        let h = &self.health;
        json!({
            "schema": 1,
            "name": self.lens.name,
            "sha256": self.lens.sha256(),
            "passes": h.passes(),
            "rays": h.rays,
            "failed": h.failed,
            "figures": h.figures,
            "surfaces": h.surfaces,
            "variables": h.variables,
        })
    }

    /// The figures as comma-separated values.
    pub fn csv(&self) -> String {
        csv(&COLUMNS, &self.health.figures)
    }

    /// What was measured, a figure a row.
    pub fn table(&self) -> Table {
        table(&COLUMNS, &self.health.figures)
    }

    fn surfaces(&self) -> Table {
        let mut table = Table::new([
            "surface",
            "evaluations",
            "mean",
            "residual/mm",
            "second root/mm",
            "cos² refracted",
            "1 − αρ",
            "incidence/°",
        ]);
        for (i, s) in self.health.surfaces.iter().enumerate() {
            table.row([
                i.to_string(),
                s.evaluations.to_string(),
                significant(s.mean_evaluations, 3),
                significant(s.residual_mm, 2),
                significant(s.second_root_mm, 4),
                significant(s.cos2_refracted, 4),
                significant(s.conic_edge, 4),
                significant(s.incidence_deg, 4),
            ]);
        }
        table
    }

    fn variables(&self) -> Table {
        let mut table = Table::new(["variable", "scaled unit", "effect/mm", "independence", "gradient error"]);
        for v in &self.health.variables {
            table.row([
                v.name.clone(),
                significant(v.scale, 3),
                significant(v.effect_mm, 3),
                significant(v.independence, 2),
                v.gradient_error.map_or("–".to_owned(), |e| significant(e, 2)),
            ]);
        }
        table
    }
}

impl fmt::Display for HealthReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let h = &self.health;
        writeln!(f, "{}: {} rays aimed over field, stop and wavelengths", self.lens.name, h.rays)?;
        writeln!(f, "\n{}", self.table())?;
        writeln!(f, "{}", self.surfaces())?;
        writeln!(f, "{}", self.variables())?;
        let verdict = if h.passes() { "passes" } else { "FAILS" };
        writeln!(f, "{verdict}")
    }
}
