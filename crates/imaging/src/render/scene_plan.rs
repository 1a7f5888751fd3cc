//! A lens planned for scenes: what is rendered how finely, and what is left out, with reason, saving and error bound.

use ndarray::Array3;
use serde::Serialize;

use super::inputs::Seen;
use super::needs::{Channels, Needs, check};
use super::plan::Settings;
use super::renderer::Renderer;
use crate::plane::{Plane, Region};
use crate::render::blur::Method;
use isoplanat_base::error::Result;
use isoplanat_base::math::real::Real;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// The cheapest settings that hold this PSNR (linear light, range 1).
    Psnr(f64),
    /// These settings; the scene's needs still count.
    Settings(Settings),
    /// Everything, finely and everywhere: nothing is left out.
    Everything,
}

/// Something that is left out, or made coarser.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Skip {
    /// What.
    pub what: &'static str,
    /// Why it is not needed here.
    pub reason: String,
    /// Work of its stage that remains, as a share of the full computation's.
    pub remaining: f64,
    /// Root mean square difference to the full computation that it may make, relative to white; 0: none.
    pub bound: f64,
}

/// A lens ready for scenes like those it was planned with.
pub struct ScenePlan {
    /// Lens and plan.
    pub renderer: Renderer,
    /// What the scenes hold, together.
    pub needs: Needs,
    /// Pixels that their light can reach; `None`: none.
    pub region: Option<Region>,
    /// Convolution of a scene that holds what they hold together.
    pub method: Method,
    /// What is left out.
    pub skips: Vec<Skip>,
    /// Predicted PSNR against the finest setting, dB, where it was measured.
    pub predicted_db: Option<f64>,
    /// Whether the request is predicted to hold (true where nothing was asked).
    pub holds: bool,
    /// Error bound of coarser cells, rms; 0 where cells are pixels.
    pub(super) coarse_bound: f64,
    /// Error bound of leaving diffraction out, rms, where that was looked at; no number where it was not measured.
    pub(super) bend_bound: Option<f64>,
    /// Bytes, from above, that looking whether diffraction is needed took.
    pub(super) look_bytes: u64,
    pub(super) everything: bool,
}

impl ScenePlan {
    /// The picture of `scene`, `[3, row, col]`, 1 = white on the axis; `progress` hears the share done.
    ///
    /// # Errors
    /// A scene that cannot be rendered, or at another distance than planned for.
    pub fn picture<T: Real>(&self, scene: &Plane, progress: &(dyn Fn(f64) + Sync)) -> Result<(Array3<T>, Seen)> {
        self.part(scene, Region::whole(&self.renderer.plan.frame), progress)
    }

    /// [`Self::picture`] of a part of the frame: what its neighbours show is in it, what lies outside is not computed.
    ///
    /// # Errors
    /// As there.
    #[doc(hidden)]
    pub fn part<T: Real>(
        &self,
        scene: &Plane,
        part: Region,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<(Array3<T>, Seen)> {
        check(scene)?;
        let plan = &self.renderer.plan;
        let depth = plan.depth(scene.vergence)?;
        let (channels, region) = if self.everything {
            (Channels::all(), Some(part))
        } else {
            let reach = plan.depths[depth].reach_px();
            let needs = Needs::compute(scene, &self.renderer.optics.maps[depth], &plan.frame, reach);
            let region = needs.reached(plan.depths[depth].reach_px(), part);
            (needs.channels, region)
        };
        let mut image = Array3::from_elem((3, part.rows, part.cols), T::zero());
        let Some(region) = region else {
            progress(1.0);
            return Ok((image, Seen::default()));
        };
        let (seen_part, seen) = self.renderer.picture(scene, depth, region, &channels, progress);
        if region == part {
            return Ok((seen_part, seen));
        }
        let (r, c) = ((region.row - part.row).unsigned_abs(), (region.col - part.col).unsigned_abs());
        image.slice_mut(ndarray::s![.., r..r + region.rows, c..c + region.cols]).assign(&seen_part);
        Ok((image, seen))
    }

    /// The ideal picture of a part of the frame, `[3, row, col]`, as [`Renderer::truth`] has it.
    ///
    /// # Errors
    /// As [`Self::picture`].
    #[doc(hidden)]
    pub fn truth<T: Real>(&self, scene: &Plane, part: Region) -> Result<Array3<T>> {
        check(scene)?;
        let depth = self.renderer.plan.depth(scene.vergence)?;
        Ok(self.renderer.truth(scene, depth, part, &Channels::from_scene(scene)))
    }
}

/// What is told of a plan that predicts so many dB and does not hold the `asked` ones with the margin that probes need; `option` asked for them.
#[doc(hidden)]
pub fn shortfall(predicted_db: Option<f64>, asked: f64, option: &str) -> String {
    let (predicted, margin) = (predicted_db.unwrap_or(f64::NAN), 10.0 * super::choose::MARGIN.log10());
    format!(
        "the finest settings are predicted to reach {predicted:.1} dB, not the {asked} dB of {option} and a margin of {margin:.1} dB"
    )
}
