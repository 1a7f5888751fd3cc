//! Why there is no transfer function.

use crate::trace::Failure;

/// Why there is no transfer function.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// The chief ray, or one that no clear aperture stops, does not reach the image.
    #[error("a ray that no clear aperture stops ends at surface {} ({})", .0.surface, .0.cause.name().replace('_', " "))]
    Ray(Failure),
    /// No light reaches the image.
    #[error("no light of this object point reaches the image")]
    Dark,
    /// Rays of several points of the stop have one direction: an afocal lens, or a pupil that folds.
    #[error("rays from several points of the stop reach the image in one direction (an afocal lens, a folded pupil)")]
    Folded,
}

impl From<Failure> for Fault {
    fn from(failure: Failure) -> Self {
        Self::Ray(failure)
    }
}
