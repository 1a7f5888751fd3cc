//! MTF before and after reconstruction of the cameras of a comparison, by slanted edges ([`crate::report::measured`]).

use serde::{Deserialize, Serialize};

use super::Entrant;
use crate::report::measured::Curves;
use crate::report::plot::{Mark, Plot, Series};
use crate::report::table::{Table, significant};

/// Frequencies of the table, cycles a pixel.
const QUARTER: f64 = 0.25;
const HALF: f64 = 0.5;
/// Where curves are drawn, fortieths of [`HALF`].
const FREQUENCIES: std::ops::RangeInclusive<u8> = 0..=40;

/// Edges of one camera at one distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EdgesAt {
    /// Object distance, mm.
    pub depth_mm: f64,
    /// What could not be measured or is doubtful, a sentence each.
    pub missing: Vec<String>,
    /// From the axis outwards.
    pub curves: Vec<Curves>,
}

/// The modulation at a frequency, between the points of a curve.
fn at(points: &[[f64; 2]], frequency: f64) -> Option<f64> {
    let next = points.iter().position(|p| p[0] >= frequency - 1e-9)?;
    let [f, value] = points[next];
    let Some([f0, before]) = next.checked_sub(1).map(|k| points[k]) else { return Some(value) };
    let part = if f > f0 { ((frequency - f0) / (f - f0)).min(1.0) } else { 1.0 };
    Some(before + part * (value - before))
}

/// How far a curve rises again behind its lowest point: contrast that has come back, of a turned sign as a rule.
fn again(points: &[[f64; 2]]) -> Option<f64> {
    let mut lowest = f64::INFINITY;
    let mut most = 0.0f64;
    for [_, value] in points {
        lowest = lowest.min(*value);
        most = most.max(value - lowest);
    }
    (!points.is_empty()).then_some(most)
}

/// The mean of what is there.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let all: Vec<f64> = values.flatten().collect();
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let n = all.len() as f64;
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / n)
}

impl EdgesAt {
    /// The edges next to the axis, and those farthest out.
    fn ends(&self) -> [Vec<&Curves>; 2] {
        let of = |height: Option<f64>| self.curves.iter().filter(|c| Some(c.height_mm) == height).collect();
        [of(self.curves.first().map(|c| c.height_mm)), of(self.curves.last().map(|c| c.height_mm))]
    }
}

/// Modulation of capture and reconstruction next to the axis and farthest out at each distance, the mean of the two directions.
pub(super) fn table(entrants: &[Entrant]) -> Table {
    let mut table =
        Table::new(["lens", "distance, mm", "height, mm", "MTF at 1/4 cy/px", "at 1/2 cy/px", "rises again by"]);
    let words = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:.2}"));
    for e in entrants {
        for edges in &e.edges {
            let [axis, end] = edges.ends();
            let one = axis.first().map(|c| c.height_mm) == end.first().map(|c| c.height_mm);
            for some in [Some(axis), (!one).then_some(end)].into_iter().flatten().filter(|s| !s.is_empty()) {
                let over = |of: &dyn Fn(&[[f64; 2]]) -> Option<f64>| {
                    let [before, after] =
                        [mean(some.iter().map(|c| of(&c.capture))), mean(some.iter().map(|c| of(&c.reconstruction)))];
                    format!("{} → {}", words(before), words(after))
                };
                table.row([
                    e.label(),
                    significant(edges.depth_mm, 5),
                    significant(some[0].height_mm, 4),
                    over(&|c| at(c, QUARTER)),
                    over(&|c| at(c, HALF)),
                    over(&again),
                ]);
            }
        }
    }
    table
}

