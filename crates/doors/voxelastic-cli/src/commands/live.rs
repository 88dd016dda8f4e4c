//! `voxelastic live`: maps scans as they come.

mod exploring;
mod network;
mod summary;

use crate::args::{CorrectionArgs, DataArgs, ReadingArgs, ResumeArgs, SaveArgs, SettingFlags};
use crate::commands::space::explore::seconds;
use crate::failure::{self, Failure};
use crate::progress::Progress;
use crate::{allocator, interrupt, output};
use clap::Args;
use exploring::ExploringArgs;
use network::NetworkArgs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use summary::Summary;
use voxelastic::memory::MemorySize;
use voxelastic::settings::Settings;
use voxelastic_io::OpenOptions;
use voxelastic_live::link::Link;
use voxelastic_live::node::{KeptIn, ScansFrom, Setup, ViewerSetup, play};
use voxelastic_live::ouster::OusterAddress;
use voxelastic_live::replay::Rate;
use voxelastic_live::spinning::SpinningAddress;
use voxelastic_run::{Corrections, keep};

/// Where the viewer is if nothing else is said: this machine only.
pub const VIEWER: &str = "127.0.0.1:7717";

/// How much the viewer shows.
#[derive(Clone, Copy, Debug, Args)]
pub struct DetailArgs {
    /// Level of detail of the surface in the viewer: 0 is full resolution, 3 has vertices eight voxels apart
    #[arg(long, value_name = "0..3", default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=3))]
    pub view_detail: u8,
}

/// Map scans as they come, as on a robot
///
/// The input is a recording, or a folder of scans, that is played at its own speed or another: each scan comes when its time stamp says, and waits for nothing.
/// Or it is a robot: with --ros2, scans come from topics, with poses by topic or /tf, or estimated; the topics are found by their types. With --ouster or --lidar they are the packets of a sensor.
/// When scans come faster than they can be mapped, four wait (sixteen that came within 0.4 s), and the newest win: for each that comes, the oldest that waits is left out and
/// counted; edges and corrected poses are never left out. With `--rate max` every scan is mapped, as fast as possible.
/// Where no scan is left out, the map is that of `voxelastic map`, bit for bit.
/// Ctrl-C or a termination request ends the input; what has come is mapped and the map is saved. While it maps, it keeps what it has in the folder
/// `unfinished` of the map, a map itself, when no scan waits: the same command goes on after the process was killed or the power failed. A recording goes on from
/// where it was. Scans of a robot, which may have moved meanwhile, are found in the map first, by their poses or by the places that they show; if twenty
/// are not, a new map begins, and that of before is set aside under another name.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic live --from drive.mcap                     as it was recorded, with the poses in it; writes drive.mcap.vox
  voxelastic live --from drive.mcap --rate 4 --every scan   every scan, four times as fast
  voxelastic live --from drive.mcap --view              and a page that shows it: http://127.0.0.1:7717
  voxelastic live --from kitti00 --slam --json          poses by odometry and loop closures; statistics on stdout
  voxelastic live --ros2 --view                         the topics of a robot, until Ctrl-C; writes live.vox
  voxelastic live --ros2=zenoh --cloud-topic /os/points --slam -o site.vox
  voxelastic live --from drive.mcap --ros2              play a recording, and publish its map
  voxelastic live --ros2 --field both --explore --every 0.5m   and publish where to go next
  voxelastic live --ouster os-122312.local --view       straight from an Ouster sensor, without a driver
  voxelastic live --lidar 192.168.1.201 --view          straight from a Velodyne, Hesai or RoboSense")]
