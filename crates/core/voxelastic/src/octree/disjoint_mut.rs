//! Mutable access to different items of a [`Pool`] from several threads.
#![allow(unsafe_code)]

use super::Pool;
use crate::memory::PageVec;
use std::marker::PhantomData;
use std::sync::OnceLock;

/// Pages that are allocated while others are written to, each when it is first needed.
pub(crate) type PendingPages<T> = [OnceLock<PageVec<T>>];

/// A pool borrowed for writing to disjoint items; the pool itself can neither grow nor be read meanwhile.
pub(crate) struct DisjointMut<'a, T> {
    pages: *mut PageVec<T>,
    page_count: usize,
    /// The pages that follow those.
    pending: &'a PendingPages<T>,
    pool: PhantomData<&'a mut Pool<T>>,
}

// SAFETY: a `DisjointMut` hands out `&mut T` from `&self`; sharing it between threads is sound exactly when `T` may be sent
// to them, because callers of `get` promise that no two threads use the same index. Of pending pages, too, only the headers are shared.
unsafe impl<T: Send> Sync for DisjointMut<'_, T> {}
// SAFETY: as above; it stands for a `&mut Pool<T>`.
unsafe impl<T: Send> Send for DisjointMut<'_, T> {}

impl<'a, T> DisjointMut<'a, T> {
    /// Borrows all items of `pool`.
    pub fn new(pool: &'a mut Pool<T>) -> Self {
        Self::over(pool.pages_mut(), &mut [])
    }

    /// Borrows pages that are laid out as a pool's, and those that may follow them.
    pub fn over(pages: &'a mut [PageVec<T>], pending: &'a mut PendingPages<T>) -> Self {
        Self { pages: pages.as_mut_ptr(), page_count: pages.len(), pending, pool: PhantomData }
    }

    /// Page number `page`, if it is allocated.
    #[inline(always)]
    fn page(&self, page: usize) -> Option<&PageVec<T>> {
        if page >= self.page_count {
            return self.pending_page(page);
        }
        // SAFETY: `page` is in bounds, pages are never reallocated while `self` borrows the pool, and only shared
        // references to the page headers are formed here.
        Some(unsafe { &*self.pages.add(page) })
    }

    #[cold]
    #[inline(never)]
    fn pending_page(&self, page: usize) -> Option<&PageVec<T>> {
        self.pending.get(page - self.page_count)?.get()
    }

    /// Allocates the page of item `index` with `make` unless it exists.
    pub fn ensure_page(&self, index: u32, make: impl Fn() -> PageVec<T>) {
        let (page, _) = Pool::<T>::page_and_offset(index);
        if let Some(pending) = page.checked_sub(self.page_count) {
            self.pending[pending].get_or_init(make);
        }
    }

    /// The item at `index`.
    ///
    /// # Safety
    /// While the returned reference lives, no other reference to the same index may be obtained from this `DisjointMut`.
    ///
    /// # Panics
    /// If `index` was never allocated.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn get(&self, index: u32) -> &mut T {
        // SAFETY: the item is initialised; the caller promises that this reference is not aliased.
        unsafe { &mut *self.item(index) }
    }

    /// Pointer to the item at `index`, which is initialised; dereferencing it is sound if no reference to the item lives.
    ///
    /// # Panics
    /// If `index` was never allocated.
    #[inline(always)]
    pub fn item(&self, index: u32) -> *mut T {
        let (page, offset) = Pool::<T>::page_and_offset(index);
        let Some(page) = self.page(page) else { panic!("item {index} was never allocated") };
        assert!(offset < page.len(), "item {index} was never allocated");
        // `Vec::as_ptr` makes no reference to the items.
        page.as_ptr().cast_mut().wrapping_add(offset)
    }

    /// Pointer to the item at `index`; [`SlotPtr::NOT_RESIDENT`] if it was never allocated.
    #[inline(always)]
    pub fn slot_ptr(&self, index: u32) -> SlotPtr<T> {
        SlotPtr(self.address(index).cast_mut())
    }

    /// Address of the item at `index`, for [`prefetch`](super::prefetch); null if it was never allocated.
    #[inline(always)]
    pub fn address(&self, index: u32) -> *const T {
        let (page, offset) = Pool::<T>::page_and_offset(index);
        self.page(page).map_or(std::ptr::null(), |page| page.as_ptr().wrapping_add(offset))
    }
}

/// Fails unless all `ids`, of blocks that tasks are about to write to, are below `count` and different.
pub(crate) fn assert_distinct(ids: &[u32], count: u32) {
    let mut found = vec![0u64; count.div_ceil(64) as usize];
    for &id in ids {
        assert!(id < count, "block {id} does not exist");
        let (word, bit) = (&mut found[id as usize / 64], 1 << (id % 64));
        assert!(*word & bit == 0, "block {id} is written to twice");
        *word |= bit;
    }
}

/// Pointer to an item of a pool, for loops that access the same items repeatedly.
#[derive(Debug)]
pub(crate) struct SlotPtr<T>(*mut T);

impl<T> Clone for SlotPtr<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for SlotPtr<T> {}

impl<T> PartialEq for SlotPtr<T> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl<T> SlotPtr<T> {
    /// Sentinel: the item exists, but not in this pool.
    pub const NOT_RESIDENT: Self = Self(std::ptr::null_mut());
    /// Sentinel: the item does not exist; [`NOT_RESIDENT`](Self::NOT_RESIDENT) means it is stored elsewhere.
    pub const MISSING: Self = Self(std::ptr::dangling_mut());

    /// Whether it points to an item and is neither of the sentinels.
    #[inline(always)]
    pub fn is_item(self) -> bool {
        self.0.addr() > Self::MISSING.0.addr()
    }

    /// The item's address, for [`prefetch`](super::prefetch).
    #[inline(always)]
    pub fn address(self) -> *const T {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn parallel_writes_equal_sequential_ones() {
        let mut fast = Pool::<[u32; 64]>::default();
        let mut slow = Pool::<[u32; 64]>::default();
        for i in 0..5000 {
            fast.insert([i; 64]);
            slow.insert([i; 64]);
        }
        let items = DisjointMut::new(&mut fast);
        (0..5000u32).into_par_iter().filter(|i| i % 3 != 1).for_each(|i| {
            // SAFETY: every index occurs once.
            let item = unsafe { items.get(i) };
            item[(i % 64) as usize] = i * 7;
        });
        for i in (0..5000u32).filter(|i| i % 3 != 1) {
            slow[i][(i % 64) as usize] = i * 7;
        }
        assert!((0..5000).all(|i| fast[i] == slow[i]));
    }
}
