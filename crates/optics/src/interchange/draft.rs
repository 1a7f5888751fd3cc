//! A lens as another program's file states it, before glasses, apertures and fields are resolved.

use super::media::Stated;
use crate::lens::{ImageSurface, Shape};
use isoplanat_base::error::Location;

/// Numbers of a file in mm, nm and degrees, in the order of the light.
#[derive(Debug)]
pub(super) struct Draft {
    /// Title of the lens; may be empty.
    pub(super) title: String,
    /// What kind of file it is, in words.
    pub(super) kind: &'static str,
    /// Object distance before the first surface, mm.
    pub(super) object_mm: f64,
    /// Medium between the object and the first surface.
    pub(super) object_medium: Stated,
    /// Where that stands in the file.
    pub(super) object_at: Location,
    /// How far behind the last distance's end the image plane lies, mm: not positive. Below 0 the image is virtual.
    pub(super) image_back_mm: f64,
    /// Form of the image surface.
    pub(super) image: ImageSurface,
    /// How large the stop is.
    pub(super) aperture: Option<Size>,
    /// What field points are.
    pub(super) field: FieldKind,
    /// Field points.
    pub(super) points: Vec<Point>,
    /// Wavelengths, nm, and their weights.
    pub(super) wavelengths: Vec<(f64, f64)>,
    /// Which of them is the reference.
    pub(super) primary: usize,
    /// Surfaces without object and image.
    pub(super) surfaces: Vec<Stage>,
    /// Catalogues that glasses are looked up in, first come first.
    pub(super) catalogues: Vec<String>,
    /// Width and height of the sensor, mm.
    pub(super) sensor_mm: Option<[f64; 2]>,
    /// What is told about the file: what was left out, resolved or assumed.
    pub(super) notes: Vec<String>,
}

/// How the size of the stop is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Size {
    /// Diameter of the entrance pupil, mm.
    EntrancePupil(f64),
    /// Focal length over entrance-pupil diameter.
    FNumber(f64),
    /// Paraxial f-number of the image of the object at its own distance.
    WorkingFNumber(f64),
    /// Sine of the marginal ray at the object.
    ObjectAperture(f64),
    /// Sine of the marginal ray at the image.
    ImageAperture(f64),
    /// The stop's own clear aperture.
    Stop,
}

/// What the numbers of a field point are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum FieldKind {
    /// Degrees at the entrance pupil.
    Angle,
    /// Heights of the object, mm.
    ObjectHeight,
    /// Heights of the paraxial image, mm.
    ParaxialImageHeight,
    /// Heights at which the chief ray lands, mm.
    ImageHeight,
}

/// A field point with its vignetting factors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) decentre: [f64; 2],
    pub(super) compression: [f64; 2],
}

/// One surface.
#[derive(Clone, Debug)]
pub(super) struct Stage {
    /// Where it stands in the file: `line 12 (SURF 3)`.
    pub(super) place: Location,
    /// Its form, mm.
    pub(super) shape: Shape,
    /// Distance to the next surface, mm.
    pub(super) thickness: f64,
    /// Where a solve puts the next surface at the paraxial image: how far beyond it, mm.
    pub(super) solved: Option<f64>,
    pub(super) medium: Stated,
    /// Clear semi-diameter that the file fixes, mm; `None` for one that follows the beam.
    pub(super) semi_diameter: Option<f64>,
    /// Clear semi-diameter that the file's program had computed, mm.
    pub(super) computed: Option<f64>,
    pub(super) stop: bool,
}

impl Stage {
    pub(super) fn plane(place: Location) -> Self {
        Self {
            place,
            shape: Shape::default(),
            thickness: 0.0,
            solved: None,
            medium: Stated::Air,
            semi_diameter: None,
            computed: None,
            stop: false,
        }
    }

    /// Whether it is a plane, for marking a place.
    pub(super) fn is_flat(&self) -> bool {
        self.shape.curvature == 0.0 && self.shape.ideal.is_none() && !self.shape.is_aspheric()
    }
}

impl Draft {
    /// Takes a curved image surface, and tells it; `place` is where it stands.
    pub(super) fn curve_image(&mut self, place: &Location, image: ImageSurface) {
        self.image = image;
        if !image.is_plane() {
            let conic =
                if image.conic == 0.0 { String::new() } else { format!(" and a conic constant of {}", image.conic) };
            self.notes.push(format!(
                "{place}: the image is curved, with a radius of {} mm{conic}: rays land on it, and places on it are told by x and y",
                image.curvature.recip()
            ));
        }
    }

    pub(super) fn new(kind: &'static str) -> Self {
        Self {
            title: String::new(),
            kind,
            object_mm: f64::INFINITY,
            object_medium: Stated::Air,
            object_at: Location::called("the object"),
            image_back_mm: 0.0,
            image: ImageSurface::default(),
            aperture: None,
            field: FieldKind::Angle,
            points: Vec::new(),
            wavelengths: Vec::new(),
            primary: 0,
            surfaces: Vec::new(),
            catalogues: Vec::new(),
            sensor_mm: None,
            notes: Vec::new(),
        }
    }
}
