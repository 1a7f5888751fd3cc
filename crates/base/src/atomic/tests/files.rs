//! Files: what is kept, what is followed, what is written into, what is refused.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
use std::path::PathBuf;
use std::time::Instant;

use super::super::{check_target, distinct, outside, spares, write_cached, write_folder};
use super::kills::child_at;
use super::*;

fn place() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).expect("readable")
}

#[test]
fn what_stands_there_is_replaced_only_when_asked_for() {
    for without in [&[][..], NFS, FAT] {
        let place = place();
        let path = place.path().join("a.csv");
        let _faults = Faults::without(without, Errno::INVAL);
        put(&path, Replace::Never, "one").expect("new");
        assert!(matches!(put(&path, Replace::Never, "two"), Err(Error::Exists(_))));
        // Made by another while this one was at work.
        let late = place.path().join("late.csv");
        let refused = publish_file(&late, Replace::Never, |out| {
            fs::write(&late, "theirs").expect("writes");
            out.write_all(b"ours").map_err(|e| Error::writing(&late, e))
        });
        assert!(matches!(refused, Err(Error::Exists(_))), "{refused:?}");
        assert_eq!((text(&path).as_str(), text(&late).as_str()), ("one", "theirs"));
        put(&path, Replace::Always, "two").expect("replaced");
        assert_eq!(text(&path), "two");
        assert!(publish_file(&path, Replace::Always, |_| Err::<(), _>(Error::Interrupted)).is_err());
        assert_eq!(text(&path), "two");
        assert_eq!(names(place.path()), ["a.csv", "late.csv"]);
    }
}

#[test]
fn the_mode_of_a_replaced_file_is_kept() {
    let place = place();
    let path = place.path().join("a.csv");
    for mode in [0o600, 0o640, 0o444, 0o755] {
        fs::write(&path, "old").expect("writes");
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("set");
        put(&path, Replace::Always, "new").expect("replaced");
        assert_eq!(path.metadata().expect("there").permissions().mode() & 0o7777, mode);
        assert_eq!(text(&path), "new");
        fs::remove_file(&path).expect("removed");
    }
}

/// A writer that makes its file for its owner alone gives it the mode of any new file.
#[test]
fn a_file_of_another_writer_has_the_mode_of_a_new_file() {
    let place = place();
    let [usual, ours] = ["usual", "ours"].map(|name| place.path().join(name));
    fs::write(&usual, "new").expect("writes");
    let mode = |path: &Path| path.metadata().expect("there").permissions().mode() & 0o7777;
    let fill = |at: &Path| {
        fs::write(at, "new").expect("writes");
        fs::set_permissions(at, fs::Permissions::from_mode(0o600)).expect("set");
        Ok(())
    };
    publish_path(&ours, Replace::Never, fill).expect("published");
    assert_eq!(mode(&ours), mode(&usual));
    fs::set_permissions(&ours, fs::Permissions::from_mode(0o640)).expect("set");
    publish_path(&ours, Replace::Always, fill).expect("published");
    assert_eq!(mode(&ours), 0o640, "that of the file before");
}

