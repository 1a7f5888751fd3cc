//! `isoplanat dataset LENS… --photos DIR -o OUT/`: pairs of capture and truth, for networks that are trained elsewhere.

use std::io::Write;
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock};

use isoplanat::dataset::{Crops, Form, Judging, Made, Part, Planned, Settings, make};
use isoplanat::imaging::render::shortfall;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::report::columns::{Column, table};
use isoplanat::report::table::numbered;
use isoplanat::{Error, Result};

use crate::bending::Bending;
use crate::input;
use crate::memory;
use crate::named::Named;
use crate::output::{Common, distinct_stems};
use crate::progress::{Bar, Waiting};
use crate::scene::{RasterArgs, check_texels};

/// Pairs of capture and truth of lenses and photographs.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens files, or names of shipped lenses.
    #[arg(required = true)]
    lenses: Vec<Named>,
    /// Folder of photographs: .png, .jpg, .tif, .npy.
    #[arg(long, value_name = "DIR")]
    photos: PathBuf,
    /// Folder to fill; what is whole in it already stays, if it is of the same settings.
    #[arg(short, long, value_name = "OUT_DIR")]
    output: PathBuf,
    /// Object distances before the first surface, mm (inf allowed); each lens file's own where left out.
    #[arg(long, value_delimiter = ',', value_name = "MM,…")]
    depth_mm: Vec<f64>,
    #[command(flatten)]
    raster: RasterArgs,
    /// Choose each lens's pitch so that --columns and --rows span its file's sensor.
    #[arg(long, conflicts_with = "pitch_um")]
    whole_field: bool,
    /// Texels a pixel sees: on the axis of whole frames, in the middle of crops; by default a photograph just fills the frame.
    #[arg(long)]
    texels_per_pixel: Option<f64>,
    /// Crops at random places of the frame in place of whole frames: pixels a side, or COLUMNSxROWS.
    #[arg(long, value_name = "SIZE", value_parser = size)]
    crop: Option<[usize; 2]>,
    /// Crops of each photograph [default: 1].
    #[arg(long, requires = "crop", value_name = "N")]
    crops: Option<usize>,
    #[command(flatten)]
    noise: input::NoiseArgs,
    /// Noise deviation over the sensor's own: a number, or LOW,HIGH to draw one for each pair, evenly in the logarithm [default: 1].
    #[arg(long, value_delimiter = ',', requires = "noise", value_name = "LEVEL", allow_negative_numbers = true)]
    noise_level: Vec<f64>,
    #[command(flatten)]
    light: input::Light,
    /// PSNR that pictures are planned to hold before noise, dB in linear light for a range of 1.
    #[arg(long, value_name = "DB", default_value_t = 45.0)]
    min_psnr_db: f64,
    /// Captures by diffraction (scalar waves), of rays, of rays convolved with the open pupil's diffraction, or as each lens needs [default: auto; off with --judge, since rays judge].
    #[arg(long, value_enum)]
    diffraction: Option<Bending>,
    /// Share of the pairs whose picture is judged by rays, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_negative_numbers = true)]
    judge: f64,
    /// Rays a pixel and channel of a judgement.
    #[arg(long, value_name = "N", default_value_t = 128)]
    judge_samples: usize,
    /// Files: png (16 bits, sRGB curve), tiff (float), npy (shards, float), npz (the same with the table's numbers).
    #[arg(long, value_name = "FORM", default_value = "png", value_parser = form)]
    form: Form,
    /// Pairs of a shard at most (npy, npz); by default what makes captures of 256 MiB.
    #[arg(long, value_name = "PAIRS")]
    shard: Option<usize>,
    /// Number of this process among those that share the work, from 0; `slurm` and `pbs` take it from the job's array.
    #[arg(long, value_name = "I")]
    index: Option<String>,
    /// How many processes share the work.
    #[arg(long, value_name = "N")]
    of: Option<usize>,
    /// Seed of crops, noise and rays.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

/// A side, or two.
fn size(text: &str) -> std::result::Result<[usize; 2], String> {
    let sides: Option<Vec<usize>> = text.split(['x', '×', ',']).map(|n| n.trim().parse().ok()).collect();
    match sides.as_deref() {
        Some([side]) => Ok([*side, *side]),
        Some([columns, rows]) => Ok([*columns, *rows]),
        _ => Err("pixels a side, or COLUMNSxROWS".into()),
    }
}

fn form(text: &str) -> std::result::Result<Form, String> {
    Form::ALL.into_iter().find(|f| f.name() == text).ok_or_else(|| Form::ALL.map(Form::name).join(", "))
}

