//! A few SVG elements, readable on light and on dark pages.
//!
//! Lines and texts take the page's own colour (`currentColor`); a drawing that stands alone brings a background. The
//! hues of `HUES` have enough contrast on white and on near-black.

use std::fmt::Write;

/// Colours of fields and series, in order.
pub(crate) const HUES: [&str; 10] =
    ["#3b82d6", "#2f9e5f", "#d9572b", "#9b6dd0", "#b58900", "#2a9d9d", "#c94f8c", "#7d838b", "#a0703a", "#6f7fe0"];

/// Colours only where the drawing is a document of its own.
const STYLE: &str = "svg:root{background:#fff;color:#1d2329}\
    @media(prefers-color-scheme:dark){svg:root{background:#14181d;color:#dce2e9}}";

/// Where a text stands relative to its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    /// The text begins there.
    Start,
    /// The text is centred there.
    Middle,
    /// The text ends there.
    End,
}

/// A drawing under construction; coordinates in px, `y` downwards.
#[derive(Clone, Debug)]
pub(crate) struct Svg {
    width: f64,
    height: f64,
    body: String,
    attributes: String,
}

impl Svg {
    /// An empty drawing.
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: String::new(), attributes: String::new() }
    }

    /// A line through `points`; those that are not finite are left out. `attributes` are written as they are.
    pub(crate) fn polyline(&mut self, points: &[[f64; 2]], attributes: &str) {
        let mut list = String::new();
        for [x, y] in points.iter().filter(|p| p[0].is_finite() && p[1].is_finite()) {
            let _ = write!(list, "{x:.2},{y:.2} ");
        }
        self.add(format_args!("<polyline fill=\"none\" points=\"{}\" {attributes}/>", list.trim_end()));
    }

    /// Dots of `radius` at `points` as one element; those that are not finite are left out.
    pub(crate) fn dots(&mut self, points: &[[f64; 2]], radius: f64, hue: &str) {
        let mut path = String::new();
        for [x, y] in points.iter().filter(|p| p[0].is_finite() && p[1].is_finite()) {
            let _ = write!(path, "M{x:.1} {y:.1}h0");
        }
        self.add(format_args!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"{hue}\" stroke-width=\"{:.1}\" stroke-linecap=\"round\"/>",
            2.0 * radius
        ));
    }

    /// A circle of which the line is drawn.
    pub(crate) fn circle(&mut self, at: [f64; 2], radius: f64, attributes: &str) {
        self.add(format_args!(
            "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius:.2}\" fill=\"none\" {attributes}/>",
            at[0], at[1]
        ));
    }

    /// A closed area.
    pub(crate) fn polygon(&mut self, points: &[[f64; 2]], attributes: &str) {
        let list: Vec<String> = points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
        self.add(format_args!("<polygon points=\"{}\" {attributes}/>", list.join(" ")));
    }

    /// A straight line.
    pub(crate) fn line(&mut self, from: [f64; 2], to: [f64; 2], attributes: &str) {
        let ([x1, y1], [x2, y2]) = (from, to);
        self.add(format_args!("<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" {attributes}/>"));
    }

    /// A filled dot.
    pub(crate) fn dot(&mut self, at: [f64; 2], radius: f64, fill: &str) {
        self.add(format_args!("<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius}\" fill=\"{fill}\"/>", at[0], at[1]));
    }

    /// A text in the page's colour; `size` in px.
    pub(crate) fn text(&mut self, at: [f64; 2], anchor: Anchor, size: f64, text: &str) {
        self.turned_text(at, anchor, size, 0.0, text);
    }

    /// A text turned by `degrees` clockwise about its point.
    pub(crate) fn turned_text(&mut self, at: [f64; 2], anchor: Anchor, size: f64, degrees: f64, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let [x, y] = at;
        let turn =
            if degrees == 0.0 { String::new() } else { format!(" transform=\"rotate({degrees} {x:.2} {y:.2})\"") };
        let text = escape(text);
        self.add(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" text-anchor=\"{anchor}\"{turn}>{text}</text>"
        ));
    }

    /// Begins a group of elements; `attributes` are written as they are.
    pub(crate) fn open(&mut self, attributes: &str) {
        self.add(format_args!("<g {attributes}>"));
    }

    /// Ends the group begun last.
    pub(crate) fn close(&mut self) {
        self.add(format_args!("</g>"));
    }

    /// Attributes of the whole drawing, written as they are.
    pub(crate) fn attributes(&mut self, attributes: &str) {
        self.attributes.push(' ');
        self.attributes.push_str(attributes);
    }

    /// The whole drawing; `title` is read out where pictures are not seen.
    pub(crate) fn finish(self, title: &str) -> String {
        let Self { width, height, body, attributes } = self;
        let title = escape(title);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" role=\"img\" aria-label=\"{title}\" fill=\"currentColor\" stroke-linecap=\"round\" \
             stroke-linejoin=\"round\" font-family=\"system-ui,Helvetica,Arial,sans-serif\"{attributes}><title>{title}</title>\
             <style>{STYLE}</style>\n{body}</svg>\n"
        )
    }

    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        let _ = writeln!(self.body, "{element}");
    }
}

/// Text for HTML and SVG, in elements and in quoted attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

/// Width of a text in px, estimated: 0.56 em a character.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "short texts")]
    let count = text.chars().count() as f64;
    0.56 * size * count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_escaped_and_gaps_left_out() {
        let mut svg = Svg::new(10.0, 10.0);
        svg.text([1.0, 2.0], Anchor::Middle, 12.0, "a<b & \"c\"");
        svg.polyline(&[[0.0, 0.0], [f64::NAN, 1.0], [2.0, 2.0]], "stroke=\"red\"");
        let text = svg.finish("<t>");
        assert!(text.contains("a&lt;b &amp; &quot;c&quot;") && text.contains("<title>&lt;t&gt;</title>"));
        assert!(text.contains("points=\"0.00,0.00 2.00,2.00\""), "{text}");
    }
}
