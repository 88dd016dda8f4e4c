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

/// Processor time of all threads of `pool` so far; none where the system does not report it.
///
/// Other threads, such as those that decode or write files, do not count.
pub fn pool_cpu_time(pool: &rayon::ThreadPool) -> Option<Duration> {
    pool.broadcast(|_| thread_cpu_time()).into_iter().sum()
}

#[cfg(unix)]
fn thread_cpu_time() -> Option<Duration> {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Some(Duration::new(u64::try_from(t.tv_sec).ok()?, u32::try_from(t.tv_nsec).ok()?))
}

#[cfg(not(unix))]
fn thread_cpu_time() -> Option<Duration> {
    None
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn only_threads_of_the_pool_count() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let before = pool_cpu_time(&pool).unwrap();
        let spin = || while std::hint::black_box(thread_cpu_time()).unwrap() < before + Duration::from_millis(30) {};
        pool.install(spin);
        let used = pool_cpu_time(&pool).unwrap() - before;
        assert!((0.029..0.3).contains(&used.as_secs_f64()), "{used:?}");
        assert!(peak_resident_bytes().unwrap() >= resident_bytes().unwrap() / 2);
    }
}
