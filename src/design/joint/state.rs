//! Where a joint stage stands, as text: everything but the network, so that it goes on with the same bits.

use serde::{Deserialize, Serialize};

use super::distances::Distances;
use super::lens_steps::Remembered;
use super::noise::Noise;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::render::Settings;
use isoplanat_imaging::render::gradient_error::Chosen;
use isoplanat_optics::lens::{Lens, prescription};

/// How finely steps were rendered from one on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fineness {
    /// From which step on.
    pub step: usize,
    /// With which settings.
    pub chosen: Chosen,
}

/// A stage but for its network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Steps done.
    pub step: usize,
    /// Seconds so far.
    pub seconds: f64,
    /// The step at which settings are chosen again.
    pub again: usize,
    /// Shortens steps after one that failed.
    pub damping: f64,
    /// Steps that were taken back.
    pub rejected: usize,
    /// How often filters were made anew …
    pub refreshed: usize,
    /// … and how long that took.
    pub refreshing_seconds: f64,
    /// Steps of the schedule's first part and in all, once that is settled.
    pub settled: Option<[u64; 2]>,
    /// The best judgement of held-out pictures so far, dB ([`super::run::Stage`] says of what), and the step it was made at.
    pub best: Option<(f64, usize)>,
    /// Half field angle for which variables' scales and constraints were made, degrees, and the start's distortion there.
    pub seen: [f64; 2],
    /// How it is rendered now.
    pub settings: Option<Settings>,
    /// What the lens's steps remember.
    pub remembered: Remembered,
    /// Gradients since the last judgement.
    pub noise: Noise,
    /// Losses by object distance; files written before there were such weights have none.
    #[serde(default)]
    pub distances: Option<Distances>,
    /// The lens that drawn ones are around, where pictures are taken through those.
    #[serde(default)]
    around: Option<String>,
    /// The lens for which rays were chosen, the one for windows and nodes, the one that filters are of, the one that steps' object points
    /// are of, and the one now.
    lenses: [String; 5],
    /// Drawn lenses that showed nothing.
    #[serde(default)]
    pub lost: usize,
    /// How finely it was rendered.
    pub fineness: Vec<Fineness>,
}

impl State {
    /// A state of these lenses, the rest as `fill` says.
    pub(in crate::design) fn new(lenses: [&Lens; 5], fill: impl FnOnce(&mut Self)) -> Self {
        let mut state = Self {
            step: 0,
            seconds: 0.0,
            again: 0,
            damping: 1.0,
            rejected: 0,
            refreshed: 0,
            refreshing_seconds: 0.0,
            settled: None,
            best: None,
            seen: [0.0; 2],
            settings: None,
            remembered: Remembered::default(),
            noise: Noise::default(),
            distances: None,
            around: None,
            lenses: lenses.map(|l| prescription::to_toml(l)),
            lost: 0,
            fineness: Vec::new(),
        };
        fill(&mut state);
        state
    }

    /// The lens that drawn ones are around.
    pub(in crate::design) fn around(&self) -> Result<Option<Lens>> {
        self.around.as_ref().map(|text| prescription::from_toml(text, "checkpoint")).transpose()
    }

    /// Keeps the lens that drawn ones are around.
    pub(in crate::design) fn keep_around(&mut self, lens: Option<&Lens>) {
        self.around = lens.map(|l| prescription::to_toml(l));
    }

    /// Its lenses.
    pub(in crate::design) fn lenses(&self) -> Result<[Lens; 5]> {
        let read = |text: &String| prescription::from_toml(text, "checkpoint");
        let [a, b, c, d, e] = &self.lenses;
        Ok([read(a)?, read(b)?, read(c)?, read(d)?, read(e)?])
    }

    /// As text.
    pub fn to_text(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::Internal(format!("state: {e}")))
    }

    /// From text; `file` names where it stands.
    ///
    /// # Errors
    /// Text of another form.
    pub fn from_text(text: &str, file: &str) -> Result<Self> {
        isoplanat_base::exact::from_toml(text)
            .map_err(|e| Error::toml(file, text, &e, "a state, as `isoplanat design` writes it"))
    }
}
