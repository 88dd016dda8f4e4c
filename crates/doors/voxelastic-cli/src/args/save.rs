//! Arguments about the map that is saved.

use crate::interrupt;
use clap::{Args, ValueEnum};
use voxelastic_run::keep::{self, SaveOptions};

/// What to do when the finished map cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum OnFullDisk {
    /// Save it in the current, the home or the temporary folder, whichever has the space (exit code 3); if none has, wait
    Elsewhere,
    /// Keep it in memory and try again until it fits; after an interrupt try elsewhere
    Wait,
    /// Give it up and end with exit code 1
    Fail,
}

/// Arguments about the map that is saved.
#[derive(Clone, Copy, Debug, Args)]
pub struct SaveArgs {
    /// Replace an existing map even if it has more scans than the new one
    #[arg(long, hide_short_help = true)]
    overwrite: bool,
    /// What to do when the finished map cannot be written, because the disk is full for one
    #[arg(long, value_name = "WHAT", default_value = "elsewhere", hide_short_help = true)]
    on_full_disk: OnFullDisk,
}

impl From<SaveArgs> for SaveOptions {
    fn from(args: SaveArgs) -> Self {
        let on_full_disk = match args.on_full_disk {
            OnFullDisk::Elsewhere => keep::OnFullDisk::Elsewhere,
            OnFullDisk::Wait => keep::OnFullDisk::Wait,
            OnFullDisk::Fail => keep::OnFullDisk::Fail,
        };
        Self { overwrite: args.overwrite, on_full_disk, is_stopped: Some(interrupt::requested) }
    }
}
