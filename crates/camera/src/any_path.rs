//! Paths of any bytes in what parent and child say to each other: JSON has no text for a name that is none.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The path's bytes; its text where the system's names are no bytes.
pub(crate) fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    #[cfg(unix)]
    return std::os::unix::ffi::OsStrExt::as_bytes(path.as_os_str()).serialize(to);
    #[cfg(not(unix))]
    path.serialize(to)
}

/// The path again.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
    #[cfg(unix)]
    return Vec::<u8>::deserialize(from)
        .map(|bytes| PathBuf::from(<std::ffi::OsString as std::os::unix::ffi::OsStringExt>::from_vec(bytes)));
    #[cfg(not(unix))]
    PathBuf::deserialize(from)
}

/// A path as a result shows it: what is no text in it is replaced.
pub(crate) fn shown<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(&path.display())
}
