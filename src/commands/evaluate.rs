//! `isoplanat evaluate RUN/`: PSNR, SSIM and colour of a run over field and depth.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::design::evaluate::{
    Built, FINENESS, Judge, Pictures, Retrain, Settings, Sheet, TEXELS_PER_PIXEL, evaluate, measured,
};
use isoplanat::design::opened::Run;
use isoplanat::design::subject::Subject;
use isoplanat::design::task::Task;
use isoplanat::design::{folder, memory};
use isoplanat::imaging::files::write_png8;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::scene::photos::Photos;
use isoplanat::imaging::scene::{SceneKind, TRAINING};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::network::Reconstructor;
use isoplanat::psf::Model;
use isoplanat::report::comparison::EdgesAt;
use isoplanat::report::evaluation::Evaluation;
use isoplanat::report::measured::Settings as EdgeSettings;
use isoplanat::report::paired;
use isoplanat::report::table::{significant, value};
use isoplanat::report::verdict::Verdict;
use isoplanat::terminal::{in_line, path_in_line};
use isoplanat::{Error, Result, atomic};

use crate::output::Common;
use crate::progress::Bar;
use crate::{output, tolerance};

/// Built-in scenes without `--photos`.
const SCENES: usize = 8;

/// The file that makes a folder one of sheets.
const MARKER: &str = "sheets.txt";

