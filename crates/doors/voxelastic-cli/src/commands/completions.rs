//! `voxelastic completions`: what a shell completes.

use crate::{failure, output};
use clap::Args;
use clap_complete::Shell;

/// Print what completes commands and flags in a shell
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  eval \"$(voxelastic completions bash)\"                                                         in ~/.bashrc
  voxelastic completions bash > ~/.local/share/bash-completion/completions/voxelastic
  voxelastic completions zsh > \"${fpath[1]}/_voxelastic\"
  voxelastic completions fish > ~/.config/fish/completions/voxelastic.fish")]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

/// Runs the command, for the command line that is completed.
pub fn run(args: &CompletionsArgs, mut command_line: clap::Command) -> anyhow::Result<u8> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command_line, "voxelastic", &mut script);
    output::print(&String::from_utf8_lossy(&script))?;
    Ok(failure::DONE)
}
