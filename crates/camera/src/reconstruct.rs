//! A capture to a picture: veiling glare, levels, white balance, flat field, demosaic, network, undistort, colour, upright.
//!
//! The order is [`isoplanat_imaging::develop`]'s. Without a kit the capture is developed from what its own file says, and
//! no network is applied.

mod memory;

use std::path::Path;
use std::time::{Duration, Instant};

use ndarray::{Array3, ArrayView2, ArrayView4};

use crate::kit::Kit;
use crate::lock;
use crate::network_process::{Apart, Network};
use crate::raw::{Area, RawCapture, RawPixels};
use crate::session::Options;
use crate::tiles;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::calibrate::file::MeasuredDistortion;
use isoplanat_imaging::calibrate::shading::MeasuredShading;
use isoplanat_imaging::develop::color::XYZ_FROM_SRGB;
use isoplanat_imaging::develop::distortion::Distortion;
use isoplanat_imaging::develop::shading::Shading;
use isoplanat_imaging::develop::{self, Balance, Development, IDENTITY, Rendering, glare};
use isoplanat_imaging::dng::CameraColour;
use isoplanat_imaging::exif::Exif;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Region;
use isoplanat_imaging::sensor::cfa::Cfa;

/// Pixels around one that demosaicking looks at.
const DEMOSAIC_REACH: usize = 4;

/// Which share of the light is taken off as veiling glare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Veil {
    /// The kit's; none where it names none.
    #[default]
    Kit,
    /// This one.
    Share(f64),
    /// What the picture's darkest parts suggest ([`glare::guess`]).
    Guess,
    /// None.
    Keep,
}

/// What a capture is made into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// A picture to look at.
    Rendered(Rendering),
    /// The camera's own linear colours, for programs that develop it further.
    Camera,
}

impl Default for Target {
    fn default() -> Self {
        Self::Rendered(Rendering::default())
    }
}

/// Which steps of a kit to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Steps {
    /// The network.
    pub network: bool,
    /// Undistortion.
    pub undistort: bool,
}

impl Default for Steps {
    fn default() -> Self {
        Self { network: true, undistort: true }
    }
}

/// A camera ready to develop captures.
#[derive(Debug, Default)]
pub struct Camera {
    calibrated: Option<Calibrated>,
    /// Without a kit: the distortion to take out, the falling light to divide out.
    measured: Option<Measured<Distortion>>,
    shading: Option<Measured<Shading>>,
    veil: Veil,
    target: Target,
}

/// What was measured of a lens, the frame it was measured in, and the camera's name, which may be empty.
#[derive(Debug)]
struct Measured<T> {
    what: &'static str,
    frame: Frame,
    value: T,
    camera: String,
}

#[derive(Debug)]
struct Calibrated {
    kit: Kit,
    network: Option<Network>,
    undistort: bool,
}

/// A finished picture.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Linear light from 0 to 1, upright, `[3, row, col]`, in the colours asked for.
    pub image: Array3<f32>,
    /// What the camera's own colours stand for.
    pub colour: CameraColour,
    /// Facts of the exposure.
    pub exif: Exif,
    /// The camera's name.
    pub camera: String,
    /// What the user should know, one sentence each.
    pub notes: Vec<String>,
    /// Fraction of pixels that undistortion had no source for (black).
    pub outside_fraction: f64,
    /// Number of tiles the network ran.
    pub tiles: usize,
    /// Where the time went.
    pub times: Times,
}

/// Time of each part of a reconstruction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Levels, white balance, flat field, demosaic.
    pub input: Duration,
    /// The network, tiles cut and put together included.
    pub network: Duration,
    /// Within the runtime itself, summed over tiles (which may run at the same time).
    pub runtime: Duration,
    /// Undistortion, colour, orientation.
    pub finish: Duration,
}

impl Camera {
    /// A camera without a kit: develops what the file itself says.
    pub fn plain() -> Self {
        Self::default()
    }

    /// A camera with a kit. The network's runtime is opened here, unless `steps` leaves the network out: in this process, without limits, for kits of one's own.
    ///
    /// # Errors
    /// A model the runtime refuses, or a named runtime that cannot be used.
    pub fn with_kit(kit: Kit, steps: Steps, options: &Options) -> Result<Self> {
        Self::opened(kit, steps, options, None)
    }

