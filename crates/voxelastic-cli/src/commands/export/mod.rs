//! `voxelastic export`: writes a map as a cloud or an OctoMap.

mod args;
mod cloud;
mod octomap;

pub use args::ExportArgs;

use crate::failure::{self, Failure};
use std::path::Path;

/// File formats that maps are exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Octomap { states_only: bool },
    Cloud(cloud::Format),
}

impl Format {
    fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_lowercase();
        Some(match ending.as_str() {
            "bt" => Self::Octomap { states_only: true },
            "ot" => Self::Octomap { states_only: false },
            other => Self::Cloud(cloud::Format::of(other)?),
        })
    }
}

/// Runs the command.
pub fn run(args: &ExportArgs) -> anyhow::Result<u8> {
    let unknown =
        || Failure::usage(format!("{}: not a known format", args.output.display()), "use the extension .ply, .pcd, .las, .laz, .e57, .bt or .ot");
    match Format::of(&args.output).ok_or_else(unknown)? {
        Format::Octomap { states_only } => octomap::run(args, states_only)?,
        Format::Cloud(_) if args.voxel_size.is_some() => {
            return Err(Failure::usage("--voxel-size is for OctoMaps", "reduce a cloud with --lod").into());
        }
        Format::Cloud(format) => cloud::run(args, format)?,
    }
    Ok(failure::DONE)
}
