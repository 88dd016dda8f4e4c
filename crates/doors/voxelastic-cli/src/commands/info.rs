//! `voxelastic info`: describes a map, a dataset, a recording or a cloud.

mod cloud;
mod dataset;
mod map;
mod recording;
mod rows;

use crate::args::LoadArgs;
use crate::args::data::DataArgs;
use crate::failure::{self, Failure};
use crate::output;
use clap::Args;
use voxelastic_run::map_files;

/// Describe a map, a folder of scans, a recording or a cloud
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic info hall.vox                    submaps, blocks, sizes, settings
  voxelastic info hall.vox --check            verify every file and compute the extent of the map
  voxelastic info hall                        the scans and poses that `voxelastic map hall` would read
  voxelastic info drive.bag                   topics with types, counts and rates, and those that would be used
  voxelastic info hall/scans/000000.pcd       points, channels, extent")]
pub struct InfoArgs {
    #[command(flatten)]
    data: DataArgs,
    /// For maps: read every submap, verify its checksums, and compute the extent of the map
    #[arg(long)]
    check: bool,
    #[command(flatten)]
    load: LoadArgs,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &InfoArgs) -> anyhow::Result<u8> {
    let path = args.data.path();
    if !path.exists() {
        return Err(Failure::new(format!("{}: no such file or folder", path.display()), "check the path").into());
    }
    if voxelastic_io::bag::is_recording(path)? {
        let info = recording::describe(&args.data)?;
        print(args, &info, recording::table)?;
    } else if path.is_file() {
        let info = cloud::describe(path)?;
        print(args, &info, cloud::table)?;
    } else if map_files::is_map(path) || map_files::has_submap_files(path) || map_files::is_unfinished(path) {
        let info = map::describe(path, args.check, args.load)?;
        print(args, &info, map::table)?;
    } else {
        let info = dataset::describe(&args.data)?;
        print(args, &info, dataset::table)?;
    }
    Ok(failure::DONE)
}

fn print<T: serde::Serialize>(args: &InfoArgs, info: &T, table: impl Fn(&T) -> Vec<(String, String)>) -> anyhow::Result<()> {
    if args.json {
        return output::print_json(info);
    }
    output::print(&table(info).iter().map(|(name, value)| format!("{name:<22}{value}\n")).collect::<String>())
}
