//! Where ONNX Runtime's library may lie on this machine, and whether a library is one.
//!
//! The binding may be asked to load only once: in its release candidate 14 a load that fails leaves it with a library
//! handle that was never written. So every candidate is opened and asked for its version here first.

use std::ffi::{CStr, OsStr, c_char, c_void};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::{Deserialize, Serialize};

/// A place to try, in order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Candidate {
    /// The library: an absolute path, or a bare name for the system's loader.
    #[serde(with = "crate::any_path")]
    pub library: PathBuf,
    /// Who named it, for messages.
    pub origin: String,
}

impl Candidate {
    pub(crate) fn new(library: impl Into<PathBuf>, origin: &str) -> Self {
        Self { library: library.into(), origin: origin.into() }
    }
}

/// The places to try: `ORT_DYLIB_PATH`, beside the program that loads it, the loader's path, the active Python environment. What is found is no path that depends
/// on a working folder.
pub(crate) fn candidates(folder: &Path) -> impl Iterator<Item = Candidate> {
    let named = std::env::var_os("ORT_DYLIB_PATH").filter(|v| !v.is_empty()).map(PathBuf::from);
    // A bare name is the loader's to find.
    let whole = |p: PathBuf| if p.components().count() == 1 { p } else { std::path::absolute(&p).unwrap_or(p) };
    let named = named.map(|v| Candidate::new(whole(v), "ORT_DYLIB_PATH"));
    let beside: Vec<PathBuf> = loader_names().iter().map(|n| folder.join(n)).filter(|p| p.exists()).collect();
    // The binding takes a bare name from the program's folder where it lies there.
    let by_name = if beside.is_empty() { loader_names() } else { &[] };
    let beside = beside.into_iter().map(|library| Candidate::new(library, "the program's folder"));
    let loader = by_name.iter().map(|n| Candidate::new(n, "the loader's path"));
    let environment = std::env::var_os("VIRTUAL_ENV")
        .map(PathBuf::from)
        .into_iter()
        .flat_map(|root| site_packages(&root).into_iter().filter_map(|site| library_in(&site.join("onnxruntime"))));
    let environment = environment.map(|library| Candidate::new(library, "VIRTUAL_ENV"));
    named.into_iter().chain(beside).chain(loader).chain(environment)
}

/// The place to try last, because it starts a program: the package of the Python on the path.
pub(crate) fn python() -> Option<Candidate> {
    let library = python_package().and_then(|package| library_in(&package))?;
    Some(Candidate::new(library, "Python's onnxruntime package"))
}

/// The folder of the running program.
pub(crate) fn own_folder() -> PathBuf {
    std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_owned)).unwrap_or_default()
}

/// The version text of an ONNX Runtime library, for instance `1.24.0`; the error is a clause that says what it is instead.
///
/// The library stays loaded: it may have started threads, and the binding opens it again.
pub(crate) fn version_of(library: &Path) -> Result<String, String> {
    /// The start of `OrtApiBase` in ONNX Runtime's C header, unchanged since its first version.
    #[repr(C)]
    struct ApiBase {
        get_api: unsafe extern "system" fn(u32) -> *const c_void,
        get_version: unsafe extern "system" fn() -> *const c_char,
    }
    type GetApiBase = unsafe extern "system" fn() -> *const ApiBase;

    #[allow(unsafe_code, reason = "the C interface of a shared library; checked for null at each step")]
    // SAFETY: opening a library runs its initialisers, which is what the user asked for by naming or installing it. The
    // symbol's type is that of ONNX Runtime's C header, and the text it returns lives as long as the library.
    unsafe {
        let opened = libloading::Library::new(library).map_err(|_| "it cannot be loaded as a library")?;
        let opened = std::mem::ManuallyDrop::new(opened);
        let base = opened.get::<GetApiBase>(b"OrtGetApiBase").map_err(|_| "it is not ONNX Runtime")?;
        let base = base().as_ref().ok_or("it does not answer as ONNX Runtime")?;
        let text = (base.get_version)();
        if text.is_null() {
            return Err("it does not tell its version".into());
        }
        Ok(CStr::from_ptr(text).to_string_lossy().into_owned())
    }
}

