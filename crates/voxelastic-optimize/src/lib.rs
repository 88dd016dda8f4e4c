//! Pose-graph optimisation: node poses that agree best with all edges, found by the [`factrs`] library.
//!
//! Voxelastic takes corrected poses from whatever SLAM system made the graph (paper Sec. IV-D). This crate is for data that has edges
//! and no such system beside it: [`optimise`] solves a whole graph, [`LiveOptimiser`] sits in a stream of events and adds a
//! [`PoseUpdate`](voxelastic::event::Event::PoseUpdate) after loops. It is a crate of its own because the solver is heavy to build and
//! mapping does not need it.
//!
//! ```
//! use voxelastic::{Pose, event::Edge};
//! use voxelastic_optimize::{Options, Problem, optimise};
//!
//! // Odometry says 1 m and 1 m, the loop edge says 2.2 m; all are trusted alike.
//! let nodes = [0, 1, 2].map(|i| (i, Pose::translation(i as f64, 0.0, 0.0)));
//! let edge = |from, to, x| Edge { from, to, t_from_to: Pose::translation(x, 0.0, 0.0), information: None };
//! let edges = [edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 2.2)];
//! let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &[] }, &Options::default())?;
//! assert!((solved.poses[2].1.translation.x - 2.1).abs() < 0.1 && solved.cost < solved.cost_before);
//! # Ok::<(), voxelastic_optimize::OptimiseError>(())
//! ```

mod error;
mod live;
mod solve;

pub use error::OptimiseError;
pub use live::LiveOptimiser;
pub use solve::{Options, Problem, Solved, default_information, optimise};
