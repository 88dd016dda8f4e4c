//! `voxelastic config`: prints a documented configuration file.

use crate::args::settings::{SettingFlags, documented_toml};
use crate::{failure, output};
use clap::Args;

/// Print a configuration file with all settings, their units, ranges and defaults
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic config > mapping.toml                       then edit, and: voxelastic map DATA --config mapping.toml
  voxelastic config --voxel-size 0.1 --max-range 80           with some values changed
  voxelastic config --config old.toml --threads 2        a complete file from a partial one")]
pub struct ConfigArgs {
    #[command(flatten)]
    settings: SettingFlags,
}

/// Runs the command.
pub fn run(args: &ConfigArgs) -> anyhow::Result<u8> {
    output::print(&documented_toml(&args.settings.resolve()?))?;
    Ok(failure::DONE)
}
