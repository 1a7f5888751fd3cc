//! HTTP over one connection, with bounds on the heads of requests; the connection may be a socket, or bytes in memory.

use std::convert::Infallible;
use std::future::{Ready, ready};
use std::time::Duration;

use hyper::body::Incoming;
use hyper::rt::{Read, Write};
use hyper::server::conn::http1::{Builder, Connection};
use hyper::service::{HttpService, service_fn};
use hyper::{Request, Response};
use hyper_util::rt::TokioTimer;

use super::answer::{Body, Desk};
use super::room::Kind;

/// The head of a request is there after so long, whether its connection is new or has been answered before.
pub(super) const HEAD: Duration = Duration::from_secs(5);
/// Bytes of a head, lines and target together.
const HEAD_BYTES: usize = 16 << 10;
/// Lines of a head.
const HEAD_LINES: usize = 64;

/// The connection `over` a stream, answered by `desk` as it is polled; `heard` is told what each request with the token shows of who sent it. Within a runtime.
pub(super) fn connection<'a, S: Read + Write + Unpin + 'a>(
    over: S,
    desk: &'a Desk,
    heard: impl Fn(Kind) + 'a,
) -> Connection<S, impl HttpService<Incoming, ResBody = Body, Error = Infallible, Future = Ready<Answer>>> {
    let service = service_fn(move |request: Request<Incoming>| {
        let (response, kind) = desk.answer(&request);
        if let Some(kind) = kind {
            heard(kind);
        }
        ready(Ok(response))
    });
    Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(HEAD_BYTES)
        .max_headers(HEAD_LINES)
        .serve_connection(over, service)
}

/// What becomes of a request: always a response.
type Answer = Result<Response<Body>, Infallible>;
