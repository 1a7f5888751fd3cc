//! `Lens.trace`, what it gives, and its adjoint.

use std::sync::{Mutex, PoisonError};

use isoplanat::glam::DVec3;
use isoplanat::trace::lanes::{Bundle, Options, Program, Status, TILE, Tile, trace_gradient};
use isoplanat::trace::{Cause, SystemGradient};
use isoplanat::{Lens, LensGradient, Ray, Result, System};
use ndarray::{ArrayD, ArrayViewD, IxDyn};
use numpy::Element;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Floats, Whole, given, written, wrong_shape};
use crate::errors::{raised, refused};
use crate::work::{here, work};

/// What a ray came to, by its number in `Rays.status`.
pub(crate) const STATUS: [&str; 5] = ["ok", "missed", "vignetted", "total_reflection", "not_converged"];
/// Rays that are traced on the calling thread.
const FEW: usize = 1024;

/// Traced rays, float64.
///
/// Attributes
/// ----------
/// positions, directions : array, shape (..., 3)
///     Points on the image plane in its own frame (mm) and unit directions there; nan where the ray does not arrive.
/// paths : array, shape (...)
///     Optical paths from the origins, mm.
/// status : uint8 array, shape (...)
///     0 where the ray arrives, else the place of its failure in `isoplanat.STATUS`.
/// surface : int32 array, shape (...)
///     The surface that stopped it, counted from 0; -1 where it arrives.
#[pyclass(frozen, get_all, module = "isoplanat")]
pub(crate) struct Rays {
    positions: Py<PyAny>,
    directions: Py<PyAny>,
    paths: Py<PyAny>,
    status: Py<PyAny>,
    surface: Py<PyAny>,
}

#[pymethods]
impl Rays {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Rays of shape {}>", self.paths.bind(py).getattr("shape")?))
    }
}

/// Landed rays, one after the other.
struct Landed {
    positions: Vec<f64>,
    directions: Vec<f64>,
    paths: Vec<f64>,
    status: Vec<u8>,
    surface: Vec<i32>,
}

/// Rays that set out, as Python gave them.
struct Launch<'py> {
    nm: f64,
    origins: Floats<'py>,
    directions: Floats<'py>,
    /// (…, 3).
    shape: Vec<usize>,
    count: usize,
}

impl<'py> Launch<'py> {
    fn of(
        lens: &Lens,
        (origins, directions): (&Bound<'py, PyAny>, &Bound<'py, PyAny>),
        wavelength_nm: Option<f64>,
    ) -> PyResult<Self> {
        let nm = wavelength_nm.unwrap_or(lens.wavelengths.primary_nm);
        if !(200.0..=20_000.0).contains(&nm) {
            return Err(refused("wavelength_nm", nm, "200 to 20000 nm"));
        }
        lens.require_indices(nm, lens.file()).map_err(raised)?;
        let origins = Floats::of(origins, "origins", Whole::Taken)?;
        let directions = Floats::of(directions, "directions", Whole::Taken)?;
        let shape = origins.shape().to_vec();
        let Some((3, leading)) = shape.split_last().map(|(last, leading)| (*last, leading)) else {
            return Err(wrong_shape("origins", &shape, "(..., 3): x, y, z in mm"));
        };
        if directions.shape() != [3] && directions.shape() != shape {
            let allowed = format!("that of origins, {}, or (3,)", written(&shape));
            return Err(wrong_shape("directions", directions.shape(), &allowed));
        }
        let count = leading.iter().product();
        Ok(Self { nm, origins, directions, shape, count })
    }

    /// Without the coordinates.
    fn leading(&self) -> &[usize] {
        &self.shape[..self.shape.len() - 1]
    }
}

/// The numbers of rays that set out, row by row.
#[derive(Clone, Copy)]
struct Starts<'a> {
    from: &'a [f64],
    towards: &'a [f64],
}

impl Starts<'_> {
    /// Which direction is that of a ray: one serves all.
    fn towards(&self, ray: usize) -> usize {
        if self.towards.len() == 3 { 0 } else { ray }
    }

    /// Ray `number`, its direction of length one.
    fn ray(&self, number: usize) -> Result<Ray> {
        let [origin, direction] =
            [(self.from, number), (self.towards, self.towards(number))].map(|(all, k)| three(all, k));
        checked(origin, direction, number)
    }
}

/// Point or direction `k` of many.
fn three(all: &[f64], k: usize) -> DVec3 {
    DVec3::new(all[3 * k], all[3 * k + 1], all[3 * k + 2])
}

