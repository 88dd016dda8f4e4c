//! Where pages of fields come from: the system, or the file of the memory budget.
#![allow(unsafe_code)]

use super::budget;
use allocator_api2::alloc::{AllocError, Allocator, Global};
use bytemuck::Zeroable;
use std::alloc::Layout;
use std::ptr::NonNull;

/// A vector in the memory of fields.
pub(crate) type PageVec<T> = allocator_api2::vec::Vec<T, FieldMemory>;

/// A slice in the memory of fields.
pub(crate) type PageBox<T> = allocator_api2::boxed::Box<[T], FieldMemory>;

/// The memory of fields: under a [budget](super::limit), from its file while there is room in it; otherwise from the system.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FieldMemory;

// SAFETY: both parts hand out memory that is valid, and of the caller alone, until it is given back; which of the two gave it is told from
// its address. All values of the type are alike, so that clones may give back what another one gave.
unsafe impl Allocator for FieldMemory {
    fn allocate(&self, layout: Layout) -> Result<NonNull<[u8]>, AllocError> {
        match budget::region().and_then(|region| region.allocate(layout)) {
            Some((memory, _)) => Ok(memory),
            None => Global.allocate(layout),
        }
    }

    fn allocate_zeroed(&self, layout: Layout) -> Result<NonNull<[u8]>, AllocError> {
        match budget::region().and_then(|region| region.allocate(layout)) {
            Some((memory, is_fresh)) => {
                if !is_fresh {
                    // SAFETY: the memory is the caller's.
                    unsafe { memory.cast::<u8>().write_bytes(0, memory.len()) };
                }
                Ok(memory)
            }
            None => Global.allocate_zeroed(layout),
        }
    }

    unsafe fn deallocate(&self, memory: NonNull<u8>, layout: Layout) {
        match budget::any_region().filter(|region| region.contains(memory)) {
            Some(region) => region.free(memory, layout),
            // SAFETY: what is not from the file is from the system, and the caller passes the layout with which it was allocated.
            None => unsafe { Global.deallocate(memory, layout) },
        }
    }
}

/// A page of `len` items whose bytes are zero.
pub(crate) fn zeroed_page<T: Zeroable>(len: usize) -> PageVec<T> {
    zeroed(len, FieldMemory)
}

/// As [`zeroed_page`], always from the system: for what every scan uses, and whose memory would come back as soon as it is given back.
pub(crate) fn zeroed_working_page<T: Zeroable>(len: usize) -> PageVec<T> {
    zeroed(len, Global)
}

fn zeroed<T: Zeroable>(len: usize, source: impl Allocator) -> PageVec<T> {
    let Ok(layout) = Layout::array::<T>(len) else { panic!("a page of {len} items is larger than memory can be") };
    if layout.size() == 0 {
        return PageVec::new_in(FieldMemory);
    }
    let Ok(memory) = source.allocate_zeroed(layout) else { std::alloc::handle_alloc_error(layout) };
    // SAFETY: the memory was just allocated for `len` items, which may have zero bytes; `FieldMemory` takes back what is from either source.
    unsafe { PageVec::from_raw_parts_in(memory.cast::<T>().as_ptr(), len, len, FieldMemory) }
}
