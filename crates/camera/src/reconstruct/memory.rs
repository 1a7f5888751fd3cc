//! How much memory a capture's development takes.

use super::Camera;
use crate::raw::{Area, RawCapture};
use isoplanat_base::math::memory::{BASE, product};

impl Camera {
    /// Bytes that developing a capture and writing its picture take, about; `written` of them for each pixel of the file as it is put together.
    ///
    /// Samples and the picture made of them stand side by side; so do a picture and its next form, where it is restored, straightened or cut; so do the picture
    /// and its file. (It is turned a plane at a time. Tiles are bounded by the kit, and run in a process with a limit of its own.)
    pub(crate) fn bytes_needed(&self, capture: &RawCapture, written: usize) -> u64 {
        const PICTURE: usize = 3 * size_of::<f32>();
        let (rows, columns) = capture.size();
        let whole = Area { row: 0, column: 0, rows, columns };
        let again = self.calibrated.is_some() || self.measured.is_some() || capture.crop != whole;
        let beside = size_of::<f32>().max(written).max(if again { PICTURE } else { 0 });
        BASE.saturating_add(product(&[rows, columns, PICTURE + beside]))
    }
}
