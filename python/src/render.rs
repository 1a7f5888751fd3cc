//! `render`, `render.plan`, `render.record`: a photograph through a lens.

use std::sync::Arc;

use isoplanat::imaging::render::{Channels, Seen, memory, shortfall};
use isoplanat::imaging::scene::detail::{LOOKED, deciding, detail, spread};
use isoplanat::imaging::scene::placement::{Placement, Scale, texels_that_fill};
use isoplanat::imaging::sensor::illuminant::Illuminant;
use isoplanat::lens::paraxial::require_real_image;
use isoplanat::lens::{Prescription, SensorRaster};
use isoplanat::math::memory::Limit;
use isoplanat::{Error, PlanOptions, Plane, Region, Renderer, Request, Result, Sensor, SpectralDensity, plan};
use ndarray::Array3;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;

use crate::arrays::{Floats, Number, Whole, given};
use crate::bending::Bending;
use crate::errors::{raised, refused, vergence};
use crate::frame::Frame;
use crate::lens::Lens;
use crate::pictures::owned;
use crate::record::Record;
use crate::work::{here, work};

/// PSNR that is held where none is asked for, as by the command.
const DEFAULT_DB: f64 = 50.0;
/// What takes less memory.
const SMALLER: &str = "a smaller frame, larger pixels or a smaller photograph";

/// How a lens renders photographs of one size on one frame: settings that hold the PSNR that was asked for, where the photograph stands before the lens,
/// and the lens traced. For many photographs, and for one lens that moves: what a plan holds stays.
///
/// Attributes
/// ----------
/// predicted_psnr_db : float or None
///     Against the finest settings, in linear light for a range of 1.
/// holds : bool
///     Whether what was asked for is predicted to hold.
/// frame : Frame
/// settings : dict
///     How finely each approximation is made.
/// kernel_size, kernels : int
///     Side of the kernels (in cells) and how many places they stand at.
#[pyclass(frozen, module = "isoplanat")]
#[derive(Clone)]
pub(crate) struct Plan {
    pub(crate) lens: Arc<isoplanat::Lens>,
    pub(crate) renderer: Arc<Renderer>,
    frame: Frame,
    placed: Placed,
    predicted_db: Option<f64>,
    holds: bool,
}

/// Where photographs of one size stand before a lens.
#[derive(Clone, Copy, Debug)]
struct Placed {
    /// Rows and columns.
    texels: [usize; 2],
    texels_per_slope: f64,
    axis_texel: [f64; 2],
    vergence: f64,
}

impl Placed {
    fn of(scene: &Plane) -> Self {
        let (_, rows, columns) = scene.texture.dim();
        let Plane { texels_per_slope, axis_texel, vergence, .. } = *scene;
        Self { texels: [rows, columns], texels_per_slope, axis_texel, vergence }
    }

    fn plane(self, texture: Array3<f32>) -> Result<Plane> {
        let (_, rows, columns) = texture.dim();
        if [rows, columns] != self.texels {
            let allowed = format!("{} × {} pixels, which its plan was made for", self.texels[1], self.texels[0]);
            return Err(Error::bad("", "photo", format!("{columns} × {rows} pixels"), allowed));
        }
        let Self { texels_per_slope, axis_texel, vergence, .. } = self;
        Ok(Plane { texture, texels_per_slope, axis_texel, vergence })
    }
}

#[pymethods]
impl Plan {
    /// Predicted PSNR against the finest settings, dB.
    #[getter]
    fn predicted_psnr_db(&self) -> Option<f64> {
        self.predicted_db
    }

    /// Whether what was asked for is predicted to hold.
    #[getter]
    fn holds(&self) -> bool {
        self.holds
    }

    /// The frame.
    #[getter]
    fn frame(&self) -> Frame {
        self.frame.clone()
    }

    /// Object distance, mm.
    #[getter]
    fn distance_mm(&self) -> f64 {
        1.0 / self.placed.vergence
    }

