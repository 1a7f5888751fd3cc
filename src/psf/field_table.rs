//! Dense pupil maps over the field: traced at a few fields of the meridian, interpolated to all others.
//!
//! Landings and weights of one point of the stop are smooth in the field, so a frame's many nodes need few traces. The
//! table holds maps at increasing object slopes and interpolates by cubics through the nearest four. Fields are added by
//! halving until the map traced in the middle of an interval agrees with its interpolation; what the last such test saw,
//! over 8 (halving reduces a cubic's error 16-fold), is reported as the table's error.

use glam::DVec2;
use rayon::prelude::*;

use super::pupil::{PupilMap, PupilSampling};
use crate::lens::Lens;
use crate::trace::aim::ParaxialPupil;
use crate::trace::{Failure, FieldPoint, System};

/// Intervals at the start.
const FIRST: usize = 4;

/// Fields at most.
const MOST: usize = 65;

/// What the error of a table may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableTolerance {
    /// Root mean square error of the landings, mm, weighted by light.
    pub landing_mm: f64,
    /// Error of the weights: sum of the differences over the sum.
    pub weight: f64,
}

/// Landings and weights of the dense points at one field.
#[derive(Clone, Debug, Default)]
pub struct Landings {
    /// Across the meridian, mm.
    pub x: Vec<f64>,
    /// Along the meridian, mm.
    pub y: Vec<f64>,
    /// Étendue weights, mm².
    pub weight: Vec<f64>,
}

/// Maps over the field, one list a wavelength.
#[derive(Clone, Debug)]
pub struct FieldTable {
    /// Object slopes, increasing.
    pub slopes: Vec<f64>,
    /// Largest landing error seen, mm (root mean square over the light).
    pub landing_error_mm: f64,
    /// Largest weight error seen, relative.
    pub weight_error: f64,
    /// Smallest traced fraction of the stop's radius.
    pub kept: f64,
    /// Largest residual of the pupil polynomials, mm.
    pub residual_mm: f64,
    /// Surfaces whose clear aperture clips some beam.
    pub clipping: Vec<usize>,
    /// Rays aimed.
    pub rays: usize,
    maps: Vec<Vec<Landings>>,
}

/// One traced field: its maps by wavelength.
struct Traced {
    slope: f64,
    landings: Vec<Landings>,
    kept: f64,
    residual: f64,
    clipping: Vec<usize>,
}

impl FieldTable {
    /// Traces `lens` for objects at `vergence` over the slopes `range` at each of `wavelength_nm`.
    ///
    /// # Errors
    /// A field none of whose rays reaches the sensor.
    pub fn compute(
        lens: &Lens,
        vergence: f64,
        sampling: &PupilSampling,
        wavelength_nm: &[f64],
        range: [f64; 2],
        tolerance: TableTolerance,
    ) -> Result<Self, Failure> {
        let pupil = ParaxialPupil::new(lens);
        let systems: Vec<System> = wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let trace = |slopes: &[f64]| -> Result<Vec<Traced>, Failure> {
            slopes.par_iter().map(|s| traced(&systems, pupil, sampling, *s, vergence)).collect()
        };
        let [from, to] = range;
        let at = |i: usize, n: usize| from + (to - from) * ratio(i, n);
        let first: Vec<f64> = if to > from { (0..=FIRST).map(|i| at(i, FIRST)).collect() } else { vec![from] };
        let mut table = Self {
            slopes: Vec::new(),
            landing_error_mm: 0.0,
            weight_error: 0.0,
            kept: 1.0,
            residual_mm: 0.0,
            clipping: Vec::new(),
            rays: 0,
            maps: Vec::new(),
        };
        let rays = sampling.traced_rays() * systems.len();
        trace(&first)?.into_iter().for_each(|t| table.insert(t, rays));
        let mut open: Vec<[f64; 2]> = first.windows(2).map(|w| [w[0], w[1]]).collect();
        while !open.is_empty() {
            let middles: Vec<f64> = open.iter().map(|[a, b]| 0.5 * (a + b)).collect();
            let new = trace(&middles)?;
            let full = table.slopes.len() + new.len() >= MOST;
            let mut next = Vec::new();
            let mut seen = [0.0f64; 2];
            for (traced, [a, b]) in new.iter().zip(&open) {
                let [landing, weight] = table.difference(traced).map(|e| e / 8.0);
                if (landing <= tolerance.landing_mm && weight <= tolerance.weight) || full {
                    seen = [seen[0].max(landing), seen[1].max(weight)];
                } else {
                    next.extend([[*a, traced.slope], [traced.slope, *b]]);
                }
            }
            table.landing_error_mm = table.landing_error_mm.max(seen[0]);
            table.weight_error = table.weight_error.max(seen[1]);
            new.into_iter().for_each(|t| table.insert(t, rays));
            open = next;
        }
        Ok(table)
    }

    fn insert(&mut self, traced: Traced, rays: usize) {
        let at = self.slopes.partition_point(|s| *s < traced.slope);
        self.slopes.insert(at, traced.slope);
        self.maps.insert(at, traced.landings);
        self.kept = self.kept.min(traced.kept);
        self.residual_mm = self.residual_mm.max(traced.residual);
        self.clipping.extend(traced.clipping);
        self.clipping.sort_unstable();
        self.clipping.dedup();
        self.rays += rays;
    }

