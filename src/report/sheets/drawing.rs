//! The cross-section of one element with its dimensions.

use crate::report::svg::{Anchor, Svg};
use crate::report::table::significant;
use isoplanat_optics::analysis::fabrication::element::Element;
use isoplanat_optics::analysis::fabrication::face::Face;

use super::words::fixed;

/// Largest size of the glass, px: along the axis, across it.
const GLASS: [f64; 2] = [230.0, 230.0];
/// Room for dimensions and names: left, top, right, px.
const ROOM: [f64; 3] = [96.0, 62.0, 96.0];
/// Lines of dimensions below the glass, at most, and their distance, px.
const BELOW: usize = 3;
const LINE: f64 = 20.0;
const LETTERS: f64 = 13.0;
/// Half the points of a face.
const STEPS: i32 = 40;
const DIMENSION: &str = "stroke=\"currentColor\" stroke-width=\"1\" stroke-opacity=\".75\"";
/// From the glass to a dimension.
const EXTENSION: &str = "stroke=\"currentColor\" stroke-width=\"1\" stroke-opacity=\".25\"";

/// Glass with flat rims, thickness on the axis and at the rim, mechanical diameter, clear diameters of the first and the last face.
pub(super) fn element_svg(e: &Element) -> String {
    let scale = (GLASS[0] / e.length_mm).min(GLASS[1] / e.diameter_mm);
    let [left, top, right] = ROOM;
    #[expect(clippy::cast_precision_loss, reason = "at most three")]
    let bottom = 12.0 + LINE * e.glasses.len().min(BELOW) as f64;
    let width = (e.length_mm * scale + left + right).ceil();
    let view = View { e, scale, width };
    let mut svg = Svg::new(width, (e.diameter_mm * scale + top + bottom).ceil());
    view.glass(&mut svg);
    let axis = view.at(0.0, 0.0)[1];
    let ends = [[left - 14.0, axis], [width - right + 14.0, axis]];
    svg.line(ends[0], ends[1], &format!("{DIMENSION} stroke-dasharray=\"9 3 2 3\""));
    view.thicknesses(&mut svg);
    view.diameters(&mut svg);
    for (x, face) in [(left - 14.0, &e.faces[0]), (width - right + 24.0, &e.faces[e.faces.len() - 1])] {
        svg.text([x, 20.0], Anchor::Middle, LETTERS, &format!("face {}", face.surface));
    }
    svg.finish(&format!("Cross-section of element {}", e.number))
}

/// An element on its drawing.
struct View<'a> {
    e: &'a Element,
    /// px a mm.
    scale: f64,
    /// Of the drawing, px.
    width: f64,
}

