//! Outputs as the command line names them: looked at before the work, all of them by one rule.
//!
//! An argument is an output where the name of its value begins with `OUT`: `OUT.csv` is a file of that ending, `OUT` one of several forms that its command knows,
//! `OUT_DIR` a folder. Whatever else is named is an input.

use std::path::{Path, PathBuf};

use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command};
use isoplanat::{Error, Result, atomic};

/// How the name of an output's value begins.
const OUTPUT: &str = "OUT";

/// Endings that say the same.
const SAME: [(&str, &[&str]); 2] = [("html", &["html", "htm"]), ("csv", &["csv", "txt"])];

/// Whether every output that `words` name may be written as far as its name tells: its ending is not that of another form, it is none of the command's inputs,
/// and no two are one place or one inside of the other.
///
/// # Errors
/// An output whose name ends as other files do; one that is an input, or holds one; one that is another output, or lies in one.
pub(crate) fn check(program: &Command, words: &ArgMatches) -> Result<()> {
    let Some((name, words)) = words.subcommand() else { return Ok(()) };
    let Some(command) = program.find_subcommand(name) else { return Ok(()) };
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    for argument in command.get_arguments().chain(program.get_arguments()) {
        match (ending(argument), given(argument, words)) {
            (Some(ending), paths) => outputs.extend(paths.into_iter().map(|path| (path, ending))),
            (None, paths) => inputs.extend(paths),
        }
    }
    outputs.iter().try_for_each(|(path, ending)| fits(path, ending))?;
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    outputs.iter().try_for_each(|(path, _)| atomic::spares(path, &inputs))?;
    let places: Vec<&Path> = outputs.iter().map(|(path, _)| path.as_path()).collect();
    // What is wrong with a single one is told where it is written.
    if places.len() > 1 { atomic::distinct(&places) } else { Ok(()) }
}

/// What an output's value is called behind its `OUT`; `None`: it is no output.
fn ending(argument: &Arg) -> Option<&str> {
    argument.get_value_names()?.first()?.as_str().strip_prefix(OUTPUT)
}

/// The values that were given for an argument; its defaults are none.
fn given(argument: &Arg, words: &ArgMatches) -> Vec<PathBuf> {
    let id = argument.get_id().as_str();
    if !argument.get_action().takes_values() || !is_given(words, id) {
        return Vec::new();
    }
    words.get_raw(id).into_iter().flatten().map(PathBuf::from).collect()
}

/// Whether an argument stands on the command line; its default does not.
pub(crate) fn is_given(words: &ArgMatches, id: &str) -> bool {
    words.try_contains_id(id).is_ok() && words.value_source(id) == Some(ValueSource::CommandLine)
}

/// Whether a name ends as `wanted` (`.csv`) says, or does not say what it is: devices and pipes have names of their own.
fn fits(path: &Path, wanted: &str) -> Result<()> {
    let Some(wanted) = wanted.strip_prefix('.') else { return Ok(()) };
    let Some(found) = path.extension() else { return Ok(()) };
    let other = std::fs::metadata(path).is_ok_and(|m| !m.is_file());
    let own = [wanted];
    let endings = SAME.iter().find(|(ending, _)| *ending == wanted).map_or(&own[..], |(_, same)| *same);
    if other || endings.iter().any(|e| found.eq_ignore_ascii_case(e)) {
        return Ok(());
    }
    let found = format!("`.{}`", found.display());
    Err(Error::bad(path.display().to_string(), "file name", found, format!("a name that ends in .{wanted}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn refused(words: &[&str]) -> Option<String> {
        let command = crate::Cli::command();
        let words = command.clone().try_get_matches_from([&["isoplanat"], words].concat()).expect("parses");
        check(&command, &words).err().map(|e| e.to_string())
    }

    /// Every argument that is called as outputs are is one, and every command that overwrites has one.
    #[test]
    fn outputs_are_known_by_their_values() {
        const NAMES: [&str; 14] = [
            "output",
            "truth",
            "out",
            "svg",
            "csv",
            "npz",
            "png",
            "best",
            "plot",
            "pictures",
            "lenses",
            "export",
            "psf",
            "psf-picture",
        ];
        let command = crate::Cli::command();
        for command in command.get_subcommands() {
            let all: Vec<&Arg> = command.get_arguments().collect();
            let long =
                |a: &Arg, name: &str| a.get_long() == Some(name) || (a.get_long().is_none() && a.get_id() == name);
            for argument in all.iter().filter(|a| NAMES.iter().any(|name| long(a, name))) {
                let inputs = ["report", "dataset"].contains(&command.get_name()) && argument.get_id() == "lenses";
                assert_eq!(ending(argument).is_some(), !inputs, "{} {}", command.get_name(), argument.get_id());
            }
            let forced = all.iter().any(|a| a.get_id() == "force");
            assert!(!forced || all.iter().any(|a| ending(a).is_some()), "{}", command.get_name());
        }
    }

    #[test]
    fn endings_of_other_forms_are_refused() {
        for words in [
            &["psf", "cooke_triplet", "-o", "x.foo"][..],
            &["psf", "cooke_triplet", "-o", "x.npy"],
            &["spot", "cooke_triplet", "--csv", "x.svg"],
            &["capture", "cooke_triplet", "text", "-o", "x.raw"],
            &["report", "cooke_triplet", "-o", "x.pdf"],
            &["trace", "cooke_triplet", "--rays", "-", "-o", "x.csv"],
        ] {
            let said = refused(words).expect("refused");
            assert!(said.contains("a name that ends in ."), "{said}");
        }
        for words in [
            &["psf", "cooke_triplet", "-o", "x.NPZ"][..],
            &["psf", "cooke_triplet", "-o", "kernels"],
            &["spot", "cooke_triplet", "--csv", "x.txt"],
            &["spot", "cooke_triplet", "--csv", "/dev/stdout"],
            &["report", "cooke_triplet", "-o", "x.htm"],
        ] {
            assert_eq!(refused(words), None, "{words:?}");
        }
    }

    #[test]
    fn inputs_are_spared() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name).display().to_string();
        for name in ["lens.toml", "lens.csv", "photo.png"] {
            std::fs::write(at(name), name).expect("writes");
        }
        let (lens, table, photo, whole) = (&at("lens.toml"), &at("lens.csv"), &at("photo.png"), &at(""));
        for words in [
            &["convert", lens, lens, "--force"][..],
            &["optimize", lens, "-o", lens, "--force"],
            &["optimize", "cooke_triplet", "--merit", lens, "-o", lens, "--force"],
            &["spot", table, "--csv", table, "--force"],
            &["render", "cooke_triplet", photo, "-o", photo, "--force"],
            &["render", "cooke_triplet", photo, "-o", whole, "--force"],
            &["convert", "cooke_triplet", lens, "--glass", lens, "--force"],
            &["sheets", lens, "-o", whole, "--force"],
        ] {
            let said = refused(words).expect("refused");
            assert!(said.contains("read by the same command"), "{said}");
        }
        assert_eq!(refused(&["convert", lens, &at("other.toml"), "--force"]), None);
        assert_eq!(refused(&["spot", lens, "--csv", table, "--force"]), None);
    }
}
