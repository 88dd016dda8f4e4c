//! What an explorer says.

use crate::targets::clusters::FrontierCluster;
use std::fmt;
use std::time::Duration;
use voxelastic_plan::Point;

/// What the robot is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// It goes to see more.
    Explore,
    /// It goes home: nothing is left to see, or the time is up.
    Return,
    /// It is at home, or cannot move.
    Done,
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Decision {
    /// What for.
    pub purpose: Purpose,
    /// The path from the robot on, map frame, metres; empty when it is done.
    pub path: Vec<Point>,
    /// Whether the decision planned: the path is new, unless the plan is unfinished.
    pub is_new: bool,
    /// Whether the next decision goes on with the plan, as it takes more than fits into one. The path is that of before, or empty.
    pub is_unfinished: bool,
    /// Clusters of the frontier in the box.
    pub frontier: Vec<FrontierCluster>,
    /// Viewpoints that were worth a visit, if it planned.
    pub viewpoints: usize,
    /// Time to bring the frontier up to date and to cluster it.
    pub frontier_time: Duration,
    /// Time of the whole decision.
    pub time: Duration,
}

/// Why a robot turns back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnReason {
    /// The time left is needed for the way home.
    Time,
    /// No viewpoint that it can reach is worth a visit.
    NothingLeft,
    /// It found no way to where there is more to see.
    Stuck,
    /// It was asked to.
    Asked,
}

impl fmt::Display for ReturnReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Time => "the time is up",
            Self::NothingLeft => "nothing more is worth a visit",
            Self::Stuck => "there is no way to where there is more to see",
            Self::Asked => "it was asked to",
        })
    }
}
