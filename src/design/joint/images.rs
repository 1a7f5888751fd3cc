//! A step of the lens by its sensor images at several distances: [`SensorLoss`], before the electronics, no network in it.

use ndarray::Array3;
use rayon::prelude::*;

use super::{Joint, Report};
use crate::design::chain::Patch;
use crate::design::data::{Scale, Textures};
use crate::design::joint::sensor_loss::SensorLoss;
use crate::design::places::Places;
use isoplanat_base::error::Result;
use isoplanat_imaging::metrics::decibel;
use isoplanat_imaging::render::{Rendered, Renderer};
use isoplanat_optics::psf::OpticsBar;

/// What the images of one scene say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::design) struct Seen {
    /// The loss.
    pub loss: f64,
    /// PSNR against the ideal picture, linear light, dB, mean over the distances …
    pub mean_db: f64,
    /// … and the lowest of them.
    pub lowest_db: f64,
}

impl Seen {
    /// The mean of some.
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    pub(in crate::design) fn mean(all: &[Self]) -> Self {
        let mean = |of: fn(&Self) -> f64| all.iter().map(of).sum::<f64>() / all.len().max(1) as f64;
        Self { loss: mean(|s| s.loss), mean_db: mean(|s| s.mean_db), lowest_db: mean(|s| s.lowest_db) }
    }
}

/// One scene as the sensor sees it from each distance.
struct Images {
    rendered: Vec<Rendered<f32>>,
    images: Vec<Array3<f64>>,
    ideals: Vec<Array3<f64>>,
    reference: usize,
}

impl Images {
    fn of(renderer: &Renderer, loss: &SensorLoss, group: &[Patch]) -> Result<Self> {
        let record = |patch: &Patch| -> Result<Rendered<f32>> {
            let depth = renderer.plan.depth(patch.scene.vergence)?;
            Ok(renderer.record(&patch.scene, depth, patch.region))
        };
        let rendered = group.par_iter().map(record).collect::<Result<Vec<_>>>()?;
        let images = rendered.iter().map(|r| r.image.mapv(f64::from)).collect();
        let ideals = rendered.iter().map(|r| (&r.truth * &r.illumination).mapv(f64::from)).collect();
        let vergence = loss.reference_mm.recip();
        let far = |p: &Patch| (p.scene.vergence - vergence).abs();
        let reference = (0..group.len()).min_by(|a, b| far(&group[*a]).total_cmp(&far(&group[*b]))).unwrap_or(0);
        Ok(Self { rendered, images, ideals, reference })
    }

    fn seen(&self, loss: f64) -> Seen {
        let db = |(a, b): (&Array3<f64>, &Array3<f64>)| {
            #[expect(clippy::cast_precision_loss, reason = "a picture's size")]
            let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64;
            decibel(square.max(1e-12))
        };
        let all: Vec<f64> = self.images.iter().zip(&self.ideals).map(db).collect();
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let mean_db = all.iter().sum::<f64>() / all.len() as f64;
        Seen { loss, mean_db, lowest_db: all.into_iter().fold(f64::INFINITY, f64::min) }
    }
}

/// Scene `number` of the draws of `seed` at every distance of `renderer`, in one place of its frame: a patch a distance.
pub(in crate::design) fn group(
    renderer: &Renderer,
    loss: &SensorLoss,
    textures: &Textures,
    draw: (u64, u64),
    places: &Places,
) -> Vec<Patch> {
    let frame = &renderer.plan.frame;
    let maps = renderer.optics.maps.iter().enumerate();
    maps.map(|(k, map)| {
        let scale = loss.texels_per_slope(k, map.vergence.recip(), frame.columns);
        let scale = scale.map_or(Scale::ThereToPixel, Scale::PerSlope);
        textures.numbered_as(draw, places, frame, map, (0, scale))
    })
    .collect()
}

/// The sensor images of a scene from each distance, then its ideal picture at the one that others are to resemble.
///
/// # Errors
/// As [`look`].
pub(in crate::design) fn pictures(renderer: &Renderer, loss: &SensorLoss, group: &[Patch]) -> Result<Vec<Array3<f32>>> {
    let i = Images::of(renderer, loss, group)?;
    let truth = i.rendered[i.reference].truth.clone();
    Ok(i.rendered.into_iter().map(|r| r.image).chain([truth]).collect())
}

/// What `loss` says of a scene from each distance: a patch a distance.
///
/// # Errors
/// A distance that the renderer was not made for.
pub(in crate::design) fn look(renderer: &Renderer, loss: &SensorLoss, group: &[Patch]) -> Result<Seen> {
    let i = Images::of(renderer, loss, group)?;
    Ok(i.seen(loss.slopes(&i.images, &i.ideals, i.reference)?.loss))
}

