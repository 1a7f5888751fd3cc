//! `isoplanat render LENS SCENE… -o OUT`: pictures on the sensor, by PSF grid or by rays from the sensor.

mod figures;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use isoplanat::atomic::Target;
use isoplanat::dataset::Exposure;
use isoplanat::imaging::develop::shading::evened;
use isoplanat::imaging::files::{Annotation, Depth, Encoding, PICTURES, extension, write_annotated};
use isoplanat::imaging::plane::Region;
use isoplanat::imaging::reference::{Channels, Sampling, Settings as Rays, render};
use isoplanat::imaging::render::{PlanOptions, Request, ScenePlan, Skip, memory as estimate, plan, shortfall};
use isoplanat::imaging::scene::detail;
use isoplanat::imaging::scene::photos::Photos;
use isoplanat::imaging::scene::placement::slope_per_mm;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::report::table::{Table, numbered, significant};
use isoplanat::{Error, Result, atomic};
use ndarray::Array3;
use serde::Serialize;

use self::figures::{Figures, GridFigures};
use crate::bending::Bending;
use crate::input;
use crate::memory;
use crate::named::Named;
use crate::output;
use crate::output::Common;
use crate::progress::{Bar, Waiting};
use crate::scene::{SMALLER, SceneArgs, Stage, texels};

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// PSF grid and patched FFT convolution.
    PsfGrid,
    /// The reference: rays from the sensor.
    MonteCarlo,
}

/// The picture on the sensor.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file, or the name of a shipped lens.
    lens: Named,
    /// Picture files (.png, .tif, .jpg, .npy), folders of them, or built-in scenes: dead_leaves, text, fine_texture, slanted_edges, mixed, facades, color_chart (with
    /// :SEED). Several share one plan.
    #[arg(required = true)]
    scenes: Vec<Named>,
    /// Picture to write: .png, .tif, .jpg, .npy (linear light); for several scenes the folder to put them in, as .png.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Renderer.
    #[arg(long, value_enum, default_value = "psf-grid")]
    method: Method,
    /// Rays a pixel and channel (monte-carlo).
    #[arg(long, default_value_t = 64)]
    samples: usize,
    /// Take the cheapest settings that hold this PSNR, dB in linear light for a range of 1 (psf-grid) [default: 50].
    #[arg(long, value_name = "DB")]
    min_psnr_db: Option<f64>,
    /// Leave nothing out and make everything fine (psf-grid); for comparison.
    #[arg(long, conflicts_with = "min_psnr_db")]
    everything: bool,
    /// Kernels by diffraction (scalar waves), of rays, of rays convolved with the open pupil's diffraction, or the cheapest of them that differs little (psf-grid).
    #[arg(long, value_enum, default_value = "auto")]
    diffraction: Bending,
    /// Say what this scene did not need: reason, work that remains, error bound (psf-grid).
    #[arg(long)]
    explain: bool,
    #[command(flatten)]
    light: input::Light,
    #[command(flatten)]
    place: SceneArgs,
    #[command(flatten)]
    noise: input::NoiseArgs,
    /// Ideal picture to write beside one picture (psf-grid): where the lens's distortion shows the scene, without blur, falling light and noise.
    #[arg(long, value_name = "OUT")]
    truth: Option<PathBuf>,
    /// Seed of rays and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write linear light as 32-bit floating point (.tif or .npy; for several scenes as .tif).
    #[arg(long)]
    float: bool,
    #[command(flatten)]
    common: Common,
}

impl Args {
    /// The same with the pictures of folders in the folders' place, and whether there was one.
    fn expanded(&self) -> Result<(Self, bool)> {
        let mut scenes = Vec::new();
        let mut folders = false;
        for scene in &self.scenes {
            let path: &Path = scene.as_ref();
            if path.is_dir() {
                folders = true;
                scenes.extend(Photos::open(path)?.paths().iter().map(Named::from));
            } else {
                scenes.push(scene.clone());
            }
        }
        Ok((Self { scenes, ..self.clone() }, folders))
    }

