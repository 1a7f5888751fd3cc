//! Folders: what gives way, what is refused by name, what never enters.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;

use super::super::{MANIFEST, check_folder, check_kind, write_folder};
use super::*;

fn place() -> (tempfile::TempDir, PathBuf) {
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("run");
    (place, folder)
}

/// A folder of ours gives way to a new one; another folder, and a failed writing, leave everything as it was.
#[test]
fn folders_appear_whole_and_foreign_folders_are_never_replaced() {
    for without in [&[][..], NFS] {
        let (place, folder) = place();
        let _faults = Faults::without(without, Errno::NOSYS);
        let fill = |text: &'static str| move |at: &Path| write_bytes(&at.join("mark"), text.as_bytes());
        write_folder(&folder, "mark", false, fill("one")).expect("new");
        assert!(matches!(write_folder(&folder, "mark", false, fill("two")), Err(Error::Exists(_))));
        write_folder(&folder, "mark", true, fill("two")).expect("replaced");
        let failed = write_folder(&folder, "mark", true, |_| Err::<(), _>(Error::Internal("no".into())));
        assert!(failed.is_err());
        assert_eq!(fs::read(folder.join("mark")).expect("kept"), b"two");
        let foreign = place.path().join("photos");
        fs::create_dir(&foreign).expect("made");
        fs::write(foreign.join("a.jpg"), "mine").expect("writes");
        let refused = write_folder(&foreign, "mark", true, fill("x")).expect_err("of another kind").to_string();
        assert!(refused.contains("without mark") && !refused.contains("--force"), "{refused}");
        assert!(matches!(write_folder(&foreign, "mark", false, fill("x")), Err(Error::Exists(_))));
        let late = place.path().join("late");
        let refused = write_folder(&late, "mark", false, |at| {
            fs::create_dir(&late).expect("made by another meanwhile");
            fs::write(late.join("b"), "another's").expect("writes");
            write_bytes(&at.join("mark"), b"x")
        });
        assert!(matches!(refused, Err(Error::Exists(_))), "{refused:?}");
        assert_eq!(names(place.path()), ["late", "photos", "run"], "nothing is left beside");
    }
}

/// A folder without entries gives way without being asked for, keeps its mode, and stays where the writing fails; one that gets an entry meanwhile is another's.
#[test]
fn an_empty_folder_gives_way() {
    for without in [&[][..], NFS] {
        for replace in [Replace::Never, Replace::Always] {
            let (place, folder) = place();
            let _faults = Faults::without(without, Errno::NOSYS);
            fs::create_dir(&folder).expect("made");
            fs::set_permissions(&folder, fs::Permissions::from_mode(0o750)).expect("set");
            check_folder(&folder, MARKER, replace == Replace::Always).expect("free");
            assert!(write_folder(&folder, MARKER, false, |_| Err::<(), _>(Error::Interrupted)).is_err());
            assert!(fs::read_dir(&folder).expect("stays").next().is_none());
            let came = publish_folder(&folder, &FolderKind::listed(MARKER), replace, |at| {
                fs::write(folder.join("b"), "another's").expect("writes");
                write_bytes(&at.join(MARKER), b"x")
            });
            assert_eq!(came.expect_err("taken meanwhile").exit_code(), 2);
            assert_eq!(names(&folder), ["b"]);
            fs::remove_file(folder.join("b")).expect("removed");
            put_folder(&folder, replace, "one").expect("written");
            assert_eq!(text_of(&folder), "one");
            assert_eq!(folder.metadata().expect("there").permissions().mode() & 0o777, 0o750);
            assert!(matches!(put_folder(&folder, Replace::Never, "two"), Err(Error::Exists(_))));
            assert_eq!(names(place.path()), ["run"], "nothing is left beside");
        }
    }
}

/// What comes into an empty folder in the last moment stays, and nothing else comes beside it.
#[test]
fn an_entry_that_comes_last_keeps_its_folder() {
    for without in [&[][..], NFS] {
        let (place, folder) = place();
        fs::create_dir(&folder).expect("made");
        let note = folder.join("b");
        let faults = Faults::set(move |at| {
            if at == "rename" {
                fs::write(&note, "another's").expect("writes");
            }
            without.contains(&at).then(|| Errno::NOSYS.into())
        });
        let refused = put_folder(&folder, Replace::Never, "one");
        drop(faults);
        assert!(matches!(refused, Err(Error::Exists(_))), "{refused:?}");
        assert_eq!(names(&folder), ["b"]);
        assert_eq!(names(place.path()), ["run"], "nothing is left beside");
    }
}

