//! All of a data set: its folder, its units, what was there already.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::product;
use isoplanat_imaging::files::picture_size;
use isoplanat_imaging::scene::detail::{deciding, detail};
use isoplanat_imaging::scene::photos::Photos;
use isoplanat_imaging::scene::placement::texels_that_fill;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::psf::Model;
use rayon::prelude::*;
use serde::Serialize;

use super::folder::{TABLE, description, is_there, opened};
use super::layout::{Layout, Unit, drawn};
use super::pair::{Pair, Place, made};
use super::record::{COLUMNS, Judged, Record, Row, Written};
use super::settings::Settings;
use super::stage::Stage;
use super::write::write;
use crate::report::columns::csv;

/// A lens at a distance as it was planned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Planned {
    /// Name of the lens.
    pub lens: String,
    /// Object distance, mm; none is infinity.
    pub distance_mm: Option<f64>,
    /// Seconds.
    pub seconds: f64,
    /// By what its captures' kernels are made.
    pub diffraction: Model,
    /// Predicted PSNR, dB.
    pub predicted_psnr_db: Option<f64>,
    /// Whether what is asked for is predicted to hold.
    pub holds: bool,
    /// What is not known of its rays; nothing where they are told.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub untold: Option<String>,
}

/// What was done.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// Pairs of the whole data set.
    pub pairs: usize,
    /// Pairs that were made now.
    pub made: usize,
    /// Pairs of this part that were whole already.
    pub kept: usize,
    /// Units of the folder whose files or records were found damaged and that were made again.
    pub damaged: usize,
    /// Whether all parts are whole: `pairs.csv` is there.
    pub complete: bool,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Lenses that were planned now.
    pub planned: Vec<Planned>,
    /// Lines of all pairs where all are whole, otherwise of this part.
    pub rows: Vec<Row>,
}

impl Made {
    /// Judged pairs, how many of them hold `db` ([`Judged::holds`]), and the mean of their errors.
    pub fn verdict(&self, db: f64) -> Option<([usize; 2], Judged)> {
        let judged: Vec<Judged> = self.rows.iter().filter_map(|r| r.judged).collect();
        let held = judged.iter().filter(|j| j.holds(db)).count();
        Judged::mean(&judged).map(|mean| ([judged.len(), held], mean))
    }
}

/// Makes a data set, or its part, in `folder`; what is whole there stays. `watch` hears the share that is done and what is worked on, from any thread: an
/// empty text until the photographs have been read once and the first lens is planned, when nothing has been written. Where it returns `false` the work ends with [`Error::Interrupted`] after the pairs that are under way.
///
/// # Errors
/// Settings that mean nothing; photographs or lenses that cannot be used; a folder of something else, or of other settings; too much memory; what the
/// disk says; an end that was asked for.
pub fn make(settings: &Settings, folder: &Path, watch: &(dyn Fn(f64, &str) -> bool + Sync)) -> Result<Made> {
    let clock = Instant::now();
    settings.check()?;
    let photos = Photos::open(&settings.photos)?;
    let density = SpectralDensity::under(&settings.sensor, settings.illuminant)?;
    for (name, lens) in &settings.lenses {
        density.require(lens).map_err(|e| e.in_file(name))?;
    }
    let sizes = photos.paths().par_iter().map(|path| picture_size(path)).collect::<Result<Vec<_>>>()?;
    let most = |k: usize| sizes.iter().map(|s| s[k]).max().unwrap_or(0);
    let work = Work {
        settings,
        photos: &photos,
        density: &density,
        folder,
        layout: layout(settings, photos.len())?,
        texels: [most(0), most(1)],
        watch,
        ended: AtomicBool::new(false),
    };
    work.done(clock)
}

/// The numbers of a data set.
fn layout(settings: &Settings, photos: usize) -> Result<Layout> {
    let crops = settings.crops.map_or(1, |c| c.count);
    let mut pixels = 0;
    for lens in 0..settings.lenses.len() {
        let (_, frame) = settings.before(lens, 0)?;
        let [columns, rows] = settings.crops.map_or([frame.columns, frame.rows], |c| c.size);
        pixels = pixels.max(columns * rows);
    }
    let together = settings.form.together(settings.shard, crops, pixels);
    Ok(Layout { lenses: settings.lenses.len(), distances: settings.distances(), photos, crops, together })
}

