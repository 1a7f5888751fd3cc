//! `isoplanat`: reads the command line, runs one command, turns its error into one line and an exit code.
//!
//! 0 done, 1 a check failed or an internal error, 2 bad input, 130 interrupted. Results go to stdout, everything else to
//! stderr. How a command is added stands in ARCHITECTURE.md; one that needs a feature has a second variant over [`missing::Args`] for builds without it.

/// Where memory is refused, one line and exit code 2.
#[global_allocator]
static MEMORY: isoplanat::refusing::Refusing = isoplanat::refusing::Refusing;

pub(crate) use isoplanat_program::{aside, tell};

mod accuracy;
mod analyses;
mod bending;
#[cfg(feature = "calibrate")]
mod calibrate;
#[cfg(feature = "deploy")]
mod calibrate_sensor;
mod capture;
mod check;
#[cfg(feature = "train")]
mod compare;
mod convert;
mod dataset;
#[cfg(all(feature = "train", feature = "deploy"))]
mod demo;
#[cfg(feature = "train")]
mod design;
#[cfg(feature = "train")]
mod evaluate;
#[cfg(all(feature = "train", feature = "deploy"))]
mod export;
mod focus;
mod glasses;
mod idle;
mod input;
mod inspect;
#[cfg(all(feature = "train", feature = "deploy"))]
mod kit;
mod lenses;
mod long;
mod memory;
#[cfg(any(test, not(all(feature = "train", feature = "deploy"))))]
mod missing;
mod named;
mod optimize;
mod output;
mod outputs;
mod peak;
mod picture;
mod progress;
mod psf;
mod render;
mod report;
mod scene;
mod sheets;
mod slanted_edge;
#[cfg(feature = "train")]
mod sweep;
mod tolerance;
mod trace;
#[cfg(feature = "train")]
mod train;
#[cfg(any(feature = "calibrate", feature = "deploy"))]
mod twice;
mod view;

use std::io::{BufWriter, ErrorKind, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use isoplanat::Error;
use isoplanat::interchange::Reading;
use isoplanat::math::simd::check_environment;
use isoplanat::report::lens::analysis::Analysis;
use isoplanat::terminal::Printable;

/// Designs a camera lens and its reconstruction network together, and runs the result on real captures.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Memory that the command may take, GiB; work that needs more is refused [default: 80 % of what is available]
    #[arg(long, global = true, value_name = "GIB", allow_negative_numbers = true)]
    memory_gib: Option<f64>,
    /// Glasses beside the shipped ones: an AGF catalogue, a page of refractiveindex.info (.yml) or a folder of them; as often as wanted.
    /// The folder that ISOPLANAT_GLASSES names is read too
    #[arg(long, global = true, value_name = "FILE")]
    glass: Vec<std::path::PathBuf>,
    /// A glass to take where a lens names another, such as SSK4=SSK4A; SSK4=1.6177,55.1 takes a model glass,
    /// SSK4=model that of the line that names it; as often as wanted
    #[arg(long, global = true, value_name = "NAME=GLASS")]
    glass_for: Vec<String>,
    /// Refuse a lens file with keywords that are not known, in place of a note
    #[arg(long, global = true)]
    strict: bool,
    /// The configuration (zoom position) to read of a Zemax or CODE V file that has several, from 1 [default: 1]
    #[arg(long, global = true, value_name = "N")]
    configuration: Option<usize>,
    /// Print no notes and no progress: warnings and errors alone, beside the result
    #[arg(long, short, global = true)]
    quiet: bool,
}