    /// [`Self::with_kit`], the network in a child process.
    ///
    /// # Errors
    /// As `Network::open`.
    pub fn with_kit_apart(kit: Kit, steps: Steps, options: &Options, apart: &Apart) -> Result<Self> {
        Self::opened(kit, steps, options, Some(apart))
    }

    /// With a kit, the network here or, where `apart` says how, in a child process.
    ///
    /// # Errors
    /// As `Network::open`.
    pub fn opened(mut kit: Kit, steps: Steps, options: &Options, apart: Option<&Apart>) -> Result<Self> {
        // The model's bytes are the runtime's from here on.
        let model = std::mem::take(&mut kit.model_bytes);
        let open = || Network::open(&model, &kit.model_path(), options, apart);
        let network = steps.network.then(open).transpose()?;
        let calibrated = Some(Calibrated { kit, network, undistort: steps.undistort });
        Ok(Self { calibrated, ..Self::default() })
    }

    /// The camera that takes a measured distortion out, where it has no kit.
    ///
    /// # Errors
    /// A frame that is none.
    pub(crate) fn straightening(self, measured: &MeasuredDistortion) -> Result<Self> {
        let (frame, value, camera) = (measured.frame()?, measured.distortion(), measured.camera.clone());
        Ok(Self { measured: Some(Measured { what: "distortion", frame, value, camera }), ..self })
    }

    /// The camera that divides a measured illumination out, where it has no kit.
    ///
    /// # Errors
    /// A frame or an illumination that is none.
    pub(crate) fn evening(self, measured: &MeasuredShading) -> Result<Self> {
        let (frame, value, camera) = (measured.frame()?, measured.shading()?, measured.camera.clone());
        Ok(Self { shading: Some(Measured { what: "illumination", frame, value, camera }), ..self })
    }

    /// The camera that takes `veil` off.
    ///
    /// # Errors
    /// A share that is none.
    pub fn without(self, veil: Veil) -> Result<Self> {
        if let Veil::Share(share) = veil {
            glare::check(share)?;
        }
        Ok(Self { veil, ..self })
    }

    /// The camera that makes captures into `target`.
    #[must_use]
    pub(crate) fn making(self, target: Target) -> Self {
        Self { target, ..self }
    }

    /// The share of glare in a capture, and what is said of it.
    fn share(&self, mosaic: ArrayView2<'_, f32>, cfa: Cfa, balance: &Balance, notes: &mut Vec<String>) -> f64 {
        match self.veil {
            Veil::Keep => 0.0,
            Veil::Share(share) => share,
            Veil::Kit => self.calibrated.as_ref().and_then(|c| c.kit.glare).unwrap_or(0.0),
            Veil::Guess => {
                let share = glare::guess(mosaic, cfa, balance);
                notes
                    .push(format!("veiling glare guessed from the darkest parts: {:.1} % of the light", 100.0 * share));
                share
            }
        }
    }

    /// The network, if one is applied.
    pub fn network(&self) -> Option<&Network> {
        self.calibrated.as_ref().and_then(|c| c.network.as_ref())
    }

    /// The part of the frame around `region` that the network sees of it: as far as a tile's overlap and its filters reach, from a multiple of
    /// the network's, to the frame's ends. `None` without a kit.
    pub fn around(&self, region: Region) -> Option<Region> {
        let kit = &self.calibrated.as_ref()?.kit;
        let multiple = kit.model.multiple.next_multiple_of(2);
        // The demosaicked border of a part is not the whole's.
        let wide =
            region.grown(kit.model.overlap_px + kit.guide.reach() + DEMOSAIC_REACH).common(Region::whole(&kit.frame));
        let step = multiple.cast_signed();
        let [row, col] = [wide.row, wide.col].map(|first| first.div_euclid(step) * step);
        let more = |first: isize, from: isize| (from - first).unsigned_abs();
        Some(Region { row, col, rows: wide.rows + more(row, wide.row), cols: wide.cols + more(col, wide.col) })
    }

