//! A network in a child process that is held to a memory and a time limit and sees no file, as [`super::raw_process`] decodes files: a model that asks for more
//! memory than there is, or never ends, is one sentence and not the end of the program.
//!
//! The helper program is started with `COMMAND`. The child is told on its standard input which runtime to load, loads it, enters its sandbox, and says so; only
//! then it is given the model's bytes. It answers with one line, and then answers tiles, as many at a time as its runtime takes. Numbers are in this machine's byte
//! order.

mod wire;

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use ndarray::{Array4, ArrayView4};

use super::child::{Confinement, Helper, Limits, Start};
use super::lock;
use super::onnxruntime::{self, Candidate};
use super::session::{Options, Prepared, Runtime, Session};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::{GIB, Limit, words as in_words};
use isoplanat_base::threads;
use wire::{
    Answer, Asked, Opened, Said, line, line_of, of_input, read_answer, read_tile, words, write_answer, write_tile,
};

/// First argument that makes the program a child that runs a network.
pub(crate) const COMMAND: &str = "run-network-child";

/// Address space where nobody says more: so much, and so much more for each thread; no more than the machine has.
const MEMORY: u64 = 8 * GIB;
const MEMORY_A_THREAD: u64 = GIB;
/// Time for a tile, and for opening a model.
const TIME: Duration = Duration::from_secs(600);

/// How a network is run apart.
#[derive(Clone, Debug)]
pub struct Apart {
    /// The program that becomes the child.
    pub helper: Helper,
    /// Most address space, bytes; `None`: 8 GiB and one more for each thread, or what the machine has left where that is less.
    pub memory_bytes: Option<u64>,
    /// Most time for a tile, and for opening a model.
    pub time: Duration,
    /// What a refusal says of how the limits are set.
    pub hint: &'static str,
}

impl Apart {
    /// As a child of `helper`, within what the machine has and at most 8 GiB of address space and one more for each thread, ten minutes a tile.
    pub fn new(helper: Helper) -> Self {
        Self { helper, memory_bytes: None, time: TIME, hint: "" }
    }
}

/// A network that runs: in this process, or apart.
#[derive(Debug)]
pub enum Network {
    /// Here.
    Here(Session),
    /// In a child.
    Apart(Process),
}

impl Network {
    /// Opens a model here, or apart where that is asked for; `file` names it in messages. On Linux a child lives as long as the thread that opened it.
    ///
    /// # Errors
    /// As [`Session::open`]; a child that could not be started, or broke off.
    pub(crate) fn open(model: &[u8], file: &Path, options: &Options, apart: Option<&Apart>) -> Result<Self> {
        match apart {
            None => Session::open(model, file, options).map(Self::Here),
            Some(apart) => Process::open(model, file, options, apart).map(Self::Apart),
        }
    }

    /// Ready for the next capture: a child that broke off is started anew.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(crate) fn ready(&self) -> Result<()> {
        match self {
            Self::Here(_) => Ok(()),
            Self::Apart(process) => process.ready(),
        }
    }

    /// The runtime in use.
    pub fn runtime(&self) -> &Runtime {
        match self {
            Self::Here(session) => session.runtime(),
            Self::Apart(process) => &process.opened.runtime,
        }
    }

    /// What the child is held by; `None` for a network that runs here.
    pub(crate) fn confinement(&self) -> Option<Confinement> {
        match self {
            Self::Here(_) => None,
            Self::Apart(process) => Some(lock(&process.live).confinement),
        }
    }

    /// How many tiles the runtime works on at a time.
    pub(crate) fn workers(&self) -> usize {
        match self {
            Self::Here(session) => session.parallel_tiles(),
            Self::Apart(process) => process.opened.workers,
        }
    }

    /// How many tiles to ask for at a time: one more where they have a way to go, so that the runtime need not wait for the next.
    pub(crate) fn parallel_tiles(&self) -> usize {
        match self {
            Self::Here(session) => session.parallel_tiles(),
            Self::Apart(process) => process.opened.workers + 1,
        }
    }

    /// Runs one batch `[batch, channel, row, col]`; its result, and the time within the runtime.
    ///
    /// # Errors
    /// As [`Session::run`]; a child that broke off or had not answered in time.
    pub fn run(&self, tile: ArrayView4<'_, f32>) -> Result<(Array4<f32>, Duration)> {
        let started = Instant::now();
        match self {
            Self::Here(session) => session.run(tile).map(|tile| (tile, started.elapsed())),
            Self::Apart(process) => process.run(tile),
        }
    }
}

