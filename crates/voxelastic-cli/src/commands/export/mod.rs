//! `voxelastic export`: a map for other people's software.

mod cloud;
mod octomap;

use crate::failure::{self, Failure};
use crate::meshing::SurfaceArgs;
use clap::Args;
use std::path::{Path, PathBuf};

/// Write a map as a cloud or as an OctoMap
///
/// A cloud has a point wherever the surface passes between two voxels, in the map frame, with intensity and colour where the scans had
/// them, and normals in PLY and PCD. E57 has one scan per submap, with the submap's pose.
///
/// An OctoMap is made of the map's occupancy. All submaps become one: a voxel is occupied if any submap says so, free if some submap says so
/// and none occupied, and absent otherwise. Where submaps are turned against the OctoMap's grid, no occupied voxel is lost.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic export hall.vox -o hall.laz               a cloud for survey software
  voxelastic export hall.vox -o hall.pcd --lod 2       for PCL, a sixteenth of the points
  voxelastic export hall.vox -o hall.bt                free and occupied, smallest
  voxelastic export hall.vox -o hall.ot --voxel 0.2    with log-odds, coarser")]
pub struct ExportArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// The file to write; its ending says the format: a cloud as .ply, .pcd, .las, .laz or .e57, an OctoMap as .bt (states) or .ot (log-odds)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Edge of the OctoMap's voxels, metres [default: the map's finest voxel]
    #[arg(long, value_name = "M", value_parser = voxel)]
    voxel: Option<f64>,
    /// Print one JSON object on stdout: file, points, intensity, colours, seconds; of an OctoMap file, voxel_m, leaves, occupied_leaves, seconds
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    surface: SurfaceArgs,
}

fn voxel(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.005..=10.0).contains(v)).ok_or_else(|| "must be 0.005 to 10 metres".to_owned())
}

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

/// Writes the file.
pub fn run(args: &ExportArgs) -> anyhow::Result<u8> {
    let unknown =
        || Failure::usage(format!("{}: no format of that name", args.output.display()), "end the name with .ply, .pcd, .las, .laz, .e57, .bt or .ot");
    match Format::of(&args.output).ok_or_else(unknown)? {
        Format::Octomap { states_only } => octomap::run(args, states_only)?,
        Format::Cloud(_) if args.voxel.is_some() => {
            return Err(Failure::usage("--voxel is for OctoMaps", "thin a cloud with --lod").into());
        }
        Format::Cloud(format) => cloud::run(args, format)?,
    }
    Ok(failure::DONE)
}
