//! Spinning threads while a scan is integrated, with useful work in between.
//!
//! Integrating a scan takes some twenty parallel steps with sequential work in between. A thread without work for some microseconds goes to
//! sleep; waking it takes tens of microseconds, and more on a virtual machine that may have given its processor away.

use rayon::Yield;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time without work after which a thread may sleep: the rest of the scan does not need it.
const MAX_SPIN: Duration = Duration::from_millis(3);

/// Work for threads that are idle while a scan is integrated, such as decoding the next scan.
#[derive(Clone)]
pub struct IdleTask(Arc<dyn Fn() -> bool + Send + Sync>);

impl IdleTask {
    /// A task of which each call of `step` does a part, about a millisecond of work, and returns whether there was any.
    pub fn new(step: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(step))
    }

    /// Does a part of it; returns whether there was any.
    pub fn run(&self) -> bool {
        self.0()
    }
}

impl fmt::Debug for IdleTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("IdleTask").finish_non_exhaustive()
    }
}

/// Does `work` and keeps the other threads of the current pool awake meanwhile. They do the idle task, and yield to other programs.
pub(crate) fn keep_threads_awake<R>(task: Option<IdleTask>, work: impl FnOnce() -> R) -> R {
    let Some(here) = rayon::current_thread_index().filter(|_| rayon::current_num_threads() > 1) else { return work() };
    let done = Arc::new(AtomicBool::new(false));
    let is_done = Arc::clone(&done);
    rayon::spawn_broadcast(move |thread| {
        // The calling thread may execute this while it waits for another thread.
        if thread.index() == here {
            return;
        }
        let mut idle_since = Instant::now();
        while !is_done.load(Ordering::Relaxed) && idle_since.elapsed() < MAX_SPIN {
            match rayon::yield_now() {
                Some(Yield::Executed) => idle_since = Instant::now(),
                _ if task.as_ref().is_some_and(IdleTask::run) => idle_since = Instant::now(),
                _ => std::thread::yield_now(),
            }
        }
    });
    let result = work();
    done.store(true, Ordering::Relaxed);
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::atomic::AtomicU32;

    /// Parallel steps with short and long pauses in between.
    fn steps() -> u64 {
        let step = |n: u64| {
            std::thread::sleep(if n.is_multiple_of(3) { 2 * MAX_SPIN } else { MAX_SPIN / 10 });
            (0..10_000u32).into_par_iter().with_min_len(16).map(|i| u64::from(i) * n).sum::<u64>()
        };
        (1..7).map(step).sum()
    }

    #[test]
    fn works_in_pools_of_any_size_and_outside_of_pools() {
        assert_eq!(keep_threads_awake(None, steps), 21 * 49_995_000);
        for threads in [1, 2, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for _ in 0..3 {
                assert_eq!(pool.install(|| keep_threads_awake(None, steps)), 21 * 49_995_000, "{threads} threads");
            }
        }
    }

    #[test]
    fn idle_threads_do_the_task() {
        let done = Arc::new(AtomicU32::new(0));
        let count = Arc::clone(&done);
        let task = IdleTask::new(move || count.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| (n < 5).then_some(n + 1)).is_ok());
        let do_with = |threads| {
            done.store(0, Ordering::Relaxed);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| keep_threads_awake(Some(task.clone()), steps)), 21 * 49_995_000);
            done.load(Ordering::Relaxed)
        };
        assert_eq!([do_with(1), do_with(2), do_with(4)], [0, 5, 5]);
    }

    #[test]
    fn a_panic_releases_the_other_threads() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let fails = || pool.install(|| keep_threads_awake(None, || panic!("on purpose")));
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(fails));
        assert!(caught.is_err());
        assert_eq!(pool.install(|| keep_threads_awake(None, steps)), 21 * 49_995_000);
        drop(pool);
    }
}
