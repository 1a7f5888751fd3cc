//! A design task as a TOML file: which lens, on which sensor, trained on what, for how long.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::bound::require_agreement;
use super::data::{TEXTURE, Textures};
use super::folder::MARKER;
use super::lens_steps::Steps;
use super::places::Spread;
use super::schedule::Length;
use super::sensor_loss::SensorLoss;
use super::stated::Stated;
use super::subject::Subject;
use super::sweep_task::SweepTask;
use super::train_task::{MOST_DEPTHS, TrainTask};
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::calibrate::lens::MeasuredLens;
use isoplanat_imaging::guide::Inputs;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;
use isoplanat_optics::interchange::{self, Reading};
use isoplanat_optics::lens::catalogue::Glasses;
use isoplanat_optics::lens::variables::Variables;
use isoplanat_optics::lens::{Field, Kind, Lens, Prescription, SensorRaster};
use isoplanat_optics::optimize::spec::Spec;
use isoplanat_optics::optimize::{Constraint, Problem, Quantity};
use isoplanat_optics::trace::rims::require_clear;

/// Largest distortion at the frame's corner, and how much more than its own a lens may get that has more.
const BARREL: f64 = 0.08;
const SLACK: f64 = 0.02;

/// Most draws of which the worst one is taken.
const MOST_DRAWS: usize = 64;

pub use isoplanat_models::TASKS as SHIPPED;

/// The form of task files this program reads.
pub(crate) const SCHEMA: u32 = 1;

/// Bytes of a task at most.
const LARGEST: u64 = 1 << 20;

/// A task; every key but `schema` and `lens` has a default.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Form of the file: 1.
    pub schema: u32,
    /// Lens file, or the name of a shipped lens; for `isoplanat train` also the folder of a measured one.
    pub lens: String,
    /// Raster in place of the lens file's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<TaskSensor>,
    /// Sensor calibration file; the generic sensor where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// Folder of photographs; built-in scenes where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<PathBuf>,
    /// Built-in scenes to generate.
    #[serde(default = "default_scenes")]
    pub scenes: usize,
    /// Seed of every draw.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Steps of the joint stage (repeatable), or …
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    /// … minutes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// Patch side, pixels.
    #[serde(default = "default_patch")]
    pub patch_px: usize,
    /// Patches a step.
    #[serde(default = "default_batch")]
    pub batch: usize,
    /// Channels of the network's finest scale.
    #[serde(default = "default_width")]
    pub base_width: usize,
    /// What the network of the joint stage sees beside the capture; names as in `train.inputs`.
    #[serde(default, skip_serializing_if = "Inputs::is_bare")]
    pub inputs: Inputs,
    /// What moves, in which bounds, what is held: the keys of `isoplanat optimize --merit`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub optics: Spec,
    /// Even powers up to which refracting surfaces have terms that may move, stated as 0 where the lens has none; 0: as the lens states
    /// them.
    #[serde(default)]
    pub asphere_power: usize,
    /// Whether the sensor first moves to the least spots over the field and all distances.
    #[serde(default, skip_serializing_if = "is_false")]
    pub focus_all: bool,
    /// Starts of a global search by spots, where the lens is first improved by those; 0: from the lens alone.
    #[serde(default)]
    pub search: usize,
    /// Whether the lens is first improved by its spots alone.
    #[serde(default = "yes")]
    pub warm_start: bool,
    /// What steps of the lens are measured by.
    #[serde(default)]
    pub lens_steps: Steps,
    /// Largest step of the lens where steps are measured by rays: their rms movement, µm.
    #[serde(default = "default_lens_rate_um")]
    pub lens_rate_um: f64,
    /// Largest step of the lens where they are not.
    #[serde(default = "default_lens_rate")]
    pub lens_rate: f64,
    /// Part of the joint stage in which the lens moves, from and to, of 1.
    #[serde(default = "default_lens_share")]
    pub lens_share: [f64; 2],
    /// Equal parts of the stage, each with 0.8 of the rates of the one before; 0: a rise and half a cosine.
    #[serde(default)]
    pub epochs: usize,
    /// Least illumination relative to the axis that steps of the lens keep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_illumination: Option<f64>,
    /// Object distances, mm, taken in turn; left out: the lens's own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub depths_mm: Vec<f64>,
    /// Power of the mean over the distances' losses behind the network: 1 is their mean, more looks at the worst of them.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub depth_power: f64,
    /// A loss on the lens's own images at those distances in place of one behind the network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_loss: Option<SensorLoss>,
    /// What lenses may be off by through which the design's pictures are taken: a file as for `isoplanat tolerance`, or its keys.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerances: Option<Stated>,
    /// Of how many of those draws the one with the largest spots is taken.
    #[serde(default = "once", skip_serializing_if = "is_once")]
    pub worst_of: usize,
    /// How patches are spread over the field.
    #[serde(default)]
    pub spread: Spread,
    /// Photographs at the beginning of the folder that are kept from training, and judge the design on its way.
    #[serde(default)]
    pub keep_first: usize,
    /// How often the design is judged on pictures that it does not train on.
    #[serde(default = "default_checks")]
    pub checks: usize,
    /// Seconds between checkpoints: what a kill may lose.
    #[serde(default = "default_checkpoint_seconds")]
    pub checkpoint_seconds: f64,
    /// Largest network step.
    #[serde(default = "default_network_rate")]
    pub network_rate: f64,
    /// Train the network alone.
    #[serde(default)]
    pub freeze_lens: bool,
    /// Designs that come before this one, each from the lens of the one before: what is different in them ([`super::stages`]).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages: Vec<toml::Table>,
    /// What differs between the designs of a sweep (`isoplanat sweep`).
    #[serde(default, skip_serializing_if = "no_sweep")]
    pub sweep: SweepTask,
    /// The final network for the finished lens (`isoplanat train`).
    #[serde(default)]
    pub train: TrainTask,
}

