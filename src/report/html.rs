//! One self-contained page: nothing is loaded from elsewhere, so it can be mailed and kept.
//!
//! Texts are escaped by the templates; drawings are inline SVG of this crate; pictures are PNG in data URIs. Readable on a phone, in print,
//! on light and dark screens. A small script of the page's own (`page.js`) shows the values of plots under the pointer, makes what belongs to one
//! field stand out everywhere, and steps through drawings by slider; without it the page reads as it stands.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use ndarray::Array3;

use super::table::Table;
use isoplanat_base::error::Result;
use isoplanat_imaging::files::{jpeg_bytes_srgb, png_bytes_srgb};

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

/// Cells up to so many characters are not broken into lines.
const WHOLE: usize = 14;
/// Cells of more characters are given wide lines on a phone, too.
const LONG: usize = 50;

/// A page under construction.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    head: Markup,
    sections: Vec<Section>,
}

/// A section: its heading, none for what stands before the first, and what it holds.
#[derive(Clone, Debug)]
struct Section {
    title: Option<String>,
    /// Whether it begins a printed page of its own.
    sheet: bool,
    body: Markup,
}

impl Section {
    /// Its name in links: letters and digits of the heading.
    fn name(&self) -> String {
        let kept = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
        let name: String = self.title.iter().flat_map(|t| t.chars()).map(kept).collect();
        name.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
    }
}

impl Page {
    /// A page with its heading and one line below it.
    pub fn new(title: &str, subtitle: &str) -> Self {
        let head = html! { header { h1 { (title) } p { (subtitle) } } };
        let sections = vec![Section { title: None, sheet: false, body: PreEscaped(String::new()) }];
        Self { title: title.to_owned(), head, sections }
    }

    /// Begins a section.
    pub fn section(&mut self, title: &str) -> &mut Self {
        self.sections.push(Section { title: Some(title.to_owned()), sheet: false, body: PreEscaped(String::new()) });
        self
    }

    /// Begins a section that stands on a printed page of its own, in smaller type there.
    pub(crate) fn sheet(&mut self, title: &str) -> &mut Self {
        self.sections.push(Section { title: Some(title.to_owned()), sheet: true, body: PreEscaped(String::new()) });
        self
    }

    /// A smaller heading.
    pub(crate) fn heading(&mut self, title: &str) -> &mut Self {
        self.add(html! { h3 { (title) } })
    }

    /// A paragraph of text.
    pub(crate) fn paragraph(&mut self, text: &str) -> &mut Self {
        self.add(html! { p { (text) } })
    }

    /// A paragraph in small type: definitions, settings and accuracy of what stands above it.
    pub fn note(&mut self, text: &str) -> &mut Self {
        self.add(html! { p.note { (text) } })
    }

    /// A list of texts.
    pub fn list<S: AsRef<str>>(&mut self, items: &[S]) -> &mut Self {
        self.add(html! { ul { @for item in items { li { (item.as_ref()) } } } })
    }

    /// Figures side by side.
    pub fn facts(&mut self, facts: &[Fact]) -> &mut Self {
        self.add(html! { div.facts { @for f in facts { div { b { (f.value) } span { (f.label) } } } } })
    }

    /// A table; columns of numbers are set to the right.
    pub fn table(&mut self, table: &Table) -> &mut Self {
        self.add(Self::tabled(table))
    }

    /// Names and values in a section called "How".
    pub fn how(&mut self, settings: &[[String; 2]]) -> &mut Self {
        let mut table = Table::new(["what", "value"]);
        settings.iter().for_each(|[name, value]| {
            table.row([name.as_str(), value.as_str()]);
        });
        self.section("How").table(&table)
    }

    /// A drawing and a table below its heading, beside each other where there is room.
    pub(crate) fn drawing_beside(&mut self, svg: &str, heading: &str, table: &Table) -> &mut Self {
        self.add(html! {
            div.columns { figure { (PreEscaped(svg)) } div { h3 { (heading) } (Self::tabled(table)) } }
        })
    }

    /// Columns of tables, each below its heading; beside each other where there is room.
    pub(crate) fn tables_beside(&mut self, columns: &[Vec<(String, Table)>]) -> &mut Self {
        self.add(html! {
            div.columns { @for column in columns { div {
                @for (heading, table) in column { h3 { (heading) } (Self::tabled(table)) }
            } } }
        })
    }

    fn tabled(table: &Table) -> Markup {
        let numeric: Vec<bool> = (0..table.heading.len()).map(|i| table.is_numeric(i)).collect();
        html! {
            div.wide { table {
                thead { tr { @for (c, n) in table.heading.iter().zip(&numeric) { th.n[*n] { (c) } } } }
                tbody { @for row in &table.rows { tr {
                    @for (c, n) in row.iter().zip(&numeric) { td.n[*n].k[c.chars().count() <= WHOLE].long[c.chars().count() > LONG] { (c) } }
                } } }
            } }
        }
    }

