//! When checkpoints are written.

use std::str::FromStr;
use std::time::Duration;

/// A checkpoint takes at most this share of the time: the next comes after so many times what the last took.
const SHARE: u32 = 50;
/// Runs shorter than this have none.
const LEAST: Duration = Duration::from_secs(2);
/// The first comes after this at the latest: a map that grows as fast as a fiftieth of the speed of writing would never have one.
const FIRST: Duration = Duration::from_secs(120);
/// Memory of fields that is compressed and written in a second, as a rule on two threads.
const BYTES_PER_SECOND: f64 = 100e6;

/// How often checkpoints are written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CheckpointEvery {
    /// As often as a fiftieth of the time allows.
    Auto,
    /// Never.
    Off,
    /// After so many scans.
    Scans(usize),
    /// After so much time.
    Time(Duration),
}

impl CheckpointEvery {
    /// How long the first is expected to take, of a map whose fields take so many bytes of memory.
    pub fn expected(bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND).min(FIRST / SHARE)
    }

    /// Whether one is due, after so many scans and so much time since the last, which took `took`.
    pub fn is_due(self, scans: usize, time: Duration, took: Duration) -> bool {
        match self {
            Self::Auto => scans > 0 && time >= LEAST.max(took * SHARE),
            Self::Off => false,
            Self::Scans(most) => scans >= most,
            Self::Time(most) => scans > 0 && time >= most,
        }
    }
}

impl FromStr for CheckpointEvery {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = |text: &str| text.parse().ok().filter(|s: &f64| *s > 0.0).and_then(|s| Duration::try_from_secs_f64(s).ok());
        let found = match (text, text.strip_suffix('s')) {
            ("auto", _) => Some(Self::Auto),
            ("off", _) => Some(Self::Off),
            (_, Some(number)) => seconds(number).map(Self::Time),
            _ => text.parse().ok().filter(|n| *n > 0).map(Self::Scans),
        };
        found.ok_or_else(|| format!("{text:?} is none of: auto, off, a number of scans such as 100, a time such as 30s"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_takes_at_most_a_fiftieth_of_the_time() {
        let seconds = Duration::from_secs_f64;
        let auto = CheckpointEvery::Auto;
        assert!(!auto.is_due(9, seconds(1.9), seconds(0.0)) && auto.is_due(9, seconds(2.0), seconds(0.0)));
        assert!(!auto.is_due(9, seconds(9.9), seconds(0.2)) && auto.is_due(9, seconds(10.0), seconds(0.2)));
        assert!(!auto.is_due(0, seconds(10.0), seconds(0.2)), "nothing came");
        // The first of a map of 20 MB, and of one of 20 GB.
        let expected = [20_000_000, 20_000_000_000].map(CheckpointEvery::expected);
        assert!(!auto.is_due(9, seconds(9.9), expected[0]) && auto.is_due(9, seconds(10.1), expected[0]));
        assert!(!auto.is_due(9, seconds(119.9), expected[1]) && auto.is_due(9, seconds(120.1), expected[1]));
        assert_eq!(["7".parse(), "2.5s".parse()], [Ok(CheckpointEvery::Scans(7)), Ok(CheckpointEvery::Time(seconds(2.5)))]);
        for wrong in ["0", "-1", "0s", "nans", "never", ""] {
            assert!(wrong.parse::<CheckpointEvery>().is_err(), "{wrong}");
        }
    }
}