    /// A part of the kit's frame developed as far as the network's input, and behind the network: balanced camera RGB, `[3, row, col]` each. `dn`
    /// holds raw values over `at`, which [`Self::around`] gives; glare is not taken off.
    ///
    /// # Errors
    /// No kit, or steps without the network; a network that fails.
    ///
    /// # Panics
    /// If `dn` has not the size of `at`.
    pub fn part(&self, dn: ArrayView2<'_, f32>, at: Region) -> Result<[Array3<f32>; 2]> {
        let (Some(calibrated), Some(network)) = (&self.calibrated, self.network()) else {
            return Err(Error::Internal("a part is seen by a kit with its network".into()));
        };
        assert_eq!(dn.dim(), (at.rows, at.cols), "values over the part");
        let Kit { sensor, frame, shading, .. } = &calibrated.kit;
        let flat_field = Some((frame, shading));
        let developed =
            develop::network_input_at(dn.to_owned(), at, sensor.cfa, &Balance::from_sensor(sensor), flat_field);
        let (restored, _) = calibrated.restored(network, developed.clone(), at, &|_, _| ())?;
        Ok([developed, restored])
    }

    /// Develops a capture; `file` names it in messages, `progress(done, all)` counts tiles.
    ///
    /// # Errors
    /// A capture that is not of the kit's camera, or a network that fails.
    pub fn reconstruct(
        &self,
        capture: RawCapture,
        file: &Path,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Picture> {
        let mut notes = capture.notes.clone();
        let (orientation, exif) = (capture.orientation, capture.exif.clone());
        let name = format!("{} {}", capture.make, capture.model).trim().to_owned();
        let distortion = self.measured.as_ref().map(|m| m.of(&capture, file, &mut notes)).transpose()?;
        let flat_field = self.shading.as_ref().map(|m| m.of(&capture, file, &mut notes)).transpose()?;
        let mut development = match &self.calibrated {
            Some(calibrated) => calibrated.development(&capture, file, &mut notes)?,
            None => Development {
                distortion: distortion.as_ref().map(|(frame, value)| (frame, *value)),
                flat_field: flat_field.as_ref().map(|(frame, value)| (frame, *value)),
                ..plain_development(&capture, &mut notes)
            },
        };
        let started = Instant::now();
        let mut camera = match capture.pixels {
            RawPixels::Mosaic { mut samples, cfa } => {
                let share = self.share(samples.view(), cfa, &development.balance, &mut notes);
                if share > 0.0 {
                    glare::remove(&mut samples, cfa, &development.balance, share);
                }
                develop::network_input(samples, cfa, &development.balance, development.flat_field)
            }
            RawPixels::Linear(mut samples) => {
                if matches!(self.veil, Veil::Share(_) | Veil::Guess) {
                    notes.push("glare is left in a picture that is demosaicked already".into());
                }
                develop::colour_input(&mut samples, &development.balance, development.flat_field);
                samples
            }
            RawPixels::Grey(samples) => {
                if matches!(self.veil, Veil::Share(_) | Veil::Guess) {
                    notes.push("glare is left in a picture without colours".into());
                }
                develop::grey_input(samples, &development.balance, development.flat_field)
            }
        };
        let mut times = Times { input: started.elapsed(), ..Times::default() };
        let mut count = 0;
        if let Some((calibrated, network)) = self.calibrated.as_ref().zip(self.network()) {
            let started = Instant::now();
            network.ready()?;
            count = calibrated.kit.tiling()?.count(camera.dim().1, camera.dim().2);
            let whole = Region::whole(&calibrated.kit.frame);
            (camera, times.runtime) = calibrated.restored(network, camera, whole, progress)?;
            times.network = started.elapsed();
        }
        let started = Instant::now();
        let colour =
            CameraColour { srgb_from_camera: development.srgb_from_camera, neutral: development.balance.neutral };
        let developed = match self.target {
            Target::Rendered(rendering) => {
                development.rendering = rendering;
                develop::finish(camera, &development)
            }
            Target::Camera => develop::unfinished(camera, &development),
        };
        // Calibrations state places of the whole active area: the part that is shown is cut out behind them.
        let image = orientation.apply(cut(developed.image, capture.crop));
        times.finish = started.elapsed();
        let outside_fraction = developed.outside_fraction;
        Ok(Picture { image, colour, exif, camera: name, notes, outside_fraction, tiles: count, times })
    }
}

impl<T> Measured<T> {
    /// Frame over the active area, and value, for a capture of the size that they were measured at: the active area's, or that of the part that
    /// pictures show.
    fn of(&self, capture: &RawCapture, file: &Path, notes: &mut Vec<String>) -> Result<(Frame, &T)> {
        let Area { row, column, rows, columns } = capture.crop;
        let frame = if (rows, columns) == (self.frame.rows, self.frame.columns) {
            let [x, y] = self.frame.axis_px;
            let (rows, columns) = capture.size();
            Frame { rows, columns, axis_px: [x + column as f64, y + row as f64], ..self.frame.clone() }
        } else {
            of_size(capture, &self.frame, file, &format!("the pictures that the {} was measured in", self.what))?;
            self.frame.clone()
        };
        let camera = format!("{} {}", capture.make, capture.model);
        if !self.camera.is_empty() && !same_camera(&camera, &self.camera) {
            notes.push(format!("the file is of {}, the {} was measured on {}", camera.trim(), self.what, self.camera));
        }
        Ok((frame, &self.value))
    }
}

impl Calibrated {
    /// What the network makes of `camera`, balanced camera RGB at `at` of the frame, and the time within the runtime.
    fn restored(
        &self,
        network: &Network,
        camera: Array3<f32>,
        at: Region,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<(Array3<f32>, Duration)> {
        let inside = std::sync::Mutex::new(Duration::ZERO);
        let one = |tile: ArrayView4<'_, f32>| {
            let (output, took) = network.run(tile)?;
            *lock(&inside) += took;
            Ok(output)
        };
        let (tiling, parallel) = (self.kit.tiling()?, network.parallel_tiles());
        let restored = tiles::run(camera, at, &self.kit.guide, tiling, parallel, &one, progress);
        let restored = restored.map_err(|e| e.in_file(self.kit.model_path()))?;
        Ok((restored, inside.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)))
    }

