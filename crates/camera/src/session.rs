//! Inference; the only place that names the two runtimes.
//!
//! ONNX Runtime is loaded as a shared library when one is found (see `crate::onnxruntime`); without it the
//! model runs in tract, which is part of this program, and [`Session::runtime`] says so and why. Both give the same
//! picture to 1e-5.

mod model;

use std::collections::{BTreeMap, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use ndarray::{Array4, ArrayView4};
use serde::{Deserialize, Serialize};
use tract_onnx::prelude::{
    Framework, InferenceModelExt, IntoRunnable, RunnableModel, Tensor, TypedFact, TypedOp, tvec,
};

use crate::lock;
use crate::onnxruntime::{Candidate, candidates, own_folder, python, version_of};
use isoplanat_base::error::{Error, Result};

/// How often slower tract was than ONNX Runtime, per thread, on U-Nets of three scales (32 to 128 channels).
const TRACT_SLOWDOWN: &str = "3 to 4";

/// Which runtime to take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Choice {
    /// ONNX Runtime where there is one, else tract.
    #[default]
    Best,
    /// ONNX Runtime or an error.
    OnnxRuntime,
    /// tract.
    Tract,
}

/// How to run a model.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// ONNX Runtime's library, if the user names one; it is then an error if it cannot be used.
    pub onnxruntime: Option<PathBuf>,
    /// Threads; 0 is one for each core.
    pub threads: usize,
    /// Which runtime.
    pub choice: Choice,
}

impl Options {
    /// How many threads those are.
    pub(crate) fn thread_count(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            n => n,
        }
    }
}

/// The runtime a session uses.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Runtime {
    /// ONNX Runtime.
    OnnxRuntime {
        /// Its version, for instance `1.24.0`.
        version: String,
        /// The library.
        #[serde(serialize_with = "crate::any_path::shown")]
        library: PathBuf,
        /// Who named it.
        origin: String,
    },
    /// tract, compiled in.
    Tract {
        /// Why not ONNX Runtime; empty where tract was asked for.
        reason: String,
    },
}

impl Runtime {
    /// Its name and version, without places of this machine.
    pub fn name(&self) -> String {
        match self {
            Self::OnnxRuntime { version, .. } => format!("ONNX Runtime {version}"),
            Self::Tract { .. } => "tract".to_owned(),
        }
    }
}

impl std::fmt::Display for Runtime {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OnnxRuntime { version, library, origin } => {
                write!(f, "ONNX Runtime {version} ({}, from {origin})", library.display())
            }
            Self::Tract { reason } if reason.is_empty() => write!(f, "tract"),
            Self::Tract { reason } => write!(
                f,
                "tract, about {TRACT_SLOWDOWN} times slower than ONNX Runtime, because {reason}; \
                 `pip install onnxruntime` or --onnxruntime brings the faster one"
            ),
        }
    }
}

type Plan = Arc<RunnableModel<TypedFact, Box<dyn TypedOp>>>;
type Proto = tract_onnx::pb::ModelProto;

enum Engine {
    /// The session's `run` must not be entered twice.
    OnnxRuntime(Mutex<ort::session::Session>),
    /// One plan for each shape seen.
    Tract { proto: Box<Proto>, plans: Mutex<HashMap<[usize; 4], Plan>> },
}

/// A model ready to run.
pub struct Session {
    /// What errors call the model.
    file: PathBuf,
    engine: Engine,
    runtime: Runtime,
    metadata: BTreeMap<String, String>,
    threads: usize,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("runtime", &self.runtime).field("threads", &self.threads).finish()
    }
}

/// A runtime that is found, its library loaded: a model may be opened in it, and nothing of the file system is needed for that any more.
pub(crate) struct Prepared {
    /// Whether ONNX Runtime is there, else why not.
    onnxruntime: std::result::Result<(), String>,
    options: Options,
}

impl Prepared {
    /// The runtime that the options ask for, looked for at all places.
    pub(crate) fn new(options: &Options) -> Self {
        let python = std::iter::once_with(python).flatten();
        Self::with(options, candidates(&own_folder()).chain(python))
    }

    /// The runtime that the options ask for, from the first of the `candidates` where they name none.
    pub(crate) fn with(options: &Options, candidates: impl Iterator<Item = Candidate>) -> Self {
        let onnxruntime = match options.choice {
            Choice::Tract => Err(String::new()),
            _ => load(options.onnxruntime.as_deref(), candidates),
        };
        Self { onnxruntime, options: options.clone() }
    }