/// PSNR, SSIM and colour (ΔE 2000) of capture and reconstruction by field and depth, on pictures the run was not trained on.
///
/// Both are compared with the ideal picture as seen: sRGB-encoded, range 1. A margin of the network's receptive radius (at most
/// 64 pixels) around each patch is captured and restored with it and then cut off, so that no patch has a border.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Run folder: task.toml, lens.toml (or lens/, measured), network.safetensors.
    run: PathBuf,
    #[command(flatten)]
    protocol: Protocol,
    /// Lens file, shipped lens or folder of a measured lens that captures are made through, in place of the run's own lens, which still says what the
    /// ideal picture is and what light is divided out: how good a network is behind a lens that is not quite the one it was trained for.
    #[arg(long, value_name = "LENS")]
    through: Option<crate::named::Named>,
    /// Another run, judged on the same pictures at the same places: differences picture by picture, with 95 % intervals.
    #[arg(long, value_name = "RUN")]
    against: Option<PathBuf>,
    /// Folder of drawn lenses (`isoplanat tolerance --lenses`): PSNR of captures by rays through each of them, and behind the run's network, as they stand
    /// and after centre and scale of their pictures were aligned. Needs --reference.
    #[arg(long, value_name = "DIR", requires = "reference", conflicts_with_all = ["through", "against", "plot", "pictures"])]
    drawn: Option<PathBuf>,
    /// Trains a copy of the network on for each drawn lens, so many steps on 48 captures by rays through it of the run's own pictures, and judges that too:
    /// what a camera that is calibrated by itself reaches.
    #[arg(long, value_name = "STEPS", requires = "drawn", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    retrain: Option<u64>,
    /// Rows to write as comma-separated values.
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Plot to write: PSNR over the field.
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
    /// Folder for sheets, one a zone and depth: truth, capture, Wiener filter and reconstruction of the first four pictures.
    #[arg(long, value_name = "OUT_DIR")]
    pictures: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// On what and how a camera is judged.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Protocol {
    /// Folder of photographs; built-in scenes where left out.
    #[arg(long, value_name = "DIR", conflicts_with = "scene")]
    pub(crate) photos: Option<PathBuf>,
    /// Kind of built-in scenes; color_chart judges colour.
    #[arg(long, value_name = "KIND", default_value = "facades", value_parser = kind)]
    scene: SceneKind,
    /// Zones of equal width in image height, axis to corner.
    #[arg(long, default_value_t = 5)]
    fields: usize,
    /// Zones of equal steps of half field angle in the object's space out to this, in place of image height out to the corner.
    #[arg(long, value_name = "DEG")]
    to_degrees: Option<f64>,
    /// Half field angles to which means are taken beside the one over all zones, comma-separated.
    #[arg(long, value_delimiter = ',', value_name = "DEG,…")]
    means_degrees: Vec<f64>,
    /// Distances of the scene, comma-separated (`inf` allowed); those that the run's task states, or else the lens's own, where left out.
    #[arg(long, value_delimiter = ',', value_name = "MM,…")]
    pub(crate) depths_mm: Vec<f64>,
    /// Side of a patch, pixels; a zone too narrow gets half of it.
    #[arg(long, default_value_t = 256, value_name = "PX")]
    patch: usize,
    /// Captures by rays from the sensor, so many a pixel, in place of the fast renderer: the judge of both.
    #[arg(long, value_name = "RAYS", value_parser = clap::value_parser!(u32).range(2..=65536))]
    reference: Option<u32>,
    /// Captures of rays (off), by diffraction (on), or of rays convolved with the open pupil's diffraction (approximate) [default: as the run's task says].
    #[arg(long, value_name = "HOW", value_parser = model, conflicts_with = "reference")]
    diffraction: Option<Model>,
    /// Texels of a picture that a pixel sees at a patch's centre; 1: a pixel of the photograph is one of the sensor.
    #[arg(long, default_value_t = TEXELS_PER_PIXEL, value_name = "N")]
    texels_per_pixel: f64,
    /// Seed of places and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Protocol {
    /// The pictures, checked; stderr is told where they are built in.
    pub(crate) fn pictures(&self) -> Result<Pictures> {
        if !(0.1..=100.0).contains(&self.texels_per_pixel) {
            let found = self.texels_per_pixel.to_string();
            return Err(Error::bad("--texels-per-pixel", "value", found, "0.1 to 100"));
        }
        Ok(match &self.photos {
            Some(folder) => Pictures::Photos(Photos::open(folder)?),
            None => Pictures::BuiltIn(self.scene, SCENES),
        })
    }

    /// How a camera of `task` with `subject` is judged.
    pub(crate) fn settings(&self, task: &Task, subject: &Subject) -> Settings {
        let own = match task.network_depths_mm() {
            [] => vec![1.0 / subject.vergence()],
            depths => depths.to_vec(),
        };
        let mut settings = Settings {
            fields: self.fields,
            to_deg: self.to_degrees,
            means_deg: self.means_degrees.clone(),
            depths_mm: if self.depths_mm.is_empty() { own } else { self.depths_mm.clone() },
            patch: self.patch,
            seed: self.seed,
            fineness: FINENESS,
            rays: self.reference.map(|n| n as usize),
            texels: self.texels_per_pixel,
            through: None,
        }
        .of_pictures(&task.pictures);
        settings.fineness.diffraction = self.diffraction.unwrap_or(settings.fineness.diffraction);
        settings
    }

    /// In words, by name and value.
    pub(crate) fn described(&self) -> Vec<[String; 2]> {
        let zones = self.to_degrees.map_or_else(
            || format!("{} of equal width in image height", self.fields),
            |d| format!("{} of equal steps of half field angle to {d} degrees", self.fields),
        );
        let captures = match (self.reference, self.diffraction) {
            (Some(n), _) => format!("{n} rays a pixel"),
            (None, None) => "fast renderer, evaluation fineness".to_owned(),
            (None, Some(Model::Rays)) => "fast renderer, evaluation fineness, of rays".to_owned(),
            (None, Some(Model::Approximate)) => {
                "fast renderer, evaluation fineness, with the open pupil's diffraction".to_owned()
            }
            (None, Some(Model::Waves)) => "fast renderer, evaluation fineness, by diffraction".to_owned(),
        };
        let pictures = self.photos.as_ref().map_or_else(
            || format!("{SCENES} built-in {} scenes", self.scene.name()),
            |p| format!("photographs of {}", p.file_name().unwrap_or_default().to_string_lossy()),
        );
        [
            ("pictures judged", pictures),
            ("zones", zones),
            ("patch, pixels", self.patch.to_string()),
            ("texels to a pixel", self.texels_per_pixel.to_string()),
            ("captures", captures),
            ("seed of the judgement", self.seed.to_string()),
        ]
        .map(|(a, b)| [a.to_owned(), b])
        .to_vec()
    }
}

