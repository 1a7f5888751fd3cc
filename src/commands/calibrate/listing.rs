//! What `calibrate` shows: a table, JSON, every corner as values, a drawing.

use std::fmt;
use std::path::PathBuf;

use glam::DVec2;
use isoplanat::Error;
use isoplanat::calibrate::View;
use isoplanat::calibrate::solve::{Fit, Settings, rms};
use isoplanat::report::residuals::{Residuals, Seen};
use isoplanat::report::table::{Table, numbered, significant};
use serde::Serialize;
use serde_json::Value;

/// A picture that is off by so many times the whole is worth a look.
const ODD: f64 = 2.0;
/// Part of the frame's half diagonal that corners should reach.
const REACH: f64 = 0.85;

/// One picture.
pub(super) struct Chart {
    pub(super) path: PathBuf,
    pub(super) view: View,
}

/// All that was found.
pub(super) struct Listing {
    pub(super) settings: Settings,
    pub(super) charts: Vec<Chart>,
    /// Pictures without a chart, and why.
    pub(super) skipped: Vec<Error>,
    pub(super) fit: Fit,
    /// What is doubtful about the fit as a whole.
    pub(super) doubts: Vec<String>,
}

/// Figures of one picture, pixels.
struct Figures {
    rms: f64,
    worst: f64,
    bent: f64,
    straight: f64,
}

/// Everything, for machines.
#[derive(Serialize)]
struct Everything<'a> {
    columns: usize,
    rows: usize,
    focal_length_px: f64,
    focal_length_error_px: f64,
    centre_px: [f64; 2],
    centre_error_px: [f64; 2],
    k: &'a [f64],
    k_error: &'a [f64],
    max_slope: f64,
    distortion_at_max_slope: f64,
    reach: f64,
    rms_px: f64,
    bend_px: f64,
    bend_straightened_px: f64,
    pictures: Vec<Picture>,
    left_out: Vec<String>,
    warnings: Vec<String>,
}

/// One picture, for machines.
#[derive(Serialize)]
struct Picture {
    picture: String,
    corners: usize,
    rms_px: f64,
    worst_px: f64,
    bend_px: f64,
    bend_straightened_px: f64,
}

impl Listing {
    fn figures(&self, k: usize) -> Figures {
        let (view, off) = (&self.charts[k].view, &self.fit.residuals[k]);
        Figures {
            rms: rms(off),
            worst: off.iter().map(|r| r.length()).fold(0.0, f64::max),
            bent: view.bend(&view.seen),
            straight: view.bend(&self.fit.straight(view)),
        }
    }

    /// Root mean square of one figure over all pictures, by their corners.
    fn overall(&self, of: impl Fn(&Figures) -> f64) -> f64 {
        let weight = |k: usize| self.charts[k].view.seen.len() as f64;
        let sum: f64 = (0..self.charts.len()).map(|k| weight(k) * of(&self.figures(k)).powi(2)).sum();
        (sum / (0..self.charts.len()).map(weight).sum::<f64>()).sqrt()
    }

    /// Farthest corner from the centre, of the frame's farthest corner.
    fn reach(&self) -> f64 {
        let centre = self.fit.camera.centre_px;
        let far = self.charts.iter().flat_map(|c| &c.view.seen).map(|p| p.distance(centre)).fold(0.0, f64::max);
        let [columns, rows] = self.settings.size.map(|n| n as f64);
        let ends = [(0.0, 0.0), (columns, 0.0), (0.0, rows), (columns, rows)];
        far / ends.map(|(x, y)| centre.distance(DVec2::new(x, y))).into_iter().fold(0.0, f64::max)
    }

    /// Distortion at the outermost corner: image height against that without distortion, less one.
    fn distortion(&self) -> f64 {
        let camera = &self.fit.camera;
        let at = DVec2::new(self.fit.max_slope, 0.0);
        (camera.land(at).x - camera.centre_px.x) / (camera.focal_px.x * at.x) - 1.0
    }

    pub(super) fn warnings(&self) -> Vec<String> {
        let mut out = self.doubts.clone();
        let all = self.fit.rms_px();
        for (k, chart) in self.charts.iter().enumerate() {
            let own = self.figures(k).rms;
            if own > ODD * all {
                let (path, own, all) = (chart.path.display(), significant(own, 3), significant(all, 3));
                out.push(format!(
                    "{path}: off by {own} pixels rms, {all} over all: was the board flat, the focus the same?"
                ));
            }
        }
        let reach = self.reach();
        if reach < REACH {
            let share = significant(100.0 * reach, 2);
            out.push(format!(
                "corners reach {share} % of the way to the frame's corner; beyond slope {} the model is continued linearly",
                significant(self.fit.max_slope, 3)
            ));
        }
        for (term, (k, error)) in self.fit.camera.k.iter().zip(self.fit.errors.k).enumerate() {
            if k.abs() < 2.0 * error {
                let (k, error) = (significant(*k, 2), significant(error, 1));
                out.push(format!("k{} = {k} ± {error} is not told by these pictures: fewer --terms may do", term + 1));
            }
        }
        out
    }