/// The child's side: loads the runtime that it is told to on `input`, gives up what it does not need any more by `seal`, opens the model, and answers tiles on
/// `out` until there are no more.
///
/// # Errors
/// An input that is none, an answer that cannot be written. A model that is refused is an answer, and so is a sandbox that could not be entered.
pub(crate) fn serve(
    input: &mut impl BufRead,
    out: &mut (impl Write + Send),
    seal: impl FnOnce() -> std::result::Result<Confinement, String>,
) -> std::io::Result<()> {
    let asked: Asked = line(input)?;
    let options = Options {
        onnxruntime: asked.onnxruntime.map(|named| named.library),
        threads: asked.threads,
        choice: asked.choice,
    };
    let more = std::iter::once_with(|| -> std::io::Result<Vec<Candidate>> {
        words(out, &Said::Look)?;
        line(input)
    });
    let candidates = asked.candidates.into_iter().chain(more.flat_map(std::io::Result::unwrap_or_default));
    let prepared = Prepared::with(&options, candidates);
    let confinement = match seal() {
        Ok(confinement) => confinement,
        Err(why) => return unheld(out, why),
    };
    words(out, &Said::Ready(confinement))?;
    let mut model = Vec::new();
    input.take(asked.model_bytes).read_to_end(&mut model)?;
    let opened = prepared.open(&model, &asked.file);
    drop(model);
    let session = match opened {
        Ok(session) => session,
        Err(error) => return words(out, &Said::Opened(Err(of_input(error, &asked.file)))),
    };
    let out = Mutex::new(out);
    let (sender, receiver) = mpsc::sync_channel::<(u64, Array4<f32>)>(1);
    let receiver = Mutex::new(receiver);
    let work = || -> std::io::Result<()> {
        loop {
            let next = lock(&receiver).recv();
            let Ok((id, tile)) = next else { return Ok(()) };
            let started = Instant::now();
            let answer = session.run(tile.view()).map_err(|e| of_input(e, &asked.file));
            let answer = answer.map(|tile| (tile, started.elapsed()));
            write_answer(&mut **lock(&out), id, &answer)?;
        }
    };
    std::thread::scope(|scope| {
        let mut workers = Vec::new();
        for _ in 0..session.parallel_tiles() {
            match std::thread::Builder::new().spawn_scoped(scope, work) {
                Ok(worker) => workers.push(worker),
                // Its limit of memory, mostly: whoever started it knows that one.
                Err(reason) if workers.is_empty() => return Err(reason),
                // Those that could be started are enough.
                Err(_) => break,
            }
        }
        let opened = Opened { runtime: session.runtime().clone(), workers: workers.len() };
        words(&mut **lock(&out), &Said::Opened(Ok(opened)))?;
        while let Some((id, tile)) = read_tile(input)? {
            if sender.send((id, tile)).is_err() {
                break;
            }
        }
        drop(sender);
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| Err(std::io::Error::other("a worker failed"))))
    })
}

/// The answer of a child that could not be held to its limits.
pub(crate) fn unheld(out: &mut impl Write, why: String) -> std::io::Result<()> {
    words(out, &Said::Unheld(why))
}

/// Who waits for which tile, when the child last answered, and why it is no more.
#[derive(Default)]
struct Desk {
    waiting: HashMap<u64, mpsc::Sender<Answer>>,
    last: Option<Instant>,
    gone: Option<String>,
}

/// A child at work; it ends when this is dropped.
struct Live {
    child: Mutex<Child>,
    /// What is on its way to the child: a child that does not read keeps nobody waiting for longer than the limit.
    to_write: Mutex<mpsc::Sender<Written>>,
    desk: Arc<Mutex<Desk>>,
    /// Samples of the largest tile so far: no answer is larger.
    largest: Arc<AtomicU64>,
    opened: Opened,
    confinement: Confinement,
}

