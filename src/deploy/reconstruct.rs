//! A capture to a picture: veiling glare, levels, white balance, flat field, demosaic, network, undistort, colour, upright.
//!
//! The order is [`crate::imaging::develop`]'s. Without a kit the capture is developed from what its own file says, and
//! no network is applied.

use std::path::Path;
use std::time::{Duration, Instant};

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayView4};

use crate::calibrate::file::MeasuredDistortion;
use crate::deploy::kit::Kit;
use crate::deploy::raw::{RawCapture, RawPixels};
use crate::deploy::session::{Options, Session};
use crate::deploy::tiles;
use crate::error::{Error, Result};
use crate::imaging::develop::color::XYZ_FROM_SRGB;
use crate::imaging::develop::distortion::Distortion;
use crate::imaging::develop::{self, Balance, Development, IDENTITY, Rendering, glare};
use crate::imaging::exif::Exif;
use crate::imaging::frame::Frame;
use crate::imaging::plane::Region;
use crate::imaging::sensor::cfa::Cfa;
use crate::imaging::sensor::dng::CameraColour;

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
    /// Without a kit: the distortion to take out.
    measured: Option<Measured>,
    veil: Veil,
    target: Target,
}

/// A measured distortion, the frame it was measured in, and the camera's name, which may be empty.
#[derive(Debug)]
struct Measured {
    frame: Frame,
    distortion: Distortion,
    camera: String,
}

#[derive(Debug)]
struct Calibrated {
    kit: Kit,
    session: Option<Session>,
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

    /// A camera with a kit. The network's runtime is opened here, unless `steps` leaves the network out.
    ///
    /// # Errors
    /// A model the runtime refuses, or a named runtime that cannot be used.
    pub fn with_kit(kit: Kit, steps: Steps, options: &Options) -> Result<Self> {
        let session = if steps.network {
            Some(Session::open(&kit.model_bytes, Path::new(&kit.model.file), options)?)
        } else {
            None
        };
        let calibrated = Some(Calibrated { kit, session, undistort: steps.undistort });
        Ok(Self { calibrated, ..Self::default() })
    }

