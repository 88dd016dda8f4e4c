//! The command `voxelastic`: LiDAR scans in, with or without poses, an elastic map and meshes out.
//!
//! [`run`] is all of it. The binary calls it, and so does the `voxelastic` of the Python package, within the interpreter's process.
//!
//! ```
//! assert_eq!(voxelastic_cli::run(["voxelastic", "config", "--wrong"]), 2);
//! ```

pub mod allocator;
mod args;
mod commands;
mod failure;
mod interrupt;
mod map_picture;
mod meshing;
mod output;
mod progress;
mod reporting;
mod ros_args;
mod version;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use commands::earth::georeference;
use commands::measuring::{demo, eval, heldout, simulate};
use commands::poses::{localize, odometry, optimize};
use commands::sessions::{changes, edit, merge, refine, remove, repair};
use commands::space::{esdf, explore, plan, slice};
use commands::{check, completions, config as config_command, export, info, live, map, mesh, render, report, view};
use std::ffi::OsString;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
/// The page that streams tiles, by file names; the Python package writes it, too.
pub use voxelastic_report::tiles_page::FILES as TILES_PAGE;

const EXAMPLES: &str = "\
Examples:
  voxelastic demo                          simulate a campus, map it, measure the map, make a report
  voxelastic map hall                      map the folder hall: makes hall.vox
  voxelastic mesh hall.vox -o hall.ply     extract a mesh
  voxelastic render hall.vox -o hall.png   draw a picture";

/// The commands by headings, those that most people need first.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Commands", &["map", "live", "view", "mesh", "export", "render", "report", "check", "info", "plan", "refine", "localize", "demo"]),
    ("Edits, sessions, places on Earth, damaged maps", &["edit", "merge", "remove", "changes", "georeference", "repair"]),
    ("Free space", &["slice", "esdf", "explore"]),
    ("Poses alone", &["odometry", "optimize"]),
    ("Measuring", &["eval", "heldout", "simulate"]),
    ("Settings, shells", &["config", "completions"]),
];

/// The command line, with its commands by headings. Manual pages and completions are made from it.
pub fn command_line() -> clap::Command {
    let command = Cli::command();
    let about = |name: &str| command.find_subcommand(name).and_then(clap::Command::get_about).map(ToString::to_string).unwrap_or_default();
    let row = |name: &&str| format!("  {name:<14}{}\n", about(name));
    let list: String = GROUPS.iter().map(|(heading, names)| format!("{heading}:\n{}\n", names.iter().map(row).collect::<String>())).collect();
    command.help_template(format!("{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}Options:\n{{options}}{{after-help}}"))
}

/// Elastic LiDAR mapping: builds a dense map from registered scans and deforms it when poses are corrected.
///
/// Scans and poses are read from a recording, or from a folder as SLAM systems and datasets write it; the layout is detected. The map is a
/// directory of submaps, from which meshes, clouds and pictures are made.
#[derive(Debug, Parser)]
#[command(
    name = "voxelastic",
    version,
    long_version = version::long(),
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
    Live(Box<live::LiveArgs>),
    View(view::ViewArgs),
    Mesh(mesh::MeshArgs),
    Check(check::CheckArgs),
    Info(info::InfoArgs),
    Render(render::RenderArgs),
    Slice(slice::SliceArgs),
    Export(export::ExportArgs),
    Report(report::ReportArgs),
    Plan(plan::PlanArgs),
    Esdf(esdf::EsdfArgs),
    Explore(explore::ExploreArgs),
    Changes(changes::ChangesArgs),
    Edit(edit::EditArgs),
    Georeference(georeference::GeoreferenceArgs),
    Merge(merge::MergeArgs),
    Refine(refine::RefineArgs),
    Remove(remove::RemoveArgs),
    Repair(repair::RepairArgs),
    Heldout(heldout::HeldoutArgs),
    Eval(eval::EvalArgs),
    Simulate(simulate::SimulateArgs),
    Odometry(odometry::OdometryArgs),
    Localize(localize::LocalizeArgs),
    Optimize(optimize::OptimizeArgs),
    Config(config_command::ConfigArgs),
    Completions(completions::CompletionsArgs),
}

