//! `voxelastic view`: a map, or a recording while it is mapped, in the browser.

use crate::args::LoadArgs;
use crate::commands::live::{self, DetailArgs, VIEWER};
use crate::failure::Failure;
use crate::interrupt;
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;
use voxelastic_live::node::{Figures, ViewerSetup, Watch};
use voxelastic_live::replay::Rate;
use voxelastic_run::map_files::{self, is_map};
use voxelastic_run::threads;
use voxelastic_run::usage;

/// Show a map in the browser, or a recording while it is mapped
///
/// Serves a page on this machine, for any number of browsers: the surface in 3D, submaps, trajectory; of a recording, also the robot, its last scan and how the map bends when loops
/// close. The page needs no network. A recording is mapped with the usual settings, and the map is not saved: `voxelastic live --view` has all settings and
/// saves it. Ctrl-C ends.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic view hall.vox                        then open http://127.0.0.1:7717
  voxelastic view drive.mcap --rate 4             maps it, four times as fast as it was recorded
  voxelastic view hall.vox --address 0.0.0.0:80   for everyone who reaches this machine")]
pub struct ViewArgs {
    /// A map, a folder of scans, or a recording
    #[arg(value_name = "MAP|DATA")]
    thing: PathBuf,
    /// Where to serve: an address of this machine and a port; port 0 is one that is free
    #[arg(long, value_name = "ADDRESS:PORT", default_value = VIEWER)]
    address: SocketAddr,
    /// Speed at which a recording is played: 1 is its own, `max` as fast as it can be mapped [default: 1]
    #[arg(long, value_name = "RATE", value_parser = Rate::parse)]
    rate: Option<Rate>,
    #[command(flatten)]
    detail: DetailArgs,
    #[command(flatten)]
    load: LoadArgs,
}

/// Runs the command.
pub fn run(args: &ViewArgs, quiet: bool) -> anyhow::Result<u8> {
    if !is_map(&args.thing) {
        if args.load.skip_damaged {
            return Err(Failure::usage(format!("{} is not a map, and --skip-damaged is for maps", args.thing.display()), "leave it out").into());
        }
        return live::watch(&args.thing, args.rate, args.address, args.detail, quiet);
    }
    if args.rate.is_some() {
        return Err(Failure::usage(format!("{} is a map, and --rate is for recordings", args.thing.display()), "leave it out").into());
    }
    let pool = threads::pool(0)?;
    let viewer = ViewerSetup { address: args.address, origins: Vec::new(), detail: args.detail.view_detail, link: None, token: None };
    let mut watch = Watch::start(&args.thing, &viewer, None)?;
    let map = pool.install(|| map_files::load_surfaces(&args.thing, args.load.into()))?;
    interrupt::install("closing the viewer");
    watch.publisher.note_atlas(&map.atlas, None);
    let figures = Figures {
        state: "a saved map",
        scans: map.atlas.scan_count(),
        submaps: map.atlas.submaps().len(),
        map_mb: usage::megabytes(map.atlas.bytes() as u64),
        rss_mb: usage::resident_bytes().map(usage::megabytes),
        ..Figures::default()
    };
    watch.stay(&map.atlas, &pool, figures, interrupt::requested);
    Ok(crate::failure::DONE)
}
