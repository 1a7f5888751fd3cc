//! A connection whose other end must read: after some time without a byte taken, writing fails.

use std::io::{ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

/// A connection with a time limit on every write.
#[derive(Debug)]
pub(super) struct Patient {
    stream: TcpStream,
    patience: Duration,
    /// Runs while nothing is taken.
    end: Option<Pin<Box<Sleep>>>,
}

impl Patient {
    pub(super) fn new(stream: TcpStream, patience: Duration) -> Self {
        Self { stream, patience, end: None }
    }

    pub(super) fn into_inner(self) -> TcpStream {
        self.stream
    }

    fn within<T>(&mut self, context: &mut Context<'_>, written: Poll<Result<T>>) -> Poll<Result<T>> {
        if written.is_ready() {
            self.end = None;
            return written;
        }
        let patience = self.patience;
        let end = self.end.get_or_insert_with(|| Box::pin(sleep(patience)));
        end.as_mut().poll(context).map(|()| Err(ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Patient {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, into)
    }
}

impl AsyncWrite for Patient {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.within(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        self.within(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;
    use std::io::Read;
    use std::time::Instant;

    use super::*;

    /// Writes until it fails; how much was taken.
    async fn fill(to: &mut Patient) -> (usize, ErrorKind) {
        let (mut taken, bytes) = (0, [7; 1 << 16]);
        loop {
            match poll_fn(|context| Pin::new(&mut *to).poll_write(context, &bytes)).await {
                Ok(n) => taken += n,
                Err(e) => return (taken, e.kind()),
            }
        }
    }

    #[test]
    fn who_does_not_read_is_given_up_and_who_reads_slowly_is_not() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
            let address = listener.local_addr().expect("an address");
            let mut reader = std::net::TcpStream::connect(address).expect("connects");
            let (stream, _) = listener.accept().await.expect("accepts");
            let patience = Duration::from_millis(400);
            let mut patient = Patient::new(stream, patience);
            let begun = Instant::now();
            let (taken, why) = fill(&mut patient).await;
            assert_eq!(why, ErrorKind::TimedOut, "after {taken} bytes");
            assert!(begun.elapsed() >= patience && begun.elapsed() < 20 * patience, "{:?}", begun.elapsed());

            // All that was taken and as much again, with rests shorter than the limit: longer together than it.
            let (stream, patience) = (patient.into_inner(), 2 * patience);
            let slow = std::thread::spawn(move || {
                let (mut read, mut some) = (0, vec![0; taken.div_ceil(8)]);
                while read < 2 * taken {
                    std::thread::sleep(Duration::from_millis(60));
                    read += reader.read(&mut some).expect("reads");
                }
            });
            let begun = Instant::now();
            let (more, why) = fill(&mut Patient::new(stream, patience)).await;
            assert!(more >= taken && begun.elapsed() > patience, "{more} of {taken}: {why}");
            slow.join().expect("read");
        });
    }
}
