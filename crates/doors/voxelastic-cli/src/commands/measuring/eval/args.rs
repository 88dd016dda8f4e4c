//! Arguments of `voxelastic eval`.

use super::truth::Limits;
use crate::args::LoadArgs;
use crate::meshing::SurfaceArgs;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_eval::metrics::CompareSettings;

/// Measure a map, mesh or cloud against the truth
///
/// Against a survey (a cloud or mesh), as in the paper: all submaps are fused into one TSDF, the vertices of its mesh are aligned to the truth
/// (point-to-plane ICP), the truth is downsampled to 5 cm, and distances are from point to nearest point; for a mesh also to its triangles.
///
/// Against a simulated folder, or its world.toml: distances to the world are exact, completeness is that of the visible surface, free and
/// occupied space are measured, and the poses of the map are compared with the true ones. Nothing is aligned: map and world have one frame.
///
/// Against any other folder of scans: only the poses, scan by scan. The true poses are those in the file that is named ground truth, or in the
/// one that --poses names.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic eval quad.vox --truth survey.ply                 a map against a survey, aligned to it
  voxelastic eval quad.ply --truth survey.pcd --error-ply errors.ply
  voxelastic eval campus.vox --truth campus                   against the world that was simulated into campus
  voxelastic eval campus.vox --truth campus --field occupancy --max-range 20
  voxelastic eval kitti00.vox --truth kitti00                 the poses of the map against the ground truth in kitti00
  voxelastic eval kitti00.vox --truth kitti00 --poses gps.tum the same with another file of true poses
  voxelastic eval quad.vox --truth survey.ply --thresholds 0.05,0.2 --json")]
pub struct EvalArgs {
    /// The map, or a mesh or cloud (.ply, .pcd, .bin) of another program
    #[arg(value_name = "MAP.vox|MESH|CLOUD")]
    pub map: PathBuf,
    #[command(flatten)]
    pub load: LoadArgs,
    /// The truth: a cloud, a mesh, a simulated folder or its world.toml, or a folder with ground truth poses
    #[arg(long, value_name = "CLOUD|MESH|DIR|world.toml")]
    pub truth: PathBuf,
    /// The file of true poses in the folder of --truth: a path, a name, or a part of one [default: the one named ground truth]
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Do not align a cloud or mesh: it is in the map frame already
    #[arg(long)]
    pub no_align: bool,
    /// Align to a simulated world, too: for maps whose first pose is not the true one
    #[arg(long, conflicts_with = "no_align")]
    pub align: bool,
    /// Distances for precision, recall and F-score, metres
    #[arg(long, value_name = "M,..", value_delimiter = ',', default_value = "0.05,0.1,0.2,0.5", value_parser = length)]
    pub thresholds: Vec<f32>,
    /// Maximum range for completeness and occupancy of simulated worlds, metres
    #[arg(long, value_name = "M", default_value_t = Limits::default().max_range, value_parser = length)]
    pub max_range: f32,
    /// The truth is downsampled to one point per cube of this edge, metres
    #[arg(long, value_name = "M", default_value_t = Limits::default().truth_voxel, value_parser = length, hide_short_help = true)]
    pub truth_voxel: f32,
    /// Measure accuracy at this many points of the map at most, evenly selected
    #[arg(long, value_name = "N", default_value_t = usize::MAX, hide_default_value = true, hide_short_help = true, conflicts_with = "error_ply")]
    pub max_points: usize,
    /// The field to measure [default: tsdf if the map has it, else occupancy; and free and occupied space]
    #[arg(long, value_enum)]
    pub field: Option<Field>,
    /// Measure the meshes of the submaps as `voxelastic mesh --unfused` writes them, instead of fusing the submaps first
    #[arg(long)]
    pub unfused: bool,
    /// Write the measured points coloured by their errors: from teal for none to dark red for --error-max and more
    #[arg(long, value_name = "FILE.ply")]
    pub error_ply: Option<PathBuf>,
    /// Error at the end of the colour scale of --error-ply, metres
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = length, requires = "error_ply")]
    pub error_max: f32,
    /// Print one JSON object on stdout
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub surface: SurfaceArgs,
}

/// The field of a map that is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Field {
    /// Vertices of the mesh of the TSDF
    Tsdf,
    /// Centres of the occupied voxels
    Occupancy,
}

impl EvalArgs {
    /// The arguments of `eval MAP --truth TRUTH`.
    pub fn of(map: &Path, truth: &Path) -> Self {
        Self {
            load: LoadArgs::default(),
            map: map.to_owned(),
            truth: truth.to_owned(),
            poses: None,
            no_align: false,
            align: false,
            thresholds: CompareSettings::default().thresholds,
            max_range: Limits::default().max_range,
            truth_voxel: Limits::default().truth_voxel,
            max_points: usize::MAX,
            field: None,
            unfused: false,
            error_ply: None,
            error_max: 0.1,
            json: false,
            surface: SurfaceArgs::default(),
        }
    }

    /// These arguments for one field of the map.
    pub fn with_field(self, field: Field) -> Self {
        Self { field: Some(field), ..self }
    }

    /// These arguments with accuracy measured at `most` points of the map.
    pub fn with_max_points(self, most: usize) -> Self {
        Self { max_points: most, ..self }
    }

    /// Limits on the truth.
    pub fn limits(&self) -> Limits {
        Limits { truth_voxel: self.truth_voxel, max_range: self.max_range, ..Limits::default() }
    }
}

fn length(text: &str) -> Result<f32, String> {
    let wrong = || "must be a length in metres, from 0.001 to 1000".to_owned();
    text.trim().parse().ok().filter(|m| (0.001..=1000.0).contains(m)).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_limited_to_a_sensible_range() {
        assert_eq!(length("0.05"), Ok(0.05));
        assert!(["0", "-1", "nan", "inf", "five", ""].iter().all(|t| length(t).unwrap_err().contains("metres")));
    }
}