/// Names under which the system's loader may know it.
fn loader_names() -> &'static [&'static str] {
    if cfg!(windows) {
        // Windows ships an old `onnxruntime.dll` of its own; only named libraries are taken there.
        &[]
    } else if cfg!(target_os = "macos") {
        &["libonnxruntime.dylib"]
    } else {
        &["libonnxruntime.so", "libonnxruntime.so.1"]
    }
}

/// The `site-packages` folders of a Python environment.
fn site_packages(root: &Path) -> Vec<PathBuf> {
    if cfg!(windows) {
        return vec![root.join("Lib").join("site-packages")];
    }
    let Ok(entries) = std::fs::read_dir(root.join("lib")) else { return Vec::new() };
    let mut found: Vec<PathBuf> = entries
        .flatten()
        .filter(|e| e.file_name().to_string_lossy().starts_with("python"))
        .map(|e| e.path().join("site-packages"))
        .collect();
    found.sort();
    found
}

/// The library in Python's `onnxruntime` package.
fn library_in(package: &Path) -> Option<PathBuf> {
    let folder = package.join("capi");
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(&folder).ok()?.flatten().map(|e| e.path()).filter(|p| is_library(p.file_name())).collect();
    found.sort();
    found.pop()
}

fn is_library(name: Option<&OsStr>) -> bool {
    let Some(name) = name.and_then(OsStr::to_str) else { return false };
    name == "onnxruntime.dll"
        || name.starts_with("libonnxruntime.so")
        || (name.starts_with("libonnxruntime.") && name.ends_with(".dylib"))
}

/// The folder of Python's `onnxruntime` package, without importing it.
fn python_package() -> Option<PathBuf> {
    // The empty entry is the working folder, where a stranger's files may lie.
    let script = "import sys\nsys.path = [p for p in sys.path if p]\nimport importlib.util as u\n\
                  s = u.find_spec('onnxruntime')\nprint(s.submodule_search_locations[0] if s else '')";
    let python = if cfg!(windows) { "python" } else { "python3" };
    let output = Command::new(python).args(["-c", script]).stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let path = PathBuf::from(String::from_utf8(output.stdout).ok()?.trim());
    (output.status.success() && path.is_absolute()).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_is_found_in_a_python_environment() {
        let root = tempfile::tempdir().expect("temporary folder");
        let capi = if cfg!(windows) { "Lib/site-packages" } else { "lib/python3.11/site-packages" };
        let capi = root.path().join(capi).join("onnxruntime").join("capi");
        std::fs::create_dir_all(&capi).expect("creates");
        for name in ["libonnxruntime_providers_shared.so", "libonnxruntime.so.1.31.1", "_pybind_state.py"] {
            std::fs::write(capi.join(name), "").expect("writes");
        }
        let found: Vec<PathBuf> =
            site_packages(root.path()).iter().filter_map(|site| library_in(&site.join("onnxruntime"))).collect();
        assert_eq!(found, [capi.join("libonnxruntime.so.1.31.1")]);
        assert!(library_in(root.path()).is_none());
    }

    #[test]
    fn what_is_no_onnx_runtime_has_no_version() {
        let root = tempfile::tempdir().expect("temporary folder");
        let text = root.path().join("libonnxruntime.so");
        std::fs::write(&text, "text").expect("writes");
        assert!(version_of(&text).is_err() && version_of(&root.path().join("missing.so")).is_err());
        // Every Unix system has a C library by one of these names.
        for other in ["libc.so.6", "libSystem.dylib", "kernel32.dll"] {
            let reason = version_of(Path::new(other)).expect_err("not ONNX Runtime");
            assert!(reason.contains("cannot be loaded") || reason.contains("not ONNX Runtime"), "{reason}");
        }
    }
}
