//! What a request is answered: the page or a stream of events, to whoever asks this server by its own name, by `GET` and with the token.
//!
//! The token stands in the address, where the page's script finds it, and in no cookie: a browser sends a host's cookies to all its ports, so another
//! user's server at another port of this machine would be told it. An address is told to nobody (`Referrer-Policy`), and can be loaded again.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hyper::body::{Bytes, Frame, SizeHint};
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::{Method, Request, Response, StatusCode};
use isoplanat::report::html::SCRIPT;
use isoplanat::{Error, Result};
use sha2::{Digest, Sha256};
use tokio::sync::watch::Receiver;

use super::board::{Board, LIVE, Shown};
use super::room::Kind;
use super::token::Token;

/// Most time between two signs of life on a stream of events.
const ALIVE: Duration = Duration::from_secs(10);

const TEXT: &str = "text/plain; charset=utf-8";

/// What answers requests.
pub(super) struct Desk {
    address: SocketAddr,
    token: Token,
    board: Arc<Board>,
    /// What a page may do.
    policy: HeaderValue,
}

impl Desk {
    pub(super) fn new(address: SocketAddr, token: Token, board: Arc<Board>) -> Result<Self> {
        Ok(Self { address, token, board, policy: policy()? })
    }

    /// The address of the page.
    pub(super) fn url(&self) -> String {
        format!("http://{}/?token={}", self.address, self.token.as_str())
    }

    /// Whether what a connection begins with, as far as it has come, asks with the token.
    pub(super) fn is_promised(&self, begin: &[u8]) -> bool {
        let line = begin.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let target = std::str::from_utf8(line).ok().and_then(|line| line.split(' ').nth(1));
        target.and_then(|target| target.split_once('?')).is_some_and(|(_, query)| self.token.is_in(query))
    }

    /// The answer to a request, and what the request shows of who sent it, if it has the token. Nothing of a body is read, so a request with one is its connection's last; so
    /// is one that is refused.
    pub(super) fn answer<B: hyper::body::Body>(&self, request: &Request<B>) -> (Response<Body>, Option<Kind>) {
        let (status, kind, form, body) = match self.refusal(request) {
            Some((status, words)) => (status, None, TEXT, Body::words(words)),
            None => match request.uri().path() {
                "/" => {
                    let page = Bytes::from_owner(self.board.page());
                    (StatusCode::OK, Some(Kind::Known), "text/html; charset=utf-8", Body::Whole(Some(page)))
                }
                "/events" => {
                    let events = Body::Events(Box::pin(event(self.board.follow(), true)));
                    (StatusCode::OK, Some(Kind::Stream), "text/event-stream", events)
                }
                _ => (StatusCode::NOT_FOUND, Some(Kind::Known), TEXT, Body::words("nothing here")),
            },
        };
        let mut response = Response::new(body);
        *response.status_mut() = status;
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_SECURITY_POLICY, self.policy.clone());
        let mut put = |name: HeaderName, value| headers.insert(name, HeaderValue::from_static(value));
        put(header::CONTENT_TYPE, form);
        put(header::CACHE_CONTROL, "no-store");
        put(header::REFERRER_POLICY, "no-referrer");
        put(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
        put(HeaderName::from_static("cross-origin-resource-policy"), "same-origin");
        if status == StatusCode::METHOD_NOT_ALLOWED {
            put(header::ALLOW, "GET");
        }
        if status != StatusCode::OK || !request.body().is_end_stream() {
            put(header::CONNECTION, "close");
        }
        (response, kind)
    }

    /// Why a request is not answered.
    fn refusal<B>(&self, request: &Request<B>) -> Option<(StatusCode, &'static str)> {
        if !self.is_meant(request.headers()) {
            return Some((StatusCode::FORBIDDEN, "this server answers to its own address only"));
        }
        if request.method() != Method::GET {
            return Some((StatusCode::METHOD_NOT_ALLOWED, "GET only"));
        }
        if !self.token.is_in(request.uri().query().unwrap_or("")) {
            return Some((
                StatusCode::FORBIDDEN,
                "the address of this page ends in a token; the whole address stands where `isoplanat view` was started",
            ));
        }
        None
    }

    /// Whether the one `Host` is a name of this server's: a page elsewhere whose name was made to lead here has another.
    fn is_meant(&self, headers: &HeaderMap) -> bool {
        let mut hosts = headers.get_all(header::HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else { return false };
        let port = self.address.port();
        let names = [self.address.ip().to_string(), "localhost".to_owned()];
        names.iter().any(|name| (port == 80 && host == name.as_str()) || *host == *format!("{name}:{port}"))
    }
}

/// A page has its styles and pictures in itself and two scripts, known by their hashes; it asks this server alone, and no page frames it.
fn policy() -> Result<HeaderValue> {
    let hash = |script: &str| {
        // A browser takes line ends as one character.
        STANDARD.encode(Sha256::digest(script.replace("\r\n", "\n")))
    };
    let policy = format!(
        "default-src 'none'; script-src 'sha256-{}' 'sha256-{}'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        hash(SCRIPT),
        hash(LIVE)
    );
    HeaderValue::from_str(&policy).map_err(|e| Error::Internal(format!("the page's policy: {e}")))
}

/// The rest of a stream of events: what is followed, and the bytes of the next one; none after the last.
type Next = (Receiver<Shown>, Option<Bytes>);

/// News of the page, as its script reads them.
#[derive(serde::Serialize)]
struct News<'a> {
    version: u64,
    page: String,
    error: Option<&'a str>,
}

