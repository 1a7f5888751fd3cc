//! One self-contained page: nothing is loaded from elsewhere, so it can be mailed and kept.
//!
//! Texts are escaped; drawings are inline SVG of this crate; pictures are PNG in data URIs. Readable on a phone, in print,
//! on light and dark screens.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ndarray::Array3;

use super::svg::escape;
use super::table::Table;
use crate::error::Result;
use crate::imaging::files::png_bytes_srgb;

/// A picture with what stands below it.
#[derive(Clone, Debug)]
pub struct Picture<'a> {
    /// Linear RGB, `[3, row, col]`.
    pub image: &'a Array3<f32>,
    /// What it shows.
    pub caption: String,
    /// Figures, one a line.
    pub notes: Vec<String>,
    /// Whether enlarged pixels stay squares.
    pub pixelated: bool,
}

/// A figure of the summary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fact {
    /// The number with its unit.
    pub value: String,
    /// What it is.
    pub label: String,
}

/// A page under construction.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
    open: bool,
}

impl Page {
    /// A page with its heading and one line below it.
    pub fn new(title: &str, subtitle: &str) -> Self {
        let body = format!("<header><h1>{}</h1><p>{}</p></header>\n", escape(title), escape(subtitle));
        Self { title: title.to_owned(), body, open: false }
    }

    /// Begins a section.
    pub fn section(&mut self, title: &str) -> &mut Self {
        self.close();
        self.open = true;
        self.add(&format!("<section><h2>{}</h2>", escape(title)))
    }

    /// A smaller heading.
    pub fn heading(&mut self, title: &str) -> &mut Self {
        self.add(&format!("<h3>{}</h3>", escape(title)))
    }

    /// A paragraph of text.
    pub fn paragraph(&mut self, text: &str) -> &mut Self {
        self.add(&format!("<p>{}</p>", escape(text)))
    }

    /// A list of texts.
    pub fn list<S: AsRef<str>>(&mut self, items: &[S]) -> &mut Self {
        let items: String = items.iter().map(|i| format!("<li>{}</li>", escape(i.as_ref()))).collect();
        self.add(&format!("<ul>{items}</ul>"))
    }

    /// Figures side by side.
    pub fn facts(&mut self, facts: &[Fact]) -> &mut Self {
        let cell = |f: &Fact| format!("<div><b>{}</b><span>{}</span></div>", escape(&f.value), escape(&f.label));
        self.add(&format!("<div class=\"facts\">{}</div>", facts.iter().map(cell).collect::<String>()))
    }

    /// A table; columns of numbers are set to the right.
    pub fn table(&mut self, table: &Table) -> &mut Self {
        let numeric: Vec<bool> = (0..table.heading.len()).map(|i| table.is_numeric(i)).collect();
        let row = |cells: &[String], tag: &str| {
            let cells = cells.iter().zip(&numeric).map(|(c, n)| {
                let class = if *n { " class=\"n\"" } else { "" };
                format!("<{tag}{class}>{}</{tag}>", escape(c))
            });
            format!("<tr>{}</tr>", cells.collect::<String>())
        };
        let rows: String = table.rows.iter().map(|r| row(r, "td")).collect();
        let head = row(&table.heading, "th");
        self.add(&format!("<div class=\"wide\"><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>"))
    }

    /// Drawings (SVG text of this crate) with captions, side by side where there is room for `min_px` each.
    pub fn drawings(&mut self, drawings: &[(String, String)], min_px: u32) -> &mut Self {
        let figures = drawings.iter().map(|(svg, caption)| {
            let caption = if caption.is_empty() {
                String::new()
            } else {
                format!("<figcaption>{}</figcaption>", escape(caption))
            };
            format!("<figure>{svg}{caption}</figure>")
        });
        let figures: String = figures.collect();
        self.grid(&figures, min_px)
    }

    /// Drawings with captions and, below each caption, notes of one line; side by side where there is room for `min_px` each.
    pub fn noted_drawings(&mut self, drawings: &[(String, String, Vec<String>)], min_px: u32) -> &mut Self {
        let figures = drawings.iter().map(|(svg, caption, notes)| {
            let notes: String = notes.iter().map(|n| format!("<span>{}</span>", escape(n))).collect();
            format!("<figure>{svg}<figcaption><b>{}</b>{notes}</figcaption></figure>", escape(caption))
        });
        let figures: String = figures.collect();
        self.grid(&figures, min_px)
    }

    /// Drawings with captions of which one is seen, the last at first; a slider steps through them.
    pub fn stepped(&mut self, drawings: &[(String, String)]) -> &mut Self {
        let last = drawings.len().saturating_sub(1);
        let figures: String = drawings
            .iter()
            .enumerate()
            .map(|(k, (svg, caption))| {
                let hidden = if k == last { "" } else { " hidden" };
                format!("<figure data-k=\"{k}\"{hidden}>{svg}<figcaption>{}</figcaption></figure>", escape(caption))
            })
            .collect();
        let slider = format!(
            "<input type=\"range\" min=\"0\" max=\"{last}\" value=\"{last}\" aria-label=\"step\" oninput=\"for (const f of \
             this.parentNode.querySelectorAll('figure')) f.hidden = f.dataset.k !== this.value\">"
        );
        self.add(&format!("<div class=\"steps\">{}{figures}</div>", if last > 0 { slider } else { String::new() }))
    }