impl View<'_> {
    /// A point of the meridian, mm from the first vertex, in px.
    fn at(&self, z: f64, y: f64) -> [f64; 2] {
        let [left, top, ..] = ROOM;
        [left + (z - self.e.foremost_mm) * self.scale, top + (self.e.radius_mm() - y) * self.scale]
    }

    /// The outline of each glass.
    fn glass(&self, svg: &mut Svg) {
        let (vertices, radius) = (self.e.vertices(), self.e.radius_mm());
        let side = |j: usize| -> Vec<[f64; 2]> {
            let clear = self.e.faces[j].clear_mm();
            let curve = (-STEPS..=STEPS).map(|s| clear * f64::from(s) / f64::from(STEPS));
            let all = std::iter::once(-radius).chain(curve).chain(std::iter::once(radius));
            all.map(|y| self.at(vertices[j] + self.e.faces[j].rimmed_sag(y.abs()), y)).collect()
        };
        for (k, glass) in self.e.glasses.iter().enumerate() {
            let outline: Vec<[f64; 2]> = side(k).into_iter().chain(side(k + 1).into_iter().rev()).collect();
            // Denser glass, darker fill.
            let fill = (0.10 + 0.35 * (glass.n_primary - 1.45)).clamp(0.10, 0.30);
            let style =
                format!("fill=\"#4a90d9\" fill-opacity=\"{fill:.2}\" stroke=\"currentColor\" stroke-width=\"1.3\"");
            svg.polygon(&outline, &style);
        }
    }

    /// On the axis below the glass, of several glasses one below the other; at the rim above it.
    fn thicknesses(&self, svg: &mut Svg) {
        let (vertices, radius) = (self.e.vertices(), self.e.radius_mm());
        let ([_, top], [_, bottom], [_, axis]) = (self.at(0.0, radius), self.at(0.0, -radius), self.at(0.0, 0.0));
        for (k, glass) in self.e.glasses.iter().enumerate() {
            let [a, b] = [vertices[k], vertices[k + 1]].map(|z| self.at(z, 0.0)[0]);
            #[expect(clippy::cast_precision_loss, reason = "one of three lines")]
            let y = bottom + 16.0 + LINE * (k % BELOW) as f64;
            for x in [a, b] {
                svg.line([x, axis], [x, y + 4.0], EXTENSION);
            }
            across(svg, a, b, y, &significant(glass.centre_thickness_mm, 6));
        }
        let last = self.e.faces.len() - 1;
        let [a, b] = [0, last].map(|j| self.at(vertices[j] + self.e.faces[j].rimmed_sag(radius), 0.0)[0]);
        let y = top - 14.0;
        for x in [a, b] {
            svg.line([x, top], [x, y - 4.0], DIMENSION);
        }
        across(svg, a, b, y, &fixed(self.e.edges.flat_mm, 4));
    }

    /// The mechanical diameter and the first clear one on the left, the last clear one on the right.
    fn diameters(&self, svg: &mut Svg) {
        let e = self.e;
        let (front, rear) = (&e.faces[0], &e.faces[e.faces.len() - 1]);
        let rim = |f: &Face, vertex: f64, height: f64| self.at(vertex + f.rimmed_sag(height), 0.0)[0];
        let behind = e.centre_thickness_mm;
        self.upright(svg, 20.0, e.radius_mm(), rim(front, 0.0, e.radius_mm()), "⌀");
        self.upright(svg, 56.0, front.clear_mm(), rim(front, 0.0, front.clear_mm()), "⌀e");
        self.upright(svg, self.width - 46.0, rear.clear_mm(), rim(rear, behind, rear.clear_mm()), "⌀e");
    }

    /// A diameter of twice `radius` at `x`, with lines to the glass at `from`.
    fn upright(&self, svg: &mut Svg, x: f64, radius: f64, from: f64, symbol: &str) {
        let [[_, high], [_, low]] = [radius, -radius].map(|y| self.at(0.0, y));
        for (y, way) in [(high, 1.0), (low, -1.0)] {
            svg.line([from, y], [x, y], EXTENSION);
            svg.polyline(&[[x - 3.0, y + 8.0 * way], [x, y], [x + 3.0, y + 8.0 * way]], DIMENSION);
        }
        svg.line([x, high], [x, low], DIMENSION);
        let text = format!("{symbol} {}", significant(2.0 * radius, 6));
        svg.turned_text([x - 5.0, 0.5 * (high + low) - 8.0], Anchor::Start, LETTERS, -90.0, &text);
    }
}

/// A dimension along the axis between `a` and `b`; arrows stand outside where there is no room between.
fn across(svg: &mut Svg, a: f64, b: f64, y: f64, text: &str) {
    let (low, high) = (a.min(b), a.max(b));
    let inside = high - low > 24.0;
    let (way, beyond) = if inside { (8.0, 0.0) } else { (-8.0, 14.0) };
    for (x, way) in [(low, way), (high, -way)] {
        svg.polyline(&[[x + way, y - 3.0], [x, y], [x + way, y + 3.0]], DIMENSION);
    }
    svg.line([low - beyond, y], [high + beyond, y], DIMENSION);
    svg.text([high + beyond + 8.0, y + 4.5], Anchor::Start, LETTERS, text);
}