/// The next event: which page is shown now and, where the file cannot be shown, why; a sign of life where nothing happens.
async fn event(mut news: Receiver<Shown>, first: bool) -> Next {
    if !first {
        match tokio::time::timeout(ALIVE, news.changed()).await {
            Err(_) => return (news, Some(Bytes::from_static(b": still here\n\n"))),
            Ok(Err(_)) => return (news, None),
            Ok(Ok(())) => {}
        }
    }
    let event = {
        let shown = news.borrow_and_update();
        let (page, error) = (shown.page_version.to_string(), shown.error.as_deref());
        serde_json::json!(News { version: shown.version, page, error })
    };
    (news, Some(format!("data: {event}\n\n").into()))
}

/// What is sent: all at once, or event by event.
pub(super) enum Body {
    Whole(Option<Bytes>),
    Events(Pin<Box<dyn Future<Output = Next> + Send>>),
}

impl Body {
    fn words(text: &str) -> Self {
        Self::Whole(Some(format!("{text}\n").into()))
    }
}

impl hyper::body::Body for Body {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let bytes = match self.get_mut() {
            Self::Whole(bytes) => bytes.take(),
            Self::Events(next) => {
                let (news, bytes) = ready!(next.as_mut().poll(context));
                *next = Box::pin(event(news, false));
                bytes
            }
        };
        Poll::Ready(bytes.map(|bytes| Ok(Frame::data(bytes))))
    }

    fn is_end_stream(&self) -> bool {
        matches!(self, Self::Whole(None))
    }

    fn size_hint(&self) -> SizeHint {
        match self {
            Self::Whole(bytes) => SizeHint::with_exact(bytes.as_ref().map_or(0, |b| b.len() as u64)),
            Self::Events(_) => SizeHint::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A request, and how it is answered.
    fn asked(desk: &Desk, method: Method, target: &str, hosts: &[&str]) -> (u16, Option<Kind>) {
        let mut request = Request::builder().method(method).uri(target);
        for host in hosts {
            request = request.header(header::HOST, *host);
        }
        let (response, kind) = desk.answer(&request.body(Body::Whole(None)).expect("a request"));
        let policy = response.headers()[header::CONTENT_SECURITY_POLICY].to_str().expect("text");
        assert!(policy.contains("'sha256-") && policy.contains("frame-ancestors 'none'"), "{policy}");
        let closes = response.headers().get(header::CONNECTION).is_some_and(|v| v == "close");
        assert_eq!(closes, response.status() != StatusCode::OK, "{target}");
        (response.status().as_u16(), kind)
    }

    #[test]
    fn only_the_token_at_the_own_name_is_let_in() {
        let board = Arc::new(Board::new("<head></head>"));
        let desk = |port: u16| {
            let token = Token::new().expect("random numbers");
            Desk::new(SocketAddr::from(([127, 0, 0, 1], port)), token, Arc::clone(&board)).expect("a policy")
        };
        let own = desk(4000);
        let with = |path: &str| format!("{path}?token={}", own.token.as_str());
        let is = |method, target: &str, hosts: &[&str], status, kind| {
            assert_eq!(asked(&own, method, target, hosts), (status, kind), "{target} {hosts:?}");
        };
        is(Method::GET, &with("/"), &["127.0.0.1:4000"], 200, Some(Kind::Known));
        is(Method::GET, &with("/"), &["localhost:4000"], 200, Some(Kind::Known));
        is(Method::GET, &with("/events"), &["127.0.0.1:4000"], 200, Some(Kind::Stream));
        is(Method::GET, &with("/else"), &["127.0.0.1:4000"], 404, Some(Kind::Known));
        for target in ["/", "/events", "/else", "/?token=", "/?token=00000000000000000000000000000000"] {
            is(Method::GET, target, &["127.0.0.1:4000"], 403, None);
        }
        let others: [&[&str]; 6] = [
            &[],
            &["127.0.0.1"],
            &["127.0.0.1:4001"],
            &["evil.example:4000"],
            &["127.0.0.1:4000", "evil.example"],
            &["127.0.0.1:4000", "127.0.0.1:4000"],
        ];
        for hosts in others {
            is(Method::GET, &with("/"), hosts, 403, None);
        }
        for (begin, is) in [
            (format!("GET {} HTTP/1.1\r\nHost: x", with("/")), true),
            (format!("GET {} ", with("/")), true),
            (format!("GET {}", &with("/")[..20]), false),
            (format!("GET / HTTP/1.1\r\nX: ?token={}", own.token.as_str()), false),
            (String::new(), false),
        ] {
            assert_eq!(own.is_promised(begin.as_bytes()), is, "{begin}");
        }
        assert!(!own.is_promised(b"\xff\xff \xff?token="));
        for method in [Method::POST, Method::HEAD, Method::OPTIONS, Method::DELETE] {
            is(method, &with("/"), &["127.0.0.1:4000"], 405, None);
        }
        let usual = desk(80);
        let target = format!("/?token={}", usual.token.as_str());
        assert_eq!(asked(&usual, Method::GET, &target, &["127.0.0.1"]).0, 200, "the port need not be named");
        assert_eq!(asked(&usual, Method::GET, &target, &["localhost"]).0, 200);
    }
}
