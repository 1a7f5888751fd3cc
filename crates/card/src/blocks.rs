//! What a U-Net is made of at every scale, by name.

use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};

/// The kind of a U-Net's blocks. Pooling, transposed convolutions, skips, and the last convolution are the same for all.
///
/// A block looks at its surroundings through 3×3 convolutions alone, so that tiles of a picture give what the whole gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Blocks {
    /// Two 3×3 convolutions with PReLU, as in the paper.
    #[default]
    Paper,
    /// The same two, each as depthwise 3×3 convolution and 1×1 convolution (Howard et al., "MobileNets", 2017).
    Separable,
    /// Gated residuals after L. Chen et al., "Simple Baselines for Image Restoration" (ECCV 2022): products of channels in place of
    /// activations. Layer norm and channel attention are left out: the attention's mean over the whole picture would differ
    /// from tile to tile.
    Gated,
}

impl Blocks {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Separable, Self::Gated];

    /// The name in tasks and cards.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Separable => "separable",
            Self::Gated => "gated",
        }
    }

    /// From a name.
    ///
    /// # Errors
    /// A name that is none.
    pub(crate) fn of_name(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|b| b.name() == name);
        found.ok_or_else(|| Error::bad("", "blocks", name, Self::ALL.map(Self::name).join(", ")))
    }

    /// Whether they are those of the paper.
    pub fn is_paper(&self) -> bool {
        *self == Self::Paper
    }

    /// 3×3 convolutions one after the other.
    pub(crate) const fn convolutions(self) -> usize {
        match self {
            Self::Paper | Self::Separable => 2,
            Self::Gated => 1,
        }
    }
}

impl TryFrom<String> for Blocks {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        Self::of_name(&name)
    }
}

impl From<Blocks> for String {
    fn from(blocks: Blocks) -> Self {
        blocks.name().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_files() {
        for blocks in Blocks::ALL {
            assert_eq!(serde_json::to_string(&blocks).expect("text"), format!("\"{}\"", blocks.name()));
            assert_eq!(Blocks::of_name(blocks.name()).expect("a name"), blocks);
        }
        let message = Blocks::of_name("dense").expect_err("none").to_string();
        assert!(message.contains("dense") && message.contains("paper, separable, gated"), "{message}");
    }
}
