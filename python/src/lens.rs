//! `Lens`: a checked prescription, read, not written.

use std::collections::BTreeMap;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use isoplanat::atomic::{Target, check_target, write_bytes};
use isoplanat::interchange::{Form, lens_or_file, text_of};
use isoplanat::lens::f_number::stopped_to;
use isoplanat::lens::prescription;
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::lens::analysis::Analysis;
use isoplanat::report::listing::Listing;
use isoplanat::trace::rims::overlapping_rims;
use isoplanat::{Error, Glasses, LensGradient, Parameter, Result, builtin};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::analyses::Look;
use crate::arrays::Several;
use crate::bending::Bending;
use crate::errors::{in_python, raised};
use crate::frame::Frame;
use crate::optimized::Optimized;
use crate::psf::{Asked, Psf};
use crate::psf_map;
use crate::rays::Rays;
use crate::work::{here, work};

/// A lens: surfaces in the order of the light, stop, object distance, wavelengths, sensor. It does not change; `replace` makes another.
///
/// Parameters
/// ----------
/// file : str or os.PathLike
///     A lens file (.toml, .zmx, .seq, .json of DeepLens or Optiland, .txt of DiffOptics), or the name of a shipped lens (`isoplanat.lenses()`).
/// glasses : sequence of str or os.PathLike, optional
///     Glass catalogues (.agf, .glc, pages of refractiveindex.info) beside the shipped one, and beside those that ISOPLANAT_GLASSES names.
/// glass_for : dict of str, optional
///     Glasses to take where the file names others: `{"SSK4": "SSK4A"}`; `"model"` takes the index and Abbe number of the line that names it. A name that no surface has is refused.
///
/// Raises FileNotFoundError, ValueError with file, place, what was found and what is allowed. What a file leaves open is in `notes`.
#[pyclass(frozen, eq, module = "isoplanat")]
#[derive(Clone, Debug)]
pub(crate) struct Lens {
    pub(crate) inner: Arc<isoplanat::Lens>,
    notes: Vec<String>,
}

impl PartialEq for Lens {
    fn eq(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}

impl From<isoplanat::Lens> for Lens {
    fn from(lens: isoplanat::Lens) -> Self {
        Self { inner: Arc::new(lens), notes: Vec::new() }
    }
}

/// The names of the shipped lenses.
#[pyfunction]
pub(crate) fn lenses() -> Vec<&'static str> {
    builtin::LENSES.iter().map(|(name, _)| *name).collect()
}

/// The shipped glasses, those that the environment names, and `files`.
fn glasses(files: &[PathBuf]) -> Result<Glasses> {
    let mut all = Glasses::shipped().clone();
    let configured = std::env::var_os("ISOPLANAT_GLASSES").filter(|f| !f.is_empty()).map(PathBuf::from);
    configured.iter().chain(files).try_for_each(|path| all.add(path))?;
    Ok(all)
}

/// Gradients, or values, under the names of the numbers of `lens`.
pub(crate) fn named(py: Python<'_>, lens: &isoplanat::Lens, gradient: &LensGradient) -> PyResult<Py<PyDict>> {
    let all = PyDict::new(py);
    for number in Parameter::all(lens) {
        all.set_item(number.name(lens), number.value(gradient).unwrap_or(0.0))?;
    }
    Ok(all.unbind())
}

/// The lens with an object at a distance that may be infinite; its own where none is asked for.
pub(crate) fn at(lens: &isoplanat::Lens, distance_mm: Option<f64>) -> PyResult<isoplanat::Lens> {
    match distance_mm {
        None => Ok(lens.clone()),
        Some(distance) => {
            let vergence = crate::errors::vergence("distance_mm", distance)?;
            here(|| lens.changed(|l| l.object_vergence = vergence))
        }
    }
}

