//! `isoplanat optimize`: a lens made better by damped least squares, from where it stands or from anywhere.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use isoplanat::analysis::curves::over_field;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::interchange::{Form, text_of};
use isoplanat::lens::paraxial::first_order;
use isoplanat::lens::{Lens, Parameter, prescription};
use isoplanat::optimize::pool::Pool;
use isoplanat::optimize::search::{Plan, Progress, search};
use isoplanat::optimize::spec::{Range, Spec, Wanted, glasses};
use isoplanat::optimize::{Constraint, Limits, Outcome, Problem, Quality, Quantity, Valued, glass, optimize};
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::table::{significant, value};
use isoplanat::terminal::in_line;
use isoplanat::{Error, Result, atomic};

use crate::named::Named;
use crate::output::Common;
use crate::progress::Bar;

/// Arguments of `optimize`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens such as `cooke_triplet`
    lens: Named,
    /// Where the better lens goes (.toml, .zmx, .seq)
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// What to judge, move and hold (TOML); flags count more. Keys, all optional: `vary`, `fix` (lists of patterns), tables `bounds`
    /// (pattern = 12 or [10, 12]), `constraints` (name = 50 or [low, high]) and `targets` (name = { value, weight }); `fields` and `field_weights` (shares
    /// of the largest field), `depths_mm` and `depth_weights`, `rings` and `arms` (rays in the stop), `quality` (`spot`, `wavefront`),
    /// `reference` (`centroid`, `chief`), `apertures` (`stated`, `automatic`)
    #[arg(long, value_name = "FILE")]
    merit: Option<PathBuf>,
    /// Numbers that move, by name or pattern: `surface[*].curvature`, `surface[2].a4`, `surface[0..3].n_d`; as often as wanted
    /// [default: curvatures of refracting surfaces, all thicknesses]
    #[arg(long, value_name = "PATTERN")]
    vary: Vec<String>,
    /// Numbers that do not move
    #[arg(long, value_name = "PATTERN")]
    fix: Vec<String>,
    /// Bounds of variables: `surface[*].thickness=1..8`
    #[arg(long, value_name = "PATTERN=RANGE")]
    bound: Vec<String>,
    /// What is held or bounded: `focal_length=50`, `track=..60`, `back_focus=35..`, `working_f_number=..4.5`, `distortion=-0.02..0.02`, `edge_glass=1..`,
    /// `edge_air=0.1..`, `slope=-1..1`, `surface[2].edge=1..`; `..` takes a standard one away
    #[arg(long, value_name = "NAME=RANGE")]
    constraint: Vec<String>,
    /// What is wanted without being held, and how many mm of rms a unit of deviation counts: `focal_length=50@0.01`,
    /// `distortion=0@0.1`; names as of constraints
    #[arg(long, value_name = "NAME=VALUE@WEIGHT")]
    target: Vec<String>,
    /// `spot` or `wavefront`
    #[arg(long)]
    quality: Option<String>,
    /// Spots about the `centroid` or the `chief` ray
    #[arg(long)]
    reference: Option<String>,
    /// Which light counts: what `stated` clear semi-diameters let through at the start (they grow where it needs room), or all of the
    /// stop's (`automatic`: they follow the beam)
    #[arg(long)]
    apertures: Option<String>,
    /// Object distance, mm; as often as wanted [default: the lens's]
    #[arg(long, value_name = "MM")]
    depth_mm: Vec<f64>,
    /// Steps at most
    #[arg(long, default_value_t = 400)]
    iterations: usize,
    /// Minutes at most
    #[arg(long, value_name = "MINUTES", allow_negative_numbers = true)]
    minutes: Option<f64>,
    /// Search globally: start from this many lenses drawn by thin-lens powers and bendings, then hop from the best
    #[arg(long, value_name = "STARTS")]
    search: Option<usize>,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for the ten best lenses of a search, with drawings
    #[arg(long, value_name = "OUT_DIR")]
    best: Option<PathBuf>,
    /// Choose real glasses: `*` or patterns such as `surface[2].medium`, and among which, such as `SCHOTT/*,!plastic` or `N-BK7,N-SF5`; `plastic` lets polymers be
    /// cemented to glass, `obsolete` takes types that are no longer made
    #[arg(long, value_name = "PATTERN")]
    choose_glass: Vec<String>,
    /// Drawing of the lens before and after
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let form = Form::from_path(&args.output)?;
    if matches!(form, Form::Json | Form::Txt) {
        let file = args.output.display().to_string();
        return Err(Error::bad(file, "name", "a form that is read only", ".toml, .zmx or .seq").into());
    }
    crate::output::check_all(&[Some(&*args.output), args.svg.as_deref()], args.common.force)?;
    if let Some(folder) = &args.best {
        atomic::check_folder(folder, MARKER, args.common.force)?;
    }
    if args.best.is_some() && args.search.is_none() {
        return Err(Error::bad("--best", "value", "given", "together with --search").into());
    }
    let minutes = args.minutes.unwrap_or(f64::INFINITY);
    if minutes.is_nan() || minutes <= 0.0 {
        return Err(Error::bad("--minutes", "value", minutes.to_string(), "a positive number").into());
    }
    if args.iterations == 0 || args.search == Some(0) {
        return Err(Error::bad("--iterations, --search", "value", "0", "at least 1").into());
    }
    if let Some(starts) = args.search.filter(|n| *n > MOST_STARTS) {
        return Err(Error::bad("--search", "value", starts.to_string(), format!("1 to {MOST_STARTS}")).into());
    }
    let until = Duration::try_from_secs_f64(60.0 * minutes).ok().and_then(|d| Instant::now().checked_add(d));
    let (spec, file) = spec(args)?;
    let lens = crate::input::start(&args.lens, spec.focal_length_mm())?;
    // What the form cannot say is told before the work.
    text_of(&lens, form, crate::glasses::all())?;
    let problem = spec.problem(&lens, &file)?;
    spec.notes(&lens, &file)?.iter().for_each(|note| crate::aside!("note: {file}: {note}"));
    if problem.merit.quality == Quality::Wavefront && args.search.is_none() {
        near_focus(&lens)?;
    }
    let limits = Limits { iterations: args.iterations, until, ..Limits::default() };
    // Ctrl-C asks for an end; the best lens so far is written.
    let asked = isoplanat_program::signals::asked();
    let bar = Bar::new("optimize");
    let started = Instant::now();
    let mut found: Vec<Outcome> = Vec::new();
    if let Some(starts) = args.search {
        let plan = Plan { starts, seed: args.seed, until, ..Plan::default() };
        let mut tell = |p: Progress| {
            let timed = until.map_or(0.0, |_| started.elapsed().as_secs_f64() / (60.0 * minutes));
            bar.set(p.share.max(timed), format!("rms {:.3} µm, {} minima", p.rms * 1e3, p.minima));
            !asked()
        };
        found = search(&problem, &plan, &mut tell)?;
    }
    let mut from = problem.clone();
    if args.search.is_some() {
        let Some(best) = found.first() else {
            let allowed = "more starts, or constraints that leave room";
            return Err(Error::bad(&*args.lens, "--search", "no lens keeps the constraints", allowed).into());
        };
        from.lens = best.lens.clone();
    }
    let mut tell = |s: isoplanat::optimize::Step| {
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        let share = s.iteration as f64 / args.iterations as f64;
        let timed = until.map_or(0.0, |_| started.elapsed().as_secs_f64() / (60.0 * minutes));
        bar.set(share.max(timed), format!("rms {:.4} µm", s.rms * 1e3));
        !asked()
    };
    let mut chosen = Vec::new();
    let outcome = if args.choose_glass.is_empty() {
        match found.first() {
            Some(best) => best.clone(),
            None => optimize(&from, limits, &mut tell)?,
        }
    } else {
        let (surfaces, pool) = choice(&lens, &args.choose_glass)?;
        let outcome = glass::choose(&from, &surfaces, &pool, limits, &mut tell)?;
        let named = |lens: &Lens, i: usize| lens.surfaces[i].medium.to_string();
        let glass =
            |&surface: &usize| Glass { surface, before: named(&lens, surface), after: named(&outcome.lens, surface) };
        chosen = surfaces.iter().map(glass).collect();
        outcome
    };
    bar.done(format!("rms {:.4} µm", outcome.rms_mm[1] * 1e3));
    if asked() {
        crate::tell!("stopped on request: the best lens so far is kept");
    }
    outcome.require(&file)?;
    let better = text_of(&outcome.lens, form, crate::glasses::all())?.0;
    crate::output::put(&better, Some(&args.output), args.common.force, out)?;
    if let Some(path) = &args.svg {
        crate::output::put(&pair_svg(&lens, &outcome.lens), Some(path), args.common.force, out)?;
    }
    if let Some(folder) = &args.best {
        atomic::write_folder(folder, MARKER, args.common.force, |folder| keep(folder, &found))?;
    }
    doubts(&spec, &problem, &outcome).iter().for_each(|doubt| crate::tell!("warning: {doubt}"));
    if args.common.json {
        json(&outcome, chosen, &found, out)?;
    } else {
        text(args, &problem, &outcome, (&chosen, &found), out)?;
    }
    out.flush()?;
    // The lens is there for who wants to look; who goes on without looking is stopped.
    let asked_for = |h: &&Valued<Constraint>| spec.asks_for(&problem, h.of.quantity);
    let broken: Vec<String> = outcome.broken().filter(asked_for).take(MOST_BROKEN).map(said(&problem)).collect();
    let broken: Vec<String> = broken.into_iter().chain(beyond(&problem, &outcome.lens)).take(MOST_BROKEN).collect();
    anyhow::ensure!(
        broken.is_empty(),
        "{}: what was asked for is not kept: {}",
        args.output.display(),
        broken.join("; ")
    );
    Ok(())
}