    /// Opens an ONNX model given as bytes; `file` names it in messages.
    ///
    /// # Errors
    /// No ONNX model with one image in and one out, a runtime that refuses it, or a named library that cannot be used.
    pub(crate) fn open(self, bytes: &[u8], file: &Path) -> Result<Session> {
        let Self { onnxruntime, options } = self;
        let proto = model::read(bytes, file)?;
        let metadata = model::metadata(&proto);
        let (threads, named) = (options.thread_count(), file.to_owned());
        match onnxruntime.and_then(|()| environment()) {
            Ok((Library { version, library, origin }, environment)) => {
                let session = guarded(|| onnxruntime_session(&environment, &model::bytes(&proto), threads))
                    .map_err(|e| model::bad(file, &e))?;
                let runtime = Runtime::OnnxRuntime { version, library, origin };
                Ok(Session {
                    file: named,
                    engine: Engine::OnnxRuntime(Mutex::new(session)),
                    runtime,
                    metadata,
                    threads,
                })
            }
            Err(reason) if options.onnxruntime.is_some() && options.choice != Choice::Tract => {
                let path = options.onnxruntime.as_deref().unwrap_or(file).display().to_string();
                let allowed = format!(
                    "ONNX Runtime's shared library, 1.{} or newer; without the option another one is looked for",
                    ort::MINOR_VERSION
                );
                Err(Error::bad(path, "--onnxruntime", reason, allowed))
            }
            Err(reason) if options.choice == Choice::OnnxRuntime => {
                Err(Error::bad("ONNX Runtime", "library", reason, "`pip install onnxruntime`, or name the library"))
            }
            Err(reason) => {
                let engine = Engine::Tract { proto: Box::new(proto), plans: Mutex::default() };
                Ok(Session { file: named, engine, runtime: Runtime::Tract { reason }, metadata, threads })
            }
        }
    }
}

impl Session {
    /// Opens an ONNX model given as bytes in the runtime that the options ask for; `file` names it in messages.
    ///
    /// # Errors
    /// As `Prepared::open`.
    pub fn open(model: &[u8], file: &Path, options: &Options) -> Result<Self> {
        Prepared::new(options).open(model, file)
    }

    /// The runtime in use; its text says why, and what it costs.
    pub fn runtime(&self) -> &Runtime {
        &self.runtime
    }

    /// The entries the model's writer left in the file.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// How many tiles to run at a time: ONNX Runtime uses its threads within a tile, tract one thread a tile.
    pub(crate) fn parallel_tiles(&self) -> usize {
        match self.engine {
            Engine::OnnxRuntime(_) => 1,
            Engine::Tract { .. } => self.threads,
        }
    }

    /// Runs one batch `[batch, channel, row, col]`.
    ///
    /// # Errors
    /// What the runtime refuses, for instance a size the model cannot take.
    pub fn run(&self, tile: ArrayView4<'_, f32>) -> Result<Array4<f32>> {
        let allowed = "a model that takes and returns an image";
        let failed = |e: String| Error::bad(self.file.display().to_string(), "inference", e, allowed);
        let tile = tile.as_standard_layout();
        match &self.engine {
            Engine::OnnxRuntime(session) => {
                guarded(|| run_onnxruntime(&mut lock(session), tile.view())).map_err(failed)
            }
            Engine::Tract { proto, plans } => guarded(|| {
                let (n, c, h, w) = tile.dim();
                let plan = plan_for(proto, plans, [n, c, h, w])?;
                run_tract(&plan, tile.view())
            })
            .map_err(failed),
        }
    }
}

/// The metadata of a model that need not be run.
///
/// # Errors
/// Bytes that are no ONNX model with one image in and one out.
pub fn metadata(bytes: &[u8], file: &Path) -> Result<BTreeMap<String, String>> {
    Ok(model::metadata(&model::read(bytes, file)?))
}

/// The bytes that a runtime is given in place of a model's own: all that was checked, and nothing beside it.
///
/// # Errors
/// As [`metadata`].
pub fn rewritten(bytes: &[u8], file: &Path) -> Result<Vec<u8>> {
    Ok(model::bytes(&model::read(bytes, file)?))
}

