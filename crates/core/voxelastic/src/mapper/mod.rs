//! The mapper: events in, an elastic atlas out. Live and replayed input take the same path (paper Fig. 4).
//!
//! [`Mapper::handle`] takes each [`Event`](crate::event::Event) as it happens. A scan is prepared (range image, local planes), assigned to
//! a submap (`assign`, Sec. IV-A) and integrated into the submap's fields in the submap frame (`integrators`, Sec. IV-B). Closed loops start
//! fusions, which run in the background (`background_fusion`, Sec. IV-C). Corrected poses move root poses and nothing else (`correct`,
//! Sec. IV-D); submaps whose scans moved against each other are reported and can be rebuilt from their scans (`rebuild`). On a revisit,
//! surfaces that are well observed are not updated again (`revisit`). Several sensors may feed one map (`sensors`). Things that move are set aside, if that is wanted (`moving`). What a mapper knows beside its atlas can be stored, so that another process goes
//! on with it (`state`).
//!
//! ```
//! use voxelastic::event::Scan;
//! use voxelastic::{Cloud, Error, Mapper, Pose, Settings};
//!
//! let settings = Settings { sensor: "vlp-16".to_owned(), ..Settings::default() };
//! let mut mapper = Mapper::builder().settings(settings).build()?;
//! let wall = Cloud::from_points((0..50).map(|i| [2.0, 0.01 * i as f32, 0.0]).collect());
//! let scan = Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud: wall };
//! let report = mapper.integrate(&scan)?;
//! assert!(report.is_new_submap);
//! let atlas = mapper.into_atlas();
//! assert_eq!(atlas.scan_count(), 1);
//! # Ok::<(), Error>(())
//! ```

mod assign;
mod background_fusion;
mod background_sampling;
mod builder;
mod clusters;
mod correct;
mod error;
mod frontend;
mod idle;
mod integrators;
mod moving;
mod pipeline;
mod rebuild;
mod report;
mod revisit;
mod sensors;
mod state;

pub use builder::MapperBuilder;
pub use correct::Deformation;
pub use error::MapError;
pub use frontend::{Frontend, FrontendScan};
pub use idle::IdleTask;
pub use pipeline::Mapper;
pub use rebuild::{RebuildError, RebuildReport, Rebuilding, ScanSource};
pub use report::{Assignment, ElasticCounts, ScanReport};
pub use state::{MapperState, ResumeError};
