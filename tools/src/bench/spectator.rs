use std::{
    net::TcpStream,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket, client::IntoClientRequest as _, http::HeaderValue};

/// The protocol of Foxglove's viewers.
const PROTOCOL: &str = "foxglove.sdk.v1";
/// How long it waits before it tries to connect again, and looks whether it is to leave.
const PATIENCE: Duration = Duration::from_millis(100);

/// A viewer that looks at every topic which `netcord view` offers, and draws nothing.
#[derive(Debug)]
pub struct Spectator {
    leave: Arc<AtomicBool>,
    thread: JoinHandle<u64>,
}

impl Spectator {
    /// Looks at what is, or will be, served on this port of this machine.
    pub fn attach(port: u16) -> Self {
        let leave = Arc::new(AtomicBool::new(false));
        let told = leave.clone();
        let thread = std::thread::spawn(move || {
            let mut messages = 0;
            // Relaxed: nothing else is shared.
            while !told.load(Ordering::Relaxed) {
                match connect(port) {
                    Some(socket) => messages += watch(socket, &told),
                    None => std::thread::sleep(PATIENCE),
                }
            }
            messages
        });
        Self { leave, thread }
    }

    /// Leaves, and says how many messages came.
    pub fn leave(self) -> u64 {
        self.leave.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or(0)
    }
}

fn connect(port: u16) -> Option<WebSocket<TcpStream>> {
    let stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(PATIENCE)).ok()?;
    let mut request = format!("ws://127.0.0.1:{port}").into_client_request().ok()?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static(PROTOCOL));
    Some(tungstenite::client(request, stream).ok()?.0)
}

/// Subscribes to all that is advertised and counts what comes, until told to leave or the server goes.
fn watch(mut socket: WebSocket<TcpStream>, leave: &AtomicBool) -> u64 {
    let mut messages = 0;
    while !leave.load(Ordering::Relaxed) {
        let answer = match socket.read() {
            Ok(Message::Text(text)) => subscription(text.as_str()),
            Ok(Message::Binary(_)) => {
                messages += 1;
                None
            }
            Ok(Message::Close(_)) => break,
            Ok(_) => None,
            Err(tungstenite::Error::Io(e))
                if matches!(e.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
            {
                None
            }
            Err(_) => break,
        };
        if let Some(answer) = answer
            && socket.send(Message::text(answer)).is_err()
        {
            break;
        }
    }
    messages
}

/// What subscribes to the channels that a message advertises.
fn subscription(text: &str) -> Option<String> {
    let message: Value = serde_json::from_str(text).ok()?;
    if message["op"] != "advertise" {
        return None;
    }
    let channels = message["channels"].as_array()?;
    let wanted: Vec<Value> =
        channels.iter().map(|c| json!({ "id": c["id"], "channelId": c["id"] })).collect();
    Some(json!({ "op": "subscribe", "subscriptions": wanted }).to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_is_advertised_is_subscribed_to() {
        let said = r#"{"op":"advertise","channels":[{"id":3,"topic":"/tf"},{"id":8,"topic":"/scene"}]}"#;
        let answer: Value = serde_json::from_str(&subscription(said).expect("channels")).expect("JSON");
        let expected = json!([{ "id": 3, "channelId": 3 }, { "id": 8, "channelId": 8 }]);
        assert_eq!((&answer["op"], &answer["subscriptions"]), (&json!("subscribe"), &expected));
        assert_eq!(subscription(r#"{"op":"serverInfo"}"#), None);
    }
}