/// Amount of output on stderr.
#[derive(Clone, Copy, Debug, Args)]
struct Logging {
    /// Print warnings and errors only, no progress
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Print debug messages; twice for trace messages, and warnings of libraries
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

impl Logging {
    /// Sends log lines to stderr. `RUST_LOG`, where set, wins over the flags. What libraries have to say, such as those of networks, is for `-v -v`.
    fn install(self) {
        let level = match (self.quiet, self.verbose) {
            (true, _) => "warn",
            (false, 0) => "info",
            (false, 1) => "debug",
            (false, _) => "trace",
        };
        let libraries = if self.verbose > 1 { "warn" } else { "off" };
        let from_environment = std::env::var("RUST_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
        let filter = from_environment.unwrap_or_else(|| format!("{libraries},voxelastic={level}").parse().unwrap_or_default());
        let has_colours = std::io::IsTerminal::is_terminal(&std::io::stderr()) && std::env::var_os("NO_COLOR").is_none();
        let lines = tracing_subscriber::fmt::layer()
            .with_writer(move || progress::LogWriter { has_colours })
            .with_ansi(false)
            .with_target(false)
            .without_time()
            .compact();
        // A second call within a process keeps what the first one installed.
        let _ = tracing_subscriber::registry().with(filter).with(lines).try_init();
    }
}

/// Runs the command with `arguments`, of which the first is the name of the program, and returns the exit code.
///
/// It is made for a process of its own: it installs handlers of signals and a panic hook, and sends log lines to stderr from the first call on.
pub fn run<A: Into<OsString> + Clone>(arguments: impl IntoIterator<Item = A>) -> u8 {
    failure::install_panic_hook();
    let cli = match command_line().try_get_matches_from(ros_args::translated(arguments)).and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(end) => return failure::report_usage(&end),
    };
    cli.logging.install();
    cli.command.run(cli.logging.quiet).unwrap_or_else(|error| failure::report(&error))
}

impl Command {
    fn run(&self, quiet: bool) -> anyhow::Result<u8> {
        match self {
            Self::Demo(args) => demo::run(args, quiet),
            Self::Map(args) => map::run(args, quiet),
            Self::Live(args) => live::run(args, quiet),
            Self::View(args) => view::run(args, quiet),
            Self::Mesh(args) => mesh::run(args),
            Self::Check(args) => check::run(args, quiet),
            Self::Info(args) => info::run(args),
            Self::Render(args) => render::run(args),
            Self::Slice(args) => slice::run(args),
            Self::Export(args) => export::run(args, quiet),
            Self::Report(args) => report::run(args),
            Self::Plan(args) => plan::run(args),
            Self::Esdf(args) => esdf::run(args),
            Self::Explore(args) => explore::run(args, quiet),
            Self::Changes(args) => changes::run(args),
            Self::Edit(args) => edit::run(args),
            Self::Georeference(args) => georeference::run(args),
            Self::Merge(args) => merge::run(args),
            Self::Refine(args) => refine::run(args, quiet),
            Self::Remove(args) => remove::run(args),
            Self::Repair(args) => repair::run(args),
            Self::Heldout(args) => heldout::run(args, quiet),
            Self::Eval(args) => eval::run(args),
            Self::Simulate(args) => simulate::run(args, quiet),
            Self::Localize(args) => localize::run(args, quiet),
            Self::Odometry(args) => odometry::run(args, quiet),
            Self::Optimize(args) => optimize::run(args),
            Self::Config(args) => config_command::run(args),
            Self::Completions(args) => completions::run(args, command_line()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_command_line_is_well_formed() {
        command_line().debug_assert();
    }

    #[test]
    fn every_command_is_under_one_heading() {
        let listed: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let command = Cli::command();
        let all: BTreeSet<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
        assert_eq!(listed.len(), all.len());
        assert_eq!(listed.into_iter().collect::<BTreeSet<_>>(), all);
    }

    #[test]
    fn the_short_help_of_map_has_a_dozen_flags() {
        let mut command = Cli::command();
        let help = command.find_subcommand_mut("map").unwrap().render_help().to_string();
        let flags = help.lines().filter(|line| line.trim_start().starts_with("--") || line.trim_start().starts_with("-o")).count();
        assert!((10..=14).contains(&flags), "{help}");
    }
}
