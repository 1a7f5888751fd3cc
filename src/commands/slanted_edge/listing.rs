//! What `slanted-edge` shows: a table, JSON, comma-separated values, a drawing.

use std::collections::BTreeMap;
use std::fmt;

use isoplanat::imaging::metrics::slanted_edge::{Crossing, EdgeMeasurement, MtfPoint, Rectangle};
use isoplanat::report::columns::{Column, table};
use isoplanat::report::plot::{Mark, Plot, Series};
use isoplanat::report::table::{Table, numbered};
use isoplanat::terminal::in_line;
use serde::Serialize;
use serde_json::Value;

/// One channel's edge.
pub(super) struct Measured {
    pub(super) name: &'static str,
    pub(super) edge: EdgeMeasurement,
}

/// All channels of a picture.
pub(super) struct Listing {
    /// The channel whose figures stand first.
    pub(super) first: usize,
    pub(super) measured: Vec<Measured>,
    /// Channels in which no edge could be measured, and why.
    pub(super) refused: Vec<(&'static str, String)>,
    /// What the numbers were taken as.
    pub(super) source: String,
    /// The picture's name.
    pub(super) image: String,
}

/// Everything as JSON has it: the figures of the first channel at the top too.
#[derive(Serialize)]
struct Everything<'a> {
    image: &'a str,
    taken_as: &'a str,
    channel: &'a str,
    #[serde(flatten)]
    first: Channel<'a>,
    /// Places of R and B along the edge's normal, and along the row or column that crosses the edge, pixels.
    #[serde(flatten)]
    lateral: BTreeMap<&'static str, BTreeMap<&'static str, f64>>,
    channels: BTreeMap<&'a str, Channel<'a>>,
    not_measured: BTreeMap<&'a str, &'a str>,
}

/// One channel's figures.
#[derive(Serialize)]
struct Channel<'a> {
    mtf50_cy_per_px: Option<f64>,
    mtf50_interval_cy_per_px: Option<[f64; 2]>,
    mtf10_cy_per_px: Option<f64>,
    mtf10_interval_cy_per_px: Option<[f64; 2]>,
    edge_angle_deg: f64,
    edge_angle_uncertainty_deg: f64,
    normal_to_bright_side_deg: f64,
    edge_position_px: Place,
    edge_fit: &'static str,
    edge_sagitta_px: f64,
    region_px: Rectangle,
    dark_level: f64,
    bright_level: f64,
    contrast: f64,
    michelson_contrast: f64,
    noise: f64,
    rise_10_90_px: f64,
    samples: usize,
    oversampling: f64,
    warnings: &'a [String],
    mtf: &'a [MtfPoint],
    interval_95_over_uncertainty: f64,
    spread: Vec<SpreadRow>,
}

/// A place in the picture.
#[derive(Serialize)]
struct Place {
    x: f64,
    y: f64,
}

/// Edge and line spread functions at one distance.
#[derive(Serialize)]
struct SpreadRow {
    distance_px: f64,
    esf: f64,
    lsf_per_px: f64,
}

impl<'a> From<&'a EdgeMeasurement> for Channel<'a> {
    fn from(edge: &'a EdgeMeasurement) -> Self {
        let [[x, y], [dark_level, bright_level]] = [edge.position, edge.levels];
        let row = |&[distance_px, esf, lsf_per_px]: &[f64; 3]| SpreadRow { distance_px, esf, lsf_per_px };
        Self {
            mtf50_cy_per_px: edge.mtf50.map(|c| c.frequency),
            mtf50_interval_cy_per_px: edge.mtf50.map(|c| c.interval),
            mtf10_cy_per_px: edge.mtf10.map(|c| c.frequency),
            mtf10_interval_cy_per_px: edge.mtf10.map(|c| c.interval),
            edge_angle_deg: edge.angle_deg,
            edge_angle_uncertainty_deg: edge.angle_uncertainty_deg,
            normal_to_bright_side_deg: edge.normal_deg,
            edge_position_px: Place { x, y },
            edge_fit: if edge.sagitta == 0.0 { "line" } else { "parabola" },
            edge_sagitta_px: edge.sagitta,
            region_px: edge.region,
            dark_level,
            bright_level,
            contrast: bright_level - dark_level,
            michelson_contrast: edge.michelson(),
            noise: edge.noise,
            rise_10_90_px: edge.rise,
            samples: edge.samples,
            oversampling: edge.knots_per_px,
            warnings: &edge.warnings,
            mtf: &edge.mtf,
            interval_95_over_uncertainty: edge.coverage,
            spread: edge.spread.iter().map(row).collect(),
        }
    }
}

