//! `Layer`: patches of many scenes through one lens whose numbers move, with the gradient by those numbers: what `isoplanat.torch` stands on.

use std::sync::Arc;

use isoplanat::imaging::render::{RenderPlan, Rendered, Settings};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::lens::variables::Variables;
use isoplanat::psf::{OpticsBar, SensorMap};
use isoplanat::{Error, Plane, Region, Renderer, Result, Sensor, SpectralDensity};
use ndarray::{Array3, Array4, ArrayView4, Axis, Ix4};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

use crate::arrays::{Floats, Number, Several, Whole, given, wrong_shape};
use crate::bending::Bending;
use crate::errors::{refused, vergence};
use crate::fineness;
use crate::frame::Frame;
use crate::lens::Lens;
use crate::render::{light, standing};
use crate::traced::Traced;
use crate::work::work;

/// A lens whose numbers move, and how patches of scenes are rendered through it.
#[pyclass(frozen, module = "isoplanat._isoplanat")]
pub(crate) struct Layer {
    inner: Arc<Planned>,
}

#[derive(Clone)]
pub(crate) struct Planned {
    /// The lens that the plan was made for; numbers that move are put into it.
    lens: isoplanat::Lens,
    pub(crate) variables: Variables,
    pub(crate) plan: RenderPlan,
    /// Where scenes lie, a distance each.
    pub(crate) maps: Vec<SensorMap>,
    pub(crate) density: SpectralDensity,
    pub(crate) frame: Frame,
    illuminant: Option<String>,
    /// How often it was planned anew.
    pub(crate) generation: u64,
    /// The lens as it was then.
    pub(crate) at: isoplanat::Lens,
    traced: Traced,
}

/// A patch before the lens, rendered.
struct Patch<T: Number> {
    scene: Plane,
    rendered: Rendered<T>,
}

enum Kept {
    Single(Vec<Patch<f32>>),
    Double(Vec<Patch<f64>>),
}

/// What the patches of a batch keep for their gradient.
#[pyclass(frozen, module = "isoplanat._isoplanat")]
pub(crate) struct LayerRecord {
    planned: Arc<Planned>,
    renderer: Arc<Renderer>,
    lens: isoplanat::Lens,
    kept: Kept,
    /// Light of the captures over what the truths and the lens's illumination give.
    light: f64,
}

/// Captures, truths and illumination of a batch, and what its gradient needs.
type RecordedBatch = (Py<PyAny>, Py<PyAny>, Py<PyAny>, LayerRecord);

/// What a batch is asked for.
struct Batch<'a> {
    /// Texels around a patch, on each side, that its blur sees.
    margin: usize,
    /// The distance of each.
    depths: &'a [usize],
    /// First row and column of each patch in the frame.
    places: &'a [[usize; 2]],
    /// Texels down and across from a scene's middle to what the patch's middle sees; [`SHIFT`] where left out.
    shifts: Option<&'a [[f64; 2]]>,
    /// Whether scenes stand where they were laid out; before the lens as it is otherwise.
    held: bool,
}

/// Texels down and across from a scene's middle to what a patch's middle sees, unless others are asked for: a pixel there sees where four texels meet.
///
/// Interpolation between texels softens, least where they lie on pixels. Were they laid there, whatever moves a scene would soften it, and a loss would gain by
/// moving. Here softness is largest, and does not change to first order.
const SHIFT: [f64; 2] = [0.5, 0.5];

impl Planned {
    /// The lens with these numbers.
    pub(crate) fn with(&self, values: &[f64]) -> Result<isoplanat::Lens> {
        if values.len() != self.variables.parameters.len() {
            let found = format!("{} of them", values.len());
            return Err(Error::bad("", "numbers", found, self.variables.parameters.len().to_string()));
        }
        self.variables.lens(&self.lens, values)
    }

    /// The same for `lens`, laid out anew as `renderer` is.
    pub(crate) fn laid_out(&self, lens: isoplanat::Lens, renderer: &Renderer) -> Self {
        let (plan, maps, generation) = (renderer.plan.clone(), renderer.optics.maps.clone(), self.generation + 1);
        Self { at: lens.clone(), lens, plan, maps, generation, ..self.clone() }
    }

