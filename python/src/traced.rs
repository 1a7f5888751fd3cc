//! The renderer of the numbers that a layer was asked for last: a network that is trained behind a lens at rest has it traced once.

use std::sync::{Arc, Mutex, PoisonError};

use isoplanat::{Lens, Renderer, Result};

/// A lens by its numbers, and its renderer.
struct Of {
    values: Vec<f64>,
    lens: Lens,
    renderer: Arc<Renderer>,
}

/// The lens and the renderer of one set of numbers; nothing at first.
#[derive(Default)]
pub(crate) struct Traced(Mutex<Option<Of>>);

impl Traced {
    /// Of `renderer`, which was traced of `lens`, that has the numbers `values`.
    pub(crate) fn of(values: Vec<f64>, lens: Lens, renderer: Renderer) -> Self {
        Self(Mutex::new(Some(Of { values, lens, renderer: Arc::new(renderer) })))
    }

    /// Lens and renderer of the numbers `values`: those at hand where they are the same to the bit, else what `make` gives, which is kept in their place.
    ///
    /// # Errors
    /// Those of `make`.
    pub(crate) fn at(
        &self,
        values: &[f64],
        make: impl FnOnce() -> Result<(Lens, Renderer)>,
    ) -> Result<(Lens, Arc<Renderer>)> {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |of: &&Of| of.values.iter().map(|v| v.to_bits()).eq(values.iter().map(|v| v.to_bits()));
        if let Some(of) = kept().as_ref().filter(same) {
            return Ok((of.lens.clone(), Arc::clone(&of.renderer)));
        }
        // Other threads may ask meanwhile: nothing is held while rays are traced.
        let (lens, renderer) = make()?;
        let renderer = Arc::new(renderer);
        *kept() = Some(Of { values: values.to_vec(), lens: lens.clone(), renderer: Arc::clone(&renderer) });
        Ok((lens, renderer))
    }
}

/// A plan that is changed has traced nothing yet.
impl Clone for Traced {
    fn clone(&self) -> Self {
        Self::default()
    }
}
