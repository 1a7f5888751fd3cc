//! PSNR, SSIM and colour of captures and reconstructions over field and depth: rows of `isoplanat evaluate`, as table, CSV, JSON and
//! plot.

use serde::{Deserialize, Serialize};

use super::columns::{Column, csv};
use super::plot::{Mark, Plot, Series};
use super::table::{Table, significant};

/// Mean over pictures and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean: sample deviation over √n; NaN for a single picture.
    pub standard_error: f64,
}

impl Figure {
    /// Mean and standard error of `values`, infinite values included; NaN where there are none.
    #[expect(clippy::cast_precision_loss, reason = "counts of pictures")]
    pub fn from_values(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        Self { mean, standard_error: (square / (n - 1.0) / n).sqrt() }
    }

    /// Half the width of the 95 % interval of a mean over so many; NaN below three.
    pub(super) fn half_width(self, count: usize) -> f64 {
        student(count.saturating_sub(1)) * self.standard_error
    }

    /// The 95 % interval of a mean over so many; NaN below three.
    pub(super) fn interval(self, count: usize) -> [f64; 2] {
        let half = self.half_width(count);
        [self.mean - half, self.mean + half]
    }

    /// Its error as a cell; one that is not known stays empty.
    fn error_cell(self) -> String {
        if self.standard_error.is_nan() { String::new() } else { self.standard_error.to_string() }
    }

    /// `27.31 ± 0.42`; the mean alone where the error is not known.
    fn text(self, places: usize) -> String {
        if self.standard_error.is_finite() {
            format!("{:.places$} ± {:.places$}", self.mean, self.standard_error)
        } else {
            format!("{:.places$}", self.mean)
        }
    }
}

/// The 97.5 % point of Student's t with `freedom` degrees, within 1 % from 2 on (Abramowitz and Stegun 26.7.5); NaN below.
#[expect(clippy::cast_precision_loss, reason = "a count of pictures")]
fn student(freedom: usize) -> f64 {
    const TERMS: [f64; 5] = [1.959_964, 2.372_27, 2.822_50, 2.555_85, 1.589_53];
    if freedom < 2 {
        return f64::NAN;
    }
    TERMS.iter().rev().fold(0.0, |sum, term| sum / freedom as f64 + term)
}

/// How close one kind of picture is to the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Closeness {
    /// PSNR as seen (sRGB-encoded, range 1), dB.
    pub psnr_db: Figure,
    /// SSIM as seen.
    pub ssim: Figure,
    /// Mean CIE ΔE 2000 of the pixels, developed to sRGB.
    pub delta_e: Figure,
    /// The same of means over blocks of 32 × 32 pixels, which blur hardly moves.
    pub colour_shift: Figure,
    /// PSNR as seen after the gain that brings a patch nearest to the truth in linear light: brightness that is off does not count.
    pub best_gain_psnr_db: Figure,
}

/// One zone of the field at one depth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Distance of the scene, mm; infinite is null in JSON.
    pub depth_mm: f64,
    /// The zone, counted from 1 at the axis; 0 is a mean over zones, to the angle that it names.
    pub zone: usize,
    /// Image heights it covers, of the frame's farthest corner's.
    pub field: [f64; 2],
    /// Half field angles in the object's space that they belong to, degrees.
    pub angle_deg: [f64; 2],
    /// Patches judged.
    pub patches: usize,
    /// Their side, pixels.
    pub patch_px: usize,
    /// The network's input against the truth.
    pub capture: Closeness,
    /// The network's output against the truth.
    pub reconstruction: Closeness,
    /// PSNR that the network adds, dB; its error is that of the differences, which vary less than the pictures.
    pub gain_db: Figure,
    /// The capture through the lens's own Wiener filters against the truth: what needs no training.
    pub wiener: Closeness,
    /// PSNR that the network has over those filters, dB; its error is that of the differences.
    pub over_wiener_db: Figure,
    /// PSNR, dB, and SSIM of each picture's reconstruction, in the order of the pictures: what pairs two runs.
    pub each: Vec<[f64; 2]>,
}

/// What a run was judged on, and the outcome.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Version of this form.
    pub schema: u32,
    /// Lens.
    pub lens: String,
    /// What was photographed, in words.
    pub pictures: String,
    /// How many photographs.
    pub count: usize,
    /// Zones of the field that no patch of the frame stands in.
    pub empty_zones: Vec<usize>,
    /// Columns and rows of the frame.
    pub frame: [usize; 2],
    /// Pixels around a patch that the network saw and that were not judged.
    pub context_px: usize,
    /// Seed of places and noise.
    pub seed: u64,
    /// By depth, then by zone, the mean over the zones last.
    pub rows: Vec<Row>,
}

/// A figure and its error, a column each.
macro_rules! figure {
    ($key:literal, $($of:ident).+) => {
        [
            Column::value($key, |r: &Row| r.$($of).+.mean.to_string()),
            Column::value(concat!($key, "_error"), |r: &Row| r.$($of).+.error_cell()),
        ]
    };
}

