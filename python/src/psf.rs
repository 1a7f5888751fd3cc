//! `Lens.psf` and what it gives.

use std::sync::Arc;

use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::Spectrum;
use isoplanat::math::memory::Limit;
use isoplanat::psf::{Quadrature, SensorPoint};
use isoplanat::report::kernels::{KernelPlan, PlacedKernels};
use isoplanat::{KernelRequest, Lens};
use ndarray::{Array2, Array3, Array4, Array5, ArrayView5, Ix5, s};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Floats, Number, Whole, given, written, wrong_shape};
use crate::errors::{positive, refused, vergence};
use crate::work::work;

/// Wavelengths of a kernel in colour.
const COLOUR_NODES: usize = 7;
/// Largest window, pixels.
const LARGEST: usize = 2047;
/// Rays of a kernel and wavelength.
const RAYS: usize = 16_384;

/// What was asked for.
#[derive(Clone)]
pub(crate) struct Asked {
    pub(crate) fields_deg: Option<Vec<f64>>,
    pub(crate) distances_mm: Option<Vec<f64>>,
    pub(crate) pitch_um: Option<f64>,
    pub(crate) size: Option<usize>,
    pub(crate) fields: Option<usize>,
    pub(crate) wavelengths_nm: Option<Vec<f64>>,
    pub(crate) rays: Option<usize>,
    pub(crate) diffraction: bool,
}

/// What a [`Psf`] is made of once more: the lens that it was placed by, what was asked for, the lens it is of where that is another, its precision.
type Pickled<'py> = (crate::lens::Lens, Bound<'py, PyDict>, Option<crate::lens::Lens>, &'static str);

/// A `Psf` that was pickled.
#[pyfunction]
pub(crate) fn psf_again<'py>(
    first: &Bound<'py, PyAny>,
    keywords: &Bound<'py, PyDict>,
    lens: Option<&Bound<'py, PyAny>>,
    dtype: &str,
) -> PyResult<Bound<'py, PyAny>> {
    keywords.set_item("dtype", dtype)?;
    let placed = first.call_method("psf", (), Some(keywords))?;
    let Some(lens) = lens else { return Ok(placed) };
    let like = PyDict::new(first.py());
    like.set_item("like", placed)?;
    lens.call_method("psf", (), Some(&like))
}

impl Asked {
    /// As arguments of `Lens.psf`.
    fn keywords<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        let Self { fields_deg, distances_mm, pitch_um, size, fields, wavelengths_nm, rays, diffraction } = self;
        for (name, list) in
            [("fields_deg", fields_deg), ("distances_mm", distances_mm), ("wavelengths_nm", wavelengths_nm)]
        {
            all.set_item(name, list)?;
        }
        for (name, count) in [("size", size), ("fields", fields), ("rays", rays)] {
            all.set_item(name, count)?;
        }
        all.set_item("pitch_um", pitch_um)?;
        all.set_item("diffraction", diffraction)?;
        Ok(all)
    }

    fn anything(&self) -> bool {
        let lists = [&self.fields_deg, &self.distances_mm, &self.wavelengths_nm];
        let counts = [&self.size, &self.fields, &self.rays];
        lists.iter().any(|l| l.is_some())
            || counts.iter().any(|c| c.is_some())
            || self.pitch_um.is_some()
            || self.diffraction
    }

    /// The checked request, its quadrature, and its field angles.
    fn request(self, lens: &Lens) -> PyResult<(KernelRequest, Quadrature, Option<Vec<f64>>)> {
        let of = |name: &str, list: &Option<Vec<f64>>| match list {
            Some(list) if list.is_empty() => Err(refused(name, "none", "one or more")),
            _ => Ok(()),
        };
        of("fields_deg", &self.fields_deg)?;
        of("distances_mm", &self.distances_mm)?;
        of("wavelengths_nm", &self.wavelengths_nm)?;
        if self.fields_deg.is_some() && self.fields.is_some() {
            return Err(refused("fields", "given beside fields_deg", "one of the two"));
        }
        let fields = self.fields.unwrap_or(5);
        if !(1..=512).contains(&fields) {
            return Err(refused("fields", fields, "1 to 512"));
        }
        if let Some(angle) = self.fields_deg.iter().flatten().find(|a| !(0.0..90.0).contains(*a)) {
            return Err(refused("fields_deg", angle, "0 to below 90 degrees"));
        }
        let depth_mm = self.distances_mm.unwrap_or_else(|| vec![1.0 / lens.object_vergence]);
        depth_mm.iter().try_for_each(|d| vergence("distances_mm", *d).map(|_| ()))?;
        if let Some(size) = self.size.filter(|s| s % 2 == 0 || *s > LARGEST) {
            return Err(refused("size", size, format!("an odd number of pixels up to {LARGEST}")));
        }
        let rays = self.rays.unwrap_or(RAYS);
        if !(16..=1_000_000).contains(&rays) {
            return Err(refused("rays", rays, "16 to 1000000"));
        }
        let pitch_um = positive("pitch_um", self.pitch_um.unwrap_or(lens.sensor.pitch_um), "µm")?;
        let quadrature = match &self.wavelengths_nm {
            Some(nm) => {
                if let Some(bad) = nm.iter().find(|nm| !(200.0..=20_000.0).contains(*nm)) {
                    return Err(refused("wavelengths_nm", bad, "200 to 20000 nm"));
                }
                let own = |c: usize| (0..nm.len()).map(|l| f64::from(u8::from(c == l))).collect();
                Quadrature { nm: nm.clone(), weight: (0..nm.len()).map(own).collect() }
            }
            None => {
                let spectrum = Spectrum::quadrature(&Sensor::generic(), COLOUR_NODES);
                Quadrature { nm: spectrum.wavelength_nm, weight: spectrum.weight.to_vec() }
            }
        };
        let request = KernelRequest {
            depth_mm,
            wavelength_nm: Vec::new(),
            weights: Vec::new(),
            fields,
            size: self.size,
            pitch_mm: pitch_um * 1e-3,
            rays,
            diffraction: self.diffraction,
            memory: Limit::of_process(),
        };
        Ok((request, quadrature, self.fields_deg))
    }
}

