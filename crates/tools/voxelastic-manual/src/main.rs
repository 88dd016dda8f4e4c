//! Writes the manual pages of the command: `voxelastic.1` and one page for each subcommand, `voxelastic-map.1` and so on.
//!
//! ```sh
//! cargo run -p voxelastic-manual -- FOLDER
//! ```

#![allow(clippy::print_stderr)]

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("usage: voxelastic-manual FOLDER");
        return ExitCode::from(2);
    };
    match write(&folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: cannot write manual pages into {}: {error}", folder.display());
            ExitCode::FAILURE
        }
    }
}

/// Writes all pages into `folder`, which is made where it is missing.
fn write(folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    // The short version: the page is the same on every machine.
    clap_mangen::generate_to(voxelastic_cli::command_line().long_version(env!("CARGO_PKG_VERSION")), folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_with_its_flags() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path()).unwrap();
        let page = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut command = voxelastic_cli::command_line();
        command.build();
        for subcommand in command.get_subcommands().filter(|c| c.get_name() != "help") {
            let name = subcommand.get_name();
            assert!(page("voxelastic.1").contains(&format!("voxelastic\\-{name}(1)")), "{name} is not in voxelastic.1");
            let text = page(&format!("voxelastic-{name}.1"));
            for flag in subcommand.get_arguments().filter(|a| !a.is_hide_set()).filter_map(|a| a.get_long()) {
                assert!(text.contains(&format!("\\-\\-{}", flag.replace('-', "\\-"))), "--{flag} is not in the page of {name}");
            }
        }
    }
}