    /// A camera without a kit that takes a measured distortion out.
    ///
    /// # Errors
    /// A frame that is none.
    pub fn straightening(measured: &MeasuredDistortion) -> Result<Self> {
        let (frame, distortion) = (measured.frame()?, measured.distortion());
        Ok(Self { measured: Some(Measured { frame, distortion, camera: measured.camera.clone() }), ..Self::default() })
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
    pub fn making(self, target: Target) -> Self {
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

    /// The network's session, if one is applied.
    pub fn session(&self) -> Option<&Session> {
        self.calibrated.as_ref().and_then(|c| c.session.as_ref())
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
        let (Some(calibrated), Some(session)) = (&self.calibrated, self.session()) else {
            return Err(Error::Internal("a part is seen by a kit with its network".into()));
        };
        assert_eq!(dn.dim(), (at.rows, at.cols), "values over the part");
        let Kit { sensor, frame, shading, .. } = &calibrated.kit;
        let flat_field = Some((frame, shading));
        let developed = develop::network_input_at(dn, at, sensor.cfa, &Balance::from_sensor(sensor), flat_field);
        let (restored, _) = calibrated.restored(session, developed.view(), at, &|_, _| ())?;
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
        let mut development = match &self.calibrated {
            Some(calibrated) => calibrated.development(&capture, file, &mut notes)?,
            None => {
                let distortion = self.measured.as_ref().map(|m| m.of(&capture, file, &mut notes)).transpose()?;
                Development { distortion, ..plain_development(&capture, &mut notes) }
            }
        };
        let started = Instant::now();
        let mut camera = match capture.pixels {
            RawPixels::Mosaic { mut samples, cfa } => {
                let share = self.share(samples.view(), cfa, &development.balance, &mut notes);
                if share > 0.0 {
                    glare::remove(&mut samples, cfa, &development.balance, share);
                }
                develop::network_input(samples.view(), cfa, &development.balance, development.flat_field)
            }
            RawPixels::Linear(mut samples) => {
                if matches!(self.veil, Veil::Share(_) | Veil::Guess) {
                    notes.push("glare is left in a picture that is demosaicked already".into());
                }
                develop::balance_colours(&mut samples, &development.balance);
                samples
            }
        };
        let mut times = Times { input: started.elapsed(), ..Times::default() };
        let mut count = 0;
        if let Some((calibrated, session)) = self.calibrated.as_ref().zip(self.session()) {
            let started = Instant::now();
            count = calibrated.kit.tiling()?.count(camera.dim().1, camera.dim().2);
            let whole = Region::whole(&calibrated.kit.frame);
            (camera, times.runtime) = calibrated.restored(session, camera.view(), whole, progress)?;
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
        let image = orientation.apply(developed.image);
        times.finish = started.elapsed();
        let outside_fraction = developed.outside_fraction;
        Ok(Picture { image, colour, exif, camera: name, notes, outside_fraction, tiles: count, times })
    }
}

impl Measured {
    /// Frame and distortion for a capture of the size that they were measured at.
    fn of(&self, capture: &RawCapture, file: &Path, notes: &mut Vec<String>) -> Result<(&Frame, &Distortion)> {
        of_size(capture, &self.frame, file, "the pictures that the distortion was measured in")?;
        let camera = format!("{} {}", capture.make, capture.model);
        if !self.camera.is_empty() && !same_camera(&camera, &self.camera) {
            notes.push(format!("the file is of {}, the distortion was measured on {}", camera.trim(), self.camera));
        }
        Ok((&self.frame, &self.distortion))
    }
}

impl Calibrated {
    /// What the network makes of `camera`, balanced camera RGB at `at` of the frame, and the time within the runtime.
    fn restored(
        &self,
        session: &Session,
        camera: ArrayView3<'_, f32>,
        at: Region,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<(Array3<f32>, Duration)> {
        let inside = std::sync::Mutex::new(Duration::ZERO);
        let network = |tile: ArrayView4<'_, f32>| {
            let started = Instant::now();
            let output = session.run(tile);
            *inside.lock().unwrap_or_else(std::sync::PoisonError::into_inner) += started.elapsed();
            output
        };
        let (tiling, parallel) = (self.kit.tiling()?, session.parallel_tiles());
        let restored = tiles::run(camera, at, &self.kit.guide, tiling, parallel, &network, progress)?;
        Ok((restored, inside.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)))
    }

    /// The kit's own levels, colour and calibration; white balance as the capture was shot.
    fn development(&self, capture: &RawCapture, file: &Path, notes: &mut Vec<String>) -> Result<Development<'_>> {
        let Kit { sensor, frame, distortion, shading, .. } = &self.kit;
        of_size(capture, frame, file, "the kit's frame")?;
        let file = file.display().to_string();
        match capture.pixels {
            RawPixels::Mosaic { cfa, .. } if cfa == sensor.cfa => {}
            RawPixels::Mosaic { cfa, .. } => {
                return Err(Error::bad(file, "colour filter", cfa.to_string(), format!("{}, the kit's", sensor.cfa)));
            }
            RawPixels::Linear(_) => {
                let found = "a picture that is demosaicked already";
                return Err(Error::bad(file, "RAW", found, "the sensor's mosaic; without --kit it is only developed"));
            }
        }
        let mut balance = Balance::from_sensor(sensor);
        let range = balance.white[0] - balance.black[0];
        let far = |a: f32, b: f32| (a - b).abs() > 0.01 * range;
        if (0..4).any(|i| far(capture.black[i], balance.black[i]) || far(capture.white[i], balance.white[i])) {
            notes.push(format!(
                "the file's levels ({} to {}) are not the kit's ({} to {}), which are used",
                capture.black[0], capture.white[0], balance.black[0], balance.white[0]
            ));
        }
        let camera = format!("{} {}", capture.make, capture.model);
        if !same_camera(&camera, &sensor.name) {
            notes.push(format!("the file is of {}, the kit is for {}", camera.trim(), sensor.name));
        }
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
mod tests {
    use super::*;
    use crate::deploy::kit::tests::kit;
    use crate::deploy::orientation::Orientation;
    use crate::deploy::raw;
    use crate::deploy::session::Choice;
    use crate::testing::shared;
    use ndarray::Array2;

    fn capture(columns: usize, rows: usize) -> RawCapture {
        let rng = &mut fastrand::Rng::with_seed(2);
        let samples = Array2::from_shape_fn((rows, columns), |(r, c)| {
            (800.0 + 500.0 * (r as f32 / 9.0).sin() * (c as f32 / 7.0).cos() + 20.0 * rng.f32()).round()
        });
        RawCapture {
            pixels: RawPixels::Mosaic { samples, cfa: Cfa::RGGB },
            black: [256.0; 4],
            white: [4095.0; 4],
            neutral: None,
            camera_from_xyz: None,
            orientation: Orientation::from_exif(6),
            make: "Test".into(),
            model: "Test".into(),
            exif: Exif::default(),
            notes: Vec::new(),
        }
    }

    fn tract() -> Options {
        Options { choice: Choice::Tract, threads: 2, ..Options::default() }
    }

    /// A measured distortion is taken out of a capture of its own size as a kit's is; another size is refused, another camera told.
    #[test]
    fn a_measured_distortion_is_taken_out() {
        let text = "schema = 1\ncamera = \"Other 5\"\nlens = \"\"\nsource = \"test\"\ncolumns = 150\nrows = 110\n\
            focal_length_px = 120.0\ncentre_px = [70.0, 60.0]\nk = [-0.2, 0.01, 0.0]\nmax_slope = 0.7\nrms_px = 0.1\n";
        let measured = MeasuredDistortion::parse(text, "d.toml").expect("valid");
        let camera = Camera::straightening(&measured).expect("a frame");
        let straight = camera.reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert!(straight.notes.iter().any(|n| n.contains("Other 5")), "{:?}", straight.notes);
        let bent = Camera::plain().reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert_eq!(bent.outside_fraction, 0.0);
        // Barrel distortion taken out: the corners of the straight picture lie beyond nothing, the centre stays.
        let centre = |p: &Picture| p.image[[1, 70, 110 - 60]];
        assert!((centre(&straight) - centre(&bent)).abs() < 0.02, "{} {}", centre(&straight), centre(&bent));
        let off = (&straight.image - &bent.image).mapv(f32::abs).mean().expect("pixels");
        assert!(off > 0.01, "{off}");
        let error = camera.reconstruct(capture(152, 110), Path::new("a.dng"), &|_, _| ()).expect_err("another size");
        assert!(error.to_string().contains("150 × 110") && error.exit_code() == 2, "{error}");
    }

    #[test]
    fn the_whole_path_equals_its_steps_in_order() {
        let (kit, capture) = (kit(150, 110), capture(150, 110));
        let camera = Camera::with_kit(kit.clone(), Steps::default(), &tract()).expect("opens");
        let picture = camera.reconstruct(capture.clone(), Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert_eq!(picture.image.dim(), (3, 150, 110), "turned upright");
        // The same by the pure functions, the network in one piece.
        let RawPixels::Mosaic { samples, cfa } = &capture.pixels else { panic!("a mosaic") };
        let development = Development {
            balance: Balance::from_sensor(&kit.sensor),
            flat_field: Some((&kit.frame, &kit.shading)),
            distortion: Some((&kit.frame, &kit.distortion)),
            srgb_from_camera: kit.sensor.srgb_from_camera,
            rendering: Rendering::default(),
        };
        let session = Session::open(&kit.model_bytes, Path::new("m"), &tract()).expect("opens");
        let network = |input: Array3<f32>| {
            let tiling = tiles::Tiling::new(256, 24, 4).expect("valid");
            tiles::run(
                input.view(),
                Region::whole(&kit.frame),
                &kit.guide,
                tiling,
                1,
                &|t: ArrayView4<'_, f32>| session.run(t),
                &|_, _| (),
            )
        };
        let expected = develop::develop(samples.view(), *cfa, &development, network).expect("develops");
        let expected = Orientation::from_exif(6).apply(expected.image);
        let worst = (&picture.image - &expected).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(worst <= 2e-6, "{worst}");
    }

    /// A part with what the network sees around it is what it is in the whole: at a corner, at an edge, in the middle.
    #[test]
    fn a_part_is_what_it_is_in_the_whole() {
        let (kit, capture) = (kit(230, 210), capture(230, 210));
        let RawPixels::Mosaic { samples, .. } = &capture.pixels else { panic!("a mosaic") };
        let camera = Camera::with_kit(kit.clone(), Steps::default(), &tract()).expect("opens");
        let [all, restored] = camera.part(samples.view(), Region::whole(&kit.frame)).expect("develops");
        for (row, col) in [(0, 0), (170, 96), (88, 101)] {
            let region = Region { row, col, rows: 40, cols: 32 };
            let at = camera.around(region).expect("a kit");
            assert!(at.rows < 150 && at.cols < 150, "a part: {at:?}");
            let within = |r: Region, a: &Array3<f32>| {
                let (i, j) = ((region.row - r.row).unsigned_abs(), (region.col - r.col).unsigned_abs());
                a.slice(ndarray::s![.., i..i + region.rows, j..j + region.cols]).to_owned()
            };
            let of = |r: Region| {
                let (i, j) = (r.row.unsigned_abs(), r.col.unsigned_abs());
                camera.part(samples.slice(ndarray::s![i..i + r.rows, j..j + r.cols]), r).expect("develops")
            };
            for (part, whole) in of(at).iter().zip([&all, &restored]) {
                let off = (&within(at, part) - &within(Region::whole(&kit.frame), whole)).mapv(f32::abs);
                let worst = off.iter().fold(0.0_f32, |m, v| m.max(*v));
                assert!(worst <= 2e-6, "{row}, {col}: {worst}");
            }
        }
    }

    #[test]
    fn steps_can_be_left_out() {
        let (kit, capture) = (kit(150, 110), capture(150, 110));
        let steps = Steps { network: false, undistort: false };
        let camera = Camera::with_kit(kit, steps, &tract()).expect("opens");
        let picture = camera.reconstruct(capture, Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert!(camera.session().is_none() && picture.tiles == 0 && picture.outside_fraction == 0.0);
        assert!(picture.notes.iter().any(|n| n.contains("white balance")));
    }

    #[test]
    fn other_cameras_are_told_of() {
        assert!(same_camera("NIKON CORPORATION NIKON D50", "Nikon D50") && same_camera("", "generic"));
        assert!(same_camera("Isoplanat generic 12-bit RGB sensor", "generic 12-bit RGB sensor"));
        assert!(!same_camera("Canon EOS 6D", "Nikon D50") && !same_camera("Nikon D60", "Nikon D50"));
        let camera =
            Camera::with_kit(kit(150, 110), Steps { network: false, undistort: true }, &tract()).expect("opens");
        let picture = camera.reconstruct(capture(150, 110), Path::new("a.dng"), &|_, _| ()).expect("develops");
        assert!(picture.notes.iter().any(|n| n.contains("of Test Test")), "{:?}", picture.notes);
    }

    #[test]
    fn captures_of_another_camera_are_refused() {
        let kit = kit(150, 110);
        let camera = Camera::with_kit(kit, Steps { network: false, undistort: true }, &tract()).expect("opens");
        let refused = |capture: RawCapture| {
            let error = camera.reconstruct(capture, Path::new("a.dng"), &|_, _| ()).expect_err("refused");
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        };
        assert!(refused(capture(148, 110)).contains("148 × 110"));
        let mut other = capture(150, 110);
        other.pixels = RawPixels::Mosaic { samples: Array2::zeros((110, 150)), cfa: Cfa::BGGR };
        assert!(refused(other).contains("BGGR"));
        let mut linear = capture(150, 110);
        linear.pixels = RawPixels::Linear(Array3::zeros((3, 110, 150)));
        assert!(refused(linear).contains("demosaicked"));
    }

    #[test]
    fn balanced_captures_have_libraws_colour() {
        for (name, balanced) in [
            ("nikon_crop_gbrg_u16.dng", true),
            ("nikon_crop_rggb_lj92.dng", true),
            ("canon_eos_6d_linear_lossy.dng", true),
            ("RAW_NIKON_D1.NEF", false),
        ] {
            let Some(path) = shared(&format!("data/raw/{name}")) else { return };
            let Some(facts) = shared(&format!("data/raw/{name}.json")) else { return };
            let facts: serde_json::Value =
                serde_json::from_str(&std::fs::read_to_string(facts).expect("readable")).expect("JSON");
            let capture = raw::decode(&path).expect("decodes");
            let mut balance = plain_development(&capture, &mut Vec::new()).balance;
            if !balanced {
                balance.neutral = [1.0; 3];
            }
            let camera = match capture.pixels {
                RawPixels::Mosaic { samples, cfa } => develop::network_input(samples.view(), cfa, &balance, None),
                RawPixels::Linear(mut samples) => {
                    develop::balance_colours(&mut samples, &balance);
                    samples
                }
            };
            for c in 0..3 {
                // LibRaw cuts at white, on 16 bits.
                let plane = camera.index_axis(ndarray::Axis(0), c);
                let mean = plane.iter().map(|v| f64::from(v.clamp(0.0, 1.0))).sum::<f64>() / plane.len() as f64;
                let expected = facts["linear_demosaic_camera_rgb16"]["mean_rgb"][c].as_f64().expect("mean") / 65_535.0;
                // The demosaicking kernels differ.
                assert!((mean / expected - 1.0).abs() < 4e-3, "{name} {c}: {mean} {expected}");
            }
        }
    }

    #[test]
    fn the_same_scene_from_both_layouts_is_the_same_picture() {
        // The two DNG hold the same samples, arranged differently within each cell of the mosaic.
        let (Some(a), Some(b)) =
            (shared("data/raw/nikon_crop_gbrg_u16.dng"), shared("data/raw/nikon_crop_rggb_lj92.dng"))
        else {
            return;
        };
        let develop = |path: &Path| {
            let capture = raw::decode(path).expect("decodes");
            Camera::plain().reconstruct(capture, path, &|_, _| ()).expect("develops").image
        };
        let (a, b) = (develop(&a), develop(&b));
        let mean = |i: &Array3<f32>, c: usize| i.index_axis(ndarray::Axis(0), c).mean().expect("pixels");
        for c in 0..3 {
            assert!((mean(&a, c) / mean(&b, c) - 1.0).abs() < 0.01, "channel {c}");
        }
    }
}
