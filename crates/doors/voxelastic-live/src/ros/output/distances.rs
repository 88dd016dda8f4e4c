//! A slice of the distance field around the robot: where its points lie, and when it is due.

use std::time::{Duration, Instant};

/// A slice is published at most this often ...
const PERIOD: Duration = Duration::from_secs(1);
/// ... and making it takes no more than this share of the time.
const SHARE: f64 = 0.05;
/// From the robot to the sides of the slice, metres.
const REACH: f64 = 10.0;
/// Points along a side, at most.
const MOST_POINTS: f64 = 128.0;

/// When a slice was made, and whether the map has changed since.
#[derive(Debug, Default)]
pub struct SliceState {
    has_changed: bool,
    listeners: usize,
    /// When it was made, and how long that took.
    last: Option<(Instant, Duration)>,
}

impl SliceState {
    /// Notes that the map has changed.
    pub fn note(&mut self) {
        self.has_changed = true;
    }

    /// Whether a slice is due: for those who listen, if the map has changed or some have come.
    pub fn is_due(&mut self, listeners: usize, now: Instant) -> bool {
        self.has_changed |= listeners > std::mem::replace(&mut self.listeners, listeners);
        let has_waited = self.last.is_none_or(|(at, took)| now.saturating_duration_since(at) >= PERIOD.max(took.div_f64(SHARE)));
        listeners > 0 && self.has_changed && has_waited
    }

    /// A slice was made.
    pub fn made(&mut self, begin: Instant, took: Duration) {
        (self.has_changed, self.last) = (false, Some((begin, took)));
    }
}

/// Points of a horizontal slice around `robot`, metres in the map frame, at its height: corners of a grid of voxels, or of a coarser one.
pub fn points(robot: [f64; 3], voxel: f64) -> Vec<[f64; 3]> {
    let step = voxel.max(2.0 * REACH / MOST_POINTS);
    let range = |c: f64| ((c - REACH) / step).ceil() as i64..=((c + REACH) / step).floor() as i64;
    range(robot[1]).flat_map(|y| range(robot[0]).map(move |x| [x as f64 * step, y as f64 * step, robot[2]])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slice_is_due_for_listeners_when_the_map_has_changed() {
        let (mut state, begin) = (SliceState::default(), Instant::now());
        let ms = |k| begin + Duration::from_millis(k);
        state.note();
        assert!(!state.is_due(0, begin) && state.is_due(1, begin));
        state.made(begin, Duration::from_millis(10));
        assert!(!state.is_due(1, ms(5000)), "nothing has changed");
        assert!(state.is_due(2, ms(5000)), "somebody has come");
        state.made(ms(5000), Duration::from_millis(100));
        state.note();
        assert!(!state.is_due(2, ms(6500)) && state.is_due(2, ms(7100)), "a twentieth of the time");
    }

    #[test]
    fn points_lie_around_the_robot_and_stay_where_they_are_when_it_moves() {
        let here = points([100.03, -50.0, 1.25], 0.2);
        assert!(here.len() == 100 * 101 || here.len() == 101 * 101, "{}", here.len());
        assert!(here.iter().all(|[x, y, z]| (x - 100.03).abs() <= REACH && (y + 50.0).abs() <= REACH && *z == 1.25));
        let moved = points([101.0, -50.0, 1.25], 0.2);
        assert!(here.iter().filter(|point| moved.contains(point)).count() > here.len() * 9 / 10);
        assert!(points([0.0; 3], 0.01).len() <= 129 * 129);
    }
}
