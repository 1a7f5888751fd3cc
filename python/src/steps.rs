//! `Steps`: how a layer's lens moves by the gradient of a user's own loss, measured by what a step does to rays, within constraints.

use std::sync::{Mutex, PoisonError};

use isoplanat::optimize::descent::{Descent, Memory};
use isoplanat::optimize::spec::Spec;
use isoplanat::optimize::{Constraint, Problem, Quantity};
use isoplanat::psf::corner::{Corner, distortion_held};
use isoplanat::{Error, LensGradient, Result};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::Several;
use crate::errors::refused;
use crate::layer::{Layer, Planned};
use crate::work::work;

/// What errors call the arguments of one call.
const CALL: &str = "LensSteps";
/// Longest step, mm.
const MOST_MM: f64 = 10.0;
/// What can be held by name alone.
const HELD: [&str; 5] = ["focal_length", "track", "distortion", "back_focus", "f_number"];

/// Steps of a layer's numbers and what they remember.
#[pyclass(frozen, module = "isoplanat._isoplanat")]
pub(crate) struct Steps {
    state: Mutex<State>,
}

struct State {
    descent: Descent,
    memory: Memory,
    /// Of the plan whose field the rays are over.
    generation: u64,
}

/// The lens over the field that its frame sees, and the distortion at the corner of that.
fn seen(planned: &Planned, lens: &isoplanat::Lens) -> Result<(isoplanat::Lens, f64)> {
    let corner = Corner::new(&planned.maps[0], planned.frame.inner.max_radius_mm());
    if corner.angle_deg.is_nan() || corner.angle_deg >= 90.0 {
        return Err(Error::bad("", "frame", corner.angle_deg.to_string(), "a frame that the lens's field reaches"));
    }
    let lens = lens.changed(|l| l.field = corner.field())?;
    Ok((lens, corner.distortion))
}

fn problem(
    planned: &Planned,
    lens: &isoplanat::Lens,
    mut spec: Spec,
    hold: &[String],
    frozen: &[String],
) -> Result<Problem> {
    let (lens, distortion) = seen(planned, lens)?;
    if let Some(other) = hold.iter().find(|h| !HELD.contains(&h.as_str())) {
        let allowed = format!("any of {}; others by constraints, with their bounds", HELD.join(", "));
        return Err(Error::bad("", "hold", format!("`{other}`"), allowed));
    }
    let stated = |name: &str| spec.constraints.contains_key(name);
    let held = |name: &str| hold.iter().any(|h| h == name) && !stated(name);
    let free_focus = !held("focal_length") && !stated("focal_length");
    let [track, back_focus, f_number, distorted] = ["track", "back_focus", "f_number", "distortion"].map(held);
    spec.depths_mm = Some(planned.plan.depths.iter().map(|d| d.vergence.recip()).collect());
    let mut moving = planned.variables.parameters.clone();
    moving.retain(|p| !frozen.contains(&p.name(&lens)));
    if moving.is_empty() {
        return Err(Error::bad("", "layer", "no number that asks for a gradient", "one or more"));
    }
    let mut problem = spec.problem_varying(&lens, moving, CALL)?;
    if free_focus {
        problem.constraints.retain(|c| c.quantity != Quantity::FocalLength);
    }
    let first = isoplanat::first_order(&lens, lens.wavelengths.primary_nm);
    let last = lens.surfaces.last().map_or(0.0, |s| s.thickness);
    let mut keep = |asked: bool, quantity: Quantity, bounds: [f64; 2]| {
        if asked {
            problem.constraints.retain(|c| c.quantity != quantity);
            problem.constraints.push(Constraint { quantity, bounds });
        }
    };
    keep(track, Quantity::Track, [f64::NEG_INFINITY, lens.length()]);
    keep(back_focus, Quantity::BackFocus, [last; 2]);
    keep(f_number, Quantity::FNumber, [first.f_number; 2]);
    let outermost = problem.merit.fields.len() - 1;
    if distorted {
        problem.constraints.extend(distortion_held(distortion, outermost));
    }
    Ok(problem.following_beam())
}