#[test]
fn inputs_are_spared() {
    let place = place();
    let at = |name: &str| place.path().join(name);
    fs::write(at("lens.toml"), "lens").expect("writes");
    fs::create_dir(at("photos")).expect("made");
    fs::write(at("photos/a.png"), "a").expect("writes");
    symlink(at("lens.toml"), at("link")).expect("linked");
    fs::hard_link(at("lens.toml"), at("second")).expect("linked");
    write_folder(&at("run"), "task.toml", false, |folder| {
        fs::write(folder.join("task.toml"), "task").map_err(|e| Error::writing(folder, e))
    })
    .expect("written");
    fs::write(at("run/own.csv"), "own").expect("writes");
    let refused = |output: &str, inputs: &[&str]| {
        let inputs: Vec<PathBuf> = inputs.iter().map(|i| at(i)).collect();
        let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
        spares(&at(output), &inputs).is_err()
    };
    for (output, inputs) in [
        ("lens.toml", &["lens.toml"][..]),
        ("photos/../lens.toml", &["photos", "lens.toml"]),
        ("none/../lens.toml", &["lens.toml"]),
        ("link", &["lens.toml"]),
        ("lens.toml", &["link"]),
        ("photos", &["photos/a.png"]),
        ("photos", &["photos"]),
        ("run/task.toml", &["run"]),
    ] {
        assert!(refused(output, inputs), "{output} {inputs:?}");
    }
    for (output, inputs) in [
        ("new.toml", &["lens.toml"][..]),
        ("second", &["lens.toml"]),
        ("photos/new.csv", &["photos", "lens.toml"]),
        ("run/own.csv", &["run"]),
        ("run/new.csv", &["run"]),
        ("lens.toml", &["cooke_triplet", ""]),
    ] {
        assert!(!refused(output, inputs), "{output} {inputs:?}");
    }
    assert!(spares(Path::new("/dev/null"), &[Path::new("/dev/null")]).is_ok());
    assert!(outside(&at("run/new.png"), &at("run")).is_err() && outside(&at("new/new.png"), &at("run")).is_ok());
}

#[test]
fn links_stay_and_lead_to_the_new_file() {
    let place = place();
    let at = |name: &str| place.path().join(name);
    fs::create_dir(at("there")).expect("made");
    fs::write(at("there/real.csv"), "old").expect("writes");
    symlink("there/real.csv", at("one")).expect("linked");
    symlink(at("one"), at("two")).expect("linked");
    put(&at("two"), Replace::Always, "new").expect("replaced");
    assert_eq!(text(&at("there/real.csv")), "new");
    assert!(at("one").is_symlink() && at("two").is_symlink());
    assert!(matches!(put(&at("two"), Replace::Never, "x"), Err(Error::Exists(_))));
    // One that leads nowhere yet makes what it leads to.
    symlink("there/made.csv", at("three")).expect("linked");
    put(&at("three"), Replace::Never, "made").expect("new");
    assert_eq!(text(&at("there/made.csv")), "made");
    assert!(at("three").is_symlink());
    assert_eq!(names(&at("there")), ["made.csv", "real.csv"]);
    symlink("nowhere/a.csv", at("four")).expect("linked");
    assert!(put(&at("four"), Replace::Always, "x").expect_err("no folder").to_string().contains("nowhere"));
    symlink("round", at("round")).expect("linked");
    assert!(put(&at("round"), Replace::Always, "x").is_err());
}

#[test]
fn devices_and_pipes_are_written_into() {
    for replace in [Replace::Never, Replace::Always] {
        put(Path::new("/dev/null"), replace, "x").expect("written");
        check_target(Path::new("/dev/null"), replace).expect("may be written");
    }
    assert!(fs::metadata("/dev/null").expect("there").file_type().is_char_device());
    if Path::new("/dev/full").exists() {
        let full = put(Path::new("/dev/full"), Replace::Always, "x").expect_err("full").to_string();
        assert!(full.starts_with("/dev/full: writing: "), "{full}");
    }
    let place = place();
    let pipe = place.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    if !made.is_ok_and(|s| s.success()) {
        eprintln!("SKIPPED: there is no mkfifo");
        return;
    }
    check_target(&pipe, Replace::Never).expect("may be written, and nobody is waited for");
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || text(&pipe)
    });
    // A writer that goes back and forth, as that of an archive does.
    publish_file(&pipe, Replace::Never, |out| {
        let back = out.write_all(b"..cd").and_then(|()| out.seek(SeekFrom::Start(0)));
        back.and_then(|_| out.write_all(b"ab")).map_err(|e| Error::writing(&pipe, e))
    })
    .expect("written");
    assert_eq!(reader.join().expect("read"), "abcd");
    assert!(fs::metadata(&pipe).expect("there").file_type().is_fifo());
    // A writing that fails puts nothing into the pipe: nobody has to read it.
    let failed = publish_file(&pipe, Replace::Always, |out| {
        out.write_all(b"half").map_err(|e| Error::writing(&pipe, e))?;
        Err::<(), _>(Error::Interrupted)
    });
    assert!(matches!(failed, Err(Error::Interrupted)));
    assert_eq!(names(place.path()), ["pipe"]);
}

