//! Forms of a data set's files: pictures in two folders, or shards of arrays.

/// How pairs are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// PNG of 16 bits with the sRGB curve, cut off below black and above white.
    Png,
    /// TIFF of 32-bit floating point in linear light.
    Tiff,
    /// NumPy arrays of many pairs, `[pair, row, col, channel]` float32 in linear light, one file of captures and one of truths.
    Npy,
    /// The same in one archive, with what the table says in numbers.
    Npz,
}

/// Bytes of a shard's captures at most, unless its pairs are counted.
const SHARD: usize = 256 << 20;
/// Pairs of a shard at most, unless they are counted.
const PAIRS: usize = 1024;

impl Form {
    /// The forms there are.
    pub const ALL: [Self; 4] = [Self::Png, Self::Tiff, Self::Npy, Self::Npz];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Tiff => "tiff",
            Self::Npy => "npy",
            Self::Npz => "npz",
        }
    }

    /// Whether one file holds many pairs.
    pub(super) fn has_shards(self) -> bool {
        matches!(self, Self::Npy | Self::Npz)
    }

    /// Photographs whose pairs stand in one file: `crops` of each, so many pixels large; `asked` pairs at most.
    pub(super) fn together(self, asked: Option<usize>, crops: usize, pixels: usize) -> usize {
        let fitting = (SHARD / (pixels.max(1) * 3 * size_of::<f32>())).clamp(1, PAIRS);
        if self.has_shards() { (asked.unwrap_or(fitting) / crops).max(1) } else { 1 }
    }

    /// Names of the files that hold capture and truth of a pair in a unit, from the data set's folder.
    pub(super) fn files(self, pair: usize, unit: usize) -> [String; 2] {
        match self {
            Self::Png => [format!("capture/{pair:06}.png"), format!("truth/{pair:06}.png")],
            Self::Tiff => [format!("capture/{pair:06}.tif"), format!("truth/{pair:06}.tif")],
            Self::Npy => [format!("capture/{unit:05}.npy"), format!("truth/{unit:05}.npy")],
            Self::Npz => [format!("pairs/{unit:05}.npz"), format!("pairs/{unit:05}.npz")],
        }
    }

    /// Folders that the files stand in.
    pub(super) fn folders(self) -> &'static [&'static str] {
        if self == Self::Npz { &["pairs"] } else { &["capture", "truth"] }
    }
}
