//! Damage to files: the same in every run, or more of it for as long as asked (`VOXELASTIC_SOAK_S`, seconds a format).

use std::time::{Duration, Instant};
use voxelastic_testing::thread_cpu_time;

/// A generator good enough to hit every byte (Marsaglia's xorshift).
pub struct Random(u64);

impl Random {
    pub fn new() -> Self {
        Self(0x9e37_79b9_7f4a_7c15)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % n.max(1) as u64) as usize
    }

    /// Changes `bytes` in up to three places, half of them in the first `head` bytes, where lengths are; at least `head` bytes stay.
    pub fn damage(&mut self, bytes: &mut Vec<u8>, head: usize) {
        for _ in 0..=self.below(3) {
            let reach = if self.below(2) == 0 { bytes.len() } else { head.min(bytes.len()) };
            let at = self.below(reach);
            match self.below(6) {
                0 => bytes[at] ^= 1 << self.below(8),
                1 => bytes[at] = self.below(256) as u8,
                2 => bytes[at] = b"0123456789-.e \n"[self.below(15)],
                3 => bytes[at..].iter_mut().take(8).for_each(|b| *b = 0xff),
                4 => bytes.insert(at, b"9e \n"[self.below(4)]),
                _ => bytes.truncate(at.max(head)),
            }
        }
    }
}

/// Damages `good` at least `rounds` times and hands it to `read`, which says whether anything was read. Panics if one round takes more
/// processor time than `limit`.
pub fn soak(name: &str, good: &[u8], rounds: usize, limit: Duration, mut read: impl FnMut(&[u8]) -> bool) {
    let asked: Option<f64> = std::env::var("VOXELASTIC_SOAK_S").ok().and_then(|s| s.parse().ok());
    let (mut random, clock) = (Random::new(), Instant::now());
    let (mut runs, mut opened, mut slowest) = (0, 0, Duration::ZERO);
    while asked.map_or(runs < rounds, |seconds| clock.elapsed().as_secs_f64() < seconds) {
        let mut bad = good.to_vec();
        random.damage(&mut bad, 400);
        let start = thread_cpu_time();
        opened += usize::from(read(&bad));
        slowest = slowest.max(thread_cpu_time().saturating_sub(start));
        runs += 1;
    }
    eprintln!("{name}: {runs} damaged files, {opened} read, the slowest took {slowest:?}");
    assert!(slowest < limit, "{name}: {slowest:?}");
}
