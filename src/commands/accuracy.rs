//! `isoplanat accuracy LENS SCENE`: error against run time of every way to make the picture.

mod gradient;

use std::cell::Cell;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use isoplanat::Result;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::halves::psnr_against_halves;
use isoplanat::imaging::reference::{Channels, Rendered, Sampling, Settings as Rays, render, render_halves};
use isoplanat::imaging::render::{PlanOptions, Request, Settings, lacking, memory as estimate, plan};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::math::memory::words as in_words;
use isoplanat::report::accuracy::{Accuracy, Row, mark_pareto};
use isoplanat::report::table::value;
use ndarray::Array3;

use crate::memory;
use crate::named::Named;
use crate::output;
use crate::output::Common;
use crate::peak::measured;
use crate::progress::Bar;
use crate::scene::{Placed, SMALLER, SceneArgs, texels};

/// Error against run time of every way to make the picture.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file, or the name of a shipped lens.
    lens: Named,
    /// Picture file, or a built-in scene as KIND or KIND:SEED.
    scene: Named,
    /// Rays a pixel and channel of the reference, in two halves.
    #[arg(long, default_value_t = 512)]
    reference_samples: usize,
    /// Page to write: plot and table.
    #[arg(short, long, value_name = "OUT.html")]
    output: Option<PathBuf>,
    /// Plot to write.
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// Rows to write as comma-separated values.
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Judge the lens gradient of design steps instead: error against seconds of every setting.
    #[arg(long, conflicts_with = "output")]
    gradient: bool,
    #[command(flatten)]
    place: SceneArgs,
    #[command(flatten)]
    common: Common,
}

/// One way to make the picture.
enum Way {
    /// PSF grid, single precision.
    Grid(Request),
    /// PSF grid, double precision.
    Double(Request),
    /// Rays from the sensor.
    Rays(usize, Sampling),
}

/// Pixels from which a frame is cut to its middle part unless `--crop` says otherwise.
const LARGE: usize = 1 << 19;

/// Every row: ladder, settings in words, way.
fn ways() -> Vec<(&'static str, String, Way)> {
    let fine = Settings::FINE;
    let grid = |s: Settings| Way::Grid(Request::Settings(s));
    let mut ways = vec![
        ("nothing left out", "finest, everywhere".into(), Way::Grid(Request::Everything)),
        ("precision", "finest, f64".into(), Way::Double(Request::Settings(fine))),
        ("precision", "finest, f32".into(), grid(fine)),
    ];
    for m in Settings::SAMPLES {
        ways.push(("scene samples", format!("{m} × {m} a pixel"), grid(Settings { samples: m, ..fine })));
    }
    for n in Settings::WAVELENGTHS {
        ways.push(("wavelengths", format!("{n}"), grid(Settings { wavelengths: n, ..fine })));
    }
    for n in Settings::DENSE {
        ways.push(("pupil points", format!("{n}"), grid(Settings { dense: n, ..fine })));
    }
    for e in Settings::NODE_ERRORS {
        ways.push(("field nodes", format!("interpolated within {e}"), grid(Settings { node_error: e, ..fine })));
    }
    for o in Settings::OUTSIDE {
        ways.push(("kernel size", format!("{o:e} outside"), grid(Settings { outside: o, ..fine })));
    }
    for db in [35.0, 40.0, 45.0, 50.0, 55.0] {
        ways.push(("chosen", format!("--min-psnr-db {db}"), Way::Grid(Request::Psnr(db))));
    }
    for n in [4, 16, 64] {
        ways.push(("rays", format!("{n} a pixel"), Way::Rays(n, Sampling::Bounded)));
    }
    for n in [16, 64, 256] {
        ways.push(("rays", format!("{n} a pixel"), Way::Rays(n, Sampling::RearAperture)));
    }
    ways
}

/// What every way is held against: rays from the sensor in two independent halves.
struct Reference {
    halves: [Rendered; 2],
    mean: Array3<f32>,
    seconds: f64,
}

