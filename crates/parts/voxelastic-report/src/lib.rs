//! Reports: a map and the run that made it as one self-contained HTML page, without network, server or other files.
//!
//! The page shows the time of each scan (the paper's Fig. 2), memory and submaps (Fig. 3), the time by phase, distances to a reference (Fig. 5), a top
//! view with trajectory and loops, and an interactive 3D view of the surface.
//!
//! The crate does not depend on the structures of the map. A [`Report`] is plain data ([`content`], [`Surface`](surface::Surface), [`RunLog`], which
//! `voxelastic map` stores with a map); [`Report::html`] makes the page: surfaces are decimated to a limit of vertices, quantised and packed
//! (`pack`), and inserted with the other data into the HTML, CSS and JavaScript files of `page/`.
//!
//! ```
//! use voxelastic_report::{Report, surface::Surface};
//! let mut report = Report::titled("a triangle");
//! report.surface.push(Surface {
//!     positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
//!     normals: vec![[0.0, 0.0, 1.0]; 3],
//!     triangles: vec![[0, 1, 2]],
//!     ..Surface::default()
//! });
//! let html = report.html()?;
//! assert!(html.starts_with("<!doctype html>") && html.contains("a triangle") && !html.contains("https://"));
//! # Ok::<(), voxelastic_report::ReportError>(())
//! ```

pub mod content;
mod decimate;
mod error;
mod moving_log;
mod pack;
mod packed_surface;
mod page;
mod run_log;
pub mod scripts;
pub mod shown;
mod split;
pub mod surface;
pub mod tiles_page;

pub use content::Report;
pub use error::{ReportError, Result};
pub use moving_log::MovingLog;
pub use packed_surface::{PackedBytes, pack_surface};
pub use run_log::{Correction, FORMAT, LoopEdge, RegistrationLog, RunLog, ScanLog, TriedClosure, Warning};