/// Point spread functions.
///
/// Each stands as in an upright picture: row 0 is the side away from the axis (the field runs upwards from the axis), columns run to the right. It is
/// what a point of light looks like: for convolution as it is, for correlation turned by 180°. It sums to one less `outside`.
///
/// Attributes
/// ----------
/// kernels : array [distance, field, channel, row, col]
/// outside : array [distance, field, channel]
///     Share of the light outside the window.
/// relative_illumination : array [distance, field, channel]
///     Irradiance of white over that on the axis.
/// centroid_um : array [distance, field, channel, 2]
///     Mean place of the light from the kernel's middle pixel, right and up (away from the axis).
/// radius_mm, angle_deg, slope : array [distance, field]
///     Middle of the kernel: distance from the axis on the sensor; field angle at the paraxial entrance pupil; object height over distance.
/// distances_mm : list
/// wavelengths_nm : list
///     Wavelengths behind the channels.
/// weights : list
///     By channel, the weight of each wavelength, which sum to 1.
/// pitch_um : float
#[pyclass(frozen, module = "isoplanat")]
pub(crate) struct Psf {
    #[pyo3(get)]
    kernels: Py<PyAny>,
    #[pyo3(get)]
    outside: Py<PyAny>,
    #[pyo3(get)]
    relative_illumination: Py<PyAny>,
    #[pyo3(get)]
    centroid_um: Py<PyAny>,
    #[pyo3(get)]
    radius_mm: Py<PyAny>,
    #[pyo3(get)]
    angle_deg: Py<PyAny>,
    #[pyo3(get)]
    slope: Py<PyAny>,
    plan: KernelPlan,
    lens: Arc<Lens>,
    double: bool,
    /// What the plan was made of.
    first: Arc<First>,
}

/// The lens that places and windows are for, and what was asked for.
struct First {
    lens: Arc<Lens>,
    asked: Asked,
}

/// All arrays of a [`Psf`].
struct Made<T> {
    kernels: Array5<T>,
    outside: Array3<f64>,
    light: Array3<f64>,
    centroid_um: Array4<f64>,
    places: [Array2<f64>; 3],
}

