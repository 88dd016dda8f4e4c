//! Arguments about runs that did not end.

use clap::Args;
use voxelastic_run::keep::{CheckpointEvery, Resume};

/// Arguments about runs that did not end.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Runs that did not end")]
pub struct ResumeArgs {
    /// Go on with the run that did not end; fail if there is none. Without it, a run with the same input and settings goes on, too
    #[arg(long, conflicts_with = "restart", hide_short_help = true)]
    resume: bool,
    /// Map from the beginning, and give up what a run that did not end has mapped
    #[arg(long, hide_short_help = true)]
    restart: bool,
    /// When to keep what is mapped so far, to go on after the process is killed: auto (so that it takes at most a fiftieth of the time),
    /// off, a number of scans, or seconds (30s)
    #[arg(long, value_name = "auto|off|N|SECONDSs", default_value = "auto", hide_short_help = true)]
    pub checkpoints: CheckpointEvery,
}

impl ResumeArgs {
    /// Whether the run goes on with one that did not end.
    pub fn resume(self) -> Resume {
        match (self.resume, self.restart) {
            (true, _) => Resume::Required,
            (_, true) => Resume::Restart,
            _ => Resume::IfSame,
        }
    }
}
