//! Lenses as they may be built around the one under design: `isoplanat design --tolerance-aware`.
//!
//! A step's pictures are taken through a lens that is off the one under design by a draw of a file of tolerances, refocused by its Jacobian. The draw adds to
//! the lens's numbers, so a gradient at the drawn lens is one of the lens itself. Its aperture is what the lens states, a pupil as large as the lens's own. Only what leaves a lens round is drawn: the design's pictures are those of
//! round lenses, and `isoplanat tolerance` and `evaluate --drawn` judge with tilts and shifts too.

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::{at_share, mixed};
use isoplanat_imaging::render::Renderer;
use isoplanat_optics::analysis::deviations::{Deviation, deviations, drawn, off_by, parameters};
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;
use isoplanat_optics::lens::{Kind, Lens, Parameter};
use isoplanat_optics::optimize::sensitivity::Sensitivity;
use isoplanat_optics::optimize::{Merit, Outcome, residuals_of};

/// Drawn lenses that a judgement's pictures are taken through, and the number of the first, far from those of the steps.
pub(in crate::design) const BUILT: u64 = 6;
pub(in crate::design) const UNSEEN: u64 = 1 << 40;

/// What may deviate in `lens` and leaves it round.
///
/// # Errors
/// Tolerances that leave nothing to draw but tilts and shifts, or that are not this lens's.
pub fn round(tolerances: &Tolerances, lens: &Lens) -> Result<Vec<Deviation>> {
    let (_, mut all, _) = deviations(lens, tolerances)?;
    all.retain(Deviation::is_round);
    if all.is_empty() {
        let file = tolerances.file.clone().unwrap_or_default();
        let allowed = "a tolerance of a radius, thickness, index, Abbe number or air space: a design's pictures are those of lenses without tilts";
        return Err(Error::bad(file, "tolerances", "tilts and shifts alone", allowed));
    }
    Ok(all)
}

/// Draws of lenses around one.
#[derive(Clone, Debug)]
pub(in crate::design) struct AsBuilt {
    tolerances: Tolerances,
    merit: Merit,
    seed: u64,
    /// Of so many draws the one with the largest spots.
    worst_of: usize,
    /// The lens that deviations and focus are of.
    pub(in crate::design) around: Lens,
    deviations: Vec<Deviation>,
    /// The sensor's place, then all that deviates.
    model: Sensitivity,
}

impl AsBuilt {
    /// Around `lens`, whose focus `merit` judges: by `seed`, of `worst_of` draws the one with the largest spots.
    ///
    /// # Errors
    /// As [`round`]; rays that fail.
    pub(in crate::design) fn new(
        tolerances: &Tolerances,
        merit: &Merit,
        lens: &Lens,
        (seed, worst_of): (u64, usize),
    ) -> Result<Self> {
        let all = round(tolerances, lens)?;
        let sensor = Kind::Thickness.at(lens.surfaces.len() - 1);
        let model = Sensitivity::new(lens, merit, parameters(sensor, &all))?;
        let (tolerances, merit) = (tolerances.clone(), merit.clone());
        Ok(Self { tolerances, merit, seed, worst_of, around: lens.clone(), deviations: all, model })
    }

    /// The same around a lens that the design has moved to; one that cannot be looked at leaves it as it was.
    pub(in crate::design) fn follow(&mut self, lens: &Lens) {
        if let Ok(there) = Self::new(&self.tolerances, &self.merit, lens, (self.seed, self.worst_of)) {
            *self = there;
        }
    }

    /// Numbers of draw `number`, and how far they are off, the sensor's place refocused; the rms of its spots by the Jacobian, mm.
    fn off(&self, number: u64) -> (Vec<(Parameter, f64)>, f64) {
        // Others than `isoplanat tolerance` draws from the same seed.
        let mut off = drawn(&self.deviations, mixed(self.seed, 0x6465_7369), number);
        off.push((self.model.parameters[0], self.model.taken_up(0, &self.model.indexed(&off))));
        let rms = self.model.rms(&self.model.indexed(&off));
        (off, rms)
    }

    /// Numbers of the worst of the draws that stand for `number`.
    fn worst(&self, number: u64) -> Vec<(Parameter, f64)> {
        let count = self.worst_of as u64;
        let draws = (0..count).map(|k| self.off(number * count + k));
        draws.max_by(|a, b| a.1.total_cmp(&b.1)).map(|d| d.0).unwrap_or_default()
    }

