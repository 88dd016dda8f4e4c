//! One file per subcommand: its arguments, its examples, and what it does.

pub mod config;
