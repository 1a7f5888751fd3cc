//! Which channels a network sees, by name.

use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};

/// Colours of a picture.
const COLOURS: usize = 3;

/// Channels that say what the point spread function is like.
pub const SPREAD: usize = 6;

/// What a network sees beside the capture. Channels stand in this order: capture, Wiener-filtered capture, the same at other levels of noise, place in the field,
/// point spread function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct Inputs {
    /// The capture through the lens's own Wiener filters: three channels.
    pub wiener: bool,
    /// The same through filters for a tenth of the noise and for ten times it: six channels.
    pub levels: bool,
    /// The place in the field: `x` and `y` from the axis, and the squared distance, over the frame's largest: three channels.
    pub field: bool,
    /// The point spread function of the place in six numbers (`Spread` of the imaging side).
    pub psf: bool,
}

/// Names of what can be seen beside the capture.
const NAMES: [&str; 4] = ["wiener", "levels", "field", "psf"];

impl Inputs {
    /// The capture alone, as in the paper.
    pub const BARE: Self = Self { wiener: false, levels: false, field: false, psf: false };

    /// The capture through filters for three levels of noise.
    pub const GUIDED: Self = Self { wiener: true, levels: true, ..Self::BARE };

    fn all(self) -> [(bool, usize); NAMES.len()] {
        [(self.wiener, COLOURS), (self.levels, 2 * COLOURS), (self.field, COLOURS), (self.psf, SPREAD)]
    }

    /// Channels in all.
    pub fn channels(self) -> usize {
        COLOURS + self.all().iter().filter(|(has, _)| *has).map(|(_, n)| n).sum::<usize>()
    }

    /// Whether the network sees the capture alone.
    pub fn is_bare(&self) -> bool {
        *self == Self::BARE
    }

    /// Whether any of it is the capture through filters.
    pub fn is_filtered(self) -> bool {
        self.wiener || self.levels
    }

    /// Whether any of it is made from the lens.
    pub fn knows_lens(self) -> bool {
        self.is_filtered() || self.psf
    }

    /// Filtered captures; they stand behind the capture.
    pub fn banks(self) -> usize {
        usize::from(self.wiener) + 2 * usize::from(self.levels)
    }

    /// The first of the channels that the output of a network whose base is the filtered capture is added to.
    pub fn base(self) -> usize {
        if self.wiener { COLOURS } else { 0 }
    }

    /// Names of what is seen beside the capture.
    pub fn names(self) -> Vec<&'static str> {
        let all = self.all().into_iter().zip(NAMES);
        all.filter_map(|((has, _), name)| has.then_some(name)).collect()
    }

    /// From names.
    ///
    /// ```
    /// use isoplanat_card::Inputs;
    ///
    /// assert_eq!(Inputs::of_names(["wiener", "field"])?.names(), ["wiener", "field"]);
    /// assert!(Inputs::of_names([])?.is_bare());
    /// assert!(Inputs::of_names(["colour"]).is_err());
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// A name that is none, or stands twice.
    pub fn of_names<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Self> {
        let mut inputs = Self::BARE;
        for name in names {
            let has = match name {
                "wiener" => &mut inputs.wiener,
                "levels" => &mut inputs.levels,
                "field" => &mut inputs.field,
                "psf" => &mut inputs.psf,
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
