//! A network behind lenses that are not quite its own: as they were built.

use std::time::Instant;

use super::camera::{Camera, seen_by};
use super::{Judge, Retrain};
use crate::design::subject::Subject;
use crate::report::drawn::{Aspect, Drawn, Draws, Psnr};
use crate::report::evaluation::Evaluation;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;

/// Lenses as they were built.
#[derive(Clone, Debug)]
pub struct Built {
    /// The lens that was drawn around, refocused as the draws are.
    pub refocused: Option<Lens>,
    /// By name; `None` where none was found.
    pub draws: Vec<(String, Option<Lens>)>,
}

impl Judge<'_> {
    /// PSNR behind each lens, by rays, of the pictures and places of this judgement: as it stands, and after its pictures were aligned; then too behind a
    /// network that was trained on for that lens, where somebody says how to `retrain`. `told` hears the share that is done, and after a draw ends the work by
    /// `false`: what was judged is the result.
    ///
    /// # Errors
    /// Settings without rays, or at several distances; the run of a measured lens; lenses on another frame. A drawn lens that shows nothing is told with the
    /// reason.
    pub fn draws(
        &self,
        built: &Built,
        retrain: Option<&Retrain<'_>>,
        told: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Draws> {
        let Some(rays) = self.settings.rays else {
            let allowed = "captures by rays from the sensor: --reference N";
            return Err(Error::bad("", "drawn lenses", "captures by the fast renderer", allowed));
        };
        if self.settings.depths_mm.len() != 1 {
            let found = format!("{} distances", self.settings.depths_mm.len());
            return Err(Error::bad("", "drawn lenses", found, "one distance: --depths-mm"));
        }
        let Subject::Lens(own) = self.subject else {
            let allowed = "the run of a lens with a prescription";
            return Err(Error::bad(self.subject.name(), "drawn lenses", "a measured lens", allowed));
        };
        let size = |l: &Lens| [l.sensor.columns, l.sensor.rows];
        let given = built.draws.iter().filter_map(|(name, lens)| Some((name.as_str(), lens.as_ref()?)));
        if let Some((name, lens)) =
            given.chain(built.refocused.iter().map(|l| ("", l))).find(|l| size(l.1) != size(own))
        {
            let [[a, b], [c, d]] = [size(lens), size(own)];
            return Err(Error::bad(
                name,
                "sensor",
                format!("{a} x {b}"),
                format!("{c} x {d} pixels, as the run's lens"),
            ));
        }
        told(0.0);
        let started = Instant::now();
        let density = SpectralDensity::new(self.sensor);
        let own_seen = seen_by(own, &self.frame, &density, &self.renderer)?;
        let through =
            |lens: Option<&Lens>| Camera::built(lens, (own, &own_seen), (self.sensor, &density), &self.renderer, rays);
        let nominal = psnr(&self.through(&through(None)?, false, &mut |_| ())?.0)?;
        let shown = |lens: &Lens, goes_on: &mut dyn FnMut() -> bool| -> Result<Aspect> {
            let camera = through(Some(lens))?;
            let (scale, shift_px) = camera.moved(&self.renderer);
            let aligned = psnr(&self.through(&camera, false, &mut |_| ())?.0)?;
            let retrained = match retrain {
                Some(how) => {
                    let own = self.retrained(&camera, how, goes_on)?;
                    Some(psnr(&self.behind(&own, &camera, false, &mut |_| ())?.0)?)
                }
                None => None,
            };
            let as_it_stands = psnr(&self.through(&camera.unaligned(), false, &mut |_| ())?.0)?;
            Ok(Aspect { as_it_stands, aligned, retrained, scale, shift_px })
        };
        let refocused = built.refocused.as_ref().map(|lens| shown(lens, &mut || told(0.0))).transpose()?;
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        let share = |done: usize| done as f64 / built.draws.len() as f64;
        let mut draws = Vec::new();
        for (k, (name, lens)) in built.draws.iter().enumerate() {
            let found = match lens {
                None => Err("no lens was found there".to_owned()),
                Some(lens) => match shown(lens, &mut || told(share(k))) {
                    Ok(aspect) => Ok(aspect),
                    Err(Error::Interrupted) => break,
                    Err(e @ Error::BadInput(_)) => Err(e.to_string()),
                    Err(e) => return Err(e),
                },
            };
            draws.push(Drawn { name: name.clone(), shown: found.as_ref().ok().copied(), why: found.err() });
            if !told(share(k + 1)) {
                break;
            }
        }
        Ok(Draws { nominal, refocused, draws, seconds: started.elapsed().as_secs_f64() })
    }
}