const CHANNELS: [Column<Measured>; 10] = [
    Column::shown("channel", |m| m.name.to_owned()),
    Column::shown("MTF50/(cy/px)", |m| figure(m.edge.mtf50)),
    Column::shown("95 %", |m| interval(m.edge.mtf50)),
    Column::shown("MTF10/(cy/px)", |m| figure(m.edge.mtf10)),
    Column::shown("95 %", |m| interval(m.edge.mtf10)),
    Column::shown("10-90/px", |m| format!("{:.2}", m.edge.rise)),
    Column::shown("dark", |m| format!("{:.4}", m.edge.levels[0])),
    Column::shown("bright", |m| format!("{:.4}", m.edge.levels[1])),
    Column::shown("noise", |m| format!("{:.5}", m.edge.noise)),
    Column::shown("samples", |m| m.edge.samples.to_string()),
];

fn figure(c: Option<Crossing>) -> String {
    c.map_or_else(|| "-".into(), |c| format!("{:.4}", c.frequency))
}

fn interval(c: Option<Crossing>) -> String {
    match c {
        None => "-".into(),
        Some(c) if c.interval[1].is_finite() => format!("{:.4} to {:.4}", c.interval[0], c.interval[1]),
        Some(c) => format!("from {:.4}", c.interval[0]),
    }
}

/// Every so many points of a curve stand in the table.
const STEP: usize = 5;

impl Listing {
    /// Warnings, each with its channel; those of several channels once.
    pub(super) fn warnings(&self) -> Vec<(&'static str, &str)> {
        let mut out: Vec<(&str, &str)> = Vec::new();
        for m in &self.measured {
            for w in &m.edge.warnings {
                if !out.iter().any(|(_, known)| *known == w) {
                    out.push((m.name, w));
                }
            }
        }
        out
    }

    /// Places of R and B relative to G, where there are such channels.
    fn lateral(&self) -> Vec<(&'static str, f64)> {
        let of = |name: &str| self.measured.iter().find(|m| m.name == name);
        let Some(green) = of("G") else { return Vec::new() };
        let colours = ["R", "B"].into_iter().filter_map(of);
        colours.map(|m| (m.name, m.edge.shift_from(&green.edge))).collect()
    }

    /// The table as values separated by commas: one row a frequency.
    pub(super) fn csv(&self) -> String {
        let names = self.measured.iter().flat_map(|m| [format!("mtf_{}", m.name), format!("uncertainty_{}", m.name)]);
        let mut table = Table::new(std::iter::once("frequency_cy_per_px".to_owned()).chain(names));
        let longest = self.measured.iter().map(|m| m.edge.mtf.len()).max().unwrap_or(0);
        let all = self.measured.iter().find(|m| m.edge.mtf.len() == longest);
        for (i, point) in all.iter().flat_map(|m| m.edge.mtf.iter().enumerate()) {
            let values = self.measured.iter().flat_map(|m| {
                let at = m.edge.mtf.get(i);
                [at.map(|p| p.value), at.map(|p| p.uncertainty)]
            });
            let cells = values.map(|v| v.map_or_else(String::new, |v| format!("{v:.6}")));
            table.row(std::iter::once(format!("{:.2}", point.frequency)).chain(cells));
        }
        table.csv()
    }

    /// Everything, the first channel's figures at the top too.
    pub(super) fn json(&self) -> Value {
        let (first, shifts, mut lateral) = (&self.measured[self.first], self.lateral(), BTreeMap::new());
        if !shifts.is_empty() {
            let slant = first.edge.normal_deg.to_radians();
            let (x, y) = (slant.cos().abs(), slant.sin().abs());
            let across = if x >= y { "lateral_colour_x_px" } else { "lateral_colour_y_px" };
            lateral.insert(across, shifts.iter().map(|(name, px)| (*name, px / x.max(y))).collect());
            lateral.insert("lateral_colour_px", shifts.into_iter().collect());
        }
        numbered(&Everything {
            image: &self.image,
            taken_as: &self.source,
            channel: first.name,
            first: Channel::from(&first.edge),
            lateral,
            channels: self.measured.iter().map(|m| (m.name, Channel::from(&m.edge))).collect(),
            not_measured: self.refused.iter().map(|(name, why)| (*name, &**why)).collect(),
        })
    }