/// Numbers beyond their bounds: those that somebody asked for, since the start lies within the standard ones.
fn beyond(problem: &Problem, lens: &Lens) -> Vec<String> {
    const KEPT: f64 = 1e-6;
    let of = |(p, [low, high]): (&Parameter, &[f64; 2])| {
        let value = p.value(&**lens)?;
        let off = (low - value).max(value - high);
        (off > KEPT * value.abs().max(1e-3))
            .then(|| format!("{} is {} (allowed: {})", p.name(lens), significant(value, 6), allowed([*low, *high])))
    };
    problem.variables.parameters.iter().zip(&problem.bounds).filter_map(of).collect()
}

/// A broken constraint in words.
fn said(problem: &Problem) -> impl Fn(&Valued<Constraint>) -> String {
    move |held| {
        let quantity = held.of.quantity;
        // With as many digits as tell the value from its bounds.
        let beside = |digits: &usize| {
            let value = significant(held.value, *digits);
            held.of.bounds.iter().all(|b| significant(*b, *digits) != value)
        };
        let digits = (5..=12).find(beside).unwrap_or(12);
        let value = [significant(held.value, digits), quantity.unit().to_owned()].join(" ");
        format!("{} is {} (allowed: {})", problem.words(quantity), value.trim_end(), allowed(held.of.bounds))
    }
}

