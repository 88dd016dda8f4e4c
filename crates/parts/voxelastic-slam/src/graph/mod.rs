//! Pose-graph optimisation: node poses that agree best with all edges, found by the [`factrs`] library.
//!
//! [`optimise`] solves a whole graph, [`optimise_with_positions`] one with positions of a receiver or of control points, [`optimise_held`] one of which somebody holds nodes; [`LiveOptimiser`] sits in a stream of events and adds a
//! [`PoseUpdate`](voxelastic::event::Event::PoseUpdate) after loop edges (paper Sec. IV-D takes these from any SLAM system).
//!
//! ```
//! use voxelastic::{Pose, event::Edge};
//! use voxelastic_slam::graph::{Options, Problem, optimise};
//!
//! // Odometry says 1 m and 1 m, the loop edge says 2.2 m; all have the same information.
//! let nodes = [0, 1, 2].map(|i| (i, Pose::translation(i as f64, 0.0, 0.0)));
//! let edge = |from, to, x| Edge { from, to, t_from_to: Pose::translation(x, 0.0, 0.0), information: None };
//! let edges = [edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 2.2)];
//! let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &[] }, &Options::default())?;
//! assert!((solved.poses[2].1.translation.x - 2.1).abs() < 0.1 && solved.cost < solved.cost_before);
//! # Ok::<(), voxelastic_slam::SlamError>(())
//! ```

mod between;
mod block_cholesky;
mod held;
mod incremental;
mod information;
mod lie;
mod live;
mod position;
mod solve;
mod vertical;

pub(crate) use between::Between;
pub(crate) use block_cholesky::{Structure, System};
pub use held::{HeldRotation, Hold, optimise_held};
pub use incremental::Correction;
pub use information::default_information;
pub(crate) use information::{adjoint, symmetric, upper_triangle, usable_information};
pub(crate) use lie::{exp, log, renormalised};
pub use live::LiveOptimiser;
pub use position::{MeasuredPosition, Positioned, largest_bend, optimise_with_positions};
pub use solve::{Options, Problem, Solved, optimise};
