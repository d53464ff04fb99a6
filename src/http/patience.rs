//! Clients that take nothing of their answer are cut off: each would otherwise keep a connection, and the file that it was
//! promised, for ever. hyper's timer ends with a request's head.

use std::future::Future;
use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, Sleep, sleep};

/// A stream on its way to a peer.
pub(super) trait Outgoing: AsyncWrite {
    /// Bytes that were written and that the peer has not taken, where the system tells.
    fn backlog(&self) -> Option<usize>;
}

impl Outgoing for TcpStream {
    #[cfg(target_os = "linux")]
    fn backlog(&self) -> Option<usize> {
        use std::os::fd::AsRawFd;
        let mut bytes: libc::c_int = 0;
        // SAFETY: the call only writes the given number.
        let asked = unsafe { libc::ioctl(self.as_raw_fd(), libc::TIOCOUTQ, &mut bytes) };
        usize::try_from(bytes).ok().filter(|_| asked == 0)
    }

    #[cfg(not(target_os = "linux"))]
    fn backlog(&self) -> Option<usize> {
        None
    }
}

/// A stream that fails with [`io::ErrorKind::TimedOut`] where a write waits and nothing goes out.
pub(super) struct Patient<S> {
    stream: S,
    patience: Duration,
    /// While a write waits.
    wait: Option<Wait>,
}

struct Wait {
    timer: Pin<Box<Sleep>>,
    backlog: Option<usize>,
}

impl<S: Outgoing + Unpin> Patient<S> {
    pub fn new(stream: S, patience: Duration) -> Patient<S> {
        Patient { stream, patience, wait: None }
    }

    fn attend<T>(&mut self, polled: Poll<io::Result<T>>, context: &mut Context<'_>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.wait = None;
            return polled;
        }
        let Patient { stream, patience, wait } = self;
        let wait = wait.get_or_insert_with(|| Wait { timer: Box::pin(sleep(*patience)), backlog: stream.backlog() });
        while wait.timer.as_mut().poll(context).is_ready() {
            // The system lets a writer go on only when it has room for a good deal more, which a slow line takes longer to make.
            let backlog = stream.backlog();
            if backlog.zip(wait.backlog).is_none_or(|(now, before)| now >= before) {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            wait.backlog = backlog;
            wait.timer.as_mut().reset(Instant::now() + *patience);
        }
        Poll::Pending
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Patient<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: Outgoing + Unpin> AsyncWrite for Patient<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.attend(polled, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.attend(polled, context)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_flush(context);
        self.attend(polled, context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(context);
        self.attend(polled, context)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    use super::*;

    impl Outgoing for DuplexStream {
        fn backlog(&self) -> Option<usize> {
            None
        }
    }

    #[tokio::test]
    async fn a_write_that_nobody_takes_ends() {
        let (stream, _peer) = duplex(64);
        let mut stream = Patient::new(stream, Duration::from_millis(20));
        let error = stream.write_all(&[0; 65]).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn what_is_taken_ends_the_wait() {
        let (stream, mut peer) = duplex(64);
        let mut stream = Patient::new(stream, Duration::from_secs(3600));
        stream.write_all(&[0; 64]).await.unwrap();
        for _ in 0..3 {
            tokio::select! {
                biased;
                _ = stream.write(&[0]) => panic!("there is no room"),
                () = std::future::ready(()) => {}
            }
            assert!(stream.wait.is_some());
            peer.read_u8().await.unwrap();
            stream.write_all(&[0]).await.unwrap();
            assert!(stream.wait.is_none());
        }
    }

    /// Never has room; so many bytes fewer wait each time that it is asked.
    struct SlowLine(Cell<usize>);

    impl Outgoing for SlowLine {
        fn backlog(&self) -> Option<usize> {
            let left = self.0.get();
            self.0.set(left.saturating_sub(1));
            Some(left)
        }
    }

    impl AsyncWrite for SlowLine {
        fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, _: &[u8]) -> Poll<io::Result<usize>> {
            Poll::Pending
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Pending
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Pending
        }
    }

    #[tokio::test]
    async fn a_slow_line_is_waited_for_while_anything_goes_out() {
        let mut stream = Patient::new(SlowLine(Cell::new(5)), Duration::from_millis(1));
        let error = stream.write(&[0]).await.unwrap_err();
        assert_eq!((error.kind(), stream.stream.0.get()), (io::ErrorKind::TimedOut, 0));
    }
}
