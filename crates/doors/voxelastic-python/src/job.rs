//! Thread pools, and long calls: without the interpreter lock, ended by Ctrl-C.

use crate::errors;
use pyo3::exceptions::PyRuntimeError;
use pyo3::{PyResult, Python, pyfunction};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use voxelastic::memory::MemorySize;

/// Time between two looks for Ctrl-C.
const TICK: Duration = Duration::from_millis(50);

/// A thread pool and the process that has its threads.
type OwnedPool = (u32, Arc<ThreadPool>);

/// The pool for maps.
static SHARED: Mutex<Option<OwnedPool>> = Mutex::new(None);

/// The share of this process in the machine, threads; 0 for one per core.
static SHARE: AtomicUsize = AtomicUsize::new(0);

/// Limits the threads of this process, for one of several on a machine: the shared pool, and pools made later that are not of a given size. 0 for one per core.
#[pyfunction]
pub fn use_threads(threads: usize) {
    if SHARE.swap(threads, Ordering::Relaxed) != threads {
        // The next call makes another one. Calls under way have that of before, which ends with the last of them.
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if shared.as_ref().is_some_and(|(owner, _)| *owner == std::process::id()) {
            *shared = None;
        }
    }
}

/// Limits the memory of this process to `size`, see [`voxelastic::memory::limit`].
#[pyfunction]
pub fn limit_memory(py: Python<'_>, size: &str, folder: Option<PathBuf>) -> PyResult<()> {
    let refused = |why: String| errors::Kind::Setting.exception(py, why);
    let MemorySize(bytes) = size.parse().map_err(|error| refused(format!("{size}: {error}")))?;
    voxelastic::memory::limit(bytes, folder.as_deref()).map_err(|error| refused(error.to_string()))
}

/// Size of a piece of memory, bytes, that comes from the memory of a thread and is large enough that the C library tidies that up when it is freed.
const TIDIED_UP: usize = 100 << 10;

/// Allocates and frees in every thread of the shared pool, and in new ones, which take over the memory of those that ended: the C library keeps memory for each thread,
/// and looks whether it is too much only when something is freed there.
#[pyfunction]
pub fn free_in_every_thread(py: Python<'_>) -> PyResult<()> {
    let allocate_and_free = || drop(std::hint::black_box(Vec::<u8>::with_capacity(TIDIED_UP)));
    let pool = shared_pool()?;
    run_short(py, || {
        pool.broadcast(|_| allocate_and_free());
        let gate = Mutex::new(());
        std::thread::scope(|scope| {
            let wait = || {
                allocate_and_free();
                drop(gate.lock());
            };
            // While all of them wait, each has memory of its own.
            let closed = gate.lock();
            for _ in 0..pool.current_num_threads() + 2 {
                // Where the system gives no more threads, some memory stays.
                let _ = std::thread::Builder::new().spawn_scoped(scope, wait);
            }
            drop(closed);
        });
    })
}

/// The pool in which maps are opened, meshed and queried, with a thread per core, or as many as [`use_threads`] says. A process that was forked gets one of its
/// own: threads are not forked.
pub fn shared_pool() -> PyResult<Arc<ThreadPool>> {
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some((_, pool)) = shared.as_ref().filter(|(owner, _)| *owner == process) {
        return Ok(Arc::clone(pool));
    }
    let pool = Arc::new(new_pool(0)?);
    // That of the parent is not dropped: it would wait for threads that are not there.
    std::mem::forget(shared.replace((process, Arc::clone(&pool))));
    Ok(pool)
}

/// A pool of `threads` threads; 0 for one per core, or as many as [`use_threads`] says.
pub fn new_pool(threads: usize) -> PyResult<ThreadPool> {
    let threads = if threads == 0 { SHARE.load(Ordering::Relaxed) } else { threads };
    let built = ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("voxelastic {i}")).build();
    built.map_err(|error| PyRuntimeError::new_err(format!("cannot start {threads} threads: {error}; use fewer with `threads`")))
}

/// Does `work` in a thread of its own, without the interpreter lock. On Ctrl-C the call ends at once with `KeyboardInterrupt`, and the work ends in the
/// background: it owns what it works on.
pub fn run<R: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> R + Send + 'static) -> PyResult<R> {
    let (send, mut receive) = sync_channel(1);
    let job = move || {
        // After Ctrl-C nobody takes the result.
        let _ = send.send(catch_unwind(AssertUnwindSafe(work)));
    };
    let started = std::thread::Builder::new().name("voxelastic job".to_owned()).spawn(job);
    started.map_err(|error| PyRuntimeError::new_err(format!("cannot start a thread: {error}")))?;
    loop {
        let done;
        (done, receive) = py.detach(move || (receive.recv_timeout(TICK), receive));
        match done {
            Ok(done) => return done.map_err(|payload| errors::bug(&*payload)),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => return Err(errors::bug(&"a thread ended early")),
        }
    }
}

/// Does `work`, which takes some milliseconds, without the interpreter lock.
pub fn run_short<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_err(|payload| errors::bug(&*payload))
}
