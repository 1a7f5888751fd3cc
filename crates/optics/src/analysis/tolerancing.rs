//! A lens as it will be built: what each tolerance of a file costs in rms spot, and draws of whole lenses within all of them.
//!
//! Deviations are those of the file of `isoplanat sheets --tolerances` ([`super::fabrication::tolerances`]): radii, thicknesses, indices and Abbe numbers,
//! tilts of surfaces, air spaces, shifts and tilts of elements. Scalars are drawn evenly between their bounds, shifts and tilts evenly over the disk. The
//! sensor is moved to the least rms of each lens (it alone compensates). Spots count from their centroids, over all sides of the field and the whole stop,
//! whose size is that of the nominal lens: boresight and distortion are no blur. Light that stated clear apertures stop does not count, looked at anew for each
//! lens that is traced; the Jacobian keeps the nominal lens's.
//!
//! Every draw is judged twice: by rays through the lens of its numbers, refocused, and by the nominal lens's Jacobian
//! ([`crate::optimize::sensitivity`]), which costs next to nothing; their difference is told. Not drawn: irregularity and form, homogeneity, the mount.

use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use super::deviations::{Deviation, deviations, drawn, off_by, parameters};
use super::fabrication::Fabrication;
use super::fabrication::tolerances::Tolerances;
use super::scatter::Scatter;
use crate::lens::{Kind, Lens, Parameter};
use crate::optimize::sensitivity::Sensitivity;
use crate::optimize::{Merit, light_of, refocused};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::at_share;

/// What one tolerance costs by itself.
#[derive(Clone, Debug, Serialize)]
pub struct Alone {
    /// Which.
    pub deviation: Deviation,
    /// Rms at the upper and at the lower bound, refocused, mm; none where it is no lens, a ray does not arrive or half of a field point's light is lost.
    pub rms_mm: [Option<f64>; 2],
    /// By the Jacobian, the larger of the two, mm.
    pub model_mm: f64,
}

/// A lens of the draw.
#[derive(Clone, Debug, Serialize)]
pub struct Draw {
    /// Refocused rms, mm; none where it is no lens, a ray does not arrive or half of a field point's light is lost.
    pub rms_mm: Option<f64>,
    /// By the Jacobian, mm.
    pub model_mm: f64,
    /// How far the sensor moved, mm.
    pub focus_mm: Option<f64>,
}

/// All of it.
#[derive(Clone, Debug, Serialize)]
pub struct AsBuilt {
    /// Of the nominal lens, refocused, mm.
    pub nominal_mm: f64,
    /// The costliest first.
    pub alone: Vec<Alone>,
    /// In the order of their numbers.
    pub draws: Vec<Draw>,
    /// What polish and imperfections scatter, where the file states them.
    pub scatter: Option<Scatter>,
    /// What the file states and no draw knows, and other remarks.
    pub notes: Vec<String>,
    /// Seconds of the Jacobian with the costs by it, and of the rays of all draws.
    pub seconds: [f64; 2],
}

/// How many lenses, from which seed.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Lenses drawn.
    pub draws: usize,
    /// Seed.
    pub seed: u64,
    /// Whether the drawn lenses are wanted.
    pub lenses: bool,
}

/// Lenses between two looks at whether to go on; the result does not depend on it.
const TOGETHER: usize = 16;

/// Least part of its light that a field point keeps in a lens that is judged.
const DARK: f64 = 0.5;

/// The rays that lenses are judged by.
fn merit() -> Merit {
    Merit { whole: true, ..Merit::default() }
}

/// `lens` where numbers are off by so much, refocused, with its rms and the sensor's way, mm; none where a field point has less than a [`DARK`] part of its
/// `light` left: the rms of what still gets through would be no measure.
fn built(lens: &Lens, off: &[(Parameter, f64)], light: &[f64]) -> Option<(Lens, f64, f64)> {
    let moved = off_by(lens, off).ok()?;
    let last = lens.surfaces.len() - 1;
    let found = refocused(&moved, merit()).ok()?;
    let left = light_of(&found.lens, &merit()).ok()?;
    if left.iter().zip(light).any(|(now, then)| *now < DARK * then) {
        return None;
    }
    let way = found.lens.surfaces[last].thickness - lens.surfaces[last].thickness;
    Some((found.lens, found.rms_mm[1], way))
}