/// The last bytes of a buffer count, too: what cannot be written of them is told, and the old file stays.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_at_the_end_is_told() {
    let place = place();
    let path = place.path().join("a.csv");
    put(&path, Replace::Never, "old").expect("new");
    let full = publish_file(&path, Replace::Always, |out| {
        let device = File::options().write(true).open("/dev/full").map_err(|e| Error::writing(&path, e))?;
        *out = std::io::BufWriter::new(device);
        out.write_all(b"new").map_err(|e| Error::writing(&path, e))
    });
    let said = full.expect_err("full").to_string();
    assert!(said.contains("a.csv: writing: No space left"), "{said}");
    assert_eq!(text(&path), "old");
    assert_eq!(names(place.path()), ["a.csv"]);
}

/// A file that is open as a descriptor is written on where it ends; it is not replaced.
#[cfg(target_os = "linux")]
#[test]
fn open_descriptors_are_written_on() {
    use std::os::fd::AsRawFd;
    let place = place();
    let path = place.path().join("out.txt");
    let mut open = File::options().read(true).append(true).create(true).open(&path).expect("opens");
    open.write_all(b"before ").expect("writes");
    let link = place.path().join("stdout");
    symlink(format!("/proc/self/fd/{}", open.as_raw_fd()), &link).expect("linked");
    put(&link, Replace::Never, "after").expect("written");
    let mut read = String::new();
    open.rewind().and_then(|()| open.read_to_string(&mut read).map(drop)).expect("reads");
    assert_eq!(read, "before after");
    assert!(link.is_symlink());
}

/// The program's own output goes on where it is: nothing before it is lost, and what is printed after it follows.
#[test]
fn own_output_is_written_on() {
    let place = place();
    let path = place.path().join("out.txt");
    let mut open = File::create(&path).expect("made");
    open.write_all(b"before\n").expect("writes");
    let mut child = child_at("file", Path::new("/dev/stdout"), Replace::Never, "nothing", 0);
    let ended = child.stdout(open).output().expect("ends");
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let text = text(&path);
    let at = |part: &str| text.find(part).unwrap_or_else(|| panic!("{part}: {} bytes", text.len()));
    let new = "new ".repeat(6_000);
    assert!(text.starts_with("before\n") && at("running 1 test") < at(&new) && at(&new) < at("test result: ok"));
    assert_eq!(names(place.path()), ["out.txt"]);
}

/// One word to the user, however often a file system needs several steps.
#[test]
fn what_a_file_system_lacks_is_told_once() {
    static TOLD: std::sync::Mutex<Vec<String>> = std::sync::Mutex::new(Vec::new());
    super::super::tell_by(|note| TOLD.lock().expect("whole").push(note.to_owned()));
    let place = place();
    let _faults = Faults::without(NFS, Errno::INVAL);
    for name in ["a", "b"] {
        put(&place.path().join(name), Replace::Never, "x").expect("written");
        put_folder(&place.path().join(format!("{name}-run")), Replace::Never, "x").expect("written");
    }
    // Another test may have been the first to need several steps.
    let told = TOLD.lock().expect("whole");
    assert!(told.len() == 1 && told[0].contains("this file system can"), "{told:?}");
}

