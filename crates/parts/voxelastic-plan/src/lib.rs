//! Collision-free paths for robots in Voxelastic's occupancy maps (paper Sec. V-B).
//!
//! [`plan()`] takes a map ([`AtlasQuery`](voxelastic::query::AtlasQuery)) and a [`Request`] (start, goal, [`Robot`], limits) and returns a [`Plan`]:
//! waypoints, clearances, and how the path was found. The data flow:
//!
//! 1. The endpoints are checked. Where the robot does not fit, [`PlanError::Blocked`] says why and gives the nearest position where it does.
//! 2. RRT-Connect searches for a first path. If its two trees do not meet soon, A* over a coarse lattice takes over, with small trees at narrow
//!    passages.
//! 3. The lattice is searched for shorter alternatives, for instance through another door.
//! 4. RRT* shortens the path as long as time remains, and [`shorten`] smooths the result.
//!
//! Every motion is checked as a whole sweep against the map's octree, never at steps along it. Searches see the map through the [`Space`] trait only:
//! [`FlyingSpace`] and [`GroundSpace`] implement it, and so can a space of your own.
//!
//! Maps change: [`Snapshot`] copies the occupancy, so that planning and mapping can run at the same time; [`anchor_path`] and [`resolve_anchors`]
//! move waypoints along with corrections; [`recheck`] finds the segments of a path that are no longer free.
//!
//! All lengths are in metres, all points in the map frame.
//!
//! ```
//! use voxelastic::{Settings, event::Event, mapper::Mapper};
//! use voxelastic_plan::{PlanError, Request, Robot, plan};
//! use voxelastic_sim::{PoseSource, SimOptions, Simulation};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // Map a simulated room.
//! let mut settings = Settings { voxel_size: 0.1, ..Settings::default() };
//! settings.set("field", "occupancy")?;
//! let mut mapper = Mapper::new(settings)?;
//! let room = Simulation::new(SimOptions { scans: Some(3), columns: Some(512), ..SimOptions::of("room") })?;
//! for scan in room.scans(PoseSource::Truth) {
//!     mapper.handle(Event::Scan(scan))?;
//! }
//! // Plan in it, with a limit of samples so that the result is the same on every machine.
//! let map = mapper.atlas().query()?;
//! let request = Request { samples: Some(200), ..Request::new([-3.0, -2.0, 1.2], [3.0, 1.0, 1.5], Robot::flying(0.3)) };
//! let path = plan(&map, &request)?;
//! assert!(path.length < 7.5 && path.least_clearance >= 0.3);
//! // A goal inside of the wall is an error that names the nearest free position.
//! let blocked = plan(&map, &Request { goal: [5.5, 0.0, 1.5], ..request });
//! assert!(matches!(blocked, Err(PlanError::Blocked { .. } | PlanError::OutsideMap { .. })));
//! # Ok(())
//! # }
//! ```

mod anchors;
mod endpoint;
mod error;
mod flying;
mod ground;
mod planner;
mod points;
mod recheck;
mod robot;
mod search;
mod snapshot;
mod space;

pub use anchors::{Anchor, anchor_path, resolve_anchors};
pub use error::{Endpoint, Obstacle, PlanError};
pub use flying::FlyingSpace;
pub use ground::{GroundSpace, STRIDE};
pub use planner::{FirstPath, Plan, Request, plan};
pub use points::{Point, between, distance, length, sharpest_turn};
pub use recheck::{BlockedSegment, recheck};
pub use robot::{Robot, Wheels};
pub use search::shorten::{Effort, shorten};
pub use snapshot::Snapshot;
pub use space::{Fit, Space};
