//! A run's network behind lenses as they were built: PSNR of each draw, before and after its pictures were aligned, as table, CSV and JSON.

use serde::Serialize;
use serde_json::Value;

use super::columns::{Column, csv};
use super::table::{Table, numbered, significant};
use isoplanat_base::math::at_share;

/// Shares of the draws that are told of.
const SHARES: [f64; 3] = [0.1, 0.5, 0.9];

/// PSNR of captures and of reconstructions, dB: means over pictures and zones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Psnr {
    /// Against the ideal picture of the run's own lens.
    pub capture_db: f64,
    /// Behind the network.
    pub reconstruction_db: f64,
}

/// What a drawn lens shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Aspect {
    /// As it stands: pictures that are shifted or of another size count as wrong.
    pub as_it_stands: Psnr,
    /// After centre and scale of its pictures were brought to those of the run's own lens, as a calibration does.
    pub aligned: Psnr,
    /// Aligned, behind a network that was trained on for this lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retrained: Option<Psnr>,
    /// How many times as large it shows slopes.
    pub scale: f64,
    /// How far its picture is shifted, pixels `[right, down]`.
    pub shift_px: [f64; 2],
}

/// A drawn lens.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drawn {
    /// Its file.
    pub name: String,
    /// What it shows.
    pub shown: Option<Aspect>,
    /// Why nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// The run's own lens and those drawn.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Draws {
    /// Captures through the run's own lens, at the same places, with as many rays, drawn alike, and the same noise. Each lens's light counts relative to what
    /// it has on its axis.
    pub nominal: Psnr,
    /// The lens that was drawn around, refocused as the draws are, where the folder has it.
    pub refocused: Option<Aspect>,
    /// The drawn lenses.
    pub draws: Vec<Drawn>,
    /// Seconds of all draws.
    pub seconds: f64,
}