    /// `lens` as draw `number` builds it; none where that is no lens.
    pub(in crate::design) fn lens(&self, lens: &Lens, number: u64) -> Option<Lens> {
        off_by(lens, &self.worst(number)).ok()
    }
}

/// Lenses that are drawn around each that a search found, and the share of them that is to be as good as what they are ranked by.
const RANKED: u64 = 60;
const SHARE: f64 = 0.9;

/// Which of several lenses is the best where they are built, not where they are drawn.
#[derive(Clone, Copy, Debug)]
pub struct BestBuilt {
    /// Its place among them by its own spots, from 0.
    pub rank: usize,
    /// How many there were.
    pub of: usize,
    /// Spots that nine in ten of the lenses built around it do not exceed, rms, mm; and around the first, endless where those could not be judged.
    pub spots_mm: [f64; 2],
}

/// Of `found`, the best first, the lens whose spots are least where it is built within `tolerances`: those that nine in ten drawn lenses do not exceed, each refocused by its Jacobian, by
/// rays: [`isoplanat_optics::analysis::tolerancing`] without tilts and shifts. None where no lens can be judged.
pub(in crate::design) fn best_built(
    found: &[Outcome],
    tolerances: &Tolerances,
    merit: &Merit,
    seed: u64,
) -> Option<BestBuilt> {
    let spots = |lens: &Lens| -> Option<f64> {
        let built = AsBuilt::new(tolerances, merit, lens, (mixed(seed, 0x7261_6e6b), 1)).ok()?;
        let rms = |number| {
            let drawn = built.lens(lens, number)?;
            let residuals = residuals_of(&drawn, merit).ok()?;
            Some(residuals.iter().map(|r| r * r).sum::<f64>().sqrt())
        };
        // One through which some ray does not come is worse than any other.
        Some(at_share((0..RANKED).map(|n| rms(n).unwrap_or(f64::INFINITY)).collect(), SHARE))
    };
    let judged: Vec<f64> = found.iter().map(|o| spots(&o.lens).unwrap_or(f64::INFINITY)).collect();
    let (rank, least) = judged.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
    least.is_finite().then(|| BestBuilt { rank, of: found.len(), spots_mm: [least, judged[0]] })
}

