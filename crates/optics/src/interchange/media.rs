//! Media as other programs' files state them.

use super::line_glass::OfLine;
use crate::lens::Medium;
use crate::lens::catalogue::{Glasses, Naming};
use crate::lens::model_glass::{cauchy_of_lines, constant};
use isoplanat_base::error::Result;

/// A medium before it is looked up.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Stated {
    Air,
    /// A glass of a catalogue; where the catalogue is named it stands before a slash.
    Glass(String),
    /// A glass by name on a line that has an index and an Abbe number beside it.
    Line(OfLine),
    /// Index at 587.5618 nm and Abbe number of the lines d, F, C.
    Lines {
        n_d: f64,
        v_d: f64,
    },
    /// Index and Abbe number of the paper's eq. 8.
    Pair {
        n_d: f64,
        v_d: f64,
    },
    /// One index for all wavelengths.
    Constant(f64),
    /// Wavelengths (nm) and indices.
    Table(Vec<(f64, f64)>),
}

impl Stated {
    /// The medium itself.
    ///
    /// # Errors
    /// An unknown glass, or one of several catalogues; the error names no file and no place.
    pub(super) fn resolve(&self, glasses: &Glasses, catalogues: &[String]) -> Result<Medium> {
        Ok(self.resolve_told(glasses, catalogues)?.0)
    }

    /// [`Self::resolve`] with what is to be told of it.
    ///
    /// # Errors
    /// As [`Self::resolve`].
    pub(super) fn resolve_told(&self, glasses: &Glasses, catalogues: &[String]) -> Result<(Medium, Option<String>)> {
        let medium = match self {
            Self::Air => Medium::Air,
            Self::Glass(name) => glasses.find(name, Naming::Foreign(catalogues))?,
            Self::Line(line) => {
                let (medium, told) = line.resolve(glasses, catalogues)?;
                let all: Vec<String> = told.into_iter().chain(glasses.repeated(&medium)).collect();
                return Ok((medium, (!all.is_empty()).then(|| all.join("; "))));
            }
            Self::Lines { n_d, v_d } => cauchy_of_lines(*n_d, *v_d)?,
            Self::Pair { n_d, v_d } => Medium::Cauchy { n_d: *n_d, v_d: *v_d },
            Self::Constant(n) => constant(*n)?,
            Self::Table(pairs) => {
                let mut pairs = pairs.clone();
                pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
                let (wavelength_nm, index) = pairs.into_iter().unzip();
                Medium::Table { wavelength_nm, index }
            }
        };
        let told = glasses.repeated(&medium);
        Ok((medium, told))
    }
}
