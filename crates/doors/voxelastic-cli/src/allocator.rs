//! The memory of the process: that of the memory budget or the system's, and what is said when there is no more.
//!
//! Rust ends a program that gets no memory with a line of its own and SIGABRT, and lets nobody add to that on stable versions but the allocator. A small request that
//! is refused ends the program in it; a large one may have somebody who knows what to do without, so what it ends is told by the signal.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicBool, Ordering};
use voxelastic::memory::BudgetAllocator;
use voxelastic_files::last_read;

/// A larger request may be refused although there is memory, and some of those who make one have an answer to that: for a length in a damaged file,
/// for one.
const LARGE: usize = 256 << 20;
/// Whether a large request was refused.
static IS_REFUSED: AtomicBool = AtomicBool::new(false);
/// Exit code of a command that failed.
#[cfg(target_os = "linux")]
const FAILED: i32 = 1;

const MESSAGE: &[u8] = b"error: out of memory: the system gives no more
  Maps saved before are not affected. `map` keeps what it had at its last checkpoint: the same command goes on from there.
  remedy: --memory 500MB, or whatever there is, keeps most of the map in a file; larger voxels (--voxel-size) and a shorter range (--max-range) need less;
          a limit of the shell (ulimit -v) or of a container may be too low
";

/// Requests of this size and more are mapped and unmapped by themselves, bytes.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAPPED: i32 = 256 << 10;

/// Has memory that is freed in large pieces given back to the system at once. By itself, the C library comes to keep pieces of up to 32 MB for later, once one such has
/// been freed: in a process that runs for hours, what was needed for a moment stays its own.
pub fn give_back_large_pieces() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: it only sets a number in the C library. If it is refused, all is as it was.
        let _ = unsafe { nix::libc::mallopt(nix::libc::M_MMAP_THRESHOLD, MAPPED) };
    }
}

/// Has the program end in order where the system refuses: without memory, whatever the size of the request; and not at all when a file grows beyond a limit of the
/// shell (`ulimit -f`), which is an error of writing then.
pub fn install_signals() {
    #[cfg(target_os = "linux")]
    {
        use nix::libc::{SIG_DFL, SIG_IGN, SIGABRT, SIGXFSZ, sighandler_t, signal};
        /// Of a large request that was refused and that nobody could do without.
        extern "C" fn aborted(_: nix::libc::c_int) {
            if IS_REFUSED.load(Ordering::Relaxed) {
                end();
            }
            // SAFETY: the signal comes again, and ends the process as if this were not here.
            unsafe { signal(SIGABRT, SIG_DFL) };
        }
        // SAFETY: the handler calls nothing but functions that may be called in one, and the other signal is ignored.
        unsafe {
            signal(SIGABRT, aborted as *const () as sighandler_t);
            signal(SIGXFSZ, SIG_IGN);
        }
    }
}

/// The allocator of the program.
pub struct Allocator;

// SAFETY: all memory is the other allocator's, which gets the layouts as they are.
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise about the layout is passed on.
        checked(unsafe { BudgetAllocator.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        checked(unsafe { BudgetAllocator.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as above, and the memory is the other allocator's.
        checked(unsafe { BudgetAllocator.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { BudgetAllocator.dealloc(memory, layout) }
    }
}

#[inline]
fn checked(memory: *mut u8, size: usize) -> *mut u8 {
    if memory.is_null() {
        if size < LARGE {
            end();
        }
        IS_REFUSED.store(true, Ordering::Relaxed);
    }
    memory
}

/// Ends the process with a message, without a request for memory and without anything that others do at the end of it.
#[cold]
fn end() -> ! {
    #[cfg(target_os = "linux")]
    {
        // Where nobody reads it, there is nobody to tell.
        let _ = nix::unistd::write(std::io::stderr(), MESSAGE);
        last_read(|path| {
            for part in [b"  the file that was read last: ".as_slice(), path, b"\n"] {
                let _ = nix::unistd::write(std::io::stderr(), part);
            }
        });
        // SAFETY: it only ends the process.
        unsafe { nix::libc::_exit(FAILED) }
    }
    #[cfg(not(target_os = "linux"))]
    {
        use std::io::Write;
        let _ = std::io::stderr().write_all(MESSAGE);
        std::process::abort()
    }
}
