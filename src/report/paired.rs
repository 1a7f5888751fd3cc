//! Two runs on the same pictures at the same places: differences picture by picture, which vary less than the pictures do.

use serde::Serialize;

use super::evaluation::{Evaluation, Figure};
use super::table::{Table, significant};
use isoplanat_base::error::{Error, Result};

/// How much better one run's reconstructions are than another's, in one zone at one depth or in a mean.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Distance of the scene, mm; infinite is null in JSON.
    pub depth_mm: f64,
    /// The zone, counted from 1 at the axis; 0 is a mean over zones.
    pub zone: usize,
    /// Image heights it covers, of the frame's farthest corner's.
    pub field: [f64; 2],
    /// Pictures that were compared.
    pub pictures: usize,
    /// PSNR, dB.
    pub psnr_db: Figure,
    /// Its 95 % interval over pictures, dB; NaN below three of them.
    pub psnr_interval_db: [f64; 2],
    /// SSIM.
    pub ssim: Figure,
    /// Its 95 % interval over pictures.
    pub ssim_interval: [f64; 2],
}

/// `run` less `other`, row by row.
///
/// # Errors
/// Runs that were not judged alike: other pictures, frames, zones, depths, or another seed.
pub fn against(run: &Evaluation, other: &Evaluation) -> Result<Vec<Difference>> {
    let differ = |what: &str, a: String, b: String| Err(Error::bad("", what, a, format!("{b}, as the other run's")));
    if run.frame != other.frame {
        return differ("frame", format!("{:?}", run.frame), format!("{:?}", other.frame));
    }
    if (&run.pictures, run.count, run.seed) != (&other.pictures, other.count, other.seed) {
        return differ("pictures", run.pictures.clone(), other.pictures.clone());
    }
    let places = |e: &Evaluation| {
        e.rows.iter().map(|r| (r.depth_mm.to_bits(), r.zone, r.patch_px, r.patches)).collect::<Vec<_>>()
    };
    if places(run) != places(other) {
        let told = |e: &Evaluation| {
            let all: Vec<String> =
                e.rows.iter().map(|r| format!("{} mm zone {} of {} px", r.depth_mm, r.zone, r.patch_px)).collect();
            all.join(", ")
        };
        return differ("distances and zones", told(run), told(other));
    }
    let pairs = run.rows.iter().zip(&other.rows);
    Ok(pairs
        .map(|(a, b)| {
            let figure = |k: usize| {
                Figure::from_values(&a.each.iter().zip(&b.each).map(|(a, b)| a[k] - b[k]).collect::<Vec<f64>>())
            };
            let (pictures, psnr_db, ssim) = (a.each.len(), figure(0), figure(1));
            Difference {
                depth_mm: a.depth_mm,
                zone: a.zone,
                field: a.field,
                pictures,
                psnr_db,
                psnr_interval_db: psnr_db.interval(pictures),
                ssim,
                ssim_interval: ssim.interval(pictures),
            }
        })
        .collect())
}

/// The differences as a table.
pub fn table(differences: &[Difference]) -> Table {
    let mut table = Table::new(["depth mm", "field", "pictures", "dB more", "95 %", "SSIM more", "95 %"]);
    for d in differences {
        let between = |v: [f64; 2], places: usize| match v[0].is_finite() {
            true => format!("{:+.places$} to {:+.places$}", v[0], v[1]),
            false => "–".into(),
        };
        table.row([
            significant(d.depth_mm, 6),
            if d.zone == 0 {
                format!("mean to {:.2}", d.field[1])
            } else {
                format!("{:.2}–{:.2}", d.field[0], d.field[1])
            },
            d.pictures.to_string(),
            format!("{:+.2}", d.psnr_db.mean),
            between(d.psnr_interval_db, 2),
            format!("{:+.4}", d.ssim.mean),
            between(d.ssim_interval, 4),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::evaluation::{Closeness, Row};

    fn judged(each: Vec<[f64; 2]>) -> Evaluation {
        let figure = Figure { mean: 1.0, standard_error: 0.1 };
        let closeness = Closeness {
            psnr_db: figure,
            ssim: figure,
            delta_e: figure,
            colour_shift: figure,
            best_gain_psnr_db: figure,
        };
        let row = Row {
            depth_mm: 1000.0,
            zone: 1,
            field: [0.0, 1.0],
            angle_deg: [0.0, 20.0],
            patches: each.len(),
            patch_px: 256,
            capture: closeness,
            reconstruction: closeness,
            gain_db: figure,
            wiener: closeness,
            over_wiener_db: figure,
            each,
        };
        Evaluation::of_rows(vec![row])
    }

    /// Pictures that vary by 10 dB, differences by 0.1 dB: only the latter count. Deviations 0.1, 0, −0.1 from 0.5.
    #[test]
    fn differences_are_taken_by_picture() {
        let a = judged(vec![[20.6, 0.5], [30.5, 0.7], [25.4, 0.6]]);
        let b = judged(vec![[20.0, 0.5], [30.0, 0.7], [25.0, 0.6]]);
        let found = against(&a, &b).expect("alike");
        let d = &found[0];
        assert!((d.psnr_db.mean - 0.5).abs() < 1e-12 && (d.psnr_db.standard_error - 0.1 / 3f64.sqrt()).abs() < 1e-12);
        let half = 4.3027 * 0.1 / 3f64.sqrt();
        assert!((d.psnr_interval_db[1] - 0.5 - half).abs() < 0.01 * half && d.ssim.mean.abs() < 1e-12);
        let text = table(&found).to_string();
        assert!(text.contains("+0.50") && text.contains("to"), "{text}");
        for other in [Evaluation { seed: 2, ..b.clone() }, Evaluation { frame: [64, 48], ..b.clone() }] {
            assert!(against(&a, &other).is_err());
        }
        assert!(against(&a, &judged(vec![[20.0, 0.5]])).is_err());
        let mut far = b.clone();
        far.rows[0].depth_mm = 2000.0;
        assert!(against(&a, &far).expect_err("another distance").to_string().contains("2000 mm"));
    }
}
