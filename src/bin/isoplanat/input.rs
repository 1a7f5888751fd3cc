//! What commands read: texts from a file or from stdin, and the lens behind `LENS`.

use std::io::Read;
use std::path::Path;

use isoplanat::lens::{Lens, builtin};
use isoplanat::{Error, Result};

/// The lens named on the command line: a TOML file, or a shipped lens by its bare name.
///
/// # Errors
/// A file that cannot be read or is no lens; where neither a file nor a shipped lens has that name, both are said.
pub(crate) fn lens(name_or_path: &str) -> Result<Lens> {
    let path = Path::new(name_or_path);
    let bare = path.extension().is_none() && path.components().count() == 1;
    if bare && !path.exists() { builtin::lens(name_or_path) } else { builtin::lens_or_file(name_or_path) }
}

/// The same error with the argument that named the lens in place of the lens's own name.
pub(crate) fn in_lens(error: Error, lens: &Lens, argument: &str) -> Error {
    match error {
        Error::BadInput { file, place, found, allowed } if file == lens.name => {
            Error::bad(argument, place, found, allowed)
        }
        other => other,
    }
}

/// The text of the file at `path`, or of stdin where that is `-`, with the name errors give it.
pub(crate) fn text(path: &Path) -> Result<(String, String)> {
    if path == Path::new("-") {
        let mut text = String::new();
        let name = Path::new("<stdin>");
        std::io::stdin().read_to_string(&mut text).map_err(|e| Error::reading(name, e))?;
        return Ok((text, name.display().to_string()));
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::reading(path, e))?;
    Ok((text, path.display().to_string()))
}
