//! What the planner says, and what it may be asked.

use std::time::Duration;
use voxelastic_explore::{FrontierCluster, ReturnReason};
use voxelastic_plan::{Anchor, Point};

/// What a robot is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlanState {
    /// It waits for a scan, or for the first plan.
    #[default]
    Waiting,
    /// It goes to see more.
    Exploring,
    /// It goes home.
    Returning,
    /// It is at home, or cannot get there.
    Done,
    /// It was asked to wait.
    Paused,
}

impl PlanState {
    /// A word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Exploring => "exploring",
            Self::Returning => "returning",
            Self::Done => "done",
            Self::Paused => "paused",
        }
    }
}

/// What may be asked of a robot that explores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Explore, also after it went home.
    Explore,
    /// Go home, and stay there.
    Return,
}

/// What the planner says.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Plan {
    /// What the robot is doing.
    pub state: PlanState,
    /// Why it does not explore any more.
    pub reason: Option<ReturnReason>,
    /// The path from the robot on, map frame, metres; empty where it is to stay.
    pub path: Vec<Point>,
    /// What the waypoints are anchored to: they move with corrections of the map.
    pub anchors: Vec<Anchor>,
    /// Clusters of the frontier in the box to explore.
    pub frontier: Vec<FrontierCluster>,
    /// Whether the path is a new one.
    pub is_new: bool,
    /// Distance of the robot from its home, metres.
    pub from_home: Option<f64>,
    /// Places of the roadmap.
    pub places: usize,
    /// Time to bring the frontier up to date.
    pub frontier_took: Duration,
    /// Time of all of it.
    pub took: Duration,
}
