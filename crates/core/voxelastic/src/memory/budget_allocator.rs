//! A global allocator for programs whose large arrays are part of the budget.
#![allow(unsafe_code)]

use super::budget;
use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr::NonNull;

/// Arrays of this size and larger, bytes, may come from a file. Smaller ones never do.
const LARGE: usize = 256 << 10;

/// The system's allocator, but for large arrays while they are to be [kept in a file](super::keep_arrays_in_file).
#[derive(Clone, Copy, Debug, Default)]
pub struct BudgetAllocator;

impl BudgetAllocator {
    /// Memory from the file, all of it zero; none if the array is small, or is not to come from there.
    #[inline]
    fn from_file(layout: Layout) -> Option<NonNull<u8>> {
        if layout.size() < LARGE { None } else { budget::arrays()?.allocate(layout) }
    }

    /// Makes an array as large as `size` bytes at another place, which may be in the file or not.
    ///
    /// # Safety
    /// As for [`GlobalAlloc::realloc`].
    #[cold]
    unsafe fn move_to(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let Ok(new_layout) = Layout::from_size_align(size, layout.align()) else { return std::ptr::null_mut() };
        // SAFETY: the size is not zero, as the caller promises.
        let new = unsafe { self.alloc(new_layout) };
        if !new.is_null() {
            // SAFETY: both are at least as long, and the new one was just made.
            unsafe { std::ptr::copy_nonoverlapping(memory, new, layout.size().min(size)) };
            // SAFETY: the caller's promise about the old one is passed on.
            unsafe { self.dealloc(memory, layout) };
        }
        new
    }
}

// SAFETY: both parts hand out memory that is valid, and of the caller alone, until it is given back; which of the two gave it is told from its address.
unsafe impl GlobalAlloc for BudgetAllocator {
    #[inline]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        match Self::from_file(layout) {
            Some(memory) => memory.as_ptr(),
            // SAFETY: the caller's promise about the layout is passed on.
            None => unsafe { System.alloc(layout) },
        }
    }

    #[inline]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        match Self::from_file(layout) {
            Some(memory) => memory.as_ptr(),
            // SAFETY: as above.
            None => unsafe { System.alloc_zeroed(layout) },
        }
    }

    #[inline]
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if layout.size() < LARGE && size < LARGE {
            // SAFETY: the caller's promises are passed on; small arrays are the system's.
            return unsafe { System.realloc(memory, layout, size) };
        }
        let here = NonNull::new(memory).and_then(|here| Some((budget::any_arrays().filter(|arrays| arrays.contains(here))?, here)));
        match here {
            Some((arrays, here)) if size >= LARGE && arrays.resize(here, layout, size) => memory,
            // SAFETY: as above, and the memory is the system's.
            None if size < LARGE || budget::arrays().is_none() => unsafe { System.realloc(memory, layout, size) },
            // SAFETY: the caller's promises are passed on.
            _ => unsafe { self.move_to(memory, layout, size) },
        }
    }

    #[inline]
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        if layout.size() >= LARGE
            && let Some(here) = NonNull::new(memory)
            && let Some(arrays) = budget::any_arrays().filter(|arrays| arrays.contains(here))
        {
            return arrays.free(here, layout);
        }
        // SAFETY: what is not from the file is from the system, and the caller passes the layout with which it was allocated.
        unsafe { System.dealloc(memory, layout) }
    }
}