/// What a figure of a draw is called, and the figure.
type Figure = (&'static str, fn(&Aspect) -> f64);
const FIGURES: [Figure; 5] = [
    ("capture as it stands", |j| j.as_it_stands.capture_db),
    ("behind the network", |j| j.as_it_stands.reconstruction_db),
    ("capture aligned", |j| j.aligned.capture_db),
    ("aligned, behind the network", |j| j.aligned.reconstruction_db),
    ("behind one trained on for it", |j| j.retrained.map_or(f64::NAN, |r| r.reconstruction_db)),
];

const VALUES: [Column<Drawn>; 10] = [
    Column::value("lens", |d| d.name.clone()),
    Column::value("capture_db", |d| value(d, |a| a.as_it_stands.capture_db)),
    Column::value("reconstruction_db", |d| value(d, |a| a.as_it_stands.reconstruction_db)),
    Column::value("aligned_capture_db", |d| value(d, |a| a.aligned.capture_db)),
    Column::value("aligned_reconstruction_db", |d| value(d, |a| a.aligned.reconstruction_db)),
    Column::value("scale", |d| value(d, |a| a.scale)),
    Column::value("shift_right_px", |d| value(d, |a| a.shift_px[0])),
    Column::value("shift_down_px", |d| value(d, |a| a.shift_px[1])),
    Column::value("own_network_db", |d| {
        d.shown.and_then(|a| a.retrained).map_or(String::new(), |r| r.reconstruction_db.to_string())
    }),
    Column::value("why_none", |d| d.why.clone().filter(|_| d.shown.is_none()).unwrap_or_default()),
];

fn value(d: &Drawn, of: fn(&Aspect) -> f64) -> String {
    d.shown.as_ref().map_or(String::new(), |a| of(a).to_string())
}

impl Draws {
    /// The PSNR that a share of the draws does not reach, dB; draws without a figure reach nothing. NaN without draws.
    pub(crate) fn quantile(&self, share: f64, of: impl Fn(&Aspect) -> f64) -> f64 {
        let figure = |d: &Drawn| d.shown.as_ref().map(&of).filter(|db| !db.is_nan()).unwrap_or(f64::NEG_INFINITY);
        at_share(self.draws.iter().map(figure).collect(), share)
    }

    /// Draws without a figure.
    pub fn lost(&self) -> impl Iterator<Item = (&str, &str)> {
        self.draws.iter().filter_map(|d| Some((d.name.as_str(), d.why.as_deref()?)))
    }

    /// Columns that have figures.
    fn columns(&self) -> &'static [Figure] {
        let retrained = |a: &Aspect| a.retrained.is_some();
        let any = self.draws.iter().filter_map(|d| d.shown.as_ref()).chain(&self.refocused).any(retrained);
        if any { &FIGURES } else { &FIGURES[..4] }
    }

    /// The lens as it is, and what shares of the draws do not reach.
    pub fn table(&self) -> Table {
        let columns = self.columns();
        let mut table = Table::new(std::iter::once("PSNR, dB").chain(columns.iter().map(|c| c.0)));
        let own = [self.nominal.capture_db, self.nominal.reconstruction_db].map(|v| format!("{v:.2}"));
        let mut row =
            vec!["the lens itself".to_owned(), own[0].clone(), own[1].clone(), own[0].clone(), own[1].clone()];
        row.resize(1 + columns.len(), "–".to_owned());
        table.row(row);
        if let Some(refocused) = &self.refocused {
            let cells = columns.iter().map(|(_, of)| format!("{:.2}", of(refocused)));
            table.row(std::iter::once("refocused as the draws are".to_owned()).chain(cells));
        }
        for share in SHARES {
            let cell = |(_, of): &Figure| {
                let db = self.quantile(share, of);
                if db.is_finite() { format!("{db:.2}") } else { "lost".to_owned() }
            };
            let name = format!("{:.0} % of the draws reach", 100.0 * (1.0 - share));
            table.row(std::iter::once(name).chain(columns.iter().map(cell)));
        }
        table
    }

    /// A row a draw.
    pub fn csv(&self) -> String {
        csv(&VALUES, &self.draws)
    }

    /// All of it.
    pub fn json(&self) -> Value {
        numbered(self)
    }

    /// How long it took.
    pub fn pace(&self) -> String {
        #[expect(clippy::cast_precision_loss, reason = "a count")]
        let each = self.seconds / self.draws.len().max(1) as f64;
        format!("{} draws in {} s, {} s each", self.draws.len(), significant(self.seconds, 3), significant(each, 2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_draws_are_counted_with_the_lost_ones() {
        let psnr = |db: f64| Psnr { capture_db: db - 2.0, reconstruction_db: db };
        let drawn = |k: u32| {
            let judged = Aspect {
                as_it_stands: psnr(10.0),
                aligned: psnr(20.0 + f64::from(k)),
                retrained: None,
                scale: 1.0,
                shift_px: [0.5, 0.0],
            };
            Drawn {
                name: format!("draw-{k}.toml"),
                shown: (k > 0).then_some(judged),
                why: (k == 0).then(|| "no light, none".into()),
            }
        };
        let draws = Draws { nominal: psnr(31.0), refocused: None, draws: (0..10).map(drawn).collect(), seconds: 5.0 };
        let of = |j: &Aspect| j.aligned.reconstruction_db;
        assert_eq!(draws.quantile(0.1, of), f64::NEG_INFINITY);
        assert_eq!([draws.quantile(0.2, of), draws.quantile(0.5, of), draws.quantile(1.0, of)], [21.0, 24.0, 29.0]);
        let table = draws.table().to_string();
        assert!(
            table.contains("90 % of the draws reach") && table.contains("lost") && table.contains("31.00"),
            "{table}"
        );
        let csv = draws.csv();
        assert!(csv.lines().count() == 11 && csv.contains("\"no light, none\"") && csv.contains(",0.5,0,,"), "{csv}");
        assert_eq!(draws.lost().count(), 1);
        assert_eq!(draws.json()["draws"][3]["shown"]["aligned"]["reconstruction_db"], 23.0);
        let mut own = draws.clone();
        own.draws[3].shown.as_mut().expect("shown").retrained = Some(psnr(26.5));
        assert!(own.table().to_string().contains("trained on for it") && !table.contains("trained on for it"));
        assert!(own.csv().contains(",0.5,0,26.5,"), "{}", own.csv());
        let none = Draws { draws: Vec::new(), ..draws };
        assert!(none.quantile(0.5, of).is_nan() && none.pace().contains("0 draws"));
    }
}
