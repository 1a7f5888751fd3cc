//! What reading a picture may take.

use std::path::Path;

use isoplanat_base::error::Result;
use isoplanat_base::math::memory::{Limit, product};

/// What reading a picture may take, and what is made of it.
#[derive(Clone, Copy)]
pub(super) struct Room {
    memory: Limit,
    /// Bytes of the planes that are made of a pixel of so many channels.
    made: fn(usize) -> usize,
}

impl Room {
    /// Of a picture as it is stored: three planes in single precision.
    pub(super) fn stored(memory: Limit) -> Self {
        Self { memory, made: |_| 3 * size_of::<f32>() }
    }

    /// Of as many planes in double precision as it has.
    pub(super) fn planes(memory: Limit) -> Self {
        Self { memory, made: |channels| channels * size_of::<f64>() }
    }

    /// Refuses a picture whose pixels there is no memory for, before they are decoded: `decoding` bytes of the decoder, samples of `sample` bytes a channel,
    /// and the planes that are made of them.
    pub(super) fn allow(
        &self,
        path: &Path,
        [rows, cols]: [usize; 2],
        decoding: u64,
        (channels, sample): (usize, usize),
    ) -> Result<()> {
        let bytes = product(&[rows, cols, channels * sample + (self.made)(channels)]).saturating_add(decoding);
        let picture = format!("{}: {cols} × {rows} pixels", path.display());
        self.memory.allow(&picture, bytes, "a smaller picture")
    }

    /// Refuses a file that is read whole, before its size in pixels is known.
    pub(super) fn allow_bytes(&self, path: &Path, bytes: u64) -> Result<()> {
        self.memory.allow(&path.display().to_string(), bytes, "a smaller picture")
    }
}
