//! Memory of the process and processor time of a thread pool.

use std::time::Duration;

/// A line of `/proc/self/status` in bytes; none where there is no such file.
fn status(key: &str) -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(':'))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Resident memory now, bytes.
pub fn resident_bytes() -> Option<u64> {
    status("VmRSS")
}

/// Peak resident memory of the process, bytes.
pub fn peak_resident_bytes() -> Option<u64> {
    status("VmHWM")
}

/// Bytes as megabytes (10^6).
pub fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

/// Reads the processor time of the threads of a pool, without waking any of them: a thread that the system does not schedule would keep the
/// reader waiting.
#[derive(Debug)]
pub struct PoolClock {
    clocks: Vec<ThreadClock>,
}

impl PoolClock {
    /// The clock of `pool`. Waits until each thread of it has run once.
    pub fn new(pool: &rayon::ThreadPool) -> Self {
        Self { clocks: pool.broadcast(|_| ThreadClock::current()) }
    }

    /// Processor time of all threads of the pool so far; none where the system does not report it. Other threads, such as those that decode
    /// or write files, do not count.
    pub fn now(&self) -> Option<Duration> {
        self.clocks.iter().map(ThreadClock::now).sum()
    }
}

/// The clock of one thread. Only Linux lets other threads read it.
#[derive(Debug)]
#[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "cannot be read"))]
struct ThreadClock {
    thread: i32,
}

#[cfg(target_os = "linux")]
impl ThreadClock {
    fn current() -> Self {
        Self { thread: nix::unistd::gettid().as_raw() }
    }

    fn now(&self) -> Option<Duration> {
        // The kernel's encoding of a thread's processor-time clock, the one that `pthread_getcpuclockid` returns.
        let clock = nix::time::ClockId::from_raw(!self.thread << 3 | 0b110);
        clock.now().ok().map(Duration::from)
    }
}

#[cfg(not(target_os = "linux"))]
impl ThreadClock {
    fn current() -> Self {
        Self { thread: 0 }
    }

    fn now(&self) -> Option<Duration> {
        None
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn only_threads_of_the_pool_count() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let clock = PoolClock::new(&pool);
        let before = clock.now().unwrap();
        let spin = || while clock.now().unwrap() < before + Duration::from_millis(30) {};
        pool.install(spin);
        let used = clock.now().unwrap() - before;
        assert!((0.029..0.3).contains(&used.as_secs_f64()), "{used:?}");
        assert!(peak_resident_bytes().unwrap() >= resident_bytes().unwrap() / 2);
    }

    #[test]
    fn reading_does_not_wait_for_the_threads() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let clock = PoolClock::new(&pool);
        let (release, held) = channel::<()>();
        pool.spawn(move || held.recv().unwrap());
        // Would never return if it needed the thread that is held.
        assert!(clock.now().is_some());
        release.send(()).unwrap();
    }
}
