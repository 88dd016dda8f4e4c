//! Keyframing: which of the scans to take.

use super::scan_entry::ScanEntry;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic::geometry::stored::StoredPose;

/// Which scans to take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Keyframing {
    /// All of them.
    #[default]
    All,
    /// The first and every n-th after it.
    Nth(usize),
    /// The first, and each that is at least so many metres of travel after the last one taken.
    Metres(f64),
    /// The first, and each that is at least so many seconds after the last one taken.
    Seconds(f64),
}

impl FromStr for Keyframing {
    type Err = String;

    /// `scan` (all), `5` (every fifth), `2m`, `0.5s`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is none of: scan, a whole number such as 5, a distance such as 2m, a time such as 0.5s");
        let positive = |number: &str| number.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(wrong);
        match text.trim() {
            "scan" => Ok(Self::All),
            t => match (t.strip_suffix('m'), t.strip_suffix('s')) {
                (Some(metres), _) => positive(metres).map(Self::Metres),
                (_, Some(seconds)) => positive(seconds).map(Self::Seconds),
                _ => t.parse().ok().filter(|n| *n > 0).map(Self::Nth).ok_or_else(wrong),
            },
        }
    }
}

impl fmt::Display for Keyframing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => write!(f, "every scan"),
            Self::Nth(n) => write!(f, "one in {n} scans"),
            Self::Metres(m) => write!(f, "every {m} m"),
            Self::Seconds(s) => write!(f, "every {s} s"),
        }
    }
}

/// The scans that are taken.
pub(crate) fn select(scans: Vec<ScanEntry>, keyframing: Keyframing) -> Vec<ScanEntry> {
    let mut filter = KeyframeFilter::new(keyframing);
    scans.into_iter().filter(|scan| filter.takes(&scan.t_map_lidar, scan.time)).collect()
}

/// Selects keyframes from a sequence of scans. Its serialised form belongs to the version of the program that wrote it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct KeyframeFilter {
    keyframing: Keyframing,
    /// Pose and time of the previous scan.
    previous: Option<(StoredPose, f64)>,
    /// Scans so far.
    count: usize,
    /// Metres or seconds since the last scan that was taken.
    since_taken: f64,
}

impl KeyframeFilter {
    /// A filter before the first scan.
    pub fn new(keyframing: Keyframing) -> Self {
        Self { keyframing, previous: None, count: 0, since_taken: f64::INFINITY }
    }

    /// Whether the next scan is taken, by its pose in the map frame and its time in seconds.
    pub fn takes(&mut self, t_map_lidar: &Pose, time: f64) -> bool {
        let (index, previous) = (self.count, self.previous.replace((StoredPose(*t_map_lidar), time)));
        self.count += 1;
        let (limit, step) = match self.keyframing {
            Keyframing::All => return true,
            Keyframing::Nth(n) => return index % n.max(1) == 0,
            Keyframing::Metres(limit) => (limit, previous.map_or(0.0, |(StoredPose(pose), _)| pose.translation_distance(t_map_lidar))),
            Keyframing::Seconds(limit) => (limit, previous.map_or(0.0, |(_, before)| time - before)),
        };
        self.since_taken += step;
        // Tolerance for rounding: without it, every other scan of an evenly spaced drive could be skipped.
        let taken = self.since_taken >= limit * (1.0 - 1e-9);
        self.since_taken = if taken { 0.0 } else { self.since_taken };
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(keyframing: &str) -> Vec<usize> {
        let scan = |k: usize| ScanEntry {
            path: "a".into(),
            index: k,
            node: k as u64,
            time: 0.1 * k as f64,
            t_map_lidar: Pose::translation(0.5 * k as f64, 0.0, 0.0),
            sensor: 0,
        };
        let scans: Vec<ScanEntry> = (0..9).map(scan).collect();
        select(scans, keyframing.parse().unwrap()).iter().map(|s| s.index).collect()
    }

    #[test]
    fn keyframes_by_count_distance_and_time() {
        assert_eq!(taken("scan").len(), 9);
        assert_eq!(taken("4"), [0, 4, 8]);
        assert_eq!(taken("2m"), [0, 4, 8]);
        assert_eq!(taken("0.3s"), [0, 3, 6]);
        for wrong in ["", "0", "-1m", "nans", "2 km", "m"] {
            assert!(wrong.parse::<Keyframing>().is_err(), "{wrong}");
        }
    }
}