    /// How finely each approximation is made.
    #[getter]
    fn settings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let told =
            here(|| serde_json::to_value(self.renderer.plan.settings).map_err(|e| Error::Internal(e.to_string())))?;
        crate::analyses::python(py, &told)
    }

    /// Side of the kernels, in cells.
    #[getter]
    fn kernel_size(&self) -> usize {
        self.renderer.plan.depths[0].size()
    }

    /// How many places kernels stand at.
    #[getter]
    fn kernels(&self) -> usize {
        self.renderer.plan.depths[0].grid.len()
    }

    fn __repr__(&self) -> String {
        let db = self.predicted_db.map_or_else(|| "not predicted".to_owned(), |db| format!("{db:.2} dB predicted"));
        let (frame, texels) = (&self.frame.inner, self.placed.texels);
        format!(
            "<Plan: photographs of {} × {} pixels on a frame of {} × {}, {db}>",
            texels[1], texels[0], frame.columns, frame.rows
        )
    }
}

/// What a call asks for.
pub(crate) struct Asked<'a, 'py> {
    pub(crate) lens: &'a Bound<'py, Lens>,
    pub(crate) frame: Option<&'a Bound<'py, Frame>>,
    pub(crate) distance_mm: Option<f64>,
    pub(crate) min_psnr_db: Option<f64>,
    pub(crate) texels_per_pixel: Option<f64>,
    pub(crate) diffraction: Option<Bending>,
    pub(crate) illuminant: Option<&'a str>,
    pub(crate) plan: Option<&'a Bound<'py, Plan>>,
}

/// The light of a name.
pub(crate) fn light(name: Option<&str>) -> PyResult<Illuminant> {
    let Some(name) = name else { return Ok(Illuminant::default()) };
    name.parse::<Illuminant>().map_err(|e| raised(e.at("illuminant")))
}

/// `lens` with an object and a frame in place of its own.
pub(crate) fn standing(lens: &isoplanat::Lens, frame: &Frame, vergence: f64) -> Result<isoplanat::Lens> {
    let isoplanat::Frame { columns, rows, axis_px, .. } = frame.inner;
    let sensor = SensorRaster { columns, rows, pitch_um: frame.pitch(), axis_px };
    let standing = Prescription { sensor, object_vergence: vergence, ..(**lens).clone() };
    let standing = isoplanat::Lens::new(standing, lens.file())?;
    require_real_image(&standing)?;
    Ok(standing)
}

/// Photographs whose mean is beyond this are taken for numbers of another range.
const BRIGHT: f32 = 4.0;

/// Warns of a photograph that hardly is linear light in which 1 is white.
fn warn_of_range(py: Python<'_>, texture: &Array3<f32>) -> PyResult<()> {
    let mean = texture.mean().unwrap_or(0.0);
    if mean > BRIGHT {
        warn(
            py,
            &format!("photo: its mean is {mean:.3}; 1 is white (numbers up to 255 are divided by 255 and decoded)"),
        )?;
    }
    Ok(())
}

/// A `UserWarning`.
fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = std::ffi::CString::new(text).unwrap_or_default();
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}

/// Where a picture stands before a lens: it fills the frame, or shows so many of its pixels to one of the frame's on the axis.
pub(crate) fn place(
    lens: &isoplanat::Lens,
    frame: &Frame,
    texels_per_pixel: Option<f64>,
    texture: Array3<f32>,
) -> Result<Plane> {
    let (_, rows, columns) = texture.dim();
    let fill = Placement::filling([rows, columns], &frame.inner);
    let placement = texels_per_pixel.map_or(fill, |texels| Placement { scale: Scale::OnAxis(texels), ..fill });
    placement.before(lens, &frame.inner, texture)
}

impl Asked<'_, '_> {
    fn own(&self) -> (Arc<isoplanat::Lens>, Option<Frame>) {
        (self.lens.get().inner.clone(), self.frame.map(|f| f.get().clone()))
    }