#[pymethods]
impl Lens {
    #[new]
    #[pyo3(signature = (file, *, glasses = Vec::new(), glass_for = BTreeMap::new()))]
    fn new(
        py: Python<'_>,
        file: PathBuf,
        glasses: Vec<PathBuf>,
        glass_for: BTreeMap<String, String>,
    ) -> PyResult<Self> {
        work(py, || {
            let mut all = self::glasses(&glasses)?;
            let instead =
                |(name, glass): (&String, &String)| all.take_instead(name, glass).map_err(|e| e.of_file("glass_for"));
            glass_for.iter().try_for_each(instead)?;
            let read = lens_or_file(&file, &all, Default::default())?;
            all.all_taken().map_err(|e| e.of_file("glass_for"))?;
            let mut notes = read.notes;
            notes.extend(overlapping_rims(&read.lens, &file.display().to_string()));
            let notes = notes.iter().map(|note| in_python(note)).collect();
            Ok(Self { inner: Arc::new(read.lens), notes })
        })
    }

    /// The lens of a text in the form of `.toml` files; `name` stands for the file in errors.
    #[staticmethod]
    #[pyo3(signature = (text, name = "text"))]
    fn from_toml(py: Python<'_>, text: &str, name: &str) -> PyResult<Self> {
        work(py, || Ok(prescription::from_toml(text, name)?.into()))
    }

    /// All of it as the text of a `.toml` file.
    fn to_toml(&self) -> String {
        prescription::to_toml(&self.inner)
    }

    /// What its file calls it.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// What errors call it: the file that it was read from.
    #[getter]
    fn file(&self) -> &str {
        self.inner.file()
    }

    /// What reading its file left out, resolved or assumed, and surfaces that overlap beyond the light; one line each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// SHA-256 of its `.toml` form: the same for the same numbers.
    #[getter]
    fn sha256(&self) -> String {
        self.inner.sha256()
    }

    /// Its wavelengths (nm) and their shares of the light.
    #[getter]
    fn wavelengths(&self) -> Vec<(f64, f64)> {
        self.inner.wavelengths.shares().collect()
    }

    /// The wavelength of chief rays and first-order data, nm.
    #[getter]
    fn primary_nm(&self) -> f64 {
        self.inner.wavelengths.primary_nm
    }

    /// Object distance before the first vertex, mm; may be inf.
    #[getter]
    fn distance_mm(&self) -> f64 {
        1.0 / self.inner.object_vergence
    }

    /// Medium between the object and the first surface.
    #[getter]
    fn object_medium(&self) -> String {
        self.inner.object_medium.to_string()
    }

    /// Radius of the image surface, mm: positive where its centre lies behind it, infinite for a plane.
    #[getter]
    fn image_radius(&self) -> f64 {
        self.inner.image.curvature.recip()
    }

    /// The raster that its file states.
    #[getter]
    fn frame(&self) -> PyResult<Frame> {
        Frame::of(&self.inner).map_err(raised)
    }

    /// Every number that rays depend on, by its path in the file without units: lengths in mm, curvatures in 1/mm, angles in radians.
    ///
    /// `{"surface[0].curvature": 0.0454, "surface[0].thickness": 3.25899, …}`
    #[getter]
    fn parameters(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let all = PyDict::new(py);
        for number in Parameter::all(&self.inner) {
            all.set_item(number.name(&self.inner), number.value(&**self.inner).unwrap_or(0.0))?;
        }
        Ok(all.unbind())
    }

    /// This lens with other numbers, by the names of `parameters`, with its object elsewhere, and with its stop closed to an f-number (focal length over entrance pupil).
    ///
    /// Raises ValueError for a name that is none, for numbers that are no lens, and for a stop larger than its surface is clear.
    #[pyo3(signature = (numbers = None, *, distance_mm = None, f_number = None))]
    fn replace(
        &self,
        numbers: Option<&Bound<'_, PyDict>>,
        distance_mm: Option<f64>,
        f_number: Option<f64>,
    ) -> PyResult<Self> {
        let lens = at(&self.inner, distance_mm)?;
        let mut wanted = Vec::new();
        for (name, value) in numbers.into_iter().flatten() {
            let name: String = name.extract()?;
            let value: f64 = value.extract().map_err(|_| {
                let found = value.get_type();
                PyTypeError::new_err(format!("{name}: {found}; a number"))
            })?;
            wanted.push((name, value));
        }
        let known: HashMap<String, Parameter> = match wanted[..] {
            [] => HashMap::new(),
            _ => Parameter::all(&lens).map(|p| (p.name(&lens), p)).collect(),
        };
        let changes = wanted.iter().map(|(name, value)| match known.get(name) {
            Some(parameter) => Ok((*parameter, *value)),
            None => {
                let first = Parameter::all(&lens).next().map_or(String::new(), |p| p.name(&lens));
                let allowed = format!("a name in its parameters, such as {first}");
                Err(raised(Error::bad(lens.file(), name.as_str(), "no such number", allowed)))
            }
        });
        let changes = changes.collect::<PyResult<Vec<(Parameter, f64)>>>()?;
        let change = |l: &mut isoplanat::Prescription| {
            for (parameter, value) in &changes {
                if let Some(number) = parameter.value_mut(l) {
                    *number = *value;
                }
            }
        };
        let changed = here(|| lens.changed(change))?;
        Ok(match f_number {
            Some(number) => here(|| stopped_to(&changed, number).map_err(|e| e.of_file("f_number")))?.into(),
            None => changed.into(),
        })
    }