#[pymethods]
impl Steps {
    #[new]
    fn new(
        py: Python<'_>,
        layer: &Bound<'_, Layer>,
        values: PyReadonlyArray1<'_, f64>,
        hold: Several<String>,
        constraints: Option<&Bound<'_, PyDict>>,
        bounds: Option<&Bound<'_, PyDict>>,
        frozen: Vec<String>,
    ) -> PyResult<Self> {
        let spec = crate::optimized::spec((Vec::new(), Vec::new()), (bounds, constraints, None), None, None)?;
        let (planned, values) = (layer.get().planned(), values.as_array().to_vec());
        let generation = planned.generation;
        let descent = work(py, || {
            let lens = planned.with(&values)?;
            Descent::new(&problem(&planned, &lens, spec, &hold.0, &frozen)?)
        })?;
        Ok(Self { state: Mutex::new(State { descent, memory: Memory::default(), generation }) })
    }

    /// One step of `values` against `gradient`: the layer and the numbers behind it, how far rays moved (mm, rms), agreement of the gradients (0 to 1), the largest
    /// violation of a constraint before it, and what held it back. None where no lens was found.
    #[expect(clippy::type_complexity, reason = "a row of facts")]
    fn step<'py>(
        &self,
        py: Python<'py>,
        layer: &Bound<'_, Layer>,
        values: PyReadonlyArray1<'_, f64>,
        gradient: PyReadonlyArray1<'_, f64>,
        rate_mm: f64,
    ) -> PyResult<Option<(Layer, Bound<'py, PyArray1<f64>>, f64, f64, f64, Vec<String>)>> {
        if !(rate_mm > 0.0 && rate_mm <= MOST_MM) {
            return Err(refused("lr", rate_mm, "0 to 10 (mm)"));
        }
        let planned = layer.get().planned();
        let (values, gradient) = (values.as_array().to_vec(), gradient.as_array().to_vec());
        let found = work(py, || {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let lens = planned.with(&values)?;
            if state.generation != planned.generation {
                let (lens, _) = seen(&planned, &planned.at)?;
                // A lens through which its rays do not pass is looked at as before.
                let again = Problem { lens, ..state.descent.problem().clone() };
                if let Ok(descent) = Descent::new(&again) {
                    state.descent = descent;
                }
                state.generation = planned.generation;
            }
            let field = state.descent.problem().lens.field;
            let lens = lens.changed(|l| l.field = field)?;
            let mut slopes = LensGradient::zeros(&lens);
            for (p, g) in planned.variables.parameters.iter().zip(&gradient) {
                if let Some(slope) = p.value_mut(&mut slopes) {
                    *slope = *g;
                }
            }
            let State { descent, memory, .. } = &mut *state;
            let Some(moved) = descent.step(memory, &lens, &slopes, rate_mm, &[]) else { return Ok(None) };
            if isoplanat::trace::rims::require_clear(&moved.lens, &moved.lens.name).is_err() {
                return Ok(None);
            }
            Ok(Some((planned.based(&moved.lens)?, planned.variables.values(&moved.lens), moved)))
        })?;
        Ok(found.map(|(planned, values, moved)| {
            let values = PyArray1::from_vec(py, values);
            (Layer::from(planned), values, moved.length_mm, moved.signal, moved.violation, moved.active)
        }))
    }

    /// The largest violation of a constraint, relative to its bound or to 1; None where rays do not arrive.
    fn violation(
        &self,
        py: Python<'_>,
        layer: &Bound<'_, Layer>,
        values: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Option<f64>> {
        let (planned, values) = (layer.get().planned(), values.as_array().to_vec());
        work(py, || {
            let lens = planned.with(&values)?;
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(state.descent.violation(&lens))
        })
    }

    /// What is held: name, lowest, highest.
    #[getter]
    fn held(&self) -> Vec<(String, f64, f64)> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let constraints = &state.descent.problem().constraints;
        constraints.iter().map(|c| (c.quantity.name(), c.bounds[0], c.bounds[1])).collect()
    }

    /// What is remembered: mean gradient, mean of its square, steps, part of the rate that steps take.
    #[getter]
    fn memory(&self) -> (Vec<f64>, f64, u64, f64) {
        let memory = self.state.lock().unwrap_or_else(PoisonError::into_inner).memory.clone();
        (memory.first, memory.second, memory.steps, memory.reach)
    }

    /// Goes on with what other steps remembered.
    fn remember(&self, first: Vec<f64>, second: f64, steps: u64, reach: f64) -> PyResult<()> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = state.descent.problem().variables.parameters.len();
        if !first.is_empty() && first.len() != wanted {
            return Err(refused("memory", format!("of {} numbers", first.len()), format!("of {wanted}")));
        }
        state.memory = Memory { first, second, steps, reach };
        Ok(())
    }
}
