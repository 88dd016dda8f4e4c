//! A map and the run that made it as one HTML page that needs nothing else: no network, no server, no other file.
//!
//! The page shows how long each scan took (the paper's Fig. 2), what memory and submaps did (Fig. 3), where the time went, how far the map is
//! from a truth (Fig. 5), the map from above with its trajectory and loops, and the surface in 3D, to be turned, sliced and coloured.
//!
//! Nothing here knows the map's own structures. A [`Report`] is plain data; [`Report::html`] makes the page of it.
//!
//! | question | room |
//! | --- | --- |
//! | What is on the page? | [`Report`], [`content`] |
//! | What is remembered of a run? | [`RunLog`], which `voxelastic map` stores beside the map |
//! | How does a surface of millions of vertices fit into a page? | [`surface`]: thinned, quantised and packed (`pack`) |
//! | What does the page look like, and what does it do? | `page/`: HTML, CSS and JavaScript, put together by [`page`] |
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
mod error;
mod pack;
pub mod page;
mod run_log;
pub mod surface;
mod thin;

pub use content::Report;
pub use error::{ReportError, Result};
pub use run_log::{Correction, FORMAT, LoopEdge, RunLog, ScanLog};
