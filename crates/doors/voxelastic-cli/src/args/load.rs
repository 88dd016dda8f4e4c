//! How commands that read a map load it.

use clap::Args;
use voxelastic::memory::MemorySize;
use voxelastic_run::map_files::Loading;

/// How commands that read a map load it.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct LoadArgs {
    /// Leave out submaps whose files are damaged or missing, and count them, instead of failing
    #[arg(long)]
    pub skip_damaged: bool,
    /// Show, too, what later sessions, or laps with --laps apart, saw to be gone: otherwise surfaces and occupied space where they know free space only are left out
    #[arg(long)]
    pub keep_vanished: bool,
    /// Memory that the program may have, such as 500MB: what of the map, and of what is made of it, is beyond that is kept in files in TMPDIR or /var/tmp
    #[arg(long, value_name = "SIZE", default_value = "none", hide_default_value = true)]
    pub memory: MemorySize,
}

impl From<LoadArgs> for Loading {
    fn from(args: LoadArgs) -> Self {
        let LoadArgs { skip_damaged, keep_vanished, memory } = args;
        Self { skip_damaged, keep_vanished, memory }
    }
}
