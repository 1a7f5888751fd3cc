//! A lens that was measured on its camera: point spread functions, distortion and falling light, in one folder, in place of a prescription.
//!
//! All three are in pixels of the pictures they were measured in; here a pixel counts as a millimetre, as in the frames of the single files. The object
//! is taken to be at infinity: kernels are those of the distance at which the board stood.

use std::path::Path;

use super::file::MeasuredDistortion;
use super::shading::MeasuredShading;
use crate::develop::distortion::Distortion;
use crate::develop::shading::Shading;
use crate::frame::Frame;
use isoplanat_base::atomic::{self, sha256_hex};
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::psf::measured::{Falloff, MeasuredPsf};
use isoplanat_optics::psf::{Optics, SensorMap, SensorPoint};

/// The files of the folder.
const PSF: &str = "psf.npz";
const DISTORTION: &str = "distortion.toml";
const SHADING: &str = "shading.toml";
/// Radii that the map of the distortion is fitted through.
const RADII: u32 = 96;
/// Pixels by which the map may miss the distortion's polynomial before it is told.
const MISSES: f64 = 0.05;
/// Change of the illumination by a shift of its centre before it is told.
const SHIFTS: f64 = 0.01;

/// A measured lens.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredLens {
    /// What it is called.
    pub name: String,
    /// Kernels over radius and colour.
    pub psf: MeasuredPsf,
    /// Where things are seen.
    pub distortion: MeasuredDistortion,
    /// How light falls off, where that was measured.
    pub shading: Option<MeasuredShading>,
    /// By which kernels and kits know it.
    sha256: String,
}

impl MeasuredLens {
    /// Whether a folder is one: it has point spread functions.
    pub fn is_at(folder: &Path) -> bool {
        folder.join(PSF).is_file()
    }

    /// Reads `psf.npz`, `distortion.toml` and, where there is one, `shading.toml` of a folder.
    ///
    /// # Errors
    /// A file that is missing or wrong; files of different pictures.
    pub fn load(folder: &Path) -> Result<Self> {
        let shading = folder.join(SHADING);
        let shading = if shading.exists() { Some(MeasuredShading::load(&shading)?) } else { None };
        let psf = MeasuredPsf::load(&folder.join(PSF))?;
        let mut distortion = MeasuredDistortion::load(&folder.join(DISTORTION))?;
        if distortion.lens.is_empty() && distortion.camera.is_empty() {
            // It is known by its folder from here on, wherever it is kept.
            let whole = folder.canonicalize().map_err(|e| Error::reading(folder, e))?;
            distortion.lens =
                whole.file_name().map_or_else(|| "measured lens".into(), |n| n.to_string_lossy().into_owned());
        }
        Self::new(psf, distortion, shading).map_err(|e| e.in_file(folder))
    }

    /// From its parts.
    ///
    /// # Errors
    /// Parts of different pictures.
    pub fn new(psf: MeasuredPsf, distortion: MeasuredDistortion, shading: Option<MeasuredShading>) -> Result<Self> {
        let size = [distortion.columns, distortion.rows];
        let differs = |file: &str, found: String, allowed: String| {
            let allowed = format!("{allowed}, as in {DISTORTION}: files of one camera and one run");
            Err(Error::bad("", file, found, allowed))
        };
        if psf.size != size {
            return differs(PSF, format!("size {:?}", psf.size), format!("{size:?} pixels"));
        }
        if psf.centre_px.iter().zip(distortion.centre_px).any(|(a, b)| (a - b).abs() > 1e-6) {
            return differs(PSF, format!("centre_px {:?}", psf.centre_px), format!("{:?}", distortion.centre_px));
        }
        if let Some(s) = shading.as_ref().filter(|s| [s.columns, s.rows] != size) {
            return differs(SHADING, format!("{:?} pixels", [s.columns, s.rows]), format!("{size:?}"));
        }
        // Of what is known, not of how a file is packed.
        let mut known = distortion.text()?.into_bytes();
        known.extend(shading.as_ref().map_or_else(|| Ok(String::new()), MeasuredShading::text)?.bytes());
        let scalars = [psf.moves.reach_px, psf.moves.spacing_px].into_iter().chain(psf.radii_px.iter().copied());
        known.extend(scalars.flat_map(f64::to_le_bytes));
        for knot in 0..psf.radii_px.len() {
            for channel in 0..psf.channels() {
                known.extend(psf.weights(knot, channel).iter().flat_map(|w| w.to_le_bytes()));
            }
        }
        let sha256 = sha256_hex(&known);
        let name = match (distortion.lens.as_str(), distortion.camera.as_str()) {
            ("", camera) => camera.to_owned(),
            (lens, "") => lens.to_owned(),
            (lens, camera) => format!("{lens} on {camera}"),
        };
        Ok(Self { name, psf, distortion, shading, sha256 })
    }