    /// Landing error (mm, root mean square over the light) and relative weight error of the interpolation at a traced
    /// field: the largest over the wavelengths.
    fn difference(&self, traced: &Traced) -> [f64; 2] {
        let mut worst = [0.0f64; 2];
        let mut here = Landings::default();
        for (l, truth) in traced.landings.iter().enumerate() {
            self.interpolate(traced.slope, l, &mut here);
            let (mut square, mut total, mut off) = (0.0, 0.0, 0.0);
            for q in 0..truth.x.len() {
                let (dx, dy) = (here.x[q] - truth.x[q], here.y[q] - truth.y[q]);
                square += truth.weight[q] * (dx * dx + dy * dy);
                total += truth.weight[q];
                off += (here.weight[q] - truth.weight[q]).abs();
            }
            if total > 0.0 {
                worst = [worst[0].max((square / total).sqrt()), worst[1].max(off / total)];
            } else if off > 0.0 {
                worst[1] = f64::INFINITY;
            }
        }
        worst
    }

    /// Landings and weights at `slope` (held at the ends of the table) of wavelength `l`.
    pub fn interpolate(&self, slope: f64, l: usize, out: &mut Landings) {
        let n = self.slopes.len();
        let taps = n.min(4);
        let slope = slope.clamp(self.slopes[0], self.slopes[n - 1]);
        let after = self.slopes.partition_point(|s| *s <= slope);
        let first = after.saturating_sub(taps / 2).min(n - taps);
        let nodes = &self.slopes[first..first + taps];
        let weights: Vec<f64> = (0..taps)
            .map(|i| {
                let others = (0..taps).filter(|j| *j != i);
                others.map(|j| (slope - nodes[j]) / (nodes[i] - nodes[j])).product()
            })
            .collect();
        let mix = |out: &mut Vec<f64>, part: &dyn Fn(&Landings) -> &[f64]| {
            out.clear();
            out.extend(part(&self.maps[first][l]).iter().map(|v| weights[0] * v));
            for (k, w) in weights.iter().enumerate().skip(1) {
                out.iter_mut().zip(part(&self.maps[first + k][l])).for_each(|(a, v)| *a += w * v);
            }
        };
        mix(&mut out.x, &|m| &m.x);
        mix(&mut out.y, &|m| &m.y);
        mix(&mut out.weight, &|m| &m.weight);
        out.weight.iter_mut().for_each(|w| *w = w.max(0.0));
    }

    /// The traced fields: slope and maps by wavelength.
    pub fn fields(&self) -> impl Iterator<Item = (f64, &[Landings])> {
        self.slopes.iter().copied().zip(self.maps.iter().map(Vec::as_slice))
    }
}

fn traced(
    systems: &[System],
    pupil: ParaxialPupil,
    sampling: &PupilSampling,
    slope: f64,
    vergence: f64,
) -> Result<Traced, Failure> {
    let field = FieldPoint { slope: DVec2::new(0.0, slope), vergence };
    let mut out = Traced { slope, landings: Vec::new(), kept: 1.0, residual: 0.0, clipping: Vec::new() };
    for system in systems {
        let map = PupilMap::compute(system, pupil, sampling, field)?;
        out.kept = out.kept.min(map.kept);
        out.residual = out.residual.max(map.residual);
        out.clipping.extend(map.clipping());
        out.landings.push(Landings { x: map.x, y: map.y, weight: map.weight });
    }
    Ok(out)
}

#[expect(clippy::cast_precision_loss, reason = "small counts")]
fn ratio(i: usize, n: usize) -> f64 {
    i as f64 / n as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;

    /// Maps between the table's fields against traced ones, within twice what the table says of itself.
    #[test]
    fn interpolated_maps_are_as_near_as_the_table_says() {
        for (name, to) in [("two_element", 0.5), ("cooke_triplet", 0.36), ("phone", 0.6)] {
            let lens = builtin::lens(name).expect("shipped");
            let sampling = PupilSampling::new(9, 400);
            let tolerance = TableTolerance { landing_mm: 1e-4, weight: 2e-3 };
            let nm = [450.0, 600.0];
            let v = lens.object_vergence;
            let table = FieldTable::compute(&lens, v, &sampling, &nm, [0.0, to], tolerance).expect("traces");
            assert!(table.slopes.len() < MOST, "{name}: {} fields", table.slopes.len());
            let systems: Vec<System> = nm.iter().map(|nm| System::new(&lens, *nm)).collect();
            let mut worst = [0.0f64; 2];
            for i in 0..40 {
                let slope = to * (f64::from(i) + 0.37) / 40.0;
                let truth = traced(&systems, ParaxialPupil::new(&lens), &sampling, slope, v).expect("traces");
                let d = table.difference(&truth);
                worst = [worst[0].max(d[0]), worst[1].max(d[1])];
            }
            eprintln!(
                "{name}: {} fields, says {:.1e} mm, {:.1e}; found {:.1e} mm, {:.1e}",
                table.slopes.len(),
                table.landing_error_mm,
                table.weight_error,
                worst[0],
                worst[1]
            );
            assert!(worst[0] < 2.0 * tolerance.landing_mm && worst[1] < 2.0 * tolerance.weight, "{name}: {worst:?}");
        }
    }

    #[test]
    fn a_single_field_is_itself() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let sampling = PupilSampling::new(7, 60);
        let tolerance = TableTolerance { landing_mm: 1e-4, weight: 1e-3 };
        let table = FieldTable::compute(&lens, 0.0, &sampling, &[550.0], [0.1, 0.1], tolerance).expect("traces");
        assert_eq!(table.slopes, [0.1]);
        let mut out = Landings::default();
        table.interpolate(0.3, 0, &mut out);
        assert_eq!(out.x.len(), sampling.points.len());
    }
}
