//! How good is a map? Distances, alignment, trajectory errors, plots and pictures.
//!
//! Nothing here knows the map's own structures: inputs are plain arrays (`[f32; 3]` points in metres, [`MeshView`], lists of poses), so that the
//! same measures serve other people's maps.

pub mod align;
mod bvh;
mod canvas;
pub mod cloud_distance;
pub mod colour;
mod error;
mod glyphs;
pub mod held_out;
mod mesh;
pub mod mesh_distance;
pub mod metrics;
mod order;
pub mod plot;
pub mod render;
pub mod stats;
pub mod trajectory;
mod vec3;

pub use cloud_distance::{PointIndex, cloud_distances, downsample};
pub use error::{EvalError, Result};
pub use mesh::{MeshView, bounds, vertex_normals};
pub use mesh_distance::{MeshIndex, mesh_distances};
pub use stats::DistanceStats;
