//! The command line: what it says, or one line on what is wrong with it.

use std::ffi::OsString;
use std::io::Write as _;

use clap::error::ErrorKind;
use clap::{ArgMatches, Command, CommandFactory, Error, FromArgMatches};

/// Exit code of bad input.
const BAD_INPUT: u8 = 2;
/// Exit code where what was asked for could not be printed.
const FAILURE: u8 = 1;

/// What the command line asks for, and its words by argument; `Err`: the exit code of a program whose work is done with that (help, the version, a line on what is
/// wrong, which begins with `before`).
///
/// # Errors
/// As said.
pub fn asked<C: CommandFactory + FromArgMatches>(before: &str) -> Result<(C, ArgMatches), u8> {
    let words = joined(std::env::args_os());
    read(&words).map_err(|error| match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let printed = error.print().and_then(|()| std::io::stdout().flush());
            match printed {
                // A reader that has gone away is no error.
                Err(lost) if !error.use_stderr() && lost.kind() != std::io::ErrorKind::BrokenPipe => {
                    crate::tell!("{before}standard output: {lost}");
                    FAILURE
                }
                _ => u8::try_from(error.exit_code()).unwrap_or(BAD_INPUT),
            }
        }
        _ => {
            crate::tell!("{before}{} (see `{} --help`)", line(&error), program(&C::command(), &words));
            BAD_INPUT
        }
    })
}

fn read<C: CommandFactory + FromArgMatches>(words: &[OsString]) -> Result<(C, ArgMatches), Error> {
    let matches = C::command().try_get_matches_from(words)?;
    Ok((C::from_arg_matches(&matches)?, matches))
}

/// The words with negative numbers joined to the options before them: `--depth-mm -5` as `--depth-mm=-5`. What is wrong with one is said by who knows what is allowed.
fn joined(words: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let option =
        |word: &OsString| word.to_str().is_some_and(|w| w.len() > 2 && w.starts_with("--") && !w.contains('='));
    let negative = |word: &OsString| {
        let number = |part: &str| part.parse::<f64>().is_ok();
        word.to_str().is_some_and(|w| w.starts_with('-') && w.split(',').all(number))
    };
    let mut out: Vec<OsString> = Vec::new();
    for word in words {
        match out.last_mut() {
            Some(last) if option(last) && negative(&word) => {
                last.push("=");
                last.push(word);
            }
            _ => out.push(word),
        }
    }
    out
}

/// A refusal as one line: what is wrong, what is near it.
fn line(error: &Error) -> String {
    let rendered = error.render().to_string();
    let told = |line: &&str| !line.starts_with("Usage:") && !line.starts_with("For more information");
    let said: Vec<&str> = rendered.lines().map(str::trim).take_while(told).filter(|line| !line.is_empty()).collect();
    let said = said.join(" ").trim_start_matches("error: ").replace(" tip: ", "; ");
    // Nobody who misspells an option means it as a value.
    let said = said.split("; to pass '").next().unwrap_or_default();
    spoken_range(said)
}

/// `-3 is not in 1..=2047` as `-3 is not in 1 to 2047`.
fn spoken_range(said: &str) -> String {
    match said.split_once(" is not in ") {
        Some((before, range)) => {
            format!("{before} is not in {}", range.replacen("..=", " to ", 1).replacen("..", " up to below ", 1))
        }
        None => said.to_owned(),
    }
}

/// The program and its command that the words begin with.
fn program(command: &Command, words: &[OsString]) -> String {
    let known = words.iter().skip(1).find_map(|word| command.find_subcommand(word));
    let name = command.get_name();
    known.map_or_else(|| name.to_owned(), |known| format!("{name} {}", known.get_name()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    #[command(name = "show")]
    struct Show {
        #[command(subcommand)]
        what: What,
    }

    #[derive(Debug, clap::Subcommand)]
    enum What {
        /// A picture.
        Picture {
            file: std::path::PathBuf,
            #[arg(short, long)]
            output: std::path::PathBuf,
            #[arg(long)]
            depth_mm: Option<f64>,
            #[arg(long, value_parser = clap::value_parser!(u32).range(1..=9))]
            rays: Option<u32>,
            #[arg(long, requires = "rays")]
            seed: Option<u64>,
        },
    }

    fn parsed(words: &[&str]) -> Result<Show, Error> {
        let words = joined(["show", "picture"].iter().chain(words).map(Into::into));
        assert_eq!(program(&Show::command(), &words), "show picture");
        read(&words).map(|(show, _)| show)
    }

    #[test]
    fn negative_numbers_are_values() {
        for (word, number) in [("-5", -5.0), ("-1e-300", -1e-300), ("-inf", f64::NEG_INFINITY), ("-.5", -0.5)] {
            let What::Picture { depth_mm, .. } = parsed(&["a", "-o", "b", "--depth-mm", word]).expect("parses").what;
            assert_eq!(depth_mm, Some(number));
        }
        let words = ["a", "--list", "-1,-2", "--flag", "-x", "--depth-mm=1", "-5", "-o", "-5"].map(OsString::from);
        let wanted = ["a", "--list=-1,-2", "--flag", "-x", "--depth-mm=1", "-5", "-o", "-5"].map(OsString::from);
        assert_eq!(joined(words.into_iter()), wanted);
    }

    #[test]
    fn whatever_is_wrong_is_one_line() {
        for (words, found) in [
            (&["a"][..], "--output <OUTPUT>"),
            (&["a", "-o", "b", "--depht-mm", "5"], "--depth-mm"),
            (&["a", "-o", "b", "--depth-mm", "far"], "far"),
            (&["a", "-o", "b", "--rays", "-5"], "-5"),
            (&["a", "-o", "b", "--rays", "70"], "70 is not in 1 to 9"),
            (&["a", "-o", "b", "--seed", "1"], "--rays <RAYS>"),
            (&["a", "-o", "b", "c"], "'c'"),
            (&["a", "-o", "b", "-o", "c"], "--output"),
            (&["a", "-o", "b", "--rays"], "--rays"),
            (&["a", "-o", "b", "--bent"], "unexpected argument '--bent' found"),
        ] {
            let said = line(&parsed(words).expect_err("refused"));
            assert!(said.contains(found) && !said.contains('\n') && !said.contains("to pass"), "{words:?}: {said}");
        }
        let words = ["show", "pictrue"].map(OsString::from);
        let said = line(&read::<Show>(&words).expect_err("refused"));
        assert!(said.contains("'picture'"), "{said}");
        assert_eq!(program(&Show::command(), &words), "show");
    }
}
