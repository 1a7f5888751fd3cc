//! What a child gives up before it reads a byte of others: new rights, files, the network, other processes.

use super::Confinement;

/// Gives all of it up, for every thread of this process and for good. What is in force then, beside the limits that `held` says; what the kernel lacks is not.
///
/// Whatever is still needed of the file system, a shared library say, has to be loaded before.
///
/// # Errors
/// A sandbox that the kernel has and could not be entered, in words: whoever was to be in it must not go on.
#[cfg(target_os = "linux")]
pub(crate) fn enter(held: Confinement) -> Result<Confinement, String> {
    // Linux before 3.5 knows of no such thing.
    let no_new_privs = rustix::thread::set_no_new_privs(true).is_ok();
    let landlock_abi = see_nothing().map_err(|e| format!("Landlock: {e}"))?;
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    let seccomp = super::denied::refuse().map_err(|e| format!("seccomp: {e}"))?;
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let seccomp = false;
    Ok(Confinement { no_new_privs, landlock_abi, seccomp, ..held })
}

/// Other systems have nothing of the kind that a process could enter by itself.
#[cfg(not(target_os = "linux"))]
pub(crate) fn enter(held: Confinement) -> Result<Confinement, String> {
    Ok(held)
}

/// Landlock with no exception: no path, no port, no signal and no abstract socket beyond this process. The version in force on all threads; `None` where the
/// kernel has none, or where there are threads already that it would not reach.
#[cfg(target_os = "linux")]
fn see_nothing() -> Result<Option<u32>, landlock::RulesetError> {
    use landlock::{
        ABI, Access, AccessFs, AccessNet, LandlockStatus, RestrictSelfAttr, Ruleset, RulesetAttr, RulesetStatus, Scope,
    };
    // The newest that the library knows: of it, the kernel's part is taken.
    let all = ABI::V10;
    let alone = std::fs::read_dir("/proc/self/task").is_ok_and(|threads| threads.count() == 1);
    let status = Ruleset::default()
        .handle_access(AccessFs::from_all(all))?
        .handle_access(AccessNet::from_all(all))?
        .scope(Scope::from_all(all))?
        .create()?
        .all_threads(true)?
        .restrict_self()?;
    let abi = match status.landlock {
        LandlockStatus::Available { effective_abi, .. } => effective_abi.to_string().parse().ok(),
        _ => None,
    };
    Ok(abi.filter(|_| status.ruleset != RulesetStatus::NotEnforced && (alone || status.all_threads)))
}