    /// The plan that was given, with this lens; or one made for `textures`.
    fn plan(&self, py: Python<'_>, textures: Vec<Array3<f32>>) -> PyResult<(Plan, Vec<Plane>)> {
        textures.iter().try_for_each(|texture| warn_of_range(py, texture))?;
        let (lens, frame) = self.own();
        if let Some(plan) = self.plan {
            let plan = plan.get().clone();
            let decided = [self.distance_mm.is_some(), self.min_psnr_db.is_some(), self.texels_per_pixel.is_some()];
            if decided.contains(&true) || self.illuminant.is_some() || self.diffraction.is_some() {
                return Err(refused("plan", "given beside what it decides", "lens, photo and frame alone"));
            }
            if let Some(frame) = frame.filter(|f| *f != plan.frame) {
                let allowed = "the frame that the plan was made for, or none";
                return Err(refused("frame", format!("{:?}", frame.inner), allowed));
            }
            return work(py, || {
                let planes = textures.into_iter().map(|t| plan.placed.plane(t)).collect::<Result<Vec<_>>>()?;
                let lens = standing(&lens, &plan.frame, plan.placed.vergence)?;
                let plan = if lens == *plan.lens {
                    plan
                } else {
                    let renderer = Arc::new(Renderer::new(&lens, &plan.renderer.plan)?);
                    Plan { lens: Arc::new(lens), renderer, predicted_db: None, ..plan }
                };
                Ok((plan, planes))
            });
        }
        let db = self.min_psnr_db.unwrap_or(DEFAULT_DB);
        if !(10.0..=80.0).contains(&db) {
            return Err(refused("min_psnr_db", db, "10 to 80 dB"));
        }
        if let Some(texels) = self.texels_per_pixel.filter(|t| !(*t > 0.0 && *t <= 1000.0)) {
            return Err(refused("texels_per_pixel", texels, "a positive number, at most 1000"));
        }
        let options =
            PlanOptions { diffraction: Bending::of_pictures(self.diffraction.as_ref())?, ..PlanOptions::default() };
        let light = light(self.illuminant)?;
        let distance = self.distance_mm.map_or(Ok(lens.object_vergence), |d| vergence("distance_mm", d))?;
        let texels_per_pixel = self.texels_per_pixel;
        let made = work(py, || {
            let frame = frame.map_or_else(|| Frame::of(&lens), Ok)?;
            let what = format!("a picture of {} × {} pixels", frame.inner.columns, frame.inner.rows);
            let limit = Limit::of_process();
            limit.allow(&what, memory::planes(&frame.inner), SMALLER)?;
            let lens = standing(&lens, &frame, distance)?;
            let density = SpectralDensity::under(&Sensor::generic(), light)?;
            density.require(&lens)?;
            let place = |t: Array3<f32>| place(&lens, &frame, texels_per_pixel, t);
            let planes = textures.into_iter().map(place).collect::<Result<Vec<_>>>()?;
            let made = plan(&lens, &planes, &frame.inner, &density, Request::Psnr(db), options)?;
            let placed = Placed::of(&planes[0]);
            limit.allow(&what, made.bytes(placed.texels), SMALLER)?;
            let plan = Plan {
                lens: Arc::new(lens),
                renderer: Arc::new(made.renderer),
                frame,
                placed,
                predicted_db: made.predicted_db,
                holds: made.holds,
            };
            Ok((plan, planes))
        })?;
        if !made.0.holds {
            warn(py, &shortfall(made.0.predicted_db, db, "min_psnr_db"))?;
        }
        let plan = &made.0.renderer.plan;
        if let Some(text) = plan.table_error.untold(plan.frame.pitch_mm) {
            warn(py, &text)?;
        }
        Ok(made)
    }
}

/// The picture of a scene and its ideal.
fn both<T: Number>(plan: &Plan, scene: &Plane) -> Result<[Array3<T>; 2]> {
    let renderer = &plan.renderer;
    let (whole, channels) = (Region::whole(&renderer.plan.frame), Channels::from_scene(scene));
    finite(scene)?;
    let (picture, _): (_, Seen) = renderer.picture::<T>(scene, 0, whole, &channels, &|_| isoplanat::stop::look());
    Ok([picture, renderer.truth::<T>(scene, 0, whole, &channels)])
}

/// Refuses light that is no number.
fn finite(scene: &Plane) -> Result<()> {
    match scene.texture.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(()),
        Some(((c, i, j), v)) => {
            let place = format!("photo, channel {c}, row {i}, column {j}");
            Err(Error::bad("", place, v.to_string(), "finite light"))
        }
    }
}

