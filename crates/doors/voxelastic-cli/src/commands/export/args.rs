//! Arguments of `voxelastic export`.

use crate::args::{BodyArgs, LoadArgs};
use crate::meshing::{LayerArgs, SurfaceArgs};
use clap::Args;
use std::path::PathBuf;

/// Write a map as a cloud, as tiles that a browser streams, as an OctoMap, or as 2-D maps for robots
///
/// A cloud has a point for each crossing of the surface between two voxels, in the map frame (LAS, LAZ and COPC of a map on Earth: in its coordinate system), with intensity and colour if the scans have them,
/// and normals in PLY and PCD. Overlapping submaps are fused into one surface; E57 files have one scan per submap instead, with the pose of the submap.
///
/// Tiles (3D Tiles 1.1) are for maps that are too large to download: a folder with the surface at several levels of detail, and a page that loads what it
/// shows. Any server of files can serve the folder; Cesium and other viewers of 3D Tiles read its tileset.json. A later export to the folder writes only what
/// changed.
///
/// An OctoMap is made of the occupancy of all submaps: a voxel is occupied if it is in any submap, free if it is free in some submap and occupied
/// in none, and absent otherwise. Resampling of rotated submaps loses no occupied voxel.
///
/// 2-D maps (map.yaml with an image, as map_server and Nav2 load them) are made of occupancy, too: the floor is followed from below the sensor's way over ramps and kerbs, and a cell is
/// occupied if anything stands between --step and --body-height above the floor or the floor is steeper than the robot climbs, free only where all of that was seen free, else unknown.
/// A building with several storeys gets map_0.yaml, map_1.yaml, .. from below; map.json says how high they are and where they connect.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic export hall.vox -o hall.laz               a cloud for survey software
  voxelastic export hall.vox -o hall.pcd --lod 2       for PCL, a sixteenth of the points
  voxelastic export hall.vox -o hall.copc.laz          a cloud of which viewers load what they show
  voxelastic export hall.vox -o tiles/                 the surface in tiles, with a page: python3 -m http.server -d tiles
  voxelastic export hall.vox -o hall.bt                free and occupied, smallest
  voxelastic export hall.vox -o map.yaml --resolution 0.05 --body-height 0.6  a map for Nav2
  voxelastic export hall.vox -o hall.ot --voxel-size 0.2  with log-odds, coarser")]
pub struct ExportArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    pub map: PathBuf,
    #[command(flatten)]
    pub load: LoadArgs,
    /// The file to write; the extension selects the format: a cloud as .ply, .pcd, .las, .laz, .copc.laz or .e57, an OctoMap as .bt (states) or .ot
    /// (log-odds), 2-D maps as .yaml. A folder, which ends with a slash, gets tiles
    #[arg(short, long, value_name = "FILE|FOLDER/")]
    pub output: PathBuf,
    /// Edge of the OctoMap's voxels, metres [default: the finest voxel of the map]
    #[arg(long, value_name = "M", value_parser = voxel_size)]
    pub voxel_size: Option<f64>,
    /// Print one JSON object on stdout: file, points, intensity, colours, crs, seconds; of tiles folder, tiles, levels, triangles, bytes, files_kept, seconds; of an
    /// OctoMap file, voxel_m, leaves, occupied_leaves, seconds; of 2-D maps file, resolution_m, robot, storeys, connections, seconds
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub ground: GroundArgs,
    #[command(flatten)]
    pub layers: LayerArgs,
    #[command(flatten)]
    pub surface: SurfaceArgs,
}

/// What 2-D maps are made for.
#[derive(Clone, Debug, Args)]
pub struct GroundArgs {
    /// Edge of a cell of a 2-D map, metres [default: the finest voxel of the map]
    #[arg(long, value_name = "M")]
    pub resolution: Option<f64>,
    #[command(flatten)]
    pub robot: BodyArgs,
    /// What the pixels of a 2-D map say: trinary (free, occupied, unknown), scale or raw (also 1 to 99, by how much of what the robot climbs the floor takes)
    #[arg(long, value_name = "MODE", value_parser = ["trinary", "scale", "raw"])]
    pub mode: Option<String>,
}

impl GroundArgs {
    /// The first of these options that was given.
    pub fn given(&self) -> Option<&'static str> {
        let own = [("--resolution", self.resolution.is_some()), ("--mode", self.mode.is_some())];
        own.into_iter().chain(self.robot.given()).find(|(_, given)| *given).map(|(name, _)| name)
    }
}

fn voxel_size(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.005..=10.0).contains(v)).ok_or_else(|| "must be 0.005 to 10 metres".to_owned())
}
