//! New connections: one thread takes them as fast as they come, and closes the oldest of too many before any work is done for them.
//!
//! Were each taken and worked for in turn, a flood would fill the system's queue, and what comes to a full queue is tried again only a second later: the
//! user's request as well. What a connection has sent by now is looked at, so that those with the token are never among the closed.

use std::collections::{BTreeSet, VecDeque};
use std::io::{ErrorKind, Result};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::TcpSocket;
use tokio::sync::Notify;

use super::room::{Kind, Room};

/// Connections that the system keeps until they are taken, if it keeps so many. Fewer overflow in a flood, and more are a longer queue where other programs
/// leave little of the processor: 1024 cost a second now and then, 4096 up to 0.2 s.
const WAITING: u32 = 2048;
/// Bytes that are looked at: a first line with the token is much shorter.
pub(super) const BEGIN: usize = 512;
/// Strangers that are heard in one turn: what they cost is time that others wait for.
const HEARD: usize = 16;
/// Rest after an error, until descriptors are free again.
const REST: Duration = Duration::from_millis(5);

/// Connections by kind, the oldest first.
type Arrived = [VecDeque<TcpStream>; Kind::ALL.len()];

/// Connections that have come and are not in the room yet.
#[derive(Debug, Default)]
pub(super) struct Hall {
    arrived: Mutex<Arrived>,
    news: Notify,
}

impl Hall {
    /// What has come, once there is something; those with the token first.
    pub(super) async fn arrived(&self, is_promised: impl Fn(&[u8]) -> bool) -> Vec<(TcpStream, Kind)> {
        loop {
            let mut arrived = std::mem::take(&mut *self.arrived.lock().unwrap_or_else(PoisonError::into_inner));
            // Most have said something by now, or have gone.
            for stream in std::mem::take(&mut arrived[Kind::Silent as usize]) {
                if let Some(kind) = kind(&stream, &is_promised) {
                    let _ = put(&mut arrived, stream, kind);
                }
            }
            let of = |kind: Kind| std::mem::take(&mut arrived[kind as usize]).into_iter().map(move |s| (s, kind));
            let all: Vec<_> = [Kind::Known, Kind::Stranger, Kind::Silent].into_iter().flat_map(of).collect();
            if !all.is_empty() {
                return all;
            }
            self.news.notified().await;
        }
    }

    /// Takes a connection in; of its kind the newest stay, and those that have shown the token since they came.
    fn add(&self, stream: TcpStream, kind: Kind, is_promised: impl Fn(&[u8]) -> bool) {
        let mut arrived = self.arrived.lock().unwrap_or_else(PoisonError::into_inner);
        let mut over = put(&mut arrived, stream, kind);
        if let Some(oldest) = over.take_if(|oldest| self::kind(oldest, is_promised) == Some(Kind::Known)) {
            over = put(&mut arrived, oldest, Kind::Known);
        }
        drop(arrived);
        drop(over);
        self.news.notify_one();
    }
}

/// Puts a connection among its kind; the oldest, where they are too many.
fn put(arrived: &mut Arrived, stream: TcpStream, kind: Kind) -> Option<TcpStream> {
    let all = &mut arrived[kind as usize];
    all.push_back(stream);
    let most = if kind == Kind::Stranger { HEARD } else { kind.most() };
    if all.len() > most { all.pop_front() } else { None }
}

/// Listens on the loopback interface; within a runtime.
///
/// # Errors
/// A port that is not free; a system that gives no descriptors.
pub(super) fn listen(port: u16) -> Result<TcpListener> {
    let socket = TcpSocket::new_v4()?;
    // On Unix a port of connections that ended a moment ago is free; on Windows this would let two servers have one port.
    socket.set_reuseaddr(cfg!(unix))?;
    socket.bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
    let listener = socket.listen(WAITING)?.into_std()?;
    listener.set_nonblocking(false)?;
    Ok(listener)
}

/// Takes connections for ever; no error ends it.
pub(super) fn watch(listener: &TcpListener, hall: &Hall, room: &Arc<Room>, is_promised: impl Fn(&[u8]) -> bool) -> ! {
    let mut told = BTreeSet::new();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                let kind = stream.set_nonblocking(true).ok().and_then(|()| kind(&stream, &is_promised));
                if let Some(kind) = kind {
                    hall.add(stream, kind, &is_promised);
                }
            }
            // Whoever it was has gone.
            Err(e) if [ErrorKind::ConnectionAborted, ErrorKind::ConnectionReset].contains(&e.kind()) => {}
            Err(e) => {
                if told.insert(e.raw_os_error()) {
                    crate::aside!("note: a connection could not be taken: {e}; the page is served on");
                }
                // No descriptors, most likely.
                room.spare();
                std::thread::sleep(REST);
            }
        }
    }
}

/// What a connection that is new is by what it has sent; none if it is closed again.
fn kind(stream: &TcpStream, is_promised: impl Fn(&[u8]) -> bool) -> Option<Kind> {
    let mut bytes = [0; BEGIN];
    match stream.peek(&mut bytes) {
        Ok(0) => None,
        Ok(n) => Some(if is_promised(&bytes[..n]) { Kind::Known } else { Kind::Stranger }),
        Err(e) => (e.kind() == ErrorKind::WouldBlock).then_some(Kind::Silent),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};

    use super::*;

    #[test]
    fn the_newest_come_in_and_the_known_before_all_others() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let listener = runtime.block_on(async { listen(0).expect("a port") });
        let address = listener.local_addr().expect("an address");
        let hall = Hall::default();
        let known = |bytes: &[u8]| bytes == b"known";
        let come = |words: &str| {
            let mut stream = TcpStream::connect(address).expect("connects");
            stream.write_all(words.as_bytes()).expect("writes");
            let (other, _) = listener.accept().expect("accepts");
            other.set_nonblocking(true).expect("is set");
            let kind = kind(&other, known).expect("open");
            hall.add(other, kind, known);
            stream
        };
        // One that speaks only after it came, before others that do not at all; and more strangers than may be.
        let mut late = come("");
        late.write_all(b"known").expect("writes");
        let (silent, strangers) = (Kind::Silent.most(), HEARD);
        let mut open: Vec<TcpStream> = (0..strangers + 5).map(|k| come(&format!("stranger {k}"))).collect();
        open.extend((0..silent).map(|_| come("")));
        open.push(come("known"));
        for stream in &mut open[..5] {
            assert!(!matches!(stream.read(&mut [0]), Ok(1..)), "closed before anybody has asked for it");
        }
        // Two that change their minds at the end.
        let late = open.len() - 3;
        drop(open.remove(late));
        open[late].write_all(b"known").expect("writes");
        let arrived = runtime.block_on(hall.arrived(known));
        let mut expected = vec![Kind::Known; 3];
        expected.extend(std::iter::repeat_n(Kind::Stranger, strangers));
        expected.extend(std::iter::repeat_n(Kind::Silent, silent - 2));
        assert_eq!(arrived.iter().map(|(_, kind)| *kind).collect::<Vec<_>>(), expected);
        let mut bytes = [0; BEGIN];
        let n = arrived[3].0.peek(&mut bytes).expect("was said");
        assert_eq!(&bytes[..n], b"stranger 5");
    }

    #[test]
    fn who_has_gone_again_is_nobody() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let listener = runtime.block_on(async { listen(0).expect("a port") });
        drop(TcpStream::connect(listener.local_addr().expect("an address")).expect("connects"));
        let (stream, _) = listener.accept().expect("accepts");
        // The other's end comes on its own way.
        stream.peek(&mut [0]).expect("comes");
        assert_eq!(kind(&stream, |_| true), None);
    }
}
