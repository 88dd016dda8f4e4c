//! A recording as a transport.

use crate::transport::Transport;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use voxelastic_run::Input;

/// Longest sleep without asking whether to stop.
const NAP: Duration = Duration::from_millis(50);
/// A step between two time stamps that is longer than this, seconds, or goes back, is a jump of the clock and not a pause of the recording.
const LONGEST_PAUSE: f64 = 600.0;

/// The speed at which a recording is played: a factor, or as fast as possible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate(Option<f64>);

/// Rates beyond these are mistakes.
const RATES: [f64; 2] = [0.01, 100.0];

impl Default for Rate {
    /// Its own speed.
    fn default() -> Self {
        Self(Some(1.0))
    }
}

impl Rate {
    /// Parses `max` or a factor.
    ///
    /// # Errors
    /// When it is neither.
    pub fn parse(text: &str) -> Result<Self, String> {
        let number = || text.parse().ok().filter(|r: &f64| (RATES[0]..=RATES[1]).contains(r));
        match text {
            "max" => Ok(Self(None)),
            _ => number().map(|rate| Self(Some(rate))).ok_or_else(|| format!("must be `max` or a number from {} to {}", RATES[0], RATES[1])),
        }
    }

    /// The factor; none for as fast as possible.
    pub fn factor(self) -> Option<f64> {
        self.0
    }
}

/// Plays inputs by their time stamps: two scans that are a second apart are given out a second apart, at rate 1.
pub struct Replay<I> {
    inputs: I,
    rate: Option<f64>,
    /// A time stamp and when it was due, from which later ones are counted.
    reference: Option<(f64, Instant)>,
    last: Option<f64>,
    lateness: Lateness,
}

/// How much later than it was due an input was read, at most so far.
#[derive(Clone, Debug, Default)]
pub struct Lateness(Arc<AtomicU64>);

impl Lateness {
    /// The most so far.
    pub fn most(&self) -> Duration {
        Duration::from_micros(self.0.load(Ordering::Relaxed))
    }

    fn note(&self, late: Duration) {
        self.0.fetch_max(u64::try_from(late.as_micros()).unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

impl<I: Iterator<Item = Input> + Send> Replay<I> {
    /// Plays `inputs` at `rate` times their own speed, or as fast as they are taken.
    pub fn new(inputs: I, rate: Rate) -> Self {
        Self { inputs, rate: rate.factor(), reference: None, last: None, lateness: Lateness::default() }
    }

    /// How late inputs were read, which can be asked while the recording is played.
    pub fn lateness(&self) -> Lateness {
        self.lateness.clone()
    }

    /// When a scan of time stamp `time` is due.
    fn due(&mut self, time: f64, rate: f64, now: Instant) -> Instant {
        let jumped = self.last.replace(time).is_some_and(|last| !(0.0..=LONGEST_PAUSE).contains(&(time - last)));
        match self.reference {
            Some((first, start)) if !jumped => {
                let after = Duration::try_from_secs_f64((time - first) / rate).unwrap_or_default();
                start.checked_add(after).unwrap_or(now)
            }
            _ => {
                self.reference = Some((time, now));
                now
            }
        }
    }
}

impl<I: Iterator<Item = Input> + Send> Transport for Replay<I> {
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
        let input = self.inputs.next()?;
        let (Some(rate), Some(time)) = (self.rate, input.time()) else { return (!is_stopped()).then_some(input) };
        let due = self.due(time, rate, Instant::now());
        loop {
            if is_stopped() {
                return None;
            }
            match due.checked_duration_since(Instant::now()) {
                Some(left) if !left.is_zero() => std::thread::sleep(left.min(NAP)),
                _ => break,
            }
        }
        self.lateness.note(Instant::now().saturating_duration_since(due));
        Some(input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Cloud;
    use voxelastic_slam::slam::RawScan;
    use voxelastic_testing::PATIENCE;

    fn scan(time: f64) -> Input {
        Input::RawScan(RawScan { node: 0, time, cloud: Cloud::default(), imu: Vec::new() }, String::new())
    }

    fn play(times: &[f64], rate: Option<f64>) -> Duration {
        let mut replay = Replay::new(times.iter().map(|t| scan(*t)), Rate(rate));
        let clock = Instant::now();
        let mut seen = 0;
        while replay.next(&|| false).is_some() {
            seen += 1;
        }
        assert_eq!(seen, times.len());
        clock.elapsed()
    }

    #[test]
    fn scans_come_as_far_apart_as_they_were_taken() {
        assert!(play(&[1000.0, 1000.1, 1000.4], Some(2.0)) >= Duration::from_millis(199));
        assert!(play(&[1000.0, 1000.1, 1900.4], None) < Duration::from_secs(300));
    }

    #[test]
    fn a_jump_of_the_clock_is_not_waited_for() {
        assert!(play(&[1000.0, 1.7e9, 1.7e9 + 0.1, 5.0, 5.1, f64::NAN, 6.0], Some(1.0)) < PATIENCE);
        assert!(play(&[5.0, 4.0, 4.2], Some(1.0)) >= Duration::from_millis(199), "after a jump, time goes on");
    }

    #[test]
    fn a_long_pause_can_be_ended() {
        let mut replay = Replay::new([scan(0.0), scan(500.0)].into_iter(), Rate::default());
        assert!(replay.next(&|| false).is_some());
        let clock = Instant::now();
        assert!(replay.next(&|| clock.elapsed() > Duration::from_millis(20)).is_none());
        assert!(clock.elapsed() < Duration::from_secs(400));
    }

    #[test]
    fn rates_are_factors_or_max() {
        assert_eq!((Rate::parse("max"), Rate::parse("0.5")), (Ok(Rate(None)), Ok(Rate(Some(0.5)))));
        assert!(["0", "-1", "nan", "inf", "101", "fast", ""].iter().all(|text| Rate::parse(text).is_err()));
    }
}