    /// The same laid out for the lens with these numbers: how large its kernels are and where they stand, and where scenes lie before it.
    fn replanned(&self, values: Vec<f64>) -> Result<Self> {
        let lens = self.with(&values)?;
        let renderer = Renderer::replanned(&lens, &self.plan)?;
        let next = self.laid_out(lens.clone(), &renderer);
        Ok(Self { traced: Traced::of(values, lens, renderer), ..next })
    }

    /// The same plan around `lens`, which opened or closed surfaces of it.
    pub(crate) fn based(&self, lens: &isoplanat::Lens) -> Result<Self> {
        let base = self.lens.changed(|l| {
            for (to, from) in l.surfaces.iter_mut().zip(&lens.surfaces) {
                *to = from.clone();
            }
        })?;
        Ok(Self { lens: base, ..self.clone() })
    }

    /// Scene `b` of a batch before a lens that maps its distances so.
    fn scene<T: Number>(
        &self,
        maps: &[SensorMap],
        batch: &Batch<'_>,
        b: usize,
        texture: ndarray::ArrayView3<'_, T>,
    ) -> (Plane, Region) {
        let (_, rows, cols) = texture.dim();
        let [row, col] = batch.places[b];
        let (rows, cols) = (rows - 2 * batch.margin, cols - 2 * batch.margin);
        let region = Region { row: row.cast_signed(), col: col.cast_signed(), rows, cols };
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let middle = |first: usize, n: usize| first as f64 + 0.5 * n as f64;
        let texture = texture.mapv(|v| v.to_double() as f32);
        let depth = batch.depths[b];
        let [down, across] = batch.shifts.map_or(SHIFT, |all| all[b]);
        // A texel a pixel there: the scene's middle in the patch's, but for the shift.
        let place = Placement {
            texel: [middle(batch.margin, cols) + across, middle(batch.margin, rows) + down],
            pixel: [middle(col, cols), middle(row, rows)],
            scale: Scale::There(1.0),
        };
        (place.by(&maps[depth], &self.frame.inner, texture), region)
    }

    fn rendered<T: Number>(&self, renderer: &Renderer, batch: &Batch<'_>, scenes: ArrayView4<'_, T>) -> Vec<Patch<T>> {
        let all: Vec<usize> = (0..batch.depths.len()).collect();
        let maps = if batch.held { &self.maps } else { &renderer.optics.maps };
        let one = |b: &usize| {
            isoplanat::stop::look();
            let (scene, region) = self.scene(maps, batch, *b, scenes.index_axis(Axis(0), *b));
            let rendered = renderer.record::<T>(&scene, batch.depths[*b], region);
            Patch { scene, rendered }
        };
        all.par_iter().map(one).collect()
    }
}

/// Light of all captures over that of the truths as the lens's illumination dims them: far from 1 where kernels do not stand where the light goes.
fn light_of<T: Number>(patches: &[Patch<T>]) -> f64 {
    let sum = |of: &dyn Fn(&Rendered<T>) -> f64| patches.iter().map(|p| of(&p.rendered)).sum::<f64>();
    let captured = sum(&|r| r.image.iter().map(|v| v.to_double()).sum());
    let expected = sum(&|r| r.truth.iter().zip(&r.illumination).map(|(t, a)| t.to_double() * a.to_double()).sum());
    if expected.abs() > 0.0 { captured / expected } else { 1.0 }
}

/// Pictures, ideals and illumination of patches `[patch, channel, row, col]`.
fn stacked<T: Number>(patches: &mut [Patch<T>]) -> [Array4<T>; 3] {
    let (_, rows, cols) = patches.first().map_or((3, 0, 0), |p| p.rendered.image.dim());
    let mut all = [(); 3].map(|()| Array4::from_elem((patches.len(), 3, rows, cols), T::zero()));
    for (b, patch) in patches.iter_mut().enumerate() {
        let Rendered { image, truth, illumination, .. } = &mut patch.rendered;
        let parts = [std::mem::take(image), std::mem::take(truth), illumination.clone()];
        for (to, from) in all.iter_mut().zip(parts) {
            to.index_axis_mut(Axis(0), b).assign(&from);
        }
    }
    all
}

