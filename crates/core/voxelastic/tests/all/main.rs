//! The library as a whole, against slow references, on random geometry, simulated worlds and real scans.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout)]

mod changes;
mod common;
mod elastic;
mod fused_surface;
mod occupancy;
mod query;
mod sensor;
mod surface_tiles;
mod tsdf;
