//! Options that do nothing beside others: told, since whoever gives one wants something of it; refused where they ask for a promise that is not kept.

use clap::ArgMatches;
use isoplanat::{Error, Result};

use crate::outputs::is_given;

/// An option that has an effect only beside others.
struct Idle {
    command: &'static str,
    /// Its name, as clap has it.
    option: &'static str,
    /// Whether it does nothing beside the others.
    idle: fn(&ArgMatches) -> bool,
    /// How the others are.
    beside: &'static str,
    allowed: &'static str,
    /// Whether it promises something.
    promise: bool,
}

const ALL: [Idle; 12] = [
    Idle { option: "cycles_per_mm", ..OF_CHIEF_RAYS },
    Idle { option: "max_cycles_per_mm", ..OF_CHIEF_RAYS },
    Idle { option: "shift_mm", ..OF_CHIEF_RAYS },
    Idle { option: "rays", ..OF_CHIEF_RAYS },
    Idle { option: "fields_deg", ..OF_CHIEF_RAYS },
    Idle {
        command: "render",
        option: "samples",
        idle: |words| !by_rays(words),
        beside: "no --method monte-carlo",
        allowed: "together with it: kernels of psf-grid are not drawn by samples",
        promise: false,
    },
    Idle {
        command: "render",
        option: "min_psnr_db",
        idle: by_rays,
        beside: "--method monte-carlo",
        allowed: "--method psf-grid, which is planned; monte-carlo takes --samples",
        promise: true,
    },
    Idle {
        command: "render",
        option: "everything",
        idle: by_rays,
        beside: "--method monte-carlo",
        allowed: "--method psf-grid, which leaves things out; monte-carlo takes --samples",
        promise: true,
    },
    Idle {
        command: "render",
        option: "diffraction",
        idle: |words| by_rays(words) && word(words, "diffraction") != "off",
        beside: "--method monte-carlo",
        allowed: "--method psf-grid; rays from the sensor have no diffraction",
        promise: true,
    },
    Idle {
        command: "optimize",
        option: "seed",
        idle: |words| !is_given(words, "search"),
        beside: "no --search",
        allowed: "together with it: nothing else is drawn",
        promise: false,
    },
    Idle {
        command: "dataset",
        option: "shard",
        idle: |words| ["png", "tiff", "tif"].contains(&word(words, "form").to_lowercase().as_str()),
        beside: "a file for each picture",
        allowed: "--form npy or npz, which have shards",
        promise: false,
    },
    Idle {
        command: "view",
        option: "port",
        idle: |words| is_given(words, "export"),
        beside: "--export",
        allowed: "either of them: nothing is served where the page goes into a file",
        promise: false,
    },
];

/// Distortion needs no more than the chief rays.
const OF_CHIEF_RAYS: Idle = Idle {
    command: "distortion",
    option: "",
    idle: |_| true,
    beside: "chief rays alone",
    allowed: "`isoplanat mtf` or `isoplanat spot`, which it is for",
    promise: false,
};

fn by_rays(words: &ArgMatches) -> bool {
    word(words, "method") == "monte-carlo"
}

/// What stands behind an option, or its default.
fn word(words: &ArgMatches, option: &str) -> String {
    let raw = words.try_get_raw(option).ok().flatten();
    raw.and_then(|mut all| all.next()).map_or_else(String::new, |w| w.to_string_lossy().into_owned())
}

/// What `words` give and does nothing.
fn found(words: &ArgMatches) -> Vec<&'static Idle> {
    let Some((name, words)) = words.subcommand() else { return Vec::new() };
    ALL.iter().filter(|i| i.command == name && is_given(words, i.option) && (i.idle)(words)).collect()
}

/// What `words` give and does nothing, in words, to be told where the command succeeds: a refusal is one line.
///
/// # Errors
/// Such an option that promises something, by its name.
pub(crate) fn check(words: &ArgMatches) -> Result<Vec<String>> {
    let mut told = Vec::new();
    for Idle { option, beside, allowed, promise, .. } in found(words) {
        let error = Error::bad(format!("--{}", option.replace('_', "-")), "with", *beside, *allowed);
        if *promise {
            return Err(error);
        }
        told.push(format!("it does nothing: {error}"));
    }
    Ok(told)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// Every command and option of the table is one, and each line of the table finds its own case and not the other.
    #[test]
    fn what_does_nothing_is_found() {
        let command = crate::Cli::command();
        for Idle { command: name, option, .. } in &ALL {
            let Some(of) = command.find_subcommand(name) else { continue };
            assert!(of.get_arguments().any(|a| a.get_id() == option), "{name} {option}");
        }
        for (line, idle) in [
            ("distortion x --rays 100", true),
            ("mtf x --rays 100", false),
            ("distortion x --shift-mm 0.1", true),
            ("distortion x --max-cycles-per-mm 4", true),
            ("render x y -o z.png --samples 4", true),
            ("render x y -o z.png --samples 4 --method monte-carlo", false),
            ("render x y -o z.png --min-psnr-db 40 --method monte-carlo", true),
            ("render x y -o z.png --everything --method monte-carlo", true),
            ("render x y -o z.png --diffraction on --method monte-carlo", true),
            ("render x y -o z.png --diffraction off --method monte-carlo", false),
            ("render x y -o z.png --everything", false),
            ("optimize x -o y --seed 3", true),
            ("optimize x -o y --seed 3 --search 4", false),
            ("dataset x --photos y -o z --shard 4 --form png", true),
            ("dataset x --photos y -o z --shard 4 --form npz", false),
            ("view x --export y.html --port 80", true),
        ] {
            let words = command.clone().try_get_matches_from(format!("isoplanat {line}").split(' '));
            let words = match words {
                Ok(words) => words,
                Err(e) => panic!("{line}: {e}"),
            };
            let found = found(&words);
            assert_eq!(!found.is_empty(), idle, "{line}");
            let told = check(&words).map(|told| told.len());
            assert_eq!(told.ok(), (!found.iter().any(|i| i.promise)).then_some(found.len()), "{line}");
        }
    }
}
