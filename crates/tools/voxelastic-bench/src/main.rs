//! The program `voxelastic-bench`: time, memory and error of the command at the paper's settings, compared with other systems, and their growth.

use anyhow::Context;
use clap::Parser;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use voxelastic_bench::peers::{self, Interpreters, Peer};
use voxelastic_bench::suite::{self, Options};
use voxelastic_bench::{Workspace, comparison, growth, plots, slam, table};

/// Variable with the folder of recorded scans, as for the tests.
const DATA_VARIABLE: &str = "VOXELASTIC_DATA";
/// Its default.
const DATA_FOLDER: &str = "../shared/data";
/// Factor on the time limit of peers for whole recordings.
const SLAM_LIMIT_FACTOR: u32 = 30;
/// Scans of a simulated walk: a minute, after three seconds at rest.
const WALK_SCANS: usize = 630;
/// Variable with the Python interpreter for peers.
const PYTHON_VARIABLE: &str = "VOXELASTIC_PYTHON";

/// Measure speed, memory and error, and compare with other systems on the same scans
///
/// The paper's three settings, both fields, one and two threads, on a simulated campus and on recorded scans where available ($VOXELASTIC_DATA,
/// default ../shared/data). Each configuration is mapped in a separate process, for its own peak of memory, and the map is measured against the
/// world or against held-out scans. The output ends with the goals of the project; the folder then contains bench.json (or growth.json) and
/// plots. Takes ten minutes on a quiet machine, with --quick one.
#[derive(Debug, Parser)]
#[command(
    name = "voxelastic-bench",
    version,
    after_help = "Examples:
  voxelastic-bench --quick                                the hardest setting on 60 scans, to check a change
  voxelastic-bench --peers -o bench                       everything, with OctoMap and VDBFusion on the same scans
  voxelastic-bench --growth                               how cost grows with rings, range, voxels and submaps
  voxelastic-bench --slam --peers                         odometry and loop closures, beside other systems
  voxelastic-bench --comparison docs/comparison.md        everything that pip can install, on everything that is here, as one page
  voxelastic-bench --peer \"Bonxai=python3 bonxai.py\"      another system, by an adapter

OctoMap, VDBFusion and Open3D run in Python: `pip install pyoctomap vdbfusion open3d-cpu` (VDBFusion has packages up to Python 3.10). VOXELASTIC_PYTHON is the
interpreter that has them [default: python3]; --install and --comparison make an environment for each instead. Those of --slam: `pip install kiss-icp genz-icp
kiss-slam map-closures rko-lio retro-slam genz-lio pelorus evalio`. The protocol of adapters is documented in crates/tools/voxelastic-bench/src/peers/mod.rs."
)]
struct BenchArgs {
    /// The command to measure [default: `voxelastic` beside this program]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// The folder for results and simulated scans; existing scans are reused
    #[arg(short, long, value_name = "DIR", default_value = "voxelastic-bench")]
    output: PathBuf,
    /// The hardest setting only, on 60 scans of the campus, without errors; with --comparison, few scans, and none of kitti00-loops
    #[arg(long, conflicts_with = "growth")]
    quick: bool,
    /// Measure the growth of cost instead: tables with fitted exponents, and the cost of new road
    #[arg(long, conflicts_with_all = ["peers", "peer", "repeat"])]
    growth: bool,
    /// Measure odometry and loop closures from the scans alone instead, on the recordings in $VOXELASTIC_DATA that have true poses and on simulated walks
    #[arg(long, conflicts_with_all = ["growth", "quick", "peer", "repeat", "campus"])]
    slam: bool,
    /// Only this recording of --slam [default: all]
    #[arg(long, value_name = "NAME", requires = "slam", value_parser = clap::builder::PossibleValuesParser::new(slam::recordings().collect::<Vec<_>>()))]
    recording: Vec<String>,
    /// Write a page that compares everything that pip can install, on everything that is here: maps, trajectories, closures, moving things
    #[arg(long, value_name = "FILE", conflicts_with_all = ["growth", "slam", "peers", "peer", "repeat", "campus"])]
    comparison: Option<PathBuf>,
    /// Run OctoMap, VDBFusion and Open3D on the same scans, in turn; with --slam, KISS-ICP, GenZ-ICP, KISS-SLAM, MapClosures, RKO-LIO and others
    #[arg(long)]
    peers: bool,
    /// Install each peer in an environment of its own, below the folder for results, instead of using one Python for all
    #[arg(long, requires = "peers")]
    install: bool,
    /// Run another system in turn, by an adapter
    #[arg(long, value_name = "NAME=COMMAND", value_parser = peer)]
    peer: Vec<Peer>,
    /// Time limit of a peer for one configuration, seconds (30 times that for a recording of --slam); the number of its scans is reported
    #[arg(long, value_name = "S", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    peer_limit: u64,
    /// Number of runs of each configuration; the median counts
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=99))]
    repeat: u64,
    /// A folder written by `voxelastic simulate campus -o DIR`, to be used instead of a new one
    #[arg(long, value_name = "DIR")]
    campus: Option<PathBuf>,
    /// Print the results as one JSON object on stdout, instead of the tables
    #[arg(long)]
    json: bool,
}

