//! `isoplanat accuracy --gradient`: error of the lens gradient against seconds.

use std::io::Write;

use isoplanat::imaging::render::Settings;
use isoplanat::imaging::render::gradient_error::{CONVERGED, Patches};
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::report::gradient_accuracy::{GradientAccuracy, Row};
use isoplanat::report::table::value;

use super::{Args, tell};
use crate::progress::Bar;
use crate::scene::Placed;

/// Patches, and their side in pixels.
const PATCHES: (usize, usize) = (128, 8);

/// Every setting: ladder, words.
fn settings() -> Vec<(&'static str, String, Settings)> {
    let base = Settings::DESIGN;
    let mut all = vec![
        ("preset", "design".to_owned(), base),
        ("preset", "training".to_owned(), Settings::TRAINING),
        ("nothing but converged", "converged".to_owned(), CONVERGED),
    ];
    for n in [3, 5, 7, 9] {
        all.push(("wavelengths", n.to_string(), Settings { wavelengths: n, ..CONVERGED }));
    }
    for n in [100, 200, 500, 1200] {
        all.push(("stop points", n.to_string(), Settings { dense: n, ..CONVERGED }));
    }
    for e in [0.5, 0.25, 0.1, 0.05] {
        all.push(("field nodes", format!("within {e}"), Settings { node_error: e, ..CONVERGED }));
    }
    for o in [2e-2, 5e-3, 2e-3] {
        all.push(("kernel size", format!("{o:e} outside"), Settings { outside: o, ..CONVERGED }));
    }
    for n in [8, 16, 32, 64] {
        all.push(("cells", format!("half-width of {n} cells at most"), Settings { cells: n, ..CONVERGED }));
    }
    for d in [5, 7] {
        all.push(("degree over the stop", d.to_string(), Settings { degree: d, ..CONVERGED }));
    }
    for m in [1, 2] {
        all.push(("scene samples", format!("{m} × {m} a pixel"), Settings { samples: m, ..CONVERGED }));
    }
    all
}

/// Measures all of them on patches of `placed`.
pub(super) fn run(args: &Args, placed: &Placed, density: &SpectralDensity, out: &mut dyn Write) -> anyhow::Result<()> {
    let patches = Patches::even(&placed.lens, &placed.frame, density, &placed.plane, PATCHES);
    let bar = Bar::new("gradients");
    let converged = patches.measure(CONVERGED)?;
    let noise = converged.noise();
    let all = settings();
    let mut rows = Vec::with_capacity(all.len());
    for (k, (ladder, words, settings)) in all.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        bar.set(k as f64 / all.len() as f64, format!("{ladder}: {words}"));
        let found = patches.measure(*settings)?;
        rows.push(Row {
            ladder: (*ladder).to_owned(),
            setting: words.clone(),
            relative_error: found.error(&converged),
            seconds: found.seconds,
            planning_seconds: found.planning,
        });
    }
    bar.done(String::new());
    let accuracy = GradientAccuracy {
        schema: 1,
        lens: placed.lens.name.clone(),
        scene: args.scene.to_string(),
        patches: [patches.parts.len(), patches.parts.first().map_or(0, |p| p.1.rows)],
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        noise,
        rows,
    };
    let [count, side] = accuracy.patches;
    let note = format!(
        "{count} patches of {side}² pixels; {:.2} of their gradients is not common to them: an error well below that moves no design",
        accuracy.noise
    );
    let text = if args.common.json { value(&accuracy)?.to_string() } else { format!("{}\n{note}", accuracy.table()) };
    tell([(&args.svg, accuracy.svg()), (&args.csv, accuracy.csv())], args.common.force, text, out)
}