pub(crate) fn trace(
    py: Python<'_>,
    lens: &Lens,
    given_rays: (&Bound<'_, PyAny>, &Bound<'_, PyAny>),
    wavelength_nm: Option<f64>,
    clip: bool,
) -> PyResult<Rays> {
    let launch = Launch::of(lens, given_rays, wavelength_nm)?;
    let (from, towards) = (launch.origins.cast::<f64>(), launch.directions.cast::<f64>());
    let (from, towards) = (from.view(), towards.view());
    let system = System::new(lens, launch.nm);
    let program = Program::new(&system, Options { clip, path: true, level: None });
    let count = launch.count;
    let job = || traced(&program, Starts { from: flat(&from), towards: flat(&towards) }, count);
    let landed = if count <= FEW { here(job)? } else { work(py, job)? };
    let [whole, each] = [&launch.shape[..], launch.leading()];
    Ok(Rays {
        positions: shaped(py, landed.positions, whole),
        directions: shaped(py, landed.directions, whole),
        paths: shaped(py, landed.paths, each),
        status: shaped(py, landed.status, each),
        surface: shaped(py, landed.surface, each),
    })
}

/// Cotangents of where rays arrive, row by row; none where left out.
struct Bars<'a> {
    positions: Option<&'a [f64]>,
    directions: Option<&'a [f64]>,
    paths: Option<&'a [f64]>,
}

/// Cotangents by name of number, of origins and of directions.
type Pulled = (Py<PyDict>, Py<PyAny>, Py<PyAny>);

