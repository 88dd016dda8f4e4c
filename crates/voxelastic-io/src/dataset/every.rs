//! Keyframes: which of the scans to take.

use super::ScanEntry;
use std::str::FromStr;
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

impl Every {
    /// Keeps the scans that are taken.
    pub(super) fn select(self, scans: Vec<ScanEntry>) -> Vec<ScanEntry> {
        let (limit, progress): (f64, fn(&ScanEntry, &ScanEntry) -> f64) = match self {
            Self::Scan => return scans,
            Self::Nth(n) => return scans.into_iter().step_by(n.max(1)).collect(),
            Self::Metres(limit) => (limit, |a, b| a.t_map_lidar.translation_distance(&b.t_map_lidar)),
            Self::Seconds(limit) => (limit, |a, b| b.time - a.time),
        };
        let steps = scans.windows(2).map(|pair| progress(&pair[0], &pair[1]));
        let mut since_last = f64::INFINITY;
        let taken = |step: f64| {
            since_last += step;
            // A hair's breadth of rounding must not skip every other scan of an evenly spaced drive.
            let taken = since_last >= limit * (1.0 - 1e-9);
            since_last = if taken { 0.0 } else { since_last };
            taken
        };
        let flags: Vec<bool> = std::iter::once(0.0).chain(steps).map(taken).collect();
        scans.into_iter().zip(flags).filter(|(_, taken)| *taken).map(|(scan, _)| scan).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;

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
