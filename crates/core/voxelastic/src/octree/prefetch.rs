//! Cache prefetching.
#![allow(unsafe_code)]

/// Bytes of a cache line.
const LINE: usize = 64;

/// Prefetches the cache line at `address`. Any address is allowed: it is never read.
#[inline(always)]
pub(crate) fn prefetch<T>(address: *const T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch never faults, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast::<i8>()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}

/// Prefetches all cache lines of the item at `item`. Any address is allowed.
#[inline(always)]
pub(crate) fn prefetch_item<T>(item: *const T) {
    for line in (0..size_of::<T>()).step_by(LINE) {
        prefetch(item.cast::<u8>().wrapping_add(line));
    }
    prefetch(item.cast::<u8>().wrapping_add(size_of::<T>() - 1));
}