#[test]
fn outputs_are_tested_before_the_work() {
    let place = place();
    let at = |name: &str| place.path().join(name);
    let refused = |path: &Path, replace, said: &str| {
        let error = check_target(path, replace).expect_err("refused").to_string();
        assert!(error.contains(said), "{error}");
        assert!(put(path, replace, "x").is_err(), "what is refused before would fail after");
    };
    fs::write(at("a.csv"), "old").expect("writes");
    check_target(&at("a.csv"), Replace::Always).expect("may be replaced");
    check_target(&at("b.csv"), Replace::Never).expect("may be made");
    check_target(&at(&"ä".repeat(127)), Replace::Never).expect("254 bytes");
    put(&at(&"ä".repeat(127)), Replace::Never, "long").expect("254 bytes");
    refused(&at("a.csv"), Replace::Never, "exists already");
    refused(place.path(), Replace::Always, "a folder stands there");
    refused(&at("new/"), Replace::Always, "folder");
    refused(&at("none/a.csv"), Replace::Always, "there is no folder");
    refused(&at("a.csv/b.csv"), Replace::Always, "a.csv/b.csv: writing: ");
    refused(&at(&"n".repeat(256)), Replace::Never, "name too long");
    refused(Path::new(""), Replace::Never, "an empty name");
    assert_eq!(names(place.path()).len(), 2);
    fs::create_dir(at("closed")).expect("made");
    fs::set_permissions(at("closed"), fs::Permissions::from_mode(0o500)).expect("set");
    if rustix::process::geteuid().is_root() {
        eprintln!("SKIPPED: a folder that may not be written to: the tests run as root, who may");
    } else {
        refused(&at("closed/a.csv"), Replace::Never, "ermission denied");
    }
    if Path::new("/proc/sys").is_dir() {
        refused(Path::new("/proc/sys/a.csv"), Replace::Never, "/proc/sys/a.csv: writing: ");
    }
}

#[test]
fn two_outputs_are_two_places() {
    let place = place();
    let at = |name: &str| place.path().join(name);
    fs::create_dir(at("sub")).expect("made");
    fs::write(at("real.csv"), "x").expect("writes");
    symlink("sub", at("other")).expect("linked");
    symlink("real.csv", at("linked.csv")).expect("linked");
    symlink("sub/new.csv", at("dangling.csv")).expect("linked");
    let same = [
        ["a.csv", "./a.csv"],
        ["a.csv", "sub/../a.csv"],
        ["sub/new.csv", "other/new.csv"],
        ["real.csv", "linked.csv"],
        ["sub/new.csv", "dangling.csv"],
        ["none/x", "none/../none/x"],
    ];
    for [one, other] in same {
        let error = distinct(&[&at(one), &at("else.csv"), &at(other)]).expect_err(other).to_string();
        assert!(error.contains(other) && error.contains("two outputs"), "{error}");
    }
    for [outer, inner] in [["sub", "sub/a.csv"], ["new", "new/deep/a.csv"], ["sub", "other/a.csv"], ["other", "sub/a"]]
    {
        for [one, other] in [[outer, inner], [inner, outer]] {
            let error = distinct(&[&at(one), &at("else.csv"), &at(other)]).expect_err(inner).to_string();
            assert!(error.contains(&format!("{inner}: output: lies in ")), "{error}");
        }
    }
    distinct(&[&at("a"), &at("a.csv"), &at("ab/a")]).expect("all different");
    let null = Path::new("/dev/null");
    distinct(&[&at("a.csv"), &at("b.csv"), &at("sub/a.csv"), null, null]).expect("all different");
}

