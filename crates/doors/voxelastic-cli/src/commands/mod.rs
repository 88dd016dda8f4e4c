//! One file per subcommand: its arguments, its examples, and what it does.

pub mod check;
pub mod completions;
pub mod config;
pub mod earth;
pub mod export;
pub mod info;
pub mod live;
pub mod map;
pub mod measuring;
pub mod mesh;
pub mod poses;
pub mod render;
pub mod report;
pub mod sessions;
pub mod space;
pub mod view;