/// Curves of the place nearest the axis at each distance, the mean of the two directions; modulation at a quarter of a cycle a pixel over the field at each; captures dashed.
pub(super) fn plots(entrants: &[Entrant]) -> Vec<Plot> {
    let count = entrants.iter().map(|e| e.edges.len()).max().unwrap_or(0);
    let mut plots = Vec::new();
    let both = |name: String, after: Vec<[f64; 2]>, before: Vec<[f64; 2]>, mark: Mark| {
        [Series { name, points: after, mark }, Series { name: String::new(), points: before, mark: Mark::Dashed }]
    };
    for depth in 0..count {
        let there = || entrants.iter().filter_map(|e| Some((e, e.edges.get(depth)?)));
        let Some(depth_mm) = there().map(|(_, edges)| edges.depth_mm).next() else { continue };
        let from = format!("from {} mm", significant(depth_mm, 5));
        let (mut on_axis, mut over_field) = (Vec::new(), Vec::new());
        for (e, edges) in there() {
            let [nearest, _] = edges.ends();
            let curve = |of: &dyn Fn(&Curves) -> Vec<[f64; 2]>| -> Vec<[f64; 2]> {
                let all: Vec<Vec<[f64; 2]>> = nearest.iter().map(|c| of(c)).collect();
                let there = FREQUENCIES.map(|k| HALF * f64::from(k) / 40.0);
                there.filter_map(|f| Some([f, mean(all.iter().map(|points| at(points, f)))?])).collect()
            };
            let (after, before) = (curve(&|c| c.reconstruction.clone()), curve(&|c| c.capture.clone()));
            on_axis.extend(both(e.label(), after, before, Mark::Line));
            let mut heights: Vec<f64> = edges.curves.iter().map(|c| c.height_mm).collect();
            heights.dedup();
            let over = |of: &dyn Fn(&Curves) -> Option<f64>| -> Vec<[f64; 2]> {
                let here = |h: f64| edges.curves.iter().filter(move |c| c.height_mm == h);
                heights.iter().filter_map(|h| Some([*h, mean(here(*h).map(of))?])).collect()
            };
            let (after, before) = (over(&|c| at(&c.reconstruction, QUARTER)), over(&|c| at(&c.capture, QUARTER)));
            over_field.extend(both(e.label(), after, before, Mark::Both));
        }
        let plot = |title: String, x_label: &str, series: Vec<Series>| Plot {
            title,
            x_label: x_label.into(),
            y_label: "MTF with the pixel".into(),
            series,
            ..Plot::default()
        };
        plots.push(plot(format!("Nearest the axis, {from}"), "cycles a pixel", on_axis));
        let title = format!("At 1/4 cycle a pixel, {from}");
        plots.push(plot(title, "distance from the axis on the sensor, mm", over_field));
    }
    plots.retain(|p| p.series.iter().any(|s| s.points.len() > 1));
    plots
}

/// What could not be measured, a line each.
pub(super) fn missing(entrants: &[Entrant]) -> Vec<String> {
    let of = |e: &Entrant| -> Vec<String> {
        let line =
            |edges: &EdgesAt, why: &String| format!("{}, {} mm: {why}", e.label(), significant(edges.depth_mm, 5));
        e.edges
            .iter()
            .flat_map(|edges| edges.missing.iter().map(move |why| line(edges, why)).collect::<Vec<_>>())
            .collect()
    };
    entrants.iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values between points, the contrast that comes back behind a zero, and none where nothing was measured.
    #[test]
    fn curves_are_read_between_their_points() {
        let curve = [[0.0, 1.0], [0.2, 0.6], [0.3, 0.2], [0.4, 0.0], [0.5, 0.15]];
        assert_eq!(at(&curve, 0.2), Some(0.6));
        assert!((at(&curve, 0.25).expect("within") - 0.4).abs() < 1e-12);
        assert_eq!(at(&curve, 0.5), Some(0.15));
        assert_eq!(at(&curve, 0.6), None);
        assert_eq!(again(&curve), Some(0.15));
        assert_eq!(again(&curve[..4]), Some(0.0));
        assert_eq!((again(&[]), at(&[], 0.1)), (None, None));
        assert_eq!(mean([Some(1.0), None, Some(3.0)].into_iter()), Some(2.0));
        assert_eq!(mean([None].into_iter()), None);
    }
}