/// Runs what may panic inside a runtime; errors become their first line.
fn guarded<T>(work: impl FnOnce() -> std::result::Result<T, String>) -> std::result::Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(message)) => Err(message.lines().next().unwrap_or_default().chars().take(300).collect()),
        Err(_) => Err("the runtime gave up".into()),
    }
}

/// ONNX Runtime's library, loaded.
#[derive(Clone)]
struct Library {
    version: String,
    library: PathBuf,
    origin: String,
}

/// One library and one environment for the whole process.
enum Loading {
    NotTried,
    /// The library is loaded, and nothing of it was run but the question for its version.
    Library(Library, Box<ort::environment::EnvironmentBuilder>),
    Done(Library, ort::environment::Environment),
    /// The binding itself failed; it must not be called again (see [`crate::onnxruntime`]).
    Broken(String),
}

static LOADING: Mutex<Loading> = Mutex::new(Loading::NotTried);

/// Loads the library that is named, or the first of the candidates that is one, if none is loaded; the error is a clause that says why there is none.
fn load(named: Option<&Path>, mut candidates: impl Iterator<Item = Candidate>) -> std::result::Result<(), String> {
    let named = named.map(std::path::absolute).transpose().map_err(|e| e.to_string())?;
    let mut loading = lock(&LOADING);
    match &*loading {
        Loading::Library(loaded, _) | Loading::Done(loaded, _) => {
            return match named {
                Some(path) if path != loaded.library => {
                    Err(format!("{} is loaded already, and a process holds one", loaded.library.display()))
                }
                _ => Ok(()),
            };
        }
        Loading::Broken(reason) => return Err(reason.clone()),
        Loading::NotTried => {}
    }
    let mut failures = Vec::new();
    let mut usable = |candidate: Candidate| match version_of(&candidate.library).and_then(compatible) {
        Ok(version) => Some((candidate, version)),
        Err(reason) => {
            // That the loader knows no library by a bare name is the usual case, not news.
            let bare = candidate.library.components().count() == 1;
            if !(bare && reason.contains("cannot be loaded")) {
                failures.push(match named {
                    Some(_) => reason,
                    None => format!("{} ({}): {reason}", candidate.library.display(), candidate.origin),
                });
            }
            None
        }
    };
    let found = match named.clone() {
        Some(library) => usable(Candidate::new(library, "--onnxruntime")),
        None => candidates.find_map(usable),
    };
    let Some((Candidate { library, origin }, version)) = found else {
        return Err(if failures.is_empty() { "no library was found".into() } else { failures.join("; ") });
    };
    match guarded(|| ort::init_from(&library).map_err(|e| e.to_string())) {
        Ok(builder) => {
            *loading = Loading::Library(Library { version, library, origin }, Box::new(builder));
            Ok(())
        }
        Err(reason) => {
            let reason = format!("{} ({origin}): {reason}", library.display());
            *loading = Loading::Broken(reason.clone());
            Err(reason)
        }
    }
}

/// The process's environment, made now if need be in the library that [`load`] loaded: with it the runtime starts to look about and to make threads. The error
/// is a clause that says why there is none.
fn environment() -> std::result::Result<(Library, ort::environment::Environment), String> {
    let mut loading = lock(&LOADING);
    match std::mem::replace(&mut *loading, Loading::NotTried) {
        Loading::Library(library, builder) => {
            let build = || builder.with_name("isoplanat").with_telemetry(false).build().map_err(|e| e.to_string());
            *loading = match guarded(build) {
                Ok(environment) => Loading::Done(library, environment),
                Err(reason) => Loading::Broken(format!("{} ({}): {reason}", library.library.display(), library.origin)),
            };
        }
        before => *loading = before,
    }
    match &*loading {
        Loading::Done(library, environment) => Ok((library.clone(), environment.clone())),
        Loading::Broken(reason) => Err(reason.clone()),
        Loading::NotTried | Loading::Library(..) => Err("no library is loaded".into()),
    }
}

/// The version if the binding can use it, which means its minor number or a later one.
fn compatible(version: String) -> std::result::Result<String, String> {
    let mut numbers = version.split('.').map(|n| n.parse::<u32>().unwrap_or(0));
    match (numbers.next(), numbers.next()) {
        (Some(1), Some(minor)) if minor >= ort::MINOR_VERSION => Ok(version),
        _ => Err(format!("version {version} is too old or unknown; 1.{} or newer is needed", ort::MINOR_VERSION)),
    }
}