pub struct LiveArgs {
    /// Folder with scans, or a recording, to be played: as for `voxelastic map`
    #[arg(long, value_name = "DATA", required_unless_present_any = ["ros2", "ouster", "lidar"])]
    from: Option<PathBuf>,
    /// An Ouster sensor: its name or address, which is asked what it is, or the port to which packets come (with --metadata). Poses are estimated
    #[arg(long, value_name = "HOST|PORT", value_parser = OusterAddress::parse, conflicts_with = "from")]
    ouster: Option<OusterAddress>,
    /// A Velodyne, a Hesai or a RoboSense, which its packets tell: its name or address, or the port to which packets come (2368 unless it is given; 6699 is usual for RoboSense). Poses are estimated
    #[arg(long, visible_aliases = ["velodyne", "hesai", "robosense"], value_name = "HOST[:PORT]|PORT", value_parser = SpinningAddress::parse, conflicts_with_all = ["from", "ouster"])]
    lidar: Option<SpinningAddress>,
    /// Speed at which it is played: 1 is its own, `max` as fast as it can be mapped, with no scan left out
    #[arg(long, value_name = "RATE", default_value = "1", value_parser = Rate::parse)]
    rate: Rate,
    /// Serve a page that shows the map while it grows, and after the end of the input until Ctrl-C. Without an address on this machine only, at
    /// 127.0.0.1:7717; port 0 is one that is free
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, require_equals = true, default_missing_value = VIEWER)]
    view: Option<SocketAddr>,
    /// Let those control the node over HTTP who know the token in this file: POST /save, /mesh, /pause, /resume, /reset, and /load with the path of a saved map, at
    /// the viewer's address; with --explore also /explore, /explore/pause and /explore/home
    #[arg(long, value_name = "FILE", requires = "view")]
    token: Option<PathBuf>,
    #[command(flatten)]
    detail: DetailArgs,
    /// What is published and shown goes over a link that carries so many bytes a second, such as a radio: together --ros2, --foxglove and --view send no more. What is large (surface, OctoMap,
    /// slices and moving points as topics) is not published then; --view has the surface in a tenth of the bytes, what is near the robot first
    #[arg(long, value_name = "BYTES", value_parser = link_rate)]
    link_rate: Option<MemorySize>,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Estimate the poses from the scans, even if the data have some
    #[arg(long)]
    slam: bool,
    #[command(flatten)]
    save: SaveArgs,
    #[command(flatten)]
    resume: ResumeArgs,
    /// Of a robot whose poses may be corrected, keep so much of its scans on disk, in files without names in the folder of the map: what corrections bend is rebuilt from them while it
    /// maps. Beyond it the oldest are given up; none keeps none
    #[arg(long, value_name = "SIZE", default_value = "4GB", hide_short_help = true)]
    keep_scans: MemorySize,
    /// After so many seconds without the transform that says where the lidar is on the robot, take the poses of the robot for those of the lidar. Without this, scans wait for it
    #[arg(long, value_name = "SECONDS", value_parser = seconds, requires = "ros2", hide_short_help = true)]
    mount_timeout: Option<f64>,
    /// Print statistics as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    network: NetworkArgs,
    #[command(flatten)]
    exploring: ExploringArgs,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    corrections: CorrectionArgs,
    #[command(flatten)]
    settings: SettingFlags,
}

/// Slower links would have nothing left beside transforms and figures.
const SLOWEST_LINK: u64 = 10_000;

fn link_rate(text: &str) -> Result<MemorySize, String> {
    let rate = text.parse::<MemorySize>().map_err(|problem| problem.to_string())?;
    if rate.0 < SLOWEST_LINK { Err("must be 10kB (a second) or more".to_owned()) } else { Ok(rate) }
}

/// Runs the command.
pub fn run(args: &LiveArgs, quiet: bool) -> anyhow::Result<u8> {
    if args.from.is_none() && args.corrections.rebuilds() {
        let remedy = "record the topics, and map the recording with it";
        return Err(Failure::usage("submaps cannot be rebuilt: the scans of a robot are not kept".to_owned(), remedy).into());
    }
    let mut settings = args.settings.resolve()?;
    let voxel_size = settings.voxel_size;
    let planner = args.exploring.prepare(&mut settings, args.network.publishes())?;
    let corrections = args.corrections.corrections();
    let link = args.link_rate.map(|rate| Arc::new(Link::new(rate.0 as f64)));
    let setup = Setup {
        name: args.name().to_owned(),
        reading: args.reading(corrections)?,
        settings,
        corrections,
        viewer: args.view.map(|address| ViewerSetup {
            address,
            origins: args.network.origins(),
            detail: args.detail.view_detail,
            link: link.clone(),
            token: args.token.clone(),
        }),
        kept: Some(KeptIn {
            path: keep::path(args.output.as_deref(), args.name())?,
            save: args.save.into(),
            resume: args.resume.resume(),
            checkpoints: args.resume.checkpoints,
        }),
        network: Some(args.network.setup(voxel_size, link)?),
        keep_scans: args.keep_scans.0,
        planner,
        is_stopped: interrupt::requested,
    };
    node(&setup, args.scans(), args.json, quiet)
}