/// What a scheduler says of a job's place in its array.
type Variables<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Which part of the work is this process's.
fn part(index: Option<&str>, of: Option<usize>, variables: Variables<'_>) -> Result<Part> {
    let number = |name: &str| -> Result<usize> {
        let bad = |found: String| Error::bad(name, "environment", found, "a whole number, as in a job of an array");
        let text = variables(name).ok_or_else(|| bad("not set".into()))?;
        text.trim().parse().map_err(|_| bad(format!("`{text}`")))
    };
    let or = |name: &str, value: usize| if variables(name).is_some() { number(name) } else { Ok(value) };
    let count = |of: Option<usize>| {
        of.ok_or_else(|| Error::bad("--index", "without", "--of", "how many processes share the work"))
    };
    let part = match (index, of) {
        (None, None) => Part::WHOLE,
        (None, Some(_)) => return Err(Error::bad("--of", "without", "--index", "the number of this process, from 0")),
        (Some("slurm"), of) => {
            let (id, first) = (number("SLURM_ARRAY_TASK_ID")?, or("SLURM_ARRAY_TASK_MIN", 0)?);
            let step = or("SLURM_ARRAY_TASK_STEP", 1)?.max(1);
            let of = of.map_or_else(|| number("SLURM_ARRAY_TASK_COUNT"), Ok)?;
            let found = || format!("{id}, less than SLURM_ARRAY_TASK_MIN {first}");
            let bad = || Error::bad("SLURM_ARRAY_TASK_ID", "environment", found(), "that or more");
            Part { index: id.checked_sub(first).ok_or_else(bad)? / step, of }
        }
        (Some("pbs"), of) => Part { index: number("PBS_ARRAY_INDEX")?, of: count(of)? },
        (Some(text), of) => {
            let bad = || Error::bad("--index", "value", format!("`{text}`"), "a whole number from 0, slurm or pbs");
            Part { index: text.parse().map_err(|_| bad())?, of: count(of)? }
        }
    };
    Ok(part)
}

impl Args {
    fn settings(&self) -> Result<Settings> {
        let part = part(self.index.as_deref(), self.of, &|name| std::env::var(name).ok())?;
        check_texels(self.texels_per_pixel)?;
        let (sensor, noise) = self.noise.sensor()?;
        let density = SpectralDensity::under(&sensor, self.light.illuminant)?;
        let stems: Vec<String> = self.lenses.iter().map(Named::stem).collect();
        let mut lenses = Vec::with_capacity(stems.len());
        for (argument, name) in self.lenses.iter().zip(distinct_stems(&stems)) {
            let lens = self.raster.lens(argument, self.whole_field)?;
            input::in_band(&lens, &density, argument)?;
            lenses.push((name, lens));
        }
        crate::glasses::all_taken()?;
        let noise_level = match self.noise_level[..] {
            [] => [1.0, 1.0],
            [level] => [level, level],
            [low, high] => [low, high],
            _ => {
                let found = format!("{} numbers", self.noise_level.len());
                return Err(Error::bad("--noise-level", "value", found, "one or two"));
            }
        };
        Ok(Settings {
            distances_mm: self.depth_mm.clone(),
            crops: self.crop.map(|size| Crops { size, count: self.crops.unwrap_or(1) }),
            texels_per_pixel: self.texels_per_pixel,
            sensor,
            noise,
            noise_level,
            flat_field: self.noise.flat_field,
            illuminant: self.light.illuminant,
            min_psnr_db: self.min_psnr_db,
            diffraction: self.diffraction.unwrap_or(if self.judge > 0.0 { Bending::Off } else { Bending::Auto }).into(),
            judging: Judging { share: self.judge, samples: self.judge_samples },
            seed: self.seed,
            form: self.form,
            shard: self.shard,
            part,
            replace: self.common.force,
            memory: memory::limit(),
            ..Settings::new(lenses, self.photos.clone())
        })
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let settings = args.settings()?;
    // What is refused is refused in one line: the bar begins with the writing.
    let (bar, waiting) = (OnceLock::new(), Mutex::new(Some(Waiting::new("plan"))));
    let made = make(&settings, &args.output, &|share, what| {
        if !what.is_empty() {
            drop(waiting.lock().ok().and_then(|mut w| w.take()));
            bar.get_or_init(|| Bar::new("dataset")).set(share, what.to_owned());
        }
        true
    })?;
    if let Some(bar) = bar.into_inner() {
        bar.done(String::new());
    }
    for plan in made.planned.iter().filter(|p| !p.holds) {
        let text = shortfall(plan.predicted_psnr_db, settings.min_psnr_db, "--min-psnr-db");
        crate::tell!("warning: {}: {text}", plan.lens);
    }
    for plan in &made.planned {
        if let Some(text) = &plan.untold {
            crate::tell!("warning: {}: {text}", plan.lens);
        }
    }
    if made.damaged > 0 {
        crate::aside!("note: {} units with files that are damaged or gone were made again", made.damaged);
    }
    if args.common.json {
        return Ok(writeln!(out, "{}", numbered(&Figures::new(args, &settings, &made)))?);
    }
    let Part { index, of } = settings.part;
    let what = if of > 1 { format!(", part {index} of {of}") } else { String::new() };
    writeln!(
        out,
        "{}{what}: {} pairs made, {} kept, of {}, in {:.1} s",
        args.output.display(),
        made.made,
        made.kept,
        made.pairs,
        made.seconds
    )?;
    if !made.planned.is_empty() {
        write!(out, "\n{}", table(&PLANS, &made.planned))?;
    }
    if let Some(([judged, held], mean)) = made.verdict(settings.min_psnr_db) {
        let ([low, high], db) = (mean.interval_db(), mean.psnr_db());
        let asked = settings.min_psnr_db;
        writeln!(
            out,
            "\njudged by rays: {held} of {judged} hold {asked} dB; together {db:.1} dB ({low:.1} to {high:.1})"
        )?;
    }
    if !made.complete {
        writeln!(out, "\npairs.csv comes with the last part")?;
    }
    Ok(())
}

const PLANS: [Column<Planned>; 5] = [
    Column::text("lens", "lens", |p| p.lens.clone()),
    Column::text("distance/mm", "distance_mm", |p| p.distance_mm.map_or("inf".into(), |mm| mm.to_string())),
    Column::text("diffraction", "diffraction", |p| p.diffraction.name().to_owned()),
    Column::text("predicted PSNR dB", "predicted_psnr_db", |p| {
        p.predicted_psnr_db.map_or("–".into(), |db| format!("{db:.1}"))
    }),
    Column::figure("planned in s", "seconds", 2, |p| p.seconds),
];

/// What was made, for machines.
#[derive(serde::Serialize)]
struct Figures<'a> {
    dataset: String,
    index: usize,
    of: usize,
    pairs: usize,
    made: usize,
    kept: usize,
    damaged: usize,
    complete: bool,
    seconds: f64,
    plans: &'a [Planned],
    judged: usize,
    held: usize,
    min_psnr_db: f64,
    judged_psnr_db: Option<f64>,
    judged_psnr_db_interval: Option<[f64; 2]>,
}