#[test]
fn foreign_entries_are_named_and_kept() {
    let (place, folder) = place();
    put_folder(&folder, Replace::Never, "old").expect("new");
    fs::create_dir(folder.join("raw")).expect("made");
    for name in ["my-notes.txt", "raw/keep.dng", "sub/mine", "zz\u{1b}[2J"] {
        fs::write(folder.join(name), "mine").expect("writes");
    }
    let named = |error: Error| {
        let text = error.to_string();
        assert!(text.contains("my-notes.txt, raw/keep.dng, sub/mine and 1 more") && text.contains("run"), "{text}");
        assert_eq!(error.exit_code(), 2);
    };
    named(check_folder(&folder, MARKER, true).expect_err("refused"));
    named(put_folder(&folder, Replace::Always, "new").expect_err("refused"));
    assert_eq!(fs::read_to_string(folder.join("raw/keep.dng")).expect("kept"), "mine");
    assert_eq!(fs::read_to_string(folder.join("a")).expect("kept"), "old");
    for name in ["my-notes.txt", "raw/keep.dng", "sub/mine"] {
        fs::remove_file(folder.join(name)).expect("removed");
    }
    let text = check_folder(&folder, MARKER, true).expect_err("refused").to_string();
    assert!(text.contains("raw, zz\\u{1b}[2J: not"), "an empty folder of another's, no control characters: {text}");
    fs::remove_dir(folder.join("raw")).expect("removed");
    fs::remove_file(folder.join("zz\u{1b}[2J")).expect("removed");
    fs::write(folder.join(".DS_Store"), "").expect("writes");
    fs::write(folder.join(".a.abcdefghijkl.partial"), "left by a kill").expect("writes");
    fs::create_dir(folder.join("sub/.c.abcdefghijkl.partial")).expect("made");
    fs::write(folder.join("sub/.c.abcdefghijkl.partial/x"), "left by a kill").expect("writes");
    put_folder(&folder, Replace::Always, "new").expect("replaced");
    assert_eq!(text_of(&folder), "new");
    assert_eq!(names(place.path()), ["run"]);
}

/// What came in while the new one was being written is seen, even in the last moment.
#[test]
fn entries_that_come_late_are_kept() {
    for (without, step) in [(&[][..], "exchange"), (NFS, "claim folder"), (&[], "fill")] {
        let (place, folder) = place();
        put_folder(&folder, Replace::Never, "old").expect("new");
        let note = folder.join("note.txt");
        let theirs = note.clone();
        let first = Cell::new(true);
        let faults = Faults::set(move |at| {
            if at == step && first.replace(false) {
                fs::write(&theirs, "mine").expect("writes");
            }
            without.contains(&at).then(|| Errno::NOSYS.into())
        });
        let text = put_folder(&folder, Replace::Always, "new").expect_err(step).to_string();
        drop(faults);
        assert!(text.contains("note.txt"), "{step}: {text}");
        assert_eq!(fs::read_to_string(&note).expect("kept"), "mine", "{step}");
        assert_eq!(fs::read_to_string(folder.join("a")).expect("kept"), "old", "{step}");
        assert_eq!(names(place.path()), ["run"], "{step}");
    }
}

