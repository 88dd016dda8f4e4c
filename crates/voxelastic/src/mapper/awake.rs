//! Threads that stay awake from the beginning of a scan to its end.
//!
//! A scan is some twenty parallel steps with work for one thread in between, and a thread that finds nothing to do for some microseconds falls asleep. To wake
//! it takes tens of microseconds more, above all on a virtual machine, where its processor may have been given to somebody else meanwhile.

use rayon::Yield;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A thread that had nothing to do for so long may sleep after all: what is left in the scan is evidently for others.
const LONGEST: Duration = Duration::from_millis(3);

/// Something useful for threads that have nothing to do while a scan is integrated, such as decoding the scan that comes next.
#[derive(Clone)]
pub struct Chore(Arc<dyn Fn() -> bool + Send + Sync>);

impl Chore {
    /// A chore of which a call of `some` does a piece, of a millisecond or so, and tells whether there was any.
    pub fn new(some: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(some))
    }

    /// Does a piece of it, and tells whether there was any.
    pub fn run(&self) -> bool {
        self.0()
    }
}

impl fmt::Debug for Chore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Chore").finish_non_exhaustive()
    }
}

/// Does `work`, and meanwhile keeps the other threads of the pool awake that it is called in. They do the `chore`, and let other programs go first.
pub(super) fn keeping_awake<R>(chore: Option<Chore>, work: impl FnOnce() -> R) -> R {
    let Some(here) = rayon::current_thread_index().filter(|_| rayon::current_num_threads() > 1) else { return work() };
    let done = Arc::new(AtomicBool::new(false));
    let is_done = Arc::clone(&done);
    rayon::spawn_broadcast(move |thread| {
        // This thread gets to it, if at all, while it waits for another one.
        if thread.index() == here {
            return;
        }
        let mut idle_since = Instant::now();
        while !is_done.load(Ordering::Relaxed) && idle_since.elapsed() < LONGEST {
            match rayon::yield_now() {
                Some(Yield::Executed) => idle_since = Instant::now(),
                _ if chore.as_ref().is_some_and(Chore::run) => idle_since = Instant::now(),
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

    /// Parallel steps with pauses of both kinds in between.
    fn steps() -> u64 {
        let step = |n: u64| {
            std::thread::sleep(if n.is_multiple_of(3) { 2 * LONGEST } else { LONGEST / 10 });
            (0..10_000u32).into_par_iter().with_min_len(16).map(|i| u64::from(i) * n).sum::<u64>()
        };
        (1..7).map(step).sum()
    }

    #[test]
    fn work_is_done_in_pools_of_any_size_and_in_none() {
        assert_eq!(keeping_awake(None, steps), 21 * 49_995_000);
        for threads in [1, 2, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for _ in 0..3 {
                assert_eq!(pool.install(|| keeping_awake(None, steps)), 21 * 49_995_000, "{threads} threads");
            }
        }
    }

    #[test]
    fn threads_with_nothing_to_do_do_the_chore() {
        let done = Arc::new(AtomicU32::new(0));
        let count = Arc::clone(&done);
        let chore = Chore::new(move || count.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| (n < 5).then_some(n + 1)).is_ok());
        let do_with = |threads| {
            done.store(0, Ordering::Relaxed);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| keeping_awake(Some(chore.clone()), steps)), 21 * 49_995_000);
            done.load(Ordering::Relaxed)
        };
        assert_eq!([do_with(1), do_with(2), do_with(4)], [0, 5, 5]);
    }

    #[test]
    fn a_panic_lets_the_others_go() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let fails = || pool.install(|| keeping_awake(None, || panic!("on purpose")));
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(fails));
        assert!(caught.is_err());
        assert_eq!(pool.install(|| keeping_awake(None, steps)), 21 * 49_995_000);
        drop(pool);
    }
}
