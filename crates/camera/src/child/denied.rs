//! System calls that a child is refused with `EPERM`: whatever opens a file by its name, starts a program or a process, opens a socket, or reaches another
//! process or the machine. All others are let pass: a runtime that asks for something new goes on, and who is refused is not killed.

use std::collections::BTreeMap;

use libc::c_long;
use seccompiler::{
    BackendError, BpfProgram, Error, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule, apply_filter_all_threads,
};

/// Refused whatever their arguments are, on both instruction sets.
const REFUSED: &[c_long] = &[
    // Programs and other processes.
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_process_madvise,
    libc::SYS_process_mrelease,
    libc::SYS_pidfd_open,
    libc::SYS_pidfd_getfd,
    libc::SYS_pidfd_send_signal,
    libc::SYS_kcmp,
    libc::SYS_tkill,
    libc::SYS_rt_sigqueueinfo,
    libc::SYS_rt_tgsigqueueinfo,
    libc::SYS_setpriority,
    libc::SYS_migrate_pages,
    libc::SYS_move_pages,
    // Its limits.
    libc::SYS_setrlimit,
    // Sockets, messages, shared memory.
    libc::SYS_socket,
    libc::SYS_socketpair,
    libc::SYS_connect,
    libc::SYS_bind,
    libc::SYS_listen,
    libc::SYS_accept,
    libc::SYS_accept4,
    libc::SYS_shmget,
    libc::SYS_shmat,
    libc::SYS_semget,
    libc::SYS_msgget,
    libc::SYS_mq_open,
    libc::SYS_mq_unlink,
    // Files by their names, and facts of open ones.
    libc::SYS_openat,
    libc::SYS_openat2,
    libc::SYS_name_to_handle_at,
    libc::SYS_open_by_handle_at,
    libc::SYS_mkdirat,
    libc::SYS_mknodat,
    libc::SYS_linkat,
    libc::SYS_symlinkat,
    libc::SYS_unlinkat,
    RENAMEAT,
    libc::SYS_renameat2,
    libc::SYS_readlinkat,
    libc::SYS_faccessat,
    libc::SYS_faccessat2,
    libc::SYS_statfs,
    libc::SYS_truncate,
    libc::SYS_chdir,
    libc::SYS_fchdir,
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    FCHMODAT2,
    libc::SYS_fchown,
    libc::SYS_fchownat,
    libc::SYS_utimensat,
    libc::SYS_setxattr,
    libc::SYS_lsetxattr,
    libc::SYS_fsetxattr,
    libc::SYS_getxattr,
    libc::SYS_lgetxattr,
    libc::SYS_listxattr,
    libc::SYS_llistxattr,
    libc::SYS_removexattr,
    libc::SYS_lremovexattr,
    libc::SYS_fremovexattr,
    XATTR_AT[0],
    XATTR_AT[1],
    XATTR_AT[2],
    XATTR_AT[3],
    libc::SYS_inotify_init1,
    libc::SYS_inotify_add_watch,
    libc::SYS_fanotify_init,
    libc::SYS_fanotify_mark,
    // Mounts and namespaces.
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_pivot_root,
    libc::SYS_chroot,
    libc::SYS_move_mount,
    libc::SYS_open_tree,
    OPEN_TREE_ATTR,
    libc::SYS_fsopen,
    libc::SYS_fsconfig,
    libc::SYS_fsmount,
    libc::SYS_fspick,
    libc::SYS_mount_setattr,
    libc::SYS_unshare,
    libc::SYS_setns,
    // The kernel's wide doors: calls through rings, programs in the kernel, faults, counters, keys.
    libc::SYS_io_uring_setup,
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    libc::SYS_bpf,
    libc::SYS_userfaultfd,
    libc::SYS_perf_event_open,
    libc::SYS_add_key,
    libc::SYS_request_key,
    libc::SYS_keyctl,
    // The machine.
    libc::SYS_personality,
    libc::SYS_init_module,
    libc::SYS_finit_module,
    libc::SYS_delete_module,
    libc::SYS_kexec_load,
    libc::SYS_kexec_file_load,
    libc::SYS_reboot,
    libc::SYS_swapon,
    libc::SYS_swapoff,
    libc::SYS_acct,
    libc::SYS_quotactl,
    libc::SYS_quotactl_fd,
    libc::SYS_syslog,
    libc::SYS_vhangup,
    libc::SYS_sethostname,
    libc::SYS_setdomainname,
    libc::SYS_settimeofday,
    libc::SYS_clock_settime,
    libc::SYS_adjtimex,
    libc::SYS_clock_adjtime,
];