fn onnxruntime_session(
    environment: &ort::environment::Environment,
    model: &[u8],
    threads: usize,
) -> std::result::Result<ort::session::Session, String> {
    use ort::session::builder::GraphOptimizationLevel;
    let session = ort::session::Session::builder(environment)
        .map_err(|e| e.to_string())?
        // Chained: a cloned builder loses the number of threads.
        .with_optimization_level(GraphOptimizationLevel::All)
        .map_err(|e| e.to_string())?
        .with_intra_threads(threads)
        .map_err(|e| e.to_string())?
        .commit_from_memory(model);
    session.map_err(|e| e.to_string())
}

fn run_onnxruntime(
    session: &mut ort::session::Session,
    tile: ArrayView4<'_, f32>,
) -> std::result::Result<Array4<f32>, String> {
    let input = ort::value::TensorRef::from_array_view(tile).map_err(|e| e.to_string())?;
    let outputs = session.run(ort::inputs![input]).map_err(|e| e.to_string())?;
    let output = outputs[0].try_extract_array::<f32>().map_err(|e| e.to_string())?;
    let output = output.into_dimensionality::<ndarray::Ix4>().map_err(|e| e.to_string())?;
    Ok(output.to_owned())
}

/// The plan for one concrete shape; tract compiles neither transposed convolutions nor fast kernels for unknown sizes.
fn plan_for(
    proto: &Proto,
    plans: &Mutex<HashMap<[usize; 4], Plan>>,
    shape: [usize; 4],
) -> std::result::Result<Plan, String> {
    use tract_onnx::prelude::DatumExt;
    // Held while compiling, so that parallel tiles wait for one plan and do not each make their own.
    let mut plans = lock(plans);
    if let Some(plan) = plans.get(&shape) {
        return Ok(plan.clone());
    }
    let plan = tract_onnx::onnx()
        .with_ignore_output_shapes(true)
        .model_for_proto_model(proto)
        .and_then(|m| m.with_input_fact(0, f32::fact(shape).into()))
        .and_then(|m| m.into_optimized())
        .and_then(|m| m.into_runnable())
        .map_err(|e| format!("{e:#}"))?;
    plans.insert(shape, plan.clone());
    Ok(plan)
}

