//! A design task as a TOML file: which lens, on which sensor, trained on what, for how long.
//!
//! `groups` are its tables, [`train`], [`sweep`] and [`stages`] those of the final network, of many designs and of several in a row; `check` says what they may hold,
//! `flat` reads files of schema 1, which had one table.

mod check;
mod flat;
mod groups;
#[doc(hidden)]
pub mod stages;
#[doc(hidden)]
pub mod stated;
#[doc(hidden)]
pub mod sweep;
#[doc(hidden)]
pub mod train;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::design::bound::require_agreement;
use crate::design::data::{TEXTURE, Textures};
use crate::design::folder::MARKER;
use crate::design::schedule::Length;
use crate::design::subject::Subject;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result, plain};
use isoplanat_imaging::calibrate::lens::MeasuredLens;
use isoplanat_imaging::render::Diffraction;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;
use isoplanat_optics::interchange::{self, Reading};
use isoplanat_optics::lens::catalogue::Glasses;
use isoplanat_optics::lens::variables::Variables;
use isoplanat_optics::lens::{Field, Kind, Lens, Prescription, SensorRaster};
use isoplanat_optics::optimize::Problem;
use isoplanat_optics::optimize::spec::Spec;
use isoplanat_optics::psf::corner::distortion_held;
use isoplanat_optics::trace::rims::require_clear;
use stated::Stated;

pub use sweep::SweepTask;
pub use train::{TrainBudget, TrainLoss, TrainNetwork, TrainPairs, TrainTask};

pub use groups::{Budget, FrameTask, LensTask, LossTask, NetworkTask, PictureTask, TaskSensor};
pub use isoplanat_models::TASKS as SHIPPED;

/// The form of task files that this program writes; it reads those of schemas 1 and 2 as well, whose pictures are of rays where they say nothing of diffraction.
pub(crate) const SCHEMA: u32 = 3;

/// Bytes of a task at most.
const LARGEST: u64 = 1 << 20;

/// What is said to be allowed where a key or a value is none.
const ALLOWED: &str = "the keys of models/README.md";

/// A task; every key but `schema` and `lens.file` has a default.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Form of the file: 3.
    pub schema: u32,
    /// Seed of every draw.
    #[serde(default = "first")]
    pub seed: u64,
    /// Which lens, and how it moves.
    #[serde(default)]
    pub lens: LensTask,
    /// The sensor.
    #[serde(default)]
    pub frame: FrameTask,
    /// What the joint stage takes pictures of.
    #[serde(default)]
    pub pictures: PictureTask,
    /// Its network.
    #[serde(default)]
    pub network: NetworkTask,
    /// What it makes small.
    #[serde(default)]
    pub loss: LossTask,
    /// How long it is.
    #[serde(default)]
    pub budget: Budget,
    /// What moves, in which bounds, what is held: the keys of `isoplanat optimize --merit`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub optics: Spec,
    /// Designs that come before this one, each from the lens of the one before: what is different in them ([`stages`]).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages: Vec<toml::Table>,
    /// What differs between the designs of a sweep (`isoplanat sweep`).
    #[serde(default, skip_serializing_if = "no_sweep")]
    pub sweep: SweepTask,
    /// The final network for the finished lens (`isoplanat train`).
    #[serde(default)]
    pub train: TrainTask,
    /// Where it was read.
    #[serde(skip)]
    origin: Origin,
}

/// The file of a task, and whether its words are those of schema 1.
#[derive(Clone, Debug, Default)]
struct Origin {
    file: String,
    is_flat: bool,
}

fn first() -> u64 {
    1
}
fn no_sweep(sweep: &SweepTask) -> bool {
    *sweep == SweepTask::default()
}
fn is_default(spec: &Spec) -> bool {
    *spec == Spec::default()
}

/// Whether a task's table says how diffraction enters its pictures.
fn says_of_diffraction(table: &toml::Table) -> bool {
    table.get("pictures").and_then(|p| p.get("diffraction")).is_some()
}

/// Puts a value under its dotted key.
fn put(table: &mut toml::Table, key: &str, value: toml::Value) {
    match key.split_once('.') {
        None => drop(table.insert(key.to_owned(), value)),
        Some((group, rest)) => {
            if let toml::Value::Table(inner) = table.entry(group).or_insert_with(|| toml::Table::new().into()) {
                put(inner, rest, value);
            }
        }
    }
}

impl Task {
    /// A task for a lens file or a shipped lens, with every other key left out.
    pub fn new(lens: impl Into<String>) -> Self {
        Self {
            schema: SCHEMA,
            seed: first(),
            lens: LensTask { file: lens.into(), ..LensTask::default() },
            frame: FrameTask::default(),
            pictures: PictureTask::default(),
            network: NetworkTask::default(),
            loss: LossTask::default(),
            budget: Budget::default(),
            optics: Spec::default(),
            stages: Vec::new(),
            sweep: SweepTask::default(),
            train: TrainTask::default(),
            origin: Origin::default(),
        }
    }

