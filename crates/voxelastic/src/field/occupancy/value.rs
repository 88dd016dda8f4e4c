//! One voxel's knowledge, and the summary that octants hold of what lies below.

/// Steps per unit of log-odds: a byte reaches from -3.97 to 3.97.
pub const LOG_ODDS_STEPS: f32 = 32.0;
/// The value of a voxel that no beam ever told anything about: not the same as log-odds of zero.
pub const UNKNOWN: i8 = i8::MIN;

/// What is known of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum State {
    /// Never observed, or observed with no result.
    Unknown,
    /// Seen to be empty.
    Free,
    /// Something is there.
    Occupied,
}

/// The state that a voxel's value stands for.
#[inline(always)]
pub fn state_of(value: i8) -> State {
    match value {
        UNKNOWN | 0 => State::Unknown,
        v if v < 0 => State::Free,
        _ => State::Occupied,
    }
}

/// Log-odds of being occupied; none for an unknown voxel.
pub fn log_odds(value: i8) -> Option<f32> {
    (value != UNKNOWN).then(|| f32::from(value) / LOG_ODDS_STEPS)
}

/// A log-odds value in steps, rounded, within what a byte holds.
pub fn steps(log_odds: f32) -> i8 {
    (log_odds * LOG_ODDS_STEPS).round().clamp(-127.0, 127.0) as i8
}

/// What an octant knows of all voxels below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Value of every voxel below, while nothing hangs below the octant.
    pub value: i8,
    /// Largest value below; [`UNKNOWN`] when nothing below was ever observed.
    pub max: i8,
    /// Whether every voxel below was observed.
    pub observed: bool,
}

impl Default for Summary {
    fn default() -> Self {
        Self::uniform(UNKNOWN)
    }
}

impl Summary {
    /// The summary of a cube with one value everywhere.
    #[inline(always)]
    pub const fn uniform(value: i8) -> Self {
        Self { value, max: value, observed: value != UNKNOWN }
    }

    /// The summary of eight siblings.
    #[inline(always)]
    pub fn of(siblings: impl Iterator<Item = Summary>) -> Self {
        siblings.fold(Self { value: UNKNOWN, max: UNKNOWN, observed: true }, |all, one| Self {
            value: UNKNOWN,
            max: all.max.max(one.max),
            observed: all.observed && one.observed,
        })
    }

    /// Whether everything below is as free as it can get, so that another look can teach nothing.
    #[inline(always)]
    pub fn is_saturated_free(&self, limit: i8) -> bool {
        self.observed && self.max <= limit
    }
}
