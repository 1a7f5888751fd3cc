//! What stands before the sensor of a training: a lens of a prescription, or one that was measured on its camera.

use std::path::{Path, PathBuf};

use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::calibrate::lens::MeasuredLens;
use isoplanat_imaging::develop::distortion::Distortion;
use isoplanat_imaging::develop::shading::Shading;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::render::light::Light;
use isoplanat_imaging::render::plan::{self, ILLUMINATIONS, quadrature};
use isoplanat_imaging::render::{Renderer, Settings, frame_of};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::{Lens, prescription};
use isoplanat_optics::psf::Optics;

/// The lens in a run's folder.
const LENS: &str = "lens.toml";
/// The folder of a measured one there.
const MEASURED: &str = "lens";

/// Wavelengths that a kit's flat field is averaged over, and the degree of the polynomials over the stop.
const WAVELENGTHS: usize = 7;
const DEGREE: usize = 9;

/// A lens, as known.
#[derive(Clone, Debug, PartialEq)]
pub enum Subject {
    /// By its prescription.
    Lens(Box<Lens>),
    /// By measurements on its camera.
    Measured(Box<MeasuredLens>),
}

impl From<Lens> for Subject {
    fn from(lens: Lens) -> Self {
        Self::Lens(Box::new(lens))
    }
}

impl Subject {
    /// The folder of the measured lens that a run's folder has in place of a prescription.
    pub(crate) fn measured_in(folder: &Path) -> Option<PathBuf> {
        let inside = folder.join(MEASURED);
        (MeasuredLens::is_at(&inside) && !folder.join(LENS).exists()).then_some(inside)
    }

    /// That of a run's folder.
    ///
    /// # Errors
    /// A folder without one, or with files that are wrong.
    pub fn of_run(folder: &Path) -> Result<Self> {
        if let Some(measured) = Self::measured_in(folder) {
            return Ok(Self::Measured(Box::new(MeasuredLens::load(&measured)?)));
        }
        Ok(prescription::load(&folder.join(LENS))?.into())
    }

    /// Writes it into a run's folder.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        match self {
            Self::Lens(lens) => prescription::save(lens, &folder.join(LENS)),
            Self::Measured(lens) => {
                let inside = folder.join(MEASURED);
                std::fs::create_dir(&inside).map_err(|e| Error::writing(&inside, e))?;
                lens.save(&inside)
            }
        }
    }

    /// What it is called.
    pub fn name(&self) -> &str {
        match self {
            Self::Lens(lens) => &lens.name,
            Self::Measured(lens) => &lens.name,
        }
    }

    /// SHA-256 of what is known of it, in hexadecimal.
    pub fn sha256(&self) -> String {
        match self {
            Self::Lens(lens) => lens.sha256(),
            Self::Measured(lens) => lens.sha256().to_owned(),
        }
    }

    /// The lens, where there is a prescription; `what` needs it.
    ///
    /// # Errors
    /// A measured one.
    pub fn lens(&self, what: &str) -> Result<&Lens> {
        match self {
            Self::Lens(lens) => Ok(lens),
            Self::Measured(_) => Err(Error::bad(
                self.name(),
                what,
                "a measured lens",
                "a lens with a prescription: there are no rays to trace",
            )),
        }
    }

    /// Its frame.
    ///
    /// # Errors
    /// A raster that is none.
    pub fn frame(&self) -> Result<Frame> {
        match self {
            Self::Lens(lens) => frame_of(lens),
            Self::Measured(lens) => lens.frame(),
        }
    }

    /// 1/distance of its object, 1/mm.
    pub fn vergence(&self) -> f64 {
        match self {
            Self::Lens(lens) => lens.object_vergence,
            Self::Measured(_) => 0.0,
        }
    }

    /// Plans the whole of its frame.
    ///
    /// # Errors
    /// As [`Renderer::planned`]; of a measured lens, another distance than its own.
    pub fn renderer(&self, density: &SpectralDensity, vergences: &[f64], settings: Settings) -> Result<Renderer> {
        match self {
            Self::Lens(lens) => Renderer::planned(lens, &frame_of(lens)?, density, vergences, settings),
            Self::Measured(lens) => {
                if let Some(other) = vergences.iter().find(|v| **v != 0.0) {
                    let found = format!("{} mm", other.recip());
                    let allowed = "inf: kernels were measured at one distance, which counts as infinity";
                    return Err(Error::bad(lens.name.clone(), "object distance", found, allowed));
                }
                let optics = lens.optics()?;
                Renderer::measured(optics, &lens.frame()?, settings).map_err(|e| e.in_file(Path::new(&lens.name)))
            }
        }
    }

    /// What a kit says of it, for light as in `density`: where things are seen, and how bright. No kernel is made for it.
    ///
    /// # Errors
    /// As [`Renderer::planned`]; a corner without light.
    pub fn calibration(&self, density: &SpectralDensity) -> Result<Calibration> {
        match self {
            Self::Lens(lens) => {
                let (rule, frame) = (quadrature(density, WAVELENGTHS, &[0, 1, 2]), frame_of(lens)?);
                let fineness = (DEGREE, ILLUMINATIONS);
                Calibration::of_optics(&plan::optics(lens, &frame, &[lens.object_vergence], rule, fineness)?.0, &frame)
            }
            Self::Measured(lens) => Ok(Calibration { distortion: lens.distortion(), shading: lens.shading()? }),
        }
    }
}

/// What a kit says of a lens: where things are seen, and how bright.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The paper's polynomial.
    pub distortion: Distortion,
    /// Flat field.
    pub shading: Shading,
}

impl Calibration {
    /// Of a lens that was traced over `frame`, at its first distance.
    ///
    /// # Errors
    /// A distortion that is not monotonic next to the axis; a corner without light.
    pub fn of_optics(optics: &Optics, frame: &Frame) -> Result<Self> {
        let distortion = Distortion::of_map(&optics.maps[0], frame.max_radius_mm())?;
        Ok(Self { distortion, shading: Light::new(optics, frame).shading()? })
    }
}
