//! A program once more, as a child that decodes files or runs models of others and can do little else.
//!
//! In `child/`: the program that is started (`helper.rs`), the limits that the child sets itself first of all (`limits.rs`), the sandbox that it enters before it
//! reads a byte of others (`sandbox.rs`, `denied.rs`), and what of it is in force (`confinement.rs`). On Linux a child dies with the thread that started it:
//! with its parent, where that is the main one.

mod confinement;
#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
mod denied;
mod helper;
mod limits;
mod sandbox;
#[cfg(test)]
pub(crate) mod tests;

use std::process::{Child, Command, Stdio};

pub use confinement::Confinement;
pub use helper::Helper;
pub(super) use limits::Bounds;
pub use limits::Limits;
pub(super) use sandbox::enter;

/// Threads that a child's processor time is counted for at most, and that it gets where nobody says more.
const WORKERS: usize = 4;

/// Variables of the environment that a child gets from its parent; all others are not for it.
///
/// The loader's paths, by which the program itself and ONNX Runtime may have been installed. On Windows `PATH` is the loader's path, and without `SystemRoot`
/// its own libraries do not load. (Where ONNX Runtime lies, `ORT_DYLIB_PATH` too, the parent looks up and says.)
const KEPT: &[&str] = if cfg!(windows) {
    &["PATH", "SystemRoot"]
} else if cfg!(target_vendor = "apple") {
    &["DYLD_LIBRARY_PATH", "DYLD_FALLBACK_LIBRARY_PATH"]
} else {
    &["LD_LIBRARY_PATH"]
};

/// How a child is started.
#[derive(Debug)]
pub(super) struct Start<'a> {
    pub(super) helper: &'a Helper,
    /// What it is to do.
    pub(super) command: &'static str,
    pub(super) limits: Limits,
    /// Whether the time limit is one of processor time too, on each of its threads: for a child that answers once.
    pub(super) once: bool,
    /// What it reads.
    pub(super) input: Stdio,
    /// Threads that it may have.
    pub(super) threads: usize,
}

impl Start<'_> {
    /// As many threads as a child gets where nobody says more.
    pub(super) fn few_threads() -> usize {
        std::thread::available_parallelism().map_or(1, |n| n.get().min(WORKERS))
    }

    /// Starts it, without a shell, and with nothing of the environment but what it needs.
    pub(super) fn spawn(self) -> std::io::Result<Child> {
        let processor_s = self.once.then(|| self.limits.time.as_secs().max(1) * WORKERS as u64);
        let mut command = Command::new(self.helper.program());
        // Ctrl-C in a terminal is the parent's affair.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        command
            .arg(self.command)
            .args(Bounds { memory_bytes: self.limits.memory_bytes, processor_s }.words())
            .env_clear()
            .envs(KEPT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))))
            // Each allocator arena and each worker's stack reserves address space, which is what is limited.
            .env("MALLOC_ARENA_MAX", "2")
            .env("RAYON_NUM_THREADS", self.threads.to_string())
            // Some builds of ONNX Runtime keep a number of the machine in its user's folder, and tell their makers of their use.
            .env("ORT_DISABLE_TELEMETRY", "1")
            .stdin(self.input)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
    }
}

/// The child's side: a parent that is killed, or a thread that started it and ended, takes it along, on Linux.
pub(super) fn follow_parent() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
}

/// The child's side: its standard input as the file that it is, whose length is known.
pub(super) fn standard_input() -> std::io::Result<std::fs::File> {
    #[cfg(unix)]
    let input = std::os::fd::AsFd::as_fd(&std::io::stdin()).try_clone_to_owned()?;
    #[cfg(windows)]
    let input = std::os::windows::io::AsHandle::as_handle(&std::io::stdin()).try_clone_to_owned()?;
    Ok(input.into())
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
