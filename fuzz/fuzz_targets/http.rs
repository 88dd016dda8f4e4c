#![no_main]

use std::sync::LazyLock;
use voxelastic_fuzz::check_memory;
use voxelastic_live::fuzzing::Server;

static VIEWER: LazyLock<Server> = LazyLock::new(Server::viewer);

/// What a client sends to the viewer.
fn ask(data: &[u8]) {
    let answer = VIEWER.answer(data);
    assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."));
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| ask(data));