    /// The kit's own levels, colour and calibration; white balance as the capture was shot.
    fn development(&self, capture: &RawCapture, file: &Path, notes: &mut Vec<String>) -> Result<Development<'_>> {
        let Kit { sensor, frame, distortion, shading, .. } = &self.kit;
        let (path, file) = (file, file.display().to_string());
        match capture.pixels {
            RawPixels::Mosaic { cfa, .. } if cfa == sensor.cfa => {}
            RawPixels::Mosaic { cfa, .. } => {
                return Err(Error::bad(file, "colour filter", cfa.to_string(), format!("{}, the kit's", sensor.cfa)));
            }
            RawPixels::Linear(_) => {
                let found = "a picture that is developed or demosaicked already";
                return Err(Error::bad(file, "RAW", found, "the sensor's mosaic; without --kit it is only developed"));
            }
            RawPixels::Grey(_) => {
                let found = "a picture of a sensor without colours";
                return Err(Error::bad(file, "RAW", found, "the sensor's mosaic; without --kit it is only developed"));
            }
        }
        of_size(capture, frame, path, "the kit's frame")?;
        let mut balance = Balance::from_sensor(sensor);
        let range = balance.white[0] - balance.black[0];
        let far = |a: f32, b: f32| (a - b).abs() > 0.01 * range;
        if capture.corrected {
            // Digital numbers are gone: the samples run from 0 to 1.
            (balance.black, balance.white) = (capture.black, capture.white);
            notes.push("the file's own corrections are made before the kit's, by the file's levels".into());
        } else if (0..4).any(|i| far(capture.black[i], balance.black[i]) || far(capture.white[i], balance.white[i])) {
            notes.push(format!(
                "the file's levels ({} to {}) are not the kit's ({} to {}), which are used",
                capture.black[0], capture.white[0], balance.black[0], balance.white[0]
            ));
        }
        let camera = format!("{} {}", capture.make, capture.model);
        if !same_camera(&camera, &sensor.name) {
            notes.push(format!("the file is of {}, the kit is for {}", camera.trim(), sensor.name));
        }
        notes.extend(self.kit.valid.notes(&capture.exif));
        match capture.neutral {
            Some(neutral) => balance.neutral = neutral,
            None => notes.push("the file names no white balance; the kit's is used".into()),
        }
        Ok(Development {
            balance,
            flat_field: Some((frame, shading)),
            distortion: self.undistort.then_some((frame, distortion)),
            srgb_from_camera: sensor.srgb_from_camera,
            rendering: Rendering::default(),
        })
    }
}