impl<T: Number> Made<T> {
    fn of(plan: &KernelPlan) -> isoplanat::Result<Self> {
        let PlacedKernels { kernels, outside, .. } = plan.kernels::<T>();
        let (depths, fields, channels, size) = (plan.lines.len(), plan.fields(), plan.optics.channels(), plan.size());
        let shape = (depths, fields, channels, size, size);
        let kernels = Array5::from_shape_vec(shape, kernels).map_err(|e| isoplanat::Error::Internal(e.to_string()))?;
        let each = (depths, fields, channels);
        let outside = Array3::from_shape_fn(each, |(d, f, c)| outside[d * fields + f][c]);
        let mut light = Array3::zeros(each);
        for (d, line) in plan.lines.iter().enumerate() {
            for (f, radius) in line.radius_mm.iter().enumerate() {
                let here = plan.optics.relative_illumination(SensorPoint::along([0.0, -1.0], *radius));
                here.into_iter().enumerate().for_each(|(c, v)| light[[d, f, c]] = v);
            }
        }
        let mut centroid_um = Array4::zeros((depths, fields, channels, 2));
        let middle = (size / 2) as f64;
        let pitch_um = plan.form.cell_mm * 1e3;
        for ((d, f, c), _) in light.indexed_iter() {
            let kernel = kernels.slice(s![d, f, c, .., ..]);
            let mut sums = [0.0; 3];
            for ((i, j), v) in kernel.indexed_iter() {
                let v = v.to_double();
                sums[0] += v;
                sums[1] += v * (j as f64 - middle);
                sums[2] += v * (middle - i as f64);
            }
            for k in 0..2 {
                centroid_um[[d, f, c, k]] = if sums[0] > 0.0 { pitch_um * sums[k + 1] / sums[0] } else { f64::NAN };
            }
        }
        let line = |of: &dyn Fn(usize, usize) -> f64| Array2::from_shape_fn((depths, fields), |(d, f)| of(d, f));
        let places = [
            line(&|d, f| plan.lines[d].radius_mm[f]),
            line(&|d, f| plan.lines[d].angle_deg[f]),
            line(&|d, f| plan.lines[d].slope[f]),
        ];
        Ok(Self { kernels, outside, light, centroid_um, places })
    }

    fn given(self, py: Python<'_>, plan: KernelPlan, lens: Arc<Lens>, double: bool, first: Arc<First>) -> Psf {
        let [radius, angle, slope] = self.places.map(|a| given(py, a));
        Psf {
            kernels: given(py, self.kernels),
            outside: given(py, self.outside),
            relative_illumination: given(py, self.light),
            centroid_um: given(py, self.centroid_um),
            radius_mm: radius,
            angle_deg: angle,
            slope,
            plan,
            lens,
            double,
            first,
        }
    }
}

/// Whether an asked precision is the double one.
fn is_double(dtype: &Bound<'_, PyAny>) -> PyResult<bool> {
    let refuse = || PyTypeError::new_err(format!("dtype: {dtype}; \"float32\" or \"float64\""));
    // PyTorch's are called so.
    match &*dtype.str()?.to_string_lossy() {
        "torch.float32" => return Ok(false),
        "torch.float64" => return Ok(true),
        _ => {}
    }
    let found = dtype.py().import("numpy")?.call_method1("dtype", (dtype,)).map_err(|_| refuse())?;
    match found.getattr("name")?.extract::<String>()?.as_str() {
        "float32" => Ok(false),
        "float64" => Ok(true),
        _ => Err(refuse()),
    }
}

pub(crate) fn compute(
    py: Python<'_>,
    lens: &Arc<Lens>,
    asked: Asked,
    dtype: Option<&Bound<'_, PyAny>>,
    like: Option<&Bound<'_, Psf>>,
) -> PyResult<Psf> {
    let double = dtype.map(is_double).transpose()?;
    let (plan, double, first) = if let Some(like) = like {
        if asked.anything() {
            return Err(refused("like", "given beside what it decides", "it alone"));
        }
        let like = like.get();
        (work(py, || like.plan.again(lens))?, double.unwrap_or(like.double), Arc::clone(&like.first))
    } else {
        let first = Arc::new(First { lens: Arc::clone(lens), asked: asked.clone() });
        let (request, quadrature, angles) = asked.request(lens)?;
        let plan = work(py, || KernelPlan::new(lens, &request, quadrature, angles.as_deref()))?;
        (plan, double.unwrap_or(false), first)
    };
    if double {
        let made = work(py, || Made::<f64>::of(&plan))?;
        Ok(made.given(py, plan, lens.clone(), true, first))
    } else {
        let made = work(py, || Made::<f32>::of(&plan))?;
        Ok(made.given(py, plan, lens.clone(), false, first))
    }
}

#[pymethods]
impl Psf {
    /// Object distances, mm.
    #[getter]
    fn distances_mm(&self) -> Vec<f64> {
        self.plan.optics.spec.vergences.iter().map(|v| 1.0 / v).collect()
    }

