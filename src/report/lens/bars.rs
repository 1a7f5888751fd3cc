//! Third-order sums by surface as bars.

use crate::report::svg::{Anchor, HUES, Svg};
use crate::report::table::significant;

const WIDTH: f64 = 1120.0;
const HEIGHT: f64 = 300.0;
/// Left, right, top, bottom of the drawn area, px.
const FRAME: [f64; 4] = [64.0, 1110.0, 40.0, 262.0];

/// Groups of bars, `(name, values)`, in the colours of `names`; the last group is set off by a line.
pub(super) fn bars(title: &str, unit: &str, names: &[&str], groups: &[(String, Vec<f64>)]) -> String {
    let mut svg = Svg::new(WIDTH, HEIGHT);
    svg.attributes("data-wide=\"\"");
    let largest =
        groups.iter().flat_map(|g| &g.1).fold(0.0, |m: f64, v| if v.is_finite() { m.max(v.abs()) } else { m });
    let [left, right, top, bottom] = FRAME;
    svg.text([left, 16.0], Anchor::Start, 15.0, title);
    let top_value = if largest > 0.0 { 1.08 * largest } else { 1.0 };
    let y = |v: f64| 0.5 * (top + bottom) - v / top_value * 0.5 * (bottom - top);
    for v in [-largest, 0.0, largest] {
        svg.line([left, y(v)], [right, y(v)], "stroke=\"currentColor\" stroke-opacity=\".2\"");
        svg.text([left - 7.0, y(v) + 4.0], Anchor::End, 12.0, &significant(v, 3));
    }
    svg.turned_text([16.0, 0.5 * (top + bottom)], Anchor::Middle, 13.0, -90.0, unit);
    #[expect(clippy::cast_precision_loss, reason = "few bars")]
    let (step, inner) = ((right - left) / groups.len().max(1) as f64, names.len() as f64 + 1.0);
    for (g, (name, values)) in groups.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "few bars")]
        let from = left + g as f64 * step;
        if g + 1 == groups.len() {
            svg.line([from, top], [from, bottom], "stroke=\"currentColor\" stroke-opacity=\".4\"");
        }
        svg.text([from + 0.5 * step, bottom + 17.0], Anchor::Middle, 12.0, name);
        for (k, v) in values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            #[expect(clippy::cast_precision_loss, reason = "few bars")]
            let [a, b] = [0.5, 1.5].map(|h| from + (k as f64 + h) / inner * step);
            let fill = format!("fill=\"{}\"", HUES[k % HUES.len()]);
            svg.polygon(&[[a, y(0.0)], [b - 1.0, y(0.0)], [b - 1.0, y(*v)], [a, y(*v)]], &fill);
        }
    }
    let mut x = left;
    for (name, hue) in names.iter().zip(HUES) {
        svg.dot([x + 4.0, HEIGHT - 8.0], 4.0, hue);
        svg.text([x + 14.0, HEIGHT - 4.0], Anchor::Start, 12.0, name);
        x += 150.0;
    }
    svg.finish(title)
}
