//! Requests to `isoplanat view` over a connection in memory, with the bounds of the real one. The connection ends; the page goes to nobody who has not named
//! the token and the server's own address.

#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../src/commands/view/answer.rs"]
mod answer;
#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../src/commands/view/board.rs"]
mod board;
#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../src/commands/view/room.rs"]
mod room;
#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../src/commands/view/talk.rs"]
mod talk;
#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../src/commands/view/token.rs"]
mod token;

use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, LazyLock};
use std::task::{Context, Poll, Waker};

use hyper::rt::{Read, ReadBufCursor, Write};
use tokio::runtime::{Builder, Runtime};

use self::answer::Desk;
use self::board::Board;
use self::room::Kind;
use self::token::Token;

/// Stands for the token, which is another in each run, in inputs.
const TOKEN: &str = "TTTTTTTTTTTTTTTTTTTTTTTTTTTTTTTT";
/// A word of the page.
const SECRET: &str = "what the page shows";
/// Polls of a connection whose bytes are all there.
const MOST: usize = 2000;

/// What comes, in parts of some bytes, and what is sent.
struct Memory<'a> {
    rest: &'a [u8],
    part: usize,
    sent: Vec<u8>,
}

impl Read for Memory<'_> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        mut into: ReadBufCursor<'_>,
    ) -> Poll<std::io::Result<()>> {
        let n = self.part.min(self.rest.len()).min(into.remaining());
        let (now, rest) = self.rest.split_at(n);
        into.put_slice(now);
        self.rest = rest;
        Poll::Ready(Ok(()))
    }
}

impl Write for Memory<'_> {
    fn poll_write(mut self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<std::io::Result<usize>> {
        self.sent.extend(bytes);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

static RUNTIME: LazyLock<Runtime> =
    LazyLock::new(|| Builder::new_current_thread().enable_time().build().expect("a runtime"));
static DESK: LazyLock<Desk> = LazyLock::new(|| {
    let board = Arc::new(Board::new(&format!("<head></head>{SECRET}")));
    Desk::new(SocketAddr::from(([127, 0, 0, 1], 4000)), Token::new().expect("random numbers"), board).expect("a policy")
});

/// The first byte says in how large parts the others come.
pub(super) fn request(bytes: &[u8]) {
    let (part, asked) = bytes.split_first().map_or((1, bytes), |(part, rest)| (1 + usize::from(*part), rest));
    let url = DESK.url();
    let (_, token) = url.split_once("token=").expect("a token");
    let mut asked = asked.to_vec();
    let places: Vec<usize> = (0..asked.len()).filter(|at| asked[*at..].starts_with(TOKEN.as_bytes())).collect();
    for at in &places {
        asked[*at..*at + TOKEN.len()].copy_from_slice(token.as_bytes());
    }
    let _inside = RUNTIME.enter();
    let memory = Memory { rest: &asked, part, sent: Vec::new() };
    let heard = std::cell::Cell::new(None);
    let mut connection = talk::connection(memory, &DESK, |kind| heard.set(Some(kind)));
    let context = &mut Context::from_waker(Waker::noop());
    let ended = (0..MOST).any(|_| connection.poll_without_shutdown(context).is_ready());
    // A stream of events behind which more was sent goes on until a write fails: nothing of what follows is read meanwhile.
    assert!(ended || heard.get() == Some(Kind::Stream), "a connection whose other end is closed goes on");
    let sent = connection.into_parts().io.sent;
    let known = heard.get().is_some();
    let holds = |part: &[u8]| sent.windows(part.len()).any(|w| w == part);
    assert!(sent.is_empty() || sent.starts_with(b"HTTP/1."), "{}", String::from_utf8_lossy(&sent));
    assert!(!known || !places.is_empty(), "known without the token");
    let named = |name: &str| asked.windows(name.len()).any(|w| w.eq_ignore_ascii_case(name.as_bytes()));
    if holds(SECRET.as_bytes()) || holds(b"data: {") {
        assert!(known && (named("127.0.0.1:4000") || named("localhost:4000")), "shown to a stranger");
    }
    assert!(!holds(token.as_bytes()), "the token is told");
}

pub(super) fn starts() -> Vec<Vec<u8>> {
    let ask =
        |first: &str, more: &str| format!("\u{7f}{first} HTTP/1.1\r\nHost: 127.0.0.1:4000\r\n{more}\r\n").into_bytes();
    let of = |path: &str| format!("GET {path}?token={TOKEN}");
    vec![
        ask(&of("/"), ""),
        ask(&of("/events"), "Accept: text/event-stream\r\n"),
        ask(&of("/else"), "Connection: close\r\n"),
        ask("GET /", "Cookie: a=b\r\n"),
        ask(&format!("POST /?a=b&token={TOKEN}"), "Content-Length: 3\r\n\r\nabc"),
        ask(
            &format!("GET http://localhost:4000/?token={TOKEN}"),
            "Transfer-Encoding: chunked\r\nExpect: 100-continue\r\n",
        ),
        [ask(&of("/"), "Range: bytes=0-1\r\n"), ask(&of("/"), "Upgrade: h2c\r\n")[1..].to_vec()].concat(),
    ]
}
