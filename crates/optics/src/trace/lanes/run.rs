//! A tile at one surface: what kernels read and write.

use super::tile::{Bundle, Status, TILE};
use isoplanat_base::math::simd::F64;

/// What a kernel computes beside the rays.
pub(super) trait Mode {
    /// Optical path.
    const PATH: bool;
    /// What the adjoint needs.
    const RECORD: bool;
    /// An index ratio per ray.
    const SPECTRAL: bool;
}

macro_rules! modes {
    ($($(#[$doc:meta])* $name:ident: $path:literal, $record:literal, $spectral:literal;)+) => {
        $(
            $(#[$doc])*
            pub(super) struct $name;
            impl Mode for $name {
                const PATH: bool = $path;
                const RECORD: bool = $record;
                const SPECTRAL: bool = $spectral;
            }
        )+
    };
}

modes! {
    /// The rays alone.
    Lean: false, false, false;
    /// Rays and optical paths.
    WithPath: true, false, false;
    /// Rays, paths and the record of the adjoint.
    Recorded: true, true, false;
    /// Rays of several wavelengths.
    Spectral: false, false, true;
}

/// What the adjoint needs of one surface, beside the rays before and after it.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Extra {
    /// `γ`; 0 where nothing is refracted.
    pub(super) gamma: [f64; TILE],
    /// `1/R`.
    pub(super) inverse_r: [f64; TILE],
    /// `1/q`.
    pub(super) inverse_q: [f64; TILE],
    /// `w` and `2P′`; only of surfaces with terms.
    pub(super) w: [f64; TILE],
    pub(super) slope: [f64; TILE],
    // Keeps the arrays of records at one distance.
    _unused: [[f64; TILE]; 3],
}

impl Extra {
    pub(super) const ZERO: Self = Self {
        gamma: [0.0; TILE],
        inverse_r: [0.0; TILE],
        inverse_q: [0.0; TILE],
        w: [0.0; TILE],
        slope: [0.0; TILE],
        _unused: [[0.0; TILE]; 3],
    };
}

/// A tile at one surface.
pub(super) struct Run<'a> {
    /// Rays before the surface, in the frame of the one before.
    pub(super) from: &'a mut Bundle,
    /// Rays behind it, in its own nominal frame.
    pub(super) to: &'a mut Bundle,
    /// Record; only touched, and only there, by [`Recorded`].
    pub(super) extra: Option<&'a mut Extra>,
    /// Wavelengths; only read by [`Spectral`].
    pub(super) colour: &'a [u32; TILE],
    /// One bit per lane that has not failed.
    pub(super) alive: &'a mut u64,
    /// Where failures are written.
    pub(super) status: &'a mut [Status; TILE],
    /// Lanes in use.
    pub(super) len: usize,
}

impl Run<'_> {
    /// The record.
    #[inline(always)]
    pub(super) fn extra(&mut self) -> &mut Extra {
        self.extra.as_deref_mut().expect("a kernel that records has a record")
    }
}

/// Numbers of the vectors that hold the first `len` lanes of a tile.
#[inline(always)]
pub(super) fn vectors<S: F64>(len: usize) -> std::ops::Range<usize> {
    0..len.div_ceil(S::LANES).min(TILE / S::LANES)
}

/// Held by a kernel, makes its stack frame aligned: vectors that do not fit the registers then lie in whole cache lines.
#[repr(align(64))]
pub(super) struct AlignedFrame(#[allow(dead_code, reason = "only its place matters")] [f64; 8]);

impl AlignedFrame {
    #[inline(always)]
    pub(super) fn hold() {
        let frame = Self([0.0; 8]);
        std::hint::black_box(&frame);
    }
}
