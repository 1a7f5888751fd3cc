//! RAW decoding in a child process that is held to little memory and time, and sees no file but the one it decodes.
//!
//! The helper program is started with [`COMMAND`] as its first argument and the open file as its standard input; that child calls `serve`, which writes what
//! holds it as a line of JSON, reads the file, and writes another line and then the samples to its standard output. Whatever happens to the child (a panic, an abort, a
//! refused allocation, no end), the parent turns it into one sentence. How it is held: [`super::child`].

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use crate::child::{self, Confinement, Helper, Limits, Start};
use crate::orientation::Orientation;
use crate::raw::{self, ALLOWED, Area, RawCapture, RawPixels};
use isoplanat_base::atomic;
use isoplanat_base::error::{BadInput, Error, Result};
use isoplanat_base::math::memory::{GIB, Limit, product, words};
use isoplanat_base::threads;
use isoplanat_imaging::exif::Exif;
use isoplanat_imaging::sensor::cfa::Cfa;

/// First argument that makes the program a decoder child.
pub const COMMAND: &str = "decode-raw-child";

/// Where errors of a whole file stand.
const PLACE: &str = "RAW";
/// What a decoder may use at most: 2 GiB of addresses, and two minutes.
const MEMORY: u64 = 2 * GIB;
const TIME: Duration = Duration::from_secs(120);
/// Bytes of the line before the samples at most.
const MOST_WORDS: u64 = 16 << 20;

/// The line before the samples.
#[derive(Serialize, Deserialize)]
enum Reply {
    Capture(Box<Header>),
    Refused(BadInput),
    /// No fault of the file's: the child could not begin.
    Unready(BadInput),
}

#[derive(Clone, Copy, Serialize, Deserialize)]
enum Kind {
    Mosaic(Cfa),
    Linear,
    Grey,
}

#[derive(Serialize, Deserialize)]
struct Header {
    rows: usize,
    columns: usize,
    /// What the samples are.
    kind: Kind,
    /// Samples as `u16` (all are whole numbers) or `f32`, in this machine's byte order.
    integer: bool,
    black: [f32; 4],
    white: [f32; 4],
    corrected: bool,
    crop: Area,
    // Facts come from f32, which JSON carries exactly.
    neutral: Option<[f32; 3]>,
    camera_from_xyz: Option<[[f32; 3]; 3]>,
    orientation: Orientation,
    make: String,
    model: String,
    exif: Exif,
    notes: Vec<String>,
}