/// The columns of comma-separated values.
fn values() -> Vec<Column<Row>> {
    let places = [
        Column::value("depth_mm", |r: &Row| r.depth_mm.to_string()),
        Column::value("zone", |r| r.zone.to_string()),
        Column::value("field_from", |r| r.field[0].to_string()),
        Column::value("field_to", |r| r.field[1].to_string()),
        Column::value("patches", |r| r.patches.to_string()),
        Column::value("patch_px", |r| r.patch_px.to_string()),
    ];
    let angles = [
        Column::value("angle_from_deg", |r: &Row| r.angle_deg[0].to_string()),
        Column::value("angle_to_deg", |r| r.angle_deg[1].to_string()),
    ];
    let before = [
        figure!("capture_psnr_db", capture.psnr_db),
        figure!("capture_ssim", capture.ssim),
        figure!("reconstruction_psnr_db", reconstruction.psnr_db),
        figure!("reconstruction_ssim", reconstruction.ssim),
        figure!("gain_db", gain_db),
        figure!("capture_delta_e", capture.delta_e),
        figure!("capture_colour_shift", capture.colour_shift),
        figure!("reconstruction_delta_e", reconstruction.delta_e),
        figure!("reconstruction_colour_shift", reconstruction.colour_shift),
    ];
    let after = [
        figure!("capture_best_gain_psnr_db", capture.best_gain_psnr_db),
        figure!("reconstruction_best_gain_psnr_db", reconstruction.best_gain_psnr_db),
        figure!("wiener_psnr_db", wiener.psnr_db),
        figure!("wiener_ssim", wiener.ssim),
        figure!("over_wiener_db", over_wiener_db),
    ];
    places.into_iter().chain(before.into_iter().flatten()).chain(angles).chain(after.into_iter().flatten()).collect()
}

impl Evaluation {
    /// The rows as a table.
    pub fn table(&self) -> Table {
        let head = [
            "depth mm",
            "field",
            "angle °",
            "patches",
            "capture dB",
            "Wiener dB",
            "network dB",
            "gain dB",
            "best gain dB",
            "capture SSIM",
            "network SSIM",
            "capture ΔE",
            "network ΔE",
            "capture shift",
            "network shift",
        ];
        let mut table = Table::new(head);
        for r in &self.rows {
            table.row([
                significant(r.depth_mm, 6),
                if r.zone == 0 { "mean".into() } else { format!("{:.2}–{:.2}", r.field[0], r.field[1]) },
                if r.zone == 0 {
                    format!("to {:.1}", r.angle_deg[1])
                } else {
                    format!("{:.1}–{:.1}", r.angle_deg[0], r.angle_deg[1])
                },
                r.patches.to_string(),
                r.capture.psnr_db.text(2),
                r.wiener.psnr_db.text(2),
                r.reconstruction.psnr_db.text(2),
                if r.gain_db.mean.is_nan() { "–".into() } else { r.gain_db.text(2) },
                r.reconstruction.best_gain_psnr_db.text(2),
                r.capture.ssim.text(4),
                r.reconstruction.ssim.text(4),
                r.capture.delta_e.text(2),
                r.reconstruction.delta_e.text(2),
                r.capture.colour_shift.text(2),
                r.reconstruction.colour_shift.text(2),
            ]);
        }
        table
    }

    /// The rows as comma-separated values with a heading; a standard error that is not known stays empty.
    pub fn csv(&self) -> String {
        csv(&values(), &self.rows)
    }

    /// PSNR over the field: of each depth the reconstruction and, dashed in the same colour, the capture.
    pub fn svg(&self) -> String {
        let mut depths: Vec<f64> = Vec::new();
        for r in &self.rows {
            if !depths.contains(&r.depth_mm) {
                depths.push(r.depth_mm);
            }
        }
        let several = depths.len() > 1;
        let mut series = Vec::new();
        for depth in &depths {
            let points = |value: fn(&Row) -> f64| -> Vec<[f64; 2]> {
                let zones = self.rows.iter().filter(|r| r.depth_mm == *depth && r.zone > 0);
                zones.map(|r| [0.5 * (r.field[0] + r.field[1]), value(r)]).collect()
            };
            let name = if several { format!("{} mm", significant(*depth, 4)) } else { "reconstruction".into() };
            series.push(Series { name, points: points(|r| r.reconstruction.psnr_db.mean), mark: Mark::Both });
            let name = if several { String::new() } else { "capture".into() };
            series.push(Series { name, points: points(|r| r.capture.psnr_db.mean), mark: Mark::Dashed });
        }
        let title = if several { "PSNR over the field: reconstruction, capture dashed" } else { "PSNR over the field" };
        Plot {
            title: title.into(),
            x_label: "image height, of the frame's corner".into(),
            y_label: "PSNR as seen, dB".into(),
            series,
            ..Plot::default()
        }
        .to_svg()
    }
}

