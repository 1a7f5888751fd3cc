//! Files that appear whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use super::place::{self, Destination};
use super::temporary::{Temporary, TemporaryFolder};
use super::{Replace, Target, fault, name, rename, sweep};
use crate::error::{Error, Result};

/// Bytes put into a file, whole or not at all: [`publish_file`].
///
/// ```
/// use isoplanat_base::atomic::{Target, read_text, write_bytes};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("note.txt");
/// write_bytes(Target::new(&path, false), b"first")?;
/// // What is there stays, unless it may be replaced.
/// assert!(write_bytes(Target::new(&path, false), b"second").is_err());
/// write_bytes(Target::new(&path, true), b"third")?;
/// assert_eq!(read_text(&path, 100)?, "third");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_bytes<'a>(to: impl Into<Target<'a>>, bytes: &[u8]) -> Result<()> {
    let to = to.into();
    write_atomic(to, |out| out.write_all(bytes).map_err(|e| Error::writing(to.path, e)))
}

/// A file that `fill` writes: [`publish_file`].
pub fn write_atomic<'a>(
    to: impl Into<Target<'a>>,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>,
) -> Result<()> {
    let Target { path, replace } = to.into();
    publish_file(path, replace, fill)
}

/// Bytes put into a file that can be made again: whole or not at all for readers, in place of whatever was there. They are not synced (a
/// loss of power may leave an empty file: its reader checks them), and leftovers of dead writers are not looked for.
///
/// # Errors
/// As [`publish_file`].
pub fn write_cached(path: &Path, bytes: &[u8]) -> Result<()> {
    publish(path, Replace::Always, false, |out| out.write_all(bytes).map_err(|e| Error::writing(path, e)))
}

/// A file that `fill` writes beside `path` and that gets its name when that went well; otherwise everything is as it was. What `fill`
/// returned.
///
/// With [`Replace::Never`] one of several simultaneous writers succeeds. The mode of a replaced file is kept (its owner and second names
/// are not). Links are followed: the link stays. A device or a pipe is written into once `fill` is done, with either `replace`; a block
/// device only with [`Replace::Always`]. File and folder are synced, within a folder that is being published with that folder.
///
/// # Errors
/// [`Error::Exists`] before `fill` or after it; `fill`'s; a folder at `path`, none around it, and what else the disk says.
pub fn publish_file<T>(
    path: &Path,
    replace: Replace,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T>,
) -> Result<T> {
    publish(path, replace, true, fill)
}

/// [`publish_file`] for writers that open their file themselves: `fill` gets the path of a file that is not there yet, in a folder of its own.
///
/// # Errors
/// As [`publish_file`].
pub fn publish_path<T>(path: &Path, replace: Replace, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let failed = |e| Error::writing(path, e);
    let way = match way(path, replace, true)? {
        Way::Move(way) => way,
        Way::Pour(stream) => {
            let folder = TemporaryFolder::beside(&std::env::temp_dir().join("isoplanat")).map_err(failed)?;
            let at = folder.path().join("output");
            let value = fill(&at)?;
            File::open(&at).and_then(|file| poured(&file, &stream)).map_err(failed)?;
            return Ok(value);
        }
    };
    let folder = TemporaryFolder::beside(&way.target).map_err(failed)?;
    let at = folder.path().join(way.target.file_name().unwrap_or_default());
    fault::at("fill").map_err(failed)?;
    let value = fill(&at)?;
    let file = File::options().write(true).open(&at).map_err(failed)?;
    // Writers that take care of secrets make their files for their owner alone.
    let new = folder.mode().map_err(failed)?;
    keep_mode(&file, way.before.as_ref().unwrap_or(&new)).and_then(|()| way.sync(&file)).map_err(failed)?;
    drop(file);
    folder.settle();
    moved(path, &at, &way.target, replace)?;
    drop(folder);
    way.sync_name().map_err(failed)?;
    Ok(value)
}

fn publish<T>(
    path: &Path,
    replace: Replace,
    sync: bool,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T>,
) -> Result<T> {
    let failed = |e| Error::writing(path, e);
    let way = match way(path, replace, sync)? {
        Way::Move(way) => way,
        Way::Pour(stream) => {
            // Written at once and without an end that can be sought: what `fill` writes is kept elsewhere until it is whole.
            let temporary = Temporary::beside(&std::env::temp_dir().join("isoplanat")).map_err(failed)?;
            temporary.hidden().map_err(failed)?;
            let value = filled(path, &temporary, fill)?;
            (&temporary.file).rewind().and_then(|()| poured(&temporary.file, &stream)).map_err(failed)?;
            return Ok(value);
        }
    };
    let temporary = Temporary::beside(&way.target).map_err(failed)?;
    way.keep_mode(&temporary.file).map_err(failed)?;
    let value = filled(path, &temporary, fill)?;
    way.sync(&temporary.file).map_err(failed)?;
    temporary.settle();
    moved(path, temporary.path(), &way.target, replace)?;
    drop(temporary);
    way.sync_name().map_err(failed)?;
    Ok(value)
}

/// How what is written gets to its place.
enum Way {
    /// Moved there when it is whole.
    Move(Move),
    /// Written into what stands there.
    Pour(PathBuf),
}