impl Drop for Live {
    fn drop(&mut self) {
        let child = self.child.get_mut().unwrap_or_else(PoisonError::into_inner);
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// A network in a child, which is started anew for the next capture where it broke off.
pub struct Process {
    live: Mutex<Arc<Live>>,
    model: Vec<u8>,
    asked: Asked,
    apart: Apart,
    limits: Limits,
    next: AtomicU64,
    opened: Opened,
}

impl std::fmt::Debug for Process {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Process").field("runtime", &self.opened.runtime).field("limits", &self.limits).finish()
    }
}

impl Process {
    fn open(model: &[u8], file: &Path, options: &Options, apart: &Apart) -> Result<Self> {
        let failed = |e: std::io::Error| Error::Internal(format!("the network's process: {e}"));
        let folder = apart.helper.program().parent();
        let asked = Asked {
            file: file.to_owned(),
            model_bytes: model.len() as u64,
            onnxruntime: options
                .onnxruntime
                .as_deref()
                .map(std::path::absolute)
                .transpose()
                .map_err(failed)?
                .map(|library| Candidate::new(library, "--onnxruntime")),
            candidates: onnxruntime::candidates(folder.unwrap_or(Path::new(""))).collect(),
            threads: options.thread_count(),
            choice: options.choice,
        };
        let memory = MEMORY.saturating_add(MEMORY_A_THREAD.saturating_mul(asked.threads as u64));
        let memory = memory.min(Limit::of_process().addresses(asked.threads));
        let limits = Limits { memory_bytes: apart.memory_bytes.unwrap_or(memory), time: apart.time };
        let live = Live::start(&asked, model, apart, limits)?;
        Ok(Self {
            opened: live.opened.clone(),
            live: Mutex::new(Arc::new(live)),
            model: model.to_vec(),
            asked,
            apart: apart.clone(),
            limits,
            next: AtomicU64::new(0),
        })
    }

    /// Starts a child where the last one is gone.
    fn ready(&self) -> Result<()> {
        let mut live = lock(&self.live);
        if lock(&live.desk).gone.is_some() {
            *live = Arc::new(Live::start(&self.asked, &self.model, &self.apart, self.limits)?);
        }
        Ok(())
    }

    fn run(&self, tile: ArrayView4<'_, f32>) -> Result<(Array4<f32>, Duration)> {
        let live = Arc::clone(&lock(&self.live));
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let (sender, receiver) = mpsc::channel();
        live.largest.fetch_max(tile.len() as u64, Ordering::Relaxed);
        {
            let mut desk = lock(&live.desk);
            if let Some(why) = &desk.gone {
                return Err(refused(&self.asked, why, &self.apart));
            }
            desk.waiting.insert(id, sender);
        }
        // (Nobody hears of a tile that could not be sent: the child is gone then, and who waits is told.)
        let _ = lock(&live.to_write).send(Written::Tile(id, tile.to_owned()));
        let answer = live.answer(&receiver, self.limits, "a tile");
        answer.map_err(|why| refused(&self.asked, &why, &self.apart))?.map_err(Error::from)
    }
}

/// What is said of a child that gave no answer.
fn refused(asked: &Asked, why: &str, apart: &Apart) -> Error {
    let allowed = format!("a model that runs within the limits{}", apart.hint);
    Error::bad(asked.file.display().to_string(), "network", why, allowed)
}

impl Live {
    fn start(asked: &Asked, model: &[u8], apart: &Apart, limits: Limits) -> Result<Self> {
        let failed = |e: std::io::Error| Error::Internal(format!("the network's process: {e}"));
        let start = Start {
            helper: &apart.helper,
            command: COMMAND,
            limits,
            once: false,
            input: Stdio::piped(),
            threads: asked.threads,
        };
        let mut child = start.spawn().map_err(|e| Error::starting(apart.helper.program(), e))?;
        let (input, output) = (child.stdin.take(), child.stdout.take());
        let (write, to_write) = mpsc::channel();
        let (say, said) = mpsc::channel();
        let mut live = Self {
            child: Mutex::new(child),
            to_write: Mutex::new(write.clone()),
            desk: Arc::default(),
            largest: Arc::default(),
            opened: Opened { runtime: Runtime::Tract { reason: String::new() }, workers: 1 },
            confinement: Confinement::default(),
        };
        let (Some(input), Some(output)) = (input, output) else {
            return Err(Error::Internal("the network's process has no pipes".into()));
        };
        threads::start(move || pass_on(input, &to_write))?;
        let (desk, largest) = (Arc::clone(&live.desk), Arc::clone(&live.largest));
        let gone = broke_off(limits);
        threads::start(move || listen(BufReader::new(output), &say, &desk, &largest, gone))?;
        // (Nobody hears what could not be sent: the child is gone then, and who waits is told.)
        let tell = |bytes: Vec<u8>| drop(write.send(Written::Words(bytes)));
        tell(line_of(asked).map_err(failed)?);
        // One question, then its readiness, then what became of the model: once it has read the model, nothing else is taken from it.
        let (mut asks, mut ready) = (true, false);
        let opened = loop {
            match live.answer(&said, limits, "opening the model").map_err(|why| refused(asked, &why, apart))? {
                // It starts a program, which the child may not.
                Said::Look if asks && !ready => {
                    asks = false;
                    tell(line_of(&onnxruntime::python().into_iter().collect::<Vec<_>>()).map_err(failed)?);
                }
                Said::Ready(confinement) if !ready => {
                    ready = true;
                    live.confinement = confinement;
                    tell(model.to_vec());
                }
                Said::Unheld(why) if !ready => {
                    return Err(Error::Internal(format!("the network's process was not given the model: {why}")));
                }
                Said::Opened(opened) if ready => break opened.map_err(Error::from)?,
                _ => return Err(refused(asked, &broke_off(limits), apart)),
            }
        };
        live.opened = Opened { workers: opened.workers.clamp(1, asked.threads.max(1)), ..opened };
        Ok(live)
    }

