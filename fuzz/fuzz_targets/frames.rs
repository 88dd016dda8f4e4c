#![no_main]

use std::sync::LazyLock;
use voxelastic_fuzz::check_memory;
use voxelastic_live::fuzzing::Server;

static VIEWER: LazyLock<Server> = LazyLock::new(Server::viewer);
static FOXGLOVE: LazyLock<Server> = LazyLock::new(Server::foxglove);

/// What a client sends once it has a WebSocket. Odd first byte: to Foxglove's port; from the second bit on: pieces with a length each are texts in whole frames.
fn ask(data: &[u8]) {
    let Some((kind, mut data)) = data.split_first() else { return };
    let (server, path) = if kind & 1 == 1 { (&*FOXGLOVE, "/") } else { (&*VIEWER, "/socket") };
    let request = format!(
        "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    );
    let mut sent = Vec::new();
    while let Some((length, rest)) = data.split_first().filter(|_| kind & 2 == 2) {
        let (text, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        // Masked by zeros.
        sent.extend([0x81, 0x80 | 126, 0, text.len() as u8, 0, 0, 0, 0]);
        sent.extend(text);
        data = rest;
    }
    sent.extend(data);
    assert!(server.answer_then(request.as_bytes(), &sent).starts_with(b"HTTP/1.1 101"));
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| ask(data));
