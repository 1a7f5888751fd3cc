//! Small plots as SVG: lines and points on linear or logarithmic axes.

use super::svg::{Anchor, HUES, Svg, escape, text_width};
use super::table::significant;

/// How an axis runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    #[default]
    Linear,
    /// In decades; values that are not positive are left out.
    Log,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mark {
    /// Connected.
    #[default]
    Line,
    /// Dots.
    Dots,
    /// Connected dots.
    Both,
    /// Connected by dashes, in the colour of the series before.
    Dashed,
}

impl Mark {
    /// Attributes of the line, if there is one.
    fn dashes(self) -> Option<&'static str> {
        match self {
            Self::Dots => None,
            Self::Line | Self::Both => Some(""),
            Self::Dashed => Some(" stroke-dasharray=\"5 4\""),
        }
    }

    /// Whether points are dots.
    fn dotted(self) -> bool {
        matches!(self, Self::Dots | Self::Both)
    }
}

/// Named points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Name, for the legend; empty leaves it out.
    pub name: String,
    /// `[x, y]`; pairs that are not finite interrupt nothing and are left out.
    pub points: Vec<[f64; 2]>,
    /// How it is drawn.
    pub mark: Mark,
}

/// A plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// Heading.
    pub title: String,
    /// What runs to the right, with its unit.
    pub x_label: String,
    /// What runs upwards, with its unit.
    pub y_label: String,
    /// Scale of x.
    pub x_scale: Scale,
    /// Scale of y.
    pub y_scale: Scale,
    /// What is shown.
    pub series: Vec<Series>,
    /// What each series belongs to, in their order: series of one key stand out together on a page. Missing or empty: to nothing.
    pub keys: Vec<String>,
}

// As wide as makes the letters readable on a phone.
const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 306.0;
/// Left, right, top, bottom of the drawn area, px.
const FRAME: [f64; 4] = [62.0, 426.0, 56.0, 254.0];

/// Letters of a heading that has room, px.
const TITLE: f64 = 15.0;
/// Height of the first row of names.
const FIRST_ROW: f64 = 40.0;

/// A series' name and where it stands.
struct Name<'a> {
    series: &'a Series,
    hue: &'static str,
    at: [f64; 2],
}

/// One axis: its ends and ticks, in transformed values.
struct Axis {
    scale: Scale,
    low: f64,
    high: f64,
    ticks: Vec<f64>,
}

impl Plot {
    /// Whether it says more than numbers in a sentence would: points at two places or more are drawn.
    pub(crate) fn is_telling(&self) -> bool {
        let mut places = self.series.iter().flat_map(|s| self.shown(s)).map(|p| p[0]);
        places.next().is_some_and(|first| places.any(|x| x != first))
    }

    /// The drawing; without a single point it shows its axes and says so.
    pub fn to_svg(&self) -> String {
        let shown: Vec<Vec<[f64; 2]>> = self.series.iter().map(|s| self.shown(s)).collect();
        let values = |k: usize| shown.iter().flatten().map(move |p| p[k]).collect::<Vec<f64>>();
        let (x_axis, y_axis) = (Axis::new(self.x_scale, &values(0)), Axis::new(self.y_scale, &values(1)));
        let names = self.names();
        // Every row of names but the first moves the area down.
        let down = names.last().map_or(0.0, |n| n.at[1] - FIRST_ROW);
        let ([left, right, top, bottom], height) =
            ([FRAME[0], FRAME[1], FRAME[2] + down, FRAME[3] + down], HEIGHT + down);
        let at =
            |p: [f64; 2]| [left + x_axis.share(p[0]) * (right - left), bottom - y_axis.share(p[1]) * (bottom - top)];
        let mut svg = Svg::new(WIDTH, height);
        let size = TITLE.min(TITLE * (WIDTH - left - 4.0) / text_width(&self.title, TITLE).max(1.0));
        svg.text([left, 20.0], Anchor::Start, size, &self.title);
        let grid = "stroke=\"currentColor\" stroke-opacity=\".14\"";
        for t in &x_axis.ticks {
            let x = at([x_axis.value(*t), y_axis.value(y_axis.low)])[0];
            svg.line([x, top], [x, bottom], grid);
            let label = x_axis.label(*t);
            let middle = x.min(WIDTH - 1.0 - 0.5 * text_width(&label, 12.0));
            svg.text([middle, bottom + 17.0], Anchor::Middle, 12.0, &label);
        }
        for t in &y_axis.ticks {
            let y = at([x_axis.value(x_axis.low), y_axis.value(*t)])[1];
            svg.line([left, y], [right, y], grid);
            svg.text([left - 7.0, y + 4.0], Anchor::End, 12.0, &y_axis.label(*t));
        }
        svg.polyline(&[[left, top], [left, bottom], [right, bottom]], "stroke=\"currentColor\" stroke-opacity=\".6\"");
        svg.text([0.5 * (left + right), height - 12.0], Anchor::Middle, 13.0, &self.x_label);
        svg.turned_text([16.0, 0.5 * (top + bottom)], Anchor::Middle, 13.0, -90.0, &self.y_label);
        if shown.iter().all(Vec::is_empty) {
            svg.text([0.5 * (left + right), 0.5 * (top + bottom)], Anchor::Middle, 13.0, "no data");
        }
        svg.attributes(&format!("data-x=\"{}\" data-y=\"{}\"", escape(&self.x_label), escape(&self.y_label)));
        let keys = self.keys.iter().map(String::as_str).chain(std::iter::repeat(""));
        for (((series, points), hue), key) in self.series.iter().zip(&shown).zip(self.hues()).zip(keys) {
            let placed: Vec<[f64; 2]> = points.iter().map(|p| at(*p)).collect();
            svg.open(&Self::described(series, key, points));
            match series.mark.dashes().filter(|_| placed.len() > 1) {
                Some(dashes) => svg.polyline(&placed, &format!("stroke=\"{hue}\" stroke-width=\"1.8\"{dashes}")),
                None => svg.polyline(&placed, "stroke=\"none\""),
            }
            if series.mark.dotted() || placed.len() == 1 {
                placed.iter().for_each(|p| svg.dot(*p, 3.6, hue));
            }
            svg.close();
        }
        for Name { series, hue, at: [x, y] } in names {
            if let Some(dashes) = series.mark.dashes() {
                svg.line([x, y], [x + 16.0, y], &format!("stroke=\"{hue}\" stroke-width=\"2.5\"{dashes}"));
            }
            if series.mark.dotted() {
                svg.dot([x + 8.0, y], 3.6, hue);
            }
            svg.text([x + 21.0, y + 4.0], Anchor::Start, 12.0, &series.name);
        }
        svg.finish(&self.title)
    }

