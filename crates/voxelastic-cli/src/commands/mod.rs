//! One file per subcommand: its arguments, its examples, and what it does.

pub mod changes;
pub mod config;
pub mod demo;
pub mod esdf;
pub mod eval;
pub mod explore;
pub mod export;
pub mod heldout;
pub mod info;
pub mod live;
pub mod localize;
pub mod map;
pub mod merge;
pub mod mesh;
pub mod odometry;
pub mod optimize;
pub mod plan;
pub mod remove;
pub mod render;
pub mod repair;
pub mod report;
pub mod simulate;
pub mod slice;
pub mod view;