/// A data set under way.
struct Work<'a> {
    settings: &'a Settings,
    photos: &'a Photos,
    density: &'a SpectralDensity,
    folder: &'a Path,
    layout: Layout,
    /// Most rows and columns of a photograph.
    texels: [usize; 2],
    watch: &'a (dyn Fn(f64, &str) -> bool + Sync),
    ended: AtomicBool,
}

impl Work<'_> {
    fn done(&self, clock: Instant) -> Result<Made> {
        let text = description(self.settings, self.photos, &self.layout)?;
        let mut there = is_there(self.settings, self.folder, &text)?;
        let units: Vec<Unit> = self.layout.part(self.settings.part).map(|u| self.layout.unit(u)).collect();
        let pairs_of = |u: &Unit| u.photos.len() * self.layout.crops;
        let count: usize = units.iter().map(pairs_of).sum();
        let whole = |unit: &Unit| self.state(unit);
        let states: Vec<State> = if there { units.par_iter().map(whole).collect() } else { Vec::new() };
        let is_whole = |k: usize| states.get(k) == Some(&State::Whole);
        let damaged = states.iter().filter(|s| **s == State::Damaged).count();
        let left: Vec<Unit> =
            units.iter().enumerate().filter(|(k, _)| !is_whole(*k)).map(|(_, unit)| unit.clone()).collect();
        let to_make: usize = left.iter().map(pairs_of).sum();
        self.readable(&left)?;
        let deciding = if left.is_empty() { Vec::new() } else { self.deciding()? };
        let ticks = AtomicUsize::new(0);
        let tick = |what: &str| {
            let now = ticks.fetch_add(1, Ordering::Relaxed);
            self.go_on(now as f64 / to_make.max(1) as f64, what)
        };
        let drawn = drawn(self.settings.seed, self.layout.pairs(), self.settings.judging.share);
        let mut planned = Vec::new();
        for units in left.chunk_by(|a, b| a.group == b.group) {
            let (lens, distance) = self.layout.of_group(units[0].group);
            let done = ticks.load(Ordering::Relaxed) as f64 / to_make.max(1) as f64;
            let what = format!("plan {}", self.settings.lenses[lens].0);
            self.go_on(done, if planned.is_empty() { "" } else { &what })?;
            let stage = Stage::planned(self.settings, self.photos, self.density, &deciding, (lens, distance))?;
            let at_once = self.at_once(&stage, units)?;
            planned.push(Planned {
                lens: stage.name().to_owned(),
                distance_mm: stage.distance_mm(),
                seconds: stage.seconds,
                diffraction: stage.plan.renderer.optics.spec.diffraction,
                predicted_psnr_db: stage.plan.predicted_db.filter(|db| db.is_finite()),
                holds: stage.plan.holds,
                untold: stage.plan.renderer.plan.table_error.untold(stage.plan.renderer.plan.frame.pitch_mm),
            });
            // A lens that cannot be planned leaves nothing behind.
            if !there {
                opened(self.settings, self.folder, &text)?;
                there = true;
            }
            for some in units.chunks(at_once) {
                some.par_iter().try_for_each(|unit| self.unit(&stage, unit, &drawn, &tick))?;
            }
        }
        let complete = (0..self.layout.units()).all(|unit| Record::is_there(self.folder, unit));
        let numbers: Vec<usize> =
            if complete { (0..self.layout.units()).collect() } else { units.iter().map(|u| u.number).collect() };
        let rows = self.rows(&numbers)?;
        if complete {
            atomic::write_bytes(&self.folder.join(TABLE), csv(&COLUMNS, &rows).as_bytes())?;
        }
        let seconds = clock.elapsed().as_secs_f64();
        let (pairs, kept) = (self.layout.pairs(), count - to_make);
        Ok(Made { pairs, made: to_make, kept, damaged, complete, seconds, planned, rows })
    }

    /// Tells how far it is.
    ///
    /// # Errors
    /// An end that is asked for.
    fn go_on(&self, share: f64, what: &str) -> Result<()> {
        if !(self.watch)(share, what) {
            self.ended.store(true, Ordering::Relaxed);
        }
        if self.ended.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// What there is of a unit.
    fn state(&self, unit: &Unit) -> State {
        match Record::read(self.folder, unit.number) {
            Some(record) if record.holds(self.folder) => State::Whole,
            Some(_) => State::Damaged,
            None if Record::is_there(self.folder, unit.number) => State::Damaged,
            None => State::Missing,
        }
    }

    /// Reads every photograph of `units` once: what is no picture is found before anything is written.
    fn readable(&self, units: &[Unit]) -> Result<()> {
        let mut photos: Vec<usize> = units.iter().flat_map(|u| u.photos.clone()).collect();
        photos.sort_unstable();
        photos.dedup();
        photos.par_iter().try_for_each(|photo| {
            self.go_on(0.0, "")?;
            self.photos.load(*photo).map(drop)
        })
    }

    /// Photographs that every lens is planned with: those that show the most detail on the first lens's frame.
    fn deciding(&self) -> Result<Vec<usize>> {
        let (_, frame) = self.settings.before(0, 0)?;
        deciding(self.photos.len(), |photo| {
            self.go_on(0.0, "")?;
            let texture = self.photos.load(photo)?;
            let (_, rows, cols) = texture.dim();
            let texels = self.settings.texels_per_pixel.unwrap_or_else(|| texels_that_fill([rows, cols], &frame));
            Ok(detail(&texture, texels))
        })
    }

    /// Units that are worked on at once, as memory allows.
    fn at_once(&self, stage: &Stage<'_>, units: &[Unit]) -> Result<usize> {
        let Settings { crops, judging, memory, .. } = self.settings;
        let [columns, rows] = crops.map_or([stage.frame.columns, stage.frame.rows], |c| c.size);
        let pairs = units.iter().map(|u| u.photos.len()).max().unwrap_or(1) * self.layout.crops;
        let kept =
            product(&[pairs, if self.settings.form.has_shards() { 12 } else { 6 }, columns, rows, size_of::<f32>()]);
        let rays = if judging.share > 0.0 { product(&[2, columns, rows, 3 * 6, size_of::<f32>()]) } else { 0 };
        let each = stage.plan.bytes(self.texels).saturating_add(kept).saturating_add(rays);
        let what = format!("pairs of {columns} × {rows} pixels");
        let instead = "a smaller frame (--columns, --rows), crops (--crop), smaller shards (--shard) or photographs";
        memory.allow(&what, each, instead)?;
        let fitting = usize::try_from(memory.bytes / each.max(1)).unwrap_or(usize::MAX);
        Ok(fitting.min(rayon::current_num_threads()).max(1))
    }

    /// Makes a unit: its pairs, its files, its record.
    fn unit(&self, stage: &Stage<'_>, unit: &Unit, drawn: &[bool], tick: &Tick<'_>) -> Result<()> {
        let form = self.settings.form;
        let mut pairs: Vec<Pair> = Vec::new();
        for photo in unit.photos.clone() {
            let texture = self.photos.load(photo)?;
            for crop in 0..self.layout.crops {
                tick(stage.name())?;
                let pair = self.layout.number(unit.group, photo, crop);
                let place = if form.has_shards() { pairs.len() } else { 0 };
                let files = form.files(pair, unit.number);
                let named = |e: Error| e.in_file(&self.photos.paths()[photo]);
                let place = Place { pair, photo, crop, files, place, judged: drawn[pair] };
                pairs.push(made(stage, place, &texture).map_err(named)?);
            }
        }
        let names = write(form, self.folder, unit.number, &pairs)?;
        let files = names.iter().map(|name| Written::of(self.folder, name)).collect::<Result<_>>()?;
        Record { rows: pairs.into_iter().map(|p| p.row).collect(), files }.write(self.folder, unit.number)
    }

    /// The lines of units, in their order.
    fn rows(&self, units: &[usize]) -> Result<Vec<Row>> {
        let of = |unit: &usize| {
            let place = || self.folder.join("records").join(format!("{unit:05}.json")).display().to_string();
            let allowed = "the record of a unit, as it was written; the same command makes it again";
            Record::read(self.folder, *unit)
                .map(|r| r.rows)
                .ok_or_else(|| Error::bad(place(), "record", "none that can be read", allowed))
        };
        Ok(units.iter().map(of).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
    }
}

/// Counts a pair that is begun.
type Tick<'a> = dyn Fn(&str) -> Result<()> + Sync + 'a;

/// What there is of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Whole,
    Damaged,
    Missing,
}