/// Pictures that the user named, and what the kind's patterns allow, may be replaced; folders of older versions by patterns alone.
#[test]
fn entries_on_the_list_and_of_the_kind_are_replaced() {
    let (_place, folder) = place();
    let kind = FolderKind::new(MARKER, &["lock", "checkpoints/**", "zone-*.png"]);
    let write = |names: &[&str]| {
        publish_folder(&folder, &kind, Replace::Always, |inside| {
            names.iter().try_for_each(|name| write_bytes(&inside.join(name), b"x"))
        })
    };
    write(&[MARKER, "holiday.png", "100%.png"]).expect("new");
    fs::create_dir_all(folder.join("checkpoints/deep")).expect("made");
    for name in ["lock", "checkpoints/deep/1", "zone-3.png"] {
        fs::write(folder.join(name), "x").expect("writes");
    }
    check_kind(&folder, &kind, Replace::Always).expect("all ours");
    write(&[MARKER, "other.png"]).expect("replaced");
    assert_eq!(names(&folder), [MANIFEST, MARKER, "other.png"]);
    fs::write(folder.join("holiday.png"), "mine").expect("writes");
    assert!(write(&[MARKER]).expect_err("of an earlier list").to_string().contains("holiday.png"));
    // Older versions wrote no list.
    fs::remove_file(folder.join(MANIFEST)).expect("removed");
    let text = check_kind(&folder, &kind, Replace::Always).expect_err("foreign").to_string();
    assert!(text.contains("holiday.png, other.png:"), "{text}");
    check_folder(&folder, MARKER, true).expect("as before");
    fs::write(folder.join(MANIFEST), "schema = 2\nentries = 3").expect("writes");
    let text = check_folder(&folder, MARKER, true).expect_err("newer").to_string();
    assert!(text.contains(MANIFEST) && text.contains("schema = 1"), "{text}");
}

/// What a writer within the folder could not take away behind itself is not part of the result.
#[test]
fn leftovers_within_are_not_published() {
    let (_place, folder) = place();
    let kind = FolderKind::listed("mark");
    publish_folder(&folder, &kind, Replace::Never, |at| {
        fs::write(at.join(".a.abcdefghijkl.lock"), "").expect("left");
        fs::write(at.join(".a.abcdefghijkl.partial"), "half").expect("left");
        write_bytes(&at.join("mark"), b"x")
    })
    .expect("new");
    assert_eq!(names(&folder), [MANIFEST, "mark"]);
    assert!(!fs::read_to_string(folder.join(MANIFEST)).expect("list").contains("abcdefghijkl"));
}

/// Whatever stands under whatever name beside: nothing of it is in the result.
#[test]
fn nothing_planted_enters() {
    let (place, folder) = place();
    let pid = std::process::id();
    let mut planted: Vec<String> = (0..20).map(|k| format!(".run.{pid}-{k}.partial")).collect();
    planted.extend([".run.abcdefghijkl.partial".into(), ".run.abcdefghijkl.old".into(), ".run.partial".into()]);
    for name in &planted {
        fs::create_dir(place.path().join(name)).expect("made");
        fs::write(place.path().join(name).join("evil.onnx"), "evil").expect("writes");
    }
    put_folder(&folder, Replace::Never, "one").expect("new");
    put_folder(&folder, Replace::Always, "two").expect("replaced");
    assert_eq!(text_of(&folder), "two");
    let mut wanted = planted.clone();
    wanted.push("run".into());
    wanted.sort();
    assert_eq!(names(place.path()), wanted, "what has no lock is nobody's");
    // With a lock that nobody holds it is a leftover: it goes, links are not followed.
    let kept = place.path().join("kept");
    fs::create_dir(&kept).expect("made");
    fs::write(kept.join("a"), "mine").expect("writes");
    symlink(&kept, place.path().join(".run.llllllllllll.partial")).expect("linked");
    for random in ["abcdefghijkl", "llllllllllll"] {
        fs::write(place.path().join(format!(".run.{random}.lock")), "").expect("writes");
    }
    put_folder(&folder, Replace::Always, "three").expect("replaced");
    assert_eq!(fs::read_to_string(kept.join("a")).expect("kept"), "mine");
    assert!(names(place.path()).iter().all(|n| !n.contains("abcdefghijkl") && !n.contains("llllllllllll")));
}

