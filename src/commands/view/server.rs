//! The server: a thread for the door (`door`) and one for all answers, and bounds for all that another end can make long, many or slow.
//!
//! hyper on tokio, and not a smaller library, for the sake of those bounds: a time limit on the head of a request, sizes of heads (`talk`), an accept loop of
//! our own, which no error ends. It costs nine crates in place of three: 7 s more of one core to build, 0.3 MB of the program.

use std::future::poll_fn;
use std::io::{Error as IoError, ErrorKind};
use std::net::{SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use hyper_util::rt::TokioIo;
use isoplanat::{Error, Result, threads};
use tokio::io::AsyncWrite;
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use super::answer::Desk;
use super::door::{self, Hall};
use super::patience::Patient;
use super::room::{Kind, Room, Seat};
use super::talk::{self, HEAD};

/// So long nothing may be taken of what is sent.
const PATIENCE: Duration = Duration::from_secs(10);
/// After the last answer the other end may take it and go: a connection that is closed before all it sent is read loses what it was sent.
const PARTING: Duration = Duration::from_millis(250);
/// Bytes that are thrown away meanwhile.
const PARTING_BYTES: usize = 1 << 20;

/// A server that listens, and answers from when it runs.
#[derive(Debug)]
pub(super) struct Server {
    runtime: Runtime,
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// Listens on the loopback interface.
    ///
    /// # Errors
    /// A port that is not free; a system that gives no descriptors.
    pub(super) fn new(port: u16) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| Error::Stopped(format!("the server cannot start: {e}")))?;
        let listen = || {
            let _inside = runtime.enter();
            let listener = door::listen(port)?;
            Ok((listener.local_addr()?, listener))
        };
        let (address, listener) = listen()
            .map_err(|e: IoError| Error::bad("--port", "port", port.to_string(), format!("a free port ({e})")))?;
        Ok(Self { runtime, listener, address })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests from now on; no error of a connection ends it.
    ///
    /// # Errors
    /// A system that lets no thread be started; a fault of the program.
    pub(super) fn run(self, desk: Desk) -> Result<()> {
        let Self { runtime, listener, .. } = self;
        let (desk, hall, room) = (Arc::new(desk), Arc::new(Hall::default()), Arc::new(Room::default()));
        let (asked, from, seats) = (Arc::clone(&desk), Arc::clone(&hall), Arc::clone(&room));
        threads::start(move || door::watch(&listener, &from, &seats, |begin| asked.is_promised(begin)))?;
        // As one task among the others: the runtime lets the outermost one go first.
        let ended = runtime.block_on(async { tokio::spawn(answer(hall, room, desk)).await });
        ended.map_err(|e| Error::Internal(format!("the server ended: {e}")))
    }
}

/// Answers whoever comes.
async fn answer(hall: Arc<Hall>, room: Arc<Room>, desk: Arc<Desk>) {
    let mut id = 0;
    loop {
        for (stream, kind) in hall.arrived(|begin| desk.is_promised(begin)).await {
            let Ok(stream) = TcpStream::from_std(stream) else { continue };
            id += 1;
            let seat = Seat { room: Arc::clone(&room), id };
            let task = tokio::spawn(serve(stream, kind, seat, Arc::clone(&desk)));
            room.enter(id, task.abort_handle(), kind);
        }
        // Who is in has a turn, and is heard before another takes that place.
        tokio::task::yield_now().await;
    }
}

/// Answers what comes over a connection, until it ends or is ended.
async fn serve(stream: TcpStream, kind: Kind, seat: Seat, desk: Arc<Desk>) {
    if kind == Kind::Silent {
        // Costs little until something comes, and is then among its like.
        let mut begin = [0; door::BEGIN];
        let Ok(Ok(n @ 1..)) = timeout(HEAD, stream.peek(&mut begin)).await else { return };
        seat.heard(if desk.is_promised(&begin[..n]) { Kind::Known } else { Kind::Stranger });
    }
    let mut connection = talk::connection(TokioIo::new(Patient::new(stream, PATIENCE)), &desk, |kind| seat.heard(kind));
    // What ends a connection early is its other end's matter.
    let _ = poll_fn(|context| connection.poll_without_shutdown(context)).await;
    part(connection.into_parts().io.into_inner().into_inner()).await;
}

/// Ends a connection so that the other end has what it was sent.
async fn part(mut stream: TcpStream) {
    let listen = async {
        let (mut left, mut bytes) = (PARTING_BYTES, [0; 1 << 14]);
        poll_fn(|context| Pin::new(&mut stream).poll_shutdown(context)).await?;
        while left > 0 {
            stream.readable().await?;
            match stream.try_read(&mut bytes) {
                Ok(0) => break,
                Ok(n) => left = left.saturating_sub(n),
                Err(e) if e.kind() == ErrorKind::WouldBlock => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    };
    let _ = timeout(PARTING, listen).await;
}