// Numbers that the library of names lacks on one of the two; from 424 on they are the same everywhere.
const FCHMODAT2: c_long = 452;
/// `setxattrat`, `getxattrat`, `listxattrat`, `removexattrat`.
const XATTR_AT: [c_long; 4] = [463, 464, 465, 466];
const OPEN_TREE_ATTR: c_long = 467;

/// Those of x86-64 alone: older forms of the others, and its ports.
#[cfg(target_arch = "x86_64")]
const REFUSED_HERE: &[c_long] = &[
    libc::SYS_open,
    libc::SYS_creat,
    libc::SYS_mkdir,
    libc::SYS_mknod,
    libc::SYS_link,
    libc::SYS_symlink,
    libc::SYS_unlink,
    libc::SYS_rmdir,
    libc::SYS_rename,
    libc::SYS_readlink,
    libc::SYS_access,
    libc::SYS_stat,
    libc::SYS_lstat,
    libc::SYS_chmod,
    libc::SYS_chown,
    libc::SYS_lchown,
    libc::SYS_utime,
    libc::SYS_utimes,
    libc::SYS_futimesat,
    libc::SYS_inotify_init,
    libc::SYS_uselib,
    libc::SYS_fork,
    libc::SYS_vfork,
    libc::SYS_iopl,
    libc::SYS_ioperm,
    libc::SYS_modify_ldt,
];
#[cfg(target_arch = "aarch64")]
const REFUSED_HERE: &[c_long] = &[];

#[cfg(target_arch = "x86_64")]
const RENAMEAT: c_long = libc::SYS_renameat;
#[cfg(target_arch = "aarch64")]
const RENAMEAT: c_long = 38;

/// Marks calls of x86-64's ABI of 32-bit pointers, which the filter's check of the architecture does not tell apart.
#[cfg(target_arch = "x86_64")]
const SHORT: i64 = 0x4000_0000;

/// The same calls once more by their numbers with short pointers.
#[cfg(target_arch = "x86_64")]
fn with_short_pointers(refused: &mut BTreeMap<i64, Vec<SeccompRule>>) {
    let again: Vec<_> = refused.iter().map(|(number, rules)| (number | SHORT, rules.clone())).collect();
    refused.extend(again);
}
#[cfg(target_arch = "aarch64")]
fn with_short_pointers(_: &mut BTreeMap<i64, Vec<SeccompRule>>) {}

/// One comparison of an argument.
fn argument(n: u8, operation: SeccompCmpOp, value: u64) -> Result<SeccompCondition, BackendError> {
    SeccompCondition::new(n, SeccompCmpArgLen::Qword, operation, value)
}