/// What killed runs, or others, have put beside: names of ours that nobody holds go, all else stays and never enters.
#[test]
fn leftovers_are_swept_and_nothing_else() {
    let place = place();
    let at = |name: &str| place.path().join(name);
    let pid = std::process::id();
    let mut stay = vec![
        format!(".a.csv.{pid}-0.partial"),
        format!(".a.csv.{pid}-1.partial"),
        ".a.csv.partial".into(),
        ".a.csv.abcdefghijk!.partial".into(),
        ".b.csv.abcdefghijkl.partial".into(),
        ".a.csv.abcdefghijkl.old".into(),
        "a.csv.abcdefghijkl.partial".into(),
        ".a.csv.living000000.partial".into(),
    ];
    stay.iter().for_each(|name| fs::write(at(name), "planted").expect("writes"));
    let living = File::open(at(".a.csv.living000000.partial")).expect("opens");
    living.lock().expect("locked");
    fs::create_dir(at(".a.csv.folder000000.partial")).expect("made");
    symlink("/etc/passwd", at(".a.csv.link00000000.partial")).expect("linked");
    for name in [".a.csv.dead00000000.partial", ".a.csv.zzzzzzzzzzz9.partial"] {
        fs::write(at(name), "left").expect("writes");
    }
    fs::set_permissions(at(".a.csv.dead00000000.partial"), fs::Permissions::from_mode(0o444)).expect("set");
    put(&at("a.csv"), Replace::Never, "new").expect("written");
    stay.extend([".a.csv.folder000000.partial".into(), ".a.csv.link00000000.partial".into(), "a.csv".into()]);
    stay.sort();
    assert_eq!(names(place.path()), stay);
    drop(living);
    put(&at("a.csv"), Replace::Always, "newer").expect("written");
    assert!(!at(".a.csv.living000000.partial").exists(), "swept once its writer is dead");
}

/// Who goes on in a folder clears it, at every depth, of what nobody writes any more; links are not followed, and names too long to tell their target stay.
#[test]
fn leftovers_within_a_folder_are_swept_by_who_goes_on() {
    let (place, other) = (place(), place());
    let at = |name: &str| place.path().join(name);
    fs::create_dir_all(at("run/1/network")).expect("made");
    fs::write(other.path().join(".a.csv.dead00000000.partial"), "left").expect("writes");
    symlink(other.path(), at("run/elsewhere")).expect("linked");
    let long = format!(".{}~12345678.dead00000000.partial", "n".repeat(96));
    for name in
        [".lens.toml.dead00000000.partial", "1/network/.net.safetensors.dead00000000.lock", "1/lens.toml", &long]
    {
        fs::write(at("run").join(name), "left").expect("writes");
    }
    fs::write(at("run/1/.log.csv.living000000.partial"), "held").expect("writes");
    let living = File::open(at("run/1/.log.csv.living000000.partial")).expect("opens");
    living.lock().expect("locked");
    super::super::recover(&at("run")).expect("swept");
    assert_eq!(names(&at("run")), [long.as_str(), "1", "elsewhere"]);
    assert_eq!(names(&at("run/1")), [".log.csv.living000000.partial", "lens.toml", "network"]);
    assert!(names(&at("run/1/network")).is_empty() && names(other.path()).len() == 1);
}

/// Figures for the record. The bound is that of the promise, twenty times over: the disk may be shared.
#[test]
fn a_publication_costs_little() {
    let place = place();
    let (file, folder) = (place.path().join("a.csv"), place.path().join("run"));
    let time = |what: &str, n: u32, run: &mut dyn FnMut()| {
        let mut all: Vec<f64> = (0..n)
            .map(|_| {
                let clock = Instant::now();
                run();
                clock.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        all.sort_by(f64::total_cmp);
        let median = all[all.len() / 2];
        eprintln!("{what}: median {median:.2} ms, longest {:.2} ms", all[all.len() - 1]);
        assert!(median < 400.0, "{what}: {median} ms");
    };
    let bytes = "x".repeat(100_000);
    time("a file of 100 kB", 21, &mut || put(&file, Replace::Always, &bytes).expect("written"));
    time("the same, not synced", 201, &mut || write_cached(&file, bytes.as_bytes()).expect("written"));
    time("a folder of three such files", 21, &mut || put_folder(&folder, Replace::Always, &bytes).expect("written"));
    time("a check", 201, &mut || check_target(&file, Replace::Always).expect("may be replaced"));
}