/// A photograph through a lens.
///
/// `picture, truth = isoplanat.render(lens, photo, frame=None, *, distance_mm=None, min_psnr_db=50, texels_per_pixel=None, diffraction="auto", illuminant="E", plan=None)`;
/// `render.plan` makes the settings once for many photographs, `render.record` keeps what a gradient needs.
///
/// The picture that `lens` makes of `photo` on `frame`, and the ideal one: the same with the lens's distortion, without blur and falling light.
///
/// Parameters
/// ----------
/// lens : Lens
/// photo : array [3, row, col], or [row, col] for grey
///     Linear light, 1 is white, upright; float32 or float64, which the pictures follow. It stands as a flat scene before the lens and just fills the frame.
/// frame : Frame, optional
///     The lens's own where left out.
/// distance_mm : float, optional
///     Object distance before the first vertex; inf is allowed. The lens's own where left out.
/// min_psnr_db : float
///     The cheapest settings are taken that hold this PSNR (linear light, range 1); 50 where left out.
/// texels_per_pixel : float, optional
///     Pixels of the photograph that one of the frame sees on the axis, in place of filling the frame.
/// diffraction : str
///     "on": kernels by diffraction (scalar waves); "off": of rays; "approximate": of rays, convolved with the open pupil's diffraction; "auto": the first of off,
///     approximate and on that differs little.
/// illuminant : str
///     Light on the scene: "E", "A", "D50", "D55", "D65", "D75", "daylight:KELVIN", "black-body:KELVIN".
/// plan : Plan, optional
///     Of `render.plan` or of a record; then nothing else that it decides may be given.
///
/// Returns
/// -------
/// picture, truth : arrays [3, row, col]
///     Linear light, upright; 1 is white on the axis.
///
/// Warns where the asked PSNR is predicted not to hold.
#[pyclass(frozen, module = "isoplanat", name = "Render")]
pub(crate) struct Render;

