//! Simulated scans as sensors take them.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod motion;
mod sweeps;
mod thin_surface;
