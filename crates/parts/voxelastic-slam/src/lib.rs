//! SLAM for Voxelastic: from scans to the poses, edges and corrections that the mapper takes as events.
//!
//! | module | contents |
//! | --- | --- |
//! | [`odometry`] | poses of scans from the scans alone |
//! | [`loops`] | places that were visited before, found again from the scans alone |
//! | [`join`] | where one map or session lies in another |
//! | [`pose_check`] | whether given poses belong to the scans, and under which reading they would |
//! | [`TimesTrial`] | what the times of points mean, by the surfaces |
//! | [`slam`] | raw scans in, the mapper's events out |
//! | [`Corrector`] | loop closures and corrected poses, inserted into the events |
//! | [`refine`] | poses corrected by the surfaces: bundle adjustment over planes |
//! | [`graph`] | pose graphs: optimisation of a whole graph, and live in a stream of events |

mod corrector;
mod deskew;
mod error;
mod followers;
mod free_space;
pub mod graph;
pub mod join;
pub mod loops;
pub mod odometry;
pub mod pose_check;
mod raw_scan;
pub mod refine;
mod registration;
pub mod slam;
mod times_trial;

pub use corrector::Corrector;
pub use error::SlamError;
pub use times_trial::{TimesTrial, TimesVerdict};