    /// Writes it, by the ending of `file`: .toml, .zmx (Zemax OpticStudio), .seq (CODE V). Returns a line on each thing that the form cannot say and that
    /// changes no ray.
    ///
    /// Raises FileExistsError unless `force`; ValueError for what the form cannot say. Nothing is half-written.
    #[pyo3(signature = (file, *, force = false))]
    fn save(&self, py: Python<'_>, file: PathBuf, force: bool) -> PyResult<Vec<String>> {
        let lens = &self.inner;
        work(py, || {
            let form = Form::from_path(&file)?;
            check_target(&file, force.into())?;
            let (text, notes) = text_of(lens, form, &glasses(&[])?)?;
            write_bytes(Target::new(&file, force), text.as_bytes())?;
            Ok(notes)
        })
    }

    /// Its cross-section with rays of three fields, as SVG text.
    fn svg(&self, py: Python<'_>) -> PyResult<String> {
        work(py, || Ok(lens_svg(&self.inner)))
    }

    /// Exact rays through all surfaces, to the image plane.
    ///
    /// Parameters
    /// ----------
    /// origins, directions : array, shape (..., 3)
    ///     Points in mm and directions (of any length) in the frame of the first vertex: z along the light, y up. One direction, shape (3,), serves all origins.
    /// wavelength_nm : float, optional
    ///     The lens's primary wavelength where left out.
    /// clip : bool
    ///     Stop rays at clear apertures.
    ///
    /// Returns `Rays`, float64, of the same leading shape.
    #[pyo3(signature = (origins, directions, *, wavelength_nm = None, clip = false))]
    fn trace(
        &self,
        py: Python<'_>,
        origins: &Bound<'_, PyAny>,
        directions: &Bound<'_, PyAny>,
        wavelength_nm: Option<f64>,
        clip: bool,
    ) -> PyResult<Rays> {
        crate::rays::trace(py, &self.inner, (origins, directions), wavelength_nm, clip)
    }

    /// The gradient of a loss by every number of the lens, under the names of `parameters`, by `origins` and by `directions`, from those by what `trace` gives.
    ///
    /// Parameters
    /// ----------
    /// origins, directions, wavelength_nm, clip
    ///     As of `trace`, which is done once more: memory does not grow with the surfaces.
    /// positions_bar, directions_bar : array, shape (..., 3), optional
    ///     Gradients by where rays arrive and by their directions there; none where left out. Those of rays that do not arrive are not looked at.
    /// paths_bar : array, shape (...), optional
    ///     Gradients by optical paths.
    #[pyo3(signature = (origins, directions, *, positions_bar = None, directions_bar = None, paths_bar = None, wavelength_nm = None, clip = false))]
    #[expect(clippy::too_many_arguments, reason = "Python's words")]
    fn trace_vjp(
        &self,
        py: Python<'_>,
        origins: &Bound<'_, PyAny>,
        directions: &Bound<'_, PyAny>,
        positions_bar: Option<&Bound<'_, PyAny>>,
        directions_bar: Option<&Bound<'_, PyAny>>,
        paths_bar: Option<&Bound<'_, PyAny>>,
        wavelength_nm: Option<f64>,
        clip: bool,
    ) -> PyResult<(Py<PyDict>, Py<PyAny>, Py<PyAny>)> {
        let bars = [positions_bar, directions_bar, paths_bar];
        crate::rays::trace_vjp(py, &self.inner, (origins, directions), bars, wavelength_nm, clip)
    }

