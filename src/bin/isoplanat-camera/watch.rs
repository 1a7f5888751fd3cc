//! `--watch`: captures are developed as they arrive in folders.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use isoplanat::deploy::raw::has_raw_name;
use isoplanat::{Error, Result};

use crate::batch::Batch;
use crate::command::{Arguments, say};
use crate::output;

/// Between two looks.
const PAUSE: Duration = Duration::from_millis(500);

/// Set by Ctrl-C.
static STOP: AtomicBool = AtomicBool::new(false);

/// What tells a file that is still being written: its size and when it was changed.
type State = (u64, SystemTime);

/// Whether the captures are folders and the output is one; the latter.
pub(crate) fn folders(arguments: &Arguments) -> Result<&Path> {
    if let Some(file) = arguments.captures.iter().find(|c| !c.is_dir()) {
        return Err(Error::bad(file.display().to_string(), "--watch", "no folder", "folders that captures arrive in"));
    }
    match arguments.out.as_deref() {
        Some(out) if !out.is_file() => Ok(out),
        out => {
            let name = out.map_or_else(String::new, |o| o.display().to_string());
            Err(Error::bad(name, "-o", "no folder", "a folder, with --watch"))
        }
    }
}

/// Develops what arrives until Ctrl-C; the exit code of the worst capture.
pub(crate) fn run(arguments: &Arguments, out: &Path, batch: &Batch<'_>) -> Result<u8> {
    ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed))
        .map_err(|e| Error::Internal(format!("Ctrl-C cannot be heard: {e}")))?;
    let mut done: HashMap<PathBuf, State> = HashMap::new();
    let mut growing: HashMap<PathBuf, State> = HashMap::new();
    let mut code = 0;
    if !arguments.json {
        let folders: Vec<String> = arguments.captures.iter().map(|f| f.display().to_string()).collect();
        say(&format!("watching {} until Ctrl-C", folders.join(", ")));
    }
    while !STOP.load(Ordering::Relaxed) {
        let now = look(&arguments.captures)?;
        // Complete is what has not changed since the last look.
        let complete = now.iter().filter(|(path, state)| growing.get(*path) == Some(*state));
        let mut fresh: Vec<(&PathBuf, &State)> =
            complete.filter(|(path, state)| done.get(*path) != Some(*state)).collect();
        fresh.sort();
        for (capture, state) in fresh {
            if STOP.load(Ordering::Relaxed) {
                break;
            }
            done.insert(capture.clone(), *state);
            let picture = out.join(output::named(output::stem(capture), arguments.format));
            if picture.exists() && !arguments.force {
                continue;
            }
            let developed = output::check(&picture, std::slice::from_ref(capture), arguments)
                .and_then(|()| batch.develop((0, 1), capture, &picture));
            match developed {
                Ok(result) if arguments.json => say(&result.to_string()),
                Ok(_) => {}
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
            if facts.is_file() && facts.len() > 0 && has_raw_name(&path) {
                found.insert(path, (facts.len(), facts.modified().unwrap_or(SystemTime::UNIX_EPOCH)));
            }
        }
    }
    Ok(found)
}
