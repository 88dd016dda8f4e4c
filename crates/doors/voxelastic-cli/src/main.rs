//! The binary `voxelastic`.

use std::process::ExitCode;
use voxelastic_cli::allocator::{Allocator, install_signals};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

fn main() -> ExitCode {
    install_signals();
    ExitCode::from(voxelastic_cli::run(std::env::args_os()))
}
