//! Rays of one lens by sensor radius, traced when they are asked for and kept: tables of ever more knots share what they have in common.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::beam::{self, Bases, Beam, Chief};
use super::{TableSpec, failed, views};
use crate::error::Result;
use crate::lens::Lens;
use crate::trace::aim::SensorView;
use crate::trace::{Failure, System};

/// The beams of all wavelengths at one sensor radius, and the reference wavelength's chief ray.
type Seen = std::result::Result<(Arc<Vec<Beam>>, Chief), Failure>;

/// A lens whose sensor points are looked at one by one.
pub(super) struct Tracing<'a> {
    pub(super) lens: &'a Lens,
    pub(super) views: Vec<SensorView>,
    pub(super) bases: Bases,
    /// Part of the stop's radius that the unit disk stands for.
    pub(super) pupil: f64,
    wavelength_nm: Vec<f64>,
    degree: usize,
    reference: SensorView,
    /// By the bits of the radius.
    seen: HashMap<u64, Seen>,
}

impl<'a> Tracing<'a> {
    /// Nothing but the axis is traced yet.
    ///
    /// # Errors
    /// As [`super::Table::compute`].
    pub(super) fn new(lens: &'a Lens, wavelength_nm: &[f64], degree: usize) -> Result<Self> {
        lens.require_symmetry("a table of sensor radii")?;
        wavelength_nm.iter().try_for_each(|nm| lens.require_indices(*nm, &lens.name))?;
        let views = views(lens, wavelength_nm);
        let reference = SensorView::new(&System::new(lens, lens.wavelengths.primary_nm));
        let bases = Bases::new(degree);
        let pupil = beam::pupil(&views, &bases).map_err(|f| failed(lens, 0.0, f))?;
        let wavelength_nm = wavelength_nm.to_vec();
        Ok(Self { lens, views, bases, pupil, wavelength_nm, degree, reference, seen: HashMap::new() })
    }

    pub(super) fn spec(&self, radii_mm: &[f64]) -> TableSpec {
        TableSpec { radii_mm: radii_mm.to_vec(), wavelength_nm: self.wavelength_nm.clone(), degree: self.degree }
    }

    /// Object slope of the chief ray of a sensor radius, for an object at `vergence`; `None` where there is none.
    pub(super) fn chief_slope(&self, radius_mm: f64, vergence: f64) -> Option<f64> {
        Chief::trace(&self.reference, radius_mm).ok().map(|c| c.slope - vergence * c.entrance)
    }

    /// Whether light of every wavelength gets through to a sensor radius.
    pub(super) fn is_lit(&mut self, radius_mm: f64) -> bool {
        self.trace(&[radius_mm]);
        self.seen(radius_mm).is_ok()
    }

    /// Traces what has not been traced yet.
    pub(super) fn trace(&mut self, radii_mm: &[f64]) {
        let missing: Vec<f64> = radii_mm.iter().copied().filter(|r| !self.seen.contains_key(&r.to_bits())).collect();
        let found: Vec<Seen> = missing.par_iter().map(|r| self.look(*r)).collect();
        self.seen.extend(missing.iter().map(|r| r.to_bits()).zip(found));
    }

    /// What was traced at one of the radii asked for.
    pub(super) fn seen(&self, radius_mm: f64) -> &Seen {
        &self.seen[&radius_mm.to_bits()]
    }

    fn look(&self, radius_mm: f64) -> Seen {
        // One ray tells of most sensor points without light.
        let chief = Chief::trace(&self.reference, radius_mm)?;
        let mut beams: Vec<Beam> = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let beam = Beam::trace(view, &self.bases, radius_mm, self.pupil, beams.last())?;
            beams.push(beam);
        }
        Ok((Arc::new(beams), chief))
    }
}
