//! The binary `voxelastic`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(voxelastic_cli::run(std::env::args_os(), None))
}
