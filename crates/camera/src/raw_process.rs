//! RAW decoding in a child process with a memory and a time limit.
//!
//! The program starts itself again with [`COMMAND`] as its first argument; that child calls [`serve`], which writes one
//! line of JSON and then the samples to its standard output. Whatever happens to the child (a panic, an abort, a
//! refused allocation, no end), the parent turns it into one sentence. How the limits are kept: [`super::child`].

use std::io::{Read, Write};
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use crate::child::{self, Limits, Start};
use crate::orientation::Orientation;
use crate::raw::{self, ALLOWED, Area, RawCapture, RawPixels};
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::exif::Exif;
use isoplanat_imaging::sensor::cfa::Cfa;

/// First argument that makes the program a decoder child; the path of the RAW file follows.
pub const COMMAND: &str = "decode-raw-child";

/// What a decoder may use: 2 GiB and two minutes.
pub const LIMITS: Limits = Limits { memory_bytes: 2 << 30, time: Duration::from_secs(120) };

/// The line before the samples.
#[derive(Serialize, Deserialize)]
enum Reply {
    Capture(Header),
    Refused { found: String, allowed: String },
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

/// The child's side: decodes `path` and writes the reply to `out`.
///
/// # Errors
/// A reply that cannot be written. A refused file is a reply.
pub fn serve(path: &Path, out: &mut impl Write) -> std::io::Result<()> {
    child::follow_parent();
    let capture = match raw::decode(path) {
        Ok(capture) => capture,
        Err(error) => {
            // The parent knows the file's name and puts it before the sentence again.
            let (found, allowed) = match error {
                Error::BadInput { found, allowed, .. } => (found, allowed),
                Error::Io { reason, .. } => (reason.to_string(), ALLOWED.into()),
                other => (other.to_string(), ALLOWED.into()),
            };
            return write_line(out, &Reply::Refused { found, allowed });
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
    write_line(out, &Reply::Capture(header))?;
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

fn write_line(out: &mut impl Write, reply: &Reply) -> std::io::Result<()> {
    serde_json::to_writer(&mut *out, reply)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Decodes `path` in a child: `program COMMAND path`.
///
/// # Errors
/// What [`raw::decode`] refuses, and a child that failed, was stopped by a limit, or could not be started.
pub fn decode(program: &Path, path: &Path, limits: Limits) -> Result<RawCapture> {
    // Said here, the system's own reason reaches the user; what is no file would be waited for.
    atomic::regular(path)?;
    std::fs::File::open(path).map_err(|e| Error::reading(path, e))?;
    let refused = |found: String, allowed: String| Error::bad(path.display().to_string(), "RAW", found, allowed);
    let failed = |found: String| refused(found, ALLOWED.into());
    let start = |path: std::path::PathBuf| {
        let arguments = &[COMMAND.into(), path.into()];
        Start { program, arguments, limits, once: true, listens: false, threads: Start::few_threads() }.spawn()
    };
    let mut child = std::path::absolute(path)
        .and_then(start)
        .map_err(|e| Error::Internal(format!("the RAW decoder could not be started: {e}")))?;
    let mut pipe = child.stdout.take().ok_or_else(|| Error::Internal("the RAW decoder has no output".into()))?;
    let (sender, receiver) = mpsc::channel();
    let most = limits.memory_bytes;
    let reader = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        let outcome = pipe.by_ref().take(most).read_to_end(&mut bytes).map(|_| bytes);
        // The receiver may have given up already.
        let _ = sender.send(outcome);
    });
    let outcome = receiver.recv_timeout(limits.time);
    let timed_out = outcome.is_err();
    if timed_out {
        let _ = child.kill();
    }
    let status = child.wait().map_err(|e| Error::Internal(format!("the RAW decoder: {e}")))?;
    let _ = reader.join();
    if timed_out {
        return Err(failed(format!("the decoder had not finished after {} s", limits.time.as_secs())));
    }
    let bytes = outcome.ok().and_then(std::result::Result::ok).unwrap_or_default();
    match parse(&bytes) {
        Some(Ok(capture)) if status.success() => Ok(capture),
        Some(Err((found, allowed))) => Err(refused(found, allowed)),
        _ => {
            let limit = limits.memory_bytes >> 20;
            Err(failed(format!("the decoder broke off (damaged file, or more than {limit} MiB of memory)")))
        }
    }
}

/// The child's bytes; `None` if they are not a whole reply, `Some(Err)` with what the child found and what is allowed if
/// it refused.
fn parse(bytes: &[u8]) -> Option<std::result::Result<RawCapture, (String, String)>> {
    let end = bytes.iter().position(|&b| b == b'\n')?;
    let header = match serde_json::from_slice(&bytes[..end]).ok()? {
        Reply::Refused { found, allowed } => return Some(Err((found, allowed))),
        Reply::Capture(header) => header,
    };
    let body = &bytes[end + 1..];
    let planes = if matches!(header.kind, Kind::Linear) { 3 } else { 1 };
    let count = header.rows.checked_mul(header.columns)?.checked_mul(planes)?;
    if body.len() != count.checked_mul(if header.integer { 2 } else { 4 })? {
        return None;
    }
    let samples: Vec<f32> = if header.integer {
        body.chunks_exact(2).map(|b| f32::from(u16::from_ne_bytes([b[0], b[1]]))).collect()
    } else {
        body.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect()
    };
    let size = (header.rows, header.columns);
    let plane = |samples| Array2::from_shape_vec(size, samples).ok();
    let pixels = match header.kind {
        Kind::Mosaic(cfa) => RawPixels::Mosaic { samples: plane(samples)?, cfa },
        Kind::Grey => RawPixels::Grey(plane(samples)?),
        Kind::Linear => RawPixels::Linear(Array3::from_shape_vec((3, size.0, size.1), samples).ok()?),
    };
    Some(Ok(RawCapture {
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
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::shared;

    #[test]
    fn the_reply_carries_the_capture_to_the_bit() {
        for name in ["nikon_crop_gbrg_u16.dng", "canon_eos_6d_linear_lossy.dng"] {
            let Some(path) = shared(&format!("data/raw/{name}")) else { return };
            let mut bytes = Vec::new();
            serve(&path, &mut bytes).expect("writes");
            let there = parse(&bytes).expect("whole").expect("decoded");
            assert_eq!(there, raw::decode(&path).expect("decodes"));
            bytes.pop();
            assert!(parse(&bytes).is_none(), "a reply cut short is no reply");
        }
    }

    #[test]
    fn a_refusal_is_a_reply() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("text.dng");
        std::fs::write(&path, "not a picture").expect("writes");
        let mut bytes = Vec::new();
        serve(&path, &mut bytes).expect("writes");
        let (found, _) = parse(&bytes).expect("whole").expect_err("refused");
        assert!(found.contains("cannot be decoded"), "{found}");
    }

    #[cfg(unix)]
    #[test]
    fn children_that_fail_hang_or_babble_become_one_sentence() {
        use std::os::unix::fs::PermissionsExt;
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
            std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).expect("writes");
            std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("executable");
            let error = decode(&program, &raw, limits).expect_err("no picture");
            assert!(error.to_string().contains(words), "{name}: {error}");
            assert_eq!(error.exit_code(), 2);
        }
    }
}
