//! The memory of the process: that of the memory budget or the system's, and what is said when there is no more.
//!
//! Rust ends a program that gets no memory with a line of its own and SIGABRT, and lets nobody add to that on stable versions but the allocator.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout};
use voxelastic::memory::BudgetAllocator;

/// A larger request may be refused although there is memory, and some of those who make one have an answer to that: for a length in a damaged file,
/// for one.
const LARGE: usize = 256 << 20;
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
    if memory.is_null() && size < LARGE {
        end();
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
