//! What the lens is: validated numbers, no rays.
//!
//! A [`Lens`] is a list of [`Surface`]s in the order the light meets them, a stop, an object distance (as vergence) and
//! the raster the image falls on. Surfaces and elements may be tilted and decentred ([`pose`]). Lengths mm, angles radians. The numbers are those
//! of a [`Prescription`]; a `Lens` is one that passed the check, and is read, not written: [`Lens::changed`] makes another, whether its
//! numbers come from a file ([`prescription`]), a command line or a design step. [`numbers`] lists every number.
//!
//! ```
//! use isoplanat_optics::lens::{builtin, paraxial};
//!
//! let lens = builtin::lens("cooke_triplet")?;
//! let closer = lens.changed(|l| l.object_vergence = 1.0 / 500.0)?;
//! let bent = lens.changed(|l| l.surfaces[0].shape.curvature *= 1.01)?;
//! let focal_length = |lens| paraxial::first_order(lens, 587.6).effective_focal_length;
//! assert!((focal_length(&closer) - 50.0).abs() < 0.1 && focal_length(&bent) < focal_length(&lens));
//! // What is no lens is refused with the number that is wrong.
//! let error = lens.changed(|l| l.surfaces[2].thickness = -1.0).unwrap_err();
//! assert!(error.to_string().contains("surface[2].thickness_mm: -1"));
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

pub mod builtin;
pub mod catalogue;
pub(crate) mod check;
pub(crate) mod clearance;
#[doc(hidden)]
pub mod dispersion;
#[doc(hidden)]
pub mod f_number;
#[doc(hidden)]
pub mod freeform;
pub mod glass;
pub mod gradient;
pub(crate) mod model_glass;
pub mod numbers;
pub mod paraxial;
pub mod pose;
pub mod prescription;
mod sag;
mod scale;
pub mod seidel;
pub mod shape;
#[cfg(test)]
pub(crate) mod test_lenses;
pub mod variables;

use isoplanat_base::atomic::sha256_hex;
use isoplanat_base::error::{Error, Location, Result};

pub use freeform::{Xy, Zernike};
pub use glass::Medium;
pub use gradient::LensGradient;
pub use numbers::{Kind, Parameter};
pub use pose::{Element, Pose};
pub use shape::Shape;

/// One refracting surface (or a dummy: the same medium on both sides) with the space behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Form of the surface.
    pub shape: Shape,
    /// Distance to the next vertex along the axis, mm; the last one reaches the sensor.
    pub thickness: f64,
    /// Medium behind the surface.
    pub medium: Medium,
    /// Clear semi-diameter, mm: rays beyond it are vignetted. At the stop the size of the stop counts, which is not larger.
    pub semi_diameter: f64,
    /// Tilt and decentre, where stated.
    pub pose: Option<Pose>,
}

/// How the file states the size of the stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aperture {
    /// Diameter of the paraxial entrance pupil, mm.
    EntrancePupilDiameter(f64),
    /// Effective focal length over entrance-pupil diameter, object at infinity.
    FNumber(f64),
    /// Semi-diameter of the stop surface, mm.
    StopSemiDiameter(f64),
    /// Numerical aperture in object space: sine of the paraxial marginal ray's angle times the index there, of an object that is not at infinity.
    ObjectNa(f64),
}

impl Aperture {
    /// The number that states it, to change.
    pub fn number_mut(&mut self) -> &mut f64 {
        match self {
            Self::EntrancePupilDiameter(x) | Self::FNumber(x) | Self::StopSemiDiameter(x) | Self::ObjectNa(x) => x,
        }
    }
}

/// How large the field is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field {
    /// Half angle at the entrance pupil, degrees; at the first vertex in a lens that is telecentric in object space
    /// ([`paraxial::FieldOrigin`]).
    Angle(f64),
    /// Height of the object in its plane, mm.
    ObjectHeight(f64),
}

/// Design wavelengths of the prescription.
#[derive(Clone, Debug, PartialEq)]
pub struct Wavelengths {
    /// Wavelengths, nm.
    pub nm: Vec<f64>,
    /// Relative weights of the light that is detected; 0 leaves a wavelength out.
    pub weights: Vec<f64>,
    /// Reference wavelength: chief rays, distortion, first-order data; nm.
    pub primary_nm: f64,
}

impl Wavelengths {
    /// Wavelengths that count, nm, with their shares of the light (which sum to 1).
    pub fn shares(&self) -> impl Iterator<Item = (f64, f64)> {
        let sum: f64 = self.weights.iter().sum();
        self.nm.iter().zip(&self.weights).filter(|(_, w)| **w > 0.0).map(move |(nm, w)| (*nm, w / sum))
    }

    /// Shortest and longest wavelength that counts, nm.
    pub fn ends_nm(&self) -> [f64; 2] {
        self.shares().fold([f64::INFINITY, 0.0], |[a, b], (nm, _)| [nm.min(a), nm.max(b)])
    }
}