    /// Writes its files into a folder that is there.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        atomic::write_bytes(&folder.join(PSF), &self.psf.to_npz()?)?;
        atomic::write_bytes(&folder.join(DISTORTION), self.distortion.text()?.as_bytes())?;
        self.shading.as_ref().map_or(Ok(()), |s| atomic::write_bytes(&folder.join(SHADING), s.text()?.as_bytes()))
    }

    /// SHA-256 of what its files say, in hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The frame of its pictures, in which a pixel is a millimetre.
    ///
    /// # Errors
    /// None where [`Self::new`] made it.
    pub fn frame(&self) -> Result<Frame> {
        self.distortion.frame()
    }

    /// The polynomial for a kit.
    pub fn distortion(&self) -> Distortion {
        self.distortion.distortion()
    }

    /// The flat field for a kit: about the centre of distortion, 1 there, and 1 everywhere where none was measured.
    ///
    /// # Errors
    /// None where [`Self::new`] made it.
    pub fn shading(&self) -> Result<Shading> {
        let Some(measured) = &self.shading else { return Ok(Shading::none()) };
        let mut shading = measured.shading()?;
        for values in &mut shading.illumination {
            let centre = values[0];
            values.iter_mut().for_each(|v| *v /= centre);
        }
        Ok(shading)
    }

    /// Where on the sensor an object's slope is seen, for an object at infinity.
    ///
    /// # Errors
    /// A distortion that folds on the way to the frame's corner.
    pub fn map(&self) -> Result<SensorMap> {
        let (far, model) = (self.frame()?.max_radius_mm(), self.distortion());
        let radii: Vec<f64> = (0..=RADII).map(|i| far * f64::from(i) / f64::from(RADII)).collect();
        let slopes: Vec<f64> = radii.iter().map(|r| model.slope_from_sensor(*r)).collect();
        SensorMap::through(&radii, &slopes, 0.0, 0.0).map_err(|radius_px| {
            let place = format!("distortion at {radius_px:.3} pixels from the centre");
            let allowed =
                "a distortion that grows smoothly to the frame's corner: fewer --terms, or corners farther out";
            Error::bad(self.name.clone(), place, "the picture folds", allowed)
        })
    }

    /// What image formation reads of it.
    ///
    /// # Errors
    /// As [`Self::map`].
    pub fn optics(&self) -> Result<Optics> {
        let Shading { radius_mm, illumination } = self.shading()?;
        let light = Falloff { radii_px: radius_mm, light: illumination };
        Ok(Optics::measured(self.psf.clone(), light, self.map()?, 1.0))
    }

    /// What is left open or taken for granted, in words.
    ///
    /// # Errors
    /// As [`Self::map`].
    pub fn notes(&self) -> Result<Vec<String>> {
        let (mut notes, far) = (Vec::new(), self.frame()?.max_radius_mm());
        if let Some(measured) = &self.shading {
            let [dx, dy] = [0, 1].map(|k| measured.centre_px[k] - self.distortion.centre_px[k]);
            let (shift, light) = (dx.hypot(dy), measured.shading()?);
            let off = |(i, c): (u32, usize)| {
                let r = far * f64::from(i) / 256.0;
                let light = |at: f64| light.at(c, SensorPoint::along([1.0, 0.0], at));
                let change = |at: f64| (light(at) / light(r) - 1.0).abs();
                change(r + shift).max(change((r - shift).abs()))
            };
            let most = (0..256).flat_map(|i| (0..3).map(move |c| (i, c))).map(off).fold(0.0, f64::max);
            if most > SHIFTS {
                notes.push(format!(
                    "illumination is taken about the centre of distortion, {shift:.0} pixels from its own: up to {:.0} % off",
                    100.0 * most
                ));
            }
            let names = [
                ("camera", &self.distortion.camera, &measured.camera),
                ("lens", &self.distortion.lens, &measured.lens),
            ];
            for (what, here, there) in names {
                if !here.is_empty() && !there.is_empty() && here != there {
                    notes.push(format!("{SHADING} is of {what} `{there}`, {DISTORTION} of `{here}`"));
                }
            }
        } else {
            notes.push(format!("no {SHADING}: light is taken not to fall off"));
        }
        let map = self.map()?;
        if map.residual_mm > MISSES {
            notes.push(format!(
                "the map of the distortion misses its polynomial by up to {:.2} pixels",
                map.residual_mm
            ));
        }
        let seen = self.psf.radii_px[self.psf.radii_px.len() - 1];
        if seen < 0.9 * far {
            notes.push(format!(
                "kernels are known to {seen:.0} pixels from the centre, and held from there to the corner at {far:.0}"
            ));
        }
        Ok(notes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::shading::Rings;
    use super::*;
    use crate::plane::Region;
    use crate::render::{Channels, Renderer, Settings};
    use isoplanat_optics::psf::measured::Moves;

    fn distortion() -> MeasuredDistortion {
        MeasuredDistortion {
            schema: 1,
            camera: "C".into(),
            lens: "L".into(),
            source: "a test".into(),
            columns: 96,
            rows: 64,
            focal_length_px: 150.0,
            centre_px: [50.0, 31.0],
            k: [-0.2, 0.03, 0.0],
            max_slope: 0.4,
            rms_px: 0.1,
        }
    }

    fn shading() -> MeasuredShading {
        let falls: Vec<f64> = vec![1.0, 0.8, 0.5];
        MeasuredShading {
            schema: 1,
            camera: String::new(),
            lens: String::new(),
            source: "a test".into(),
            columns: 96,
            rows: 64,
            centre_px: [48.0, 32.0],
            rms: 0.01,
            illumination: Rings {
                radius_px: vec![0.0, 30.0, 60.0],
                red: falls.clone(),
                green: falls.clone(),
                blue: falls.iter().map(|v| v * v).collect(),
            },
        }
    }

    /// Moves of its own for every colour and radius; sums to one.
    fn psf(size: [usize; 2], centre_px: [f64; 2], colours: usize) -> MeasuredPsf {
        let moves = Moves::within(4.0, 0.5).expect("valid");
        let kernel = |radius: f64, c: usize| {
            let (along, across) = (0.9 + 0.004 * radius + 0.2 * c as f64, 0.9 + 0.001 * radius + 0.2 * c as f64);
            let mut w: Vec<f64> = moves
                .iter()
                .map(|([a, b], _)| (-((a - 0.003 * radius) / along).powi(2) - (b / across).powi(2)).exp())
                .collect();
            let sum: f64 = moves.iter().zip(&w).map(|((_, n), w)| n * w).sum();
            w.iter_mut().for_each(|w| *w /= sum);
            w
        };
        let radii = vec![0.0, 20.0, 40.0, 60.0];
        let weights = radii.iter().map(|r| (0..colours).map(|c| kernel(*r, c)).collect()).collect();
        MeasuredPsf::new(size, centre_px, moves, radii, weights).expect("valid")
    }

    fn lens(colours: usize) -> MeasuredLens {
        MeasuredLens::new(psf([96, 64], [50.0, 31.0], colours), distortion(), Some(shading())).expect("valid")
    }

    #[test]
    fn folders_come_back_and_those_of_two_cameras_are_refused() {
        let folder = tempfile::tempdir().expect("temporary folder");
        assert!(!MeasuredLens::is_at(folder.path()) && MeasuredLens::load(folder.path()).is_err());
        let lens = lens(3);
        lens.save(folder.path()).expect("writes");
        assert!(MeasuredLens::is_at(folder.path()));
        let read = MeasuredLens::load(folder.path()).expect("reads");
        assert_eq!((&read, read.name.as_str()), (&lens, "L on C"));
        assert_eq!(read.notes().expect("a map").len(), 1, "{:?}", read.notes());
        for (psf, distortion, shading, words) in [
            (psf([64, 96], [50.0, 31.0], 3), distortion(), None, "psf.npz"),
            (psf([96, 64], [50.1, 31.0], 3), distortion(), None, "centre_px"),
            (lens.psf.clone(), distortion(), Some(MeasuredShading { rows: 63, ..shading() }), "shading.toml"),
        ] {
            let error = MeasuredLens::new(psf, distortion, shading).expect_err(words);
            assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
        }
        let other = MeasuredLens::new(lens.psf.clone(), distortion(), None).expect("valid");
        assert_ne!(other.sha256(), lens.sha256());
        assert!(other.notes().expect("a map")[0].contains("shading.toml"));
    }

    /// A point of light at any place of the frame, through the renderer, is the kernel of that place times the illumination there, where the distortion
    /// lands it; a psf of one colour is that of all.
    #[test]
    fn points_are_seen_as_their_kernels_where_the_distortion_lands_them() {
        for colours in [3, 1] {
            let lens = lens(colours);
            let frame = lens.frame().expect("a frame");
            let settings = Settings { samples: 8, node_error: 1e-3, outside: 1e-6, ..Settings::FINE };
            let renderer = Renderer::measured(lens.optics().expect("a map"), &frame, settings).expect("plans");
            let model = lens.distortion();
            for (col, row) in [(50, 31), (70, 20), (20, 50)] {
                // A tent of light, one pixel wide either way, about the middle of a pixel of the distorted picture.
                let at = [col as f64 + 0.5 - 50.0, row as f64 + 0.5 - 31.0];
                let radius = at[0].hypot(at[1]);
                let slope = model.slope_from_sensor(radius);
                let outward = if radius > 0.0 { at.map(|v| v / radius) } else { [1.0, 0.0] };
                let fine = 12.0;
                let mut texture = ndarray::Array3::zeros((3, 1200, 1600));
                let centre = [0, 1].map(|k| slope * outward[k] * 150.0 * fine + [800.0, 600.0][k]);
                for r in 0..1200usize {
                    for c in 0..1600usize {
                        // Of equal size on the sensor: the distortion's own scale there, along the meridian and across it.
                        let d = [(c as f64 + 0.5 - centre[0]) / fine, (r as f64 + 0.5 - centre[1]) / fine];
                        let along = d[0] * outward[0] + d[1] * outward[1];
                        let across = d[1] * outward[0] - d[0] * outward[1];
                        let grow = model.sensor_from_slope_derivative(slope) / 150.0;
                        let scale = if slope > 0.0 { radius / (150.0 * slope) } else { grow };
                        let [u, v] = [along * grow, across * scale];
                        let [x, y] = [u * outward[0] - v * outward[1], u * outward[1] + v * outward[0]];
                        let light = (1.0 - x.abs()).max(0.0) * (1.0 - y.abs()).max(0.0);
                        (0..3).for_each(|k| texture[[k, r, c]] = light as f32);
                    }
                }
                let scene = crate::plane::Plane {
                    texture,
                    texels_per_slope: 150.0 * fine,
                    axis_texel: [800.0, 600.0],
                    vergence: 0.0,
                };
                let region = Region { row: row - 8, col: col - 8, rows: 17, cols: 17 };
                let (image, _) = renderer.picture::<f64>(&scene, 0, region, &Channels::all(), &|_| {});
                for c in 0..3 {
                    let kernel = lens.psf.kernel(radius, c.min(colours - 1), outward, 17);
                    let light = lens.shading().expect("valid").at(c, SensorPoint::along([1.0, 0.0], radius));
                    let found = image.index_axis(ndarray::Axis(0), c);
                    let square: f64 = found.iter().zip(&kernel).map(|(a, b)| (a - light * b).powi(2)).sum();
                    let whole: f64 = kernel.iter().map(|b| (light * b).powi(2)).sum();
                    let off = (square / whole).sqrt();
                    eprintln!("{colours} colours, {col} {row}, channel {c}: {off:.4}");
                    assert!(off < 0.03, "{colours} colours, {col} {row}, channel {c}: off by {off}");
                }
            }
        }
    }
}
