//! `isoplanat-camera`.
fn main() {}
