//! What a surface is at one place.

/// Value and derivatives of the rotationally symmetric part at one `ρ`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sag {
    /// `h`, mm.
    pub h: f64,
    /// `dh/dρ`, 1/mm.
    pub h1: f64,
    /// `d²h/dρ²`, 1/mm³.
    pub h2: f64,
    /// `φ` of the conic part.
    pub phi: f64,
    /// Sag of the conic part alone, mm.
    pub conic_h: f64,
}

/// Value and derivatives of the whole surface at one `(x, y)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    /// `h`, mm.
    pub h: f64,
    /// `(∂h/∂x, ∂h/∂y)`.
    pub slope: [f64; 2],
    /// `(∂²h/∂x², ∂²h/∂x∂y, ∂²h/∂y²)`, 1/mm.
    pub second: [f64; 3],
    /// The rotationally symmetric part.
    pub sag: Sag,
}
