//! How finely a picture is computed.

use serde::Serialize;

/// One setting of every approximation of the fast renderer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Scene samples a pixel along each axis: 1, 2 or 4.
    pub samples: usize,
    /// Wavelengths over the sensor's response.
    pub wavelengths: usize,
    /// Degree of the pupil polynomial.
    pub degree: usize,
    /// Dense pupil points a wavelength.
    pub dense: usize,
    /// Relative L2 error of a kernel interpolated between nodes.
    pub node_error: f64,
    /// Share of a beam's energy that may fall outside the kernel's half-width.
    pub outside: f64,
    /// Largest half-width of a kernel, pixels.
    pub max_half_width: usize,
}

impl Settings {
    /// Fine in every respect: what the others are measured against.
    pub const FINE: Self = Self {
        samples: 4,
        wavelengths: 12,
        degree: 9,
        dense: 3000,
        node_error: 0.02,
        outside: 1e-4,
        max_half_width: 600,
    };

    /// Ladder of scene samples a pixel.
    pub const SAMPLES: [usize; 3] = [1, 2, 4];
    /// Ladder of wavelengths.
    pub const WAVELENGTHS: [usize; 6] = [3, 4, 5, 7, 9, 12];
    /// Ladder of dense pupil points.
    pub const DENSE: [usize; 4] = [200, 500, 1200, 3000];
    /// Ladder of node errors.
    pub const NODE_ERRORS: [f64; 5] = [0.4, 0.2, 0.1, 0.05, 0.02];
    /// Ladder of energy outside.
    pub const OUTSIDE: [f64; 5] = [2e-2, 5e-3, 2e-3, 5e-4, 1e-4];
}
