//! Paths for robots in occupancy maps (paper Sec. V-B): the shortest way from one place to another that touches nothing.
//!
//! [`plan()`] takes a map and a [`Request`] and gives a [`Plan`]. Two trees find a first path (RRT-Connect) or, where they do not meet soon, a search
//! over a coarse lattice does, with small trees where that is too coarse. The lattice is asked for other ways round, RRT* looks for shorter paths
//! as long as there is time, and the best is pulled tight and made round ([`shorten`]). Every motion is checked as a whole against the map's octree: no
//! wall is too thin to be seen, and large free octants answer at a glance.
//!
//! | room | what is in it |
//! | --- | --- |
//! | `robot`, `space`, `ground` | what moves, and what asks the map whether it can: [`Air`] for balls that fly, [`Ground`] for wheels |
//! | `planner`, `ends` | from request to plan; what is wrong with a start or goal, and where the robot would fit |
//! | `guide` | which way round: the lattice |
//! | `connect`, `star`, `tree`, `nearest`, `sample` | the search |
//! | `shorten` | shortcuts, corners |
//! | `elastic`, `snapshot` | maps that change: [`recheck`], [`anchor`] and [`place`], and a [`Snapshot`] to plan in meanwhile |
//!
//! The map's own clearance and motion queries are in [`voxelastic::query`]. All lengths are metres, all points in the map frame.
//!
//! ```
//! use voxelastic::{Settings, mapper::Mapper, query::AtlasQuery};
//! use voxelastic_plan::{PlanError, Request, Robot, plan};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut settings = Settings { voxel: 0.1, ..Settings::default() };
//! settings.set("field", "occupancy")?;
//! let mapper = Mapper::new(settings)?;
//! // .. scans go into the mapper ..
//! let map = AtlasQuery::new(mapper.atlas(), 0.1);
//! match plan(&map, &Request::new([0.0, 0.0, 1.0], [8.0, 2.0, 1.0], Robot::flying(0.35))) {
//!     Ok(plan) => println!("{:.1} m, found after {:.0} ms", plan.length, 1e3 * plan.first.seconds),
//!     Err(PlanError::NoOccupancy) => println!("no scans yet"),
//!     Err(problem) => return Err(problem.into()),
//! }
//! # Ok(())
//! # }
//! ```

mod budget;
mod connect;
mod elastic;
mod ends;
mod error;
pub mod ground;
mod guide;
mod nearest;
mod planner;
mod points;
mod robot;
mod sample;
mod shorten;
mod snapshot;
mod space;
mod star;
mod tree;

pub use elastic::{Anchor, Broken, anchor, place, recheck};
pub use error::{End, Obstacle, PlanError};
pub use ground::Ground;
pub use planner::{First, Plan, Request, plan};
pub use points::{Point, between, distance, length, sharpest_turn};
pub use robot::{Robot, Wheels};
pub use shorten::{Effort, shorten};
pub use snapshot::Snapshot;
pub use space::{Air, Fit, Space};
