//! Limits and the sandbox, tried in this test binary started again: what is in force is for good.

use std::ffi::OsString;
use std::process::{Command, Stdio};

use super::*;

/// Writes a program of the shell. By another process: a child of any test at the same time would hold what this one writes open, and the system does not start
/// what is open for writing.
#[cfg(unix)]
pub(crate) fn script(path: &std::path::Path, text: &str) {
    let write = "printf '#!/bin/sh\\n%s\\n' \"$2\" > \"$1\" && chmod 755 \"$1\"";
    let status = Command::new("sh").args(["-c", write, "sh"]).arg(path).arg(text).status().expect("starts");
    assert!(status.success());
}

/// This test binary, to be started again as the (ignored) test `name`.
fn again(name: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this binary"));
    command.args(["--exact", &format!("child::tests::{name}"), "--ignored", "--nocapture", "--test-threads=1"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn passes(mut command: Command) {
    let output = command.output().expect("starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    eprint!("{said}");
}

#[test]
fn limits_go_through_arguments() {
    for bounds in
        [Bounds { memory_bytes: 5 << 30, processor_s: Some(8) }, Bounds { memory_bytes: u64::MAX, processor_s: None }]
    {
        let [memory, processor] = bounds.words().map(OsString::from);
        assert_eq!(Bounds::parse(&memory, &processor), Some(bounds));
    }
    for [memory, processor] in [["a.dng", "b.dng"], ["1", ""], ["-1", "3"], ["1", "1.5"]] {
        assert_eq!(Bounds::parse(memory.as_ref(), processor.as_ref()), None);
    }
}

/// Whatever the environment is, a child gets of it what it needs and nothing else.
#[cfg(target_os = "linux")]
#[test]
fn the_environment_is_cleared() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let program = dir.path().join("tells");
    script(&program, "/usr/bin/env\n/usr/bin/printf '%s\\n' \"$@\"");
    let helper = Helper::at(&program);
    let limits = Limits { memory_bytes: 1 << 30, time: std::time::Duration::from_secs(3) };
    let start = Start { helper: &helper, command: "do", limits, once: true, input: Stdio::null(), threads: 3 };
    let output = start.spawn().expect("starts").wait_with_output().expect("ends");
    let said = String::from_utf8(output.stdout).expect("text");
    // (A shell adds variables of its own.)
    let own = ["PWD=", "SHLVL=", "_=", "OLDPWD="];
    let mut lines: Vec<&str> = said.lines().filter(|l| !own.iter().any(|o| l.starts_with(o))).collect();
    lines.retain(|l| !l.starts_with("LD_LIBRARY_PATH="));
    lines.sort_unstable();
    let expected = ["1073741824", "12", "MALLOC_ARENA_MAX=2", "ORT_DISABLE_TELEMETRY=1", "RAYON_NUM_THREADS=3", "do"];
    assert_eq!(lines, expected);
}

#[cfg(target_os = "linux")]
#[test]
fn limits_are_held_for_good() {
    passes(again("held"));
}

#[cfg(target_os = "linux")]
#[test]
#[ignore = "the process that another test starts"]
fn held() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let bounds = Bounds { memory_bytes: 1 << 30, processor_s: Some(60) };
    let held = bounds.hold().expect("Linux has them");
    let expected = Confinement { memory_bytes: Some(1 << 30), processor_s: Some(60), ..Confinement::default() };
    assert_eq!(held, expected);
    for (resource, most) in [(Resource::As, 1 << 30), (Resource::Cpu, 60), (Resource::Core, 0)] {
        assert_eq!(getrlimit(resource), Rlimit { current: Some(most), maximum: Some(most) });
    }
    assert!(Vec::<u8>::new().try_reserve_exact(1 << 30).is_err(), "memory beyond the limit");
    // What is asked for later cannot be more; with the sandbox not even the system's own user can.
    let more = Bounds { memory_bytes: 2 << 30, processor_s: None }.hold().expect("less than asked for");
    assert_eq!(more.memory_bytes, Some(1 << 30));
    enter(held).expect("enters");
    let more = Rlimit { current: Some(2 << 30), maximum: Some(2 << 30) };
    assert!(setrlimit(Resource::As, more).is_err());
}

#[cfg(target_os = "linux")]
#[test]
fn the_sandbox_refuses_files_programs_sockets_and_processes() {
    let dir = tempfile::tempdir().expect("temporary folder");
    std::fs::write(dir.path().join("a"), "text").expect("writes");
    let mut command = again("sandboxed");
    command.env("CHILD_FOLDER", dir.path());
    passes(command);
    let left: Vec<_> = std::fs::read_dir(dir.path()).expect("lists").map(|e| e.expect("entry").file_name()).collect();
    assert_eq!(left, ["a"]);
}

/// On a kernel that has neither sandbox there is nothing to be seen, which is said.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "the process that another test starts"]
fn sandboxed() {
    use std::io::ErrorKind::PermissionDenied;
    use std::sync::mpsc;

    let folder = std::path::PathBuf::from(std::env::var_os("CHILD_FOLDER").expect("started by another test"));
    let file = folder.join("a");
    let open = std::fs::File::open(&file).expect("opens");
    let parent = rustix::process::getppid().expect("a parent");
    assert!(rustix::process::test_kill_process(parent).is_ok());
    // A thread from before: it may do no more than the others.
    let (go, wait) = mpsc::channel::<()>();
    let path = file.clone();
    let before = std::thread::spawn(move || {
        wait.recv().expect("sent");
        [std::fs::read(path).err().map(|e| e.kind()), Command::new("/bin/true").status().err().map(|e| e.kind())]
    });
    let held = enter(Confinement::default()).expect("enters");
    assert!(held.no_new_privs, "every Linux has it");
    go.send(()).expect("waits");
    let from_before = before.join().expect("joins");
    if !held.seccomp {
        eprintln!("SKIPPED: this kernel filters no system calls");
    }
    // Either refuses files.
    if held.seccomp || held.landlock_abi.is_some() {
        for refused in [
            std::fs::read(&file).map(drop),
            std::fs::write(folder.join("b"), "text"),
            std::fs::read_dir(&folder).map(drop),
            std::fs::remove_file(&file),
            std::fs::create_dir(folder.join("c")),
            std::fs::read("/proc/self/maps").map(drop),
        ] {
            assert_eq!(refused.expect_err("files").kind(), PermissionDenied);
        }
    }
    if held.seccomp {
        assert_eq!(from_before, [Some(PermissionDenied); 2], "threads from before");
        for refused in [
            Command::new("/bin/true").status().map(drop),
            std::net::TcpListener::bind("127.0.0.1:0").map(drop),
            std::net::UdpSocket::bind("127.0.0.1:0").map(drop),
            std::os::unix::net::UnixStream::pair().map(drop),
            std::fs::metadata(&file).map(drop),
            std::fs::rename(&file, folder.join("d")),
            std::os::unix::fs::symlink(&file, folder.join("e")),
            open.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777)),
            open.set_modified(std::time::SystemTime::UNIX_EPOCH),
            rustix::process::test_kill_process(parent).map_err(Into::into),
            rustix::process::pidfd_open(parent, rustix::process::PidfdFlags::empty()).map(drop).map_err(Into::into),
        ] {
            assert_eq!(refused.expect_err("more than files").kind(), PermissionDenied);
        }
    }
    // What a decoder and a runtime need goes on.
    assert_eq!(open.metadata().expect("open already").len(), 4);
    let mut text = String::new();
    std::io::Read::read_to_string(&mut &open, &mut text).expect("open already");
    assert_eq!(text, "text");
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| assert!(std::thread::available_parallelism().is_ok()));
        }
    });
    assert!(std::hint::black_box(vec![1_u8; 64 << 20]).iter().all(|b| *b == 1));
}
