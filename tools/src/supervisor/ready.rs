use std::{
    ffi::OsString,
    io,
    os::{
        fd::{AsFd, BorrowedFd},
        linux::net::SocketAddrExt as _,
        unix::net::{SocketAddr, UnixDatagram},
    },
    sync::atomic::{AtomicU64, Ordering},
};

/// The listening end of systemd's readiness protocol for one child: the child sends `READY=1` to the
/// socket that `NOTIFY_SOCKET` names, whoever started it.
#[derive(Debug)]
pub(super) struct ReadySocket {
    socket: UnixDatagram,
    name: String,
}

impl ReadySocket {
    /// A fresh socket in the kernel's abstract namespace, which leaves no file behind.
    ///
    /// # Errors
    /// When no socket can be made.
    pub(super) fn open() -> io::Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        // Relaxed: only uniqueness matters.
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("netcord-up-{}-{number}", std::process::id());
        let socket = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name)?)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, name })
    }

    /// What the child's `NOTIFY_SOCKET` must be.
    pub(super) fn address(&self) -> OsString {
        format!("@{}", self.name).into()
    }

    /// Whether `READY=1` has come since the last look.
    pub(super) fn has_come(&self) -> bool {
        let mut ready = false;
        let mut datagram = [0; 1024];
        while let Ok(length) = self.socket.recv(&mut datagram) {
            ready |= datagram[..length].split(|b| *b == b'\n').any(|line| line == b"READY=1");
        }
        ready
    }
}

impl AsFd for ReadySocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ready_counts() {
        let listening = ReadySocket::open().expect("a socket");
        let address = SocketAddr::from_abstract_name(&listening.name).expect("a name");
        let child = UnixDatagram::unbound().expect("a socket");
        assert!(!listening.has_come());
        child.send_to_addr(b"STATUS=READY=1?\n", &address).expect("sent");
        assert!(!listening.has_come());
        child.send_to_addr(b"STATUS=at work\nREADY=1\n", &address).expect("sent");
        assert!(listening.has_come());
        assert!(!listening.has_come(), "it is told once");
    }
}
