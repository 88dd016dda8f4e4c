//! Ctrl-C: the first requests an orderly end, the second ends the process at once.

use crate::failure::INTERRUPTED;
use std::sync::atomic::{AtomicBool, Ordering};

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Handles Ctrl-C, termination requests and hang-ups. `promise` is printed at the first: what happens next.
pub fn install(promise: &'static str) {
    let handler = move || {
        if REQUESTED.swap(true, Ordering::SeqCst) {
            std::process::exit(i32::from(INTERRUPTED));
        }
        tracing::warn!("interrupted: {promise} (interrupt again to stop at once)");
    };
    // Without a handler, Ctrl-C ends the program at once.
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::warn!("Ctrl-C will end the program without saving: {error}");
    }
}

/// Whether an interrupt was requested.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
