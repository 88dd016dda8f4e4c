//! The sensor room from outside: models, preparation, normals, recognition; on analytic scenes and on real scans.

// Figures and skipped tests are told on the standard output.
#![allow(clippy::print_stdout)]

mod data;
mod detecting;
mod models;
mod motion;
mod normals;
mod preparing;
mod scene;
