//! What README and manual print is true: their short commands run as printed.

use std::path::Path;
use std::process::Command;

use crate::manual::{pages, text};
use crate::support::root;

/// Blocks of shell commands that anybody can run at once; others say in their first line what they need.
fn short_commands(page: &str) -> Vec<&str> {
    let blocks = page.split("\n```sh\n").skip(1).map(|rest| rest.split("\n```").next().unwrap_or(rest));
    let other = ["# long", "# your own files", "# installs"];
    blocks.filter(|block| !other.iter().any(|o| block.lines().next().is_some_and(|l| l.trim() == *o))).collect()
}

/// Page by page, each in a folder that has the shipped models and nothing else. `demo --quick` runs by itself in `.ci/run`.
#[test]
fn printed_commands_run_as_printed() {
    let programs = Path::new(env!("CARGO_BIN_EXE_isoplanat")).parent().expect("a folder");
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap_or_default());
    let mut count = 0;
    for page in pages(root()) {
        let text = text(&page);
        let blocks = short_commands(&text);
        if blocks.is_empty() {
            continue;
        }
        let place = crate::support::Workplace::new();
        std::os::unix::fs::symlink(root().join("models"), place.path("models")).expect("linked");
        let script = blocks.join("\n").replace("isoplanat demo --quick\n", "");
        count += script.lines().filter(|l| l.starts_with("isoplanat")).count();
        let mut command = Command::new("sh");
        command.args(["-e", "-u", "-x", "-c", &script]).current_dir(place.path(".")).env("PATH", &path);
        let ran = command.output().expect("a shell");
        let said = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.success(), "{}: {}\n{said}", page.display(), ran.status);
    }
    assert!(count > 30, "only {count} commands were found");
}
