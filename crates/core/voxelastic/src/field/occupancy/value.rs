//! The value of a voxel, the state that it stands for, and the summary of a subtree.

/// Steps per unit of log-odds: a byte covers -3.97 to 3.97.
pub const LOG_ODDS_STEPS: f32 = 32.0;
/// Value of a voxel that was never observed. Not the same as log-odds of zero.
pub const UNKNOWN: i8 = i8::MIN;

/// The state of a point in space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum State {
    /// Never observed, or the observations cancel out.
    Unknown,
    /// Observed to be empty.
    Free,
    /// Observed to be occupied.
    Occupied,
}

/// The state that a value, log-odds in steps or [`UNKNOWN`], stands for.
#[inline(always)]
pub fn state_of(value: i8) -> State {
    match value {
        UNKNOWN | 0 => State::Unknown,
        v if v < 0 => State::Free,
        _ => State::Occupied,
    }
}

/// Converts a value in steps to log-odds of being occupied; none for [`UNKNOWN`].
pub fn log_odds(value: i8) -> Option<f32> {
    (value != UNKNOWN).then(|| f32::from(value) / LOG_ODDS_STEPS)
}

/// Converts log-odds to steps, rounded and clamped to -127..=127.
pub fn steps(log_odds: f32) -> i8 {
    (log_odds * LOG_ODDS_STEPS).round().clamp(-127.0, 127.0) as i8
}

/// An octant's summary of its subtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Summary {
    /// Value of the whole octant, if it is uniform and has no subtree.
    pub value: i8,
    /// Largest value in the subtree; [`UNKNOWN`] if nothing in it was observed.
    pub max: i8,
    /// Whether all of the octant was observed.
    pub observed: bool,
}

impl Default for Summary {
    fn default() -> Self {
        Self::uniform(UNKNOWN)
    }
}

impl Summary {
    /// The summary of a uniform cube.
    #[inline(always)]
    pub const fn uniform(value: i8) -> Self {
        Self { value, max: value, observed: value != UNKNOWN }
    }

    /// The summary of a parent of `siblings`.
    #[inline(always)]
    pub fn of(siblings: impl Iterator<Item = Summary>) -> Self {
        siblings.fold(Self { value: UNKNOWN, max: UNKNOWN, observed: true }, |all, one| Self {
            value: UNKNOWN,
            max: all.max.max(one.max),
            observed: all.observed && one.observed,
        })
    }

    /// Whether all values are at most `limit`, the lower clamp of log-odds, so that further free-space observations change nothing.
    #[inline(always)]
    pub fn is_saturated_free(&self, limit: i8) -> bool {
        self.observed && self.max <= limit
    }
}