/// The pixel raster behind the lens.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SensorRaster {
    /// Pixels in a row.
    pub columns: usize,
    /// Pixels in a column.
    pub rows: usize,
    /// Pixel pitch, µm (as the file states it).
    pub pitch_um: f64,
    /// Column and row of the optical axis, in pixels from the raster's first corner.
    pub axis_px: [f64; 2],
}

impl SensorRaster {
    /// So many pixels about the middle, as large as they can be within this raster's field.
    #[doc(hidden)]
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn spanned(self, columns: usize, rows: usize) -> Self {
        let grown = (self.columns as f64 / columns as f64).min(self.rows as f64 / rows as f64);
        let axis_px = [columns as f64 / 2.0, rows as f64 / 2.0];
        Self { columns, rows, pitch_um: self.pitch_um * grown, axis_px }
    }
}

/// Form of the image surface: a conic about the axis, whose vertex stands where the last distance ends; a plane unless it is said.
///
/// Places on it, and blurs, are told by their `x` and `y`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageSurface {
    /// Vertex curvature, 1/mm; positive when the centre lies towards +z.
    pub curvature: f64,
    /// Conic constant: 0 sphere, −1 paraboloid.
    pub conic: f64,
}

impl ImageSurface {
    /// As the shape of a surface.
    #[doc(hidden)]
    pub fn shape(&self) -> Shape {
        Shape { curvature: self.curvature, conic: self.conic, ..Shape::default() }
    }

    /// Refuses a raster, `what` in words, whose corner lies where it ends; `file` names the lens.
    fn require_reach(&self, corner_mm: f64, what: &str, file: &str) -> Result<()> {
        let reach = self.shape().reach();
        if corner_mm <= reach {
            return Ok(());
        }
        let found = format!("{what} whose corner lies {corner_mm:.4} mm off the axis");
        let allowed = format!("a corner within {reach:.4} mm, where the image surface ends");
        Err(Error::bad(file, "image", found, allowed))
    }

    /// Whether it is a plane.
    #[doc(hidden)]
    pub fn is_plane(&self) -> bool {
        self.curvature == 0.0
    }
}

/// The numbers of a lens as somebody states them: they may not be a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Prescription {
    /// Name, for reports.
    pub name: String,
    /// Where the numbers come from.
    pub source: String,
    /// Surfaces in the order of the light.
    pub surfaces: Vec<Surface>,
    /// Groups of surfaces that are moved together.
    pub elements: Vec<Element>,
    /// Index of the stop surface.
    pub stop: usize,
    /// How the stop's size is stated.
    pub aperture: Aperture,
    /// `1/distance` of the object before the first vertex, 1/mm; 0 is infinity.
    pub object_vergence: f64,
    /// Medium between the object and the first surface.
    pub object_medium: Medium,
    /// Largest field (as the file states it).
    pub field: Field,
    /// Fields that the file states, rising, in the unit of `field`; empty where it states the largest alone. Analyses look there.
    pub field_points: Vec<f64>,
    /// Design wavelengths.
    pub wavelengths: Wavelengths,
    /// Pixel raster.
    pub sensor: SensorRaster,
    /// Form of the surface that images land on, the sensor's.
    pub image: ImageSurface,
}

impl SensorRaster {
    /// Pixel pitch, mm.
    pub fn pitch_mm(&self) -> f64 {
        self.pitch_um * 1e-3
    }

    /// Distance of the farthest pixel corner from the axis, mm.
    pub fn radius_mm(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "validated to 65,536")]
        let (w, h) = (self.columns as f64, self.rows as f64);
        let far = |axis: f64, size: f64| axis.abs().max((size - axis).abs());
        far(self.axis_px[0], w).hypot(far(self.axis_px[1], h)) * self.pitch_mm()
    }
}

/// A prescription that passed the check: it has a stop, its numbers are within their bounds, its surfaces leave each other and the
/// sensor room, its media have an index at its wavelengths.
#[derive(Clone, Debug)]
pub struct Lens {
    numbers: Prescription,
    file: String,
}

impl std::ops::Deref for Lens {
    type Target = Prescription;
    fn deref(&self) -> &Prescription {
        &self.numbers
    }
}

/// The same numbers, wherever they were read.
impl PartialEq for Lens {
    fn eq(&self, other: &Self) -> bool {
        self.numbers == other.numbers
    }
}

impl Lens {
    /// The lens of these numbers; `file` names it in errors, these and later ones ([`Self::file`]). The stop's surface is made clear as far as the stop reaches: its size
    /// may follow from an entrance pupil or an f-number. (A file that states less gets less: [`prescription`].)
    ///
    /// # Errors
    /// The first number that is not allowed, with what is.
    pub fn new(mut numbers: Prescription, file: &str) -> Result<Self> {
        numbers.surfaces.iter_mut().for_each(|s| s.shape.refresh());
        clearance::open_stop(&mut numbers);
        numbers.check(file)?;
        Ok(Self { numbers, file: file.to_owned() })
    }