/// A raster in a task.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSensor {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Pixel pitch, µm.
    pub pitch_um: f64,
    /// Axis `[column, row]`; the centre where left out.
    pub axis_px: Option<[f64; 2]>,
}

fn default_scenes() -> usize {
    40
}
fn default_seed() -> u64 {
    1
}
fn default_patch() -> usize {
    128
}
fn one() -> f64 {
    1.0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_one(value: &f64) -> bool {
    *value == 1.0
}

fn once() -> usize {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_once(value: &usize) -> bool {
    *value == 1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_false(value: &bool) -> bool {
    !value
}

fn default_batch() -> usize {
    2
}
fn default_width() -> usize {
    16
}
fn default_lens_rate() -> f64 {
    0.01
}
fn default_lens_rate_um() -> f64 {
    2.0
}
fn default_lens_share() -> [f64; 2] {
    [0.1, 0.85]
}
fn default_checks() -> usize {
    10
}
fn default_checkpoint_seconds() -> f64 {
    60.0
}
fn yes() -> bool {
    true
}
fn no_sweep(sweep: &SweepTask) -> bool {
    *sweep == SweepTask::default()
}
fn is_default(spec: &Spec) -> bool {
    *spec == Spec::default()
}
fn default_network_rate() -> f64 {
    2e-3
}

impl Task {
    /// The demo's task: the two-element lens on a quadrant sensor of 960 × 640 pixels of 20 µm.
    pub fn demo() -> Self {
        Self {
            schema: SCHEMA,
            lens: "two_element".into(),
            sensor: Some(TaskSensor { columns: 960, rows: 640, pitch_um: 20.0, axis_px: Some([0.0, 0.0]) }),
            calibration: None,
            photos: None,
            scenes: default_scenes(),
            seed: default_seed(),
            steps: None,
            minutes: None,
            patch_px: default_patch(),
            batch: default_batch(),
            base_width: default_width(),
            inputs: Inputs::BARE,
            optics: Spec::default(),
            asphere_power: 0,
            focus_all: false,
            search: 0,
            warm_start: true,
            lens_steps: Steps::default(),
            lens_rate_um: default_lens_rate_um(),
            lens_rate: default_lens_rate(),
            lens_share: default_lens_share(),
            epochs: 0,
            least_illumination: None,
            depths_mm: Vec::new(),
            depth_power: 1.0,
            sensor_loss: None,
            tolerances: None,
            worst_of: 1,
            spread: Spread::default(),
            keep_first: 0,
            checks: default_checks(),
            checkpoint_seconds: default_checkpoint_seconds(),
            network_rate: default_network_rate(),
            freeze_lens: false,
            stages: Vec::new(),
            sweep: SweepTask::default(),
            train: TrainTask::default(),
        }
    }

    /// Reads and checks a task file, or a shipped task by its name; paths in a file are relative to it.
    ///
    /// # Errors
    /// A file that cannot be read or is no task.
    pub fn load(path: &Path) -> Result<Self> {
        let shipped = SHIPPED.iter().find(|(name, _)| path.as_os_str() == *name && !path.exists());
        let text = match shipped {
            Some((_, text)) => (*text).to_owned(),
            None if path.extension().is_none() && !path.exists() => {
                let names: Vec<&str> = SHIPPED.iter().map(|s| s.0).collect();
                let allowed = format!("a task file, or one of {}", names.join(", "));
                return Err(Error::bad(path.display().to_string(), "task", "no such file", allowed));
            }
            None => atomic::read_text(path, LARGEST)?,
        };
        let file = path.display().to_string();
        let mut task: Self =
            toml::from_str(&text).map_err(|e| Error::toml(&file, &text, &e, "the keys of models/README.md"))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        for p in [&mut task.photos, &mut task.calibration].into_iter().flatten() {
            *p = folder.join(&*p);
        }
        if let Some(Stated::File(path)) = &task.tolerances {
            task.tolerances = Some(Stated::read(&folder.join(path))?);
        }
        task.train.resolve(folder);
        let beside = folder.join(&task.lens);
        if beside.is_file() || MeasuredLens::is_at(&beside) {
            task.lens = beside.display().to_string();
        }
        task.check(&file)?;
        Ok(task)
    }

    /// Refuses a task that cannot be run; `file` is named in the error.
    pub fn check(&self, file: &str) -> Result<()> {
        let bad = |place: &str, found: String, allowed: &str| Err(Error::bad(file, place, found, allowed));
        if self.schema != SCHEMA {
            return bad("schema", self.schema.to_string(), "1");
        }
        if self.patch_px < 32 || !self.patch_px.is_multiple_of(4) || self.patch_px > 1024 {
            return bad("patch_px", self.patch_px.to_string(), "a multiple of 4 from 32 to 1024");
        }
        if !(1..=64).contains(&self.batch) {
            return bad("batch", self.batch.to_string(), "1 to 64");
        }
        if !(1..=10_000).contains(&self.scenes) {
            return bad("scenes", self.scenes.to_string(), "1 to 10000");
        }
        if self.steps.is_some() && self.minutes.is_some() {
            return bad("steps, minutes", "both".into(), "one of steps and minutes");
        }
        self.train.check(file)?;
        self.sweep.check(file)?;
        if let Some(m) = self.minutes
            && !(m > 0.0 && m < 1e6)
        {
            return bad("minutes", m.to_string(), "a positive number");
        }
        for (name, v) in [("lens_rate", self.lens_rate), ("network_rate", self.network_rate)] {
            if !(v > 0.0 && v < 1.0) {
                return bad(name, v.to_string(), "above 0, below 1");
            }
        }
        if self.asphere_power > 16 || self.asphere_power % 2 == 1 || self.asphere_power == 2 {
            return bad("asphere_power", self.asphere_power.to_string(), "0, or an even power from 4 to 16");
        }
        if self.search > 100_000 || self.search > 0 && !self.warm_start {
            return bad("search", self.search.to_string(), "at most 100000, and 0 where warm_start is false");
        }
        if !(self.lens_rate_um > 0.0 && self.lens_rate_um <= 1e4) {
            return bad("lens_rate_um", self.lens_rate_um.to_string(), "above 0, at most 10000");
        }
        let [from, to] = self.lens_share;
        if !(0.0 <= from && from < to && to <= 1.0) {
            return bad("lens_share", format!("{from}, {to}"), "[from, to], from 0 to 1");
        }
        if self.epochs > 10_000 {
            return bad("epochs", self.epochs.to_string(), "at most 10000");
        }
        if let Some(v) = self.least_illumination
            && !(0.0..1.0).contains(&v)
        {
            return bad("least_illumination", v.to_string(), "0 or more, below 1");
        }
        if self.depths_mm.len() > MOST_DEPTHS {
            return bad("depths_mm", format!("{} distances", self.depths_mm.len()), &format!("at most {MOST_DEPTHS}"));
        }
        if let Some(d) = self.depths_mm.iter().find(|d| d.is_nan() || **d <= 0.0) {
            return bad("depths_mm", d.to_string(), "positive distances; inf is allowed");
        }
        if !(1.0..=64.0).contains(&self.depth_power) {
            return bad("depth_power", self.depth_power.to_string(), "1 to 64");
        }
        if self.depth_power > 1.0 && self.depths_mm.len() < 2 {
            return bad("depth_power", self.depth_power.to_string(), "1 where depths_mm has fewer than two distances");
        }
        let twice = |d: &&f64| self.depths_mm.iter().filter(|other| other == d).count() > 1;
        if self.depth_power > 1.0
            && let Some(d) = self.depths_mm.iter().find(twice)
        {
            return bad("depths_mm", format!("{d} twice"), "each distance once beside depth_power");
        }
        if let Some(loss) = &self.sensor_loss {
            loss.check(&self.depths_mm, file)?;
            if self.depth_power > 1.0 {
                return bad("depth_power", self.depth_power.to_string(), "1 beside sensor_loss, which has weights");
            }
            if self.tolerances.is_some() {
                return bad("tolerances", "given".into(), "none beside sensor_loss, whose images are the lens's own");
            }
            if self.freeze_lens {
                return bad("freeze_lens", "true".into(), "false beside sensor_loss: nothing but the lens moves");
            }
            if self.inputs != Inputs::BARE {
                return bad(
                    "inputs",
                    "given".into(),
                    "none beside sensor_loss, which has no network; train.inputs may be given",
                );
            }
        }
        self.stated_tolerances().map_err(|e| e.in_file(Path::new(file)))?;
        let most = if self.tolerances.is_some() { MOST_DRAWS } else { 1 };
        if !(1..=most).contains(&self.worst_of) {
            return bad("worst_of", self.worst_of.to_string(), "1 to 64 beside tolerances, 1 without");
        }
        if self.keep_first > 0 && self.photos.is_none() {
            return bad("keep_first", self.keep_first.to_string(), "0 where no folder of photographs is named");
        }
        if self.checks > 1000 {
            return bad("checks", self.checks.to_string(), "at most 1000");
        }
        if !(0.0..=86_400.0).contains(&self.checkpoint_seconds) {
            return bad("checkpoint_seconds", self.checkpoint_seconds.to_string(), "0 to 86400");
        }
        self.parts(file).map(|_| ())
    }

    /// What lenses may be off by through which the design's pictures are taken.
    ///
    /// # Errors
    /// Keys that are none, values that are not allowed; a file that was not read.
    pub(crate) fn stated_tolerances(&self) -> Result<Option<Tolerances>> {
        self.tolerances.as_ref().map(Stated::tolerances).transpose()
    }

    /// Distances that the final network is for, mm: the training's own, or else the design's; none: the lens's.
    pub fn network_depths_mm(&self) -> &[f64] {
        if self.train.depths_mm.is_empty() { &self.depths_mm } else { &self.train.depths_mm }
    }

    /// How long the joint stage is.
    ///
    /// # Errors
    /// A task without `steps` and `minutes`: it has no joint stage.
    pub fn length(&self) -> Result<Length> {
        match (self.steps, self.minutes) {
            (Some(n), _) => Ok(Length::Steps(n as u64)),
            (None, Some(m)) => Ok(Length::Seconds(60.0 * m)),
            (None, None) => {
                Err(Error::bad("", "steps, minutes", "neither", "exactly one of steps and minutes for a joint design"))
            }
        }
    }

    /// What moves and is held in the joint stage, for `lens` on a frame whose corner sees `corner_deg` with so much `distortion`: where
    /// `optics` says nothing, the forms of refracting surfaces and all thicknesses, all light of the stop over the frame's field, a
    /// distortion within 8 % at its edge or near the lens's own. `file` names the task.
    ///
    /// # Errors
    /// Names and numbers that the lens does not allow.
    pub fn problem(&self, lens: &Lens, [corner_deg, distortion]: [f64; 2], file: &str) -> Result<Problem> {
        let lens = lens.changed(|l| l.field = Field::Angle(corner_deg))?;
        let mut spec = self.optics.clone();
        spec.apertures.get_or_insert_with(|| "automatic".to_owned());
        if spec.depths_mm.is_none() && !self.depths_mm.is_empty() {
            spec.depths_mm = Some(self.depths_mm.clone());
        }
        let mut free = Variables::refracting(&lens).parameters;
        // A term in the square bends as the curvature does.
        free.retain(|p| !(p.kind == Kind::Even && p.entry == 0 && p.value(&*lens) == Some(0.0)));
        let mut problem = spec.problem_varying(&lens, free, file)?;
        // What the frame sees stays what it is: left alone, lenses buy sharpness by barrels that see ever more.
        let outermost = problem.merit.fields.len() - 1;
        if !spec.constraints.contains_key("distortion")
            && !spec.targets.contains_key("distortion")
            && distortion.is_finite()
        {
            let bounds = [(-BARREL).min(distortion - SLACK), BARREL.max(distortion + SLACK)];
            problem.constraints.push(Constraint { quantity: Quantity::Distortion(outermost), bounds });
        }
        Ok(problem)
    }

    /// The task of a run's folder, with the run's lens as it is now.
    ///
    /// # Errors
    /// As [`Task::load`]; a folder without a lens, or with one that is not its checkpoint's.
    pub fn of_run(folder: &Path) -> Result<Self> {
        let lens = Subject::measured_in(folder).unwrap_or_else(|| folder.join("lens.toml"));
        if !lens.exists() {
            let allowed =
                "a run of `isoplanat design` or `train`, which has a lens.toml or the folder of a measured lens";
            return Err(Error::bad(folder.display().to_string(), "lens.toml", "missing", allowed));
        }
        require_agreement(folder)?;
        let task = Self::load(&folder.join(MARKER))?;
        Ok(Self { lens: lens.display().to_string(), ..task })
    }

    /// The task as a file that means the same anywhere: paths in full.
    ///
    /// # Errors
    /// A working folder that cannot be asked for.
    pub fn to_toml(&self) -> Result<String> {
        let mut task = self.clone();
        let full = |p: &mut PathBuf| -> Result<()> {
            *p = std::path::absolute(&*p).map_err(|e| Error::reading(p, e))?;
            Ok(())
        };
        for p in [&mut task.photos, &mut task.calibration, &mut task.train.start, &mut task.train.vgg] {
            p.as_mut().map_or(Ok(()), full)?;
        }
        if Path::new(&task.lens).exists() {
            let mut path = PathBuf::from(&task.lens);
            full(&mut path)?;
            task.lens = path.display().to_string();
        }
        toml::to_string(&task).map_err(|e| Error::Internal(format!("task: {e}")))
    }

    /// What stands before the sensor: the lens on the task's raster, or a measured one on its own.
    ///
    /// # Errors
    /// A lens that cannot be read; a measured one with a raster or with terms that may move.
    pub fn subject(&self, glasses: &Glasses) -> Result<Subject> {
        let folder = Path::new(&self.lens);
        if !MeasuredLens::is_at(folder) {
            return Ok(self.lens(glasses)?.into());
        }
        let beside = [
            ("sensor", self.sensor.map(|s| format!("{} x {} pixels", s.columns, s.rows))),
            ("asphere_power", (self.asphere_power > 0).then(|| self.asphere_power.to_string())),
        ];
        if let Some((key, Some(found))) = beside.into_iter().find(|(_, found)| found.is_some()) {
            let allowed = format!(
                "nothing beside {}, which was measured: it has its pictures' raster and no surfaces",
                self.lens
            );
            return Err(Error::bad(MARKER, key, found, allowed));
        }
        Ok(Subject::Measured(Box::new(MeasuredLens::load(folder)?)))
    }

    /// The lens, on the task's raster.
    ///
    /// # Errors
    /// A lens that cannot be read; one that was measured, which has no surfaces.
    pub fn lens(&self, glasses: &Glasses) -> Result<Lens> {
        if MeasuredLens::is_at(Path::new(&self.lens)) {
            let allowed = "a lens with a prescription; `isoplanat train` takes measured ones";
            return Err(Error::bad(&self.lens, "lens", "a measured lens, which has no surfaces to move", allowed));
        }
        let lens = interchange::lens_or_file(&self.lens, glasses, Reading::default())?.lens;
        require_clear(&lens, &self.lens)?;
        let lens = self.with_terms(&lens)?;
        let Some(TaskSensor { columns, rows, pitch_um, axis_px }) = self.sensor else { return Ok(lens) };
        #[expect(clippy::cast_precision_loss, reason = "a raster's size")]
        let centre = [columns as f64 / 2.0, rows as f64 / 2.0];
        let raster = SensorRaster { columns, rows, pitch_um, axis_px: axis_px.unwrap_or(centre) };
        Lens::new(Prescription { sensor: raster, ..(*lens).clone() }, &self.lens)
    }

    /// `lens` with the asphere terms that may move.
    pub(super) fn with_terms(&self, lens: &Lens) -> Result<Lens> {
        let n = lens.indices(lens.wavelengths.primary_nm);
        lens.changed(|l| {
            for (_, s) in l.surfaces.iter_mut().enumerate().filter(|(i, _)| n[*i] != n[*i + 1]) {
                let terms = (self.asphere_power / 2).max(s.shape.asphere.len());
                s.shape.asphere.resize(terms, 0.0);
            }
        })
    }

    /// The sensor's calibration.
    pub fn sensor(&self) -> Result<Sensor> {
        self.calibration.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)
    }

    /// The textures to train on.
    pub fn textures(&self) -> Result<Textures> {
        match &self.photos {
            Some(folder) => Textures::photos_from(folder, self.keep_first),
            None => Ok(Textures::built_in(self.seed.wrapping_mul(1000), self.scenes, TEXTURE)),
        }
    }

    /// Pictures that the design is judged by and does not train on: the photographs that are kept, at most two dozen, or built-in scenes
    /// of a kind that training never draws from.
    ///
    /// # Errors
    /// Photographs that cannot be read.
    pub fn held_out(&self) -> Result<Textures> {
        match &self.photos {
            Some(folder) if self.keep_first > 0 => Textures::photos_of(folder, 0, self.keep_first.min(24)),
            _ => Ok(Textures::unseen(self.seed.wrapping_mul(1000) ^ 0x6865_6c64, 8, TEXTURE)),
        }
    }
}
