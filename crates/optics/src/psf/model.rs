//! By what kernels are made: rays, waves, or rays with what the open pupil diffracts.

use serde::de::{Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// By what kernels are made. Files say `false`, `"approximate"` and `true`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// Rays.
    #[default]
    Rays,
    /// Rays, convolved with the diffraction of the open pupil without its path differences.
    Approximate,
    /// Scalar waves; rays where blur has hundreds of waves.
    Waves,
}

impl Model {
    /// All, the cheapest first.
    const ALL: [Self; 3] = [Self::Rays, Self::Approximate, Self::Waves];

    /// What options call it: `off`, `approximate` or `on`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rays => "off",
            Self::Approximate => "approximate",
            Self::Waves => "on",
        }
    }

    /// The model of a [`Self::name`].
    #[doc(hidden)]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|m| m.name() == name)
    }

    /// Whether light bends.
    pub fn diffracts(self) -> bool {
        self != Self::Rays
    }
}

impl Serialize for Model {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Rays => to.serialize_bool(false),
            Self::Approximate => to.serialize_str("approximate"),
            Self::Waves => to.serialize_bool(true),
        }
    }
}

impl<'de> Deserialize<'de> for Model {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Stated;
        impl Visitor<'_> for Stated {
            type Value = Model;
            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("true, false or \"approximate\"")
            }
            fn visit_bool<E: serde::de::Error>(self, waves: bool) -> Result<Model, E> {
                Ok(if waves { Model::Waves } else { Model::Rays })
            }
            fn visit_str<E: serde::de::Error>(self, word: &str) -> Result<Model, E> {
                match word {
                    "approximate" => Ok(Model::Approximate),
                    _ => Err(E::invalid_value(Unexpected::Str(word), &self)),
                }
            }
        }
        from.deserialize_any(Stated)
    }
}