/// `lens` rendered with the plan that holds the widest kernels of its own and of lenses drawn around it, and the lens that plan is of: a drawn lens's blur
/// is not to fall outside windows that are made for `lens`.
pub(in crate::design) fn widest(
    lens: &Lens,
    as_built: Option<&AsBuilt>,
    planned: impl Fn(&Lens) -> Result<Renderer>,
) -> Result<(Lens, Renderer)> {
    let own = planned(lens)?;
    let reach = |r: &Renderer| r.plan.depths.iter().map(|d| d.reach_px()).sum::<usize>();
    let drawn = |k| as_built?.lens(lens, UNSEEN + BUILT + k);
    let others = (0..BUILT).filter_map(drawn).filter_map(|l| planned(&l).ok().map(|r| (l, r)));
    // Of equal ones the lens's own.
    let wider = others.filter(|(_, r)| reach(r) > reach(&own)).max_by_key(|(_, r)| reach(r));
    match wider {
        Some((at, other)) => Ok((at, Renderer::new(lens, &other.plan)?)),
        None => Ok((lens.clone(), own)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel};
    use isoplanat_optics::analysis::tolerancing::{self, Settings};
    use isoplanat_optics::lens::builtin;
    use isoplanat_optics::optimize::refocused;
    use isoplanat_optics::optimize::search::{Plan, search};
    use isoplanat_optics::optimize::spec::Spec;

    const FILE: &str = "schema = 1\n[element.all]\nthickness_tolerance_mm = 0.05\nn_d_tolerance = 5e-4\n[surface.all]\nradius_percent = 0.2\ncentring_arcmin = 3.0\n\
        [assembly]\nair_mm = 0.05\ndecentre_mm = 0.05\n";

    /// A drawn lens is off by no more than is allowed, is in focus as its rays say, and is the same for the same number; tilts are left out, and alone refused.
    #[test]
    fn drawn_lenses_are_within_their_tolerances_and_in_focus() {
        for name in ["two_element", "three_element"] {
            let lens = builtin::lens(name).expect("shipped");
            let last = lens.surfaces.len() - 1;
            let merit = Merit::default();
            // The focus counts from the nominal lens's own.
            let lens = refocused(&lens, merit.clone()).expect("focuses").lens;
            let tolerances = Tolerances::parse(FILE, "t.toml").expect("reads");
            let built = AsBuilt::new(&tolerances, &merit, &lens, (3, 1)).expect("draws");
            let mut moved = 0.0f64;
            for number in 0..8 {
                let drawn = built.lens(&lens, number).expect("a lens");
                assert_eq!(Some(&drawn), built.lens(&lens, number).as_ref(), "the same number");
                for (k, (a, b)) in drawn.surfaces.iter().zip(&lens.surfaces).enumerate() {
                    assert!(a.pose.is_none(), "no tilts");
                    let c = b.shape.curvature;
                    assert!((a.shape.curvature - c).abs() <= 2.001e-3 * c.abs(), "{name} {k}");
                    assert!(k == last || (a.thickness - b.thickness).abs() <= 0.0501, "{name} {k}");
                }
                let way = drawn.surfaces[last].thickness - lens.surfaces[last].thickness;
                let traced = refocused(&drawn, merit.clone()).expect("focuses").lens.surfaces[last].thickness;
                assert_abs(way, way + traced - drawn.surfaces[last].thickness, 0.02 + 0.05 * way.abs(), name);
                moved = moved.max(way.abs());
            }
            assert!(moved > 0.05, "the focus moves: {moved}");
            // Of several draws the one with the largest spots; a judgement's are as far from those of the steps.
            let tail = AsBuilt::new(&tolerances, &merit, &lens, (3, 4)).expect("draws");
            let rms = |n: u64| built.off(n).1;
            for number in [0, 5, UNSEEN] {
                let four: Vec<u64> = (0..4).map(|k| 4 * number + k).collect();
                let worst = four.iter().copied().max_by(|a, b| rms(*a).total_cmp(&rms(*b))).expect("four");
                assert_eq!(tail.lens(&lens, number), built.lens(&lens, worst), "{name} {number}");
                assert!(four.iter().any(|n| rms(*n) < rms(worst)));
            }
            // Around another lens they are that lens's.
            let longer = lens.changed(|l| l.surfaces[last].thickness += 0.1).expect("a lens");
            let mut there = built.clone();
            there.follow(&longer);
            assert_eq!(there.around, longer);
        }
        let lens = builtin::lens("two_element").expect("shipped");
        let tilts = Tolerances::parse("schema = 1\n[surface.all]\ncentring_arcmin = 3.0\n", "t.toml").expect("reads");
        let why = AsBuilt::new(&tilts, &Merit::default(), &lens, (1, 1)).expect_err("nothing round").to_string();
        assert!(why.starts_with("t.toml: tolerances: tilts and shifts alone"), "{why}");
    }

    /// Of the lenses that a search finds, the one that `isoplanat tolerance`'s own draws, traced and refocused one by one, say is the best as built. The sharpest is not the best here.
    #[test]
    fn the_best_lens_as_built_is_the_one_that_draws_say() {
        let lens = builtin::lens("two_element").expect("shipped");
        let text = "schema = 1\n[element.all]\nthickness_tolerance_mm = 0.05\nn_d_tolerance = 1e-3\n[surface.all]\nradius_percent = 0.5\n[assembly]\nair_mm = 0.05\n";
        let tolerances = Tolerances::parse(text, "t.toml").expect("reads");
        let problem = Spec::default().problem(&lens, "spec").expect("a problem");
        let plan = Plan { starts: 24, ..Plan::default() };
        let mut found = search(&problem, &plan, &mut |_| true).expect("finds");
        found.truncate(4);
        let settings = Settings { draws: 60, seed: 1, lenses: false };
        let by_draws = |o: &Outcome| {
            let told = tolerancing::AsBuilt::new(&o.lens, &tolerances, settings, &mut |_| true);
            told.map_or(f64::INFINITY, |(t, _)| t.quantile(SHARE)[0])
        };
        let mut all: Vec<f64> = found.iter().map(by_draws).collect();
        // The worst first: what is chosen is not what stands there.
        let worst = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])).expect("lenses");
        found.swap(0, worst);
        all.swap(0, worst);
        let chosen = best_built(&found, &tolerances, &problem.merit, 1).expect("lenses");
        let least = all.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(all[0] > 1.1 * least, "lenses that differ as built: {all:?}");
        // Sixty draws of either, other rays over field and pupil: chance at the quantile.
        assert!(chosen.rank != 0 && all[chosen.rank] <= 1.03 * least, "{chosen:?} of {all:?}");
        assert_rel(chosen.spots_mm[0], all[chosen.rank], 0.1, 0.0, "the quantile");
        assert_eq!(chosen.of, found.len());
    }
}
