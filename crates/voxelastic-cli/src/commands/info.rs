//! `voxelastic info`: what is in a map, a dataset or a cloud.

mod cloud;
mod dataset;
mod map;
mod recording;

use crate::data::DataArgs;
use crate::failure::{self, Failure};
use crate::{map_files, output};
use clap::Args;

/// Tell what is in a map, a folder of scans, a recording or a cloud
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic info hall.vox                    submaps, blocks, sizes, settings
  voxelastic info hall.vox --check            verify every file, and measure the map's extent
  voxelastic info hall                        what `voxelastic map hall` would read
  voxelastic info drive.bag                   topics, types, counts, rates, and which would be used
  voxelastic info hall/scans/000000.pcd       points, channels, extent")]
pub struct InfoArgs {
    #[command(flatten)]
    data: DataArgs,
    /// For maps: read every submap, verify its checksums, and give the extent of the map
    #[arg(long)]
    check: bool,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// Tells what is there.
pub fn run(args: &InfoArgs) -> anyhow::Result<u8> {
    let path = args.data.path();
    if !path.exists() {
        return Err(Failure::new(format!("{}: there is nothing of this name", path.display()), "check the path").into());
    }
    if voxelastic_io::bag::is_recording(path)? {
        let info = recording::look(&args.data)?;
        show(args, &info, recording::table)?;
    } else if path.is_file() {
        let info = cloud::look(path)?;
        show(args, &info, cloud::table)?;
    } else if map_files::looks_like_map(path) {
        let info = map::look(path, args.check)?;
        show(args, &info, map::table)?;
    } else {
        let info = dataset::look(&args.data)?;
        show(args, &info, dataset::table)?;
    }
    Ok(failure::DONE)
}

fn show<T: serde::Serialize>(args: &InfoArgs, info: &T, table: impl Fn(&T) -> Vec<(String, String)>) -> anyhow::Result<()> {
    if args.json {
        return output::print_json(info);
    }
    output::print(&table(info).iter().map(|(name, value)| format!("{name:<22}{value}\n")).collect::<String>())
}

/// A row of a table.
fn row(name: &str, value: impl std::fmt::Display) -> (String, String) {
    (name.to_owned(), value.to_string())
}

/// An axis-aligned box, metres.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    /// The box, if anything is in it.
    fn of(aabb: &voxelastic::geometry::Aabb) -> Option<Self> {
        (!aabb.is_empty()).then_some(Self { min: aabb.min, max: aabb.max })
    }
}

impl std::fmt::Display for Bounds {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let axis = |name: &str, k: usize| format!("{name} {:.2} to {:.2}", self.min[k], self.max[k]);
        write!(f, "{}, {}, {} m", axis("x", 0), axis("y", 1), axis("z", 2))
    }
}