impl AsBuilt {
    /// Of `lens` within `tolerances`, with the drawn lenses where they are wanted (none where there was no lens), before them the lens itself, refocused as they are; `told` hears the share that is done, and ends the work by `false`.
    ///
    /// # Errors
    /// A lens that is not on one axis, or through which rays do not pass; a file that states nothing that can be drawn; [`Error::Interrupted`].
    pub fn new(
        lens: &Lens,
        tolerances: &Tolerances,
        settings: Settings,
        told: &mut dyn FnMut(f64) -> bool,
    ) -> Result<(Self, Vec<Option<Lens>>)> {
        let scatter = Scatter::new(lens, &Fabrication::new(lens, tolerances, None)?, tolerances);
        let (lens, deviations, notes) = deviations(lens, tolerances)?;
        let started = Instant::now();
        let Some((lens, nominal_mm, _)) = built(&lens, &[], &[]) else {
            let allowed = "a lens whose stop all rays of its fields pass";
            return Err(Error::bad(lens.file(), "rays", "some do not arrive", allowed));
        };
        let light = light_of(&lens, &merit())?;
        let last = Kind::Thickness.at(lens.surfaces.len() - 1);
        let model = Sensitivity::new(&lens, &merit(), parameters(last, &deviations))?.compensated(&[0]);
        let by_model = |off: &[(Parameter, f64)]| model.rms(&model.indexed(off));
        let of_model: Vec<f64> =
            deviations.iter().map(|d| by_model(&d.at(1.0, 0.0)).max(by_model(&d.at(-1.0, 0.0)))).collect();
        let first = started.elapsed().as_secs_f64();
        #[expect(clippy::cast_precision_loss, reason = "counts")]
        let all = (deviations.len() + settings.draws).max(1) as f64;
        let mut done = 0.0;
        let mut step = || {
            done += 1.0;
            if told(done / all) { Ok(()) } else { Err(Error::Interrupted) }
        };
        let mut alone = Vec::new();
        let both = |d: &Deviation| [1.0, -1.0].map(|part| built(&lens, &d.at(part, 0.0), &light).map(|b| b.1));
        for (some, of_model) in deviations.chunks(TOGETHER).zip(of_model.chunks(TOGETHER)) {
            let rms: Vec<_> = some.par_iter().map(both).collect();
            for ((d, rms_mm), model_mm) in some.iter().zip(rms).zip(of_model) {
                alone.push(Alone { deviation: d.clone(), rms_mm, model_mm: *model_mm });
                step()?;
            }
        }
        let worst = |a: &Alone| a.rms_mm.iter().map(|r| r.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
        alone.sort_by(|a, b| worst(b).total_cmp(&worst(a)));
        let started = Instant::now();
        let mut draws = Vec::new();
        let mut lenses: Vec<Option<Lens>> = settings.lenses.then(|| Some(lens.clone())).into_iter().collect();
        let of_draw = |k: usize| {
            let off = drawn(&deviations, settings.seed, k as u64);
            // A number that several deviations move moves by their sum in both judgements.
            (by_model(&off), built(&lens, &off, &light))
        };
        let numbers: Vec<usize> = (0..settings.draws).collect();
        for some in numbers.chunks(TOGETHER) {
            for (model_mm, found) in some.par_iter().map(|k| of_draw(*k)).collect::<Vec<_>>() {
                let (rms_mm, focus_mm) = (found.as_ref().map(|f| f.1), found.as_ref().map(|f| f.2));
                draws.push(Draw { rms_mm, model_mm, focus_mm });
                lenses.extend(settings.lenses.then(|| found.map(|f| f.0)));
                step()?;
            }
        }
        let seconds = [first, started.elapsed().as_secs_f64()];
        Ok((Self { nominal_mm, alone, draws, scatter, notes, seconds }, lenses))
    }

    /// The rms that a share of the draws does not exceed, by rays, and by the Jacobian, mm; draws that are no lens count as endless; NaN without draws.
    pub fn quantile(&self, share: f64) -> [f64; 2] {
        let of = |of: &dyn Fn(&Draw) -> f64| at_share(self.draws.iter().map(of).collect(), share);
        [of(&|d| d.rms_mm.unwrap_or(f64::INFINITY)), of(&|d| d.model_mm)]
    }

    /// Draws without a figure: no lens, a ray that does not arrive, half of a field point's light lost.
    pub fn lost(&self) -> usize {
        self.draws.iter().filter(|d| d.rms_mm.is_none()).count()
    }

    /// Share of the draws within `limit_mm`.
    pub fn within(&self, limit_mm: f64) -> f64 {
        let good = self.draws.iter().filter(|d| d.rms_mm.is_some_and(|r| r <= limit_mm)).count();
        #[expect(clippy::cast_precision_loss, reason = "counts")]
        let share = good as f64 / self.draws.len().max(1) as f64;
        share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Aperture, builtin};
    use isoplanat_base::testing::{assert_abs, assert_rel};

    const FILE: &str = "schema = 1\ntest_wavelength_nm = 632.8\n[element.all]\nthickness_tolerance_mm = 0.02\nn_d_tolerance = 2e-4\nv_d_tolerance_percent = 0.5\n\
        [surface.all]\nradius_percent = 0.1\ncentring_arcmin = 1.0\n[assembly]\nair_mm = 0.02\ndecentre_mm = 0.01\ntilt_arcmin = 1.0\n";

    fn drawn_of(name: &str, draws: usize, file: &str) -> AsBuilt {
        let lens = builtin::lens(name).expect("shipped");
        let tolerances = Tolerances::parse(file, "t.toml").expect("reads");
        AsBuilt::new(&lens, &tolerances, Settings { draws, seed: 1, lenses: false }, &mut |_| true)
            .expect("passes light")
            .0
    }

    /// Small tolerances: rays and Jacobian say the same of every deviation and of every draw, to 5 % of what it adds and 0.5 % of the nominal rms.
    #[test]
    fn rays_and_jacobian_agree_on_small_deviations() {
        for name in ["two_element", "cooke_triplet"] {
            let found = drawn_of(name, 12, FILE);
            assert!(found.alone.len() > 10 && found.lost() == 0, "{name}: {}", found.alone.len());
            for a in &found.alone {
                let worst = a.rms_mm.iter().flatten().fold(0.0f64, |m, r| m.max(*r));
                let within = 0.05 * (worst - found.nominal_mm).abs() + 2e-3 * found.nominal_mm;
                assert_abs(a.model_mm, worst, within, &format!("{name}: {}", a.deviation.name));
            }
            for d in &found.draws {
                let rms = d.rms_mm.expect("arrives");
                assert_abs(d.model_mm, rms, 0.05 * (rms - found.nominal_mm).abs() + 5e-3 * found.nominal_mm, name);
            }
            let [q10, q90] = [0.1, 0.9].map(|s| found.quantile(s)[0]);
            assert!(q10 <= q90 && found.within(q90) >= 0.9 && found.within(0.0) == 0.0);
        }
    }

    /// A radius of a single tolerance against the same lens typed by hand; the same seed draws the same lenses, tolerances of nothing are refused, and
    /// glasses that cannot be drawn are named.
    #[test]
    fn a_deviation_is_what_the_file_says() {
        let file = "schema = 1\n[surface.1]\nradius_percent = 2.0\n";
        let found = drawn_of("two_element", 3, file);
        let lens = builtin::lens("two_element").expect("shipped");
        let typed = lens.changed(|l| {
            let stop = crate::lens::paraxial::stop_semi_diameter(l);
            l.aperture = Aperture::StopSemiDiameter(stop);
            l.surfaces[1].shape.curvature *= 1.02;
        });
        let (_, rms, _) = built(&typed.expect("a lens"), &[], &[]).expect("passes light");
        assert_rel(found.alone[0].rms_mm[0].expect("arrives"), rms, 1e-6, 0.0, "typed by hand");
        let again = drawn_of("two_element", 3, file);
        assert!(found.draws.iter().zip(&again.draws).all(|(a, b)| a.rms_mm == b.rms_mm && a.model_mm == b.model_mm));
        // A fringe on a face as steep as the hologon's is what its sag says, and glass around a stop is one glass.
        let hologon = builtin::lens("hologon").expect("shipped");
        let file = "schema = 1\ntest_wavelength_nm = 632.8\n[surface.5]\nradius_fringes = 3\n[element.all]\nn_d_tolerance = 1e-3\n[assembly]\nair_mm = 0.01\n";
        let t = Tolerances::parse(file, "t.toml").expect("reads");
        let (_, all, _) = deviations(&hologon, &t).expect("made");
        let of = |name: &str| all.iter().filter(|d| d.name.contains(name)).collect::<Vec<_>>();
        let (c, h) = (hologon.surfaces[5].shape.curvature, hologon.surfaces[5].semi_diameter);
        let sag = |c: f64| c * h * h / (1.0 + (1.0 - c * c * h * h).sqrt());
        let by = of("surface 5, power")[0].moves[0].1;
        assert_rel(sag(c + 1e-3 * by) - sag(c), 3e-3 * 0.5 * 632.8e-6, 1e-2, 0.0, "a thousandth of three fringes");
        assert_eq!(of("air behind").len(), 2, "{:?}", of("air behind"));
        assert!(of("n_d").iter().any(|d| d.moves.len() == 2), "the glass that the stop divides");
        let cooke = drawn_of(
            "cooke_triplet",
            1,
            "schema = 1\n[element.all]\nn_d_tolerance = 1e-3\nthickness_tolerance_mm = 0.1\n",
        );
        assert!(cooke.notes.iter().any(|n| n.contains("catalogue")), "{:?}", cooke.notes);
        let nothing = Tolerances::parse("schema = 1\n[element.all]\nchamfer_mm = 0.2\n", "t.toml").expect("reads");
        let settings = Settings { draws: 1, seed: 1, lenses: true };
        let why = AsBuilt::new(&lens, &nothing, settings, &mut |_| true).expect_err("nothing to draw").to_string();
        assert!(why.starts_with("t.toml: tolerances"), "{why}");
        let some = Tolerances::parse(FILE, "t.toml").expect("reads");
        let ended = AsBuilt::new(&lens, &some, settings, &mut |_| false);
        assert!(matches!(ended, Err(Error::Interrupted)));
    }
}
