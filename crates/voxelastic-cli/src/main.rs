//! `voxelastic`: LiDAR scans and poses in, an elastic map and meshes out.

mod commands;
mod config;
mod data;
mod elastic;
mod failure;
mod interrupt;
mod map_files;
mod mapping;
mod meshing;
mod output;
mod progress;
mod recorder;
mod reporting;
mod usage;

use clap::{Args, Parser, Subcommand};
#[cfg(feature = "optimize")]
use commands::optimize;
use commands::{bench, config as config_command, demo, eval, export, heldout, info, map, mesh, plan, render, report, simulate, slice};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "\
Examples:
  voxelastic demo                          see what it does: simulates, maps, measures, shows
  voxelastic map hall                      map the folder hall: makes hall.vox
  voxelastic mesh hall.vox -o hall.ply     make a mesh of it
  voxelastic render hall.vox -o hall.png   look at it";

/// Elastic LiDAR maps: registered scans in, one dense map that bends with pose corrections out.
///
/// Scans and poses are read from a folder as SLAM systems and datasets leave it; the layout is recognised. The map is a directory of
/// submaps, from which meshes and pictures are made.
#[derive(Debug, Parser)]
#[command(
    name = "voxelastic",
    version,
    arg_required_else_help = true,
    subcommand_required = true,
    after_help = EXAMPLES,
    after_long_help = format!("{EXAMPLES}\n\n{}", failure::EXIT_CODES)
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    logging: Logging,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Map(map::MapArgs),
    Mesh(mesh::MeshArgs),
    Info(info::InfoArgs),
    Render(render::RenderArgs),
    Slice(slice::SliceArgs),
    Export(export::ExportArgs),
    Report(report::ReportArgs),
    Plan(plan::PlanArgs),
    Heldout(heldout::HeldoutArgs),
    Eval(eval::EvalArgs),
    Simulate(simulate::SimulateArgs),
    Bench(bench::BenchArgs),
    #[cfg(feature = "optimize")]
    Optimize(optimize::OptimizeArgs),
    Config(config_command::ConfigArgs),
}

/// How much is told on stderr.
#[derive(Clone, Copy, Debug, Args)]
struct Logging {
    /// Only warnings and errors; no progress
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// More about what happens; twice for everything
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

impl Logging {
    /// Sends log lines to stderr. `RUST_LOG`, where set, wins over the flags.
    fn install(self) {
        let level = match (self.quiet, self.verbose) {
            (true, _) => "warn",
            (false, 0) => "info",
            (false, 1) => "debug",
            (false, _) => "trace",
        };
        let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
        let ansi = std::io::IsTerminal::is_terminal(&std::io::stderr()) && std::env::var_os("NO_COLOR").is_none();
        tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(|| progress::LogWriter)
            .with_ansi(ansi)
            .with_target(false)
            .without_time()
            .compact()
            .init();
    }
}

fn main() -> ExitCode {
    failure::install_panic_hook();
    let cli = Cli::parse();
    cli.logging.install();
    let quiet = cli.logging.quiet;
    let done = match &cli.command {
        Command::Demo(args) => demo::run(args, quiet),
        Command::Map(args) => map::run(args, quiet),
        Command::Mesh(args) => mesh::run(args),
        Command::Info(args) => info::run(args),
        Command::Render(args) => render::run(args),
        Command::Slice(args) => slice::run(args),
        Command::Export(args) => export::run(args),
        Command::Report(args) => report::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Heldout(args) => heldout::run(args, quiet),
        Command::Eval(args) => eval::run(args),
        Command::Simulate(args) => simulate::run(args, quiet),
        Command::Bench(args) => bench::run(args),
        #[cfg(feature = "optimize")]
        Command::Optimize(args) => optimize::run(args),
        Command::Config(args) => config_command::run(args),
    };
    match done {
        Ok(code) => ExitCode::from(code),
        Err(error) => failure::report(&error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_well_formed() {
        Cli::command().debug_assert();
    }
}
