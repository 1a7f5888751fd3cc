//! The server: one thread, and bounds for all that another end can make long, many or slow.
//!
//! hyper on tokio, and not a smaller library, for the sake of those bounds: a time limit on the head of a request, sizes of heads, an accept loop of our
//! own, which no error ends. It costs nine crates in place of three.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::future::{poll_fn, ready};
use std::io::{Error as IoError, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use isoplanat::{Error, Result};
use tokio::io::AsyncWrite;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::runtime::Runtime;
use tokio::time::{sleep, timeout};

use super::answer::Desk;
use super::patience::Patient;
use super::room::{Kind, Room, Seat};

/// The head of a request is there after so long, whether its connection is new or has been answered before.
const HEAD: Duration = Duration::from_secs(5);
/// Bytes of a head, lines and target together.
const HEAD_BYTES: usize = 16 << 10;
/// Lines of a head.
const HEAD_LINES: usize = 64;
/// So long nothing may be taken of what is sent.
const PATIENCE: Duration = Duration::from_secs(10);
/// After the last answer the other end may take it and go: a connection that is closed before all it sent is read loses what it was sent.
const PARTING: Duration = Duration::from_millis(250);
/// Bytes that are thrown away meanwhile.
const PARTING_BYTES: usize = 1 << 20;
/// Connections that the system keeps until they are accepted.
const WAITING: u32 = 1024;
/// Connections that are accepted before the others have their turn; fewer than may be strangers, so that each is heard before its place is taken.
const TURN: u64 = 16;
/// Rest after an error that nothing can be done about.
const REST: Duration = Duration::from_millis(20);

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
            // Its sockets are the runtime's.
            let _inside = runtime.enter();
            let socket = TcpSocket::new_v4()?;
            // On Unix a port of connections that ended a moment ago is free; on Windows this would let two servers have one port.
            socket.set_reuseaddr(cfg!(unix))?;
            socket.bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
            let listener = socket.listen(WAITING)?;
            let address = listener.local_addr()?;
            Ok((listener, address))
        };
        let (listener, address) = listen()
            .map_err(|e: IoError| Error::bad("--port", "port", port.to_string(), format!("a free port ({e})")))?;
        Ok(Self { runtime, listener, address })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests from now on; no error of a connection ends it.
    pub(super) fn run(self, desk: Desk) -> ! {
        self.runtime.block_on(accept(&self.listener, &Arc::new(desk)))
    }
}

async fn accept(listener: &TcpListener, desk: &Arc<Desk>) -> ! {
    let room = Arc::new(Room::default());
    let mut told = BTreeSet::new();
    let mut id = 0_u64;
    loop {
        id += 1;
        match listener.accept().await {
            Ok((stream, _)) => {
                let seat = Seat { room: Arc::clone(&room), id };
                let task = tokio::spawn(serve(stream, seat, Arc::clone(desk)));
                room.enter(id, task.abort_handle());
            }
            // Whoever it was has gone.
            Err(e) if [ErrorKind::ConnectionAborted, ErrorKind::ConnectionReset].contains(&e.kind()) => {}
            Err(e) => {
                if told.insert(e.raw_os_error()) {
                    crate::tell!("note: a connection could not be taken: {e}; the page is served on");
                }
                // No descriptors, most likely: strangers' are free once the others have had their turn.
                if room.spare() {
                    tokio::task::yield_now().await;
                } else {
                    sleep(REST).await;
                }
            }
        }
        if id.is_multiple_of(TURN) {
            tokio::task::yield_now().await;
        }
    }
}

/// Answers what comes over a connection, until it ends or is ended.
async fn serve(stream: TcpStream, seat: Seat, desk: Arc<Desk>) {
    let service = service_fn(|request| {
        let (response, kind) = desk.answer(&request);
        if kind != Kind::Stranger {
            seat.heard(kind);
        }
        ready(Ok::<_, Infallible>(response))
    });
    let mut connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(HEAD_BYTES)
        .max_headers(HEAD_LINES)
        .serve_connection(TokioIo::new(Patient::new(stream, PATIENCE)), service);
    // What ends a connection early is its other end's matter.
    let _ = poll_fn(|context| connection.poll_without_shutdown(context)).await;
    part(connection.into_parts().io.into_inner().into_inner()).await;
}

/// Ends a connection so that the other end has what it was sent.
async fn part(mut stream: TcpStream) {
    let listen = async {
        let (mut left, mut bytes) = (PARTING_BYTES, [0; 1 << 12]);
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
