//! How long a design would take here: a few of its own steps, timed.

use super::joint::run::{JointSettings, Stage};
use super::joint::scenery::Scenery;
use super::schedule::Length;
use isoplanat_base::error::Result;
use isoplanat_network::Reconstructor;
use isoplanat_optics::optimize::Problem;

/// Steps that are timed, behind as many that are not.
const TIMED: u64 = 3;

/// Seconds of a step.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// With the lens moving.
    pub moving: f64,
    /// Of it the network.
    pub network: f64,
    /// With the lens held.
    pub held: f64,
}

impl Pace {
    /// Seconds of a stage of `settings`.
    pub fn all(&self, settings: &JointSettings) -> f64 {
        let [from, to] = settings.lens_share;
        let moving = if settings.lens_rate > 0.0 { to - from } else { 0.0 };
        match settings.length {
            Length::Seconds(s) => s,
            Length::Steps(n) => n as f64 * (moving * self.moving + (1.0 - moving) * self.held),
        }
    }
}

/// Takes a few steps of a stage of `settings` from `problem`'s lens and a fresh `network`, with the lens moving and with the lens held.
///
/// # Errors
/// As [`Stage::new`] and [`Stage::step`].
pub fn pace(
    scenery: &Scenery<'_>,
    problem: &Problem,
    network: &dyn Fn() -> Result<Reconstructor>,
    settings: &JointSettings,
) -> Result<Pace> {
    let timed = |rate: f64| -> Result<[f64; 2]> {
        let length = Length::Steps(2 * TIMED);
        let settings = JointSettings { length, lens_rate: rate, lens_share: [0.0, 1.0], ..settings.clone() };
        let mut stage = Stage::new(scenery, problem, network()?, settings)?;
        let mut sums = [0.0; 2];
        while let Some(_entry) = stage.step(scenery)? {
            if stage.steps() as u64 > TIMED {
                let [all, network] = stage.last_seconds();
                sums = [sums[0] + all, sums[1] + network];
            }
        }
        Ok(sums.map(|s| s / TIMED as f64))
    };
    let held = timed(0.0)?;
    let moving = if settings.lens_rate > 0.0 { timed(settings.lens_rate)? } else { held };
    Ok(Pace { moving: moving[0], network: moving[1], held: held[0] })
}
