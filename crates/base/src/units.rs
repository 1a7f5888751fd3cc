//! Unit conversions and the spectral lines of lens design.

/// Fraunhofer F line, nm (486.1327).
pub const F_NM: f64 = 486.1327;
/// Fraunhofer d line, nm (587.5618).
pub const D_NM: f64 = 587.5618;
/// Fraunhofer C line, nm (656.2725).
pub const C_NM: f64 = 656.2725;

/// Micrometres from nanometres.
///
/// ```
/// assert_eq!(isoplanat_base::units::um_from_nm(587.5), 0.5875);
/// ```
pub fn um_from_nm(nm: f64) -> f64 {
    nm * 1e-3
}
