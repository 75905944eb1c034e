use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
};

use serde_json::Value;

use crate::until;

/// A session's page, asked as a browser would ask it.
#[derive(Debug, Clone)]
pub struct Page {
    host: String,
    path: String,
}

impl Page {
    /// At the address that the session printed.
    ///
    /// # Panics
    /// When that is no address.
    pub fn at(url: &str) -> Self {
        let rest = url.strip_prefix("http://").unwrap_or_else(|| panic!("{url:?} is no address"));
        let (host, path) = rest.split_once('/').expect("the address has a path");
        Self { host: host.to_owned(), path: format!("/{path}") }
    }

    /// Sends a request as it is, but for the host and what `extra` adds; gives the status and the body.
    ///
    /// # Panics
    /// When there is no answer.
    pub fn request(&self, method: &str, below: &str, extra: &str, body: &str) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.host).expect("the session listens");
        write!(
            stream,
            "{method} {}{below} HTTP/1.1\r\nHost: {}\r\nContent-Length: {}\r\n{extra}\r\n{body}",
            self.path,
            self.host,
            body.len()
        )
        .expect("sent");
        // Not every server closes the connection when it has answered.
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        let (mut status, mut length) = (0, 0);
        while reader.read_line(&mut line).expect("answered") > 2 {
            if let Some(rest) = line.strip_prefix("HTTP/1.1 ") {
                status = rest[..3].parse().expect("a status");
            } else if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse().expect("a length");
            }
            line.clear();
        }
        let mut bytes = vec![0; length];
        reader.read_exact(&mut bytes).expect("answered whole");
        (status, bytes)
    }

    /// What lies at `below`.
    ///
    /// # Panics
    /// When it is not there.
    pub fn get(&self, below: &str) -> Vec<u8> {
        let (status, body) = self.request("GET", below, "", "");
        assert_eq!(status, 200, "{below}: {}", String::from_utf8_lossy(&body));
        body
    }

    /// JSON at `below`.
    ///
    /// # Panics
    /// When it is not there, or no JSON.
    pub fn json(&self, below: &str) -> Value {
        serde_json::from_slice(&self.get(below)).expect("JSON")
    }

    /// Gives a command; the error is what the session says to it.
    ///
    /// # Errors
    /// What the session answers.
    pub fn act(&self, command: &Value) -> Result<(), String> {
        let (status, body) =
            self.request("POST", "act", "Content-Type: application/json\r\n", &command.to_string());
        if status == 200 { Ok(()) } else { Err(String::from_utf8_lossy(&body).into_owned()) }
    }

    /// The state once `check` holds of it. A session that has just begun has none yet, and says so.
    ///
    /// # Panics
    /// When it does not in the watchdog's time.
    pub fn state_when(&self, what: &str, check: impl Fn(&Value) -> bool) -> Value {
        until(what, || {
            let (status, body) = self.request("GET", "state", "", "");
            assert!(matches!(status, 200 | 404), "{status}: {}", String::from_utf8_lossy(&body));
            (status == 200).then(|| serde_json::from_slice(&body).expect("JSON")).filter(&check)
        })
    }
}