/// Refuses a start so far out of focus that path differences, which are taken to spheres far away, do not tell it: of parallel light they are none. Nearer ones are told.
fn near_focus(lens: &Lens) -> anyhow::Result<()> {
    /// Distance from focus over that of the exit pupil from the sensor, beyond which a start is refused, and told.
    const REFUSED: f64 = 0.3;
    const TOLD: f64 = 0.03;
    let first = first_order(lens, lens.wavelengths.primary_nm);
    let sensor = lens.surfaces.last().map_or(0.0, |s| s.thickness);
    let off = first.paraxial_image_distance - sensor;
    // A pupil at infinity: of spheres that are planes nothing is left out.
    let share = (off / (sensor - first.exit_pupil_position)).abs();
    let words = format!("{} mm out of focus on the axis", significant(off, 4));
    if share.is_nan() || share > REFUSED {
        let allowed = "a start near its focus: optimise by spots first (--quality spot), or `isoplanat focus`";
        return Err(Error::bad(lens.file(), "--quality wavefront", words, allowed).into());
    }
    if share > TOLD {
        crate::aside!(
            "note: {}: {words}: path differences are off by about {} % there",
            lens.file(),
            significant(100.0 * share, 2)
        );
    }
    Ok(())
}

/// What whoever takes the lens should know: that it is no better, which of the constraints that nobody asked for it breaks, and that its distortion grew where nothing holds it.
fn doubts(spec: &Spec, problem: &Problem, o: &Outcome) -> Vec<String> {
    let mut all = Vec::new();
    let standard = |h: &&Valued<Constraint>| !spec.asks_for(problem, h.of.quantity);
    let broken: Vec<String> = o.broken().filter(standard).take(MOST_BROKEN).map(said(problem)).collect();
    if !broken.is_empty() {
        let replaced = "what is held without being asked for is replaced by name, such as `--constraint track=..`";
        all.push(format!("constraints are broken: {}; {replaced}", broken.join("; ")));
    }
    let [before, after] = o.rms_mm.map(|v| significant(1e3 * v, 4));
    if o.rms_mm[1] > o.rms_mm[0] * (1.0 + 1e-9) {
        all.push(format!("the lens is worse than its start by rms, {before} -> {after} µm: what is held asks for it"));
    }
    let [start, end] = [&problem.lens, &o.lens].map(|l| first_order(l, l.wavelengths.primary_nm));
    let slower = end.working_f_number / start.working_f_number;
    let asked = problem.constraints.iter().any(|c| c.quantity == Quantity::FNumber);
    if (1.0 + SLOWER..=1.0 + ALLOWED).contains(&slower) && !asked {
        let [before, after] = [start, end].map(|f| significant(f.working_f_number, 4));
        all.push(format!(
            "the lens is slower: working f-number {before} -> {after}; what is held allows it, `--constraint working_f_number=..{before}` does not"
        ));
    }
    let drift = end.magnification / start.magnification - 1.0;
    if problem.lens.object_vergence > 0.0 && drift.abs() > ENLARGED {
        let [before, after] = [start, end].map(|f| significant(f.magnification, 4));
        all.push(format!("the magnification went from {before} to {after}: nothing holds it"));
    }
    let free = !problem.constraints.iter().any(|c| matches!(c.quantity, Quantity::Distortion(_)));
    if let ([Some(before), Some(after)], true) = ([&problem.lens, &o.lens].map(distortion_percent), free)
        && after.abs() > before.abs() + DISTORTED
    {
        let [before, after] = [before, after].map(|v| significant(v, 3));
        all.push(format!(
            "distortion at the edge of the field went from {before} % to {after} %: nothing holds it; `--constraint distortion=-0.02..0.02` would"
        ));
    }
    all
}

