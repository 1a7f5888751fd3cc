//! What a child may use: its parent says it as arguments, and the child sets it before it does anything else.

use std::ffi::OsStr;
use std::time::Duration;

use super::Confinement;

/// What a child may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Address space, bytes.
    pub memory_bytes: u64,
    /// Time until an answer.
    pub time: Duration,
}

/// No limit of processor time, in the words of an argument.
const NONE: &str = "unlimited";

/// What the system is to hold a child to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bounds {
    /// Address space, bytes.
    pub(crate) memory_bytes: u64,
    /// Processor time, s.
    pub(crate) processor_s: Option<u64>,
}

impl Bounds {
    /// As arguments.
    pub(super) fn words(self) -> [String; 2] {
        [self.memory_bytes.to_string(), self.processor_s.map_or(NONE.into(), |s| s.to_string())]
    }

    /// From arguments; `None` if they are none.
    pub(crate) fn parse(memory: &OsStr, processor: &OsStr) -> Option<Self> {
        let processor = processor.to_str()?;
        let processor_s = if processor == NONE { None } else { Some(processor.parse().ok()?) };
        Some(Self { memory_bytes: memory.to_str()?.parse().ok()?, processor_s })
    }

    /// Holds this process to them for good, without core files. What is in force then.
    ///
    /// # Errors
    /// A limit that the system has and does not take, in words: whoever was to be held to it must not go on.
    #[cfg(unix)]
    pub(crate) fn hold(self) -> Result<Confinement, String> {
        use isoplanat_base::math::memory::restrict;
        use rustix::process::Resource;
        /// Systems that keep no limit on addresses.
        const WITHOUT: bool = cfg!(any(target_vendor = "apple", target_os = "openbsd"));
        let failed = |what: &str| {
            let what = format!("the limit of {what} could not be set");
            move |e: std::io::Error| format!("{what}: {e}")
        };
        let memory_bytes = match restrict(Resource::As, self.memory_bytes, true).map_err(failed("memory")) {
            Ok(held) => Some(held),
            Err(_) if WITHOUT => None,
            Err(why) => return Err(why),
        };
        let processor = |s| restrict(Resource::Cpu, s, true).map_err(failed("processor time"));
        let processor_s = self.processor_s.map(processor).transpose()?;
        restrict(Resource::Core, 0, true).map_err(failed("core files"))?;
        Ok(Confinement { memory_bytes, processor_s, ..Confinement::default() })
    }

    /// Windows has no such limits of a process by itself: only the parent's time limit holds.
    #[cfg(not(unix))]
    pub(crate) fn hold(self) -> Result<Confinement, String> {
        Ok(Confinement::default())
    }
}