/// The numbers of `lens` that names and patterns mean, and their values.
fn chosen(lens: &isoplanat::Lens, patterns: &[String]) -> Result<Variables> {
    let mut parameters = Vec::new();
    for pattern in patterns {
        let more = isoplanat::optimize::parameters(lens, pattern, "trainable")?;
        parameters.extend(more.into_iter().filter(|p| !parameters.contains(p)).collect::<Vec<_>>());
    }
    if parameters.is_empty() {
        return Err(Error::bad("", "trainable", "none", "names or patterns of the lens's numbers"));
    }
    // Numbers are as the lens has them.
    Ok(Variables { scales: vec![1.0; parameters.len()], parameters })
}

/// Names and values of a lens's numbers, those of names or patterns such as "surface[*].curvature".
#[pyfunction]
pub(crate) fn numbers_of(lens: &Bound<'_, Lens>, trainable: Several<String>) -> PyResult<(Vec<String>, Vec<f64>)> {
    let lens = &lens.get().inner;
    let variables = crate::work::here(|| chosen(lens, &trainable.0))?;
    Ok((variables.parameters.iter().map(|p| p.name(lens)).collect(), variables.values(lens)))
}

#[pymethods]
impl Layer {
    #[new]
    #[pyo3(signature = (lens, frame, distances_mm, trainable, illuminant, settings = None, diffraction = None))]
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    fn new(
        py: Python<'_>,
        lens: &Bound<'_, Lens>,
        frame: Option<&Bound<'_, Frame>>,
        distances_mm: Option<Several<f64>>,
        trainable: Several<String>,
        illuminant: Option<String>,
        settings: Option<String>,
        diffraction: Option<Bending>,
    ) -> PyResult<Self> {
        let model = Bending::of_layers(diffraction.as_ref())?;
        let lens = lens.get().inner.clone();
        let frame = frame.map(|f| f.get().clone());
        let distances = distances_mm.map_or_else(|| vec![lens.object_vergence.recip()], |d| d.0);
        if distances.is_empty() {
            return Err(refused("distances_mm", "none", "one or more"));
        }
        let vergences = distances.iter().map(|d| vergence("distances_mm", *d)).collect::<PyResult<Vec<f64>>>()?;
        let light = light(illuminant.as_deref())?;
        let inner = work(py, || {
            let frame = frame.map_or_else(|| Frame::of(&lens), Ok)?;
            // Every distance has to have a real image.
            vergences.iter().try_for_each(|v| standing(&lens, &frame, *v).map(drop))?;
            let lens = standing(&lens, &frame, vergences[0])?;
            let variables = chosen(&lens, &trainable.0)?;
            let density = SpectralDensity::under(&Sensor::generic(), light)?;
            let coarse = Settings { diffraction: model, ..Settings::DESIGN };
            let settings = settings.map_or(Ok(coarse), |text| fineness::read(&text))?;
            let renderer = Renderer::planned(&lens, &frame.inner, &density, &vergences, settings)?;
            Ok(Planned {
                at: lens.clone(),
                lens,
                variables,
                plan: renderer.plan,
                maps: renderer.optics.maps,
                density,
                frame,
                illuminant,
                generation: 0,
                traced: Traced::default(),
            })
        })?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// The numbers that move, by name.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.inner.variables.parameters.iter().map(|p| p.name(&self.inner.lens)).collect()
    }

    /// The numbers, in the order of their names.
    #[getter]
    fn values(&self) -> Vec<f64> {
        self.inner.variables.values(&self.inner.lens)
    }

    /// Object distances, mm.
    #[getter]
    fn distances_mm(&self) -> Vec<f64> {
        self.inner.plan.depths.iter().map(|d| d.vergence.recip()).collect()
    }

    /// How far a pixel's light comes from at most, in pixels.
    #[getter]
    fn reach_px(&self) -> usize {
        self.inner.plan.depths.iter().map(|d| d.reach_px()).max().unwrap_or(0)
    }

    #[getter]
    fn frame(&self) -> Frame {
        self.inner.frame.clone()
    }

    /// The lens that numbers are put into.
    #[getter]
    fn base(&self) -> Lens {
        self.inner.lens.clone().into()
    }