    /// What errors call it: the file that it was read from, as whoever asked for it named that.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Refuses a lens that lacks rotational symmetry, for work that counts on it.
    #[doc(hidden)]
    pub fn require_symmetry(&self, work: &str) -> Result<()> {
        if self.is_symmetric() {
            return Ok(());
        }
        Err(Error::bad(
            self.file(),
            "surfaces",
            "tilts, decentres or freeform terms",
            format!("a rotationally symmetric lens for {work}; `trace`, `inspect`, `check` and `capture` take any"),
        ))
    }

    /// Refuses a curved sensor, for work by rays that start on a plane one.
    #[doc(hidden)]
    pub fn require_plane_image(&self) -> Result<()> {
        if self.image.is_plane() {
            return Ok(());
        }
        let allowed = "a plane sensor for rays that start there; spot, mtf, psf and render take curved ones";
        Err(Error::bad(self.file(), "image", "a curved sensor", allowed))
    }

    /// Refuses places of the sensor, so far from the axis, that its form does not have.
    #[doc(hidden)]
    pub fn require_reach(&self, radius_mm: f64) -> Result<()> {
        self.image.require_reach(radius_mm, "a frame", self.file())
    }

    /// This lens with other numbers.
    ///
    /// # Errors
    /// Numbers that are no lens, under this lens's file.
    pub fn changed(&self, change: impl FnOnce(&mut Prescription)) -> Result<Self> {
        let mut numbers = self.numbers.clone();
        change(&mut numbers);
        Self::new(numbers, &self.file)
    }

    /// This lens without tilts, decentres and freeform terms: the one that has its symmetry.
    ///
    /// # Errors
    /// Numbers that are no lens then.
    pub fn upright(&self) -> Result<Self> {
        self.changed(|l| {
            l.elements.clear();
            for s in &mut l.surfaces {
                s.pose = None;
                s.shape = std::mem::take(&mut s.shape).symmetric_part();
            }
        })
    }
}

/// `lens` with other numbers that no check has seen: for tests of what work does with numbers that are no lens, and for nothing
/// else (a test holds it).
#[doc(hidden)]
#[must_use]
pub fn unchecked(lens: &Lens, change: impl FnOnce(&mut Prescription)) -> Lens {
    let mut numbers = lens.numbers.clone();
    change(&mut numbers);
    numbers.surfaces.iter_mut().for_each(|s| s.shape.refresh());
    Lens { numbers, file: lens.file.clone() }
}

/// Where a file states the medium of a space, counted as [`Prescription::media`] does.
pub(crate) fn place_of_medium(space: usize) -> Location {
    match space.checked_sub(1) {
        Some(surface) => Location::surface(surface).key("medium"),
        None => "object.medium".into(),
    }
}

impl Prescription {
    /// Refractive index of every space at `nm`: entry 0 is the object space, entry `i + 1` follows surface `i`.
    pub fn indices(&self, nm: f64) -> Vec<f64> {
        self.media().map(|medium| medium.index(nm)).collect()
    }

    /// Medium of every space: entry 0 is the object space, entry `i + 1` follows surface `i`.
    #[doc(hidden)]
    pub fn media(&self) -> impl Iterator<Item = &Medium> {
        std::iter::once(&self.object_medium).chain(self.surfaces.iter().map(|s| &s.medium))
    }

    /// Medium before surface `i`.
    #[doc(hidden)]
    pub fn medium_before(&self, i: usize) -> &Medium {
        i.checked_sub(1).map_or(&self.object_medium, |k| &self.surfaces[k].medium)
    }

    /// Refuses a wavelength at which a medium's index is not known; `file` names the lens.
    pub fn require_indices(&self, nm: f64, file: &str) -> Result<()> {
        for (space, medium) in self.media().enumerate() {
            let [short, long] = medium.range_nm();
            if !(short..=long).contains(&nm) {
                let found = format!("{medium} at {nm} nm");
                let allowed = format!("{short} to {long} nm, where its index is known");
                return Err(Error::bad(file, place_of_medium(space), found, allowed));
            }
        }
        Ok(())
    }

    /// Axial distance from the first vertex to the sensor, mm.
    pub fn length(&self) -> f64 {
        self.surfaces.iter().map(|s| s.thickness).sum()
    }

    /// Nominal positions of the vertices along the axis, mm from the first.
    pub(crate) fn vertices(&self) -> Vec<f64> {
        let next = |z: &mut f64, s: &Surface| {
            let here = *z;
            *z += s.thickness;
            Some(here)
        };
        self.surfaces.iter().scan(0.0, next).collect()
    }

    /// Whether the whole lens is rotationally symmetric about its axis.
    pub fn is_symmetric(&self) -> bool {
        self.surfaces.iter().all(|s| s.shape.is_symmetric() && s.pose.is_none_or(|p| p.is_nominal()))
            && self.elements.iter().all(|e| e.pose.is_nominal())
    }

    /// SHA-256 of the canonical TOML form: names this lens in kits and run folders.
    pub fn sha256(&self) -> String {
        sha256_hex(prescription::to_toml(self).as_bytes())
    }
}