#[test]
fn links_around_folders_and_modes() {
    let (place, folder) = place();
    let at = |name: &str| place.path().join(name);
    put_folder(&at("real"), Replace::Never, "one").expect("new");
    fs::set_permissions(at("real"), fs::Permissions::from_mode(0o700)).expect("set");
    symlink("real", &folder).expect("linked");
    put_folder(&folder, Replace::Always, "two").expect("replaced");
    assert!(folder.is_symlink());
    assert_eq!(text_of(&at("real")), "two");
    assert_eq!(at("real").metadata().expect("there").permissions().mode() & 0o777, 0o700);
    // Missing folders around it are made, and go again with a failed writing.
    let deep = at("x/y/run");
    check_folder(&deep, MARKER, false).expect("may be made");
    assert!(write_folder(&deep, MARKER, false, |_| Err::<(), _>(Error::Interrupted)).is_err());
    assert_eq!(names(place.path()), ["real", "run"]);
    put_folder(&deep, Replace::Never, "deep").expect("made");
    assert_eq!(text_of(&deep), "deep");
    put_folder(&at("n/../x/other/"), Replace::Never, "other").expect("made");
    assert_eq!(names(&at("x")), ["other", "y"]);
    let refused = |path: &Path, said: &str| {
        let error = check_folder(path, MARKER, true).expect_err("refused").to_string();
        assert!(error.contains(said), "{error}");
        assert!(put_folder(path, Replace::Always, "x").is_err());
    };
    fs::write(at("file"), "x").expect("writes");
    refused(&at("file"), "a file stands there");
    refused(&at("file/run"), "Not a directory");
    refused(Path::new("/"), "the root");
    refused(Path::new("/dev/null"), "a device");
    refused(&at(&"n".repeat(256)), "name too long");
    refused(&at("none").join("n".repeat(256)).join("run"), "name too long");
    if Path::new("/proc/sys").is_dir() {
        refused(Path::new("/proc/sys/a/run"), "/proc/sys/a/run");
    }
}

/// A folder that cannot be moved away is refused before the work, in words, and stays as it is.
#[test]
fn folders_that_cannot_be_moved_are_refused_before_the_work() {
    let (place, folder) = place();
    put_folder(&folder, Replace::Never, "old").expect("new");
    check_folder(&folder, MARKER, true).expect("may be moved");
    assert_eq!(text_of(&folder), "old");
    for (errno, said) in
        [(Errno::XDEV, "container's image"), (Errno::BUSY, "mount point"), (Errno::PERM, "not permitted")]
    {
        for step in ["probe", "exchange"] {
            let _faults = Faults::set(move |at| (at == step).then(|| errno.into()));
            let error = match step {
                "probe" => check_folder(&folder, MARKER, true),
                _ => put_folder(&folder, Replace::Always, "new"),
            };
            let text = error.expect_err(step).to_string();
            assert!(text.contains(said) && text.contains("run: writing: "), "{text}");
            assert_eq!(text_of(&folder), "old");
            assert_eq!(names(place.path()), ["run"]);
        }
    }
}

/// Errors name the place that was asked for, not the one where it is being written.
#[test]
fn errors_name_the_final_place() {
    let (_place, folder) = place();
    let file = folder.join("none/a");
    let said = |fill: &dyn Fn(&Path) -> Result<()>| {
        write_folder(&folder, MARKER, false, fill).expect_err("refused").to_string()
    };
    assert!(said(&|at| write_bytes(&at.join("none/a"), b"")).starts_with(&format!("{}: writing: ", file.display())));
    let bad = |at: &Path| Err(Error::bad(at.join("none/a").display().to_string(), "key", "1", "2"));
    assert_eq!(said(&bad), format!("{}: key: 1; 2", file.display()));
    let other = |_: &Path| Err(Error::bad("lens.toml", "key", "1", "2"));
    assert_eq!(said(&other), "lens.toml: key: 1; 2");
}

/// The list holds every entry, whatever bytes its name has.
#[cfg(target_os = "linux")]
#[test]
fn names_that_are_no_text_are_listed() {
    use std::os::unix::ffi::OsStrExt;
    let (_place, folder) = place();
    let odd = |end: u8| std::ffi::OsStr::from_bytes(&[b'a', 0xff, b'\n', end]).to_owned();
    let write = || {
        write_folder(&folder, MARKER, true, |inside| {
            write_bytes(&inside.join(MARKER), b"")?;
            write_bytes(&inside.join(odd(b'1')), b"")
        })
    };
    write().expect("new");
    write().expect("replaced");
    fs::write(folder.join(odd(b'2')), "mine").expect("writes");
    let text = write().expect_err("foreign").to_string();
    assert!(text.contains("a%FF\\n2"), "{text}");
}
