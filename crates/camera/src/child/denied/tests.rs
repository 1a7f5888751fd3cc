//! The filters, run by the rules of their language.

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