    /// Drawings (SVG text of this crate) with captions, side by side where there is room for `min_px` each.
    pub(crate) fn drawings(&mut self, drawings: &[(String, String)], min_px: u32) -> &mut Self {
        let figures = html! {
            @for (svg, caption) in drawings {
                figure { (PreEscaped(svg)) @if !caption.is_empty() { figcaption { (caption) } } }
            }
        };
        self.grid(&figures, min_px)
    }

    /// Drawings with captions and, below each caption, notes of one line; side by side where there is room for `min_px` each.
    pub fn noted_drawings(&mut self, drawings: &[(String, String, Vec<String>)], min_px: u32) -> &mut Self {
        let figures = html! {
            @for (svg, caption, notes) in drawings {
                figure { (PreEscaped(svg)) figcaption { b { (caption) } @for n in notes { span { (n) } } } }
            }
        };
        self.grid(&figures, min_px)
    }

    /// Drawings with captions of which one is seen, number `first` at first; a slider called `label` steps through them.
    pub(crate) fn stepped(&mut self, drawings: &[(String, String)], first: usize, label: &str) -> &mut Self {
        self.add(Self::steps(drawings, first, label))
    }

    /// Several of these with one label, beside each other where there is room for `min_px` each.
    pub(crate) fn stepped_beside(
        &mut self,
        each: &[Vec<(String, String)>],
        first: usize,
        label: &str,
        min_px: u32,
    ) -> &mut Self {
        self.grid(&html! { @for drawings in each { (Self::steps(drawings, first, label)) } }, min_px)
    }

    fn steps(drawings: &[(String, String)], first: usize, label: &str) -> Markup {
        let last = drawings.len().saturating_sub(1);
        let first = first.min(last);
        html! {
            div.steps {
                @if last > 0 { label { (label) input type="range" min="0" max=(last) value=(first); } }
                @for (k, (svg, caption)) in drawings.iter().enumerate() {
                    figure data-k=(k) hidden[k != first] { (PreEscaped(svg)) figcaption { (caption) } }
                }
            }
        }
    }

    /// Pictures side by side where there is room for `min_px` each.
    ///
    /// # Errors
    /// A picture that is no picture: neither one nor three channels, or without pixels.
    pub fn pictures(&mut self, pictures: &[Picture<'_>], min_px: u32) -> Result<&mut Self> {
        let encoded = |p: &Picture<'_>| -> Result<String> {
            // Pixels to be looked at one by one stay as they are; photographs take a tenth of that.
            let (kind, bytes) =
                if p.pixelated { ("png", png_bytes_srgb(p.image)?) } else { ("jpeg", jpeg_bytes_srgb(p.image)?) };
            Ok(format!("data:image/{kind};base64,{}", STANDARD.encode(bytes)))
        };
        let encoded = pictures.iter().map(|p| Ok((p, encoded(p)?))).collect::<Result<Vec<_>>>()?;
        let figures = html! {
            @for (p, source) in &encoded {
                figure {
                    img.px[p.pixelated] width=(p.image.dim().2) height=(p.image.dim().1) alt=(p.caption)
                        src=(source);
                    figcaption { (p.caption) @for n in &p.notes { span { (n) } } }
                }
            }
        };
        Ok(self.grid(&figures, min_px))
    }

    fn grid(&mut self, figures: &Markup, min_px: u32) -> &mut Self {
        // What is small on a desk still stands two to a row on a phone.
        self.add(html! { div.grid.small[min_px < 300] style={ "--min:" (min_px) "px" } { (figures) } })
    }

    fn add(&mut self, html: Markup) -> &mut Self {
        if let Some(section) = self.sections.last_mut() {
            section.body.0.push_str(&html.0);
            section.body.0.push('\n');
        }
        self
    }

    /// The whole page; `contents` begins it with a list of its sections.
    fn page(&self, contents: bool) -> String {
        let named = || self.sections.iter().filter(|s| s.title.is_some());
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    (self.head)
                    @if contents { nav { @for s in named() { a href={ "#" (s.name()) } { (s.title.as_deref().unwrap_or("")) } } } }
                    @for s in &self.sections {
                        @if let Some(title) = &s.title { section id=(s.name()) class=[s.sheet.then_some("sheet")] { h2 { (title) } (s.body) } } @else { (s.body) }
                    }
                    script { (PreEscaped(SCRIPT)) }
                }
            }
        };
        page.into_string()
    }

    /// The whole page.
    pub fn finish(self) -> String {
        self.page(false)
    }

    /// The whole page, with a list of its sections on top.
    pub(crate) fn finish_with_contents(self) -> String {
        self.page(true)
    }
}

const STYLE: &str = include_str!("page.css");
/// The one script of every page: a server allows it by its hash.
pub const SCRIPT: &str = include_str!("page.js");

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
        page.stepped(&[("<svg></svg>".into(), "c".into()), ("<svg></svg>".into(), "d".into())], 0, "step");
        let text = page.finish_with_contents();
        assert!(text.contains("<a href=\"#one\">one</a>") && text.contains("<section id=\"one\">"));
        assert!(
            text.contains("<title>a &lt; b</title>")
                && text.contains("&lt;script&gt;")
                && text.matches("<script").count() == 1,
            "the page's own script alone"
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
