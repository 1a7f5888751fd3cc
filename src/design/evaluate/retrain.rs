//! A network trained on for a lens as it was built: for what a camera can be calibrated to one by one, beside what holds for all of them.
//!
//! It is trained on captures by rays with one draw of noise each: with many more steps than captures it learns that noise too.

use ndarray::{Array3, Axis};

use super::camera::{Camera, Image};
use super::{Judge, STEP};
use crate::design::chain::forward_of;
use crate::design::data::Textures;
use crate::design::joint::middle;
use crate::design::places::{Places, Spread};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_network::Reconstructor;

/// How a network is trained on for each lens.
#[derive(Clone, Copy, Debug)]
pub struct Retrain<'a> {
    /// What its captures are of.
    pub textures: &'a Textures,
    /// Captures by rays, the same ones before every lens.
    pub captures: u64,
    /// Their side, pixels; less where the frame is smaller.
    pub side: usize,
    /// Steps of the network, the rate falling to zero by half a cosine.
    pub steps: u64,
    /// Captures a step.
    pub batch: usize,
    /// Largest step of the network.
    pub rate: f64,
}

impl<'a> Retrain<'a> {
    /// Captures, their side, how many a step takes.
    pub const SIZE: [usize; 3] = [48, 128, 4];

    /// [`Retrain::SIZE`], 5e-4.
    pub fn new(textures: &'a Textures, steps: u64) -> Self {
        let [captures, side, batch] = Self::SIZE;
        Self { textures, captures: captures as u64, side, steps, batch, rate: 5e-4 }
    }
}

/// What the network is told, and the truth.
type Pair = [Array3<f32>; 2];

impl Judge<'_> {
    /// The network of this judgement trained on for what `camera` captures at the one distance.
    ///
    /// # Errors
    /// A lens without light, a frame smaller than the network's scales, a network that fails; [`Error::Interrupted`] where `goes_on` says no.
    pub(super) fn retrained(
        &self,
        camera: &Camera,
        how: &Retrain<'_>,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<Reconstructor> {
        let (network, guide) = self.told;
        let electronics = Electronics::from_sensor(self.sensor);
        let multiple = network.config().multiple().max(STEP);
        let room = self.frame.rows.min(self.frame.columns) / multiple * multiple;
        let side = how.side.next_multiple_of(multiple).min(room);
        if side == 0 {
            let found = format!("{} x {} pixels", self.frame.columns, self.frame.rows);
            let allowed =
                format!("a frame of {multiple} x {multiple} pixels or more, which the network can be trained on");
            return Err(Error::bad(self.subject.name(), "sensor", found, allowed));
        }
        let (places, map) = (Places::new(&self.frame, side, Spread::Area), &self.renderer.optics.maps[0]);
        let seed = mixed(self.settings.seed, 0x7265_7472);
        let pair = |number: u64| -> Result<Pair> {
            let patch = how.textures.numbered((seed, number), &places, &self.frame, map, guide.reach());
            let Some(Image { irradiance, .. }) = camera.image(&self.renderer, &electronics, &patch)? else {
                return Err(Error::Internal("a lens as built is captured by rays".into()));
            };
            let done = forward_of(&self.renderer, &electronics, &patch, irradiance)?;
            let told = guide.over(done.developed.view(), patch.region, patch.part);
            Ok([told, done.truth.slice(middle(&patch)).to_owned()])
        };
        let mut pairs = Vec::new();
        for number in 0..how.captures.max(1) {
            pairs.push(pair(number)?);
            if !goes_on() {
                return Err(Error::Interrupted);
            }
        }
        let mut own = network.again();
        let rng = &mut fastrand::Rng::with_seed(seed);
        for step in 0..how.steps {
            let drawn: Vec<&Pair> = (0..how.batch.max(1)).map(|_| &pairs[rng.usize(0..pairs.len())]).collect();
            let [input, target] = [0, 1].map(|k| {
                let views: Vec<_> = drawn.iter().map(|pair| pair[k].view()).collect();
                ndarray::stack(Axis(0), &views).expect("captures of one size")
            });
            #[expect(clippy::cast_precision_loss, reason = "a share")]
            let used = step as f64 / how.steps as f64;
            let rate = how.rate * 0.5 * (1.0 + (std::f64::consts::PI * used).cos());
            own.step_network_only(input.view(), target.view(), None, rate)?;
            if !goes_on() {
                return Err(Error::Interrupted);
            }
        }
        Ok(own)
    }
}
