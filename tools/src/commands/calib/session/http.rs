//! A small HTTP/1.1 server: one request a connection, a thread each, everything bounded.

use std::{
    io::{self, BufReader, Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use netcord_common::Shutdown;

/// A request, read whole.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// `GET`, `POST` …
    pub method: String,
    /// What is asked for, up to the question mark.
    pub path: String,
    /// Names and values after the question mark, decoded.
    pub query: Vec<(String, String)>,
    /// Names in lower case, and values.
    pub headers: Vec<(String, String)>,
    /// The body.
    pub body: Vec<u8>,
}

impl Request {
    /// The value of a header, its name in lower case.
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    /// The value of a part of the query.
    pub fn query(&self, name: &str) -> Option<&str> {
        self.query.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }
}

/// An answer.
#[derive(Debug)]
pub struct Response {
    /// Status code.
    pub status: u16,
    /// Media type.
    pub kind: &'static str,
    /// The body.
    pub body: Vec<u8>,
}

impl Response {
    /// With a body of text.
    pub fn text(status: u16, text: impl Into<String>) -> Self {
        Self { status, kind: "text/plain; charset=utf-8", body: text.into().into_bytes() }
    }

    /// With a body of JSON.
    pub fn json(text: impl Into<Vec<u8>>) -> Self {
        Self { status: 200, kind: "application/json", body: text.into() }
    }

    /// With any body.
    pub fn of(kind: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status: 200, kind, body: body.into() }
    }
}

/// The page loads nothing from elsewhere, nothing else may frame it, and its address (which holds the token) is
/// told to nobody.
const SECURITY: &str = "Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
                        img-src 'self'; connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'\r\n\
                        Referrer-Policy: no-referrer\r\nX-Content-Type-Options: nosniff\r\nCache-Control: no-store\r\n\
                        Cross-Origin-Resource-Policy: same-origin\r\n";

/// Longest request line with headers, bytes.
const HEAD_LIMIT: usize = 16 * 1024;
/// Longest body, bytes: commands are a line of JSON.
const BODY_LIMIT: usize = 64 * 1024;
/// What is taken and thrown away of a request that was refused, bytes.
const DRAIN_LIMIT: u64 = 1024 * 1024;
/// Requests that are answered at the same time.
const CONNECTIONS: usize = 64;
/// How long a peer may take to send or receive.
const PATIENCE: Duration = Duration::from_secs(10);

/// Answers requests by `answer`, on a thread of its own, until `stop`. Returns the address that it listens on.
///
/// # Errors
/// When the address cannot be listened on.
pub fn serve(
    address: SocketAddr,
    stop: Shutdown,
    answer: impl Fn(&Request) -> Response + Send + Sync + 'static,
) -> io::Result<(SocketAddr, thread::JoinHandle<()>)> {
    let listener = TcpListener::bind(address)?;
    let local = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let (answer, open) = (Arc::new(answer), Arc::new(AtomicUsize::new(0)));
    let handle = thread::Builder::new().name("http".into()).spawn(move || {
        while !stop.is_requested() {
            let Ok((stream, _)) = listener.accept() else {
                thread::sleep(Duration::from_millis(10));
                continue;
            };
            // Relaxed: only the number matters.
            if open.fetch_add(1, Ordering::Relaxed) >= CONNECTIONS {
                open.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            let (answer, open_here) = (Arc::clone(&answer), Arc::clone(&open));
            let spawned = thread::Builder::new().name("http-peer".into()).spawn(move || {
                if let Err(e) = converse(stream, answer.as_ref()) {
                    tracing::debug!("a page's request was cut off: {e}");
                }
                open_here.fetch_sub(1, Ordering::Relaxed);
            });
            if spawned.is_err() {
                open.fetch_sub(1, Ordering::Relaxed);
            }
        }
    })?;
    Ok((local, handle))
}

fn converse(stream: TcpStream, answer: &dyn Fn(&Request) -> Response) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    stream.set_nodelay(true)?;
    let response = match read(&stream)? {
        Ok(request) => answer(&request),
        Err(refusal) => refusal,
    };
    let mut out = &stream;
    write!(
        out,
        "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n{SECURITY}Connection: close\r\n\r\n",
        response.status,
        phrase(response.status),
        response.kind,
        response.body.len()
    )?;
    out.write_all(&response.body)?;
    out.flush()?;
    // Closed with something unread, the connection is reset, and the peer may lose the answer: what a refused
    // request still sends is taken, within bounds.
    stream.shutdown(std::net::Shutdown::Write)?;
    io::copy(&mut (&stream).take(DRAIN_LIMIT), &mut io::sink()).map(|_| ())
}

