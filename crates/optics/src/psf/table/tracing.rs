//! Rays of one lens by sensor radius and wavelength, traced when they are asked for and kept: tables of ever more knots, and of more wavelengths,
//! share what they have in common.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::beam::{self, Bases, Beam, Chief};
use super::{TableSpec, failed, views};
use crate::lens::Lens;
use crate::trace::aim::SensorView;
use crate::trace::{Failure, System};
use isoplanat_base::error::Result;
use isoplanat_base::stop;

/// What was traced at one sensor radius.
struct Looked {
    /// The reference wavelength's chief ray.
    chief: std::result::Result<Chief, Failure>,
    /// By wavelength; nothing where none was asked for, or another one failed before.
    beams: Vec<Option<std::result::Result<Arc<Beam>, Failure>>>,
}

/// Beams of the wavelengths asked for, and the chief ray.
type Seen = std::result::Result<(Vec<Arc<Beam>>, Chief), Failure>;

/// A lens whose sensor points are looked at one by one.
pub(super) struct Tracing<'a> {
    pub(super) lens: &'a Lens,
    pub(super) views: Vec<SensorView>,
    pub(super) bases: Bases,
    /// Part of the stop's radius that the unit disk stands for.
    pub(super) pupil: f64,
    wavelength_nm: Vec<f64>,
    degree: usize,
    lit: bool,
    reference: SensorView,
    /// By the bits of the radius.
    looked: HashMap<u64, Looked>,
}

impl<'a> Tracing<'a> {
    /// Nothing but the axis is traced yet.
    ///
    /// # Errors
    /// As [`super::Table::compute`].
    pub(super) fn new(lens: &'a Lens, wavelength_nm: &[f64], (degree, lit): (usize, bool)) -> Result<Self> {
        lens.require_symmetry("a table of sensor radii")?;
        wavelength_nm.iter().try_for_each(|nm| lens.require_indices(*nm, lens.file()))?;
        let views = views(lens, wavelength_nm);
        let reference = SensorView::new(&System::new(lens, lens.wavelengths.primary_nm));
        let bases = Bases::new(degree, lit);
        let pupil = beam::pupil(&views, &bases).map_err(|f| failed(lens, 0.0, f))?;
        let wavelength_nm = wavelength_nm.to_vec();
        Ok(Self { lens, views, bases, pupil, wavelength_nm, degree, lit, reference, looked: HashMap::new() })
    }

    /// Every wavelength's number.
    pub(super) fn colours(&self) -> Vec<usize> {
        (0..self.wavelength_nm.len()).collect()
    }

    pub(super) fn spec(&self, radii_mm: &[f64], colours: &[usize]) -> TableSpec {
        let wavelength_nm = colours.iter().map(|l| self.wavelength_nm[*l]).collect();
        TableSpec { radii_mm: radii_mm.to_vec(), wavelength_nm, degree: self.degree, lit: self.lit }
    }

    /// Object slope of the chief ray of a sensor radius, for an object at `vergence`; `None` where there is none.
    pub(super) fn chief_slope(&self, radius_mm: f64, vergence: f64) -> Option<f64> {
        Chief::trace(&self.reference, radius_mm).ok().map(|c| c.slope - vergence * c.entrance)
    }

    /// Whether light of some wavelengths gets through to a sensor radius.
    pub(super) fn is_lit(&mut self, radius_mm: f64, colours: &[usize]) -> bool {
        self.trace(&[radius_mm], colours);
        self.seen(radius_mm, colours).is_ok()
    }

    /// Traces what has not been traced yet.
    pub(super) fn trace(&mut self, radii_mm: &[f64], colours: &[usize]) {
        let asked = radii_mm.iter().map(|r| (*r, self.looked.remove(&r.to_bits()))).collect::<Vec<_>>();
        let looked: Vec<(u64, Looked)> =
            asked.into_par_iter().map(|(r, before)| (r.to_bits(), self.look(r, colours, before))).collect();
        self.looked.extend(looked);
    }

    /// What was traced at a radius and for wavelengths that were asked for.
    ///
    /// # Errors
    /// The first ray, of these wavelengths, that does not get through.
    pub(super) fn seen(&self, radius_mm: f64, colours: &[usize]) -> Seen {
        let Looked { chief, beams } = &self.looked[&radius_mm.to_bits()];
        let chief = chief.as_ref().map_err(|f| *f)?;
        let asked = colours.iter().filter_map(|l| beams[*l].clone());
        Ok((asked.collect::<std::result::Result<_, _>>()?, chief.clone()))
    }

    fn look(&self, radius_mm: f64, colours: &[usize], before: Option<Looked>) -> Looked {
        let none = || Looked { chief: Chief::trace(&self.reference, radius_mm), beams: vec![None; self.views.len()] };
        let mut looked = before.unwrap_or_else(none);
        // One ray tells of most sensor points without light.
        if looked.chief.is_err() {
            return looked;
        }
        debug_assert_eq!(colours.first(), Some(&0), "the first wavelength is among them, and first");
        for l in colours {
            stop::look();
            let found = looked.beams[*l].take().unwrap_or_else(|| {
                // Always the first wavelength's, whatever else was traced before: tables of the same rays are equal to the bit.
                let near = looked.beams[0].as_ref().and_then(|b| b.as_ref().ok()).filter(|_| *l > 0);
                Beam::trace(&self.views[*l], &self.bases, radius_mm, self.pupil, near.map(|b| &**b)).map(Arc::new)
            });
            let failed = found.is_err();
            looked.beams[*l] = Some(found);
            if failed {
                break;
            }
        }
        looked
    }
}