#[cfg(test)]
impl Evaluation {
    /// Three pictures judged somehow.
    pub(super) fn of_rows(rows: Vec<Row>) -> Self {
        Self {
            schema: 1,
            lens: "l".into(),
            pictures: "p".into(),
            count: 3,
            empty_zones: vec![],
            frame: [640, 480],
            context_px: 24,
            seed: 1,
            rows,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation() -> Evaluation {
        let closeness = |psnr: f64, error: f64| Closeness {
            psnr_db: Figure { mean: psnr, standard_error: error },
            ssim: Figure { mean: psnr / 50.0, standard_error: error / 50.0 },
            delta_e: Figure { mean: 100.0 / psnr, standard_error: 2.0 * error },
            colour_shift: Figure { mean: 0.02 * psnr, standard_error: 0.5 * error },
            best_gain_psnr_db: Figure { mean: psnr + 0.25, standard_error: error },
        };
        let row = |depth_mm: f64, zone: usize, psnr: f64, error: f64| Row {
            depth_mm,
            zone,
            field: if zone == 0 { [0.0, 1.0] } else { [0.5 * (zone - 1) as f64, 0.5 * zone as f64] },
            angle_deg: [1.0, 2.0],
            patches: 3,
            patch_px: 256,
            capture: closeness(psnr, error),
            reconstruction: closeness(psnr + 2.5, error),
            gain_db: Figure { mean: 2.5, standard_error: 0.13 },
            wiener: closeness(psnr + 1.0, error),
            over_wiener_db: Figure { mean: 1.5, standard_error: 0.11 },
            each: vec![[psnr, 0.5]; 3],
        };
        Evaluation::of_rows(vec![
            row(500.0, 1, 25.0, 0.25),
            row(500.0, 2, 20.0, f64::NAN),
            row(500.0, 0, 22.5, 0.5),
            row(f64::INFINITY, 1, f64::INFINITY, f64::NAN),
        ])
    }

    /// Deviations 1, 0, −1 from 2: sample variance 1, of the mean 1/3.
    #[test]
    fn the_standard_error_is_that_of_the_mean() {
        let figure = Figure::from_values(&[1.0, 2.0, 3.0]);
        assert!((figure.mean - 2.0).abs() < 1e-15 && (figure.standard_error - (1f64 / 3.0).sqrt()).abs() < 1e-15);
        assert!(Figure::from_values(&[4.0]).standard_error.is_nan() && Figure::from_values(&[]).mean.is_nan());
        assert_eq!(Figure::from_values(&[f64::INFINITY; 2]).mean, f64::INFINITY);
    }

    #[test]
    fn table_csv_and_json_say_the_same() {
        let e = evaluation();
        let table = e.table().to_string();
        for text in ["25.00 ± 0.25", "27.50 ± 0.25", "2.50 ± 0.13", "0.50–1.00", "mean", "inf", "4.00 ± 0.50"] {
            assert!(table.contains(text), "{text}: {table}");
        }
        let csv = e.csv();
        let lines: Vec<Vec<&str>> = csv.lines().map(|l| l.split(',').collect()).collect();
        assert!(lines.len() == 5 && lines.iter().all(|l| l.len() == 36), "{csv}");
        assert_eq!(
            lines[1],
            [
                "500",
                "1",
                "0",
                "0.5",
                "3",
                "256",
                "25",
                "0.25",
                "0.5",
                "0.005",
                "27.5",
                "0.25",
                "0.55",
                "0.005",
                "2.5",
                "0.13",
                "4",
                "0.5",
                "0.5",
                "0.125",
                "3.6363636363636362",
                "0.5",
                "0.55",
                "0.125",
                "1",
                "2",
                "25.25",
                "0.25",
                "27.75",
                "0.25",
                "26",
                "0.25",
                "0.52",
                "0.005",
                "1.5",
                "0.11"
            ]
        );
        assert_eq!((lines[2][7], lines[4][0]), ("", "inf"));
        let json = crate::report::table::value(&e).expect("JSON");
        assert_eq!(json["rows"][0]["capture"]["psnr_db"]["mean"], serde_json::json!(25.0));
        assert_eq!(json["rows"][0]["capture"]["delta_e"]["mean"], serde_json::json!(4.0));
        assert_eq!(json["rows"][3]["depth_mm"], serde_json::Value::Null);
    }

    #[test]
    fn the_plot_has_a_pair_of_curves_a_depth() {
        let svg = evaluation().svg();
        assert!(svg.contains("500 mm") && svg.contains("stroke-dasharray") && svg.contains("dashed"), "{svg}");
        let one = Evaluation { rows: evaluation().rows[..3].to_vec(), ..evaluation() };
        let svg = one.svg();
        assert!(svg.contains("reconstruction") && svg.contains("capture") && !svg.contains("NaN"), "{svg}");
    }

    /// Printed tables of Student's t.
    #[test]
    fn points_of_student() {
        for (freedom, t, within) in
            [(2, 4.3027, 0.01), (4, 2.7764, 1e-3), (9, 2.2622, 1e-4), (23, 2.0687, 1e-4), (1000, 1.9623, 1e-4)]
        {
            let found = student(freedom);
            assert!((found / t - 1.0).abs() < within, "{freedom}: {found}");
        }
        assert!(student(1).is_nan() && student(0).is_nan());
    }
}
