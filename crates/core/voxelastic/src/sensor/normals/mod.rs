//! A local plane for every return, from its neighbours in the range image.
//!
//! A plane is linear in inverse depth: with X, Y, Z along, across and above a pixel's column, the plane aX + bY + cZ = 1 reads 1/X = a + b (Y/X) + c (Z/X). A
//! least-squares fit in these coordinates (Badino et al., ICRA 2011, solve the same system in spherical ones) is exact for planes at any slant: ground whose
//! rings are metres apart is as straight as a wall. Range noise affects 1/X alone, so the fit also gives its own uncertainty.
//!
//! 1. [`grid`]: the coordinates of every pixel, and which neighbours continue one surface (no jump against the trend). Between the first and the last column of a
//!    sweep the sensor has moved on: [`sweep_seam`] separates them.
//! 2. [`covariance`]: sums over a window of about 30 cm that ends where the surface does, along rows, then down columns.
//! 3. [`plane`]: the 3 x 3 systems, and the tests that reject uncertain planes.
//! 4. [`plane_select`]: each return takes the plane of its pixel, or of a neighbour, if it lies on it; else none.

mod covariance;
mod fitter;
mod grid;
mod plane;
mod plane_search;
mod plane_select;
mod settings;
mod sweep_seam;

pub(crate) use fitter::PlaneFitter;
pub use settings::NormalSettings;