fn run_tract(plan: &Plan, tile: ArrayView4<'_, f32>) -> std::result::Result<Array4<f32>, String> {
    let samples = tile.as_slice().ok_or("an input with gaps")?;
    let input = Tensor::from_shape(tile.shape(), samples).map_err(|e| e.to_string())?;
    let outputs = plan.run(tvec!(input.into())).map_err(|e| format!("{e:#}"))?;
    let output = outputs.first().ok_or("no output")?;
    let shape: [usize; 4] = output.shape().try_into().map_err(|_| "an output that is no image")?;
    let view = output.to_plain_array_view::<f32>().map_err(|e| e.to_string())?;
    Array4::from_shape_vec(shape, view.iter().copied().collect()).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_model;

    fn tile(rows: usize, columns: usize) -> Array4<f32> {
        let rng = &mut fastrand::Rng::with_seed(11);
        Array4::from_shape_fn((1, 3, rows, columns), |_| rng.f32())
    }

    fn open(model: &[u8], choice: Choice) -> Result<Session> {
        Session::open(model, Path::new("model.onnx"), &Options { choice, threads: 2, ..Options::default() })
    }

    /// Operators that the exporter does not write, a loop say, are refused before any runtime sees them.
    #[test]
    fn foreign_operators_are_refused() {
        let model = test_model::unet(4, 3, &[]);
        let (from, to) = (b"MaxPool", b"LoopAll");
        let mut changed = model.clone();
        let at = model.windows(from.len()).position(|w| w == from).expect("pools");
        changed[at..at + to.len()].copy_from_slice(to);
        let error = open(&changed, Choice::Tract).expect_err("refused").to_string();
        assert!(error.contains("operator") && error.contains("LoopAll") && error.contains("MaxPool"), "{error}");
    }

    /// ONNX Runtime, or `None` after a visible message; a failure where the environment requires it.
    fn with_onnxruntime(model: &[u8]) -> Option<Session> {
        match open(model, Choice::OnnxRuntime) {
            Ok(session) => Some(session),
            Err(error) if std::env::var_os("ISOPLANAT_REQUIRE_ONNXRUNTIME").is_some_and(|v| v == "1") => {
                panic!("ONNX Runtime is required here: {error}")
            }
            Err(error) => {
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    #[test]
    fn tract_computes_what_the_graph_says() {
        // One 1×1 convolution: y = W x + b.
        let session = open(
            &test_model::pointwise([[0.5, 0.1, 0.0], [0.0, 2.0, 0.0], [0.3, 0.0, -1.0]], [0.0, 0.25, 1.0]),
            Choice::Tract,
        )
        .expect("opens");
        let x = tile(8, 12);
        let y = session.run(x.view()).expect("runs");
        for i in 0..8 {
            for j in 0..12 {
                let [r, g, b] = [0, 1, 2].map(|c| x[[0, c, i, j]]);
                let expected = [0.5 * r + 0.1 * g, 2.0 * g + 0.25, 0.3 * r - b + 1.0];
                for (c, e) in expected.iter().enumerate() {
                    assert!((y[[0, c, i, j]] - e).abs() < 1e-6);
                }
            }
        }
        assert_eq!(session.runtime().to_string(), "tract");
        assert_eq!(session.parallel_tiles(), 2);
    }

    #[test]
    fn both_runtimes_agree() {
        let model = test_model::unet(8, 5, &[]);
        let Some(fast) = with_onnxruntime(&model) else { return };
        let slow = open(&model, Choice::Tract).expect("opens");
        for (rows, columns) in [(32, 32), (48, 64)] {
            let x = tile(rows, columns);
            let (a, b) = (fast.run(x.view()).expect("runs"), slow.run(x.view()).expect("runs"));
            assert_eq!(a.dim(), x.dim());
            let worst = (&a - &b).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!(worst <= 1e-5, "{rows}×{columns}: {worst}");
        }
        assert_eq!(fast.parallel_tiles(), 1);
        assert!(fast.run(tile(32, 32).slice(ndarray::s![.., ..2, .., ..])).is_err(), "two channels");
    }

    #[test]
    fn metadata_is_read_whatever_runs_it() {
        let entries = [("isoplanat.schema", "1"), ("isoplanat.name", "Täst")];
        let model = test_model::unet(4, 1, &entries);
        let expected: BTreeMap<String, String> = entries.iter().map(|(k, v)| ((*k).into(), (*v).into())).collect();
        assert_eq!(metadata(&model, Path::new("m")).expect("reads"), expected);
        assert_eq!(open(&model, Choice::Tract).expect("opens").metadata(), &expected);
    }

    #[test]
    fn what_is_no_model_is_refused() {
        for bytes in [&b""[..], b"not a model", &[0x08, 0x09]] {
            for choice in [Choice::Tract, Choice::Best] {
                assert_eq!(open(bytes, choice).expect_err("refused").exit_code(), 2);
            }
        }
    }

    #[test]
    fn a_named_library_that_is_none_is_an_error_and_no_panic() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("libonnxruntime.so");
        let model = test_model::unet(4, 1, &[]);
        let options = Options { onnxruntime: Some(path.clone()), ..Options::default() };
        assert_eq!(Session::open(&model, Path::new("m"), &options).expect_err("missing").exit_code(), 2);
        std::fs::write(&path, "no library").expect("writes");
        let error = Session::open(&model, Path::new("m"), &options).expect_err("no library").to_string();
        assert!(error.contains("libonnxruntime.so") && error.contains("--onnxruntime"), "{error}");
    }

    #[test]
    fn old_libraries_are_refused_by_version() {
        assert!(compatible("1.31.1".into()).is_ok() && compatible("1.24.0".into()).is_ok());
        for old in ["1.23.2", "1.9", "0.99.0", "2.0.0", "", "1.x"] {
            assert!(compatible(old.into()).is_err(), "{old}");
        }
    }

    #[test]
    fn the_fallback_says_why_and_what_it_costs() {
        let text = Runtime::Tract { reason: "no library was found".into() }.to_string();
        assert!(text.contains("times slower") && text.contains("no library was found"), "{text}");
    }
}
