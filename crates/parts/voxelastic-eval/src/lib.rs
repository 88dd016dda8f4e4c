//! Evaluation of LiDAR maps: distances, alignment, occupancy and trajectory errors, plots and pictures.
//!
//! Inputs are plain arrays (`[f32; 3]` points in metres, [`MeshView`], lists of poses) and no structures of the mapper, so maps of other systems can be
//! evaluated in the same way. Results are structs that serialise to JSON with stable keys. Everything is deterministic for any number of threads.
//! Points that are not finite are left out and counted.
//!
//! | question | entry point |
//! | --- | --- |
//! | How far is the map from the truth, and what does it lack? (paper Sec. V-A) | [`metrics::compare`] |
//! | How well does a mesh explain scans it was not made from? | [`held_out::HeldOut`] |
//! | Has a place on a mesh one surface, or several on top of each other? | [`layers::layers`] |
//! | Is occupancy correct? | [`occupancy::score`] |
//! | How accurate are the poses? | [`trajectory::ate`], [`trajectory::rpe`] |
//! | How far are these points from this mesh, or this cloud? | [`MeshIndex`], [`PointIndex`] |
//! | How are two clouds aligned? | [`align::align`] |
//! | Statistics of distances, errors, times | [`stats`] |
//! | Pictures, plots, slices | [`render::render_png`], [`plot::Plot`], [`grid_view::GridView`] |
//!
//! The usual flow of [`metrics::compare`]: the truth is downsampled, the map is [aligned](align::align) to it, distances are queried both ways from
//! [indices](PointIndex), and [`DistanceStats`] and F-scores summarise them.
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
mod canvas;
pub mod cloud_distance;
pub mod colour;
mod error;
mod glyphs;
pub mod grid_view;
pub mod held_out;
pub mod layers;
mod mesh;
pub mod mesh_distance;
pub mod metrics;
mod morton_order;
pub mod occupancy;
mod picture;
pub mod plot;
pub mod render;
mod round_number;
pub mod stats;
pub mod trajectory;
mod triangle_bvh;
mod vec3;

pub use cloud_distance::{PointIndex, cloud_distances, downsample};
pub use error::{EvalError, Result};
pub use mesh::{MeshView, bounds, vertex_normals};
pub use mesh_distance::{MeshIndex, mesh_distances};
pub use picture::{Picture, Size};
pub use stats::{DistanceStats, ErrorStats, SeriesStats};
