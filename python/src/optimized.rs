//! `Lens.optimize` and what it gives.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use isoplanat::optimize::spec::{Range, Spec, Wanted};
use isoplanat::optimize::{Constraint, Limits, Outcome, Valued, optimize as solve};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{raised, refused};
use crate::lens::Lens;
use crate::work::work;

/// What errors call the arguments of one call.
const CALL: &str = "optimize";

/// A lens made better.
///
/// Attributes
/// ----------
/// lens : Lens
/// rms_um : (float, float)
///     Root mean square of the rays, before and after, µm (spot radius; path difference with quality="wavefront").
/// reason : str
///     Why the work ended.
/// iterations : int
/// violation : float
///     Largest violation of a constraint, relative to its bound.
/// moved : dict
///     (before, after) by name.
/// held : dict
///     (value, lowest, highest) of what was held or bounded, by name; broken ones are in `broken`.
/// broken : list of str
#[pyclass(frozen, get_all, module = "isoplanat")]
pub(crate) struct Optimized {
    lens: Lens,
    rms_um: (f64, f64),
    reason: String,
    iterations: usize,
    violation: f64,
    moved: Py<PyDict>,
    held: Py<PyDict>,
    broken: Vec<String>,
}

#[pymethods]
impl Optimized {
    fn __repr__(&self) -> String {
        let (before, after) = self.rms_um;
        format!(
            "<Optimized: rms {before:.4} µm before, {after:.4} µm after {} steps; {}>",
            self.iterations, self.reason
        )
    }
}

type Numbers<'a, 'py> = Option<&'a Bound<'py, PyDict>>;

/// What moves, is held and wanted.
pub(crate) fn spec(
    (vary, fix): (Vec<String>, Vec<String>),
    (bounds, constraints, targets): (Numbers<'_, '_>, Numbers<'_, '_>, Numbers<'_, '_>),
    quality: Option<String>,
    depths_mm: Option<Vec<f64>>,
) -> PyResult<Spec> {
    let mut wanted = BTreeMap::new();
    for (name, value) in targets.into_iter().flatten() {
        let name: String = name.extract()?;
        let (value, weight) = value.extract::<(f64, f64)>().map_err(|_| {
            PyTypeError::new_err(format!("targets: {name}: {value}; a pair (value, weight in mm of rms a unit)"))
        })?;
        wanted.insert(name, Wanted { value, weight });
    }
    let (bounds, constraints) = (ranges("bounds", bounds)?, ranges("constraints", constraints)?);
    Ok(Spec { vary, fix, bounds, constraints, targets: wanted, quality, depths_mm, ..Spec::default() })
}

fn ranges(argument: &str, given: Numbers<'_, '_>) -> PyResult<BTreeMap<String, Range>> {
    let mut all = BTreeMap::new();
    for (name, value) in given.into_iter().flatten() {
        let name: String = name.extract()?;
        let range = if let Ok(number) = value.extract::<f64>() {
            Range::One(number)
        } else if let Ok((low, high)) = value.extract::<(Option<f64>, Option<f64>)>() {
            Range::Two([low.unwrap_or(f64::NEG_INFINITY), high.unwrap_or(f64::INFINITY)])
        } else if let Ok(text) = value.extract::<String>() {
            Range::parse(&text, argument).map_err(raised)?
        } else {
            let allowed = "a number, a pair (low, high) with None for an open end, or text such as \"..60\"";
            return Err(PyTypeError::new_err(format!("{argument}: {name}: {value}; {allowed}")));
        };
        all.insert(name, range);
    }
    Ok(all)
}

pub(crate) fn optimize(
    py: Python<'_>,
    lens: &isoplanat::Lens,
    spec: &Spec,
    iterations: usize,
    minutes: Option<f64>,
) -> PyResult<Optimized> {
    if iterations == 0 {
        return Err(refused("iterations", iterations, "at least 1"));
    }
    if let Some(minutes) = minutes.filter(|m| m.is_nan() || *m <= 0.0) {
        return Err(refused("minutes", minutes, "a positive number"));
    }
    let until = minutes.and_then(|m| Instant::now().checked_add(Duration::try_from_secs_f64(60.0 * m).ok()?));
    let found: Outcome = work(py, || {
        let problem = spec.problem(lens, CALL)?;
        let limits = Limits { iterations, until, ..Limits::default() };
        // A step looks whether somebody asked for an end.
        let outcome = solve(&problem, limits, &mut |_| {
            isoplanat::stop::look();
            true
        })?;
        outcome.require(CALL)?;
        Ok(outcome)
    })?;
    let (moved, held) = (PyDict::new(py), PyDict::new(py));
    for m in &found.moved {
        moved.set_item(&m.name, (m.before, m.after))?;
    }
    for Valued { of, value } in &found.held {
        let [low, high] = of.bounds;
        held.set_item(of.quantity.name(), (*value, low, high))?;
    }
    let said = |Valued { of, value }: &Valued<Constraint>| {
        let (quantity, [low, high]) = (of.quantity, of.bounds);
        format!("{} is {value} {}; {low} to {high}", quantity.name(), quantity.unit())
    };
    Ok(Optimized {
        rms_um: (1e3 * found.rms_mm[0], 1e3 * found.rms_mm[1]),
        reason: found.stop.reason().to_owned(),
        iterations: found.iterations,
        violation: found.violation,
        moved: moved.unbind(),
        held: held.unbind(),
        broken: found.broken().map(said).collect(),
        lens: found.lens.into(),
    })
}
