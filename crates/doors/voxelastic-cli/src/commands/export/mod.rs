//! `voxelastic export`: writes a map as a cloud, as tiles or as an OctoMap.

mod args;
mod cloud;
mod octomap;
mod tiles;

pub use args::ExportArgs;

use crate::failure::{self, Failure};
use voxelastic_run::export::{FORMATS, Format};

/// Runs the command.
pub fn run(args: &ExportArgs, quiet: bool) -> anyhow::Result<u8> {
    let unknown = || Failure::usage(format!("{}: not a known format", args.output.display()), FORMATS);
    match Format::of(&args.output).ok_or_else(unknown)? {
        Format::Octomap { states_only } => octomap::run(args, states_only)?,
        Format::Cloud(_) | Format::Tiles if args.voxel_size.is_some() => {
            return Err(Failure::usage("--voxel-size is for OctoMaps", "reduce a cloud or tiles with --lod").into());
        }
        Format::Cloud(format) => cloud::run(args, format)?,
        Format::Tiles => tiles::run(args, quiet)?,
    }
    Ok(failure::DONE)
}
