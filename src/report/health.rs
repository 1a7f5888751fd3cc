//! The numerical check of a lens, as text and as JSON.

use std::fmt;

use isoplanat_base::terminal::in_line;
use serde::Serialize;
use serde_json::Value;

use super::columns::{Column, csv, table};
use super::table::{Table, numbered, significant};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::trace::health::{Figure, Health, VariableHealth, Verdict};

/// What `isoplanat check` shows.
#[derive(Clone, Debug, Serialize)]
pub struct HealthReport<'a> {
    name: &'a str,
    sha256: String,
    passes: bool,
    #[serde(flatten)]
    health: Health,
}

const COLUMNS: [Column<Figure>; 5] = [
    Column::both("check", "key", |f| f.what.to_owned(), |f| f.key.to_owned()),
    Column::figure("worst", "value", 3, |f| f.value),
    Column::both("limit", "limit", limit, |f| f.limit.map_or(String::new(), |l| l.to_string())),
    Column::both("verdict", "verdict", verdict, |f| format!("{:?}", f.verdict).to_lowercase()),
    Column::text("where", "place", |f| f.place.clone()),
];

const VARIABLES: [Column<VariableHealth>; 5] = [
    Column::shown("variable", |v| v.name.clone()),
    Column::shown("scaled unit", |v| significant(v.scale, 3)),
    Column::shown("effect/mm", |v| significant(v.effect_mm, 3)),
    Column::shown("independence", |v| significant(v.independence, 2)),
    Column::shown("gradient error", |v| v.gradient_error.map_or("–".to_owned(), |e| significant(e, 2))),
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
        let health = isoplanat_optics::trace::health::check(lens);
        Self { name: &lens.name, sha256: lens.sha256(), passes: health.passes(), health }
    }

    /// What was measured.
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// The same as one JSON object; numbers that are not finite are `null`.
    pub fn json(&self) -> Value {
        numbered(self)
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
        table(&VARIABLES, &self.health.variables)
    }
}

impl fmt::Display for HealthReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let h = &self.health;
        writeln!(f, "{}: {} rays aimed over field, stop and wavelengths", in_line(self.name), h.rays)?;
        writeln!(f, "\n{}", self.table())?;
        writeln!(f, "{}", self.surfaces())?;
        writeln!(f, "{}", self.variables())?;
        let verdict = if self.passes { "passes" } else { "FAILS" };
        writeln!(f, "{verdict}")
    }
}