/// The part of a picture, `[3, row, col]`, in place.
fn cut(image: Array3<f32>, part: Area) -> Array3<f32> {
    let (planes, rows, columns) = image.dim();
    if (part.rows, part.columns) == (rows, columns) {
        return image;
    }
    let image = if image.is_standard_layout() { image } else { image.as_standard_layout().into_owned() };
    let mut samples = image.into_raw_vec_and_offset().0;
    let mut to = 0;
    for plane in 0..planes {
        for row in part.row..part.row + part.rows {
            let from = (plane * rows + row) * columns + part.column;
            samples.copy_within(from..from + part.columns, to);
            to += part.columns;
        }
    }
    samples.truncate(to);
    Array3::from_shape_vec((planes, part.rows, part.columns), samples).expect("as many samples as the part has")
}

/// Refuses a capture that has not the size of `frame`, which is `whose`.
fn of_size(capture: &RawCapture, frame: &Frame, file: &Path, whose: &str) -> Result<()> {
    let (rows, columns) = capture.size();
    if (rows, columns) == (frame.rows, frame.columns) {
        return Ok(());
    }
    let allowed = format!("{} × {}, {whose}", frame.columns, frame.rows);
    Err(Error::bad(file.display().to_string(), "size", format!("{columns} × {rows} pixels"), allowed))
}

/// Whether a file's make and model can be the camera that a kit's sensor is named after.
fn same_camera(file: &str, sensor: &str) -> bool {
    let words = |text: &str| -> Vec<String> {
        let parts = text.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty());
        parts.map(str::to_lowercase).collect()
    };
    let (file, sensor) = (words(file), words(sensor));
    file.is_empty() || sensor.iter().all(|w| file.contains(w)) || file.iter().all(|w| sensor.contains(w))
}

/// Levels and colour as the file has them.
fn plain_development(capture: &RawCapture, notes: &mut Vec<String>) -> Development<'static> {
    if matches!(capture.pixels, RawPixels::Grey(_)) {
        let balance = Balance { black: capture.black, white: capture.white, neutral: [1.0; 3] };
        let rendering = Rendering::default();
        return Development { balance, flat_field: None, distortion: None, srgb_from_camera: IDENTITY, rendering };
    }
    let neutral = capture.neutral.unwrap_or_else(|| {
        let daylight = capture.camera_from_xyz.as_ref().and_then(daylight_response);
        let source = if daylight.is_some() { "daylight is assumed" } else { "none is applied" };
        notes.push(format!("the file names no white balance; {source}"));
        daylight.unwrap_or([1.0; 3])
    });
    let srgb_from_camera = capture.camera_from_xyz.as_ref().and_then(develop::srgb_from_camera).unwrap_or_else(|| {
        notes.push("no colour matrix is known for this camera; colours are the camera's own".into());
        IDENTITY
    });
    Development {
        balance: Balance { black: capture.black, white: capture.white, neutral },
        flat_field: None,
        distortion: None,
        srgb_from_camera,
        rendering: Rendering::default(),
    }
}

/// Response to D65 relative to green, from the colour matrix.
fn daylight_response(camera_from_xyz: &[[f64; 3]; 3]) -> Option<[f64; 3]> {
    let white: [f64; 3] = XYZ_FROM_SRGB.map(|row| row.iter().sum());
    let response = camera_from_xyz.map(|row| row.iter().zip(white).map(|(m, w)| m * w).sum::<f64>());
    let relative = response.map(|v| v / response[1]);
    relative.iter().all(|v| v.is_finite() && (0.02..=50.0).contains(v)).then_some(relative)
}

#[cfg(test)]
mod tests;
