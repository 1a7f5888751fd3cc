//! This program once more, as a child with a memory and a time limit: what decodes files and runs models of others.
//!
//! On Unix the limits of memory and processor time are the shell's `ulimit -v` and `-t`; where the system has no such limit (Windows, macOS) only
//! the parent's time limit holds. On Linux a child dies with the thread that started it: with its parent, where that is the main one.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Threads that a child's processor time is counted for at most, and that it gets where nobody says more.
const WORKERS: usize = 4;

/// What a child may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Address space, bytes.
    pub memory_bytes: u64,
    /// Time until an answer.
    pub time: Duration,
}

/// How a child is started.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start<'a> {
    pub(super) program: &'a Path,
    pub(super) arguments: &'a [OsString],
    pub(super) limits: Limits,
    /// Whether the time limit is one of processor time too, on each of its threads: for a child that answers once.
    pub(super) once: bool,
    /// Whether it is written to.
    pub(super) listens: bool,
    /// Threads that it may have.
    pub(super) threads: usize,
}

impl Start<'_> {
    /// As many threads as a child gets where nobody says more.
    pub(super) fn few_threads() -> usize {
        std::thread::available_parallelism().map_or(1, |n| n.get().min(WORKERS))
    }

    /// Starts it, on Unix through `sh` which sets the limits.
    pub(super) fn spawn(self) -> std::io::Result<Child> {
        let start = |mut command: Command| {
            // Ctrl-C in a terminal is the parent's affair.
            #[cfg(unix)]
            std::os::unix::process::CommandExt::process_group(&mut command, 0);
            command
                // Each allocator arena and each worker's stack reserves address space, which is what is limited.
                .env("MALLOC_ARENA_MAX", "2")
                .env("RAYON_NUM_THREADS", self.threads.to_string())
                .stdin(if self.listens { Stdio::piped() } else { Stdio::null() })
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
        };
        if cfg!(unix) {
            let mut command = Command::new("sh");
            let script = "ulimit -c 0 2>/dev/null; ulimit -v \"$1\" 2>/dev/null; ulimit -t \"$2\" 2>/dev/null; shift 2; exec \"$@\"";
            let seconds = self.limits.time.as_secs().max(1) * WORKERS as u64;
            let seconds = if self.once { seconds.to_string() } else { "unlimited".to_owned() };
            command.args(["-c", script, "sh"]).arg((self.limits.memory_bytes >> 10).to_string()).arg(seconds);
            command.arg(self.program).args(self.arguments);
            if let Ok(child) = start(command) {
                return Ok(child);
            }
        }
        let mut command = Command::new(self.program);
        command.args(self.arguments);
        start(command)
    }
}

/// The child's side: a parent that is killed, or a thread that started it and ended, takes it along, on Linux.
pub(super) fn follow_parent() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
}

/// Samples read at a time, so that nobody is believed who promises many.
const PIECE: usize = 1 << 18;

/// So many samples in this machine's byte order, as both ends of the pipe have them.
pub(super) fn read_samples(input: &mut impl std::io::Read, count: usize) -> std::io::Result<Vec<f32>> {
    let mut samples = Vec::new();
    while samples.len() < count {
        let from = samples.len();
        samples.resize(count.min(from + PIECE), 0.0);
        input.read_exact(bytemuck::cast_slice_mut(&mut samples[from..]))?;
    }
    Ok(samples)
}