/// The mean over all zones.
fn psnr(evaluation: &Evaluation) -> Result<Psnr> {
    let mean = evaluation.rows.last().ok_or_else(|| Error::Internal("a judgement without rows".into()))?;
    Ok(Psnr { capture_db: mean.capture.psnr_db.mean, reconstruction_db: mean.reconstruction.psnr_db.mean })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{identity, lens, settings};
    use super::super::{Retrain, Settings};
    use super::*;
    use crate::design::data::Textures;
    use crate::design::evaluate::Pictures;
    use isoplanat_imaging::guide::Guide;
    use isoplanat_imaging::scene::SceneKind;
    use isoplanat_imaging::sensor::Sensor;
    use isoplanat_optics::lens::pose::{Element, Pose};

    /// A lens by itself changes nothing; one that stands 3 pixels aside shows the same picture there, and one whose second element is tilted is worse by what its
    /// blur does; one without light is told, and draws without rays are refused.
    #[test]
    fn drawn_lenses_are_judged_as_they_stand_and_aligned() {
        let (own, sensor) = (lens(), Sensor::generic());
        let Subject::Lens(plain) = &own else { unreachable!("a prescription") };
        let (frame, last) = (own.frame().expect("valid"), plain.surfaces.len() - 1);
        let (net, bare) = (identity(3), Guide::bare(&frame));
        let moved = |first: usize, decentre: [f64; 2], tilt: [f64; 3]| {
            let element = Element { first, last, pose: Pose { decentre, tilt }, pivot: 0.0 };
            (format!("from {first}"), plain.changed(|l| l.elements.push(element)).expect("a lens"))
        };
        let some = |(name, lens): (String, Lens)| (name, Some(lens));
        let built = Built {
            refocused: Some((**plain).clone()),
            draws: vec![
                ("itself".to_owned(), Some((**plain).clone())),
                some(moved(0, [0.24, -0.16], [0.0; 3])),
                some(moved(3, [0.0; 2], [0.07, 0.0, 0.0])),
                some(moved(3, [500.0, 0.0], [0.0; 3])),
                ("lost".to_owned(), None),
            ],
        };
        let pictures = Pictures::BuiltIn(SceneKind::Facades, 2);
        let with = Settings { rays: Some(32), ..settings(2, 32) };
        let judge = Judge::new(&own, (&net, &bare), &sensor, &pictures, &with).expect("judges");
        let found = judge.draws(&built, None, &mut |_| true).expect("draws");
        let [itself, aside, tilted, dark, lost] = &found.draws[..] else { panic!("five draws") };
        let of = |d: &Drawn| d.shown.unwrap_or_else(|| panic!("{}: {:?}", d.name, d.why));
        let same = of(itself);
        assert_eq!((same.aligned, same.as_it_stands), (found.nominal, found.nominal), "the same rays");
        assert_eq!((same.scale, same.shift_px, found.refocused), (1.0, [0.0; 2], Some(same)));
        let aside = of(aside);
        // At a metre a lens that moves takes its picture along, and a twentieth more. Its x is to the left on the sensor, its y downwards.
        let [right, down] = aside.shift_px;
        assert!((right + 3.15).abs() < 0.1 && (down + 2.1).abs() < 0.1, "{right} {down}");
        assert!((aside.scale - 1.0).abs() < 2e-3, "{}", aside.scale);
        assert!((aside.aligned.capture_db - found.nominal.capture_db).abs() < 0.4, "{aside:?} {:?}", found.nominal);
        assert!(aside.as_it_stands.capture_db < aside.aligned.capture_db - 1.0, "{aside:?}");
        let tilted = of(tilted);
        assert!(tilted.aligned.capture_db < found.nominal.capture_db - 0.3, "{tilted:?} {:?}", found.nominal);
        let why = dark.why.as_ref().expect("no light");
        assert!(why.contains("rays") || why.contains("light"), "{why}");
        assert_eq!(lost.why.as_deref(), Some("no lens was found there"));
        let first = judge.draws(&built, None, &mut |_| false).expect("draws");
        assert_eq!(first.draws, found.draws[..1]);
        for (wrong, said) in [
            (settings(2, 32), "--reference"),
            (Settings { depths_mm: vec![500.0, 1000.0], ..with.clone() }, "--depths-mm"),
        ] {
            let judge = Judge::new(&own, (&net, &bare), &sensor, &pictures, &wrong).expect("judges");
            assert!(judge.draws(&built, None, &mut |_| true).expect_err(said).to_string().contains(said));
        }
        // Trained on for each: the tilted lens is the one that gains by it, on what it is trained on.
        let textures = Textures::built_in(900_000, 2, 400);
        let how = Retrain { captures: 6, side: 32, steps: 60, rate: 2e-3, ..Retrain::new(&textures, 60) };
        let each = judge.draws(&built, Some(&how), &mut |_| true).expect("draws");
        for (a, b) in each.draws.iter().zip(&found.draws) {
            let (Some(a), Some(b)) = (&a.shown, &b.shown) else { continue };
            assert_eq!((a.aligned, a.as_it_stands), (b.aligned, b.as_it_stands), "the others are what they were");
            let retrained = a.retrained.expect("trained on");
            assert_eq!(retrained.capture_db, a.aligned.capture_db);
            assert!(retrained.reconstruction_db > a.aligned.reconstruction_db + 0.1, "{a:?}");
        }
        let larger = plain.changed(|l| l.sensor.columns = 250).expect("a lens");
        let other = Built { refocused: None, draws: vec![("large.toml".to_owned(), Some(larger))] };
        let error = judge.draws(&other, None, &mut |_| true).expect_err("another frame").to_string();
        assert!(error.contains("large.toml") && error.contains("240 x 160"), "{error}");
        let through = Settings { through: built.draws[2].1.clone().map(Into::into), ..settings(2, 32) };
        let refused = super::super::evaluate(&own, (&net, &bare), &sensor, &pictures, &through, false, &mut |_| ());
        assert!(refused.expect_err("no rays").to_string().contains("--reference"));
    }
}
