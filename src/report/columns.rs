//! What a row of a result says: one list of columns makes the table that people read and the values that machines read.

use super::table::{Table, significant};

/// One column of rows `R`.
#[derive(Clone, Debug)]
pub struct Column<R> {
    /// Its heading in the table; `None`: it is not in it.
    pub head: Option<&'static str>,
    /// Its name among comma-separated values; `None`: it is not among them.
    pub key: Option<&'static str>,
    /// What stands in it.
    pub cell: Cell<R>,
}

/// What stands in a column.
#[derive(Clone, Debug)]
pub enum Cell<R> {
    /// A text.
    Text(fn(&R) -> String),
    /// A number: to so many significant digits in the table, to all of them among values.
    Figure(fn(&R) -> f64, usize),
    /// One text in the table, another among values.
    Both(fn(&R) -> String, fn(&R) -> String),
}

impl<R> Column<R> {
    /// A text that is the same for both.
    pub const fn text(head: &'static str, key: &'static str, of: fn(&R) -> String) -> Self {
        Self { head: Some(head), key: Some(key), cell: Cell::Text(of) }
    }

    /// A number, to so many significant digits in the table.
    pub const fn figure(head: &'static str, key: &'static str, digits: usize, of: fn(&R) -> f64) -> Self {
        Self { head: Some(head), key: Some(key), cell: Cell::Figure(of, digits) }
    }

    /// What people and machines read in different forms.
    pub const fn both(head: &'static str, key: &'static str, shown: fn(&R) -> String, value: fn(&R) -> String) -> Self {
        Self { head: Some(head), key: Some(key), cell: Cell::Both(shown, value) }
    }

    /// In the table alone.
    pub const fn shown(head: &'static str, of: fn(&R) -> String) -> Self {
        Self { head: Some(head), key: None, cell: Cell::Text(of) }
    }

    /// Among values alone.
    pub const fn value(key: &'static str, of: fn(&R) -> String) -> Self {
        Self { head: None, key: Some(key), cell: Cell::Text(of) }
    }
}

/// The rows as people read them.
pub fn table<'a, R: 'a>(columns: &[Column<R>], rows: impl IntoIterator<Item = &'a R>) -> Table {
    let kept: Vec<&Column<R>> = columns.iter().filter(|c| c.head.is_some()).collect();
    let mut table = Table::new(kept.iter().filter_map(|c| c.head));
    for row in rows {
        table.row(kept.iter().map(|c| match c.cell {
            Cell::Text(of) | Cell::Both(of, _) => of(row),
            Cell::Figure(of, digits) => significant(of(row), digits),
        }));
    }
    table
}

/// The rows as comma-separated values, the names of the columns first.
pub fn csv<'a, R: 'a>(columns: &[Column<R>], rows: impl IntoIterator<Item = &'a R>) -> String {
    let kept: Vec<&Column<R>> = columns.iter().filter(|c| c.key.is_some()).collect();
    let mut table = Table::new(kept.iter().filter_map(|c| c.key));
    for row in rows {
        table.row(kept.iter().map(|c| match c.cell {
            Cell::Text(of) | Cell::Both(_, of) => of(row),
            Cell::Figure(of, _) => of(row).to_string(),
        }));
    }
    table.csv()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_columns_makes_both_forms() {
        let columns = [
            Column::shown("", |r: &(&str, f64)| if r.1 > 1.0 { "*".into() } else { String::new() }),
            Column::text("name", "name", |r| r.0.to_owned()),
            Column::figure("error", "relative_error", 2, |r| r.1),
            Column::both("so", "so_percent", |r| format!("{:.0} %", 100.0 * r.1), |r| (100.0 * r.1).to_string()),
            Column::value("twice", |r| (2.0 * r.1).to_string()),
        ];
        let rows = [("a, b", 0.125), ("c", 2.5)];
        let shown = table(&columns, &rows);
        assert_eq!(shown.heading, ["", "name", "error", "so"]);
        assert_eq!(shown.rows, [["", "a, b", "0.12", "12 %"], ["*", "c", "2.5", "250 %"]]);
        assert_eq!(
            csv(&columns, &rows),
            "name,relative_error,so_percent,twice\n\"a, b\",0.125,12.5,0.25\nc,2.5,250,5\n"
        );
    }
}