    /// Point spread functions over object distance, field and colour.
    ///
    /// Parameters
    /// ----------
    /// fields_deg : float or sequence of float, optional
    ///     Field angles at the paraxial entrance pupil. Where left out: `fields` places from the axis to the border, evenly on the sensor.
    /// distances_mm : float or sequence of float, optional
    ///     Object distances before the first vertex; inf is allowed. The lens's own where left out.
    /// pitch_um : float, optional
    ///     Pixel pitch; the lens's sensor's where left out.
    /// size : int, optional
    ///     Pixels along a side, odd. Where left out: what holds 99.9 % of the light.
    /// wavelengths_nm : float or sequence of float, optional
    ///     One channel a wavelength. Where left out: red, green and blue of the generic sensor.
    /// rays : int
    ///     Rays of a kernel and wavelength.
    /// dtype : "float32" or "float64"
    /// like : Psf, optional
    ///     Another lens's, usually this one before it was changed: its places on the sensor, distances, channels and window are taken over, and nothing
    ///     else may be given. What `Psf.vjp` differentiates.
    /// diffraction : bool, or "on" or "off"
    ///     Kernels by diffraction (scalar waves) in place of rays.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (fields_deg = None, distances_mm = None, pitch_um = None, size = None, *, fields = None, wavelengths_nm = None,
        rays = None, dtype = None, like = None, diffraction = None))]
    fn psf(
        &self,
        py: Python<'_>,
        fields_deg: Option<Several<f64>>,
        distances_mm: Option<Several<f64>>,
        pitch_um: Option<f64>,
        size: Option<usize>,
        fields: Option<usize>,
        wavelengths_nm: Option<Several<f64>>,
        rays: Option<usize>,
        dtype: Option<&Bound<'_, PyAny>>,
        like: Option<&Bound<'_, Psf>>,
        diffraction: Option<Bending>,
    ) -> PyResult<Psf> {
        let [fields_deg, distances_mm, wavelengths_nm] =
            [fields_deg, distances_mm, wavelengths_nm].map(|list| list.map(|l| l.0));
        let diffraction = Bending::of_kernels(diffraction.as_ref())?;
        let asked = Asked { fields_deg, distances_mm, pitch_um, size, fields, wavelengths_nm, rays, diffraction };
        crate::psf::compute(py, &self.inner, asked, dtype, like)
    }

    /// Point spread functions over a frame in the colours of a sensor, in the forms that networks are trained and pictures restored with: what
    /// `isoplanat psf --form` writes, as a dict of arrays. `about` in it says how to read them.
    ///
    /// Parameters
    /// ----------
    /// form : "heights", "grid" or "filters"
    ///     heights: `psf` [K, 3, h, w], `illumination` [K], `distortion` [K] from the axis to the frame's corner, outwards downwards.
    ///     grid: `psf` [R, C, 3, h, w] over the frame. filters: `filters` [1, 3, K, h, w] and `multipliers` [1, 3, K, rows, columns] of a space-varying
    ///     blur, y = sum over k of multipliers[k] * convolve(x, filters[k]).
    /// frame : Frame, optional
    ///     The lens's own where left out.
    /// distance_mm : float, optional
    /// heights : int
    ///     Kernels of heights; 64 where left out.
    /// grid : (rows, columns), optional
    ///     Kernels of grid (9, 9 where left out), or of filters.
    /// node_error : float
    ///     Relative error of a kernel between its neighbours, which decides how many filters there are; 0.05 where left out.
    /// size : int, optional
    ///     Pixels along a side, odd. Where left out: what holds 99.9 % of the light.
    /// rays : int
    /// sensor : str or os.PathLike, optional
    ///     Sensor calibration whose colours these are; the generic sensor where left out.
    /// illuminant : str
    ///     As of `render`.
    /// diffraction : bool, or "on" or "off"
    ///     Kernels by diffraction (scalar waves) in place of rays.
    ///
    /// Returns
    /// -------
    /// dict
    ///     heights: `psf`, `illumination` (white), `illumination_rgb` [K, 3], `distortion`, `height_mm` [K] on the sensor, `outside` [K, 3], the light beyond the kernels.
    ///     grid: `psf`, `illumination` [R, C, 3], `distortion`, `height_mm` [R, C], `outside` [R, C, 3], `row_px` [R], `col_px` [C]. filters: `filters`, `multipliers`,
    ///     `row_px`, `col_px`, `distortion`, `height_mm` [K], `outside` [1, 3, K]. All: `pitch_mm`, `distance_mm`, `frame_px` (rows, columns), `axis_px`, `diffraction`,
    ///     `schema`, and `about`, a text.
    ///
    /// Kernels are for convolution: turn them by 180° where a framework correlates.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (form, frame = None, *, distance_mm = None, heights = None, grid = None, node_error = None, size = None, rays = None,
        sensor = None, illuminant = None, diffraction = None))]
    fn psf_map(
        &self,
        py: Python<'_>,
        form: &str,
        frame: Option<&Bound<'_, Frame>>,
        distance_mm: Option<f64>,
        heights: Option<usize>,
        grid: Option<[usize; 2]>,
        node_error: Option<f64>,
        size: Option<usize>,
        rays: Option<usize>,
        sensor: Option<PathBuf>,
        illuminant: Option<&str>,
        diffraction: Option<Bending>,
    ) -> PyResult<Py<PyDict>> {
        let frame = frame.map(|f| f.get().clone());
        let asked = psf_map::Asked {
            form,
            frame,
            distance_mm,
            heights,
            grid,
            node_error,
            size,
            rays,
            sensor,
            illuminant,
            diffraction: Bending::of_kernels(diffraction.as_ref())?,
        };
        psf_map::compute(py, &self.inner, asked)
    }

    /// First-order data, surfaces and third-order sums, as `isoplanat inspect --json`: lengths in mm.
    #[pyo3(signature = (*, wavelength_nm = None))]
    fn inspect(&self, py: Python<'_>, wavelength_nm: Option<f64>) -> PyResult<Py<PyAny>> {
        crate::analyses::inspect(py, &self.inner, wavelength_nm)
    }

    /// Spots by field: `fields` (rms, radii, centroid, best focus; radii by diffraction; mm; Strehl ratio), `plots`, and arrays `rays` [field, wavelength, ray, 5] (x, y in mm, slopes,
    /// weight), `wavelength_nm`, `weight`, `field_angle_deg`.
    #[pyo3(signature = (*, distance_mm = None, rays = 1600, fields_deg = None, max_angle_deg = None))]
    fn spot(
        &self,
        py: Python<'_>,
        distance_mm: Option<f64>,
        rays: usize,
        fields_deg: Option<Several<f64>>,
        max_angle_deg: Option<f64>,
    ) -> PyResult<Py<PyAny>> {
        let fields_deg = fields_deg.map_or_else(Vec::new, |all| all.0);
        let look = Look { distance_mm, rays, fields_deg, max_angle_deg, ..Look::default() };
        crate::analyses::analysis(py, &self.inner, Analysis::Spot, look)
    }

    /// Modulation transfer by rays and by diffraction: `fields`, `plots`, and arrays `mtf`, `mtf_diffraction` [shift, field, frequency, direction],
    /// `shift_mm`, `cycles_per_mm`, `field_angle_deg`. Directions: tangential, sagittal. Frequencies given as `cycles_per_mm` stand among the even ones.
    #[pyo3(signature = (*, distance_mm = None, rays = 1600, fields_deg = None, max_angle_deg = None, max_cycles_per_mm = None, shift_mm = None,
        cycles_per_mm = None))]
    #[expect(clippy::too_many_arguments, reason = "each is a keyword of its own")]
    fn mtf(
        &self,
        py: Python<'_>,
        distance_mm: Option<f64>,
        rays: usize,
        fields_deg: Option<Several<f64>>,
        max_angle_deg: Option<f64>,
        max_cycles_per_mm: Option<f64>,
        shift_mm: Option<f64>,
        cycles_per_mm: Option<Several<f64>>,
    ) -> PyResult<Py<PyAny>> {
        let [fields_deg, cycles_per_mm] =
            [fields_deg, cycles_per_mm].map(|list| list.map_or_else(Vec::new, |all| all.0));
        let look = Look { distance_mm, rays, fields_deg, max_angle_deg, max_cycles_per_mm, cycles_per_mm, shift_mm };
        crate::analyses::analysis(py, &self.inner, Analysis::Mtf, look)
    }

    /// Distortion over the field: `plots`, and arrays `angle_height_percent` [field, 3] (degrees, mm, per cent), `percent_of_focal_length`.
    #[pyo3(signature = (*, distance_mm = None, max_angle_deg = None))]
    fn distortion(&self, py: Python<'_>, distance_mm: Option<f64>, max_angle_deg: Option<f64>) -> PyResult<Py<PyAny>> {
        let look = Look { distance_mm, max_angle_deg, ..Look::default() };
        crate::analyses::analysis(py, &self.inner, Analysis::Distortion, look)
    }

    /// Everything about the lens on one page, written to `file` (.html) where one is given; returns its numbers, as `isoplanat report --json`.
    #[pyo3(signature = (file = None, *, force = false, distance_mm = None, rays = 1600))]
    fn report(
        &self,
        py: Python<'_>,
        file: Option<PathBuf>,
        force: bool,
        distance_mm: Option<f64>,
        rays: usize,
    ) -> PyResult<Py<PyAny>> {
        let look = Look { distance_mm, rays, ..Look::default() };
        crate::analyses::report(py, &self.inner, file.as_deref(), force, look)
    }

    /// A better lens by damped least squares on exact rays.
    ///
    /// Parameters
    /// ----------
    /// vary, fix : str or sequence of str, optional
    ///     Patterns of numbers that move, or do not: "surface[*].curvature", "surface[2].a4". Where left out: curvatures of refracting surfaces, thicknesses.
    /// bounds, constraints : dict, optional
    ///     A number (held), a pair with None for an open end, or text such as "..60", by pattern or by name: {"surface[*].thickness": (1, 8),
    ///     "focal_length": 50, "track": (None, 60)}. What is held without being asked for stands in docs/lens-design.md.
    /// targets : dict, optional
    ///     (value, weight) by name, the weight in mm of rms a unit.
    /// quality : "spot" or "wavefront"
    /// distances_mm : float or sequence of float, optional
    /// iterations : int
    /// minutes : float, optional
    ///     Where the best lens so far is taken.
    ///
    /// Ctrl-C raises KeyboardInterrupt; what was reached is then lost.
    #[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
    #[pyo3(signature = (*, vary = Several(Vec::new()), fix = Several(Vec::new()), bounds = None, constraints = None, targets = None, quality = None,
        distances_mm = None, iterations = 400, minutes = None))]
    fn optimize(
        &self,
        py: Python<'_>,
        vary: Several<String>,
        fix: Several<String>,
        bounds: Option<&Bound<'_, PyDict>>,
        constraints: Option<&Bound<'_, PyDict>>,
        targets: Option<&Bound<'_, PyDict>>,
        quality: Option<String>,
        distances_mm: Option<Several<f64>>,
        iterations: usize,
        minutes: Option<f64>,
    ) -> PyResult<Optimized> {
        let spec = crate::optimized::spec(
            (vary.0, fix.0),
            (bounds, constraints, targets),
            quality,
            distances_mm.map(|l| l.0),
        )?;
        crate::optimized::optimize(py, &self.inner, &spec, iterations, minutes)
    }

    fn __repr__(&self) -> String {
        let first = isoplanat::first_order(&self.inner, self.inner.wavelengths.primary_nm);
        let [focal_length, number] = [first.effective_focal_length, first.f_number].map(|v| format!("{v:.5}"));
        let surfaces = self.inner.surfaces.len();
        format!("<Lens {:?}: {surfaces} surfaces, focal length {focal_length} mm, f/{number}>", self.inner.name)
    }

    /// Drawing and first-order data, for notebooks.
    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        work(py, || {
            let lens = &self.inner;
            let listing = Listing::new(lens, lens.wavelengths.primary_nm);
            Ok(crate::analyses::html(lens, &listing, &self.notes))
        })
    }

    fn __hash__(&self) -> u64 {
        // The digits of the numbers' own sum.
        u64::from_str_radix(&self.inner.sha256()[..16], 16).unwrap_or(0)
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (String, String))> {
        let own = slf.get();
        let made = slf.get_type().getattr("from_toml")?;
        Ok((made, (own.to_toml(), own.inner.file().to_owned())))
    }
}
