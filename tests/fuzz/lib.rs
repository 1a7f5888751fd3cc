//! The fuzz targets as programs of libFuzzer. `targets/` is shared with the tests; here stands what only the programs do.

mod targets;

use std::panic::{catch_unwind, set_hook};
use std::path::Path;

use targets::{TARGETS, Target};

/// The body of a target's program, which is called as the target.
#[macro_export]
macro_rules! fuzz {
    () => {
        libfuzzer_sys::fuzz_target!(init: $crate::begin(env!("CARGO_BIN_NAME")), |bytes: &[u8]| {
            $crate::run(env!("CARGO_BIN_NAME"), bytes)
        });
    };
}

fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).expect("a target of this name")
}

/// A panic in this project's code ends the program, also where a reader would catch it; one in a decoder of others that is caught does not. With `FUZZ_STARTS`
/// the inputs to start from are written into that folder.
pub fn begin(name: &str) {
    set_hook(Box::new(|panic| {
        let file = panic.location().map_or("", |l| l.file());
        if !file.contains("/registry/src/") {
            eprintln!("{panic}");
            std::process::abort();
        }
    }));
    if let Some(folder) = std::env::var_os("FUZZ_STARTS") {
        std::fs::create_dir_all(&folder).expect("a folder");
        for (k, start) in (target(name).starts)().iter().enumerate() {
            std::fs::write(Path::new(&folder).join(format!("start-{k}")), start).expect("writes");
        }
    }
}

/// One input.
pub fn run(name: &str, bytes: &[u8]) {
    if catch_unwind(|| (target(name).run)(bytes)).is_err() {
        eprintln!("a panic in a decoder of others, which nobody caught");
        std::process::abort();
    }
}