/// Broken constraints that are told.
const MOST_BROKEN: usize = 5;
/// Part by which a lens may become slower, and its magnification change, before it is told. Lenses slower than what is held without being asked for allows, 1.05 times, are so
/// because somebody asked, or break it, which is told.
const SLOWER: f64 = 0.01;
const ALLOWED: f64 = 0.051;
const ENLARGED: f64 = 0.02;
/// Per cent by which distortion may grow before it is told.
const DISTORTED: f64 = 1.0;

/// Distortion where the field ends, per cent.
fn distortion_percent(lens: &Lens) -> Option<f64> {
    let rows = over_field(lens, &[lens.wavelengths.primary_nm], &[lens.max_field_deg()]);
    rows.first().map(|r| r.distortion_percent).filter(|d| d.is_finite())
}

/// The surfaces whose glass is chosen, all where none is named, and the glasses to choose among. A lens for light that the generic sensor sees is to be
/// seen through by all of it: `render` and `train` ask for that.
fn choice(lens: &Lens, patterns: &[String]) -> Result<(Vec<usize>, Pool)> {
    const FLAG: &str = "--choose-glass";
    let parts = patterns.iter().flat_map(|p| p.split(',')).map(str::trim).filter(|p| !p.is_empty());
    let (filters, mut named): (Vec<&str>, Vec<&str>) = parts.partition(|p| Pool::is_filter(crate::glasses::all(), p));
    if named.is_empty() {
        named.push("*");
    }
    let mut surfaces = Vec::new();
    for pattern in named {
        surfaces.extend(glasses(lens, pattern, FLAG)?);
    }
    surfaces.sort_unstable();
    surfaces.dedup();
    let pool = Pool::new(crate::glasses::all(), &filters, FLAG)?;
    let seen = SpectralDensity::new(&Sensor::generic()).ends_nm();
    let [short, long] = lens.wavelengths.ends_nm();
    let visible = short <= seen[1] && long >= seen[0];
    Ok((surfaces, if visible { pool.known_over(seen) } else { pool }))
}

/// Starts of a search at most.
const MOST_STARTS: usize = 1_000_000;