/// [`look`], with its gradient as a cotangent on the optics.
///
/// # Errors
/// As [`look`].
pub(in crate::design) fn look_back(
    renderer: &Renderer,
    loss: &SensorLoss,
    group: &[Patch],
) -> Result<(Seen, OpticsBar)> {
    let i = Images::of(renderer, loss, group)?;
    let slopes = loss.slopes(&i.images, &i.ideals, i.reference)?;
    #[expect(clippy::cast_possible_truncation, reason = "pictures are single precision")]
    let single = |v: f64| v as f32;
    let bars: Vec<OpticsBar> = (0..group.len())
        .into_par_iter()
        .map(|k| {
            let r = &i.rendered[k];
            let (image_bar, ideal_bar) = (slopes.images[k].mapv(single), slopes.ideals[k].mapv(single));
            // The ideal picture is seen under the lens's own light.
            let (truth_bar, light_bar) = (&ideal_bar * &r.illumination, &ideal_bar * &r.truth);
            renderer.vjp(&group[k].scene, r, image_bar.view(), truth_bar.view(), light_bar.view())
        })
        .collect();
    let mut bar = OpticsBar::zeros(&renderer.optics);
    bars.iter().for_each(|b| bar.add(b));
    Ok((i.seen(slopes.loss), bar))
}

/// A step that makes its own images worse by more than this share is taken back.
const WORSE: f64 = 0.01;

impl Joint {
    /// Whether the step from a lens whose images of `groups` had a loss `before` made them worse; the lens is back at where it was then.
    ///
    /// # Errors
    /// As [`Joint::step`].
    pub(in crate::design) fn is_worse(
        &mut self,
        renderer: &Renderer,
        loss: &SensorLoss,
        groups: &[Vec<Patch>],
        before: f64,
    ) -> Result<bool> {
        let all = groups.iter().map(|g| look(renderer, loss, g)).collect::<Result<Vec<_>>>()?;
        let after = Seen::mean(&all).loss;
        let worse = after.is_nan() || after > (1.0 + WORSE) * before;
        if worse {
            self.take_back();
        }
        Ok(worse)
    }