const fn phrase(status: u16) -> &'static str {
    match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        409 => "Conflict",
        413 => "Content Too Large",
        431 => "Request Header Fields Too Large",
        _ => "Internal Server Error",
    }
}

/// Reads one request; the inner error is an answer to a request that cannot be.
fn read(stream: &TcpStream) -> io::Result<Result<Request, Response>> {
    let mut reader = BufReader::new(stream);
    let mut bytes = Vec::new();
    loop {
        let mut chunk = [0; 4096];
        let got = reader.read(&mut chunk)?;
        if got == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        bytes.extend_from_slice(&chunk[..got]);
        match head(&bytes) {
            Ok(Some((_, length))) if length > HEAD_LIMIT => {
                return Ok(Err(Response::text(431, "The headers are too long.")));
            }
            Ok(Some((mut request, length))) => {
                let wanted = request.header("content-length").map_or(Ok(0), str::parse::<usize>);
                let Ok(wanted) = wanted else {
                    return Ok(Err(Response::text(400, "The Content-Length is no number.")));
                };
                if wanted > BODY_LIMIT || request.header("transfer-encoding").is_some() {
                    return Ok(Err(Response::text(413, "The body is too long, or of no given length.")));
                }
                request.body = bytes.split_off(length);
                let have = request.body.len().min(wanted);
                request.body.resize(wanted, 0);
                reader.read_exact(&mut request.body[have..])?;
                return Ok(Ok(request));
            }
            Ok(None) if bytes.len() > HEAD_LIMIT => {
                return Ok(Err(Response::text(431, "The headers are too long.")));
            }
            Ok(None) => {}
            Err(what) => return Ok(Err(Response::text(400, what))),
        }
    }
}

/// The request line and headers at the start of `bytes`, and their length; `None` while they are not whole.
fn head(bytes: &[u8]) -> Result<Option<(Request, usize)>, String> {
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut parsed = httparse::Request::new(&mut headers);
    let length = match parsed.parse(bytes).map_err(|e| format!("This is no HTTP request: {e}."))? {
        httparse::Status::Complete(length) => length,
        httparse::Status::Partial => return Ok(None),
    };
    let target = parsed.path.unwrap_or_default();
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let text = |part: &str| urlencoding::decode(part).map(|t| t.into_owned()).map_err(|e| e.to_string());
    let query = query
        .split('&')
        .filter(|p| !p.is_empty())
        .map(|part| {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            Ok((text(name)?, text(value)?))
        })
        .collect::<Result<_, String>>()?;
    let headers = parsed
        .headers
        .iter()
        .map(|h| (h.name.to_ascii_lowercase(), String::from_utf8_lossy(h.value).into_owned()))
        .collect();
    let method = parsed.method.unwrap_or_default().to_owned();
    Ok(Some((Request { method, path: text(path)?, query, headers, body: Vec::new() }, length)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(address: SocketAddr, text: &[u8]) -> String {
        let mut stream = TcpStream::connect(address).expect("listens");
        stream.write_all(text).expect("sent");
        let mut answer = String::new();
        // A refusal may come before all has been read.
        let _ = stream.read_to_string(&mut answer);
        answer
    }

    #[test]
    fn requests_are_answered_and_nonsense_is_refused() {
        let stop = Shutdown::new();
        let echo = |r: &Request| {
            let body = String::from_utf8_lossy(&r.body).into_owned();
            Response::text(200, format!("{} {} {:?} {body}", r.method, r.path, r.query("a")))
        };
        let (address, server) =
            serve("127.0.0.1:0".parse().expect("valid"), stop.clone(), echo).expect("a port");
        let answer =
            ask(address, b"POST /x%20y?a=1%2B2&b HTTP/1.1\r\nHost: h\r\nContent-Length: 4\r\n\r\nbody");
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
        assert!(answer.ends_with("POST /x y Some(\"1+2\") body"), "{answer}");
        assert!(answer.contains("default-src 'none'") && answer.contains("no-referrer"), "{answer}");
        assert!(ask(address, b"\x16\x03\x01nonsense\r\n\r\n").starts_with("HTTP/1.1 400"));
        let long = format!("GET / HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(HEAD_LIMIT + 1));
        let answer = ask(address, long.as_bytes());
        assert!(answer.starts_with("HTTP/1.1 431"), "{answer}");
        let answer = ask(address, b"POST / HTTP/1.1\r\nContent-Length: 9999999\r\n\r\n");
        assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
        stop.request();
        server.join().expect("ends");
    }
}
