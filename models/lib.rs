//! The lenses, glasses and tasks that Isoplanat ships, as the texts of their files. `README.md` beside this file documents the forms and cites the sources.
//!
//! Kits (`kits/`) are folders for people and no part of the package.

/// Name and TOML text of every shipped lens.
pub const LENSES: [(&str, &str); 18] = [
    ("two_element", include_str!("lenses/two_element.toml")),
    ("three_element", include_str!("lenses/three_element.toml")),
    ("cooke_triplet", include_str!("lenses/cooke_triplet.toml")),
    ("double_gauss", include_str!("lenses/double_gauss.toml")),
    ("al2550_a", include_str!("lenses/al2550_a.toml")),
    ("ac254_050_a", include_str!("lenses/ac254_050_a.toml")),
    ("aca254_050_a_surrogate", include_str!("lenses/aca254_050_a_surrogate.toml")),
    ("phone", include_str!("lenses/phone.toml")),
    ("petzval", include_str!("lenses/petzval.toml")),
    ("telephoto", include_str!("lenses/telephoto.toml")),
    ("tessar", include_str!("lenses/tessar.toml")),
    ("retrofocus", include_str!("lenses/retrofocus.toml")),
    ("landscape", include_str!("lenses/landscape.toml")),
    ("heliar", include_str!("lenses/heliar.toml")),
    ("sonnar", include_str!("lenses/sonnar.toml")),
    ("biotar", include_str!("lenses/biotar.toml")),
    ("wide_angle", include_str!("lenses/wide_angle.toml")),
    ("hologon", include_str!("lenses/hologon.toml")),
];

/// Name and TOML text of every shipped task.
pub const TASKS: [(&str, &str); 6] = [
    ("lfov-paper", include_str!("tasks/lfov-paper.toml")),
    ("lfov-30", include_str!("tasks/lfov-30.toml")),
    ("lfov-30-free", include_str!("tasks/lfov-30-free.toml")),
    ("edof", include_str!("tasks/edof.toml")),
    ("edof-free", include_str!("tasks/edof-free.toml")),
    ("edof-joint", include_str!("tasks/edof-joint.toml")),
];

/// The shipped catalogue of glasses, TOML.
pub const GLASSES: &str = include_str!("glasses/catalog.toml");
