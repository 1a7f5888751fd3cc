//! Several writers at once: of four to one new name one succeeds.

use std::sync::Barrier;

use super::kills::child_at;
use super::*;

/// Four threads at one place: how many succeeded; the others were refused because something is there.
fn four(write: impl Fn(usize) -> Result<()> + Sync) -> usize {
    let barrier = Barrier::new(4);
    let begun = |k| {
        barrier.wait();
        write(k)
    };
    let results: Vec<Result<()>> = std::thread::scope(|scope| {
        let threads = [0, 1, 2, 3].map(|k| {
            scope.spawn({
                let begun = &begun;
                move || begun(k)
            })
        });
        threads.into_iter().map(|t| t.join().expect("no panic")).collect()
    });
    for refused in results.iter().filter_map(|r| r.as_ref().err()) {
        assert!(matches!(refused, Error::Exists(_)), "{refused}");
    }
    results.iter().filter(|r| r.is_ok()).count()
}

#[test]
fn one_of_four_threads_gets_a_new_name() {
    for without in [&[][..], NFS, FAT] {
        for round in 0..25 {
            let place = tempfile::tempdir().expect("a temporary folder");
            let (file, folder) = (place.path().join("a.csv"), place.path().join("run"));
            let told = format!("without {without:?}, round {round}");
            let done = four(|k| {
                let _faults = Faults::without(without, Errno::OPNOTSUPP);
                put(&file, Replace::Never, &format!("{k}").repeat(9_000))
            });
            assert_eq!(done, 1, "{told}");
            let text = fs::read_to_string(&file).expect("there");
            assert!(text.len() == 9_000 && text.bytes().all(|b| b == text.as_bytes()[0]), "{told}");
            let done = four(|k| {
                let _faults = Faults::without(without, Errno::OPNOTSUPP);
                put_folder(&folder, Replace::Never, &format!("{k}").repeat(9_000))
            });
            assert_eq!(done, 1, "{told}");
            assert_eq!(text_of(&folder).len(), 9_000, "{told}");
            assert_eq!(names(place.path()), ["a.csv", "run"], "{told}");
        }
    }
}

/// Four who may replace: each succeeds, and what is there in the end is one's, whole.
#[test]
fn four_threads_replace_one_another() {
    for without in [&[][..], NFS] {
        let place = tempfile::tempdir().expect("a temporary folder");
        let (file, folder) = (place.path().join("a.csv"), place.path().join("run"));
        for round in 0..10 {
            let done = four(|k| {
                let _faults = Faults::without(without, Errno::INVAL);
                put(&file, Replace::Always, &format!("{k}").repeat(9_000))?;
                put_folder(&folder, Replace::Always, &format!("{k}").repeat(9_000))
            });
            assert_eq!(done, 4, "without {without:?}, round {round}");
            assert_eq!(text_of(&folder).len(), 9_000);
        }
        assert_eq!(names(place.path()), ["a.csv", "run"]);
    }
}

#[test]
fn one_of_four_processes_gets_a_new_name() {
    for (what, without) in [("file", "nothing"), ("folder", "nothing"), ("file", "nfs"), ("folder", "nfs")] {
        for round in 0..5 {
            let place = tempfile::tempdir().expect("a temporary folder");
            let (path, go) = (place.path().join("result"), place.path().join("go"));
            let start =
                |_| child_at(what, &path, Replace::Never, without, 0).env("ATOMIC_GO", &go).spawn().expect("starts");
            let children = [0, 1, 2, 3].map(start);
            std::thread::sleep(std::time::Duration::from_millis(30));
            fs::write(&go, "").expect("writes");
            let ends = children.map(|c| c.wait_with_output().expect("ends"));
            let done = ends.iter().filter(|e| e.status.success()).count();
            assert_eq!(done, 1, "{what} without {without}, round {round}");
            for refused in ends.iter().filter(|e| !e.status.success()) {
                let said = String::from_utf8_lossy(&refused.stderr);
                assert!(said.contains("result: exists already"), "{said}");
            }
            assert_eq!(names(place.path()), ["go", "result"]);
        }
    }
}

/// While a folder is looked through and moved, nobody else does so beside it; the filling waits for nobody.
#[test]
fn replacing_folders_takes_turns() {
    for (without, moves) in [(&[][..], &["exchange"][..]), (NFS, &["set aside", "rename"])] {
        let place = tempfile::tempdir().expect("a temporary folder");
        let path = place.path().join("run");
        put_folder(&path, Replace::Never, "old").expect("the old one");
        let around = fs::File::open(place.path()).expect("opens");
        let seen = Rc::new(std::cell::RefCell::new(Vec::new()));
        let noted = seen.clone();
        let faults = Faults::set(move |step| {
            let free = around.try_lock().is_ok();
            let _ = around.unlock();
            noted.borrow_mut().push((step, free));
            without.contains(&step).then(|| Errno::NOSYS.into())
        });
        put_folder(&path, Replace::Always, "new").expect("replaced");
        drop(faults);
        let seen = seen.borrow();
        for step in moves {
            // The files within are published, too, before that: the folder's own step is the last one of the name.
            let last = seen.iter().rfind(|(s, _)| s == step).unwrap_or_else(|| panic!("no step {step}"));
            assert!(!last.1, "{step} without a turn");
        }
        assert!(seen.contains(&("fill", true)), "{seen:?}");
    }
}
