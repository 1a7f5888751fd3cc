//! Names of temporaries: `.TARGET.RANDOM.partial`, and for folders `.TARGET.RANDOM.lock` and `.TARGET.RANDOM.old` with it.

use std::ffi::OsStr;
use std::hash::{BuildHasher, RandomState};
use std::iter::repeat_with;
use std::path::Path;

use super::sha256_hex;

/// Length of the random part: 36¹² names.
const RANDOM: usize = 12;
/// Bytes of the target's name that stay: with everything else at most 135, and the shortest limit in use is 143 (eCryptfs).
const KEPT: usize = 96;

/// What a temporary is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// What is being written: a file, which locks itself, or a folder.
    Partial,
    /// The lock of a folder that is being written, and its mark.
    Lock,
    /// A folder that was set aside.
    Old,
}

impl Part {
    const ALL: [Self; 3] = [Self::Partial, Self::Lock, Self::Old];

    /// The name's ending.
    fn ending(self) -> &'static str {
        match self {
            Self::Partial => "partial",
            Self::Lock => "lock",
            Self::Old => "old",
        }
    }
}

/// The target's part of a temporary's name: its name, or the beginning of it and eight digits of the whole name's hash.
pub(super) fn tag(target: &OsStr) -> String {
    let shown = target.to_string_lossy();
    if shown.len() <= KEPT && target.to_str().is_some() {
        return shown.into_owned();
    }
    let end = (0..=KEPT.min(shown.len())).rev().find(|&k| shown.is_char_boundary(k)).unwrap_or(0);
    format!("{}~{}", &shown[..end], &sha256_hex(target.as_encoded_bytes())[..8])
}

/// A random part that nobody can foretell: the standard library's hash keys come from the operating system.
pub(super) fn random() -> String {
    let mut rng = fastrand::Rng::with_seed(RandomState::new().hash_one(RANDOM));
    repeat_with(|| if rng.u8(..36) < 26 { rng.lowercase() } else { rng.digit(10) }).take(RANDOM).collect()
}

/// The temporary's name.
pub(super) fn join(tag: &str, random: &str, part: Part) -> String {
    format!(".{tag}.{random}.{}", part.ending())
}

/// The random part and the kind of a temporary for the target with this `tag`; `None`: another name.
pub(super) fn parse<'a>(name: &'a str, tag: &str) -> Option<(&'a str, Part)> {
    let rest = name.strip_prefix('.')?.strip_prefix(tag)?.strip_prefix('.')?;
    let (random, ending) = rest.split_once('.')?;
    let part = Part::ALL.into_iter().find(|p| p.ending() == ending)?;
    is_random(random).then_some((random, part))
}

/// Whether `name` is a temporary's, of whatever target.
pub(super) fn is_temporary(name: &OsStr) -> bool {
    tag_of(name).is_some()
}

/// The name of the target whose temporary `name` is; `None`: no temporary, or one whose target had too long a name to be read from it.
pub(super) fn target(name: &OsStr) -> Option<&str> {
    tag_of(name).filter(|t| tag(OsStr::new(t)) == *t)
}

/// The target's part of a temporary's name.
fn tag_of(name: &OsStr) -> Option<&str> {
    let mut parts = name.to_str()?.rsplitn(3, '.');
    let (ending, random, rest) = (parts.next()?, parts.next()?, parts.next()?);
    let known = Part::ALL.into_iter().any(|p| p.ending() == ending) && is_random(random);
    rest.strip_prefix('.').filter(|tag| known && !tag.is_empty())
}

/// Whether `path` lies in a folder that is being written: what is in it is synced and published with it.
pub(super) fn in_temporary(path: &Path) -> bool {
    path.ancestors().skip(1).filter_map(Path::file_name).any(is_temporary)
}

fn is_random(text: &str) -> bool {
    text.len() == RANDOM && text.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_any_file_system_and_name_their_target() {
        let (long, other) = ("ä".repeat(127), format!("{}b", "ä".repeat(126)));
        for target in ["a", "a.b.csv", ".hidden", long.as_str()] {
            let (tag, random) = (tag(OsStr::new(target)), random());
            let name = join(&tag, &random, Part::Partial);
            assert!(name.len() <= 143, "{name}: {}", name.len());
            assert_eq!(parse(&name, &tag), Some((random.as_str(), Part::Partial)));
            assert!(is_temporary(OsStr::new(&name)), "{name}");
        }
        assert_ne!(tag(OsStr::new(&long)), tag(OsStr::new(&other)), "cut names are told apart");
    }

    #[test]
    fn other_names_are_not_ours() {
        for name in [
            ".a.12345-0.partial",
            ".a.partial",
            "a.abcdefghijkl.partial",
            ".a.abcdefghijk.partial",
            ".a.ABCDEFGHIJKL.old",
        ] {
            assert_eq!(parse(name, "a"), None, "{name}");
            assert!(!is_temporary(OsStr::new(name)), "{name}");
        }
        assert_eq!(parse(".a.b.abcdefghijkl.lock", "a"), None, "another target");
        assert!(
            in_temporary(Path::new("/x/.a.abcdefghijkl.partial/b/c"))
                && !in_temporary(Path::new("/x/.a.abcdefghijkl.partial"))
        );
    }

    #[test]
    fn random_parts_do_not_repeat() {
        let mut all: Vec<String> = repeat_with(random).take(10_000).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 10_000);
    }
}