/// The child's side: gives up what it does not need by `seal`, decodes `file`, and writes the reply to `out`.
///
/// # Errors
/// A file that cannot be read, a reply that cannot be written. A refused file is a reply, and so is a sandbox that could not be entered.
pub(crate) fn serve(
    mut file: impl Read,
    out: &mut impl Write,
    seal: impl FnOnce() -> std::result::Result<Confinement, String>,
) -> std::io::Result<()> {
    // Said before a byte of the file is read: nothing in the file has a word in it.
    match seal() {
        Ok(confinement) => write_line(out, &Ok::<_, String>(confinement))?,
        Err(why) => return unheld(out, why),
    }
    // In the sandbox, which each thread has from the one that starts it.
    if let Err(error) = threads::start_pool(0) {
        return write_line(out, &Reply::Unready(error.into_bad_input(PLACE, ALLOWED)));
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    drop(file);
    let capture = match raw::decode_bytes(bytes, Path::new("RAW")) {
        Ok(capture) => capture,
        Err(error) => {
            // The parent knows the file's name and puts it in.
            let refused = match error {
                Error::Io { reason, .. } => Error::bad("", PLACE, reason.to_string(), ALLOWED),
                other => other,
            };
            return write_line(out, &Reply::Refused(refused.into_bad_input(PLACE, ALLOWED)));
        }
    };
    let (rows, columns) = capture.size();
    let (samples, kind) = match capture.pixels {
        RawPixels::Mosaic { samples, cfa } => (samples.into_raw_vec_and_offset().0, Kind::Mosaic(cfa)),
        RawPixels::Linear(samples) => (samples.into_raw_vec_and_offset().0, Kind::Linear),
        RawPixels::Grey(samples) => (samples.into_raw_vec_and_offset().0, Kind::Grey),
    };
    let integer = samples.iter().all(|v| (0.0..=65_535.0).contains(v) && v.fract() == 0.0);
    let header = Header {
        rows,
        columns,
        kind,
        integer,
        black: capture.black,
        white: capture.white,
        corrected: capture.corrected,
        crop: capture.crop,
        neutral: capture.neutral.map(|v| v.map(|x| x as f32)),
        camera_from_xyz: capture.camera_from_xyz.map(|m| m.map(|row| row.map(|x| x as f32))),
        orientation: capture.orientation,
        make: capture.make,
        model: capture.model,
        exif: capture.exif,
        notes: capture.notes,
    };
    write_line(out, &Reply::Capture(Box::new(header)))?;
    if !integer {
        out.write_all(bytemuck::cast_slice(&samples))?;
        return out.flush();
    }
    for chunk in samples.chunks(1 << 16) {
        let whole: Vec<u16> = chunk.iter().map(|v| *v as u16).collect();
        out.write_all(bytemuck::cast_slice(&whole))?;
    }
    out.flush()
}

/// The reply of a child that could not be held to its limits.
pub(crate) fn unheld(out: &mut impl Write, why: String) -> std::io::Result<()> {
    write_line(out, &Err::<Confinement, _>(why))
}

fn write_line(out: &mut impl Write, reply: &impl Serialize) -> std::io::Result<()> {
    serde_json::to_writer(&mut *out, reply)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Decodes `path` in a child of `helper`, within `memory`; what held the child, too. Both this process and the child stay within the memory.
///
/// # Errors
/// What [`raw::decode`] refuses, samples beyond the memory, and a child that failed, was stopped by a limit, or could not be started or held.
pub fn decode(helper: &Helper, path: &Path, memory: Limit) -> Result<(RawCapture, Confinement)> {
    let limits = Limits { memory_bytes: memory.bytes.min(MEMORY), time: TIME };
    decode_within(helper, path, limits, memory)
}

fn decode_within(helper: &Helper, path: &Path, limits: Limits, memory: Limit) -> Result<(RawCapture, Confinement)> {
    // Said here, the system's own reason reaches the user; what is no file would be waited for.
    atomic::regular(path)?;
    let file = File::open(path).map_err(|e| Error::reading(path, e))?;
    let failed = |found: String| Error::bad(path.display().to_string(), PLACE, found, ALLOWED);
    let threads = Start::few_threads();
    let start = Start { helper, command: COMMAND, limits, once: true, input: file.into(), threads };
    let mut child = start.spawn().map_err(|e| Error::starting(helper.program(), e))?;
    let pipe = child.stdout.take().ok_or_else(|| Error::Internal("the RAW decoder has no output".into()))?;
    let (sender, receiver) = mpsc::channel();
    let reader = std::thread::Builder::new().spawn(move || {
        // The receiver may have given up already.
        let _ = sender.send(read(BufReader::new(pipe), memory));
    });
    let reader = match reader {
        Ok(reader) => reader,
        Err(reason) => {
            let _ = child.kill();
            let _ = child.wait();
            return Err(threads::refused(&reason));
        }
    };
    let outcome = receiver.recv_timeout(limits.time);
    // A child that is not done has nothing more to say that would be read.
    if !matches!(outcome, Ok(Some(Heard::Capture(..)))) {
        let _ = child.kill();
    }
    let status = child.wait().map_err(|e| Error::Internal(format!("the RAW decoder: {e}")))?;
    let _ = reader.join();
    match outcome {
        Err(_) => Err(failed(format!("the decoder had not finished after {} s", limits.time.as_secs()))),
        Ok(Some(Heard::Capture(capture, confinement))) if status.success() => Ok((*capture, confinement)),
        Ok(Some(Heard::Refused(bad))) => Err(Error::from(bad).of_file(path)),
        Ok(Some(Heard::Unready(bad))) => Err(Error::from(bad)),
        Ok(Some(Heard::Unheld(why))) => {
            Err(Error::Internal(format!("the RAW decoder was not let near the file: {why}")))
        }
        Ok(Some(Heard::TooLarge(error))) => Err(error.of_file(path)),
        Ok(_) => {
            let limit = words(limits.memory_bytes);
            Err(failed(format!("the decoder broke off (damaged file, or more than {limit} of memory)")))
        }
    }
}

/// What a child said.
enum Heard {
    Capture(Box<RawCapture>, Confinement),
    Refused(BadInput),
    Unready(BadInput),
    Unheld(String),
    TooLarge(Error),
}

/// Reads a whole reply, its samples only where there is memory for them; `None` if it is none.
fn read(mut pipe: impl BufRead, memory: Limit) -> Option<Heard> {
    let held: std::result::Result<Confinement, String> = read_line(&mut pipe)?;
    let confinement = match held {
        Ok(confinement) => confinement,
        Err(why) => return Some(Heard::Unheld(why)),
    };
    let header = match read_line(&mut pipe)? {
        Reply::Refused(bad) => return Some(Heard::Refused(bad)),
        Reply::Unready(bad) => return Some(Heard::Unready(bad)),
        Reply::Capture(header) => *header,
    };
    let planes = if matches!(header.kind, Kind::Linear) { 3 } else { 1 };
    let (rows, columns) = (header.rows, header.columns);
    let count = rows.checked_mul(columns)?.checked_mul(planes)?;
    let needed = product(&[count, size_of::<f32>()]);
    if let Err(error) = memory.allow(&format!("the samples of {columns} × {rows} pixels"), needed, "a smaller picture")
    {
        return Some(Heard::TooLarge(error));
    }
    let samples = if header.integer { read_whole(&mut pipe, count) } else { child::read_samples(&mut pipe, count) };
    let samples = samples.ok()?;
    // More than was promised is no reply.
    if !pipe.fill_buf().ok()?.is_empty() {
        return None;
    }
    let plane = |samples| Array2::from_shape_vec((rows, columns), samples).ok();
    let pixels = match header.kind {
        Kind::Mosaic(cfa) => RawPixels::Mosaic { samples: plane(samples)?, cfa },
        Kind::Grey => RawPixels::Grey(plane(samples)?),
        Kind::Linear => RawPixels::Linear(Array3::from_shape_vec((3, rows, columns), samples).ok()?),
    };
    let capture = RawCapture {
        pixels,
        black: header.black,
        white: header.white,
        corrected: header.corrected,
        crop: header.crop,
        neutral: header.neutral.map(|v| v.map(f64::from)),
        camera_from_xyz: header.camera_from_xyz.map(|m| m.map(|row| row.map(f64::from))),
        orientation: header.orientation,
        make: header.make,
        model: header.model,
        exif: header.exif,
        notes: header.notes,
    };
    Some(Heard::Capture(Box::new(capture), confinement))
}

/// What a line of JSON says; `None` if it is none.
fn read_line<T: for<'a> Deserialize<'a>>(pipe: &mut impl BufRead) -> Option<T> {
    let mut line = Vec::new();
    pipe.take(MOST_WORDS).read_until(b'\n', &mut line).ok()?;
    serde_json::from_slice(line.strip_suffix(b"\n")?).ok()
}

/// So many whole numbers of 16 bits.
fn read_whole(input: &mut impl Read, count: usize) -> std::io::Result<Vec<f32>> {
    let mut samples = Vec::new();
    let mut piece = vec![0_u16; 1 << 16];
    while samples.len() < count {
        let n = piece.len().min(count - samples.len());
        input.read_exact(bytemuck::cast_slice_mut(&mut piece[..n]))?;
        samples.extend(piece[..n].iter().map(|v| f32::from(*v)));
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::shared;

    fn open() -> std::result::Result<Confinement, String> {
        Ok(Confinement::default())
    }

    fn replied(path: &Path) -> Vec<u8> {
        let mut bytes = Vec::new();
        serve(File::open(path).expect("opens"), &mut bytes, open).expect("writes");
        bytes
    }

    #[test]
    fn the_reply_carries_the_capture_to_the_bit() {
        let memory = Limit { bytes: GIB };
        for name in ["nikon_crop_gbrg_u16.dng", "canon_eos_6d_linear_lossy.dng"] {
            let Some(path) = shared(&format!("data/raw/{name}")) else { return };
            let mut bytes = replied(&path);
            let Some(Heard::Capture(there, _)) = read(&bytes[..], memory) else { panic!("{name}: decoded") };
            assert_eq!(*there, raw::decode(&path).expect("decodes"));
            let little = Limit { bytes: 1 << 10 };
            assert!(matches!(read(&bytes[..], little), Some(Heard::TooLarge(e)) if e.exit_code() == 2));
            bytes.push(0);
            assert!(read(&bytes[..], memory).is_none(), "a reply with more behind it is no reply");
            bytes.truncate(bytes.len() - 2);
            assert!(read(&bytes[..], memory).is_none(), "a reply cut short is no reply");
        }
    }

    #[test]
    fn a_refusal_is_a_reply() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("a.dng");
        std::fs::write(&path, "not a picture").expect("writes");
        let heard = read(&replied(&path)[..], Limit { bytes: GIB });
        let Some(Heard::Refused(bad)) = heard else { panic!("refused") };
        assert!(bad.found.contains("cannot be decoded"), "{bad}");
    }

    /// A child that cannot be held to its limits does not read the file.
    #[test]
    fn a_child_that_is_not_held_reads_nothing() {
        struct Untouched;
        impl Read for Untouched {
            fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
                panic!("read")
            }
        }
        let mut bytes = Vec::new();
        serve(Untouched, &mut bytes, || Err("no limits here".into())).expect("writes");
        let heard = read(&bytes[..], Limit { bytes: GIB });
        assert!(matches!(heard, Some(Heard::Unheld(why)) if why == "no limits here"));
    }

    #[cfg(unix)]
    #[test]
    fn children_that_fail_hang_or_babble_become_one_sentence() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let raw = dir.path().join("a.nef");
        std::fs::write(&raw, "x").expect("writes");
        let limits = Limits { memory_bytes: 1 << 30, time: Duration::from_millis(500) };
        for (name, script, words) in [
            ("dies", "kill -9 $$", "broke off"),
            ("fails", "exit 3", "broke off"),
            ("babbles", "echo hello", "broke off"),
            ("hangs", "exec sleep 30", "had not finished"),
        ] {
            let program = dir.path().join(name);
            crate::child::tests::script(&program, script);
            let error =
                decode_within(&Helper::at(program), &raw, limits, Limit { bytes: GIB }).expect_err("no picture");
            assert!(error.to_string().contains(words), "{name}: {error}");
            assert_eq!(error.exit_code(), 2);
        }
    }
}
