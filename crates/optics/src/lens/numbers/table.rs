//! The table: one line for each kind of number.

use super::{Aperture, At, Line, Medium, Parameter, Prescription, from_mut, from_ref};
use crate::lens::prescription::degrees;
use crate::lens::{Xy, Zernike};

/// Access to one number by its path.
macro_rules! scalar {
    ($holder:ident.$($field:tt).+) => {
        At::$holder(|x| from_ref(&x.$($field).+), |x| from_mut(&mut x.$($field).+))
    };
}

/// Access to a number of a shape that is no ideal lens.
macro_rules! bent {
    ($field:ident) => {
        At::Shape(
            |s| if s.ideal.is_none() { from_ref(&s.$field) } else { &[] },
            |s| if s.ideal.is_none() { from_mut(&mut s.$field) } else { &mut [] },
        )
    };
}

/// Access to what one variant of an enum holds.
macro_rules! variant {
    ($holder:ident, $pattern:pat => $x:ident) => {
        At::$holder(
            |a| if let $pattern = a { from_ref($x) } else { &[] },
            |a| if let $pattern = a { from_mut($x) } else { &mut [] },
        )
    };
}

/// Whether a number turns with its surface: each kind says so.
macro_rules! turns {
    (turns) => {
        true
    };
    (stays) => {
        false
    };
}