    /// MTF and edge spread function, one above the other.
    pub(super) fn svg(&self) -> String {
        let mut curves = Vec::new();
        let mut spreads = Vec::new();
        for Measured { name, edge } in &self.measured {
            let points = edge.mtf.iter().map(|p| [p.frequency, p.value]).collect();
            curves.push(Series { name: (*name).into(), points, mark: Mark::Line });
            let band = |sign: f64| {
                edge.mtf.iter().map(|p| [p.frequency, p.value + sign * edge.coverage * p.uncertainty]).collect()
            };
            curves.extend([-1.0, 1.0].map(|s| Series { name: String::new(), points: band(s), mark: Mark::Dashed }));
            let points = edge.spread.iter().map(|p| [p[0], p[1]]).collect();
            spreads.push(Series { name: (*name).into(), points, mark: Mark::Line });
        }
        let mtf = Plot {
            title: format!("MTF along the edge's normal, 95 % band: {}", self.image),
            x_label: "cycles/px".into(),
            y_label: "modulation".into(),
            series: curves,
            ..Plot::default()
        };
        let esf = Plot {
            title: "Edge spread function".into(),
            x_label: "distance from the edge, px".into(),
            y_label: "level".into(),
            series: spreads,
            ..Plot::default()
        };
        stacked(&[mtf.to_svg(), esf.to_svg()])
    }
}

/// Drawings one below the other, each as it is.
fn stacked(drawings: &[String]) -> String {
    let size = |svg: &str, key: &str| -> f64 {
        let view = svg.split("viewBox=\"").nth(1).and_then(|v| v.split('"').next()).unwrap_or_default();
        let numbers: Vec<f64> = view.split_whitespace().filter_map(|v| v.parse().ok()).collect();
        numbers.get(if key == "width" { 2 } else { 3 }).copied().unwrap_or(0.0)
    };
    let width = drawings.iter().map(|d| size(d, "width")).fold(0.0, f64::max);
    let (mut inner, mut y) = (String::new(), 0.0);
    for drawing in drawings {
        inner += &format!("<g transform=\"translate(0 {y:.0})\">\n{drawing}</g>\n");
        y += size(drawing, "height");
    }
    let size = format!("viewBox=\"0 0 {width:.0} {y:.0}\" width=\"{width:.0}\" height=\"{y:.0}\"");
    format!("<svg xmlns=\"http://www.w3.org/2000/svg\" {size}>\n{inner}</svg>\n")
}

impl fmt::Display for Listing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let edge = &self.measured[self.first].edge;
        let r = edge.region;
        writeln!(f, "{}: {}", in_line(&self.image), in_line(&self.source))?;
        writeln!(
            f,
            "edge at {:.3}° ± {:.3}° from vertical through ({:.2}, {:.2}) px, region {},{},{},{}, {}",
            edge.angle_deg,
            1.96 * edge.angle_uncertainty_deg,
            edge.position[0],
            edge.position[1],
            r.x,
            r.y,
            r.width,
            r.height,
            if edge.sagitta == 0.0 { "straight".into() } else { format!("bent by {:.3} px (parabola)", edge.sagitta) }
        )?;
        write!(f, "{}", table(&CHANNELS, &self.measured))?;
        for (name, px) in self.lateral() {
            writeln!(f, "{name} lies {px:+.3} px from G along the edge's normal (right or down is positive)")?;
        }
        let heading = self.measured.iter().map(|m| format!("{} (± 95 %)", m.name));
        let mut table = Table::new(std::iter::once("cy/px".to_owned()).chain(heading));
        for (i, point) in edge.mtf.iter().enumerate().step_by(STEP) {
            let cell = |m: &Measured| match m.edge.mtf.get(i) {
                Some(p) => format!("{:.4} ± {:.4}", p.value, m.edge.coverage * p.uncertainty),
                None => "-".into(),
            };
            table.row(std::iter::once(format!("{:.2}", point.frequency)).chain(self.measured.iter().map(cell)));
        }
        write!(f, "{table}")
    }
}
