//! Zoom positions: `ZOO 3` has three, `ZOO THI S2 45 50 55` says what the third word names in each.

use crate::interchange::text::{Line, shown};
use isoplanat_base::error::{Error, Result};

/// Zoom positions at most.
const MOST: usize = 100;

/// The positions of a file, and the one that is read.
pub(super) struct Zoom {
    asked: Option<usize>,
    positions: Option<usize>,
}

impl Zoom {
    /// Reads the position `asked`, from 1; the first one without.
    pub(super) fn new(asked: Option<usize>) -> Self {
        Self { asked, positions: None }
    }

    /// Takes a statement `ZOO`; what it states at the position that is read.
    pub(super) fn take<'a>(&mut self, line: &Line<'a>) -> Result<Option<(String, Line<'a>)>> {
        let first = line.words.first().copied().unwrap_or("");
        if line.words.len() == 1 && first.starts_with(|c: char| c.is_ascii_digit()) {
            let count = line.count(0, MOST)?.max(1);
            self.positions = Some(count);
            self.position(line.file)?;
            return Ok(None);
        }
        let Some(count) = self.positions else {
            return Err(line.refused(format!("ZOO {}", shown(first)), "first their number, such as ZOO 3"));
        };
        // What takes other values follows in statements of its own: `TIT Z1 "…"`.
        if line.words.len() == 1 && ["TIT", "TITLE"].iter().any(|w| first.eq_ignore_ascii_case(w)) {
            return Ok(None);
        }
        if line.words.len() < 1 + count {
            let found = format!("ZOO {} with {} values at most", shown(first), line.words.len().saturating_sub(1));
            return Err(line.refused(found, format!("one for each of {count} positions")));
        }
        // Before the values stands what they are of: `S2`, `F3`.
        let (of, values) = line.words[1..].split_at(line.words.len() - 1 - count);
        let words = of.iter().copied().chain([values[self.position(line.file)? - 1]]).collect();
        Ok(Some((first.to_ascii_uppercase(), Line { file: line.file, place: line.place.clone(), words })))
    }

    /// The position that is read, from 1.
    fn position(&self, file: &str) -> Result<usize> {
        let (asked, count) = (self.asked.unwrap_or(1), self.positions.unwrap_or(1));
        if (1..=count).contains(&asked) {
            return Ok(asked);
        }
        let allowed = format!("1 to {count}, the zoom positions of the file");
        Err(Error::bad(file, "configuration", asked.to_string(), allowed))
    }

    /// Refuses a position that the file does not have; tells which was read.
    pub(super) fn finish(&self, file: &str, notes: &mut Vec<String>) -> Result<()> {
        let read = self.position(file)?;
        if let Some(count) = self.positions.filter(|n| *n > 1) {
            notes.push(format!(
                "{count} zoom positions (ZOO): position {read} is read; --configuration N takes another"
            ));
        }
        Ok(())
    }
}