    /// The demo's task: the two-element lens on a quadrant sensor of 960 × 640 pixels of 20 µm.
    pub fn demo() -> Self {
        let mut task = Self::new("two_element");
        task.frame.raster = Some(TaskSensor { columns: 960, rows: 640, pitch_um: 20.0, axis_px: Some([0.0, 0.0]) });
        task
    }

    /// A task from the text of a file of any schema that this program reads; paths stay as they are stated, values are not checked. `file` is named in errors.
    fn parse(text: &str, file: &str) -> Result<Self> {
        let table: toml::Table = toml::from_str(text).map_err(|e| Error::toml(file, text, &e, ALLOWED))?;
        let (schema, says) = (table.get("schema").cloned(), says_of_diffraction(&table));
        let (mut task, is_flat) = match schema {
            Some(toml::Value::Integer(1)) => (flat::parse(table, text, file)?, true),
            Some(toml::Value::Integer(2 | 3)) => {
                flat::refuse_strays(&table, text, file)?;
                (
                    isoplanat_base::exact::from_toml::<Self>(text).map_err(|e| Error::toml(file, text, &e, ALLOWED))?,
                    false,
                )
            }
            other => {
                let found = other.map_or_else(|| "none".to_owned(), |v| v.to_string());
                return Err(Error::bad(file, "schema", found, "1, 2 or 3"));
            }
        };
        if task.schema < SCHEMA || is_flat {
            task.schema = SCHEMA;
            if !says {
                task.pictures.diffraction = Diffraction::Off;
            }
        }
        task.origin = Origin { file: file.to_owned(), is_flat };
        Ok(task)
    }

    /// A task of tables that hold it; else the key whose value is none, and why.
    fn of_tables(table: toml::Table) -> Result<Self, (String, String)> {
        let refused =
            |e: serde_path_to_error::Error<toml::de::Error>| (e.path().to_string(), plain(e.inner().message()));
        serde_path_to_error::deserialize(toml::Value::Table(table)).map_err(refused)
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
        let mut task = Self::parse(&text, &file)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        for p in [&mut task.pictures.photos, &mut task.frame.calibration].into_iter().flatten() {
            *p = folder.join(&*p);
        }
        if let Some(Stated::File(path)) = &task.lens.tolerances {
            task.lens.tolerances = Some(Stated::read(&folder.join(path))?);
        }
        task.train.resolve(folder);
        let beside = folder.join(&task.lens.file);
        if !task.lens.file.is_empty() && (beside.is_file() || MeasuredLens::is_at(&beside)) {
            task.lens.file = beside.display().to_string();
        }
        task.check(&file).map_err(|e| task.in_its_words(e))?;
        Ok(task)
    }

    /// An error about one of its keys: of the file that it was read from, where it names none, and in the words of that file.
    pub(super) fn in_its_words(&self, error: Error) -> Error {
        let Origin { file, is_flat } = &self.origin;
        let error = if *is_flat { flat::in_its_words(error) } else { error };
        if file.is_empty() { error } else { error.in_file(file) }
    }

    /// What lenses may be off by through which the design's pictures are taken.
    ///
    /// # Errors
    /// Keys that are none, values that are not allowed; a file that was not read.
    pub(crate) fn stated_tolerances(&self) -> Result<Option<Tolerances>> {
        self.lens.tolerances.as_ref().map(Stated::tolerances).transpose()
    }

    /// Distances that the final network is for, mm: the training's own, or else the design's; none: the lens's.
    pub fn network_depths_mm(&self) -> &[f64] {
        let own = &self.train.pairs.depths_mm;
        if own.is_empty() { &self.pictures.depths_mm } else { own }
    }

    /// How long the joint stage is.
    ///
    /// # Errors
    /// A task without `steps` and `minutes`: it has no joint stage.
    pub fn length(&self) -> Result<Length> {
        match (self.budget.steps, self.budget.minutes) {
            (Some(n), _) => Ok(Length::Steps(n as u64)),
            (None, Some(m)) => Ok(Length::Seconds(60.0 * m)),
            (None, None) => {
                let allowed = "exactly one of steps and minutes for a joint design";
                Err(self.in_its_words(Error::bad("", "budget.steps, budget.minutes", "neither", allowed)))
            }
        }
    }

