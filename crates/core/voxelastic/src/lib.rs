//! Voxelastic turns LiDAR scans, with poses that a SLAM system may correct later, into one dense map that bends with the corrections:
//! surfaces as a multi-resolution signed distance field (TSDF), and free, occupied and unknown space as multi-resolution occupancy.
//!
//! # From events to a map
//!
//! A SLAM system reports [`Event`](event::Event)s: a scan with its pose, odometry and loop edges, corrected poses. A [`Mapper`] takes them one by one
//! and keeps an [`Atlas`](atlas::Atlas): a set of submaps, each rigid, each placed in the map by its root pose. A correction changes root poses only, so a loop
//! closure costs a few matrices and not a new integration; loops that close merge submaps. At any time the atlas can be meshed
//! ([`surface`]) and queried ([`query`]).
//!
//! ```
//! use voxelastic::event::{Event, Scan};
//! use voxelastic::{Cloud, Mapper, Pose, Settings};
//!
//! // A wall five metres ahead, as a spinning sensor with 32 rows and 256 columns sees it.
//! let mut points = Vec::new();
//! for row in 0..32 {
//!     for column in 0..256 {
//!         let (elevation, azimuth) = (0.3 - 0.02 * row as f32, 0.8 - 0.00625 * column as f32);
//!         points.push([5.0, 5.0 * azimuth.tan(), 5.0 * elevation.tan() / azimuth.cos()]);
//!     }
//! }
//! let cloud = Cloud { width: 256, height: 32, ..Cloud::from_points(points) };
//!
//! let mut mapper = Mapper::new(Settings { voxel_size: 0.1, ..Settings::default() })?;
//! let report = mapper.handle(Event::Scan(Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud }))?;
//! assert!(report.is_some_and(|report| report.is_new_submap));
//! let atlas = mapper.into_atlas();
//! assert_eq!(atlas.submaps().len(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! | module | what it holds | paper |
//! | --- | --- | --- |
//! | [`event`], [`Cloud`], [`Motion`] | the input | Sec. IV |
//! | [`settings`] | every setting with unit, range and default, defined once | |
//! | [`mapper`] | events in, atlas out | Sec. IV-B |
//! | [`atlas`] | pose graph, submaps, fusion, pose update | Sec. IV |
//! | [`sensor`] | beam models, range images, local planes | Sec. III |
//! | [`integrate`] | how a scan updates a submap | Sec. III |
//! | [`field`] | what voxels store: TSDF and occupancy | Sec. III-A |
//! | [`octree`] | cubes of space and keys | Sec. III-A |
//! | [`surface`] | meshes | |
//! | [`query`] | state, distance, collision, rays, slices | |
//! | [`changes`] | what appeared and vanished between two maps | |
//! | [`memory`] | a budget for maps larger than memory | |
//! | [`geometry`] | rigid transforms, boxes, Morton keys | |
//!
//! # Conventions
//!
//! Lengths are metres, times seconds, angles radians unless a name says otherwise. `t_a_b` maps coordinates in frame b to frame a; the frames are
//! map, submap and lidar. The same input and settings give the same map bit for bit, whatever the number of threads. File formats are not part of this
//! crate; `voxelastic-io` has them.

pub mod atlas;
pub mod changes;
pub mod cloud;
mod error;
pub mod event;
pub mod field;
pub mod geometry;
pub mod integrate;
pub mod mapper;
pub mod memory;
pub mod meshing;
pub mod motion;
pub mod octree;
pub mod query;
pub mod sensor;
pub mod settings;
mod simd;
pub mod surface;

pub use cloud::Cloud;
pub use error::Error;
pub use geometry::Pose;
pub use mapper::Mapper;
pub use motion::Motion;
pub use settings::Settings;
pub use simd::vector_instructions;

/// Runs the examples of README.md as tests.
#[cfg(doctest)]
#[doc = include_str!("../../../../README.md")]
struct Readme;