/// A place that a file is moved to.
struct Move {
    target: PathBuf,
    /// The mode of the file that gives way.
    before: Option<fs::Permissions>,
    /// Whether it is synced by itself; within a folder that is being published all is cleared and synced with it.
    alone: bool,
}

/// The way to `path`, cleared of what dead writers have left there.
fn way(path: &Path, replace: Replace, sync: bool) -> Result<Way> {
    let (target, before) = match allowed(path, replace)? {
        Destination::Stream(stream) => return Ok(Way::Pour(stream)),
        Destination::File(target, found) => (target, Some(found.permissions())),
        Destination::Free(target) | Destination::Folder(target) => (target, None),
    };
    let alone = sync && !name::in_temporary(&target);
    if alone {
        sweep::sweep(&target);
    }
    Ok(Way::Move(Move { target, before, alone }))
}

impl Move {
    fn keep_mode(&self, file: &File) -> io::Result<()> {
        self.before.as_ref().map_or(Ok(()), |before| keep_mode(file, before))
    }

    fn sync(&self, file: &File) -> io::Result<()> {
        if self.alone { fault::at("sync file").and_then(|()| file.sync_all()) } else { Ok(()) }
    }

    /// Has the disk know the new name.
    fn sync_name(&self) -> io::Result<()> {
        match self.target.parent() {
            Some(folder) if self.alone => rename::sync_folder(folder),
            _ => Ok(()),
        }
    }
}

/// Gives a written file its name.
fn moved(path: &Path, from: &Path, target: &Path, replace: Replace) -> Result<()> {
    let to = match replace {
        Replace::Always => rename::over(from, target),
        Replace::Never => rename::exclusive_file(from, target),
    };
    to.map_err(|e| match (e.kind(), replace) {
        (io::ErrorKind::AlreadyExists, Replace::Never) => Error::Exists(path.to_owned()),
        _ => Error::writing(path, e),
    })
}

/// What stands at `path` where a file may be put there; its folder is there.
///
/// # Errors
/// [`Error::Exists`]; a folder in the file's place, none around it, a path without a file's name.
pub(super) fn allowed(path: &Path, replace: Replace) -> Result<Destination> {
    let refuse = |kind: io::ErrorKind, text: String| Err(Error::writing(path, io::Error::new(kind, text)));
    let place = place::of(path)?;
    match &place {
        Destination::Folder(_) => refuse(io::ErrorKind::IsADirectory, "a folder stands there; name a file".into()),
        Destination::File(..) if replace == Replace::Never => Err(Error::Exists(path.to_owned())),
        Destination::Stream(stream) if replace == Replace::Never && is_disk(stream) => {
            Err(Error::Exists(path.to_owned()))
        }
        Destination::Free(target) => {
            let ends = path.as_os_str().as_encoded_bytes().last().copied();
            if target.file_name().is_none() || ends.is_some_and(|b| std::path::is_separator(b.into())) {
                return refuse(io::ErrorKind::IsADirectory, "the name of a folder; name a file".into());
            }
            match target.parent() {
                Some(folder) if folder.is_dir() => Ok(place),
                around => {
                    let given = path.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()).or(around);
                    let folder = given.unwrap_or(path).display();
                    refuse(io::ErrorKind::NotFound, format!("there is no folder {folder}"))
                }
            }
        }
        _ => Ok(place),
    }
}

/// Runs `fill` on the file and brings what it wrote out of the buffer.
fn filled<T>(path: &Path, temporary: &Temporary, fill: impl FnOnce(&mut BufWriter<File>) -> Result<T>) -> Result<T> {
    let failed = |e| Error::writing(path, e);
    let mut out = BufWriter::new(temporary.file.try_clone().map_err(failed)?);
    fault::at("fill").map_err(failed)?;
    let value = fill(&mut out)?;
    fault::at("flush").and_then(|()| out.flush()).map_err(failed)?;
    Ok(value)
}

/// Writes a whole file into a device, a pipe or an open file.
fn poured(mut from: &File, stream: &Path) -> io::Result<()> {
    fault::at("pour")?;
    let mut out = opened(stream)?;
    io::copy(&mut from, &mut out)?;
    out.flush()
}

/// A stream to write to. The program's own output goes on where it is; an open file of another's is written on at its end.
fn opened(stream: &Path) -> io::Result<File> {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd;
        let ours = format!("/proc/{}/", std::process::id());
        if stream.starts_with(ours) || stream.starts_with("/dev/fd") {
            let number = stream.file_name().and_then(|n| n.to_str());
            let output = match number {
                Some("1") => {
                    io::stdout().flush()?;
                    Some(io::stdout().as_fd().try_clone_to_owned()?)
                }
                Some("2") => Some(io::stderr().as_fd().try_clone_to_owned()?),
                _ => None,
            };
            if let Some(output) = output {
                return Ok(output.into());
            }
        }
    }
    File::options().append(true).open(stream)
}

/// Whether a stream is a block device: what is written there is replaced.
fn is_disk(stream: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        fs::metadata(stream).is_ok_and(|m| m.file_type().is_block_device())
    }
    #[cfg(not(unix))]
    {
        let _ = fs::metadata(stream);
        false
    }
}

/// Gives a file the mode of the one that it replaces; without rights that go with its owner.
fn keep_mode(file: &File, before: &fs::Permissions) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.set_permissions(fs::Permissions::from_mode(before.mode() & 0o777))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, before);
        Ok(())
    }
}
