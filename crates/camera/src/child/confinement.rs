//! What is in force in a child.

use serde::{Deserialize, Serialize};

/// What the system holds a child to, as the child found it after all was asked for. What a system lacks is absent here, and no error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confinement {
    /// Most address space, bytes; `None`: this system keeps no such limit.
    pub memory_bytes: Option<u64>,
    /// Most processor time, s; `None` for a child that answers many times, and where the system keeps no such limit.
    pub processor_s: Option<u64>,
    /// Whether programs that it starts could gain rights (Linux): `true` if not.
    pub no_new_privs: bool,
    /// Version of Landlock's interface by which it sees no file and no network (Linux from 5.13 on).
    pub landlock_abi: Option<u32>,
    /// Whether its system calls are filtered (Linux, x86-64 and AArch64).
    pub seccomp: bool,
}
