//! Error against run time: rows of `isoplanat accuracy`, as table, CSV, JSON, plot and page.

use serde::Serialize;

use super::columns::{Column, csv, table};
use super::html::Page;
use super::plot::{Mark, Plot, Scale, Series};
use super::table::Table;

/// One way to make the picture, what it cost and how far off it was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// `psf-grid`, `monte-carlo`, `monte-carlo plain`.
    pub method: String,
    /// What was varied.
    pub ladder: String,
    /// Its settings, in words.
    pub settings: String,
    /// PSNR against the reference, linear light, range 1, dB; the reference's own noise is taken out.
    pub psnr_db: f64,
    /// 95 % interval of it.
    pub psnr_db_interval: [f64; 2],
    /// Root mean square error over the reference's root mean square.
    pub relative_l2: f64,
    /// Sum of the picture over the reference's, less one.
    pub energy: f64,
    /// Largest difference to the mean of the reference, its noise included.
    pub worst_pixel: f64,
    /// Wall time from the lens on, planning and PSFs included.
    pub seconds: f64,
    /// Growth of the resident memory while it ran, bytes, where the system tells.
    pub peak_bytes: Option<u64>,
    /// No other row is both faster and nearer.
    pub pareto: bool,
}

/// All rows of a lens and scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Accuracy {
    /// Version of this form.
    pub schema: u32,
    /// Lens.
    pub lens: String,
    /// Scene.
    pub scene: String,
    /// Columns and rows of the picture.
    pub frame: [usize; 2],
    /// Threads.
    pub threads: usize,
    /// Rays a pixel and channel of the reference (both halves).
    pub reference_samples: usize,
    /// Root mean square of its noise.
    pub reference_noise_rms: f64,
    /// Half the largest difference of its halves: what `worst_pixel` cannot see below.
    pub reference_worst_pixel: f64,
    /// Seconds it took.
    pub reference_seconds: f64,
    /// What diffraction, which all of them leave out, changes of the picture, root mean square relative to white, from above.
    pub diffraction_rms: f64,
    /// Rows.
    pub rows: Vec<Row>,
}

/// Marks the rows that no other row beats in both time and PSNR.
pub fn mark_pareto(rows: &mut [Row]) {
    let points: Vec<(f64, f64)> = rows.iter().map(|r| (r.seconds, r.psnr_db)).collect();
    for (row, (s, p)) in rows.iter_mut().zip(&points) {
        row.pareto = !points.iter().any(|(t, q)| (t < s && q >= p) || (t <= s && q > p));
    }
}

const COLUMNS: [Column<Row>; 14] = [
    Column::shown("", |r| if r.pareto { "*".into() } else { String::new() }),
    Column::text("method", "method", |r| r.method.clone()),
    Column::text("varied", "ladder", |r| r.ladder.clone()),
    Column::text("settings", "settings", |r| r.settings.clone()),
    Column::both("PSNR dB", "psnr_db", |r| decibels(r.psnr_db), |r| r.psnr_db.to_string()),
    Column::both("95 % interval", "psnr_low_db", interval, |r| r.psnr_db_interval[0].to_string()),
    Column::value("psnr_high_db", |r| r.psnr_db_interval[1].to_string()),
    Column::figure("rel. L2", "relative_l2", 2, |r| r.relative_l2),
    Column::both("energy", "energy", |r| format!("{:+.1e}", r.energy), |r| r.energy.to_string()),
    Column::figure("worst", "worst_pixel", 2, |r| r.worst_pixel),
    Column::figure("s", "seconds", 3, |r| r.seconds),
    Column::shown("MiB", |r| r.peak_bytes.map_or("–".into(), mib)),
    Column::value("peak_bytes", |r| r.peak_bytes.map_or(String::new(), |b| b.to_string())),
    Column::value("pareto", |r| r.pareto.to_string()),
];

fn interval(row: &Row) -> String {
    let [low, high] = row.psnr_db_interval.map(decibels);
    format!("{low} to {high}")
}

#[expect(clippy::cast_precision_loss, reason = "bytes for a reader")]
fn mib(bytes: u64) -> String {
    format!("{:.0}", bytes as f64 / 1_048_576.0)
}

impl Accuracy {
    /// The rows as a table.
    pub fn table(&self) -> Table {
        table(&COLUMNS, &self.rows)
    }

    /// The rows as comma-separated values with a heading.
    pub fn csv(&self) -> String {
        csv(&COLUMNS, &self.rows)
    }

