//! `Lens.trace` and what it gives.

use isoplanat::glam::DVec3;
use isoplanat::trace::Cause;
use isoplanat::trace::lanes::{Options, Program, Status, TILE, Tile};
use isoplanat::{Lens, Ray, Result, System};
use ndarray::{ArrayD, ArrayViewD, IxDyn};
use pyo3::prelude::*;

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

pub(crate) fn trace(
    py: Python<'_>,
    lens: &Lens,
    (origins, directions): (&Bound<'_, PyAny>, &Bound<'_, PyAny>),
    wavelength_nm: Option<f64>,
    clip: bool,
) -> PyResult<Rays> {
    let nm = wavelength_nm.unwrap_or(lens.wavelengths.primary_nm);
    if !(200.0..=20_000.0).contains(&nm) {
        return Err(refused("wavelength_nm", nm, "200 to 20000 nm"));
    }
    lens.require_indices(nm, lens.file()).map_err(raised)?;
    let from = Floats::of(origins, "origins", Whole::Taken)?;
    let towards = Floats::of(directions, "directions", Whole::Taken)?;
    let shape = from.shape().to_vec();
    let Some((3, leading)) = shape.split_last().map(|(last, leading)| (*last, leading)) else {
        return Err(wrong_shape("origins", &shape, "(..., 3): x, y, z in mm"));
    };
    let one = towards.shape() == [3];
    if !one && towards.shape() != shape {
        let allowed = format!("that of origins, {}, or (3,)", written(&shape));
        return Err(wrong_shape("directions", towards.shape(), &allowed));
    }
    let count = leading.iter().product();
    let (from, towards) = (from.cast::<f64>(), towards.cast::<f64>());
    let (from, towards) = (from.view(), towards.view());
    let system = System::new(lens, nm);
    let program = Program::new(&system, Options { clip, path: true, level: None });
    let job = || traced(&program, (flat(&from), flat(&towards)), count);
    let landed = if count <= FEW { here(job)? } else { work(py, job)? };
    let [whole, each] = [&shape[..], leading];
    let array = |values: Vec<f64>, shape: &[usize]| {
        given(py, ArrayD::from_shape_vec(IxDyn(shape), values).expect("as many as the shape says"))
    };
    Ok(Rays {
        positions: array(landed.positions, whole),
        directions: array(landed.directions, whole),
        paths: array(landed.paths, each),
        status: given(py, ArrayD::from_shape_vec(IxDyn(each), landed.status).expect("one a ray")),
        surface: given(py, ArrayD::from_shape_vec(IxDyn(each), landed.surface).expect("one a ray")),
    })
}

/// The numbers of an array in row-major order.
fn flat<'a>(array: &'a ArrayViewD<'_, f64>) -> &'a [f64] {
    array.as_slice().expect("in row-major order")
}

fn traced(program: &Program, (from, towards): (&[f64], &[f64]), count: usize) -> Result<Landed> {
    use rayon::prelude::*;

    let one = towards.len() == 3 && count != 1;
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
            let ray = first + lane;
            let [origin, direction] = [(from, ray), (towards, if one { 0 } else { ray })]
                .map(|(all, k)| DVec3::new(all[3 * k], all[3 * k + 1], all[3 * k + 2]));
            tile.rays.set(lane, checked(origin, direction, ray)?);
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
