use std::{
    fs,
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Duration,
};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket, client};

use crate::{Running, WATCHDOG, until};

/// Chromium without a window, remote-controlled by its DevTools protocol.
#[derive(Debug)]
pub struct Browser {
    socket: WebSocket<TcpStream>,
    last: u64,
    /// What pages have complained of: exceptions, and what the console calls an error.
    complaints: Vec<String>,
    _process: Running,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Where Debian's Chromium is, if it is installed (`tests/chromium.sh` does that).
    pub fn installed() -> Option<PathBuf> {
        let path = Path::new("/usr/bin/chromium");
        path.exists().then(|| path.to_owned())
    }

    /// Opens `url` in a window of `width` × `height` px.
    ///
    /// # Panics
    /// When the browser does not start.
    pub fn open(chromium: &Path, url: &str, (width, height): (u32, u32)) -> Self {
        let profile = tempfile::Builder::new().prefix("netcord-chromium-").tempdir().expect("a folder");
        let mut command = Command::new(chromium);
        command
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
            ])
            .args(["--remote-debugging-port=0", "--hide-scrollbars", "--force-color-profile=srgb"])
            .arg(format!("--window-size={width},{height}"))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            // It is killed in the end, and then leaves what it has in its temporary folder.
            .env("TMPDIR", profile.path())
            .stdin(Stdio::null());
        let process = Running::start(command);
        let port_file = profile.path().join("DevToolsActivePort");
        let port: u16 =
            until("Chromium's port", || fs::read_to_string(&port_file).ok()?.lines().next()?.parse().ok());
        let target = until("a page in Chromium", || {
            let list = crate::Page::at(&format!("http://127.0.0.1:{port}/")).json("json/list");
            let pages = list.as_array()?.clone();
            let page = pages.iter().find(|t| t["type"] == "page")?;
            page["webSocketDebuggerUrl"].as_str().map(str::to_owned)
        });
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("Chromium listens");
        stream.set_read_timeout(Some(WATCHDOG)).expect("set");
        let (socket, _) = client(target.as_str(), stream).expect("DevTools");
        let mut browser =
            Self { socket, last: 0, complaints: Vec::new(), _process: process, _profile: profile };
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", metrics);
        browser.call("Page.navigate", json!({ "url": url }));
        browser
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.last += 1;
        let id = self.last;
        let text = json!({ "id": id, "method": method, "params": params }).to_string();
        self.socket.send(Message::text(text)).expect("sent");
        loop {
            let Message::Text(text) = self.socket.read().expect("Chromium answers") else { continue };
            let message: Value = serde_json::from_str(text.as_str()).expect("JSON");
            if message["id"] == id {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            let entry = &message["params"]["entry"];
            if message["method"] == "Runtime.exceptionThrown" {
                self.complaints.push(message["params"]["exceptionDetails"].to_string());
            } else if message["method"] == "Log.entryAdded" && entry["level"] == "error" {
                self.complaints.push(entry.to_string());
            }
        }
    }

    /// The value of a JavaScript expression in the page.
    ///
    /// # Panics
    /// When it throws.
    pub fn value(&mut self, expression: &str) -> Value {
        let params = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", params);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Waits until a JavaScript expression is true.
    ///
    /// # Panics
    /// When it is not in the watchdog's time.
    pub fn wait_for(&mut self, expression: &str) {
        until(expression, || {
            let found = self.value(&format!("Boolean({expression})")) == true;
            if !found {
                std::thread::sleep(Duration::from_millis(50));
            }
            found.then_some(())
        });
    }

    /// Clicks with the mouse on the middle of what `selector` finds, as a person does: what lies under something
    /// else, or is disabled, is not clicked.
    ///
    /// # Panics
    /// When there is no such thing to be clicked.
    pub fn click(&mut self, selector: &str) {
        let quoted = json!(selector);
        self.wait_for(&format!(
            "(() => {{ const e = document.querySelector({quoted}); if (!e || e.disabled) return false; \
             const r = e.getBoundingClientRect(); \
             const top = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2); return e.contains(top); }})()"
        ));
        let at = self.value(&format!(
            "(() => {{ const r = document.querySelector({quoted}).getBoundingClientRect(); \
             return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": at[0], "y": at[1], "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", event);
        }
    }

    /// What pages have complained of so far.
    pub fn complaints(&mut self) -> &[String] {
        // An answer to anything comes after all complaints before it.
        self.value("0");
        &self.complaints
    }
}