/// The table of a search's folder; its presence makes the folder one.
const MARKER: &str = "lenses.csv";

fn keep(folder: &Path, found: &[Outcome]) -> Result<()> {
    let mut table = String::from("rank,rms_um,track_mm,last_distance_mm,stop\n");
    for (k, o) in found.iter().enumerate() {
        let name = format!("{:02}", k + 1);
        prescription::save(&o.lens, &folder.join(format!("{name}.toml")))?;
        atomic::write_bytes(&folder.join(format!("{name}.svg")), lens_svg(&o.lens).as_bytes())?;
        let last = o.lens.surfaces.last().map_or(0.0, |s| s.thickness);
        table += &format!("{name},{},{},{last},{:?}\n", o.rms_mm[1] * 1e3, o.lens.length(), o.stop);
    }
    atomic::write_bytes(&folder.join(MARKER), table.as_bytes())
}

/// The file's spec with the flags put over it.
fn spec(args: &Args) -> Result<(Spec, String)> {
    let (mut spec, file) = match &args.merit {
        Some(path) => {
            let (text, name) = crate::input::text(path)?;
            (Spec::from_toml(&text, &name)?, name)
        }
        None => (Spec::default(), "command line".to_owned()),
    };
    if !args.vary.is_empty() {
        spec.vary.clone_from(&args.vary);
    }
    spec.fix.extend(args.fix.iter().cloned());
    for (flag, list, map) in
        [("--bound", &args.bound, &mut spec.bounds), ("--constraint", &args.constraint, &mut spec.constraints)]
    {
        for text in list {
            let Some((name, range)) = text.rsplit_once('=') else {
                return Err(Error::bad(flag, "value", text.as_str(), "NAME=RANGE, such as track=..60"));
            };
            map.insert(name.trim().to_owned(), Range::parse(range, flag)?);
        }
    }
    for text in &args.target {
        let Some((name, wanted)) = text.rsplit_once('=') else {
            return Err(Error::bad("--target", "value", text.as_str(), "NAME=VALUE@WEIGHT, such as track=60@0.001"));
        };
        spec.targets.insert(name.trim().to_owned(), Wanted::parse(wanted, "--target")?);
    }
    for (to, from) in [
        (&mut spec.quality, &args.quality),
        (&mut spec.reference, &args.reference),
        (&mut spec.apertures, &args.apertures),
    ] {
        if from.is_some() {
            to.clone_from(from);
        }
    }
    if !args.depth_mm.is_empty() {
        spec.depths_mm = Some(args.depth_mm.clone());
        spec.depth_weights = None;
    }
    Ok((spec, file))
}

/// Both lenses in one drawing, one below the other.
fn pair_svg(before: &Lens, after: &Lens) -> String {
    let [a, b] = [before, after].map(lens_svg);
    let size = |svg: &str, key: &str| -> f64 {
        let at = svg.find(&format!(" {key}=\"")).map(|i| i + key.len() + 3);
        at.and_then(|i| svg[i..].split('"').next()?.parse().ok()).unwrap_or(960.0)
    };
    let (wa, ha, wb, hb) = (size(&a, "width"), size(&a, "height"), size(&b, "width"), size(&b, "height"));
    let (width, height) = (wa.max(wb), ha + hb + 48.0);
    let inner = |svg: &str, y: f64| svg.replacen("<svg ", &format!("<svg x=\"0\" y=\"{y}\" "), 1);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n\
         <text x=\"16\" y=\"18\" font-size=\"15\" fill=\"currentColor\">before</text>\n{}\n\
         <text x=\"16\" y=\"{}\" font-size=\"15\" fill=\"currentColor\">after</text>\n{}\n</svg>\n",
        inner(&a, 24.0),
        ha + 42.0,
        inner(&b, ha + 48.0)
    )
}