    /// Wavelengths behind the channels, nm.
    #[getter]
    fn wavelengths_nm(&self) -> Vec<f64> {
        self.plan.optics.spec.quadrature.nm.clone()
    }

    /// By channel, the weight of each wavelength.
    #[getter]
    fn weights(&self) -> Vec<Vec<f64>> {
        self.plan.optics.spec.quadrature.weight.clone()
    }

    /// Pixel pitch, µm.
    #[getter]
    fn pitch_um(&self) -> f64 {
        self.plan.form.cell_mm * 1e3
    }

    /// The gradient of `(kernels * kernels_bar).sum()` by every number of the lens, under the names of `Lens.parameters`.
    ///
    /// `kernels_bar` has the shape of `kernels`. Held: places on the sensor, window, rays in the stop; `lens.psf(like=psf)` holds the same.
    fn vjp(&self, py: Python<'_>, kernels_bar: &Bound<'_, PyAny>) -> PyResult<Py<PyDict>> {
        let bar = Floats::of(kernels_bar, "kernels_bar", Whole::Taken)?;
        let size = self.plan.size();
        let wanted = [self.plan.lines.len(), self.plan.fields(), self.plan.optics.channels(), size, size];
        if bar.shape() != wanted {
            let allowed = format!("that of kernels, {}", written(&wanted));
            return Err(wrong_shape("kernels_bar", bar.shape(), &allowed));
        }
        let gradient = match &bar {
            Floats::Single(a) => self.pulled(py, &a.as_array().into_dimensionality::<Ix5>())?,
            Floats::Double(a) => self.pulled(py, &a.as_array().into_dimensionality::<Ix5>())?,
        };
        crate::lens::named(py, &self.lens, &gradient)
    }

    /// Strehl ratio and radii that hold light, by diffraction and before pixels; None of kernels of rays.
    ///
    /// A dict of `strehl`, array [distance, field, channel]: the largest value of the point spread over that of the same pupils without path differences; and of
    /// `radius_um`, array [distance, field, channel, 3]: radii about the centroid that hold 50, 80 and 95 % of the light. nan where hundreds of waves, or no light, leave it
    /// untold.
    fn energy(&self, py: Python<'_>) -> PyResult<Option<Py<PyDict>>> {
        if !self.plan.optics.spec.diffraction.diffracts() {
            return Ok(None);
        }
        let weights = self.weights();
        let of = || Ok(weights.iter().filter_map(|weight| self.plan.energies(weight)).collect::<Vec<_>>());
        let by_channel = work(py, of)?;
        let each = (self.plan.lines.len(), self.plan.fields(), weights.len());
        let at = |d: usize, f: usize, c: usize| by_channel[c][d * each.1 + f];
        let strehl = Array3::from_shape_fn(each, |(d, f, c)| at(d, f, c).0);
        let shape = (each.0, each.1, each.2, 3);
        let radius_um = Array4::from_shape_fn(shape, |(d, f, c, k)| 1e3 * at(d, f, c).1[k]);
        let found = PyDict::new(py);
        found.set_item("strehl", given(py, strehl))?;
        found.set_item("radius_um", given(py, radius_um))?;
        Ok(Some(found.unbind()))
    }

    /// Of its lenses and what was asked for.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Pickled<'py>)> {
        let First { lens: first, asked } = &*self.first;
        let dtype = if self.double { "float64" } else { "float32" };
        let lens = (!Arc::ptr_eq(first, &self.lens)).then(|| crate::lens::Lens::from((*self.lens).clone()));
        let made = py.import("isoplanat._isoplanat")?.getattr("psf_again")?;
        Ok((made, (crate::lens::Lens::from((**first).clone()), asked.keywords(py)?, lens, dtype)))
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let kernels = self.kernels.bind(py);
        Ok(format!("<Psf [distance, field, channel, row, col] = {}>", kernels.getattr("shape")?))
    }
}

impl Psf {
    fn pulled<T: Number>(
        &self,
        py: Python<'_>,
        bar: &Result<ArrayView5<'_, T>, ndarray::ShapeError>,
    ) -> PyResult<isoplanat::LensGradient> {
        work(py, || match bar {
            Ok(bar) if bar.iter().all(|v| v.is_finite()) => Ok(self.plan.vjp(&self.lens, bar.view())),
            Ok(_) => Err(isoplanat::Error::bad("", "kernels_bar", "nan or inf", "finite numbers")),
            Err(e) => Err(isoplanat::Error::Internal(e.to_string())),
        })
    }
}
