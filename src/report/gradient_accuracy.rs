//! Error of lens gradients against seconds: rows of `isoplanat accuracy --gradient`, as table, CSV, JSON and plot.

use serde::Serialize;

use super::columns::{Column, csv, table};
use super::plot::{Mark, Plot, Scale, Series};
use super::table::Table;

/// One setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was varied.
    pub ladder: String,
    /// The setting, in words.
    pub setting: String,
    /// L2 distance of the patches' gradients from the converged ones, relative to them.
    pub relative_error: f64,
    /// Seconds of tracing, rendering and pulling back all patches.
    pub seconds: f64,
    /// Seconds of planning, once for many steps.
    pub planning_seconds: f64,
}

/// All rows of a lens and scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GradientAccuracy {
    /// Version of this form.
    pub schema: u32,
    /// Lens.
    pub lens: String,
    /// Scene.
    pub scene: String,
    /// Patches and their side, pixels.
    pub patches: [usize; 2],
    /// Threads.
    pub threads: usize,
    /// Part of the patches' gradients that is not common to them: an error well below it moves no design.
    pub noise: f64,
    /// Rows.
    pub rows: Vec<Row>,
}

const COLUMNS: [Column<Row>; 5] = [
    Column::text("varied", "ladder", |r| r.ladder.clone()),
    Column::text("setting", "setting", |r| r.setting.clone()),
    Column::figure("gradient off by", "relative_error", 2, |r| r.relative_error),
    Column::figure("s", "seconds", 3, |r| r.seconds),
    Column::figure("planning, s", "planning_seconds", 3, |r| r.planning_seconds),
];

impl GradientAccuracy {
    /// The rows as a table.
    pub fn table(&self) -> Table {
        table(&COLUMNS, &self.rows)
    }

    /// The rows as comma-separated values with a heading.
    pub fn csv(&self) -> String {
        csv(&COLUMNS, &self.rows)
    }

    /// Error over seconds, a series for what is varied, and the patches' own noise.
    pub fn svg(&self) -> String {
        let ladders = self.rows.iter().fold(Vec::<&str>::new(), |mut all, r| {
            if !all.contains(&r.ladder.as_str()) {
                all.push(&r.ladder);
            }
            all
        });
        let points = |ladder: &str| {
            let kept = self.rows.iter().filter(|r| r.ladder == ladder && r.relative_error > 0.0);
            kept.map(|r| [r.seconds, r.relative_error]).collect()
        };
        let mut series: Vec<Series> =
            ladders.iter().map(|l| Series { name: (*l).to_owned(), points: points(l), mark: Mark::Both }).collect();
        let ends =
            self.rows.iter().map(|r| r.seconds).fold([f64::MAX, 0.0], |[a, b]: [f64; 2], s| [a.min(s), b.max(s)]);
        let line = ends.map(|s| [s, self.noise]).to_vec();
        series.push(Series { name: "noise of the patches".into(), points: line, mark: Mark::Line });
        Plot {
            title: format!("{}: error of the lens gradient", self.lens),
            x_label: format!("seconds of {} patches ({} threads)", self.patches[0], self.threads),
            y_label: "relative L2".into(),
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            series,
            keys: vec![],
        }
        .to_svg()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_shown_in_every_form() {
        let row = |ladder: &str, e: f64| Row {
            ladder: ladder.into(),
            setting: "a, b".into(),
            relative_error: e,
            seconds: 0.5 + e,
            planning_seconds: 0.1,
        };
        let all = GradientAccuracy {
            schema: 1,
            lens: "lens".into(),
            scene: "scene".into(),
            patches: [8, 128],
            threads: 2,
            noise: 0.3,
            rows: vec![row("wavelengths", 0.05), row("wavelengths", 0.01), row("kernel size", 0.02)],
        };
        assert_eq!(all.csv().lines().count(), 4);
        assert!(all.csv().contains("wavelengths,\"a, b\",0.05,0.55,0.1"));
        assert!(all.table().to_string().contains("gradient off by"));
        assert_eq!(crate::report::table::value(&all).expect("JSON")["rows"][2]["ladder"], "kernel size");
        let svg = all.svg();
        assert!(svg.contains("noise of the patches") && svg.contains("kernel size"));
    }
}
