//! Poses from scans, loop closures and pose graphs, on simulated and recorded drives.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout)]

mod common;
mod drift;
mod graphs;
mod loops;
mod lost;
mod odometry;
mod positions;
mod refine;
mod storeys;
mod wrong_closures;