    /// The same around a lens whose surfaces were opened.
    #[pyo3(name = "based")]
    fn based_on(&self, lens: &Bound<'_, Lens>) -> PyResult<Self> {
        Ok(crate::work::here(|| self.inner.based(&lens.get().inner))?.into())
    }

    /// The lens with these numbers.
    fn lens(&self, py: Python<'_>, values: PyReadonlyArray1<'_, f64>) -> PyResult<Lens> {
        let values = values.as_array().to_vec();
        Ok(work(py, || self.inner.with(&values))?.into())
    }

    /// The same for the lens with these numbers: how large its kernels are and where they stand, and where scenes lie before it.
    fn replanned(&self, py: Python<'_>, values: PyReadonlyArray1<'_, f64>) -> PyResult<Self> {
        let values = values.as_array().to_vec();
        Ok(work(py, || self.inner.replanned(values))?.into())
    }

    /// How finely it renders, as JSON.
    #[getter]
    fn settings(&self) -> PyResult<String> {
        crate::work::here(|| fineness::text(&self.inner.plan.settings))
    }

    /// The same for the lens with these numbers by other settings.
    fn set_to(&self, py: Python<'_>, values: PyReadonlyArray1<'_, f64>, settings: &str) -> PyResult<Self> {
        let values = values.as_array().to_vec();
        let planned = work(py, || {
            let (own, settings) = (&*self.inner, fineness::read(settings)?);
            fineness::by(own, own.with(&values)?, settings)
        })?;
        Ok(planned.into())
    }

    /// The same for the lens with these numbers by the coarsest settings whose gradient is near enough on patches; its error relative to the gradient, the patches' own
    /// scatter, and whether the error is as small as wished.
    #[pyo3(signature = (values, scenes, distances, places, margin, shifts = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's words")]
    fn tuned(
        &self,
        py: Python<'_>,
        values: PyReadonlyArray1<'_, f64>,
        scenes: &Bound<'_, PyAny>,
        distances: Vec<usize>,
        places: Vec<[usize; 2]>,
        margin: usize,
        shifts: Option<Vec<[f64; 2]>>,
    ) -> PyResult<(Self, f64, f64, bool)> {
        let values = values.as_array().to_vec();
        let floats = Floats::of(scenes, "scenes", Whole::Refused)?;
        let batch = Batch { margin, depths: &distances, places: &places, shifts: shifts.as_deref(), held: true };
        self.check(floats.shape(), &batch)?;
        let cast = floats.cast::<f32>();
        let own = &*self.inner;
        let (planned, chosen) = work(py, || {
            let scenes = cast.view().into_dimensionality::<Ix4>().map_err(|e| Error::Internal(e.to_string()))?;
            let lens = own.with(&values)?;
            let maps = Renderer::new(&lens, &own.plan)?.optics.maps;
            let placed: Vec<(Plane, Region)> =
                scenes.outer_iter().enumerate().map(|(b, scene)| own.scene(&maps, &batch, b, scene)).collect();
            fineness::tuned(own, lens, &placed)
        })?;
        Ok((planned.into(), chosen.error, chosen.noise, chosen.holds))
    }

