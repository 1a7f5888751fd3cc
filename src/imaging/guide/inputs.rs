//! Which channels a network sees, by name.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Colours of a picture.
const COLOURS: usize = 3;

/// What a network sees beside the capture. Channels stand in this order: capture, Wiener-filtered capture, place in the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct Inputs {
    /// The capture through the lens's own Wiener filters: three channels.
    pub wiener: bool,
    /// The place in the field: `x` and `y` from the axis, and the squared distance, over the frame's largest: three channels.
    pub field: bool,
}

/// Names of what can be seen beside the capture.
const NAMES: [&str; 2] = ["wiener", "field"];

impl Inputs {
    /// The capture alone, as in the paper.
    pub const BARE: Self = Self { wiener: false, field: false };

    /// Channels in all.
    pub fn channels(self) -> usize {
        COLOURS * (1 + usize::from(self.wiener) + usize::from(self.field))
    }

    /// Whether the network sees the capture alone.
    pub fn is_bare(&self) -> bool {
        *self == Self::BARE
    }

    /// The first of the channels that the network's output is added to.
    pub fn base(self) -> usize {
        if self.wiener { COLOURS } else { 0 }
    }

    /// Names of what is seen beside the capture.
    pub fn names(self) -> Vec<&'static str> {
        let all = [self.wiener, self.field].into_iter().zip(NAMES);
        all.filter_map(|(has, name)| has.then_some(name)).collect()
    }

    /// From names.
    ///
    /// # Errors
    /// A name that is none, or stands twice.
    pub fn of_names<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Self> {
        let mut inputs = Self::BARE;
        for name in names {
            let has = match name {
                "wiener" => &mut inputs.wiener,
                "field" => &mut inputs.field,
                _ => return Err(Error::bad("", "inputs", name, NAMES.join(", "))),
            };
            if std::mem::replace(has, true) {
                return Err(Error::bad("", "inputs", format!("{name} twice"), NAMES.join(", ")));
            }
        }
        Ok(inputs)
    }
}

impl TryFrom<Vec<String>> for Inputs {
    type Error = Error;

    fn try_from(names: Vec<String>) -> Result<Self> {
        Self::of_names(names.iter().map(String::as_str))
    }
}

impl From<Inputs> for Vec<String> {
    fn from(inputs: Inputs) -> Self {
        inputs.names().into_iter().map(str::to_owned).collect()
    }
}