fn text(
    args: &Args,
    problem: &Problem,
    o: &Outcome,
    (chosen, found): (&[Glass], &[Outcome]),
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let unit = if problem.merit.quality == Quality::Wavefront { "path difference" } else { "spot" };
    writeln!(out, "{} -> {}", in_line(&args.lens), in_line(&args.output.display().to_string()))?;
    writeln!(
        out,
        "rms {unit}  {:.4} µm -> {:.4} µm   {} steps of {} rays in {:.3} s",
        o.rms_mm[0] * 1e3,
        o.rms_mm[1] * 1e3,
        o.iterations,
        o.rays,
        o.seconds
    )?;
    writeln!(out, "stopped: {}", o.stop.reason())?;
    if let Some(refused) = &o.refused {
        writeln!(out, "better numbers, of merit {:.4} µm, are no lens: {}", refused.merit_mm * 1e3, refused.why)?;
        writeln!(out, "constraints on edge_glass, edge_air, slope and reach keep such numbers away")?;
    }
    if o.share < 1.0 {
        writeln!(out, "rays arrive up to {:.0} % of aperture and field only", o.share * 100.0)?;
    }
    if o.violation > 1e-6 {
        writeln!(out, "constraints are violated by up to {:.3e} (relative)", o.violation)?;
    }
    if !chosen.is_empty() {
        writeln!(out, "\n{:32} {:>24}   after", "glass behind", "before")?;
    }
    for Glass { surface, before, after } in chosen {
        writeln!(out, "{:32} {before:>24}   {after}", format!("surface[{surface}]"))?;
    }
    writeln!(out, "\n{:32} {:>14} {:>14}   allowed", "moved", "before", "after")?;
    for m in &o.moved {
        writeln!(out, "{:32} {:>14.7} {:>14.7}   {}", m.name, m.before, m.after, allowed(m.bounds))?;
    }
    writeln!(out, "\n{:32} {:>14}   allowed", "held", "value")?;
    for Valued { of, value } in &o.held {
        let (name, unit) = (problem.words(of.quantity), of.quantity.unit());
        writeln!(out, "{name:32} {value:>14.6}   {} {unit}", allowed(of.bounds))?;
    }
    if !o.wanted.is_empty() {
        writeln!(out, "\n{:32} {:>14}   target", "wanted", "value")?;
    }
    for Valued { of: t, value } in &o.wanted {
        let unit = t.quantity.unit();
        let name = problem.words(t.quantity);
        writeln!(out, "{name:32} {value:>14.6}   {:.6} {unit} at {} mm rms a unit", t.value, t.weight)?;
    }
    writeln!(out, "\n{:32} {:>14}   what loosening it gains", "active", "bound")?;
    for a in &o.active {
        let unit = match a.unit {
            "" if a.name.ends_with(".thickness") => "mm",
            "" => "unit",
            unit => unit,
        };
        writeln!(out, "{:32} {:>14.6}   {:.4e} µm rms a {unit}", a.name, a.bound, a.cost.abs() * 1e3)?;
    }
    if !found.is_empty() {
        writeln!(out, "\n{:>4} {:>12} {:>10} {:>14}", "rank", "rms, µm", "track, mm", "last gap, mm")?;
        for (k, f) in found.iter().enumerate() {
            let last = f.lens.surfaces.last().map_or(0.0, |s| s.thickness);
            writeln!(out, "{:>4} {:>12.4} {:>10.3} {:>14.3}", k + 1, f.rms_mm[1] * 1e3, f.lens.length(), last)?;
        }
    }
    Ok(())
}

fn allowed([a, b]: [f64; 2]) -> String {
    match (a.is_finite(), b.is_finite()) {
        (true, true) if a == b => format!("= {a:.6}"),
        (true, true) => format!("{a:.4} to {b:.4}"),
        (true, false) => format!("from {a:.4}"),
        (false, true) => format!("to {b:.4}"),
        (false, false) => "any".into(),
    }
}

/// A glass that was chosen: behind which surface, what stood there, what stands there.
#[derive(serde::Serialize)]
struct Glass {
    surface: usize,
    before: String,
    after: String,
}

/// The result as JSON has it.
#[derive(serde::Serialize)]
struct Found<'a> {
    #[serde(flatten)]
    outcome: &'a Outcome,
    reason: &'static str,
    /// What was chosen by `--choose-glass`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    glasses: Vec<Glass>,
    /// The rms of every lens that a search kept, mm.
    found: Vec<f64>,
}

fn json(outcome: &Outcome, glasses: Vec<Glass>, found: &[Outcome], out: &mut dyn Write) -> anyhow::Result<()> {
    let found = found.iter().map(|f| f.rms_mm[1]).collect();
    writeln!(out, "{:#}", value(&Found { outcome, reason: outcome.stop.reason(), glasses, found })?)?;
    Ok(())
}
