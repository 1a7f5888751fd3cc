//! Kills and full disks at each step: the old or the new is there, whole, and the next writing leaves nothing else.

use std::path::PathBuf;
use std::process::{Command, ExitStatus, Stdio};

use super::super::{abandon, recover};
use super::*;

/// What is written before and by the child that is killed; long enough for several writes.
fn old_and_new() -> [String; 2] {
    ["old ".repeat(5_000), "new ".repeat(6_000)]
}

/// This test binary, to be started again as [`child`].
pub(super) fn child_at(what: &str, path: &Path, replace: Replace, without: &str, kill_at: usize) -> Command {
    let mut command = process("child", path);
    command.env("ATOMIC_WHAT", what).env("ATOMIC_WITHOUT", without);
    command.env("ATOMIC_REPLACE", if replace == Replace::Always { "1" } else { "0" });
    command.env("ATOMIC_KILL_AT", kill_at.to_string());
    command
}

/// One of the ignored tests below as a process of its own.
fn process(test: &str, path: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this binary"));
    command.args(["--exact", &format!("atomic::tests::kills::{test}"), "--ignored", "--nocapture", "--test-threads=1"]);
    command.env("ATOMIC_PATH", path).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn is_killed(status: ExitStatus) -> bool {
    std::os::unix::process::ExitStatusExt::signal(&status) == Some(9)
}

#[test]
#[ignore = "the process that other tests start and kill"]
fn child() {
    let var = |name: &str| std::env::var(name).expect("started by another test");
    let (path, at) = (PathBuf::from(var("ATOMIC_PATH")), var("ATOMIC_KILL_AT").parse::<usize>().expect("a number"));
    let replace = Replace::from(var("ATOMIC_REPLACE") == "1");
    let without = match var("ATOMIC_WITHOUT").as_str() {
        "nfs" => NFS,
        "fat" => FAT,
        _ => &[],
    };
    let count = Cell::new(0);
    let _faults = Faults::set(move |step| {
        count.set(count.get() + 1);
        if count.get() == at {
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
        }
        without.contains(&step).then(|| Errno::NOSYS.into())
    });
    let [_, new] = old_and_new();
    // Children of one crowd begin together.
    let go = std::env::var_os("ATOMIC_GO").map(PathBuf::from);
    while go.as_ref().is_some_and(|go| !go.exists()) {
        std::thread::yield_now();
    }
    let done = write(&var("ATOMIC_WHAT"), &path, replace, &new);
    // The last place for a kill: all is done.
    let _ = fault::at("end");
    done.unwrap_or_else(|e| panic!("{e}"));
}

#[test]
#[ignore = "the process of the next test: whoever gives up writes nothing more"]
fn giving_up() {
    let place = PathBuf::from(std::env::var_os("ATOMIC_PATH").expect("started by another test"));
    let kind = FolderKind::listed(MARKER);
    let _ = publish_folder(&place.join("b"), &kind, Replace::Never, |folder| {
        fs::write(folder.join(MARKER), "b").map_err(|e| Error::writing(folder, e))?;
        publish_file(&place.join("a.csv"), Replace::Never, |_| -> Result<()> {
            assert_eq!(names(&place).len(), 3, "a file, a folder and its lock: {:?}", names(&place));
            abandon();
            std::process::exit(7);
        })
    });
}

/// What is being written when a program has to end at once is cleared away.
#[test]
fn what_is_given_up_leaves_nothing() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let status = process("giving_up", place.path()).status().expect("starts");
    assert_eq!(status.code(), Some(7));
    assert!(names(place.path()).is_empty(), "{:?}", names(place.path()));
}

/// Kills a child at its first step, its second one and so on until it comes to its end; how many kills that were.
fn each_step(what: &str, replace: Replace, without: &str) -> usize {
    let [old, new] = old_and_new();
    for kill_at in 1.. {
        let place = tempfile::tempdir().expect("a temporary folder");
        let path = place.path().join("result");
        if replace == Replace::Always {
            write(what, &path, Replace::Never, &old).expect("the old one");
        }
        let status = child_at(what, &path, replace, without, kill_at).output().expect("starts").status;
        let told = format!("{what}, {replace:?}, without {without}, killed at step {kill_at}");
        if !is_killed(status) {
            assert!(status.success(), "{told}: {status}");
            assert_eq!(read(what, &path), new, "{told}");
            assert_eq!(names(place.path()), ["result"], "{told}");
            return kill_at - 1;
        }
        recover(&path).expect("taken up");
        let there = path.symlink_metadata().is_ok();
        // An empty file may hold the name where there are neither such renames nor links.
        let claimed = without == "fat" && fs::metadata(&path).is_ok_and(|m| m.len() == 0);
        if there && !claimed {
            let found = read(what, &path);
            assert!(found == new || found == old && replace == Replace::Always, "{told}: another text");
        }
        assert!(there || replace == Replace::Never, "{told}: neither the old nor the new");
        assert!(names(place.path()).iter().all(|n| n == "result"), "{told}: {:?}", names(place.path()));
        if !claimed {
            write(what, &path, Replace::Always, "after\n").unwrap_or_else(|e| panic!("{told}: {e}"));
            assert_eq!(read(what, &path), "after\n", "{told}");
        }
    }
    unreachable!("a child comes to its end")
}

#[test]
fn kills_at_each_step_leave_the_old_or_the_new_file() {
    let mut kills = 0;
    for without in ["nothing", "nfs", "fat"] {
        for replace in [Replace::Never, Replace::Always] {
            kills += each_step("file", replace, without) + each_step("path", replace, without);
        }
    }
    eprintln!("{kills} kills");
    assert!(kills >= 100, "{kills}");
}