    /// It does not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    /// Planned anew for its lens.
    #[expect(clippy::type_complexity, reason = "what pickle asks for")]
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Lens, Frame, Vec<f64>, Vec<String>, Option<String>, String))> {
        let own = slf.get();
        let Planned { lens, frame, illuminant, .. } = &*own.inner;
        let (distances, names, settings) = (own.distances_mm(), own.names(), own.settings()?);
        let arguments = (lens.clone().into(), frame.clone(), distances, names, illuminant.clone(), settings);
        Ok((slf.get_type().into_any(), arguments))
    }

    /// Captures and truths of a batch, the lens's illumination of its patches, 1 on the axis, and its record.
    ///
    /// Parameters
    /// ----------
    /// values : array [n]
    /// scenes : array [patch, 3, row, col]
    /// distances : sequence of int
    ///     Which of `distances_mm`, a patch each.
    /// places : sequence of (row, column)
    ///     First pixel of each patch in the frame.
    /// margin : int
    ///     Texels on each side that are seen by the blur alone.
    /// shifts : sequence of (down, across), optional
    ///     Texels from each scene's middle to what its patch's middle sees; half a texel where left out.
    /// held : bool
    ///     Whether scenes stand where they were laid out; before the lens as it is otherwise.
    #[pyo3(signature = (values, scenes, distances, places, margin, shifts = None, held = true))]
    #[expect(clippy::too_many_arguments, reason = "Python's words")]
    fn record(
        &self,
        py: Python<'_>,
        values: PyReadonlyArray1<'_, f64>,
        scenes: &Bound<'_, PyAny>,
        distances: Vec<usize>,
        places: Vec<[usize; 2]>,
        margin: usize,
        shifts: Option<Vec<[f64; 2]>>,
        held: bool,
    ) -> PyResult<RecordedBatch> {
        let values = values.as_array().to_vec();
        let floats = Floats::of(scenes, "scenes", Whole::Refused)?;
        let batch = Batch { margin, depths: &distances, places: &places, shifts: shifts.as_deref(), held };
        self.check(floats.shape(), &batch)?;
        let double = matches!(floats, Floats::Double(_));
        if double {
            self.recorded::<f64>(py, &values, &floats, &batch, Kept::Double)
        } else {
            self.recorded::<f32>(py, &values, &floats, &batch, Kept::Single)
        }
    }
}

impl From<Planned> for Layer {
    fn from(planned: Planned) -> Self {
        Self { inner: Arc::new(planned) }
    }
}

impl Layer {
    /// Whether scenes of this shape are patches of the frame as `batch` says.
    fn check(&self, shape: &[usize], batch: &Batch<'_>) -> PyResult<()> {
        let (&[count, 3, rows, columns], true) = (shape, shape.first() > Some(&0)) else {
            return Err(wrong_shape("scenes", shape, "[patch, 3, row, column], with one or more"));
        };
        let Batch { margin, depths: distances, places, shifts, held: _ } = *batch;
        let sides = [rows, columns].map(|n| n.checked_sub(2 * margin).filter(|n| *n > 0));
        let [Some(rows), Some(columns)] = sides else {
            return Err(refused("margin", margin, format!("less than half of {rows} rows and {columns} columns")));
        };
        let shifted = shifts.map_or(count, <[_]>::len);
        for (name, n) in [("distance_mm", distances.len()), ("place", places.len()), ("shift", shifted)] {
            if n != count {
                return Err(refused(name, format!("{n} of them"), format!("one of each of {count} scenes")));
            }
        }
        let frame = &self.inner.frame.inner;
        let inside = |[row, column]: &[usize; 2]| {
            row.checked_add(rows).is_some_and(|end| end <= frame.rows)
                && column.checked_add(columns).is_some_and(|end| end <= frame.columns)
        };
        if let Some([row, column]) = places.iter().find(|p| !inside(p)) {
            let allowed =
                format!("a patch of {rows} × {columns} within {} rows and {} columns", frame.rows, frame.columns);
            return Err(refused("place", format!("({row}, {column})"), allowed));
        }
        if let Some(k) = distances.iter().find(|k| **k >= self.inner.plan.depths.len()) {
            return Err(refused("distances", k, format!("0 to {}", self.inner.plan.depths.len() - 1)));
        }
        if let Some([down, across]) = shifts.iter().copied().flatten().find(|s| !s.iter().all(|n| n.is_finite())) {
            return Err(refused("shift", format!("({down}, {across})"), "finite texels"));
        }
        Ok(())
    }

    pub(crate) fn planned(&self) -> Arc<Planned> {
        self.inner.clone()
    }

