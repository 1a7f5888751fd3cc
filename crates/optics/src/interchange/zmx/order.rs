//! The numbers of a file's surfaces: from 0, the object; or from 1, without an object and an image.

use crate::interchange::text::{Line, shown};
use isoplanat_base::error::Result;

/// Numbers as the file counts them, one a surface.
#[derive(Default)]
pub(super) struct Order {
    numbers: Vec<usize>,
    inserted: Vec<String>,
}

impl Order {
    /// The label of the next surface, of its line.
    ///
    /// # Errors
    /// A number that is not the next one. Where the count starts at 1, a surface may be put in between: `5AS` behind 5.
    pub(super) fn next<'a>(&mut self, line: &Line<'a>) -> Result<&'a str> {
        let label = line.words.first().copied().unwrap_or("");
        let digits = label.find(|c: char| !c.is_ascii_digit()).map_or(label, |end| &label[..end]);
        let suffix = &label[digits.len()..];
        let number = digits.parse::<usize>().ok();
        let Some(last) = self.numbers.last().copied() else {
            if suffix.is_empty() && number.is_some_and(|n| n <= 1) {
                self.numbers.push(number.unwrap_or(0));
                return Ok(label);
            }
            return Err(line.refused(format!("SURF {}", shown(label)), "SURF 0 or SURF 1 at the beginning"));
        };
        let between = self.starts_at_one()
            && !suffix.is_empty()
            && suffix.len() <= 4
            && suffix.bytes().all(|b| b.is_ascii_alphanumeric());
        match number {
            Some(n) if suffix.is_empty() && n == last + 1 => self.numbers.push(n),
            Some(n) if between && (n == last || n == last + 1) => {
                self.inserted.push(shown(label));
                self.numbers.push(n);
            }
            _ => return Err(line.refused(format!("SURF {}", shown(label)), format!("SURF {}, the next one", last + 1))),
        }
        Ok(label)
    }

    /// Whether object and image are left out.
    pub(super) fn starts_at_one(&self) -> bool {
        self.numbers.first() == Some(&1)
    }

    /// Where the surface that the file calls `number` stands in the list.
    pub(super) fn position(&self, number: usize) -> Option<usize> {
        self.numbers.iter().position(|n| *n == number)
    }

    /// What is told of it.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.starts_at_one() {
            notes.push("the surfaces begin with SURF 1: the object is taken to be at infinity".into());
        }
        if !self.inserted.is_empty() {
            notes.push(format!("surfaces put in between are taken where they stand: {}", self.inserted.join(", ")));
        }
        notes
    }
}
