//! Runs the built program in a folder of its own.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A temporary folder in which the program runs; removed at the end.
pub(crate) struct Workplace {
    folder: tempfile::TempDir,
}

/// What a run left behind.
#[derive(Debug)]
pub(crate) struct Ran {
    /// Exit code.
    pub(crate) code: i32,
    /// Standard output.
    pub(crate) out: String,
    /// Standard error.
    pub(crate) err: String,
}

impl Workplace {
    /// An empty folder.
    pub(crate) fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder") }
    }

    /// A path in the folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Puts a file there.
    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.path(name), content).expect("writes");
        self
    }

    /// Names of what lies there, sorted.
    pub(crate) fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).expect("lists");
        let mut names: Vec<String> =
            entries.map(|e| e.expect("entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// Runs `isoplanat` with these arguments (split at blanks) in the folder.
    pub(crate) fn run(&self, arguments: &str) -> Ran {
        self.run_with_input(arguments, "")
    }

    /// The same with `input` on stdin.
    pub(crate) fn run_with_input(&self, arguments: &str, input: &str) -> Ran {
        Self::finish(self.command(arguments), input)
    }

    /// The same under limits: seconds of processor time, KiB of addresses. A run that is ended by them has the exit code −1.
    pub(crate) fn run_limited(&self, arguments: &str, seconds: u32, kib: u32) -> Ran {
        self.run_under(&format!("ulimit -t {seconds} && ulimit -v {kib}"), arguments)
    }

    /// The same where a write fails, as on a full disk, once its file has so many blocks of 512 bytes.
    pub(crate) fn run_with_small_files(&self, arguments: &str, blocks: u64) -> Ran {
        self.run_under(&format!("ulimit -f {blocks}"), arguments)
    }

    fn run_under(&self, limits: &str, arguments: &str) -> Ran {
        let mut command = Command::new("sh");
        command.arg("-c").arg(format!("{limits} && exec \"$0\" \"$@\"")).arg(env!("CARGO_BIN_EXE_isoplanat"));
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        Self::finish(command, "")
    }

    fn finish(mut command: Command, input: &str) -> Ran {
        let mut child =
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
        // A program that does not read its input may have left already.
        let _ = child.stdin.take().expect("piped").write_all(input.as_bytes());
        let output = child.wait_with_output().expect("ends");
        Ran {
            code: output.status.code().unwrap_or(-1),
            out: String::from_utf8(output.stdout).expect("UTF-8"),
            err: String::from_utf8(output.stderr).expect("UTF-8"),
        }
    }

    /// The program with these arguments, ready to start in the folder.
    pub(crate) fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isoplanat"));
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        command
    }
}

impl Ran {
    /// Panics unless the run went well; returns its standard output.
    #[track_caller]
    pub(crate) fn done(self) -> String {
        assert_eq!(self.code, 0, "{self:?}");
        self.out
    }

    /// Panics unless the run was refused as bad input with one line on stderr that holds all of `expected`, and nothing
    /// on stdout.
    #[track_caller]
    pub(crate) fn refused(&self, expected: &[&str]) {
        assert_eq!(self.code, 2, "{self:?}");
        assert_eq!(self.out, "", "{self:?}");
        assert_eq!(self.err.lines().count(), 1, "one line: {self:?}");
        for text in expected {
            assert!(self.err.contains(text), "`{text}` in {:?}", self.err);
        }
    }
}

/// What a command said with `--json`.
///
/// # Panics
/// Where it is none, with the text.
pub(crate) fn read_json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// How often something random is repeated: `few` times, which is what every change can wait for, or `many`, where `ISOPLANAT_REPEAT` is `many` (`.ci/slow
/// repetitions`), or as often as it says.
///
/// # Panics
/// Where it says anything else.
pub(crate) fn repetitions(few: usize, many: usize) -> usize {
    match std::env::var("ISOPLANAT_REPEAT") {
        Err(_) => few,
        Ok(text) if text == "many" => many,
        Ok(text) => text.parse().expect("ISOPLANAT_REPEAT: `many` or a number"),
    }
}

/// A design of some seconds: tiny network, checkpoints all the time.
#[cfg(feature = "train")]
pub(crate) const SMALL_DESIGN: &str = r#"
schema = 1
lens = "two_element"
sensor = { columns = 96, rows = 64, pitch_um = 200.0, axis_px = [0.0, 0.0] }
scenes = 2
base_width = 4
patch_px = 32
batch = 1
steps = 90
checks = 3
checkpoint_seconds = 0.02
"#;

/// Every tensor of a checkpoint, as bytes: what stands behind the header.
#[cfg(feature = "train")]
pub(crate) fn tensors(file: &Path) -> Vec<u8> {
    let bytes = std::fs::read(file).expect("a checkpoint");
    let header = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes"));
    bytes[8 + usize::try_from(header).expect("fits")..].to_vec()
}

/// The repository's root.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The lens of a file of this repository.
pub(crate) fn lens_file(path: &str) -> isoplanat::lens::Lens {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    isoplanat::lens::prescription::load(&path).expect("a valid lens file")
}