    /// One step of the lens alone by its images of some scenes, each a patch a distance, through `renderer`, which holds the lens now.
    ///
    /// # Errors
    /// As [`Joint::step`].
    pub(crate) fn step_by_images(
        &mut self,
        renderer: &Renderer,
        loss: &SensorLoss,
        groups: &[Vec<Patch>],
        lens_rate: f64,
    ) -> Result<Report> {
        let mut bar = OpticsBar::zeros(&renderer.optics);
        let mut all = Vec::with_capacity(groups.len());
        // One after the other: the records of a scene at all its distances are what memory holds.
        for group in groups {
            let (seen, of) = look_back(renderer, loss, group)?;
            all.push(seen);
            bar.add(&of);
        }
        let seen = Seen::mean(&all);
        let moves = lens_rate > 0.0 && seen.loss.is_finite();
        let lens = moves.then(|| self.follow(renderer, None, &bar, lens_rate));
        Ok(Report {
            loss: seen.loss,
            input_psnr_db: seen.mean_db,
            output_psnr_db: seen.lowest_db,
            lens,
            network_seconds: 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::joint::designing::prepare;
    use crate::design::joint::run::{JointSettings, joint_stage, network};
    use crate::design::joint::scenery::Scenery;
    use crate::design::task::Task;
    use isoplanat_imaging::guide::Inputs;
    use isoplanat_imaging::render::{Settings, frame_of};
    use isoplanat_imaging::sensor::Sensor;
    use isoplanat_imaging::sensor::spectrum::SpectralDensity;
    use isoplanat_network::Compute;
    use isoplanat_optics::lens::variables::Variables;
    use isoplanat_optics::lens::{Lens, builtin};

    const SETTINGS: Settings = Settings { dense: 300, wavelengths: 3, outside: 1e-2, cells: 16, ..Settings::DESIGN };
    const DEPTHS: [f64; 3] = [700.0, 1000.0, 1500.0];

    fn loss() -> SensorLoss {
        SensorLoss { reference_mm: 1000.0, weights: vec![3.0, 0.3, 1.0], ssim: 3.0, texture_mm: Vec::new() }
    }

    fn small(name: &str) -> Lens {
        let lens = builtin::lens(name).expect("shipped");
        lens.changed(|l| {
            let side = 1.536 / 64.0 * 1e3;
            (l.sensor.columns, l.sensor.rows, l.sensor.pitch_um, l.sensor.axis_px) = (64, 64, side, [32.0, 32.0]);
        })
        .expect("a raster")
    }

    fn renderer(lens: &Lens) -> Renderer {
        let density = SpectralDensity::new(&Sensor::generic());
        let frame = frame_of(lens).expect("valid");
        Renderer::planned(lens, &frame, &density, &DEPTHS.map(f64::recip), SETTINGS).expect("plans")
    }

    /// The lens gradient of the loss against central differences along directions of all its numbers: 1e-2, as through a network in single precision.
    #[test]
    fn the_lens_gradient_agrees_with_differences() {
        let lens = small("three_element");
        let first = renderer(&lens);
        let textures = Textures::built_in(3, 5, 400);
        let places = Places::new(&first.plan.frame, 64, crate::design::places::Spread::Area);
        let patches = group(&first, &loss(), &textures, (4, 1), &places);
        let (seen, bar) = look_back(&first, &loss(), &patches).expect("renders");
        assert_eq!(seen, look(&first, &loss(), &patches).expect("renders"));
        assert!(seen.loss > 0.1 && seen.lowest_db < seen.mean_db, "{seen:?}");
        let variables = Variables::refracting(&lens);
        let gradient = variables.gradient(&first.lens_gradient(&lens, &bar));
        let x = variables.values(&lens);
        for seed in 0..6 {
            let dx = isoplanat_base::testing::leaning(&gradient, 40 + seed);
            let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
            let at = |t: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + t * b).collect();
                let renderer = Renderer::new(&variables.lens(&lens, &moved).expect("a lens"), &first.plan);
                look(&renderer.expect("traces"), &loss(), &patches).expect("renders").loss
            };
            let h = 2e-4;
            let numeric = (at(h) - at(-h)) / (2.0 * h);
            isoplanat_base::testing::assert_rel(pulled, numeric, 1e-2, 0.0, &format!("direction {seed}"));
        }
    }

    /// One scene at every distance is one picture: ideal pictures of three elements with a pupil 17 mm behind the first vertex agree to a hundredth
    /// of a pixel's contrast; as printed in the paper they do not.
    #[test]
    fn scenes_stand_in_one_frame() {
        let renderer = renderer(&small("three_element"));
        let textures = Textures::built_in(3, 5, 400);
        let places = Places::new(&renderer.plan.frame, 64, crate::design::places::Spread::Area);
        let worst = |loss: &SensorLoss| {
            let of = |p: &Patch| {
                let depth = renderer.plan.depth(p.scene.vergence).expect("planned");
                renderer.record::<f32>(&p.scene, depth, p.region).truth
            };
            let truths: Vec<_> = group(&renderer, loss, &textures, (4, 1), &places).iter().map(of).collect();
            let differences = truths.iter().flat_map(|t| t.iter().zip(&truths[1]).map(|(a, b)| (a - b).abs()));
            differences.fold(0.0f32, f32::max)
        };
        let aligned = worst(&loss());
        assert!(aligned < 0.01, "{aligned}");
        let printed = worst(&SensorLoss { texture_mm: vec![20.51, 30.72, 46.08], ..loss() });
        assert!(printed > 0.1, "{printed}");
    }

    /// A stage by images lowers its loss on pictures that it does not train on, repeats to the bit, and leaves its network alone.
    #[test]
    fn a_stage_by_images_moves_the_lens_alone() {
        let mut task = Task::demo();
        (task.pictures.depths_mm, task.loss.sensor) = (DEPTHS.to_vec(), Some(loss()));
        (task.lens.file, task.frame.raster, task.lens.warm_start, task.budget.steps) =
            ("three_element".into(), None, false, Some(40));
        (task.pictures.patch_px, task.pictures.batch, task.lens.rate_um) = (64, 2, 8.0);
        let lens = small("three_element");
        let problem = prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem;
        let (textures, sensor) = (Textures::built_in(3, 3, 400), Sensor::generic());
        let held_out = task.held_out().expect("built in");
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
        let settings =
            JointSettings { settings: Some(SETTINGS), ..JointSettings::from_task(&task).expect("has a length") };
        let run = |steps: u64| {
            let length = crate::design::schedule::Length::Steps(steps);
            let settings = JointSettings { length, ..settings.clone() };
            let net = network(4, Inputs::BARE, 1, Compute::Cpu).expect("valid");
            joint_stage(&scenery, &problem, net, settings, &mut |_, _| {}).expect("runs").0
        };
        let (first, last, again) = (run(1), run(40), run(40));
        let weights = |s: &crate::design::joint::run::Stage| s.joint.network.parameters()[0].values.clone();
        assert_eq!(weights(&first), weights(&last), "the network stays");
        assert_eq!(last.joint.lens, again.joint.lens, "to the bit");
        let judged = |s: &crate::design::joint::run::Stage| s.camera().judged(&held_out, 64, 0..12).expect("judged");
        let (before, after) = (judged(&first), judged(&last));
        eprintln!("{before:?} {after:?}");
        assert!(after.loss < 0.99 * before.loss, "{} -> {}", before.loss, after.loss);
        assert!(last.score(&after) > last.score(&before));
    }
}