    fn recorded<T: Number>(
        &self,
        py: Python<'_>,
        values: &[f64],
        floats: &Floats<'_>,
        batch: &Batch<'_>,
        keep: fn(Vec<Patch<T>>) -> Kept,
    ) -> PyResult<RecordedBatch> {
        let cast = floats.cast::<T>();
        let scenes = cast.view();
        let planned = self.inner.clone();
        let (all, light, renderer, lens, mut patches) = work(py, || {
            let scenes = scenes.into_dimensionality::<Ix4>().map_err(|e| Error::Internal(e.to_string()))?;
            if let Some((place, v)) = scenes.indexed_iter().find(|(_, v)| !fits(v.to_double())) {
                let place = format!("scenes, {place:?}");
                return Err(Error::bad("", place, v.to_double().to_string(), "finite light"));
            }
            let (lens, renderer) = planned.traced.at(values, || {
                let lens = planned.with(values)?;
                let renderer = Renderer::new(&lens, &planned.plan)?;
                Ok((lens, renderer))
            })?;
            let mut patches = planned.rendered(&renderer, batch, scenes);
            let light = light_of(&patches);
            Ok((stacked(&mut patches), light, renderer, lens, patches))
        })?;
        patches.shrink_to_fit();
        let [captures, truths, illumination] = all;
        let record = LayerRecord { planned: self.inner.clone(), renderer, lens, kept: keep(patches), light };
        Ok((given(py, captures), given(py, truths), given(py, illumination), record))
    }
}

#[pymethods]
impl LayerRecord {
    /// Light of the captures over what the truths and the lens's illumination give; far from 1 where the lens has left its plan.
    #[getter]
    fn light(&self) -> f64 {
        self.light
    }

    /// The gradient of a loss by the numbers, from those by captures, truths and illumination `[patch, channel, row, col]`; patches add up in their order.
    #[pyo3(signature = (captures_bar, truths_bar, illumination_bar = None))]
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        captures_bar: &Bound<'_, PyAny>,
        truths_bar: &Bound<'_, PyAny>,
        illumination_bar: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mut bars = vec![
            Floats::of(captures_bar, "captures_bar", Whole::Taken)?,
            Floats::of(truths_bar, "truths_bar", Whole::Taken)?,
        ];
        if let Some(bar) = illumination_bar {
            bars.push(Floats::of(bar, "illumination_bar", Whole::Taken)?);
        }
        let gradient = match &self.kept {
            Kept::Single(patches) => self.pulled(py, patches, &bars)?,
            Kept::Double(patches) => self.pulled(py, patches, &bars)?,
        };
        Ok(PyArray1::from_vec(py, gradient))
    }
}

impl LayerRecord {
    fn pulled<T: Number>(&self, py: Python<'_>, patches: &[Patch<T>], bars: &[Floats<'_>]) -> PyResult<Vec<f64>> {
        let (_, rows, columns) = patches.first().map_or((3, 0, 0), |p| p.rendered.illumination.dim());
        let shape = [patches.len(), 3, rows, columns];
        for (bar, name) in bars.iter().zip(["captures_bar", "truths_bar", "illumination_bar"]) {
            if bar.shape() != shape {
                return Err(wrong_shape(name, bar.shape(), &format!("that of the captures, {shape:?}")));
            }
        }
        let cast: Vec<_> = bars.iter().map(Floats::cast::<T>).collect();
        let views: Vec<_> = cast.iter().map(|c| c.view()).collect();
        let renderer = &self.renderer;
        work(py, || {
            let fourfold = views.into_iter().map(|v| v.into_dimensionality::<Ix4>()).collect::<Result<Vec<_>, _>>();
            let bars = fourfold.map_err(|e| Error::Internal(e.to_string()))?;
            let all: Vec<usize> = (0..patches.len()).collect();
            let one = |b: &usize| {
                isoplanat::stop::look();
                let Patch { scene, rendered } = &patches[*b];
                let [capture, truth] = [0, 1].map(|k| bars[k].index_axis(Axis(0), *b));
                let nothing = Array3::from_elem(truth.dim(), T::zero());
                let illumination = bars.get(2).map_or_else(|| nothing.view(), |all| all.index_axis(Axis(0), *b));
                renderer.vjp(scene, rendered, capture, truth, illumination)
            };
            let bars: Vec<OpticsBar> = all.par_iter().map(one).collect();
            let mut total = OpticsBar::zeros(&renderer.optics);
            bars.iter().for_each(|bar| total.add(bar));
            let gradient = renderer.lens_gradient(&self.lens, &total);
            Ok(self.planned.variables.gradient(&gradient))
        })
    }
}

/// Whether light is a number, in single precision, too: textures have that.
fn fits(light: f64) -> bool {
    light.abs() <= f64::from(f32::MAX)
}
