//! Spot diagrams: one panel a field, all at one scale, colours of the wavelengths, the Airy disc for comparison.

use glam::DVec2;

use crate::report::svg::{Anchor, HUES, Svg, escape};
use crate::report::table::significant;
use isoplanat_optics::analysis::overview::Overview;

/// Side of a panel, and room between panels and below them, px.
const PANEL: f64 = 176.0;
const GAP: f64 = 8.0;
const HEAD: f64 = 24.0;
const FOOT: f64 = 40.0;

/// Panels of every field `dz` mm behind the image plane, each about the centroid of all its rays; `half_mm` is half a panel's side, `only`
/// a wavelength that is shown alone.
pub(super) fn panels(overview: &Overview, dz: f64, half_mm: f64, only: Option<usize>) -> String {
    let count = overview.fields.len();
    #[expect(clippy::cast_precision_loss, reason = "few fields")]
    let left = |k: usize| GAP + k as f64 * (PANEL + GAP);
    #[expect(clippy::cast_precision_loss, reason = "few wavelengths")]
    let legend = GAP + 0.5 * PANEL + 80.0 + 78.0 * overview.colours.len() as f64;
    let width = left(count).max(legend);
    let mut svg = Svg::new(width, HEAD + PANEL + FOOT);
    svg.attributes("data-wide=\"\"");
    let scale = 0.5 * PANEL / half_mm;
    for (k, field) in overview.fields.iter().enumerate() {
        let middle = [left(k) + 0.5 * PANEL, HEAD + 0.5 * PANEL];
        svg.open(&format!("class=\"s\" data-key=\"{}\"", key(k)));
        svg.text([middle[0], HEAD - 8.0], Anchor::Middle, 12.0, &format!("{}°", significant(field.angle_deg, 4)));
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        svg.polygon(
            &corners.map(|[x, y]: [f64; 2]| [middle[0] + x * PANEL, middle[1] + y * PANEL]),
            "fill=\"currentColor\" fill-opacity=\".03\" stroke=\"currentColor\" stroke-opacity=\".25\"",
        );
        let rays = field.drawn.iter().flatten().collect::<Vec<_>>();
        if rays.is_empty() {
            svg.text(middle, Anchor::Middle, 12.0, "no light");
        } else {
            #[expect(clippy::cast_precision_loss, reason = "few rays")]
            let centre = rays.iter().map(|l| l.at_focus(dz)).sum::<DVec2>() / rays.len() as f64;
            let inside = |p: &[f64; 2]| (0..2).all(|i| (p[i] - middle[i]).abs() <= 0.5 * PANEL - 1.0);
            for (k, (landings, hue)) in field.drawn.iter().zip(HUES.into_iter().cycle()).enumerate() {
                if only.is_some_and(|only| only != k) {
                    continue;
                }
                let place = |p: DVec2| [middle[0] + (p.x - centre.x) * scale, middle[1] - (p.y - centre.y) * scale];
                let dots: Vec<[f64; 2]> = landings.iter().map(|l| place(l.at_focus(dz))).filter(inside).collect();
                svg.dots(&dots, 1.1, hue);
            }
            let airy = overview.airy_radius * scale;
            if airy < 0.5 * PANEL {
                svg.circle(middle, airy, "stroke=\"currentColor\" stroke-width=\"1.4\" stroke-dasharray=\"3 3\"");
            }
        }
        svg.close();
    }
    let below = HEAD + PANEL + 26.0;
    let bar = round_below(0.4 * half_mm);
    svg.line([GAP, below], [GAP + bar * scale, below], "stroke=\"currentColor\" stroke-width=\"2\"");
    let mut x = GAP + bar * scale + 8.0;
    let label = format!("{} µm", significant(bar * 1e3, 3));
    svg.text([x, below + 4.0], Anchor::Start, 12.0, &label);
    x += 72.0;
    for (k, ((nm, _), hue)) in overview.colours.iter().zip(HUES.into_iter().cycle()).enumerate() {
        if only.is_some_and(|only| only != k) {
            continue;
        }
        svg.dot([x, below], 3.4, hue);
        svg.text([x + 8.0, below + 4.0], Anchor::Start, 12.0, &format!("{} nm", significant(*nm, 4)));
        x += 78.0;
    }
    svg.finish(&escape(&format!("Spots {} mm behind the image plane", significant(dz, 3))))
}

/// Key of a field's series and panels.
pub(super) fn key(field: usize) -> String {
    format!("f{field}")
}

/// The half side that holds the spots on the sensor with some room, mm.
pub(super) fn half_side(overview: &Overview) -> f64 {
    let largest = overview.fields.iter().filter_map(|f| f.spot).map(|s| s.radius.min(4.0 * s.rms)).fold(0.0, f64::max);
    let airy = if overview.airy_radius.is_finite() { overview.airy_radius } else { 0.0 };
    let half = 1.25 * largest.max(1.2 * airy);
    if half.is_finite() && half > 0.0 { half } else { 0.01 }
}

/// The largest of 1, 2, 5 times a power of ten up to `value`.
fn round_below(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0].map(|f| f * power).into_iter().find(|v| *v <= value).unwrap_or(power)
}
