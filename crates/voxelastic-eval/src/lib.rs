//! How good is a map? Distances, alignment, trajectory errors, plots and pictures.
//!
//! Nothing here knows the map's own structures: inputs are plain arrays (`[f32; 3]` points in metres, [`MeshView`], lists of poses), so that the
//! same measures serve other people's maps.

mod canvas;
pub mod colour;
mod error;
mod glyphs;
mod mesh;
pub mod render;
mod vec3;

pub use error::{EvalError, Result};
pub use mesh::{MeshView, bounds, vertex_normals};
