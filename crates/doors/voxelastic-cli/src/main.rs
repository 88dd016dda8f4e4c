//! The binary `voxelastic`.

use std::process::ExitCode;
use std::thread::Builder;
use voxelastic_cli::allocator::{Allocator, install_signals};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

/// Stack of the thread that runs a command, whatever the shell's limit (`ulimit -s`) leaves to the first one.
const STACK: usize = 8 << 20;

fn main() -> ExitCode {
    install_signals();
    #[cfg(unix)]
    without_small_stacks();
    let run = || ExitCode::from(voxelastic_cli::run(std::env::args_os()));
    match Builder::new().name("main".to_owned()).stack_size(STACK).spawn(run) {
        Ok(command) => command.join().unwrap_or(ExitCode::FAILURE),
        Err(_) => run(),
    }
}

/// Begins anew where the environment makes the stacks of all threads smaller than they are otherwise: what overflows one ends without a word about the map.
#[cfg(unix)]
fn without_small_stacks() {
    use std::os::unix::process::CommandExt;
    const NAME: &str = "RUST_MIN_STACK";
    const USUAL: usize = 2 << 20;
    let is_small = std::env::var(NAME).is_ok_and(|text| text.parse::<usize>().is_ok_and(|bytes| bytes < USUAL));
    if let Some(program) = std::env::current_exe().ok().filter(|_| is_small) {
        let mut arguments = std::env::args_os();
        let mut command = std::process::Command::new(program);
        arguments.next().map(|name| command.arg0(name));
        // It returns only if that is not possible.
        let _ = command.args(arguments).env_remove(NAME).exec();
    }
}
