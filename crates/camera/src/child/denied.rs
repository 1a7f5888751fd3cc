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
/// A kernel that filters and did not take these filters.
pub(super) fn refuse() -> Result<bool, Error> {
    for program in programs()? {
        match apply_filter_all_threads(&program) {
            Ok(()) => {}
            // Kernels without filters say so in one of these ways.
            Err(Error::Prctl(e) | Error::Seccomp(e))
                if matches!(e.raw_os_error(), Some(libc::ENOSYS | libc::EINVAL)) =>
            {
                return Ok(false);
            }
            Err(other) => return Err(other),
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a filter answers to a call, by the rules of classic BPF (`linux/filter.h`, `linux/seccomp.h`), independent of the library that wrote it and of the
    /// kernel that runs it.
    fn answer(program: &BpfProgram, number: i64, arguments: [u64; 6]) -> u32 {
        const ALLOW: u32 = 0x7fff_0000;
        let arch: u32 = if cfg!(target_arch = "x86_64") { 0xc000_003e } else { 0xc000_00b7 };
        let mut data = [0_u32; 16];
        data[0] = u32::try_from(number).expect("a number of a call");
        data[1] = arch;
        for (k, argument) in arguments.iter().enumerate() {
            data[4 + 2 * k] = (argument & 0xffff_ffff) as u32;
            data[5 + 2 * k] = (argument >> 32) as u32;
        }
        let (mut at, mut accumulator) = (0, 0_u32);
        loop {
            let step = &program[at];
            at += 1;
            let mut jump = |holds: bool| at += usize::from(if holds { step.jt } else { step.jf });
            match step.code {
                0x20 => accumulator = data[step.k as usize / 4],
                0x05 => at += step.k as usize,
                0x15 => jump(accumulator == step.k),
                0x25 => jump(accumulator > step.k),
                0x35 => jump(accumulator >= step.k),
                0x54 => accumulator &= step.k,
                0x06 => return if step.k == ALLOW { 0 } else { step.k & 0xffff },
                other => panic!("an instruction of another kind: {other:#x}"),
            }
        }
    }

    fn refused(number: i64, arguments: [u64; 6]) -> bool {
        let [first, second] = programs().expect("compiles");
        assert_eq!(answer(&second, number, arguments), if number & 0xfff == libc::SYS_clone3 { 38 } else { 0 });
        match answer(&first, number, arguments) {
            0 => false,
            1 => true,
            other => panic!("error {other}"),
        }
    }

    #[test]
    fn the_filter_refuses_what_reaches_out() {
        let none = [0; 6];
        for number in [
            libc::SYS_execve,
            libc::SYS_execveat,
            libc::SYS_ptrace,
            libc::SYS_process_vm_readv,
            libc::SYS_process_vm_writev,
            libc::SYS_socket,
            libc::SYS_connect,
            libc::SYS_bind,
            libc::SYS_io_uring_setup,
            libc::SYS_bpf,
            libc::SYS_userfaultfd,
            libc::SYS_perf_event_open,
            libc::SYS_keyctl,
            libc::SYS_kexec_load,
            libc::SYS_mount,
            libc::SYS_unshare,
            libc::SYS_setns,
            libc::SYS_openat,
            libc::SYS_openat2,
        ] {
            assert!(refused(number, none), "{number}");
            #[cfg(target_arch = "x86_64")]
            assert!(refused(number | 0x4000_0000, none), "{number} of the other ABI");
        }
        // Its own numbers: `execve`, `ptrace`, `execveat` of 32-bit pointers.
        #[cfg(target_arch = "x86_64")]
        assert!([520, 521, 545].iter().all(|n| refused(n | 0x4000_0000, none)));
    }

    #[test]
    fn the_filter_looks_at_arguments_where_they_matter() {
        let first = |value: u64| [value, 0, 0, 0, 0, 0];
        let own = u64::from(std::process::id());
        // As the C library makes a thread, and as it makes a process.
        let (thread, process) = (0x003d_0f00_u64, 0x0120_0011_u64);
        assert!(!refused(libc::SYS_clone, first(thread)) && refused(libc::SYS_clone, first(process)));
        for space in [0x0002_0000_u64, 0x0200_0000, 0x0400_0000, 0x0800_0000, 0x1000_0000, 0x2000_0000, 0x4000_0000] {
            assert!(refused(libc::SYS_clone, first(thread | space)) && refused(libc::SYS_clone, first(space | 17)));
        }
        for call in [libc::SYS_kill, libc::SYS_tgkill] {
            assert!(!refused(call, first(own)) && refused(call, first(1)) && refused(call, first(u64::MAX)));
        }
        assert!(!refused(libc::SYS_prlimit64, first(0)) && refused(libc::SYS_prlimit64, [0, 9, 1 << 40, 0, 0, 0]));
        let empty = 0x1000;
        assert!(!refused(libc::SYS_statx, [0, 0, empty, 0, 0, 0]) && refused(libc::SYS_statx, [0; 6]));
        assert!(!refused(libc::SYS_newfstatat, [0, 0, 0, empty, 0, 0]) && refused(libc::SYS_newfstatat, [0; 6]));
        // Flags of a descriptor, and who gets its signals.
        assert!(!refused(libc::SYS_fcntl, [0, 2, 1, 0, 0, 0]) && refused(libc::SYS_fcntl, [0, 8, 1, 0, 0, 0]));
    }

    /// What the two children were seen to ask for behind the filter, with either runtime.
    #[test]
    fn the_filter_lets_work_go_on() {
        for number in [
            libc::SYS_read,
            libc::SYS_write,
            libc::SYS_lseek,
            libc::SYS_close,
            libc::SYS_brk,
            libc::SYS_mmap,
            libc::SYS_munmap,
            libc::SYS_mremap,
            libc::SYS_mprotect,
            libc::SYS_madvise,
            libc::SYS_futex,
            libc::SYS_getrandom,
            libc::SYS_gettid,
            libc::SYS_prctl,
            libc::SYS_rt_sigaction,
            libc::SYS_rt_sigprocmask,
            libc::SYS_rseq,
            libc::SYS_sched_getaffinity,
            libc::SYS_sched_yield,
            libc::SYS_set_robust_list,
            libc::SYS_sigaltstack,
            libc::SYS_clock_nanosleep,
            libc::SYS_exit,
            libc::SYS_exit_group,
        ] {
            assert!(!refused(number, [0; 6]), "{number}");
        }
    }
}