fn peer(text: &str) -> Result<Peer, String> {
    Peer::parse(text).ok_or_else(|| "must be a name, =, and a command".to_owned())
}

fn main() -> ExitCode {
    let args = BenchArgs::parse();
    tracing_subscriber::fmt().with_writer(std::io::stderr).with_target(false).without_time().init();
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            tracing::error!("{problem:#}");
            ExitCode::FAILURE
        }
    }
}

/// The command beside this program.
fn beside() -> anyhow::Result<PathBuf> {
    let this = std::env::current_exe().context("cannot find the path of this program")?;
    let program = this.with_file_name(format!("voxelastic{}", std::env::consts::EXE_SUFFIX));
    anyhow::ensure!(
        program.is_file(),
        "{}: the command to measure is not there: cargo build --release makes it, --program names another",
        program.display()
    );
    Ok(program)
}

fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let program = args.program.clone().map_or_else(beside, Ok)?;
    let data = std::env::var_os(DATA_VARIABLE).map_or_else(|| PathBuf::from(DATA_FOLDER), PathBuf::from);
    let workspace = Workspace::create(program, args.output.clone())?;
    if args.growth {
        let found = growth::run(&workspace, &data, args.campus.as_deref())?;
        return finish(args, "growth.json", &found, &table::growth(&found));
    }
    if let Some(page) = &args.comparison {
        let mut save = |found: &comparison::Comparison| {
            let text = comparison::page(found);
            if let Err(problem) = voxelastic_files::write(page, |out| out.write_all(text.as_bytes())) {
                tracing::error!("{}: {problem}: choose another file", page.display());
            }
        };
        let found = comparison::run(&workspace, &data, args.quick, &mut save)?;
        return finish(args, "comparison.json", &found, &comparison::page(&found));
    }
    if args.slam {
        let options = slam::Options {
            only: args.recording.clone(),
            peers: args.peers.then(|| interpreters(args, &workspace)),
            limit: SLAM_LIMIT_FACTOR * Duration::from_secs(args.peer_limit),
            walk_scans: WALK_SCANS,
            keyframes_for_closures: false,
        };
        let found = slam::run(&workspace, &data, &options)?;
        return finish(args, "slam.json", &found, &slam::table(&found));
    }
    let options = Options {
        quick: args.quick,
        peers: peers(args, &workspace)?,
        peer_limit: Duration::from_secs(args.peer_limit),
        repeat: args.repeat as usize,
        real_data: data,
        campus: args.campus.clone(),
    };
    let found = suite::run(&workspace, &options)?;
    for file in plots::write(&found, workspace.folder())? {
        tracing::info!("wrote {}", file.display());
    }
    finish(args, "bench.json", &found, &table::suite(&found))
}

fn peers(args: &BenchArgs, workspace: &Workspace) -> anyhow::Result<Vec<Peer>> {
    let mut all = Vec::new();
    if args.peers {
        let (found, missing) = peers::python_peers(workspace, &interpreters(args, workspace))?;
        missing.iter().for_each(|why| tracing::warn!("{why}"));
        all.extend(found);
    }
    all.extend(args.peer.iter().cloned());
    Ok(all)
}

/// The Python of peers.
fn interpreters(args: &BenchArgs, workspace: &Workspace) -> Interpreters {
    if args.install {
        return Interpreters::each(workspace);
    }
    Interpreters::One(std::env::var(PYTHON_VARIABLE).unwrap_or_else(|_| "python3".to_owned()))
}

/// Saves and prints the results.
fn finish(args: &BenchArgs, name: &str, found: &impl Serialize, text: &str) -> anyhow::Result<()> {
    let path: &Path = &args.output.join(name);
    let json = serde_json::to_string(found).context("cannot write the results as JSON")?;
    voxelastic_files::write(path, |out| writeln!(out, "{json}")).with_context(|| format!("{}: choose another folder with -o", path.display()))?;
    tracing::info!("wrote {}", path.display());
    let text = if args.json { json + "\n" } else { text.to_owned() };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to stdout")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peers_need_a_name_and_a_command() {
        assert_eq!(peer("Bonxai=python3 bonxai.py").unwrap().command.len(), 2);
        assert!(peer("bonxai.py").unwrap_err().contains("a name"));
    }
}