#[test]
fn kills_at_each_step_leave_the_old_or_the_new_folder() {
    let mut kills = 0;
    for without in ["nothing", "nfs"] {
        for replace in [Replace::Never, Replace::Always] {
            kills += each_step("folder", replace, without);
        }
    }
    eprintln!("{kills} kills");
    assert!(kills >= 100, "{kills}");
}

/// The next writing alone, without a call to [`recover`], takes up what a kill between two renames has left.
#[test]
fn the_next_writing_takes_up_a_replacement() {
    let [old, new] = old_and_new();
    let mut gaps = 0;
    for kill_at in 1.. {
        let place = tempfile::tempdir().expect("a temporary folder");
        let path = place.path().join("result");
        put_folder(&path, Replace::Never, &old).expect("the old one");
        let status = child_at("folder", &path, Replace::Always, "nfs", kill_at).output().expect("starts").status;
        if !is_killed(status) {
            break;
        }
        gaps += usize::from(!path.exists());
        assert!(matches!(put_folder(&path, Replace::Never, "after"), Err(Error::Exists(_))), "step {kill_at}");
        let found = text_of(&path);
        assert!(found == old || found == new, "step {kill_at}");
        assert_eq!(names(place.path()), ["result"], "step {kill_at}");
    }
    assert_eq!(gaps, 1, "one step is between the two renames");
}

/// Kills while an earlier kill is being made up for: at each step of the next writing, after one between the two renames and one between
/// the exchange and the removal.
#[test]
fn kills_of_the_next_writer_lose_nothing() {
    let [old, new] = old_and_new();
    let mut kills = 0;
    for (without, first) in [("nfs", "set aside"), ("nothing", "exchange")] {
        let first = step_after(first, without);
        for kill_at in 1.. {
            let place = tempfile::tempdir().expect("a temporary folder");
            let path = place.path().join("result");
            put_folder(&path, Replace::Never, &old).expect("the old one");
            let run = |at| child_at("folder", &path, Replace::Always, without, at).output().expect("starts").status;
            assert!(is_killed(run(first)));
            let leftovers = names(place.path()).iter().filter(|n| *n != "result").count();
            assert!(leftovers >= 2, "{:?}", names(place.path()));
            let ended = !is_killed(run(kill_at));
            recover(&path).expect("taken up");
            let found = text_of(&path);
            assert!(found == old || found == new, "without {without}, step {kill_at}");
            assert_eq!(names(place.path()), ["result"], "without {without}, step {kill_at}");
            if ended {
                break;
            }
            kills += 1;
        }
    }
    eprintln!("{kills} kills");
    assert!(kills >= 60, "{kills}");
}

/// The number of the step after the first one called `name` when a folder is replaced.
fn step_after(name: &str, without: &'static str) -> usize {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = place.path().join("result");
    put_folder(&path, Replace::Never, "old").expect("the old one");
    let steps = Rc::new(std::cell::RefCell::new(Vec::new()));
    let seen = steps.clone();
    let _faults = Faults::set(move |step| {
        seen.borrow_mut().push(step);
        (without == "nfs" && NFS.contains(&step)).then(|| Errno::NOSYS.into())
    });
    put_folder(&path, Replace::Always, "new").expect("replaced");
    let steps = steps.borrow();
    steps.iter().position(|s| *s == name).expect("a step of that name") + 2
}

/// Kills by the clock, not by a step: the new folder replaces the old one, again and again.
#[test]
fn kills_at_any_moment_leave_a_whole_folder() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = place.path().join("result");
    let [old, new] = old_and_new();
    put_folder(&path, Replace::Never, &old).expect("the old one");
    for k in 0..40 {
        let mut child = child_at("folder", &path, Replace::Always, "nothing", 0).spawn().expect("starts");
        std::thread::sleep(std::time::Duration::from_micros(500 * k));
        let _ = child.kill();
        let _ = child.wait();
        let found = text_of(&path);
        assert!(found == old || found == new);
    }
    put_folder(&path, Replace::Always, &old).expect("written");
    assert_eq!(names(place.path()), ["result"]);
}

/// A full disk at each step: an error, and everything is as it was. What had its name before the fault may be the new one.
#[test]
fn errors_at_each_step_leave_the_old_or_the_new() {
    let [old, new] = old_and_new();
    let mut faults = 0;
    let nothing: &[&str] = &[];
    let cases = [
        ("file", nothing),
        ("file", NFS),
        ("file", FAT),
        ("path", nothing),
        ("path", FAT),
        ("folder", nothing),
        ("folder", NFS),
    ];
    for ((what, without), replace) in cases.into_iter().flat_map(|c| [(c, false), (c, true)]) {
        for at in 1.. {
            let place = tempfile::tempdir().expect("a temporary folder");
            let path = place.path().join("result");
            if replace {
                write(what, &path, Replace::Never, &old).expect("the old one");
            }
            let (hook, steps) = Faults::nth(at, Errno::NOSPC, without);
            let done = write(what, &path, replace.into(), &new);
            drop(hook);
            let told = format!("{what}, {replace}, without {without:?}, step {at}: {done:?}");
            let found = path.symlink_metadata().is_ok().then(|| read(what, &path));
            match &done {
                Ok(()) => assert_eq!(found.as_ref(), Some(&new), "{told}"),
                Err(e) => {
                    assert!(e.to_string().contains("result"), "{told}");
                    let before = replace.then_some(&old);
                    assert!(found.as_ref() == before || found.as_ref() == Some(&new), "{told}");
                }
            }
            write(what, &path, Replace::Always, "after\n").unwrap_or_else(|e| panic!("{told}: {e}"));
            assert_eq!(names(place.path()), ["result"], "{told}");
            if steps.get() < at {
                break;
            }
            faults += 1;
        }
    }
    eprintln!("{faults} faults");
    assert!(faults >= 100, "{faults}");
}