impl<'a> Figures<'a> {
    fn new(args: &'a Args, settings: &Settings, made: &'a Made) -> Self {
        let (Part { index, of }, min_psnr_db) = (settings.part, settings.min_psnr_db);
        let verdict = made.verdict(min_psnr_db);
        let [judged, held] = verdict.map_or([0, 0], |v| v.0);
        let &Made { pairs, made: now, kept, damaged, complete, seconds, .. } = made;
        Self {
            dataset: args.output.display().to_string(),
            index,
            of,
            pairs,
            made: now,
            kept,
            damaged,
            complete,
            seconds,
            plans: &made.planned,
            judged,
            held,
            min_psnr_db,
            judged_psnr_db: verdict.map(|(_, mean)| mean.psnr_db()),
            judged_psnr_db_interval: verdict.map(|(_, mean)| mean.interval_db()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_schedulers_are_parts() {
        let with = |index: Option<&str>, of, set: &[(&str, &str)]| {
            let of_set = |name: &str| set.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
            part(index, of, &of_set).map(|p| (p.index, p.of)).map_err(|e| e.to_string())
        };
        assert_eq!(with(None, None, &[]), Ok((0, 1)));
        assert_eq!(with(Some("2"), Some(5), &[]), Ok((2, 5)));
        let array = [("SLURM_ARRAY_TASK_ID", "7"), ("SLURM_ARRAY_TASK_COUNT", "4")];
        assert_eq!(with(Some("slurm"), None, &array), Ok((7, 4)), "refused as out of range later");
        let more = [&array[..], &[("SLURM_ARRAY_TASK_MIN", "1"), ("SLURM_ARRAY_TASK_STEP", "2")]].concat();
        assert_eq!(with(Some("slurm"), None, &more), Ok((3, 4)));
        assert_eq!(with(Some("pbs"), Some(4), &[("PBS_ARRAY_INDEX", "3")]), Ok((3, 4)));
        // Variables that nobody asked for change nothing.
        assert_eq!(with(None, None, &more), Ok((0, 1)));
        for (index, of, set, words) in [
            (Some("slurm"), None, &[][..], "SLURM_ARRAY_TASK_ID"),
            (Some("slurm"), None, &array[..1], "SLURM_ARRAY_TASK_COUNT"),
            (Some("pbs"), None, &[("PBS_ARRAY_INDEX", "3")], "--of"),
            (Some("pbs"), Some(2), &[("PBS_ARRAY_INDEX", "x")], "`x`"),
            (Some("-1"), Some(2), &[], "`-1`"),
            (Some("1"), None, &[], "--of"),
            (None, Some(3), &[], "--index"),
        ] {
            let said = with(index, of, set).expect_err(words);
            assert!(said.contains(words), "{said}");
        }
    }
}