#[pymethods]
impl Render {
    /// As the class says.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (lens, photo, frame = None, *, distance_mm = None, min_psnr_db = None, texels_per_pixel = None,
        diffraction = None, illuminant = None, plan = None))]
    fn __call__(
        &self,
        py: Python<'_>,
        lens: &Bound<'_, Lens>,
        photo: &Bound<'_, PyAny>,
        frame: Option<&Bound<'_, Frame>>,
        distance_mm: Option<f64>,
        min_psnr_db: Option<f64>,
        texels_per_pixel: Option<f64>,
        diffraction: Option<Bending>,
        illuminant: Option<&str>,
        plan: Option<&Bound<'_, Plan>>,
    ) -> PyResult<(Py<PyAny>, Py<PyAny>)> {
        let floats = Floats::of(photo, "photo", Whole::Refused)?;
        let asked = Asked { lens, frame, distance_mm, min_psnr_db, texels_per_pixel, diffraction, illuminant, plan };
        let (plan, scenes) = asked.plan(py, vec![owned(&floats, "photo")?])?;
        let [scene] = &scenes[..] else { return Err(refused("photo", scenes.len(), "one")) };
        if matches!(floats, Floats::Double(_)) {
            let [picture, truth] = work(py, || both::<f64>(&plan, scene))?;
            Ok((given(py, picture), given(py, truth)))
        } else {
            let [picture, truth] = work(py, || both::<f32>(&plan, scene))?;
            Ok((given(py, picture), given(py, truth)))
        }
    }

    /// The settings for photographs like `photos`, all of one size: one array, or a list of them, of which the eighth with the most detail decides.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (lens, photos, frame = None, *, distance_mm = None, min_psnr_db = None, texels_per_pixel = None,
        diffraction = None, illuminant = None))]
    fn plan(
        &self,
        py: Python<'_>,
        lens: &Bound<'_, Lens>,
        photos: &Bound<'_, PyAny>,
        frame: Option<&Bound<'_, Frame>>,
        distance_mm: Option<f64>,
        min_psnr_db: Option<f64>,
        texels_per_pixel: Option<f64>,
        diffraction: Option<Bending>,
        illuminant: Option<&str>,
    ) -> PyResult<Plan> {
        let listed = photos.cast::<pyo3::types::PyList>().ok();
        let mut textures = match listed {
            Some(list) => {
                // Others are not copied.
                let looked = spread(list.len(), LOOKED).into_iter().map(|k| list.get_item(k));
                looked.map(|photo| crate::pictures::texture(&photo?, "photos")).collect::<PyResult<Vec<_>>>()?
            }
            None => vec![crate::pictures::texture(photos, "photos")?],
        };
        let Some(first) = textures.first() else { return Err(refused("photos", "none", "one or more")) };
        let size = |t: &Array3<f32>| [t.dim().1, t.dim().2];
        if let Some(other) = textures.iter().find(|t| size(t) != size(first)) {
            let [found, one] = [other, first].map(|t| format!("{} × {}", t.dim().2, t.dim().1));
            return Err(refused("photos", format!("{found} pixels beside {one}"), "one size for all of a plan"));
        }
        if textures.len() > 1 {
            let own = lens.get().inner.clone();
            let shown = frame.map(|f| f.get().clone());
            let size = size(first);
            let kept = work(py, || {
                let shown = shown.map_or_else(|| Frame::of(&own), Ok)?;
                let texels = texels_per_pixel.unwrap_or_else(|| texels_that_fill(size, &shown.inner));
                deciding(textures.len(), |k| Ok(detail(&textures[k], texels)))
            })?;
            let mut k = 0;
            textures.retain(|_| (kept.contains(&k), k += 1).0);
        }
        let asked =
            Asked { lens, frame, distance_mm, min_psnr_db, texels_per_pixel, diffraction, illuminant, plan: None };
        Ok(asked.plan(py, textures)?.0)
    }

    /// Renders as `render` does, and keeps what the gradient of one's own loss needs.
    ///
    /// `value, record = isoplanat.render.record(lens, photo, frame)`; then `record.vjp(bar)` with `bar` = ∂loss/∂value gives ∂loss/∂number for every
    /// number of the lens. With `plan=record.plan` another lens is rendered with the same settings and the photograph where it is: what the gradient holds.
    ///
    /// `region` = (row, col, rows, columns) renders a part of the frame. Other parameters as of `render`.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (lens, photo, frame = None, *, distance_mm = None, min_psnr_db = None, texels_per_pixel = None,
        diffraction = None, illuminant = None, plan = None, region = None))]
    fn record(
        &self,
        py: Python<'_>,
        lens: &Bound<'_, Lens>,
        photo: &Bound<'_, PyAny>,
        frame: Option<&Bound<'_, Frame>>,
        distance_mm: Option<f64>,
        min_psnr_db: Option<f64>,
        texels_per_pixel: Option<f64>,
        diffraction: Option<Bending>,
        illuminant: Option<&str>,
        plan: Option<&Bound<'_, Plan>>,
        region: Option<[usize; 4]>,
    ) -> PyResult<(Py<PyAny>, Record)> {
        let floats = Floats::of(photo, "photo", Whole::Refused)?;
        let asked = Asked { lens, frame, distance_mm, min_psnr_db, texels_per_pixel, diffraction, illuminant, plan };
        let (plan, mut scenes) = asked.plan(py, vec![owned(&floats, "photo")?])?;
        let Some(scene) = scenes.pop() else { return Err(refused("photo", "none", "one")) };
        here(|| finite(&scene))?;
        let double = matches!(floats, Floats::Double(_));
        Record::of(py, plan, scene, region, double)
    }

    /// What `inspect.signature` and notebooks show of it.
    #[getter(__signature__)]
    fn signature<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let made = c"__import__('inspect').signature(lambda lens, photo, frame=None, *, distance_mm=None, min_psnr_db=None, texels_per_pixel=None, \
            diffraction=None, illuminant=None, plan=None: None)";
        py.eval(made, None, None)
    }

    fn __repr__(&self) -> &'static str {
        "<isoplanat.render>"
    }

    /// There is one of it.
    fn __reduce__(&self) -> &'static str {
        "render"
    }
}
