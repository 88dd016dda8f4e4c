//! Exploration: where to go next to see what is not known yet, in an occupancy map that grows and bends.
//!
//! The caller moves the robot and maps what it sees; an [`Explorer`] decides after every scan. The data flow of a decision:
//!
//! 1. [`Frontiers`]: where free space meets unknown space, kept per submap as blocks change, checked against other submaps at the current poses, clustered.
//! 2. A roadmap of places that the robot can reach, grown over free space by motions of [`voxelastic_plan`]'s spaces: it flies, or follows the floor.
//! 3. Viewpoints: places of the roadmap that see a cluster. [`SensorView::unknown_volume`] says what the sensor would see there.
//! 4. A tour to the one that shows most per second of travel, over those beside the way: they are far from it later. The first is the next target.
//! 5. The leg there is shortened and checked as a whole against the map.
//!
//! A path is kept until it is done, blocked, or no longer worth it. Waypoints are anchored to scans and move with corrections. Far away, and home, the robot goes along its own
//! track with shortcuts, which needs no roadmap of the whole map; it turns back when the time that is left just suffices for that.
//!
//! All lengths are metres, all times seconds, all points in the map frame.

mod decision;
mod explorer;
mod last_scans;
mod near_returns;
mod robot_space;
mod routes;
mod settings;
mod targets;

pub use decision::{Decision, Purpose, ReturnReason};
pub use explorer::Explorer;
pub use settings::{ExploreError, ExploreSettings};
pub use targets::clusters::{FrontierCluster, FrontierSettings};
pub use targets::frontiers::Frontiers;
pub use targets::gain::SensorView;
