//! The binary `voxelastic`.

use std::process::ExitCode;
use voxelastic_cli::allocator::Allocator;

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

fn main() -> ExitCode {
    ExitCode::from(voxelastic_cli::run(std::env::args_os()))
}
