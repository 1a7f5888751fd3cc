//! Peak memory of a piece of work, where the system tells (Linux).

/// Runs `work`; also returns how far the resident memory rose above its level at the start, bytes.
pub(crate) fn measured<R>(work: impl FnOnce() -> R) -> (R, Option<u64>) {
    // Writing 5 sets the high-water mark back to the present level.
    let reset = std::fs::write("/proc/self/clear_refs", "5").is_ok();
    let before = field("VmRSS:");
    let result = work();
    let rise = match (reset, field("VmHWM:"), before) {
        (true, Some(peak), Some(before)) => Some(peak.saturating_sub(before)),
        _ => None,
    };
    (result, rise)
}

/// A line of the process's status, in bytes.
fn field(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 64 MiB that are touched are seen, if anything is.
    #[test]
    fn what_is_touched_is_seen() {
        let (sum, rise) =
            measured(|| std::hint::black_box(vec![1u8; 64 << 20]).iter().map(|v| u64::from(*v)).sum::<u64>());
        assert_eq!(sum, 64 << 20);
        assert!(rise.is_none_or(|r| r > 32 << 20), "{rise:?}");
    }
}