#[derive(clap::Subcommand)]
enum Command {
    /// First-order data, aberration sums and surfaces of a lens
    Inspect(inspect::Args),
    /// The shipped lenses: a table, or a folder with their files and drawings
    Lenses(lenses::Args),
    /// Numerical health of a lens: intersections, aiming, derivatives, precision
    Check(check::Args),
    /// A lens file in another form: TOML, Zemax, CODE V
    Convert(convert::Args),
    /// A lens with its sensor at best focus for an object distance, written with that distance
    Focus(focus::Args),
    /// What a workshop gets: a printable sheet of each element, sag tables, the lens in three forms
    Sheets(sheets::Args),
    /// A better lens by damped least squares with constraints, from where it stands or from anywhere
    Optimize(Box<optimize::Args>),
    /// Exact rays through every surface, as JSON
    Trace(trace::Args),
    /// Point spread functions over field, depth and wavelength
    Psf(psf::Args),
    /// Geometric MTF over frequency, field and focus
    Mtf(analyses::Args),
    /// Spots by field: size, best focus, encircled energy
    Spot(analyses::Args),
    /// Distortion over the field
    Distortion(analyses::Args),
    /// A lens as it will be built: what each tolerance costs, and lenses drawn within all of them
    Tolerance(tolerance::Args),
    /// The page of a lens or a run in a browser, following its file
    View(view::Args),
    /// Spots, fans, curves over the field, PSFs and MTF of a lens on one page; of two side by side
    Report(report::Args),
    /// The picture on the sensor, by PSF grid or by rays from the sensor
    Render(render::Args),
    /// Error against run time of every way to make the picture
    Accuracy(accuracy::Args),
    /// Pairs of capture and truth of lenses and photographs, as files for any training
    Dataset(Box<dataset::Args>),
    /// A RAW capture of a scene, by rays from the sensor
    Capture(capture::Args),
    /// The MTF that a picture of a slanted edge shows (ISO 12233 e-SFR)
    SlantedEdge(slanted_edge::Args),
    /// The distortion of a real lens from photographs of a chessboard
    #[cfg(feature = "calibrate")]
    Calibrate(calibrate::Args),
    /// The distortion of a real lens from photographs of a chessboard (needs the feature `calibrate`)
    #[cfg(not(feature = "calibrate"))]
    Calibrate(missing::Args),
    /// Black level, gain and noise of a sensor, and a lens's falling light, from dark and flat frames
    #[cfg(feature = "deploy")]
    CalibrateSensor(calibrate_sensor::Args),
    /// Black level, gain and noise of a sensor, and a lens's falling light, from dark and flat frames (needs the feature `deploy`)
    #[cfg(not(feature = "deploy"))]
    CalibrateSensor(missing::Args),
    /// The whole chain on built-in scenes, with a report
    #[cfg(all(feature = "train", feature = "deploy"))]
    Demo(demo::Args),
    /// The whole chain on built-in scenes, with a report (needs the features `train` and `deploy`)
    #[cfg(not(all(feature = "train", feature = "deploy")))]
    Demo(missing::Args),
    /// Joint design of lens and network
    #[cfg(feature = "train")]
    Design(design::Args),
    /// Joint design of lens and network (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Design(missing::Args),
    /// One of many joint designs by its number, or the best of them
    #[cfg(feature = "train")]
    Sweep(sweep::Args),
    /// One of many joint designs by its number, or the best of them (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Sweep(missing::Args),
    /// The final network for a finished lens
    #[cfg(feature = "train")]
    Train(train::Args),
    /// The final network for a finished lens (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Train(missing::Args),
    /// PSNR and SSIM of a run by field and depth
    #[cfg(feature = "train")]
    Evaluate(evaluate::Args),
    /// PSNR and SSIM of a run by field and depth (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Evaluate(missing::Args),
    /// A lens and others in its place, each with a network of its own
    #[cfg(feature = "train")]
    Compare(Box<compare::Args>),
    /// A lens and others in its place, each with a network of its own (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Compare(missing::Args),
    /// ONNX model and calibration of a run, for the camera
    #[cfg(all(feature = "train", feature = "deploy"))]
    Export(export::Args),
    /// ONNX model and calibration of a run (needs the features `train` and `deploy`)
    #[cfg(not(all(feature = "train", feature = "deploy")))]
    Export(missing::Args),
}

fn dispatch(command: Command, out: &mut dyn Write) -> anyhow::Result<()> {
    match command {
        Command::Inspect(args) => inspect::run(&args, out),
        Command::Lenses(args) => lenses::run(&args, out),
        Command::Check(args) => check::run(&args, out),
        Command::Convert(args) => convert::run(&args, out),
        Command::Focus(args) => focus::run(&args, out),
        Command::Sheets(args) => sheets::run(&args, out),
        Command::Optimize(args) => optimize::run(&args, out),
        Command::Trace(args) => trace::run(&args, out),
        Command::Psf(args) => psf::run(&args, out),
        Command::Mtf(args) => analyses::run(Analysis::Mtf, &args, out),
        Command::Spot(args) => analyses::run(Analysis::Spot, &args, out),
        Command::Distortion(args) => analyses::run(Analysis::Distortion, &args, out),
        Command::Tolerance(args) => tolerance::run(&args, out),
        Command::View(args) => view::run(&args, out),
        Command::Report(args) => report::run(&args, out),
        Command::Render(args) => render::run(&args, out),
        Command::Accuracy(args) => accuracy::run(&args, out),
        Command::Dataset(args) => dataset::run(&args, out),
        Command::Capture(args) => capture::run(&args, out),
        Command::SlantedEdge(args) => slanted_edge::run(&args, out),
        #[cfg(feature = "calibrate")]
        Command::Calibrate(args) => calibrate::run(&args, out),
        #[cfg(not(feature = "calibrate"))]
        Command::Calibrate(_) => missing::feature("calibrate"),
        #[cfg(feature = "deploy")]
        Command::CalibrateSensor(args) => calibrate_sensor::run(&args, out),
        #[cfg(not(feature = "deploy"))]
        Command::CalibrateSensor(_) => missing::feature("deploy"),
        #[cfg(feature = "train")]
        Command::Design(args) => design::run(&args, out),
        #[cfg(feature = "train")]
        Command::Sweep(args) => sweep::run(&args, out),
        #[cfg(feature = "train")]
        Command::Train(args) => train::run(&args, out),
        #[cfg(feature = "train")]
        Command::Evaluate(args) => evaluate::run(&args, out),
        #[cfg(feature = "train")]
        Command::Compare(args) => compare::run(&args, out),
        #[cfg(not(feature = "train"))]
        Command::Demo(_)
        | Command::Design(_)
        | Command::Sweep(_)
        | Command::Train(_)
        | Command::Evaluate(_)
        | Command::Compare(_)
        | Command::Export(_) => missing::feature("train"),
        #[cfg(all(feature = "train", feature = "deploy"))]
        Command::Demo(args) => demo::run(&args, out),
        #[cfg(all(feature = "train", feature = "deploy"))]
        Command::Export(args) => export::run(&args, out),
        #[cfg(all(feature = "train", not(feature = "deploy")))]
        Command::Demo(_) | Command::Export(_) => missing::feature("deploy"),
    }
}

