//! `isoplanat`.
fn main() {}
