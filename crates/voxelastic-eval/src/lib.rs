//! How good is a map? Distances, alignment, trajectory errors, plots and pictures.
//!
//! Nothing here knows the map's own structures: inputs are plain arrays (`[f32; 3]` points in metres, [`MeshView`], lists of poses), so that the
//! same measures serve other people's maps. Everything is deterministic, whatever the number of threads; points that are not finite are left out and
//! counted, never a panic.
//!
//! | question | room |
//! | --- | --- |
//! | How far is the map from the truth, and what does it miss? (paper Sec. V-A) | [`metrics::compare`] |
//! | How well does a mesh explain scans it was not made from? | [`held_out::HeldOut`] |
//! | Are free and occupied space right? | [`occupancy::score`] |
//! | How good are the poses? | [`trajectory::ate`], [`trajectory::rpe`] |
//! | How far are these points from this mesh, or this cloud? | [`MeshIndex`], [`PointIndex`] |
//! | How do these two clouds fit? | [`align::align`] |
//! | What does it look like? | [`render::render_png`], [`plot::Plot`], [`plan::Plan`] |
//!
//! ```
//! use voxelastic_eval::metrics::{CompareSettings, Map, Truth, compare};
//! // A flat floor as truth, and a map of it that is 2 cm too high.
//! let floor = |z| (0..2500).map(|i| [(i % 50) as f32 * 0.05 + 0.02, (i / 50) as f32 * 0.05 + 0.02, z]).collect::<Vec<[f32; 3]>>();
//! let (truth, map) = (floor(0.0), floor(0.02));
//! let truth = Truth { points: &truth, visible: None, distance: None };
//! // Both are in one frame already.
//! let settings = CompareSettings { align: None, ..CompareSettings::default() };
//! let result = compare(Map::Points(&map), &truth, &settings)?;
//! assert!((result.accuracy.median.unwrap() - 0.02).abs() < 1e-3);
//! assert_eq!(result.f_scores[0].f_score, 1.0);
//! # Ok::<(), voxelastic_eval::EvalError>(())
//! ```

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
pub mod occupancy;
mod order;
pub mod plan;
pub mod plot;
pub mod render;
mod spread;
pub mod stats;
pub mod trajectory;
mod vec3;

pub use cloud_distance::{PointIndex, cloud_distances, downsample};
pub use error::{EvalError, Result};
pub use mesh::{MeshView, bounds, vertex_normals};
pub use mesh_distance::{MeshIndex, mesh_distances};
pub use spread::Spread;
pub use stats::DistanceStats;
