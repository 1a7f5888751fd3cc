//! `--diffraction` of commands that make pictures.

use isoplanat::Diffraction;

/// How diffraction enters pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Bending {
    /// Kernels of rays.
    Off,
    /// Kernels by diffraction.
    On,
    /// Kernels of rays, convolved with the diffraction of the open pupil.
    Approximate,
    /// The first of off, approximate and on that uses up at most a tenth of the error that is allowed.
    Auto,
}

impl From<Bending> for Diffraction {
    fn from(bending: Bending) -> Self {
        match bending {
            Bending::Off => Self::Off,
            Bending::On => Self::On,
            Bending::Approximate => Self::Approximate,
            Bending::Auto => Self::Auto,
        }
    }
}
