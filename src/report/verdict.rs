//! Whether a network is worth its while: against its capture, and against what the lens's own Wiener filters make of that capture without any training.

use std::fmt::Display;

use serde::Serialize;

use super::evaluation::{Evaluation, Figure, Row};
use super::table::significant;

/// How far a network is ahead of something, picture by picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lead {
    /// PSNR, dB.
    pub psnr_db: Figure,
    /// Its 95 % interval over pictures, dB; NaN below three of them.
    pub interval_db: [f64; 2],
}

impl Lead {
    fn of(psnr_db: Figure, pictures: usize) -> Self {
        Self { psnr_db, interval_db: psnr_db.interval(pictures) }
    }

    /// `2.10 dB ahead of its capture (1.80 to 2.40)`.
    fn words(&self, of: &str) -> String {
        let ([low, high], mean) = (self.interval_db, self.psnr_db.mean);
        if !mean.is_finite() {
            return format!("not compared with {of}: one of them is the truth itself, or no number");
        }
        let side = if mean < 0.0 { "behind" } else { "ahead of" };
        if low.is_nan() {
            return format!("{:.2} dB {side} {of} (too few pictures for an interval)", mean.abs());
        }
        if low <= 0.0 && high >= 0.0 {
            return format!("not told apart from {of} ({low:+.2} to {high:+.2} dB)");
        }
        let (near, far) = (low.abs().min(high.abs()), low.abs().max(high.abs()));
        format!("{:.2} dB {side} {of} ({near:.2} to {far:.2})", mean.abs())
    }
}

/// What a judgement says of a network at one distance, over the whole field.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// What was photographed, in words.
    pub on: String,
    /// How many pictures.
    pub pictures: usize,
    /// Distance of the scene, mm; infinite is null in JSON.
    pub depth_mm: f64,
    /// Against the capture.
    pub over_capture: Lead,
    /// Against the lens's own Wiener filters.
    pub over_wiener: Lead,
}

impl Verdict {
    /// A verdict for every distance, from the mean over all zones.
    pub fn from_evaluation(evaluation: &Evaluation) -> Vec<Self> {
        let mut rows: Vec<&Row> = Vec::new();
        for row in evaluation.rows.iter().filter(|r| r.zone == 0) {
            // The mean to the largest angle is a distance's last row.
            match rows.iter_mut().find(|r| r.depth_mm.to_bits() == row.depth_mm.to_bits()) {
                Some(last) => *last = row,
                None => rows.push(row),
            }
        }
        let of = |row: &Row| Self {
            on: evaluation.pictures.clone(),
            pictures: evaluation.count,
            depth_mm: row.depth_mm,
            over_capture: Lead::of(row.gain_db, evaluation.count),
            over_wiener: Lead::of(row.over_wiener_db, evaluation.count),
        };
        rows.into_iter().map(of).collect()
    }

    /// In one line; `several`: the distance is named.
    pub fn line(&self, several: bool) -> String {
        let at = if several { format!(" at {} mm", significant(self.depth_mm, 6)) } else { String::new() };
        format!(
            "on {} {}{at} the network is {}, and {}; 95 % intervals",
            self.pictures,
            self.on,
            self.over_capture.words("its capture"),
            self.over_wiener.words("the lens's own Wiener filter")
        )
    }

    /// The lines of all distances.
    pub fn lines(all: &[Self]) -> Vec<String> {
        all.iter().map(|v| v.line(all.len() > 1)).collect()
    }

    /// The lines of a judgement, or why there is none.
    pub fn told<E: Display>(judged: &Result<Vec<Self>, E>) -> Vec<String> {
        match judged {
            Ok(all) => Self::lines(all),
            Err(why) => vec![format!("the network could not be judged: {why}")],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lead(mean: f64, standard_error: f64, pictures: usize) -> Lead {
        Lead::of(Figure { mean, standard_error }, pictures)
    }

    /// Student's t of 10 pictures is 2.262, of 3 it is 4.303.
    #[test]
    fn a_lead_is_one_only_where_its_interval_says_so() {
        for (lead, words) in [
            (lead(2.0, 0.1, 10), "2.00 dB ahead of x (1.77 to 2.23)"),
            (lead(-0.5, 0.1, 10), "0.50 dB behind x (0.27 to 0.73)"),
            (lead(0.2, 0.1, 10), "not told apart from x (-0.03 to +0.43 dB)"),
            (lead(-0.4, 0.1, 3), "not told apart from x (-0.83 to +0.03 dB)"),
            (lead(1.0, f64::NAN, 1), "1.00 dB ahead of x (too few pictures for an interval)"),
            (lead(f64::NAN, f64::NAN, 3), "not compared with x: one of them is the truth itself, or no number"),
        ] {
            assert_eq!(lead.words("x"), words);
        }
    }
}
