//! Keyframes: which of the scans to take.

use super::ScanEntry;
use std::fmt;
use std::str::FromStr;
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;

/// Which scans to take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Every {
    /// All of them.
    #[default]
    Scan,
    /// The first and every n-th after it.
    Nth(usize),
    /// The first, and each that is at least so many metres of travel after the last one taken.
    Metres(f64),
    /// The first, and each that is at least so many seconds after the last one taken.
    Seconds(f64),
}

impl FromStr for Every {
    type Err = String;

    /// `scan`, `5` (every fifth), `2m`, `0.5s`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is none of: scan, a whole number such as 5, a distance such as 2m, a time such as 0.5s");
        let positive = |number: &str| number.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(wrong);
        match text.trim() {
            "scan" => Ok(Self::Scan),
            t => match (t.strip_suffix('m'), t.strip_suffix('s')) {
                (Some(metres), _) => positive(metres).map(Self::Metres),
                (_, Some(seconds)) => positive(seconds).map(Self::Seconds),
                _ => t.parse().ok().filter(|n| *n > 0).map(Self::Nth).ok_or_else(wrong),
            },
        }
    }
}

impl fmt::Display for Every {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scan => write!(f, "every scan"),
            Self::Nth(n) => write!(f, "one in {n} scans"),
            Self::Metres(m) => write!(f, "every {m} m"),
            Self::Seconds(s) => write!(f, "every {s} s"),
        }
    }
}

impl Every {
    /// Keeps the scans that are taken.
    pub(super) fn select(self, scans: Vec<ScanEntry>) -> Vec<ScanEntry> {
        let mut picker = Picker::new(self);
        scans.into_iter().filter(|scan| picker.takes(scan)).collect()
    }
}

/// Takes keyframes from scans that come one after the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Picker {
    every: Every,
    /// Position and time of the scan before.
    last: Option<(Pose, f64)>,
    count: usize,
    /// Metres or seconds since the last scan that was taken.
    since_taken: f64,
}

impl Picker {
    pub(crate) fn new(every: Every) -> Self {
        Self { every, last: None, count: 0, since_taken: f64::INFINITY }
    }

    /// Whether the scan that comes next is taken.
    pub(crate) fn takes(&mut self, scan: &ScanEntry) -> bool {
        let (place, last) = (self.count, self.last.replace((scan.t_map_lidar, scan.time)));
        self.count += 1;
        let (limit, step) = match (self.every, last) {
            (Every::Scan, _) => return true,
            (Every::Nth(n), _) => return place % n.max(1) == 0,
            (Every::Metres(limit), last) => (limit, last.map_or(0.0, |(pose, _)| pose.translation_distance(&scan.t_map_lidar))),
            (Every::Seconds(limit), last) => (limit, last.map_or(0.0, |(_, time)| scan.time - time)),
        };
        self.since_taken += step;
        // A hair's breadth of rounding must not skip every other scan of an evenly spaced drive.
        let taken = self.since_taken >= limit * (1.0 - 1e-9);
        self.since_taken = if taken { 0.0 } else { self.since_taken };
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(every: &str) -> Vec<usize> {
        let scan = |k: usize| ScanEntry {
            path: "a".into(),
            index: k,
            node: k as u64,
            time: 0.1 * k as f64,
            t_map_lidar: Pose::translation(0.5 * k as f64, 0.0, 0.0),
        };
        let scans: Vec<ScanEntry> = (0..9).map(scan).collect();
        every.parse::<Every>().unwrap().select(scans).iter().map(|s| s.index).collect()
    }

    #[test]
    fn keyframes_by_count_distance_and_time() {
        assert_eq!(taken("scan").len(), 9);
        assert_eq!(taken("4"), [0, 4, 8]);
        assert_eq!(taken("2m"), [0, 4, 8]);
        assert_eq!(taken("0.3s"), [0, 3, 6]);
        for wrong in ["", "0", "-1m", "nans", "2 km", "m"] {
            assert!(wrong.parse::<Every>().is_err(), "{wrong}");
        }
    }
}