    /// Waits for an answer: as long as the limit from the last answer on, since a tile may stand behind another. Why there is none, which is the same for
    /// all who wait; the child is ended then.
    fn answer<T>(&self, receiver: &mpsc::Receiver<T>, limits: Limits, work: &str) -> std::result::Result<T, String> {
        let started = Instant::now();
        loop {
            let from = lock(&self.desk).last.map_or(started, |last| last.max(started));
            let why = match receiver.recv_timeout(limits.time.saturating_sub(from.elapsed())) {
                Ok(answer) => return Ok(answer),
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    if lock(&self.desk).last.is_some_and(|last| last > from) {
                        continue;
                    }
                    format!("{work} had not come to an end after {} s", limits.time.as_secs_f64())
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => broke_off(limits),
            };
            let mut desk = lock(&self.desk);
            let why = desk.gone.get_or_insert(why).clone();
            desk.waiting.clear();
            drop(desk);
            let _ = lock(&self.child).kill();
            return Err(why);
        }
    }
}

fn broke_off(limits: Limits) -> String {
    format!("the process that runs it broke off (more than {} of memory, or stopped)", in_words(limits.memory_bytes))
}

/// What is written to a child.
enum Written {
    Words(Vec<u8>),
    Tile(u64, Array4<f32>),
}

/// Hands words and tiles to the child, until there are no more or it is gone.
fn pass_on(mut input: impl Write, to_write: &mpsc::Receiver<Written>) {
    while let Ok(next) = to_write.recv() {
        let sent = match next {
            Written::Words(bytes) => input.write_all(&bytes).and_then(|()| input.flush()),
            Written::Tile(id, tile) => write_tile(&mut input, id, tile.view()),
        };
        if sent.is_err() {
            return;
        }
    }
}

/// Hands the child's answers to who waits for them. When there are no more nobody waits any longer.
fn listen(mut output: impl BufRead, say: &mpsc::Sender<Said>, desk: &Mutex<Desk>, largest: &AtomicU64, gone: String) {
    let mut opened = false;
    while !opened && let Ok(said) = line(&mut output) {
        opened = matches!(said, Said::Opened(_));
        let _ = say.send(said);
    }
    if opened {
        while let Ok((id, answer)) = read_answer(&mut output, || largest.load(Ordering::Relaxed)) {
            let mut desk = lock(desk);
            desk.last = Some(Instant::now());
            if let Some(sender) = desk.waiting.remove(&id) {
                let _ = sender.send(answer);
            }
        }
    }
    let mut desk = lock(desk);
    desk.gone.get_or_insert(gone);
    desk.waiting.clear();
}

#[cfg(test)]
mod tests;