/// Refuses `--configuration` where the lens comes from a task, which has one.
#[cfg(feature = "train")]
fn of_one_configuration(command: &Command, configuration: Option<usize>) -> isoplanat::Result<()> {
    let by_task = matches!(
        command,
        Command::Demo(_)
            | Command::Design(_)
            | Command::Sweep(_)
            | Command::Train(_)
            | Command::Evaluate(_)
            | Command::Compare(_)
            | Command::Export(_)
    );
    match configuration.filter(|_| by_task) {
        Some(n) => {
            let allowed = "commands that read a lens file; `isoplanat convert` with it writes the configuration as a lens file for a task";
            Err(Error::bad("--configuration", "value", n.to_string(), allowed))
        }
        None => Ok(()),
    }
}

#[cfg(not(feature = "train"))]
fn of_one_configuration(_: &Command, _: Option<usize>) -> isoplanat::Result<()> {
    Ok(())
}

fn main() -> ExitCode {
    #[cfg(feature = "deploy")]
    if let Some(code) = isoplanat::deploy::serve_child() {
        return code;
    }
    isoplanat_program::signals::attend();
    isoplanat_program::guarded(run).unwrap_or_else(|text| {
        tell!("error: internal: {text}");
        ExitCode::FAILURE
    })
}

/// Reads the command line and runs its command.
fn run() -> ExitCode {
    let (cli, words) = match isoplanat_program::command_line::asked::<Cli>("error: ") {
        Ok(both) => both,
        Err(code) => return ExitCode::from(code),
    };
    let Cli { command, memory_gib, glass, glass_for, strict, configuration, quiet } = cli;
    isoplanat_program::set_quiet(quiet);
    glasses::set_reading(Reading { strict, configuration, ..Reading::default() });
    isoplanat::atomic::tell_by(|note| aside!("note: {note}"));
    let mut out = BufWriter::new(Printable::new(std::io::stdout().lock()));
    let mut idle = Vec::new();
    let ready = outputs::check(&Cli::command(), &words)
        .and_then(|()| idle::check(&words).map(|found| idle = found))
        .and_then(|()| check_environment())
        .and_then(|()| memory::set(memory_gib))
        .and_then(|()| isoplanat::threads::start_pool(0))
        .and_then(|()| glasses::set(&glass, &glass_for));
    let ready = ready.and_then(|()| of_one_configuration(&command, configuration)).map_err(anyhow::Error::from);
    let Err(error) = ready
        .and_then(|()| dispatch(command, &mut out))
        .and_then(|()| Ok(out.flush()?))
        // Of commands that read no lens, or many.
        .and_then(|()| Ok(glasses::all_taken()?))
    else {
        for option in idle {
            tell!("warning: {option}");
        }
        return ExitCode::SUCCESS;
    };
    // Whoever reads our output may stop reading: that is no error.
    if error.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe) {
        return ExitCode::SUCCESS;
    }
    // Everything but standard output is written under its name.
    let of = if error.downcast_ref::<std::io::Error>().is_some() { "standard output: " } else { "" };
    crate::tell!("error: {of}{}", format!("{error:#}").replace('\n', " "));
    ExitCode::from(error.downcast_ref::<Error>().map_or(1, Error::exit_code))
}
