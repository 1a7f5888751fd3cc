//! What holds of the sources and pages as texts: the order of modules, circles, adjoints and their tests, the public list, the README.
//!
//! A crate of its own, which builds nothing of the project: `cargo test -p isoplanat-structure` takes seconds.
#![cfg(test)]

mod circles;
mod layering;
mod manual;
mod pages;
mod public_api;

use std::path::Path;

/// The repository's root.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}