    /// Pictures side by side where there is room for `min_px` each.
    ///
    /// # Errors
    /// A picture that is no picture: neither one nor three channels, or without pixels.
    pub fn pictures(&mut self, pictures: &[Picture<'_>], min_px: u32) -> Result<&mut Self> {
        let mut figures = String::new();
        for picture in pictures {
            let png = STANDARD.encode(png_bytes_srgb(picture.image)?);
            let (_, rows, columns) = picture.image.dim();
            let class = if picture.pixelated { " class=\"px\"" } else { "" };
            let caption = escape(&picture.caption);
            let notes: String = picture.notes.iter().map(|n| format!("<span>{}</span>", escape(n))).collect();
            figures.push_str(&format!(
                "<figure><img{class} width=\"{columns}\" height=\"{rows}\" alt=\"{caption}\" \
                 src=\"data:image/png;base64,{png}\"><figcaption>{caption}{notes}</figcaption></figure>"
            ));
        }
        Ok(self.grid(&figures, min_px))
    }

    fn grid(&mut self, figures: &str, min_px: u32) -> &mut Self {
        // What is small on a desk still stands two to a row on a phone.
        let class = if min_px < 300 { "grid small" } else { "grid" };
        self.add(&format!("<div class=\"{class}\" style=\"--min:{min_px}px\">{figures}</div>"))
    }

    fn add(&mut self, html: &str) -> &mut Self {
        self.body.push_str(html);
        self.body.push('\n');
        self
    }

    fn close(&mut self) {
        if self.open {
            self.body.push_str("</section>\n");
        }
    }

    /// The whole page.
    pub fn finish(mut self) -> String {
        self.close();
        let (title, body) = (escape(&self.title), self.body);
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
        )
    }
}

const STYLE: &str = "\
:root { color-scheme: light dark; --bg: #fcfcfd; --fg: #1b2026; --soft: #5b6570; --line: #dde2e8; --card: #f2f4f7; }
@media (prefers-color-scheme: dark) {
  :root { --bg: #14181d; --fg: #dce2e9; --soft: #98a3af; --line: #2c343d; --card: #1c2229; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.25rem 4rem; max-width: 1180px; background: var(--bg); color: var(--fg);
  font: 16px/1.55 system-ui, -apple-system, 'Segoe UI', Helvetica, Arial, sans-serif; }
header { border-bottom: 1px solid var(--line); margin-bottom: 1.5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.01em; text-wrap: balance; }
header p { color: var(--soft); margin: 0 0 1.1rem; max-width: 75ch; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; letter-spacing: -.005em; }
h3 { font-size: 1.02rem; margin: 1.6rem 0 .5rem; }
p, ul { max-width: 75ch; margin: .5rem 0 1rem; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 8.8rem), 1fr)); gap: .75rem; margin: 1rem 0; }
.facts div { background: var(--card); border-radius: 8px; padding: .7rem .9rem; }
.facts b { display: block; white-space: nowrap; font-size: 1.2rem; font-weight: 600; font-variant-numeric: tabular-nums; line-height: 1.25; }
.facts span { color: var(--soft); font-size: .86rem; }
.grid { display: grid; gap: 1rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fit, minmax(min(var(--min), 100%), 1fr)); align-items: start; }
@media (max-width: 560px) { .small { grid-template-columns: repeat(auto-fit, minmax(min(var(--min), 44%), 1fr)); gap: .6rem; } }
figure { margin: 0; min-width: 0; }
figure img { display: block; width: 100%; height: auto; border-radius: 4px; background: #000; }
img.px { image-rendering: pixelated; }
figure svg { display: block; max-width: 100%; height: auto; }
figcaption { font-size: .9rem; line-height: 1.4; padding-top: .4rem; }
figcaption span { display: block; color: var(--soft); font-size: .84rem; font-variant-numeric: tabular-nums; }
.steps input { width: 100%; margin: .6rem 0; }
.steps svg { margin: 0 auto; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
th, td { padding: .38rem 1.1rem .38rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; }
th:last-child, td:last-child { padding-right: 0; }
.n { text-align: right; white-space: nowrap; }
@media print { body { max-width: none; padding: 0; } figure, .facts, tr { break-inside: avoid; } }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_escaped_closed_and_load_nothing() {
        let mut page = Page::new("a < b", "sub & title");
        let image = Array3::from_elem((3, 4, 5), 0.5);
        let mut table = Table::new(["name", "x"]);
        table.row(["<script>", "1.5"]);
        page.section("one").paragraph("p < q").table(&table).list(&["i & j"]).heading("h");
        page.facts(&[Fact { value: "3 dB".into(), label: "l".into() }]);
        page.drawings(&[("<svg></svg>".into(), "c".into())], 300);
        let picture = Picture { image: &image, caption: "\"x\"".into(), notes: vec!["n".into()], pixelated: true };
        page.section("two").pictures(&[picture], 200).expect("encodes");
        let text = page.finish();
        assert!(
            text.contains("<title>a &lt; b</title>") && text.contains("&lt;script&gt;") && !text.contains("<script")
        );
        assert!(text.contains("src=\"data:image/png;base64,iVBOR") && text.contains("alt=\"&quot;x&quot;\""));
        assert!(!text.contains("http"), "nothing comes from elsewhere");
        for tag in ["section", "figure", "table", "div", "header", "body", "html", "ul", "tr"] {
            let count = |start: &str| text.matches(start).count();
            assert_eq!(count(&format!("<{tag}>")) + count(&format!("<{tag} ")), count(&format!("</{tag}>")), "{tag}");
        }
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        let image = Array3::zeros((2, 4, 5));
        let picture = Picture { image: &image, caption: String::new(), notes: vec![], pixelated: false };
        assert!(Page::new("t", "").pictures(&[picture], 200).is_err());
    }
}