    /// Every corner.
    pub(super) fn csv(&self) -> String {
        let heading = ["picture", "board_column", "board_row", "column_px", "row_px", "off_column_px", "off_row_px"];
        let mut table = Table::new(heading);
        for (chart, off) in self.charts.iter().zip(&self.fit.residuals) {
            for ((b, s), r) in chart.view.board.iter().zip(&chart.view.seen).zip(off) {
                let numbers = [b.x, b.y, s.x, s.y, r.x, r.y].map(|v| significant(v, 7));
                table.row(std::iter::once(chart.path.display().to_string()).chain(numbers));
            }
        }
        table.csv()
    }

    pub(super) fn json(&self) -> Value {
        let picture = |k: usize| {
            let (f, chart) = (self.figures(k), &self.charts[k]);
            Picture {
                picture: chart.path.display().to_string(),
                corners: chart.view.seen.len(),
                rms_px: f.rms,
                worst_px: f.worst,
                bend_px: f.bent,
                bend_straightened_px: f.straight,
            }
        };
        let (camera, errors) = (&self.fit.camera, &self.fit.errors);
        let [columns, rows] = self.settings.size;
        numbered(&Everything {
            columns,
            rows,
            focal_length_px: camera.focal_px.x,
            focal_length_error_px: errors.focal_px.x,
            centre_px: camera.centre_px.to_array(),
            centre_error_px: errors.centre_px.to_array(),
            k: &camera.k,
            k_error: &errors.k,
            max_slope: self.fit.max_slope,
            distortion_at_max_slope: self.distortion(),
            reach: self.reach(),
            rms_px: self.fit.rms_px(),
            bend_px: self.overall(|f| f.bent),
            bend_straightened_px: self.overall(|f| f.straight),
            pictures: (0..self.charts.len()).map(picture).collect(),
            left_out: self.skipped.iter().map(ToString::to_string).collect(),
            warnings: self.warnings(),
        })
    }

    /// Residuals over the frame.
    pub(super) fn svg(&self) -> String {
        let seen = self.charts.iter().zip(&self.fit.residuals).enumerate().flat_map(|(k, (chart, off))| {
            chart.view.seen.iter().zip(off).map(move |(at, off)| Seen {
                picture: k,
                at: at.to_array(),
                off: off.to_array(),
            })
        });
        let drawn = Residuals {
            size: self.settings.size,
            centre: self.fit.camera.centre_px.to_array(),
            seen: seen.collect(),
            rms: self.fit.rms_px(),
        };
        drawn.svg()
    }
}

impl fmt::Display for Listing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new(["picture", "corners", "rms/px", "worst/px", "lines bent/px", "straightened/px"]);
        for (k, chart) in self.charts.iter().enumerate() {
            let own = self.figures(k);
            let numbers = [own.rms, own.worst, own.bent, own.straight].map(|v| format!("{v:.3}"));
            let name = chart.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
            table.row([name, chart.view.seen.len().to_string()].into_iter().chain(numbers));
        }
        writeln!(f, "{table}")?;
        let (camera, errors) = (&self.fit.camera, &self.fit.errors);
        let held = |error: f64, digits: usize| {
            if error > 0.0 { format!("± {}", significant(error, digits)) } else { "held".into() }
        };
        writeln!(f, "focal length      {:.2} px {}", camera.focal_px.x, held(errors.focal_px.x, 2))?;
        let [x, y] = camera.centre_px.to_array();
        writeln!(f, "centre            {x:.2}, {y:.2} px {}", held(errors.centre_px.max_element(), 2))?;
        for term in 0..self.settings.terms {
            writeln!(f, "k{}                {:.5} {}", term + 1, camera.k[term], held(errors.k[term], 1))?;
        }
        let angle = self.fit.max_slope.atan().to_degrees();
        let percent = 100.0 * self.distortion();
        writeln!(
            f,
            "distortion        {percent:.2} % at {angle:.1}°, the outermost corner ({:.0} % of the frame)",
            100.0 * self.reach()
        )?;
        writeln!(f, "reprojection      {:.3} px rms over {} pictures", self.fit.rms_px(), self.charts.len())?;
        let (bent, straight) = (self.overall(|f| f.bent), self.overall(|f| f.straight));
        writeln!(f, "lines of the board {bent:.3} px from straight, {straight:.3} px straightened (rms)")
    }
}
