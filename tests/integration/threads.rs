//! Where the system lets a program start no thread.

use std::process::{Command, Output};

use crate::support::Workplace;

/// What `program` says where it may start none; `None` where this system cannot hold it to that. Nothing holds root, so that the program is another user's then.
fn without_threads(place: &Workplace, program: &str, arguments: &str) -> Option<Output> {
    let as_root = Command::new("id").arg("-u").output().is_ok_and(|id| id.stdout == b"0\n");
    let user: &[&str] = if as_root { &["setpriv", "--reuid=54321", "--regid=54321", "--clear-groups"] } else { &[] };
    let words: Vec<&str> = user.iter().copied().chain(["prlimit", "--nproc=0:0", program]).collect();
    let run = |more: &str| {
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).args(more.split_whitespace()).current_dir(place.path("")).output().ok()
    };
    // A program that the other user may not start says nothing of threads.
    run("--version").filter(|said| said.status.success())?;
    run(arguments)
}

#[test]
fn no_threads_are_one_line() {
    let place = Workplace::new();
    let isoplanat = (env!("CARGO_BIN_EXE_isoplanat"), "spot two_element", "error: ");
    #[cfg(feature = "deploy")]
    let camera = Some((env!("CARGO_BIN_EXE_isoplanat-camera"), "a.dng -o a.png", "isoplanat-camera: "));
    #[cfg(not(feature = "deploy"))]
    let camera = None;
    for (program, arguments, before) in std::iter::once(isoplanat).chain(camera) {
        let Some(said) = without_threads(&place, program, arguments) else { continue };
        let err = String::from_utf8_lossy(&said.stderr);
        assert_eq!((said.status.code(), &*said.stdout), (Some(2), &b""[..]), "{program}: {err}");
        assert_eq!(err.lines().count(), 1, "{program}: {err}");
        assert!(err.starts_with(&format!("{before}this process: threads: one could not be started (")), "{err}");
    }
}
