//! Where work runs: a pool of this process, with the interpreter free, a look for Ctrl-C every few hundredths of a second, and no panic that Python
//! would see.
//!
//! The pool belongs to one process: threads do not survive a fork, so that a forked worker makes one of its own, of one thread. Where `torchrun` has started several processes each takes its share of the cores. The table of pools is locked
//! only by threads that hold the interpreter, which a fork holds as well: no child finds it locked. Work of several Python threads takes turns, so that
//! Ctrl-C ends what it was meant for.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, Once, OnceLock, PoisonError};
use std::time::Duration;

use isoplanat::Result;
use isoplanat::stop::Token;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::errors::{raised, refused};

/// How often Ctrl-C is looked for.
const LOOK: Duration = Duration::from_millis(40);
/// Threads at most.
const MOST: usize = 1024;

/// The process that imported the module: any other is a fork of it.
static IMPORTED: OnceLock<u32> = OnceLock::new();
/// The pool, with its process.
static OWN: Mutex<Option<(u32, Arc<Threads>)>> = Mutex::new(None);
/// Where the last panic was.
static FAULT: Mutex<String> = Mutex::new(String::new());

struct Threads {
    pool: ThreadPool,
    token: Token,
    turn: Turn,
}

/// One piece of work at a time.
#[derive(Default)]
struct Turn {
    taken: Mutex<bool>,
    free: Condvar,
}

struct Held<'a>(&'a Turn);

impl Turn {
    fn take(&self) -> PyResult<Held<'_>> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        while *taken {
            taken = self.free.wait_timeout(taken, LOOK).unwrap_or_else(PoisonError::into_inner).0;
            if *taken {
                drop(taken);
                signals()?;
                taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
            }
        }
        *taken = true;
        Ok(Held(self))
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        *self.0.taken.lock().unwrap_or_else(PoisonError::into_inner) = false;
        self.0.free.notify_one();
    }
}

/// What signals that came since ask for.
fn signals() -> PyResult<()> {
    Python::try_attach(|py| py.check_signals()).unwrap_or(Ok(()))
}

/// Notes the process, and keeps panics from being printed: their text is in the exception.
pub(crate) fn start() {
    static HOOK: Once = Once::new();
    IMPORTED.get_or_init(std::process::id);
    HOOK.call_once(|| {
        std::panic::set_hook(Box::new(|info| {
            let place = info.location().map_or(String::new(), |l| format!(" ({}:{})", l.file(), l.line()));
            *FAULT.lock().unwrap_or_else(PoisonError::into_inner) = place;
        }));
    });
}

/// Threads of one of the processes that `torchrun` started on a machine: its share of the cores. 0: nobody says that there are several, or
/// `RAYON_NUM_THREADS` says how many.
fn share() -> usize {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.trim().parse::<usize>().ok());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    match (number("RAYON_NUM_THREADS").filter(|n| *n > 0), number("LOCAL_WORLD_SIZE").filter(|n| *n > 1)) {
        (None, Some(processes)) => (cores / processes).max(1),
        _ => 0,
    }
}

/// `threads` of them; 0: as many as `RAYON_NUM_THREADS` or the machine says.
fn made(threads: usize) -> PyResult<Arc<Threads>> {
    let token = Token::default();
    let of_thread = token.clone();
    let builder = ThreadPoolBuilder::new().num_threads(threads).thread_name(|k| format!("isoplanat-{k}"));
    let pool = builder.start_handler(move |_| of_thread.attach()).build();
    let pool = pool.map_err(|e| PyRuntimeError::new_err(format!("threads could not be started: {e}")))?;
    Ok(Arc::new(Threads { pool, token, turn: Turn::default() }))
}

/// Puts a pool of this process in the place of what there was.
fn put(own: &mut Option<(u32, Arc<Threads>)>, threads: Arc<Threads>) {
    let pid = std::process::id();
    if let Some((of, before)) = own.replace((pid, threads))
        && of != pid
    {
        // The threads of the process that this one was forked from: they are not here to be ended.
        std::mem::forget(before);
    }
}

/// The pool of this process. `_py`: whoever asks holds the interpreter.
fn own(_py: Python<'_>) -> PyResult<Arc<Threads>> {
    let pid = std::process::id();
    let mut own = OWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((of, threads)) = &*own
        && *of == pid
    {
        return Ok(threads.clone());
    }
    let forked = IMPORTED.get().is_some_and(|first| *first != pid);
    let threads = made(if forked { 1 } else { share() })?;
    put(&mut own, threads.clone());
    Ok(threads)
}

/// Lets `count` threads work in this process.
///
/// Without it there are as many as RAYON_NUM_THREADS or the machine says, and one in a forked process. Results do not depend on it.
///
/// Raises ValueError for a number that is not 1 to 1024.
#[pyfunction]
pub(crate) fn set_threads(count: usize) -> PyResult<()> {
    if !(1..=MOST).contains(&count) {
        return Err(refused("count", count, format!("1 to {MOST} threads")));
    }
    let threads = made(count)?;
    put(&mut OWN.lock().unwrap_or_else(PoisonError::into_inner), threads);
    Ok(())
}

/// How many threads work in this process.
#[pyfunction]
pub(crate) fn threads(py: Python<'_>) -> PyResult<usize> {
    Ok(own(py)?.pool.current_num_threads())
}

fn fault(payload: &(dyn Any + Send)) -> PyErr {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_default();
    let place = FAULT.lock().unwrap_or_else(PoisonError::into_inner).clone();
    PyRuntimeError::new_err(format!("internal error: {text}{place}; please report it"))
}

/// What `work` makes on the threads of this process, the interpreter free meanwhile.
pub(crate) fn work<R: Send>(py: Python<'_>, work: impl FnOnce() -> Result<R> + Send) -> PyResult<R> {
    let threads = own(py)?;
    py.detach(|| threads.run(work))
}

impl Threads {
    fn run<R: Send>(&self, work: impl FnOnce() -> Result<R> + Send) -> PyResult<R> {
        if self.pool.current_thread_index().is_some() {
            // It would wait for itself.
            return Err(PyRuntimeError::new_err("isoplanat is at work: a function that it calls must not call it"));
        }
        let _turn = self.turn.take()?;
        self.token.reset();
        let (mut made, mut signal) = (None, None);
        let (done, waits) = sync_channel(1);
        self.pool.in_place_scope(|scope| {
            let (made, token) = (&mut made, &self.token);
            scope.spawn(move |_| {
                *made = Some(catch_unwind(AssertUnwindSafe(|| token.run(work))));
                // Whoever waits may have gone.
                let _ = done.send(());
            });
            while waits.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                if signal.is_none()
                    && let Err(asked) = signals()
                {
                    signal = Some(asked);
                    token.ask();
                }
            }
        });
        if let Some(signal) = signal {
            return Err(signal);
        }
        match made {
            Some(Ok(Ok(result))) => result.map_err(raised),
            Some(Ok(Err(ended))) => Err(raised(ended)),
            Some(Err(payload)) => Err(fault(&*payload)),
            None => Err(PyRuntimeError::new_err("internal error: work that was not done; please report it")),
        }
    }
}

/// What `short` makes on this thread: work of microseconds that uses no pool.
pub(crate) fn here<R>(short: impl FnOnce() -> Result<R>) -> PyResult<R> {
    match catch_unwind(AssertUnwindSafe(short)) {
        Ok(result) => result.map_err(raised),
        Err(payload) => Err(fault(&*payload)),
    }
}