    /// Writes a picture.
    fn write<'a>(&self, to: impl Into<Target<'a>>, image: &Array3<f32>) -> Result<()> {
        let depth = if self.float { Depth::Float } else { Depth::Sixteen };
        write_annotated(to, image, Encoding::Srgb, depth, &Annotation::default())
    }

    fn request(&self) -> Result<Request> {
        match self.min_psnr_db {
            None if self.everything => Ok(Request::Everything),
            None => Ok(Request::Psnr(DEFAULT_DB)),
            Some(db) if db.is_finite() && (10.0..=80.0).contains(&db) => Ok(Request::Psnr(db)),
            Some(db) => Err(Error::bad("--min-psnr-db", "value", db.to_string(), "10 to 80 dB")),
        }
    }

    fn options(&self) -> PlanOptions {
        PlanOptions { explain: self.explain, diffraction: self.diffraction.into() }
    }

    /// Whether a picture may be written under this name.
    fn check_name(&self, path: &Path) -> Result<()> {
        let ending = extension(path);
        if self.float && !["tif", "tiff", "npy"].contains(&ending.as_str()) {
            let found = format!("`{}` has no floating point", path.display());
            return Err(Error::bad("--float", "output", found, ".tif, .tiff or .npy"));
        }
        if !PICTURES.contains(&ending.as_str()) {
            let allowed = format!("a name that ends in .{}", PICTURES.join(", ."));
            return Err(Error::bad(path.display().to_string(), "file name", format!("`.{ending}`"), allowed));
        }
        Ok(())
    }

    /// Whether what the fast renderer alone makes is asked of it: a truth, noise, a flat field.
    fn check_pair(&self, many: bool) -> Result<()> {
        let asked = [
            ("--truth", self.truth.is_some()),
            ("--noise", self.noise.is_asked()),
            ("--flat-field", self.noise.flat_field),
        ];
        if let Some((option, _)) = asked.iter().find(|(_, asked)| *asked && self.method == Method::MonteCarlo) {
            return Err(Error::bad(
                *option,
                "with",
                "--method monte-carlo",
                "--method psf-grid; `isoplanat capture` has noise by rays",
            ));
        }
        let Some(path) = &self.truth else { return Ok(()) };
        if many {
            return Err(Error::bad(
                "--truth",
                "with",
                "several scenes",
                "one; `isoplanat dataset` makes pairs of many",
            ));
        }
        self.check_name(path)
    }

    /// Names of the pictures of several scenes: the scenes' own, with numbers where they repeat.
    fn names(&self) -> Vec<String> {
        let stems: Vec<String> = self.scenes.iter().map(Named::stem).collect();
        let ending = if self.float { "tif" } else { "png" };
        output::distinct_stems(&stems).iter().map(|s| format!("{s}.{ending}")).collect()
    }
}

/// PSNR that is held where none is asked for.
const DEFAULT_DB: f64 = 50.0;

/// The file that makes a folder one of pictures.
const MARKER: &str = "pictures.json";

/// One rendered picture with its truth and its numbers.
struct Made {
    image: Array3<f32>,
    truth: Option<Array3<f32>>,
    figures: Figures,
}

/// One of the pictures, with its numbers.
#[derive(Serialize)]
struct Picture {
    picture: String,
    figures: Figures,
}

/// What was made, for machines.
#[derive(Serialize)]
struct Told<'a> {
    seconds: f64,
    #[serde(flatten)]
    made: Pictures<'a>,
}