/// What is pictured, and what a picture of it takes of memory at least.
struct Pictured<'a> {
    lens: &'a Lens,
    frame: &'a Frame,
    plane: &'a Plane,
    density: &'a SpectralDensity,
    least: u64,
}

/// A picture, the method's name and its settings in words.
type Made = (Array3<f32>, &'static str, String);

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_all(&[args.output.as_deref(), args.svg.as_deref(), args.csv.as_deref()], args.common.force)?;
    let density = SpectralDensity::new(&Sensor::generic());
    if args.gradient {
        let placed = args.place.place(&args.lens, &args.scene)?;
        crate::input::in_band(&placed.lens, &density, &args.lens)?;
        return gradient::run(args, &placed, &density, out);
    }
    let Placed { lens, frame, plane } = args.place.place_within(&args.lens, &args.scene, LARGE)?;
    crate::input::in_band(&lens, &density, &args.lens)?;
    // Two halves and a picture of every way.
    let least = estimate::rays(&frame).saturating_mul(2).saturating_add(estimate::scene(texels(&plane.texture)));
    let what = format!("a comparison over {} × {} pixels", frame.columns, frame.rows);
    memory::limit().allow(&what, least, SMALLER)?;
    let pictured = Pictured { lens: &lens, frame: &frame, plane: &plane, density: &density, least };
    let reference = pictured.reference(args.reference_samples)?;
    let lacking = lacking(&lens, std::slice::from_ref(&plane), &frame, &density)?;
    let rows = pictured.rows(&reference)?;
    let [first, second] = &reference.halves;
    let half = first.mean.iter().zip(&second.mean).map(|(a, b)| 0.5 * f64::from((a - b).abs()));
    let accuracy = Accuracy {
        schema: 1,
        lens: lens.name.clone(),
        scene: args.scene.to_string(),
        frame: [frame.columns, frame.rows],
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        reference_samples: args.reference_samples,
        reference_noise_rms: first.noise_rms().hypot(second.noise_rms()) / 2.0,
        reference_worst_pixel: half.fold(0.0, f64::max),
        reference_seconds: reference.seconds,
        diffraction_rms: lacking,
        rows,
    };
    let note = format!(
        "* no other row is both faster and nearer; the reference took {:.1} s and has {:.1e} rms of noise\nall of these are of rays: diffraction changes this picture by about {lacking:.1e} rms",
        reference.seconds, accuracy.reference_noise_rms
    );
    let files = [(&args.output, accuracy.html()), (&args.svg, accuracy.svg()), (&args.csv, accuracy.csv())];
    let text = if args.common.json { value(&accuracy)?.to_string() } else { format!("{}\n{note}", accuracy.table()) };
    tell(files, args.common.force, text, out)
}

fn rays(samples: usize, sampling: Sampling, seed: u64) -> Rays {
    Rays { samples, seed, channels: Channels::All, sampling }
}