    /// What moves and is held in the joint stage, for `lens` on a frame whose corner sees `corner_deg` with so much `distortion`: where
    /// `optics` says nothing, the forms of refracting surfaces and all thicknesses, all light of the stop over the frame's field (in a lens that vignettes what it lets through), a
    /// distortion within 8 % at its edge or near the lens's own. `file` names the task.
    ///
    /// # Errors
    /// Names and numbers that the lens does not allow.
    pub fn problem(&self, lens: &Lens, [corner_deg, distortion]: [f64; 2], file: &str) -> Result<Problem> {
        let lens = lens.changed(|l| l.field = Field::Angle(corner_deg))?;
        let mut spec = self.optics.clone();
        if spec.depths_mm.is_none() && !self.pictures.depths_mm.is_empty() {
            spec.depths_mm = Some(self.pictures.depths_mm.clone());
        }
        let mut free = Variables::refracting(&lens).parameters;
        // A term in the square bends as the curvature does.
        free.retain(|p| !(p.kind == Kind::Even && p.entry == 0 && p.value(&*lens) == Some(0.0)));
        let mut problem = spec.problem_varying(&lens, free, file)?;
        let stated = spec.constraints.contains_key("distortion") || spec.targets.contains_key("distortion");
        if !stated {
            problem.constraints.extend(distortion_held(distortion, problem.merit.fields.len() - 1));
        }
        Ok(if spec.apertures.is_some() { problem } else { problem.following_beam() })
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
        let mut task = task;
        task.lens.file = lens.display().to_string();
        Ok(task)
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
        let (start, vgg) = (&mut task.train.start, &mut task.train.loss.vgg);
        for p in [&mut task.pictures.photos, &mut task.frame.calibration, start, vgg] {
            p.as_mut().map_or(Ok(()), full)?;
        }
        if Path::new(&task.lens.file).exists() {
            let mut path = PathBuf::from(&task.lens.file);
            full(&mut path)?;
            task.lens.file = path.display().to_string();
        }
        toml::to_string(&task).map_err(|e| Error::Internal(format!("task: {e}")))
    }

    /// What stands before the sensor: the lens on the task's raster, or a measured one on its own.
    ///
    /// # Errors
    /// A lens that cannot be read; a measured one with a raster or with terms that may move.
    pub fn subject(&self, glasses: &Glasses) -> Result<Subject> {
        let folder = Path::new(&self.lens.file);
        if !MeasuredLens::is_at(folder) {
            return Ok(self.lens(glasses)?.into());
        }
        let beside = [
            ("frame.raster", self.frame.raster.map(|s| format!("{} x {} pixels", s.columns, s.rows))),
            ("lens.asphere_power", (self.lens.asphere_power > 0).then(|| self.lens.asphere_power.to_string())),
        ];
        if let Some((key, Some(found))) = beside.into_iter().find(|(_, found)| found.is_some()) {
            let allowed = format!(
                "nothing beside {}, which was measured: it has its pictures' raster and no surfaces",
                self.lens.file
            );
            return Err(self.in_its_words(Error::bad("", key, found, allowed)));
        }
        Ok(Subject::Measured(Box::new(MeasuredLens::load(folder)?)))
    }

    /// The lens, on the task's raster.
    ///
    /// # Errors
    /// A lens that cannot be read; one that was measured, which has no surfaces.
    pub fn lens(&self, glasses: &Glasses) -> Result<Lens> {
        if MeasuredLens::is_at(Path::new(&self.lens.file)) {
            let allowed = "a lens with a prescription; `isoplanat train` takes measured ones";
            return Err(Error::bad(
                &self.lens.file,
                "lens.file",
                "a measured lens, which has no surfaces to move",
                allowed,
            ));
        }
        let lens = interchange::lens_or_file(&self.lens.file, glasses, Reading::default())?.lens;
        require_clear(&lens, &self.lens.file)?;
        let lens = self.with_terms(&lens)?;
        let Some(TaskSensor { columns, rows, pitch_um, axis_px }) = self.frame.raster else { return Ok(lens) };
        #[expect(clippy::cast_precision_loss, reason = "a raster's size")]
        let centre = [columns as f64 / 2.0, rows as f64 / 2.0];
        let raster = SensorRaster { columns, rows, pitch_um, axis_px: axis_px.unwrap_or(centre) };
        Lens::new(Prescription { sensor: raster, ..(*lens).clone() }, &self.lens.file)
    }

    /// `lens` with the asphere terms that may move.
    pub(super) fn with_terms(&self, lens: &Lens) -> Result<Lens> {
        let n = lens.indices(lens.wavelengths.primary_nm);
        lens.changed(|l| {
            for (_, s) in l.surfaces.iter_mut().enumerate().filter(|(i, _)| n[*i] != n[*i + 1]) {
                let terms = (self.lens.asphere_power / 2).max(s.shape.asphere.len());
                s.shape.asphere.resize(terms, 0.0);
            }
        })
    }

    /// The sensor's calibration.
    pub fn sensor(&self) -> Result<Sensor> {
        self.frame.calibration.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)
    }

    /// The textures to train on.
    pub fn textures(&self) -> Result<Textures> {
        match &self.pictures.photos {
            Some(folder) => Textures::photos_from(folder, self.pictures.keep_first),
            None => Ok(Textures::built_in(self.seed.wrapping_mul(1000), self.pictures.scenes, TEXTURE)),
        }
    }

    /// Pictures that the design is judged by and does not train on: the photographs that are kept, at most two dozen, or built-in scenes
    /// of a kind that training never draws from.
    ///
    /// # Errors
    /// Photographs that cannot be read.
    pub fn held_out(&self) -> Result<Textures> {
        match &self.pictures.photos {
            Some(folder) if self.pictures.keep_first > 0 => {
                Textures::photos_of(folder, 0, self.pictures.keep_first.min(24))
            }
            _ => Ok(Textures::unseen(self.seed.wrapping_mul(1000) ^ 0x6865_6c64, 8, TEXTURE)),
        }
    }
}