/// Traces rays once more and pulls cotangents of where they arrive back to the lens's numbers, their origins and their directions.
pub(crate) fn trace_vjp(
    py: Python<'_>,
    lens: &Lens,
    given_rays: (&Bound<'_, PyAny>, &Bound<'_, PyAny>),
    bars: [Option<&Bound<'_, PyAny>>; 3],
    wavelength_nm: Option<f64>,
    clip: bool,
) -> PyResult<Pulled> {
    let launch = Launch::of(lens, given_rays, wavelength_nm)?;
    let names = ["positions_bar", "directions_bar", "paths_bar"];
    let shapes = [&launch.shape[..], &launch.shape, launch.leading()];
    let mut floats = Vec::new();
    for ((bar, name), shape) in bars.into_iter().zip(names).zip(shapes) {
        let bar = bar.map(|b| Floats::of(b, name, Whole::Taken)).transpose()?;
        if let Some(found) = bar.as_ref().map(Floats::shape).filter(|found| *found != shape) {
            return Err(wrong_shape(name, found, &written(shape)));
        }
        floats.push(bar);
    }
    let cast: Vec<_> = floats.iter().map(|bar| bar.as_ref().map(Floats::cast::<f64>)).collect();
    let views: Vec<_> = cast.iter().map(|bar| bar.as_ref().map(|b| b.view())).collect();
    let (from, towards) = (launch.origins.cast::<f64>(), launch.directions.cast::<f64>());
    let (from, towards) = (from.view(), towards.view());
    let (gradient, from_bar, towards_bar) = work(py, || {
        let starts = Starts { from: flat(&from), towards: flat(&towards) };
        let [positions, directions, paths] = [0, 1, 2].map(|k| views[k].as_ref().map(flat));
        let system = System::new(lens, launch.nm);
        let (of_system, from_bar, towards_bar) =
            pulled(&system, starts, &Bars { positions, directions, paths }, launch.count, clip)?;
        let mut gradient = LensGradient::zeros(lens);
        of_system.add_to(lens, launch.nm, &mut gradient);
        Ok((gradient, from_bar, towards_bar))
    })?;
    let named = crate::lens::named(py, lens, &gradient)?;
    Ok((named, shaped(py, from_bar, &launch.shape), shaped(py, towards_bar, launch.directions.shape())))
}

fn pulled(
    system: &System,
    starts: Starts<'_>,
    bars: &Bars<'_>,
    count: usize,
    clip: bool,
) -> Result<(SystemGradient, Vec<f64>, Vec<f64>)> {
    use rayon::prelude::*;

    (0..count).into_par_iter().try_for_each(|ray| starts.ray(ray).map(drop))?;
    let source = |first: usize, tile: &mut Tile| {
        isoplanat::stop::look();
        for lane in 0..tile.len() {
            tile.rays.set(lane, starts.ray(first + lane).expect("looked at before"));
        }
    };
    let landing = |first: usize, tile: &Tile, to: &mut Bundle| {
        for lane in 0..tile.len() {
            let of = |all: Option<&[f64]>| all.map_or(DVec3::ZERO, |all| three(all, first + lane));
            to.set(lane, Ray { origin: of(bars.positions), direction: of(bars.directions) });
            to.path[lane] = bars.paths.map_or(0.0, |all| all[first + lane]);
        }
        0.0
    };
    // Cotangents of every ray where it sets out: three of its origin, three of its direction of length one.
    let launched = Mutex::new(vec![0.0; 6 * count]);
    let launch = |first: usize, len: usize, bars: &Bundle| {
        let mut all = launched.lock().unwrap_or_else(PoisonError::into_inner);
        for lane in 0..len {
            let bar = bars.ray(lane);
            let to = &mut all[6 * (first + lane)..][..6];
            to[..3].copy_from_slice(&bar.origin.to_array());
            to[3..].copy_from_slice(&bar.direction.to_array());
        }
    };
    let options = Options { clip, path: true, level: None };
    let (_, gradient) = trace_gradient(system, count, options, source, landing, Some(&launch));
    let all = launched.into_inner().unwrap_or_else(PoisonError::into_inner);
    let (mut from_bar, mut towards_bar) = (Vec::with_capacity(3 * count), vec![0.0; starts.towards.len()]);
    for (ray, bar) in all.chunks_exact(6).enumerate() {
        from_bar.extend_from_slice(&bar[..3]);
        // Of the direction as it was given, of any length.
        let k = starts.towards(ray);
        let (given, bar) = (three(starts.towards, k), three(bar, 1));
        let unit = given.normalize();
        let bar = (bar - unit * bar.dot(unit)) / given.length();
        towards_bar[3 * k..][..3].iter_mut().zip(bar.to_array()).for_each(|(to, v)| *to += v);
    }
    Ok((gradient, from_bar, towards_bar))
}

/// An array of Python of as many values as its shape says.
fn shaped<T: Element>(py: Python<'_>, values: Vec<T>, shape: &[usize]) -> Py<PyAny> {
    given(py, ArrayD::from_shape_vec(IxDyn(shape), values).expect("as many as the shape says"))
}

/// The numbers of an array in row-major order.
fn flat<'a>(array: &'a ArrayViewD<'_, f64>) -> &'a [f64] {
    array.as_slice().expect("in row-major order")
}

fn traced(program: &Program, starts: Starts<'_>, count: usize) -> Result<Landed> {
    use rayon::prelude::*;

    let mut landed = Landed {
        positions: vec![f64::NAN; 3 * count],
        directions: vec![f64::NAN; 3 * count],
        paths: vec![f64::NAN; count],
        status: vec![0; count],
        surface: vec![-1; count],
    };
    let tile_of = |(first, tile, mut parts): (usize, &mut Tile, Parts<'_>)| -> Result<()> {
        let len = parts.paths.len();
        tile.resize(len);
        for lane in 0..len {
            tile.rays.set(lane, starts.ray(first + lane)?);
        }
        program.trace_tile(tile);
        for lane in 0..len {
            parts.put(lane, tile);
        }
        Ok(())
    };
    let tiles = landed
        .positions
        .chunks_mut(3 * TILE)
        .zip(landed.directions.chunks_mut(3 * TILE))
        .zip(landed.paths.chunks_mut(TILE))
        .zip(landed.status.chunks_mut(TILE).zip(landed.surface.chunks_mut(TILE)))
        .enumerate()
        .map(|(k, (((positions, directions), paths), (status, surface)))| {
            (k * TILE, Parts { positions, directions, paths, status, surface })
        });
    if count <= FEW {
        let mut tile = Tile::new();
        tiles.into_iter().try_for_each(|(first, parts)| tile_of((first, &mut tile, parts)))?;
    } else {
        let all: Vec<_> = tiles.collect();
        all.into_par_iter().try_for_each_init(Tile::new, |tile, (first, parts)| {
            isoplanat::stop::look();
            tile_of((first, tile, parts))
        })?;
    }
    Ok(landed)
}

/// The ray `number`, its direction of length one.
fn checked(origin: DVec3, direction: DVec3, number: usize) -> Result<Ray> {
    let refuse = |argument: &str, found: DVec3, allowed: &str| {
        let found = found.to_array().map(|v| v.to_string()).join(", ");
        Err(isoplanat::Error::bad("", format!("{argument}, ray {number}"), found, allowed))
    };
    if !origin.is_finite() {
        return refuse("origins", origin, "three finite numbers");
    }
    match direction.try_normalize() {
        Some(direction) => Ok(Ray { origin, direction }),
        None => refuse("directions", direction, "three finite numbers, not all 0, whose length is a number"),
    }
}

/// Where a tile's rays go.
struct Parts<'a> {
    positions: &'a mut [f64],
    directions: &'a mut [f64],
    paths: &'a mut [f64],
    status: &'a mut [u8],
    surface: &'a mut [i32],
}

impl Parts<'_> {
    fn put(&mut self, lane: usize, tile: &Tile) {
        let status: Status = tile.status[lane];
        if let Some(failure) = status {
            self.status[lane] = number(failure.cause);
            self.surface[lane] = i32::try_from(failure.surface).unwrap_or(i32::MAX);
            return;
        }
        let ray = tile.rays.ray(lane);
        self.positions[3 * lane..][..3].copy_from_slice(&ray.origin.to_array());
        self.directions[3 * lane..][..3].copy_from_slice(&ray.direction.to_array());
        self.paths[lane] = tile.rays.path[lane];
    }
}

/// The place of a cause in [`STATUS`].
fn number(cause: Cause) -> u8 {
    match cause {
        Cause::Missed => 1,
        Cause::Vignetted => 2,
        Cause::TotalReflection => 3,
        Cause::NotConverged => 4,
    }
}