    /// What a page's script reads of a series: its name, what it belongs to, the values of the points of its line in order.
    fn described(series: &Series, key: &str, points: &[[f64; 2]]) -> String {
        let values: Vec<String> =
            points.iter().map(|p| format!("{},{}", significant(p[0], 6), significant(p[1], 6))).collect();
        let key = if key.is_empty() { String::new() } else { format!(" data-key=\"{}\"", escape(key)) };
        format!("class=\"s\" data-name=\"{}\"{key} data-v=\"{}\"", escape(&series.name), values.join(" "))
    }

    /// Places of the names above the area, row by row.
    fn names(&self) -> Vec<Name<'_>> {
        let [mut x, mut y] = [FRAME[0], FIRST_ROW];
        let named = self.series.iter().zip(self.hues()).filter(|(s, _)| !s.name.is_empty());
        let place = |(series, hue): (_, _)| {
            let series: &Series = series;
            let width = 34.0 + text_width(&series.name, 12.0);
            if x + width > WIDTH + 14.0 && x > FRAME[0] {
                [x, y] = [FRAME[0], y + 18.0];
            }
            let at = [x, y];
            x += width;
            Name { series, hue, at }
        };
        named.map(place).collect()
    }

    /// Colour of each series: in order, dashed ones as the one before.
    fn hues(&self) -> Vec<&'static str> {
        let mut next = 0;
        let hue = |s: &Series| {
            next += usize::from(s.mark != Mark::Dashed || next == 0);
            HUES[(next - 1) % HUES.len()]
        };
        self.series.iter().map(hue).collect()
    }

    /// The points that stand on both axes.
    fn shown(&self, series: &Series) -> Vec<[f64; 2]> {
        let stands = |v: f64, scale: Scale| v.is_finite() && (scale == Scale::Linear || v > 0.0);
        let kept = series.points.iter().filter(|p| stands(p[0], self.x_scale) && stands(p[1], self.y_scale));
        kept.copied().collect()
    }
}

impl Axis {
    /// The axis that holds `values`.
    fn new(scale: Scale, values: &[f64]) -> Self {
        let transformed = values.iter().map(|v| if scale == Scale::Log { v.log10() } else { *v });
        let (mut low, mut high) =
            transformed.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // A single value gets some room on both sides.
        if high - low <= 1e-12 * high.abs().max(low.abs()) {
            let room = if scale == Scale::Log || low == 0.0 { 0.5 } else { 0.1 * low.abs() };
            (low, high) = (low - room, high + room);
        }
        // Values close above zero are shown from zero.
        if scale == Scale::Linear && low > 0.0 && low < 0.4 * high {
            low = 0.0;
        }
        let ticks = if scale == Scale::Log { decades(low, high) } else { even(low, high) };
        let (first, last) = (ticks[0], ticks[ticks.len() - 1]);
        Self { scale, low: low.min(first), high: high.max(last), ticks }
    }

