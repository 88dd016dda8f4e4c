//! The binary `voxelastic`.

mod allocator;

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: allocator::Allocator = allocator::Allocator;

fn main() -> ExitCode {
    ExitCode::from(voxelastic_cli::run(std::env::args_os(), None))
}
