//! A headless Chromium that runs expressions in a page, over its DevTools socket.

use crate::Browser as Process;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// A browser with one page that runs expressions. Its calls panic when the page or the browser does not do what is asked.
#[derive(Debug)]
pub struct Page {
    /// Stopped when dropped.
    _process: Process,
    socket: Option<WebSocket<TcpStream>>,
    calls: u64,
}

impl Page {
    /// Opens `url`; none, after noting the skip, without a browser. `profile` is a folder of its own.
    ///
    /// # Panics
    /// When the browser does not answer.
    pub fn open(url: &str, profile: &Path) -> Option<Self> {
        let flags = ["--remote-debugging-port=0", "--window-size=1000,700"];
        let process = Process::open(url, profile, &flags)?;
        let mut browser = Self { _process: process, socket: None, calls: 0 };
        let clock = Instant::now();
        while browser.socket.is_none() {
            assert!(clock.elapsed() < Process::TIMEOUT, "the browser does not answer");
            std::thread::sleep(Duration::from_millis(100));
            browser.socket = attach(profile, url);
        }
        Some(browser)
    }

    /// The answer to a method of the DevTools protocol.
    pub fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.calls += 1;
        let (id, socket) = (self.calls, self.socket.as_mut().unwrap());
        socket.send(Message::text(json!({ "id": id, "method": method, "params": parameters }).to_string())).unwrap();
        loop {
            let answer = socket.read().unwrap();
            let answer: Value = serde_json::from_slice(&answer.into_data()).unwrap_or_default();
            if answer["id"] == id {
                return answer["result"].clone();
            }
        }
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let answer = self.call("Runtime.evaluate", &json!({ "expression": expression, "returnByValue": true, "awaitPromise": true }));
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait(&mut self, expression: &str) {
        let clock = Instant::now();
        while self.value(expression) != true {
            let state = self.value("JSON.stringify({ text: document.body.innerText, seen: window.voxelastic && String(voxelastic.seen.messages) })");
            assert!(clock.elapsed() < Process::TIMEOUT, "never: {expression}; {state}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// The socket of the page, once the browser has one.
fn attach(profile: &Path, url: &str) -> Option<WebSocket<TcpStream>> {
    let port: u16 = std::fs::read_to_string(profile.join("DevToolsActivePort")).ok()?.lines().next()?.parse().ok()?;
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    write!(stream, "GET /json/list HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    let _ = stream.read_to_string(&mut answer);
    let pages: Value = serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()?;
    let page = pages.as_array()?.iter().find(|page| page["url"].as_str().is_some_and(|at| at.starts_with(url)))?;
    let stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(Process::TIMEOUT)).ok()?;
    let config = tungstenite::protocol::WebSocketConfig::default().max_message_size(None).max_frame_size(None);
    Some(tungstenite::client::client_with_config(page["webSocketDebuggerUrl"].as_str()?, stream, Some(config)).ok()?.0)
}
