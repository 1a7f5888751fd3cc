//! How much memory work may take, and refusals of work that would take more.

use std::path::{Path, PathBuf};

#[cfg(unix)]
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::error::{Error, Result};

/// Bytes of a gibibyte.
pub const GIB: u64 = 1 << 30;
/// What a process takes that does nothing large: code, tables of rays, stacks, what each thread's allocator holds back.
pub const BASE: u64 = 32 << 20;
/// Part of the available memory that may be used, in hundredths.
const PART: u64 = 80;
/// Addresses beside the limit: code and libraries loaded later, and what a thread's allocator and stack reserve without using it.
const RESERVED: u64 = GIB;
const RESERVED_THREAD: u64 = 160 << 20;
/// The limit where the system does not tell what is available.
const UNKNOWN: u64 = 8 * GIB;

/// The most bytes that a piece of work may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    /// Bytes.
    pub bytes: u64,
}

impl Limit {
    /// A limit in GiB.
    ///
    /// # Errors
    /// A number that is not positive, or larger than any memory.
    pub fn gib(gib: f64) -> Result<Self> {
        if !(gib > 0.0 && gib <= 1e6) {
            return Err(Error::bad("--memory-gib", "value", gib.to_string(), "a positive number of GiB"));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "checked"
        )]
        let bytes = (gib * GIB as f64) as u64;
        Ok(Self { bytes })
    }

    /// Four fifths of the memory that this process can still get: of `MemAvailable`, and of what its control groups and its own limit on addresses leave it.
    /// 8 GiB where the system does not tell.
    pub fn of_process() -> Self {
        let system = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| available(&text));
        let groups = std::fs::read_to_string("/proc/self/cgroup").ok();
        let group = groups.and_then(|text| left_in_groups(&text, Path::new("/sys/fs/cgroup")));
        let least = system.into_iter().chain(group).chain(left_of_addresses()).min();
        Self { bytes: least.map_or(UNKNOWN, |bytes| bytes / 100 * PART) }
    }

    /// Has the system refuse what goes beyond it, as far as it can: addresses beyond those that the process has now, with room for what its threads reserve and
    /// do not use. An estimate that was too low then ends the work in place of the machine's memory.
    #[cfg(unix)]
    pub fn hold(&self) {
        let Some(used) = addresses() else { return };
        let most = used.saturating_add(self.addresses(threads()));
        let most = getrlimit(Resource::As).current.map_or(most, |current| current.min(most));
        // A system that takes no limit has none.
        let _ = restrict(Resource::As, most, false);
    }

    /// Nothing, where the system knows no such limit.
    #[cfg(not(unix))]
    pub(crate) fn hold(&self) {}

    /// Addresses that work within the limit takes on so many threads, with what they reserve and do not use.
    pub fn addresses(&self, threads: usize) -> u64 {
        let room = RESERVED.saturating_add(RESERVED_THREAD.saturating_mul(threads as u64));
        self.bytes.saturating_add(room)
    }

    /// Refuses `what` if it takes more than `bytes`; `instead` says what would take less.
    ///
    /// # Errors
    /// One line with the estimate, the limit and what to change.
    pub fn allow(&self, what: &str, bytes: u64, instead: &str) -> Result<()> {
        if bytes <= self.bytes {
            return Ok(());
        }
        let allowed = format!("at most {} here (--memory-gib); {instead}", words(self.bytes));
        Err(Error::bad("memory", what, format!("about {} needed", words(bytes)), allowed))
    }
}

/// Limits a resource of this process to `most`, or to what it may have at most; `for_good`: it cannot be given more later. What then stands.
///
/// # Errors
/// What the system says: a kind that it does not limit, a number that it does not take.
#[cfg(unix)]
pub fn restrict(resource: Resource, most: u64, for_good: bool) -> std::io::Result<u64> {
    let maximum = getrlimit(resource).maximum;
    let most = maximum.map_or(most, |maximum| maximum.min(most));
    let maximum = if for_good { Some(most) } else { maximum };
    setrlimit(resource, Rlimit { current: Some(most), maximum })?;
    // Some systems take a limit and do not keep it.
    getrlimit(resource).current.filter(|held| *held <= most).ok_or(std::io::ErrorKind::Unsupported.into())
}

