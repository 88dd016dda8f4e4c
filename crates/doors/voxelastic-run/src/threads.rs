//! Thread pools.

use crate::{Error, Result};

/// As many threads may be asked for on any machine.
const LEAST_LIMIT: usize = 16;

/// A thread pool of `threads` threads, 0 for all cores. Many more than there are cores only cost time, so they are not started.
///
/// # Errors
/// When the system refuses the threads.
pub fn pool(threads: usize) -> Result<rayon::ThreadPool> {
    let most = (4 * std::thread::available_parallelism().map_or(1, usize::from)).max(LEAST_LIMIT);
    if threads > most {
        tracing::warn!("{threads} threads are more than four for each core: {most} are used");
    }
    let threads = threads.min(most);
    let built = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("worker {i}")).build();
    built.map_err(|e| Error::new(format!("cannot start {threads} threads: {e}"), "use fewer with --threads"))
}