/// Refused with some arguments: each list of conditions, where all of them hold.
fn sometimes() -> Result<BTreeMap<i64, Vec<SeccompRule>>, BackendError> {
    use SeccompCmpOp::{Eq, MaskedEq, Ne};
    let rule = |conditions: Vec<SeccompCondition>| SeccompRule::new(conditions);
    let bits = |flags: libc::c_int| u64::from(flags.cast_unsigned());
    let own = u64::from(std::process::id());
    // Another process, or a thread in a namespace of its own; threads are let pass.
    let mut clone = vec![rule(vec![argument(0, MaskedEq(bits(libc::CLONE_THREAD)), 0)?])?];
    for flag in [
        libc::CLONE_NEWNS,
        libc::CLONE_NEWCGROUP,
        libc::CLONE_NEWUTS,
        libc::CLONE_NEWIPC,
        libc::CLONE_NEWUSER,
        libc::CLONE_NEWPID,
        libc::CLONE_NEWNET,
    ] {
        clone.push(rule(vec![argument(0, MaskedEq(bits(flag)), bits(flag))?])?);
    }
    // Signals for others, by hand or of a pipe.
    let others = || -> Result<Vec<SeccompRule>, BackendError> { Ok(vec![rule(vec![argument(0, Ne, own)?])?]) };
    let mut owners = Vec::new();
    for command in [libc::F_SETOWN, F_SETOWN_EX, F_SETSIG] {
        let condition = SeccompCondition::new(1, SeccompCmpArgLen::Dword, Eq, bits(command))?;
        owners.push(rule(vec![condition])?);
    }
    // The facts of what is open are let pass, by which the standard library asks for a file's length.
    let by_name = |n: u8| -> Result<Vec<SeccompRule>, BackendError> {
        Ok(vec![rule(vec![argument(n, MaskedEq(bits(libc::AT_EMPTY_PATH)), 0)?])?])
    };
    Ok(BTreeMap::from([
        (libc::SYS_clone, clone),
        (libc::SYS_kill, others()?),
        (libc::SYS_tgkill, others()?),
        (libc::SYS_fcntl, owners),
        // A limit that is set, not one that is read.
        (libc::SYS_prlimit64, vec![rule(vec![argument(2, Ne, 0)?])?]),
        (libc::SYS_newfstatat, by_name(3)?),
        (libc::SYS_statx, by_name(2)?),
    ]))
}

const F_SETSIG: libc::c_int = 10;
const F_SETOWN_EX: libc::c_int = 15;

/// The two filters: what is refused for good, and the newer `clone3`, whose flags no filter sees and for which libraries take `clone` where it is not there.
fn programs() -> Result<[BpfProgram; 2], Error> {
    let program = |refused, errno: libc::c_int| -> Result<BpfProgram, Error> {
        let arch = std::env::consts::ARCH.try_into()?;
        let action = SeccompAction::Errno(errno.cast_unsigned());
        Ok(SeccompFilter::new(refused, SeccompAction::Allow, action, arch)?.try_into()?)
    };
    let mut refused: BTreeMap<i64, Vec<SeccompRule>> =
        REFUSED.iter().chain(REFUSED_HERE).map(|number| (*number, Vec::new())).collect();
    refused.extend(sometimes()?);
    with_short_pointers(&mut refused);
    // Forms of calls that only that ABI has.
    #[cfg(target_arch = "x86_64")]
    refused.extend((512..=547).map(|number| (number | SHORT, Vec::new())));
    let mut newer = BTreeMap::from([(libc::SYS_clone3, Vec::new())]);
    with_short_pointers(&mut newer);
    Ok([program(refused, libc::EPERM)?, program(newer, libc::ENOSYS)?])
}

/// Has the kernel refuse them to all threads of this process; whether it can.
///
/// # Errors
/// A kernel that filters and did not take these filters for a reason of theirs.
pub(super) fn refuse() -> Result<bool, Error> {
    for program in programs()? {
        match apply_filter_all_threads(&program) {
            Ok(()) => {}
            // Kernels without filters say so in one of these ways; a container that keeps them to itself, by `EPERM`.
            Err(Error::Prctl(e) | Error::Seccomp(e))
                if matches!(e.raw_os_error(), Some(libc::ENOSYS | libc::EINVAL | libc::EPERM)) =>
            {
                return Ok(false);
            }
            Err(other) => return Err(other),
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests;