/// Numbers of the one picture, or all pictures.
#[derive(Serialize)]
#[serde(rename_all = "lowercase")]
enum Pictures<'a> {
    Figures(&'a Figures),
    Pictures(&'a [Picture]),
}

/// What renders scene after scene.
enum Way {
    Grid(Box<ScenePlan>, f64),
    Rays(Rays, Box<SpectralDensity>),
}

/// What becomes of a picture: the sensor's part, and whether its truth is asked for.
struct After {
    sensor: Sensor,
    noise: bool,
    flat_field: bool,
    truth: bool,
    seed: u64,
}

impl After {
    /// The picture as the sensor shows it.
    fn of(&self, image: Array3<f32>, plan: &ScenePlan) -> Array3<f32> {
        let frame = &plan.renderer.plan.frame;
        let whole = Region::whole(frame);
        let light = || plan.renderer.light.over::<f32>(frame, whole, &[0, 1, 2]);
        let Self { sensor, flat_field, seed, .. } = self;
        match (self.noise, flat_field) {
            (true, _) => Exposure { sensor, level: 1.0, flat_field: *flat_field, seed: *seed }.developed(
                image.view(),
                light().view(),
                whole,
            ),
            (false, true) => evened(image, light().view()),
            (false, false) => image,
        }
    }
}

impl Way {
    fn of(args: &Args, stage: &Stage, density: SpectralDensity) -> Result<Self> {
        if args.method == Method::MonteCarlo {
            let rays =
                Rays { samples: args.samples, seed: args.seed, channels: Channels::All, sampling: Sampling::Bounded };
            return Ok(Self::Rays(rays, Box::new(density)));
        }
        let clock = Instant::now();
        let what = format!("pictures of {} × {} pixels", stage.frame.columns, stage.frame.rows);
        let deciding = deciding(args, stage)?;
        let (count, planned) = (args.scenes.len(), deciding.len());
        let scenes = deciding.iter().map(|k| stage.plane(&args.scenes[*k])).collect::<Result<Vec<_>>>()?;
        let waiting = Waiting::new("plan");
        let mut plan = plan(&stage.lens, &scenes, &stage.frame, &density, args.request()?, args.options())?;
        drop(waiting);
        if !plan.holds {
            let text = shortfall(plan.predicted_db, args.min_psnr_db.unwrap_or(DEFAULT_DB), "--min-psnr-db");
            crate::tell!("warning: {text}");
        }
        let render = &plan.renderer.plan;
        if let Some(text) = render.table_error.untold(render.frame.pitch_mm) {
            crate::tell!("warning: {text}");
        }
        if planned < count && !args.everything {
            #[expect(clippy::cast_precision_loss, reason = "a share")]
            let remaining = planned as f64 / count as f64;
            let which = if matches!(args.request()?, Request::Psnr(_)) {
                "that show the most detail"
            } else {
                "evenly over the list"
            };
            let reason = format!("{planned} of {count}, {which}, were looked at; the others count as no worse");
            plan.skips.push(Skip { what: "scenes of the plan", reason, remaining, bound: f64::NAN });
        }
        let sizes = scenes.iter().map(|s| plan.bytes(texels(&s.texture)));
        let (largest, of) = sizes.zip(deciding).max().unwrap_or_default();
        let others: u64 = scenes.iter().skip(1).map(|s| estimate::scene(texels(&s.texture)) / 2).sum();
        let what = format!("{}: {what}", &*args.scenes[of]);
        memory::limit().allow(&what, largest.saturating_add(others), SMALLER)?;
        Ok(Self::Grid(Box::new(plan), clock.elapsed().as_secs_f64()))
    }

    fn make(&self, stage: &Stage, scene: &Named, after: &After, progress: &(dyn Fn(f64) + Sync)) -> Result<Made> {
        let plane = stage.plane(scene)?;
        match self {
            Self::Grid(plan, planning) => {
                let bytes = plan.bytes(texels(&plane.texture));
                memory::limit().allow(scene, bytes, SMALLER)?;
                let (image, seen) = plan.picture::<f32>(&plane, progress)?;
                let figures = Figures::Grid(Box::new(GridFigures::new(plan, seen, bytes, *planning)));
                let truth =
                    if after.truth { Some(plan.truth::<f32>(&plane, Region::whole(&stage.frame))?) } else { None };
                Ok(Made { image: after.of(image, plan), truth, figures })
            }
            Self::Rays(how, density) => {
                let frame = &stage.frame;
                let whole = Region::whole(frame);
                let r = render(&stage.lens, &plane, density, frame, whole, *how, Some(progress))?;
                let figures = Figures::Rays { rays: r.rays, noise_rms: r.noise_rms() };
                Ok(Made { image: r.mean, truth: None, figures })
            }
        }
    }
}

/// Which scenes the plan is made with: where it has something to hold those that show the most detail.
fn deciding(args: &Args, stage: &Stage) -> Result<Vec<usize>> {
    if args.scenes.len() == 1 || !matches!(args.request()?, Request::Psnr(_)) {
        return Ok(detail::spread(args.scenes.len(), detail::PLANNED));
    }
    detail::deciding(args.scenes.len(), |k| {
        let scene = stage.plane(&args.scenes[k])?;
        let per_pixel = scene.texels_per_slope * slope_per_mm(&stage.lens, 0.0, &stage.frame)? * stage.frame.pitch_mm;
        Ok(detail::detail(&scene.texture, per_pixel))
    })
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let (args, folders) = &args.expanded()?;
    let many = args.scenes.len() > 1 || *folders || args.output.is_dir();
    if !many {
        args.check_name(&args.output)?;
    }
    args.check_pair(many)?;
    if many {
        atomic::check_folder(&args.output, MARKER, args.common.force)?;
    } else {
        output::check_all(&[Some(&args.output), args.truth.as_deref()], args.common.force)?;
    }
    args.request()?;
    let stage = args.place.stage(&args.lens)?;
    let (sensor, noise) = args.noise.sensor()?;
    let density = SpectralDensity::under(&sensor, args.light.illuminant)?;
    let (flat_field, truth) = (args.noise.flat_field, args.truth.is_some());
    let after = After { sensor, noise, flat_field, truth, seed: args.seed };
    input::in_band(&stage.lens, &density, &args.lens)?;
    let least = match args.method {
        Method::PsfGrid => estimate::planes(&stage.frame),
        Method::MonteCarlo => estimate::rays(&stage.frame),
    };
    let what = format!("a picture of {} × {} pixels", stage.frame.columns, stage.frame.rows);
    memory::limit().allow(&what, least.saturating_add(stage.generated(&args.scenes)), SMALLER)?;
    let clock = Instant::now();
    let way = Way::of(args, &stage, density)?;
    let bar = Bar::new("render");
    let count = args.scenes.len();
    #[expect(clippy::cast_precision_loss, reason = "a share")]
    let one = |k: usize, scene: &Named| {
        let progress = |share: f64| bar.set((k as f64 + share) / count as f64, scene.to_string());
        way.make(&stage, scene, &after, &progress)
    };
    let mut all = Vec::with_capacity(count);
    if many {
        let names = args.names();
        atomic::write_folder(&args.output, MARKER, args.common.force, |folder| {
            for (k, (scene, name)) in args.scenes.iter().zip(&names).enumerate() {
                let made = one(k, scene)?;
                args.write(&folder.join(name), &made.image)?;
                all.push(Picture { picture: name.clone(), figures: made.figures });
            }
            let text = format!("{:#}\n", numbered(&Pictures::Pictures(&all)));
            atomic::write_bytes(&folder.join(MARKER), text.as_bytes())
        })?;
    } else {
        let made = one(0, &args.scenes[0])?;
        if let (Some(path), Some(truth)) = (&args.truth, &made.truth) {
            args.write(Target::new(path, args.common.force), truth)?;
        }
        args.write(Target::new(&args.output, args.common.force), &made.image)?;
        all.push(Picture { picture: args.output.display().to_string(), figures: made.figures });
    }
    bar.done(String::new());
    if let Some(told) = &stage.middle {
        crate::aside!("note: {}: {told}", args.lens);
    }
    let seconds = clock.elapsed().as_secs_f64();
    tell(args, &way, &stage, &all, seconds, out)
}

/// Prints what was made.
fn tell(
    args: &Args,
    way: &Way,
    stage: &Stage,
    all: &[Picture],
    seconds: f64,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let skips = match way {
        Way::Grid(plan, _) if args.explain => Some(plan),
        _ => None,
    };
    let frame = &stage.frame;
    if args.common.json {
        let made = if let [one] = all { Pictures::Figures(&one.figures) } else { Pictures::Pictures(all) };
        let mut value = numbered(&Told { seconds, made });
        if let Some(plan) = skips {
            let first = if all.len() == 1 { &mut value["figures"] } else { &mut value["pictures"][0]["figures"] };
            first["skips"] = serde_json::to_value(&plan.skips)?;
        }
        writeln!(out, "{value}")?;
        return Ok(());
    }
    let what = if let [one] = all { one.picture.clone() } else { format!("{} pictures", all.len()) };
    writeln!(out, "{what}: {} × {} pixels in {seconds:.2} s", frame.columns, frame.rows)?;
    for (name, text) in all[0].figures.rows() {
        writeln!(out, "  {name:<14} {text}")?;
    }
    if let Some(plan) = skips {
        writeln!(out, "\nleft out, or made coarser than the full computation:\n{}", table(plan))?;
    }
    Ok(())
}

/// What was left out.
fn table(plan: &ScenePlan) -> Table {
    let mut table = Table::new(["what", "work left", "bound (rms)", "reason"]);
    for skip in &plan.skips {
        let bound = if skip.bound == 0.0 { "none".into() } else { significant(skip.bound, 2) };
        table.row([skip.what.to_owned(), significant(skip.remaining, 2), bound, skip.reason.clone()]);
    }
    table
}