    fn value(&self, transformed: f64) -> f64 {
        if self.scale == Scale::Log { 10f64.powf(transformed) } else { transformed }
    }

    /// Place of `value` between the ends.
    fn share(&self, value: f64) -> f64 {
        let transformed = if self.scale == Scale::Log { value.log10() } else { value };
        (transformed - self.low) / (self.high - self.low)
    }

    fn label(&self, tick: f64) -> String {
        let value = self.value(tick);
        if self.scale == Scale::Linear && value.abs() < 1e-9 * (self.high - self.low) {
            return "0".into();
        }
        if self.scale == Scale::Log && value < 9e-4 {
            return format!("{value:.0e}");
        }
        significant(value, 4)
    }
}

/// Round values a step of 1, 2 or 5 times a power of ten apart that enclose the range.
fn even(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|f| f * power).into_iter().find(|s| *s >= rough).unwrap_or(10.0 * power);
    let (first, last) = ((low / step + 1e-9).floor(), (high / step - 1e-9).ceil());
    let mut ticks = Vec::new();
    let mut k = first;
    while k <= last {
        ticks.push(k * step);
        k += 1.0;
    }
    ticks
}

/// Powers of ten that enclose the range, with 2 and 5 where there are few, every second or third where there are many.
fn decades(low: f64, high: f64) -> Vec<f64> {
    let (first, last) = ((low + 1e-9).floor(), (high - 1e-9).ceil());
    let stride = ((last - first) / 6.0).ceil().max(1.0);
    let mut ticks = Vec::new();
    let mut k = first;
    while k < last + stride - 0.5 {
        ticks.push(k);
        if last - first <= 2.0 && k < last - 0.5 {
            ticks.extend([2f64, 5.0].map(|f| k + f.log10()));
        }
        k += stride;
    }
    ticks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(x_scale: Scale, y_scale: Scale, points: Vec<[f64; 2]>) -> Plot {
        let series = vec![Series { name: "a < b".into(), points, mark: Mark::Both }];
        Plot { title: "t".into(), x_label: "x".into(), y_label: "y".into(), x_scale, y_scale, series, keys: vec![] }
    }

    #[test]
    fn ticks_are_round_and_enclose_the_range() {
        assert_eq!(even(0.0, 10.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(even(-0.3, 0.9), [-0.5, 0.0, 0.5, 1.0]);
        assert_eq!(decades(-3.0, 2.0), [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0]);
        assert_eq!(decades(0.1, 0.9).len(), 4);
        assert!(decades(-10.0, 10.0).len() < 9);
        for (low, high) in [(0.0, 1e-7), (3.0, 3.1), (-5.0, 1e6)] {
            let ticks = even(low, high);
            assert!(ticks[0] <= low && *ticks.last().expect("some") >= high && ticks.len() <= 9, "{ticks:?}");
        }
    }

    #[test]
    fn whatever_the_points_the_drawing_has_numbers_only() {
        let odd = [
            vec![],
            vec![[1.0, 2.0]],
            vec![[0.0, 0.0], [0.0, 0.0]],
            vec![[f64::NAN, 1.0], [1.0, f64::INFINITY], [-1.0, 3.0]],
            vec![[1e-9, 1e9], [1e9, 1e-9]],
        ];
        for points in odd {
            for x in [Scale::Linear, Scale::Log] {
                for y in [Scale::Linear, Scale::Log] {
                    let svg = plot(x, y, points.clone()).to_svg();
                    assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{points:?} {x:?} {y:?}: {svg}");
                    assert!(svg.contains("a &lt; b"));
                }
            }
        }
        assert!(plot(Scale::Log, Scale::Log, vec![[-1.0, 1.0]]).to_svg().contains("no data"));
    }

    #[test]
    fn dashed_series_share_the_colour_of_the_one_before() {
        let mut plot = plot(Scale::Linear, Scale::Linear, vec![[0.0, 1.0], [1.0, 2.0]]);
        let mark = |mark| Series { mark, ..plot.series[0].clone() };
        plot.series = [Mark::Dashed, Mark::Both, Mark::Dashed, Mark::Line].map(mark).to_vec();
        assert_eq!(plot.hues(), [HUES[0], HUES[1], HUES[1], HUES[2]]);
        assert_eq!(plot.to_svg().matches("stroke-dasharray").count(), 4, "two lines and their legends");
    }

    #[test]
    fn points_stand_where_they_belong() {
        let svg = plot(Scale::Linear, Scale::Log, vec![[0.0, 1.0], [10.0, 1000.0]]).to_svg();
        assert!(svg.contains("cx=\"62.00\" cy=\"254.00\"") && svg.contains("cx=\"426.00\" cy=\"56.00\""), "{svg}");
    }
}