/// The kinds, in the order of listings, each with whether it turns and its line.
macro_rules! kinds {
    ($($(#[$doc:meta])+ $kind:ident: $side:ident => $line:expr,)+) => {
        /// What a number of a lens is.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Kind {
            $($(#[$doc])+ $kind,)+
        }

        impl Kind {
            /// Every kind, in the order of listings.
            pub const ALL: [Self; [$(Self::$kind),+].len()] = [$(Self::$kind),+];

            pub(super) const fn line(self) -> &'static Line {
                match self {
                    $(Self::$kind => const { &$line },)+
                }
            }

            /// Whether it changes sign where its surface is met from the other side: what sag is proportional to does; ratios and focal
            /// lengths do not.
            pub(in crate::lens) const fn turns(self) -> bool {
                match self {
                    $(Self::$kind => turns!($side),)+
                }
            }
        }
    };
}

const fn same(x: f64) -> f64 {
    x
}

const FINITE: (fn(f64) -> bool, &str) = (f64::is_finite, "a finite number");
const POSITIVE: (fn(f64) -> bool, &str) = (|x| x.is_finite() && x > 0.0, "a positive number");
/// A length from a nanometre to a kilometre: squares and fourth powers of such lengths and of their inverses are numbers.
const SIZE: (fn(f64) -> bool, &str) = (|x| (1e-6..=1e6).contains(&x), "1e-6 to 1e6 mm");
const ANGLE: (fn(f64) -> bool, &str) = (|x| x.abs() < std::f64::consts::FRAC_PI_2, "between -90 and 90 degrees");
const AXES: [&str; 3] = ["x", "y", "z"];

/// Clear semi-diameter of the surface that has `p`.
fn radius(lens: &Prescription, p: Parameter) -> f64 {
    lens.surfaces[p.of].semi_diameter
}

/// `r^-power` there: one unit is 1 mm of sag at the rim.
fn at_rim(lens: &Prescription, p: Parameter, power: usize) -> f64 {
    radius(lens, p).powi(-i32::try_from(power).unwrap_or(20))
}

/// Any finite number, one scaled unit is 1; lines say where they differ.
const PLAIN: Line = Line {
    at: At::Shape(|_| &[], |_| &mut []),
    name: |_, _| String::new(),
    key: "",
    in_file: same,
    allowed: FINITE,
    scale: |_, _| 1.0,
    free: true,
};

kinds! {
    /// Vertex curvature of a surface; an ideal lens has none.
    Curvature: turns => Line {
        at: bent!(curvature),
        name: |_, _| "curvature".into(),
        key: "curvature_per_mm",
        // A hyperboloid of any vertex curvature reaches all clear semi-diameters; powers of this one are numbers.
        allowed: (|x| x.abs() <= 1e6, "-1e6 to 1e6 per mm: radii from 1e-6 mm"),
        scale: |lens, p| 2.0 / radius(lens, p).powi(2),
        ..PLAIN
    },
    /// Conic constant of a surface; an ideal lens has none.
    Conic: stays => Line {
        at: bent!(conic),
        name: |_, _| "conic".into(),
        key: "conic",
        allowed: (|x| x.abs() <= 1e9, "-1e9 to 1e9"),
        // Sag of the conic term at the rim is κ c³ R⁴ / 8.
        scale: |lens, p| {
            let (c, r) = (lens.surfaces[p.of].shape.curvature.abs(), radius(lens, p));
            (8.0 / (c.powi(3) * r.powi(4)).max(1e-9)).min(1e3)
        },
        ..PLAIN
    },
    /// Even polynomial coefficients: a₂, a₄, ….
    Even: turns => Line {
        at: At::Shape(|s| &s.asphere, |s| &mut s.asphere),
        name: |_, p| format!("a{}", 2 * p.entry + 2),
        key: "asphere.",
        scale: |lens, p| at_rim(lens, p, 2 * p.entry + 2),
        ..PLAIN
    },
    /// Odd polynomial coefficients: a₃, a₅, ….
    Odd: turns => Line {
        at: At::Shape(|s| &s.odd, |s| &mut s.odd),
        name: |_, p| format!("a{}", 2 * p.entry + 3),
        key: "asphere.",
        scale: |lens, p| at_rim(lens, p, 2 * p.entry + 3),
        ..PLAIN
    },
    /// Zernike coefficients: Z₁, Z₂, ….
    Zernike: turns => Line {
        at: At::Shape(
            |s| s.zernike.as_ref().map_or(&[], Zernike::terms),
            |s| s.zernike.as_mut().map_or(&mut [], Zernike::terms_mut),
        ),
        name: |_, p| format!("z{}", p.entry + 1),
        key: "zernike.",
        ..PLAIN
    },
    /// Coefficients of the polynomial in x and y, in the file's order.
    Xy: turns => Line {
        at: At::Shape(|s| s.xy.as_ref().map_or(&[], Xy::terms), |s| s.xy.as_mut().map_or(&mut [], Xy::terms_mut)),
        name: |lens, p| {
            let orders = lens.surfaces.get(p.of).and_then(|s| s.shape.xy.as_ref()?.orders().get(p.entry));
            orders.map_or_else(|| format!("xy{}", p.entry), |(i, j)| format!("x{i}y{j}"))
        },
        key: "xy.terms.",
        ..PLAIN
    },
    /// Focal length of an ideal lens, where a surface is one.
    IdealFocalLength: stays => Line {
        at: At::Shape(|s| s.ideal.as_slice(), |s| s.ideal.as_mut_slice()),
        name: |_, _| "ideal_focal_length".into(),
        key: "ideal_focal_length_mm",
        allowed: (|x| (1e-6..=1e9).contains(&x.abs()), "1e-6 to 1e9 mm, or as much below 0"),
        // It stands for what is not designed.
        free: false,
        ..PLAIN
    },
    /// Tilts of a surface about x, y, z, where it states a pose.
    Tilt: stays => Line {
        at: At::Surface(
            |s| s.pose.as_ref().map_or(&[], |p| &p.tilt),
            |s| s.pose.as_mut().map_or(&mut [], |p| &mut p.tilt),
        ),
        name: |_, p| format!("tilt_{}", AXES[p.entry % 3]),
        key: "tilt_deg",
        in_file: degrees,
        allowed: ANGLE,
        scale: |lens, p| 1.0 / radius(lens, p),
        ..PLAIN
    },
    /// Decentres of a surface along x and y, where it states a pose.
    Decentre: stays => Line {
        at: At::Surface(
            |s| s.pose.as_ref().map_or(&[], |p| &p.decentre),
            |s| s.pose.as_mut().map_or(&mut [], |p| &mut p.decentre),
        ),
        name: |_, p| format!("decentre_{}", AXES[p.entry % 3]),
        key: "decentre_mm",
        allowed: (|x| x.abs() <= 1e6, "-1e6 to 1e6 mm"),
        ..PLAIN
    },
    /// Thickness behind a surface.
    Thickness: stays => Line {
        at: scalar!(Surface.thickness),
        name: |_, _| "thickness".into(),
        key: "thickness_mm",
        allowed: (|x| (0.0..=1e6).contains(&x), "not negative, at most 1e6 mm"),
        ..PLAIN
    },
    /// `n_d` of the medium behind a surface, where two numbers state it.
    Index: stays => Line {
        at: variant!(Medium, Medium::Cauchy { n_d, .. } => n_d),
        name: |_, _| "n_d".into(),
        key: "medium.n_d",
        allowed: (|x| (1.0..=5.0).contains(&x), "1 to 5"),
        ..PLAIN
    },
    /// `v_d` of the medium behind a surface, where two numbers state it.
    Abbe: stays => Line {
        at: variant!(Medium, Medium::Cauchy { v_d, .. } => v_d),
        name: |_, _| "v_d".into(),
        key: "medium.v_d",
        allowed: (|x| (1e-3..=1e6).contains(&x), "1e-3 to 1e6"),
        scale: |_, _| 100.0,
        ..PLAIN
    },
    /// Dispersion coefficients of a catalogue's glass, in the order of its formula.
    Dispersion: stays => Line {
        at: At::Medium(
            |m| if let Medium::Glass { dispersion, .. } = m { dispersion.coefficients() } else { &[] },
            |m| if let Medium::Glass { dispersion, .. } = m { dispersion.coefficients_mut() } else { &mut [] },
        ),
        name: |_, p| format!("dispersion_{}", p.entry),
        key: "medium.coefficients.",
        free: false,
        ..PLAIN
    },
    /// Indices of a tabulated glass.
    Tabulated: stays => Line {
        at: At::Medium(
            |m| if let Medium::Table { index, .. } = m { index } else { &[] },
            |m| if let Medium::Table { index, .. } = m { index } else { &mut [] },
        ),
        name: |_, p| format!("index_{}", p.entry),
        key: "medium.index",
        allowed: (|x| (1.0..=5.0).contains(&x), "1 to 5"),
        free: false,
        ..PLAIN
    },
    /// Clear semi-diameter of a surface.
    SemiDiameter: stays => Line {
        at: scalar!(Surface.semi_diameter),
        name: |_, _| "semi_diameter".into(),
        key: "semi_diameter_mm",
        allowed: SIZE,
        free: false,
        ..PLAIN
    },
    /// Tilts of an element about x, y, z.
    ElementTilt: stays => Line {
        at: At::Element(|e| &e.pose.tilt, |e| &mut e.pose.tilt),
        name: |_, p| format!("tilt_{}", AXES[p.entry % 3]),
        key: "tilt_deg",
        in_file: degrees,
        allowed: ANGLE,
        scale: |lens, p| 1.0 / lens.surfaces[lens.elements[p.of].first].semi_diameter,
        ..PLAIN
    },
    /// Decentres of an element along x and y.
    ElementDecentre: stays => Line {
        at: At::Element(|e| &e.pose.decentre, |e| &mut e.pose.decentre),
        name: |_, p| format!("decentre_{}", AXES[p.entry % 3]),
        key: "decentre_mm",
        allowed: (|x| x.abs() <= 1e6, "-1e6 to 1e6 mm"),
        ..PLAIN
    },
    /// Pivot of an element.
    Pivot: stays => Line {
        at: scalar!(Element.pivot),
        name: |_, _| "pivot".into(),
        key: "pivot_mm",
        allowed: (|x| x.abs() <= 1e6, "-1e6 to 1e6 mm"),
        free: false,
        ..PLAIN
    },
    /// Diameter of the entrance pupil, where the aperture is stated so.
    EntrancePupilDiameter: stays => Line {
        at: variant!(Aperture, Aperture::EntrancePupilDiameter(d) => d),
        name: |_, _| "entrance_pupil_diameter".into(),
        key: "entrance_pupil_diameter_mm",
        allowed: SIZE,
        free: false,
        ..PLAIN
    },
    /// F-number, where the aperture is stated so.
    FNumber: stays => Line {
        at: variant!(Aperture, Aperture::FNumber(f) => f),
        name: |_, _| "f_number".into(),
        key: "f_number",
        allowed: POSITIVE,
        free: false,
        ..PLAIN
    },
    /// Semi-diameter of the stop, where the aperture is stated so.
    StopSemiDiameter: stays => Line {
        at: variant!(Aperture, Aperture::StopSemiDiameter(r) => r),
        name: |_, _| "stop_semi_diameter".into(),
        key: "stop_semi_diameter_mm",
        allowed: SIZE,
        free: false,
        ..PLAIN
    },
    /// Numerical aperture in object space, where the aperture is stated so.
    ObjectNa: stays => Line {
        at: variant!(Aperture, Aperture::ObjectNa(na) => na),
        name: |_, _| "object_space_na".into(),
        key: "object_space_na",
        allowed: (|x| x > 0.0 && x < 5.0, "above 0, below the object space's index"),
        free: false,
        ..PLAIN
    },
}