/// Maps `data` with the usual settings, for the viewer at `address` only.
pub fn watch(data: &Path, rate: Option<Rate>, address: SocketAddr, detail: DetailArgs, quiet: bool) -> anyhow::Result<u8> {
    let corrections = Corrections::default();
    let setup = Setup {
        name: data.to_owned(),
        reading: reading(data, &ReadingArgs::default(), corrections),
        settings: Settings::default(),
        corrections,
        viewer: Some(ViewerSetup { address, origins: Vec::new(), detail: detail.view_detail, link: None, token: None }),
        kept: None,
        network: None,
        keep_scans: 0,
        planner: None,
        is_stopped: interrupt::requested,
    };
    node(&setup, ScansFrom::Recording { data: data.to_owned(), rate: rate.unwrap_or_default(), slam: false }, false, quiet)
}

/// How `data` are read, with the poses that the corrections begin with.
fn reading(data: &Path, reading: &ReadingArgs, corrections: Corrections) -> OpenOptions {
    OpenOptions { pose_kind: corrections.pose_kind(), ..DataArgs::at(data, reading).options(false) }
}

/// Maps what comes, saves the map if it is kept, and prints the results.
fn node(setup: &Setup, from: ScansFrom, prints_json: bool, quiet: bool) -> anyhow::Result<u8> {
    allocator::give_back_large_pieces();
    interrupt::install(if setup.kept.is_some() { "mapping what has come and saving the map" } else { "closing the viewer" });
    let mut progress = Progress::new("scans", None, quiet);
    let played = play(setup, from, &mut |mapping| progress.step(|| format!("{} submaps", mapping.atlas().submaps().len())))?;
    drop(progress);
    let Some(mut played) = played else { return Ok(failure::DONE) };
    if setup.kept.is_some() {
        let bytes = played.save()?;
        let summary = Summary::of(&played, bytes);
        summary.log();
        if prints_json {
            output::print_json(&summary)?;
        }
    }
    played.end(interrupt::requested);
    Ok(match () {
        () if played.is_broken => failure::BUG,
        () if played.is_elsewhere() => failure::ELSEWHERE,
        () if played.can_go_on() => failure::INTERRUPTED,
        () => failure::DONE,
    })
}

impl LiveArgs {
    /// What is mapped, for the name of the map and the title of the viewer.
    fn name(&self) -> &Path {
        self.from.as_deref().unwrap_or(Path::new("live"))
    }

    /// How what comes is read.
    fn reading(&self, corrections: Corrections) -> anyhow::Result<OpenOptions> {
        let data = DataArgs::at(self.name(), &self.reading);
        if self.from.is_some() {
            data.check(self.slam)?;
        }
        Ok(OpenOptions { mount_timeout_s: self.mount_timeout, ..reading(self.name(), &self.reading, corrections) })
    }

    /// Where scans come from.
    fn scans(&self) -> ScansFrom {
        match (&self.lidar, &self.from, &self.ouster) {
            (Some(address), ..) => ScansFrom::Spinning(address.clone()),
            (_, Some(data), _) => ScansFrom::Recording { data: data.clone(), rate: self.rate, slam: self.slam },
            (_, _, Some(address)) => ScansFrom::Ouster(address.clone()),
            _ => ScansFrom::Topics { slam: self.slam },
        }
    }
}
