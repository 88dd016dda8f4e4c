//! Scans that are left out, to measure a map by them.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use voxelastic_io::source::Source;

/// Interval of the held-out scans: the last of every N.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HoldOut(usize);

impl std::fmt::Display for HoldOut {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl std::str::FromStr for HoldOut {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse().ok().filter(|n| *n >= 2).map(Self).ok_or_else(|| "must be a whole number, 2 or more".to_owned())
    }
}

impl HoldOut {
    /// Whether scan `i` of the selected scans is held out.
    pub fn holds_out(self, i: usize) -> bool {
        i % self.0 == self.0 - 1
    }

    /// Restricts the source to the held-out scans.
    pub fn keep_held_out(self, source: &mut Source) {
        source.retain(move |i| self.holds_out(i));
    }

    /// Removes the held-out scans from the source. The returned counter grows with each scan that is removed.
    pub fn remove_held_out(self, source: &mut Source) -> Arc<AtomicUsize> {
        let count = Arc::new(AtomicUsize::new(0));
        let held = Arc::clone(&count);
        source.retain(move |i| {
            held.fetch_add(usize::from(self.holds_out(i)), Ordering::Relaxed);
            !self.holds_out(i)
        });
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_of_each_n_is_held_out() {
        let tenth: HoldOut = "10".parse().unwrap();
        assert_eq!((0..30).filter(|i| tenth.holds_out(*i)).collect::<Vec<_>>(), [9, 19, 29]);
        assert!(["0", "1", "-3", "x"].iter().all(|t| t.parse::<HoldOut>().is_err()));
    }
}
