//! Tables: aligned text for terminals, rows for pages.

use std::fmt;

use isoplanat_base::error::{Error, Result};
pub use isoplanat_base::figures::significant;
use isoplanat_base::terminal::{cut, in_line};

/// Characters of a cell on a terminal at most.
const WIDEST: usize = 200;

/// A table of text cells; every row has as many cells as the heading.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    /// Heading of each column.
    pub heading: Vec<String>,
    /// Cells, row by row.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with this heading and no rows.
    pub fn new<S: Into<String>>(heading: impl IntoIterator<Item = S>) -> Self {
        Self { heading: heading.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds one row; missing cells stay empty, surplus ones are dropped.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        let mut cells: Vec<String> = cells.into_iter().map(Into::into).collect();
        cells.resize(self.heading.len(), String::new());
        self.rows.push(cells);
        self
    }

    /// The same as comma-separated values, the heading first; cells with commas or quotes are quoted.
    pub fn csv(&self) -> String {
        let line = |row: &Vec<String>| row.iter().map(|c| csv_cell(c)).collect::<Vec<_>>().join(",") + "\n";
        std::iter::once(&self.heading).chain(&self.rows).map(line).collect()
    }

    /// Whether every filled cell of column `index` starts like a number, so that it is set to the right.
    pub(crate) fn is_numeric(&self, index: usize) -> bool {
        let numeric =
            |c: &str| c == "inf" || c == "–" || c.starts_with(|f: char| f.is_ascii_digit() || "+-−.".contains(f));
        let mut filled = self.rows.iter().map(|r| r[index].as_str()).filter(|c| !c.is_empty()).peekable();
        filled.peek().is_some() && filled.all(numeric)
    }
}

impl fmt::Display for Table {
    /// Columns two spaces apart, numbers to the right, texts to the left, no blanks at line ends. A row is a line, whatever its cells hold.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |cell: &str| cut(&in_line(cell), WIDEST).into_owned();
        let width = |i: usize| {
            let cells = std::iter::once(&self.heading).chain(&self.rows).map(|r| shown(&r[i]).chars().count());
            cells.max().unwrap_or(0)
        };
        let columns: Vec<(usize, bool)> = (0..self.heading.len()).map(|i| (width(i), self.is_numeric(i))).collect();
        for row in std::iter::once(&self.heading).chain(&self.rows) {
            let cells = row.iter().zip(&columns).map(|(cell, (width, numeric))| {
                let cell = shown(cell);
                if *numeric { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            writeln!(f, "{}", cells.collect::<Vec<_>>().join("  ").trim_end())?;
        }
        Ok(())
    }
}

/// A result as JSON: the fields of its structs under their names; numbers that are not finite are `null`.
///
/// # Errors
/// A fault of the program: a result that has no form in JSON.
pub fn value(result: &impl serde::Serialize) -> Result<serde_json::Value> {
    serde_json::to_value(result).map_err(|e| Error::Internal(format!("a result as JSON: {e}")))
}

/// A result as commands print it: [`value`] beside `schema`, the number of its form.
#[doc(hidden)]
pub fn numbered(result: &impl serde::Serialize) -> serde_json::Value {
    #[derive(serde::Serialize)]
    struct Numbered<'a, R> {
        schema: u32,
        #[serde(flatten)]
        result: &'a R,
    }
    serde_json::json!(Numbered { schema: 1, result })
}

/// A cell of comma-separated values: with commas, quotes or ends of line in quotes; a text that a spreadsheet would run (`=`, `+`, `-`, `@` and no number) behind an apostrophe.
pub(crate) fn csv_cell(text: &str) -> String {
    let runs = text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err();
    let text = if runs { format!("'{text}") } else { text.to_owned() };
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

#[cfg(test)]
mod tests {
    /// What a file calls itself is a text to a spreadsheet, numbers stay numbers.
    #[test]
    fn cells_are_not_run() {
        for (text, cell) in [
            ("=cmd|'/c calc'!A1", "'=cmd|'/c calc'!A1"),
            ("@SUM(1,2)", "\"'@SUM(1,2)\""),
            ("-1.5e-3", "-1.5e-3"),
            ("+2", "+2"),
            ("-inf", "-inf"),
            ("-1+1", "'-1+1"),
            ("a-b", "a-b"),
        ] {
            assert_eq!(csv_cell(text), cell);
        }
    }

    use super::*;

    #[test]
    fn columns_line_up() {
        let mut table = Table::new(["name", "value"]);
        table.row(["a", "1.5"]).row(["longer µ", "-10"]).row(["b"]);
        assert_eq!(table.to_string(), "name      value\na           1.5\nlonger µ    -10\nb\n");
        let mut named = Table::new(["name", "value"]);
        named.row(["a\nb\u{2028}", "1"]).row(["c", "2"]);
        assert_eq!(named.to_string(), "name            value\na\\u000ab\\u2028      1\nc                   2\n");
        table.row(["c, \"d\"", "0"]);
        assert_eq!(table.csv(), "name,value\na,1.5\nlonger µ,-10\nb,\n\"c, \"\"d\"\"\",0\n");
    }
}
