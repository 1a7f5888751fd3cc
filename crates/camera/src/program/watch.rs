//! `--watch`: captures are developed as they arrive in folders.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use isoplanat_base::error::{Error, Result};

use crate::program::batch::Batch;
use crate::program::output::{self, Pictures};
use crate::program::say::say;

/// Between two looks.
const PAUSE: Duration = Duration::from_millis(500);

/// What tells a file that is still being written: its size and when it was changed.
type State = (u64, SystemTime);

/// Whether the captures are folders and the output is one that pictures may go to; the latter.
pub(crate) fn folders(pictures: &Pictures) -> Result<&Path> {
    if let Some(file) = pictures.captures.iter().find(|c| !c.is_dir()) {
        return Err(Error::bad(file.display().to_string(), "--watch", "no folder", "folders that captures arrive in"));
    }
    let Some(out) = pictures.out.as_deref().filter(|o| !o.is_file()) else {
        let name = pictures.out.as_ref().map_or_else(String::new, |o| o.display().to_string());
        return Err(Error::bad(name, "-o", "no folder", "a folder, with --watch"));
    };
    let example = out.join(output::named("a", pictures.format));
    pictures.check_format(&example)?;
    let place = |p: &Path| p.canonicalize().ok();
    // A DNG that is written there would be developed again.
    if output::is_dng(&example) && pictures.captures.iter().any(|c| place(c) == place(out)) {
        let found = "a folder that is watched";
        return Err(Error::bad(out.display().to_string(), "-o", found, "another folder, with --format dng"));
    }
    Ok(out)
}

/// Develops what arrives until Ctrl-C; the exit code of the worst capture. A second Ctrl-C ends the program at once.
pub(crate) fn run(batch: &Batch<'_>, out: &Path) -> Result<u8> {
    let pictures = batch.pictures;
    let stop = isoplanat_program::signals::asked();
    let mut done: HashMap<PathBuf, State> = HashMap::new();
    let mut growing: HashMap<PathBuf, State> = HashMap::new();
    // Which capture a picture of this run is of.
    let mut written: HashMap<PathBuf, PathBuf> = HashMap::new();
    let mut code = 0;
    if !batch.told.json {
        let folders: Vec<String> = pictures.captures.iter().map(|f| f.display().to_string()).collect();
        say(&format!("watching {} until Ctrl-C", folders.join(", ")));
    }
    while !stop() {
        let now = look(&pictures.captures)?;
        // Complete is what has not changed since the last look.
        let complete = now.iter().filter(|(path, state)| growing.get(*path) == Some(*state));
        let mut fresh: Vec<(&PathBuf, &State)> =
            complete.filter(|(path, state)| done.get(*path) != Some(*state)).collect();
        fresh.sort();
        let all: Vec<PathBuf> = now.keys().cloned().collect();
        for (capture, state) in fresh {
            if stop() {
                break;
            }
            done.insert(capture.clone(), *state);
            let picture = out.join(output::named(output::stem(capture), pictures.format));
            let other = written.get(&picture).filter(|c| *c != capture);
            if other.is_none() && picture.exists() && !pictures.force {
                continue;
            }
            let developed = match other {
                Some(other) => Err(output::both(other, capture, &picture)),
                None => pictures.check(&picture, &all).and_then(|()| batch.develop((0, 1), capture, &picture)),
            };
            match developed {
                Ok(mut result) => {
                    written.insert(picture, capture.clone());
                    if batch.told.json {
                        result["schema"] = 1.into();
                        say(&result.to_string());
                    }
                }
                Err(error) => code = code.max(batch.complain(&error)),
            }
            batch.finish();
        }
        growing = now;
        std::thread::sleep(PAUSE);
    }
    Ok(code)
}

/// The captures in folders, with their state.
fn look(folders: &[PathBuf]) -> Result<HashMap<PathBuf, State>> {
    let mut found = HashMap::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).map_err(|e| Error::reading(folder, e))?.flatten() {
            let path = entry.path();
            // A file may be gone again.
            let Ok(facts) = std::fs::metadata(&path) else { continue };
            if facts.is_file() && facts.len() > 0 && output::is_capture(&path) {
                found.insert(path, (facts.len(), facts.modified().unwrap_or(SystemTime::UNIX_EPOCH)));
            }
        }
    }
    Ok(found)
}