/// Bytes in words.
pub fn words(bytes: u64) -> String {
    #[expect(clippy::cast_precision_loss, reason = "for a reader")]
    let mib = bytes as f64 / f64::from(1 << 20);
    if mib < 1024.0 { format!("{mib:.0} MiB") } else { format!("{:.1} GiB", mib / 1024.0) }
}

/// `a · b · …`, at most `u64::MAX`.
pub fn product(factors: &[usize]) -> u64 {
    factors.iter().fold(1, |p: u64, f| p.saturating_mul(*f as u64))
}

/// Threads that work at a time.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

/// What the limit on the process's addresses leaves, bytes; `None` where there is none.
#[cfg(unix)]
fn left_of_addresses() -> Option<u64> {
    Some(getrlimit(Resource::As).current?.saturating_sub(addresses()?))
}

/// Bytes of addresses that the process has; `None` where the system does not tell.
#[cfg(unix)]
fn addresses() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    statm.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(rustix::param::page_size() as u64)
}

#[cfg(not(unix))]
fn left_of_addresses() -> Option<u64> {
    None
}

/// `MemAvailable` of a `/proc/meminfo`, bytes.
fn available(text: &str) -> Option<u64> {
    let line = text.lines().find(|l| l.starts_with("MemAvailable:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok()?.checked_mul(1024)
}

/// What the control group of a `/proc/self/cgroup` and those above it leave, bytes; `None` where none has a limit.
fn left_in_groups(text: &str, root: &Path) -> Option<u64> {
    let own = text.lines().find_map(|l| l.strip_prefix("0::"))?;
    let mut folder: PathBuf = root.join(own.trim_start_matches('/'));
    let mut least = None;
    loop {
        let number = |file: &str| std::fs::read_to_string(folder.join(file)).ok()?.trim().parse::<u64>().ok();
        if let Some(limit) = number("memory.max") {
            let left = limit.saturating_sub(number("memory.current").unwrap_or(0));
            least = Some(least.map_or(left, |l: u64| l.min(left)));
        }
        if folder == root || !folder.pop() || !folder.starts_with(root) {
            return least;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_what_is_told_counts() {
        assert_eq!(available("MemTotal: 9 kB\nMemAvailable:   1024 kB\n"), Some(1 << 20));
        assert_eq!(available("MemTotal: 9 kB\n"), None);
        let root = tempfile::tempdir().expect("a temporary folder");
        let inner = root.path().join("a/b");
        std::fs::create_dir_all(&inner).expect("made");
        let write = |at: &Path, file: &str, text: &str| std::fs::write(at.join(file), text).expect("written");
        assert_eq!(left_in_groups("0::/a/b\n", root.path()), None);
        write(&inner, "memory.max", "max\n");
        assert_eq!(left_in_groups("0::/a/b\n", root.path()), None);
        write(&root.path().join("a"), "memory.max", "5000\n");
        write(&root.path().join("a"), "memory.current", "1000\n");
        assert_eq!(left_in_groups("0::/a/b\n", root.path()), Some(4000));
        write(&inner, "memory.max", "300");
        assert_eq!(left_in_groups("0::/a/b\n", root.path()), Some(300));
        assert_eq!(left_in_groups("3:cpu:/a\n", root.path()), None);
        assert!(Limit::of_process().bytes > 0);
    }

    #[test]
    fn what_needs_more_is_refused_in_one_line() {
        let limit = Limit::gib(0.5).expect("positive");
        assert!(limit.allow("a picture", GIB / 2, "").is_ok());
        let error = limit.allow("a picture", 3 * GIB, "a smaller frame").expect_err("too much");
        let text = error.to_string();
        assert_eq!(
            text,
            "memory: a picture: about 3.0 GiB needed; at most 512 MiB here (--memory-gib); a smaller frame"
        );
        assert_eq!(error.exit_code(), 2);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Limit::gib(bad).is_err());
        }
        assert_eq!(product(&[usize::MAX, 3]), u64::MAX);
    }
}
