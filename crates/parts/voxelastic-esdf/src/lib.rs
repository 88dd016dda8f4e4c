//! Euclidean distance fields (ESDF) of occupancy maps: the distance to the nearest surface, or to the nearest space that is not free, with its gradient.
//!
//! An [`Esdf`] holds one field per submap, in the frame of the submap, so a correction of poses costs nothing. [`Esdf::update`] brings it up to date with an
//! [`Atlas`](voxelastic::atlas::Atlas): it recomputes only what lies within the largest distance of voxels that changed their state since. [`EsdfQuery`] answers in
//! the map frame, over all submaps. A [`LocalEsdf`] is made only around the points that it is asked about.
//!
//! Distances are exact: from the centre of a finest voxel to the centre of the nearest occupied one, as a dense transform of the whole map would give them,
//! however the map came to be. A removed obstacle leaves nothing behind. Where the map has surfaces (a TSDF), queries can give the distance to their nearest
//! triangle instead ([`EsdfQuery::sample_many_to_surfaces`]).
//!
//! ```
//! use voxelastic::{Settings, event::Event, mapper::Mapper};
//! use voxelastic_esdf::{Esdf, EsdfSettings};
//! use voxelastic_sim::{PoseSource, SimOptions, Simulation};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut settings = Settings { voxel_size: 0.1, ..Settings::default() };
//! settings.set("field", "occupancy")?;
//! let mut mapper = Mapper::new(settings)?;
//! let mut esdf = Esdf::new(EsdfSettings { max_distance: 2.0, ..EsdfSettings::default() }, 0.1)?;
//! let room = Simulation::new(SimOptions { scans: Some(3), columns: Some(256), ..SimOptions::of("room") })?;
//! for scan in room.scans(PoseSource::Truth) {
//!     mapper.handle(Event::Scan(scan))?;
//!     esdf.update(mapper.atlas());
//! }
//! let sample = esdf.query(mapper.atlas()).sample([4.0, 0.0, 1.2]);
//! assert!((sample.distance - 1.0).abs() < 0.1, "the wall is at x = 5 m");
//! assert!(sample.gradient[0] < -0.9, "away from it");
//! # Ok(())
//! # }
//! ```

mod atlas;
mod frame;
mod layer;
mod local;
mod point_order;
mod query;
mod seeds;
mod submap;
mod surfaces;
mod targets;
mod transform;
mod triangle_index;

pub use atlas::{Esdf, EsdfError, EsdfSettings, EsdfStats};
pub use local::LocalEsdf;
pub use query::{EsdfQuery, EsdfSample};