    /// PSNR over run time; the Pareto front as a line.
    pub fn svg(&self) -> String {
        let methods = self.rows.iter().fold(Vec::<&str>::new(), |mut all, r| {
            if !all.contains(&r.method.as_str()) {
                all.push(&r.method);
            }
            all
        });
        let of = |keep: &dyn Fn(&Row) -> bool| -> Vec<[f64; 2]> {
            let kept = self.rows.iter().filter(|r| keep(r) && r.psnr_db.is_finite());
            kept.map(|r| [r.seconds, r.psnr_db]).collect()
        };
        let mut series: Vec<Series> = methods
            .iter()
            .map(|m| Series { name: (*m).to_owned(), points: of(&|r| r.method == **m), mark: Mark::Dots })
            .collect();
        let mut front = of(&|r| r.pareto);
        front.sort_by(|a, b| a[0].total_cmp(&b[0]));
        series.push(Series { name: "Pareto front".into(), points: front, mark: Mark::Line });
        Plot {
            title: format!("{}: error against run time", self.lens),
            x_label: format!("run time, s ({} threads)", self.threads),
            y_label: "PSNR, dB".into(),
            x_scale: Scale::Log,
            y_scale: Scale::Linear,
            series,
            keys: vec![],
        }
        .to_svg()
    }

    /// A page of its own.
    pub fn html(&self) -> String {
        let [columns, rows] = self.frame;
        let mut page = Page::new("Error against run time", &format!("{}, {}", self.lens, self.scene));
        page.section("What an error costs");
        page.paragraph(&format!(
            "{columns} × {rows} pixels, {} threads. The reference: rays from the sensor, {} a pixel and channel in two \
             independent halves, {:.1} s. Its noise ({:.1e} rms) is taken out of the PSNR, not out of the worst pixel (which \
             sees nothing below {:.1e}). Run times are cold: plan, PSFs and picture.",
            self.threads,
            self.reference_samples,
            self.reference_seconds,
            self.reference_noise_rms,
            self.reference_worst_pixel
        ));
        page.drawings(&[(self.svg(), "PSNR in linear light for a range of 1; up and left is better.".into())], 480);
        page.section("Rows");
        page.paragraph("* marks the Pareto front: no other row is both faster and nearer.");
        page.table(&self.table());
        page.finish()
    }
}

fn decibels(v: f64) -> String {
    if v.is_finite() { format!("{v:.1}") } else { "inf".into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(method: &str, psnr_db: f64, seconds: f64) -> Row {
        Row {
            method: method.into(),
            ladder: "samples".into(),
            settings: "m = 1, \"a\"".into(),
            psnr_db,
            psnr_db_interval: [psnr_db - 1.0, f64::INFINITY],
            relative_l2: 1e-3,
            energy: -1e-4,
            worst_pixel: 0.01,
            seconds,
            peak_bytes: Some(1 << 20),
            pareto: false,
        }
    }

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let mut rows = vec![
            row("a", 40.0, 1.0),
            row("a", 50.0, 2.0),
            row("b", 45.0, 3.0),
            row("b", 60.0, 9.0),
            row("c", 50.0, 2.0),
        ];
        mark_pareto(&mut rows);
        assert_eq!(rows.iter().map(|r| r.pareto).collect::<Vec<_>>(), [true, true, false, true, true]);
    }

    #[test]
    fn all_forms_tell_the_same_rows() {
        let mut rows = vec![row("psf-grid", 40.0, 1.0), row("monte-carlo", 50.0, 20.0)];
        mark_pareto(&mut rows);
        let a = Accuracy {
            schema: 1,
            lens: "a lens".into(),
            scene: "a scene".into(),
            frame: [30, 20],
            threads: 2,
            reference_samples: 64,
            reference_noise_rms: 1e-2,
            reference_worst_pixel: 2e-2,
            reference_seconds: 3.0,
            diffraction_rms: 1e-4,
            rows,
        };
        assert_eq!(a.csv().lines().count(), 3);
        assert!(a.csv().contains("\"m = 1, \"\"a\"\"\""));
        let json = crate::report::table::value(&a).expect("JSON");
        assert_eq!(json["rows"][1]["method"], "monte-carlo");
        assert!(json["rows"][1]["psnr_db_interval"][1].is_null());
        assert!(a.table().to_string().contains("39.0 to inf"));
        assert!(a.svg().contains("Pareto front"));
        assert!(a.html().contains("<svg"));
    }
}