impl Pictured<'_> {
    fn reference(&self, samples: usize) -> Result<Reference> {
        let bar = Bar::new("reference");
        let clock = Instant::now();
        let halves = render_halves(
            self.lens,
            self.plane,
            self.density,
            self.frame,
            Region::whole(self.frame),
            rays(samples, Sampling::Bounded, 1),
            Some(&|share| bar.set(share, String::new())),
        )?;
        let seconds = clock.elapsed().as_secs_f64();
        bar.done(String::new());
        let mean = (&halves[0].mean + &halves[1].mean) * 0.5;
        Ok(Reference { halves, mean, seconds })
    }

    /// Every way, judged.
    fn rows(&self, reference: &Reference) -> Result<Vec<Row>> {
        let ways = ways();
        let most = Cell::new(self.least);
        let bar = Bar::new("methods");
        let mut rows = Vec::with_capacity(ways.len());
        for (k, (ladder, words, way)) in ways.iter().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "a share")]
            bar.set(k as f64 / ways.len() as f64, format!("{ladder}: {words}"));
            let clock = Instant::now();
            let (made, peak_bytes) = measured(|| self.made(ladder, words, way, &most));
            let (image, method, settings) = made?;
            let row = Row {
                method: method.into(),
                ladder: (*ladder).into(),
                settings,
                psnr_db: 0.0,
                psnr_db_interval: [0.0; 2],
                relative_l2: 0.0,
                energy: 0.0,
                worst_pixel: 0.0,
                seconds: clock.elapsed().as_secs_f64(),
                peak_bytes,
                pareto: false,
            };
            rows.push(judged(&image, &reference.halves, &reference.mean, row));
        }
        bar.done(format!("memory: at most {}", in_words(most.get())));
        mark_pareto(&mut rows);
        Ok(rows)
    }

    /// A picture one way; `most` is the largest estimate of memory so far.
    fn made(&self, ladder: &str, words: &str, way: &Way, most: &Cell<u64>) -> Result<Made> {
        let planned = |request: Request, copies: u64| -> Result<_> {
            let plan = plan(
                self.lens,
                std::slice::from_ref(self.plane),
                self.frame,
                self.density,
                request,
                PlanOptions::RAYS,
            )?;
            let bytes = self.least.saturating_add(plan.bytes(texels(&self.plane.texture)).saturating_mul(copies));
            memory::limit().allow(&format!("{ladder}: {words}"), bytes, SMALLER)?;
            most.set(most.get().max(bytes));
            Ok(plan)
        };
        Ok(match way {
            Way::Grid(request) => {
                let plan = planned(*request, 1)?;
                let (s, depth) = (plan.renderer.plan.settings, &plan.renderer.plan.depths[0]);
                let told = match request {
                    Request::Psnr(_) => format!(
                        "{words}: {0} × {0} samples, {1} wavelengths, {2} points, {3} nodes, {4}² kernels",
                        depth.samples,
                        s.wavelengths,
                        s.dense,
                        depth.grid.len(),
                        depth.size()
                    ),
                    _ => words.to_owned(),
                };
                (plan.picture::<f32>(self.plane, &|_| ())?.0, "psf-grid", told)
            }
            Way::Double(request) => {
                #[expect(clippy::cast_possible_truncation, reason = "compared in single precision")]
                let image = planned(*request, 2)?.picture::<f64>(self.plane, &|_| ())?.0.mapv(|v| v as f32);
                (image, "psf-grid", words.to_owned())
            }
            Way::Rays(n, sampling) => {
                let (whole, how) = (Region::whole(self.frame), rays(*n, *sampling, 77));
                let r = render(self.lens, self.plane, self.density, self.frame, whole, how, None)?;
                let name = if *sampling == Sampling::Bounded { "monte-carlo" } else { "monte-carlo, plain" };
                (r.mean, name, words.to_owned())
            }
        })
    }
}

/// Writes the files that are asked for, and `text`.
fn tell<const N: usize>(
    files: [(&Option<PathBuf>, String); N],
    force: bool,
    text: String,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    for (path, content) in files {
        if path.is_some() {
            output::put(&content, path.as_deref(), force, out)?;
        }
    }
    Ok(writeln!(out, "{text}")?)
}

/// `row` with the errors of `image`.
fn judged(image: &Array3<f32>, halves: &[Rendered; 2], mean: &Array3<f32>, row: Row) -> Row {
    let agreement = psnr_against_halves(image.view(), halves);
    let sum = |a: &Array3<f32>| a.iter().map(|v| f64::from(*v)).sum::<f64>();
    // ⟨R₁ R₂⟩ is the reference's own mean square, without its noise.
    let square: f64 = halves[0].mean.iter().zip(&halves[1].mean).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    #[expect(clippy::cast_precision_loss, reason = "a mean")]
    let square = square / mean.len().max(1) as f64;
    let worst = image.iter().zip(mean).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    Row {
        psnr_db: agreement.psnr_db,
        psnr_db_interval: agreement.psnr_db_interval,
        relative_l2: (agreement.mean_square.max(0.0) / square.max(f64::MIN_POSITIVE)).sqrt(),
        energy: sum(image) / sum(mean) - 1.0,
        worst_pixel: worst,
        ..row
    }
}