/// By what kernels of captures are made.
fn model(text: &str) -> std::result::Result<Model, String> {
    Model::from_name(text).ok_or_else(|| "off, approximate, on".to_owned())
}

/// A kind of built-in scene.
fn kind(text: &str) -> std::result::Result<SceneKind, String> {
    let known: Vec<&str> = SceneKind::ALL.iter().map(|k| k.name()).collect();
    SceneKind::from_name(text).ok_or_else(|| known.join(", "))
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_all(&[args.csv.as_deref(), args.plot.as_deref()], args.common.force)?;
    if let Some(folder) = &args.pictures {
        atomic::check_folder(folder, MARKER, args.common.force)?;
    }
    if args.plot.is_some() && args.protocol.fields < 2 {
        let found = format!("{} with --plot", args.protocol.fields);
        return Err(Error::bad("--fields", "value", found, "two zones or more: a dot is no curve").into());
    }
    let pictures = args.protocol.pictures()?;
    let judged = |folder: &Path| Judged::new(&args.protocol, args.through.as_ref(), folder);
    let run = judged(&args.run)?;
    let other = args.against.as_deref().map(judged).transpose()?;
    if args.protocol.photos.is_none() {
        let scene = args.protocol.scene;
        let family = if scene == SceneKind::Facades { "street" } else { scene.name() };
        let known = if TRAINING.contains(&scene) {
            "new draws of a family that training knows"
        } else {
            "a family that no training uses"
        };
        crate::aside!("no --photos: {SCENES} built-in {family} scenes, {known}");
    }
    if let Some(folder) = &args.drawn {
        return drawn(args, &run, &pictures, folder, out);
    }
    let (result, sheets) = run.judge(&pictures, args.pictures.is_some())?;
    let differences = match &other {
        Some(other) => {
            Some(paired::against(&result, &other.judge(&pictures, false)?.0).map_err(|e| e.in_file(&run.folder))?)
        }
        None => None,
    };
    if let Some(path) = &args.csv {
        output::put(&result.csv(), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.plot {
        output::put(&result.svg(), Some(path), args.common.force, out)?;
    }
    if let Some(folder) = &args.pictures {
        run.save(folder, args.common.force, &sheets, &result, &pictures)?;
    }
    let verdicts = Verdict::from_evaluation(&result);
    if args.common.json {
        let mut json = value(&result)?;
        json["verdicts"] = serde_json::to_value(&verdicts)?;
        if let Some(differences) = &differences {
            json["differences"] = serde_json::to_value(differences)?;
        }
        writeln!(out, "{json}")?;
        return Ok(());
    }
    for line in Verdict::lines(&verdicts) {
        writeln!(out, "{line}")?;
    }
    writeln!(out, "{}, {} {}", in_line(&result.lens), result.count, result.pictures)?;
    writeln!(out, "{}", result.table())?;
    if let Some(smallest) = result.rows.iter().map(|r| r.patch_px).min().filter(|p| *p < args.protocol.patch) {
        let patch = args.protocol.patch;
        writeln!(out, "zones too narrow for patches of {patch} pixels have smaller ones, down to {smallest}")?;
    }
    if !result.empty_zones.is_empty() {
        let list: Vec<String> = result.empty_zones.iter().map(usize::to_string).collect();
        writeln!(out, "no patch of the frame stands in zone {}", list.join(", "))?;
    }
    if let (Some(differences), Some(other)) = (&differences, &args.against) {
        writeln!(out, "\nreconstructions of {} less those of {}", path_in_line(&args.run), path_in_line(other))?;
        writeln!(out, "{}", paired::table(differences))?;
    }
    Ok(())
}

/// The run's network behind the lenses of a folder that `isoplanat tolerance` wrote.
fn drawn(args: &Args, run: &Judged, pictures: &Pictures, folder: &Path, out: &mut dyn Write) -> anyhow::Result<()> {
    let list = folder.join(tolerance::MARKER);
    let text = atomic::read_text(&list, 64 << 20)?;
    let count = text.lines().count().saturating_sub(1);
    if count == 0 {
        let allowed = "a folder of lenses, as `isoplanat tolerance --lenses` writes it";
        return Err(Error::bad(list.display().to_string(), "draws", "none", allowed).into());
    }
    // Draws that were no lens have no file.
    let lens = |name: &str| -> Result<Option<isoplanat::lens::Lens>> {
        let path = folder.join(name);
        path.is_file().then(|| crate::input::one_of_lenses(&path.display().to_string())).transpose()
    };
    let named = |k: usize| lens(&tolerance::draw(k)).map(|lens| (tolerance::draw(k), lens));
    let built =
        Built { refocused: lens(tolerance::REFOCUSED)?, draws: (1..=count).map(named).collect::<Result<Vec<_>>>()? };
    let bytes = run.allow(pictures, false)?;
    let task = &run.task;
    if args.retrain.is_some() {
        let more = memory::of_retraining(run.network.config(), task, Retrain::SIZE)?;
        crate::memory::limit().allow(
            "the training",
            bytes.saturating_add(more),
            "no --retrain, or a smaller network",
        )?;
    }
    let asked = isoplanat_program::signals::asked();
    let mut bar = None;
    let told = (&run.network, &run.guide);
    let judge =
        Judge::new(&run.subject, told, &run.sensor, pictures, &run.settings).map_err(|e| e.in_file(&run.folder))?;
    let textures = args.retrain.map(|_| task.textures()).transpose()?;
    if let Some(textures) = &textures {
        folder::same_scenes(&run.folder, &textures.sha256())?;
    }
    let retrain = textures.as_ref().zip(args.retrain).map(|(textures, steps)| Retrain::new(textures, steps));
    let draws = judge.draws(&built, retrain.as_ref(), &mut |share| {
        bar.get_or_insert_with(|| Bar::new("drawn lenses")).set(share, String::new());
        !asked()
    });
    let draws = draws.map_err(|e| e.in_file(folder))?;
    if let Some(bar) = bar {
        bar.done(String::new());
    }
    if let Some(path) = &args.csv {
        output::put(&draws.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        writeln!(out, "{}", draws.json())?;
    } else {
        writeln!(out, "{}", draws.table())?;
        for (name, why) in draws.lost() {
            writeln!(out, "{name} shows nothing: {why}")?;
        }
        writeln!(out, "{}", draws.pace())?;
    }
    // What was judged until then has been told.
    if draws.draws.len() < count { Err(Error::Interrupted.into()) } else { Ok(()) }
}

/// A run that is to be judged.
pub(crate) struct Judged {
    folder: PathBuf,
    task: Task,
    subject: Subject,
    network: Reconstructor,
    guide: Guide,
    sensor: Sensor,
    settings: Settings,
}

impl Judged {
    /// The run in `folder`, by `protocol`, captures `through` another lens where one is named.
    pub(crate) fn new(protocol: &Protocol, through: Option<&crate::named::Named>, folder: &Path) -> Result<Self> {
        let Run { task, subject, network, guide } = crate::input::run(folder)?;
        let through = through.map(crate::input::subject).transpose()?;
        let settings = Settings { through, ..protocol.settings(&task, &subject) };
        Ok(Self { folder: folder.to_owned(), sensor: task.sensor()?, task, subject, network, guide, settings })
    }

    /// The bytes that judging it takes, allowed.
    fn allow(&self, pictures: &Pictures, sheets: bool) -> Result<u64> {
        let frame = self.subject.frame()?;
        let frame = [frame.columns, frame.rows];
        let bytes = memory::of_evaluation(self.network.config(), pictures, &self.settings, Some(frame), sheets)?;
        let instead = "a smaller --patch, smaller photographs, or no --pictures";
        crate::memory::limit().allow("the evaluation", bytes, instead)?;
        Ok(bytes)
    }

    /// Judges it; with `sheets`, pictures too.
    pub(crate) fn judge(&self, pictures: &Pictures, sheets: bool) -> Result<(Evaluation, Vec<Sheet>)> {
        let bytes = self.allow(pictures, sheets)?;
        let told = (&self.network, &self.guide);
        // From the first picture on: what cannot be judged is refused before.
        let mut bar = None;
        let judged = evaluate(&self.subject, told, &self.sensor, pictures, &self.settings, sheets, &mut |share| {
            let bar = bar.get_or_insert_with(|| {
                crate::memory::tell(bytes);
                Bar::new("captures and reconstructions")
            });
            bar.set(share, String::new());
        })
        .map_err(|e| e.in_file(&self.folder))?;
        if let Some(bar) = bar {
            bar.done(String::new());
        }
        Ok(judged)
    }

    /// Slanted edges in captures by rays and behind the network, at each distance; nothing of a measured lens, which has no rays.
    pub(crate) fn edges(&self, settings: EdgeSettings, asked: &dyn Fn() -> bool) -> Result<Vec<EdgesAt>> {
        let Subject::Lens(lens) = &self.subject else { return Ok(Vec::new()) };
        let bar = Bar::new("slanted edges");
        #[expect(clippy::cast_precision_loss, reason = "a handful of distances")]
        let count = self.settings.depths_mm.len().max(1) as f64;
        let mut all = Vec::new();
        for depth_mm in &self.settings.depths_mm {
            #[expect(clippy::cast_precision_loss, reason = "a handful of distances")]
            let before = all.len() as f64;
            let there = lens.changed(|l| l.object_vergence = depth_mm.recip())?;
            let told = (&self.network, &self.guide);
            let found = measured(&there, told, &self.sensor, settings, &mut |share| {
                bar.set((before + share) / count, String::new());
            });
            if asked() {
                return Err(Error::Interrupted);
            }
            all.push(match found {
                Ok(found) => EdgesAt { depth_mm: *depth_mm, missing: found.missing(), curves: found.curves() },
                // A distance at which nothing can be measured is an outcome.
                Err(e @ Error::BadInput(_)) => {
                    EdgesAt { depth_mm: *depth_mm, missing: vec![e.to_string()], curves: Vec::new() }
                }
                Err(e) => return Err(e),
            });
        }
        bar.done(String::new());
        Ok(all)
    }

    /// Writes a folder of sheets.
    pub(crate) fn save(
        &self,
        folder: &Path,
        force: bool,
        sheets: &[Sheet],
        result: &Evaluation,
        pictures: &Pictures,
    ) -> Result<()> {
        atomic::write_folder(folder, MARKER, force, |folder| {
            let mut text = String::from("Columns: truth, capture, the lens's own Wiener filter, reconstruction. Rows:");
            for index in 0..pictures.len().min(4) {
                text += &format!(" {}", pictures.name(index));
            }
            text.push('\n');
            for sheet in sheets {
                let depth = self.settings.depths_mm.get(sheet.depth).copied().unwrap_or(f64::NAN);
                let name = match self.settings.depths_mm.len() {
                    1 => format!("field-{}.png", sheet.zone),
                    _ => format!("depth-{}mm-field-{}.png", significant(depth, 6), sheet.zone),
                };
                write_png8(&folder.join(&name), &sheet.image)?;
                let heights = result.rows.iter().find(|r| r.zone == sheet.zone).map_or([0.0; 2], |r| r.field);
                text += &format!(
                    "{name}: image height {:.2} to {:.2}, {} mm\n",
                    heights[0],
                    heights[1],
                    significant(depth, 6)
                );
            }
            atomic::write_bytes(&folder.join(MARKER), text.as_bytes())
        })
    }
}
