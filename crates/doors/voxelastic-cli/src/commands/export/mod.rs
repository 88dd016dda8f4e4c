//! `voxelastic export`: writes a map as a cloud, as tiles, as an OctoMap or as 2-D maps.

mod args;
mod cloud;
mod grid;
mod octomap;
mod tiles;

pub use args::ExportArgs;

use crate::failure::{self, Failure};
use voxelastic_run::export::{FORMATS, Format};

/// Runs the command.
pub fn run(args: &ExportArgs, quiet: bool) -> anyhow::Result<u8> {
    let unknown = || Failure::usage(format!("{}: not a known format", args.output.display()), FORMATS);
    let format = Format::of(&args.output).ok_or_else(unknown)?;
    if let Some(option) = args.ground.given().filter(|_| format != Format::Grid) {
        return Err(Failure::usage(format!("{option} is for 2-D maps"), "leave it out, or write a 2-D map: -o map.yaml").into());
    }
    match format {
        Format::Octomap { states_only } => octomap::run(args, states_only)?,
        Format::Cloud(_) | Format::Tiles | Format::Grid if args.voxel_size.is_some() => {
            return Err(Failure::usage("--voxel-size is for OctoMaps", "reduce a cloud or tiles with --lod, a 2-D map with --resolution").into());
        }
        Format::Cloud(format) => cloud::run(args, format)?,
        Format::Grid => grid::run(args)?,
        Format::Tiles => tiles::run(args, quiet)?,
    }
    Ok(failure::DONE)
}
