//! The public interface of `sensor`: models, preparation, normals, recognition; on analytic scenes and on real scans.

// Measured figures and skipped tests are printed.
#![allow(clippy::print_stdout)]

mod data;
mod detecting;
mod models;
mod motion;
mod normals;
mod preparing;
mod scattered;
mod scene;
