//! Ctrl-C: the first requests an orderly end, another one ends the process at once.

use crate::failure::STOPPED;
use crate::output;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// A signal so soon after the first is the same request: `timeout` signals a process and then its group, a terminal every process of a pipe.
const SAME_REQUEST: Duration = Duration::from_secs(1);

/// When an orderly end was requested.
static REQUESTED: OnceLock<Instant> = OnceLock::new();

/// Handles Ctrl-C, termination requests and hang-ups. `promise` is printed at the first: what happens next.
pub fn install(promise: &'static str) {
    let handler = move || {
        let now = Instant::now();
        let first = *REQUESTED.get_or_init(|| now);
        if first == now {
            tracing::warn!("interrupted: {promise} (interrupt again to stop at once, without saving)");
        } else if now.duration_since(first) > SAME_REQUEST {
            output::message("error: interrupted again: stopped at once; what was not saved yet is lost\n");
            std::process::exit(i32::from(STOPPED));
        }
    };
    // Without a handler, Ctrl-C ends the program at once.
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::warn!("Ctrl-C will end the program without saving: {error}");
    }
}

/// Whether an interrupt was requested.
pub fn requested() -> bool {
    REQUESTED.get().is_some()
}
