//! `voxelastic export`: writes a map as a cloud, as tiles or as an OctoMap.

mod args;
mod cloud;
mod octomap;
mod tiles;

pub use args::ExportArgs;

use crate::failure::{self, Failure};
use std::path::Path;

/// File formats that maps are exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Octomap {
        states_only: bool,
    },
    Cloud(cloud::Format),
    /// A folder of 3D Tiles.
    Tiles,
}

impl Format {
    fn of(path: &Path) -> Option<Self> {
        // The end of the name is lost in a path.
        let is_folder = path.is_dir() || path.as_os_str().as_encoded_bytes().ends_with(b"/");
        if is_folder {
            return Some(Self::Tiles);
        }
        let name = path.file_name()?.to_str()?.to_lowercase();
        if name.ends_with(".copc.laz") {
            return Some(Self::Cloud(cloud::Format::Copc));
        }
        let ending = path.extension()?.to_str()?.to_lowercase();
        Some(match ending.as_str() {
            "bt" => Self::Octomap { states_only: true },
            "ot" => Self::Octomap { states_only: false },
            other => Self::Cloud(cloud::Format::of(other)?),
        })
    }
}

/// Runs the command.
pub fn run(args: &ExportArgs, quiet: bool) -> anyhow::Result<u8> {
    let unknown = || {
        let remedy = "use the extension .ply, .pcd, .las, .laz, .copc.laz, .e57, .bt or .ot, or end a folder for tiles with a slash: tiles/";
        Failure::usage(format!("{}: not a known format", args.output.display()), remedy)
    };
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
