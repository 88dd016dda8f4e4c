//! Mutable access to different items of a [`Pool`] from several threads: the one place where blocks are written in parallel.
#![allow(unsafe_code)]

use super::Pool;
use std::marker::PhantomData;
use std::sync::OnceLock;

/// Pages that come while others are written to, each when it is first needed.
pub(super) type Coming<T> = [OnceLock<Vec<T>>];

/// A pool opened for writing to disjoint items; the pool itself can neither grow nor be read meanwhile.
pub struct Cells<'a, T> {
    pages: *mut Vec<T>,
    page_count: usize,
    /// The pages behind those.
    coming: &'a Coming<T>,
    pool: PhantomData<&'a mut Pool<T>>,
}

// SAFETY: a `Cells` hands out `&mut T` from `&self`; sharing it between threads is sound exactly when `T` may be sent
// to them, because callers of `get` promise that no two threads use the same index. Of pages that come, too, only the headers are shared.
unsafe impl<T: Send> Sync for Cells<'_, T> {}
// SAFETY: as above; it stands for a `&mut Pool<T>`.
unsafe impl<T: Send> Send for Cells<'_, T> {}

impl<'a, T> Cells<'a, T> {
    /// Opens `pool`.
    pub fn new(pool: &'a mut Pool<T>) -> Self {
        Self::over(pool.pages_mut(), &mut [])
    }

    /// Opens pages that are laid out as a pool's, and those that may follow them.
    pub(super) fn over(pages: &'a mut [Vec<T>], coming: &'a mut Coming<T>) -> Self {
        Self { pages: pages.as_mut_ptr(), page_count: pages.len(), coming, pool: PhantomData }
    }

    /// The page numbered `page`, if it is there.
    #[inline(always)]
    fn page(&self, page: usize) -> Option<&Vec<T>> {
        if page >= self.page_count {
            return self.come(page);
        }
        // SAFETY: `page` is in bounds, pages are never reallocated while `self` borrows the pool, and only shared
        // references to the page headers are formed here.
        Some(unsafe { &*self.pages.add(page) })
    }

    #[cold]
    #[inline(never)]
    fn come(&self, page: usize) -> Option<&Vec<T>> {
        self.coming.get(page - self.page_count)?.get()
    }

    /// Sees to it that the page of item `index` is there.
    pub(super) fn bring(&self, index: u32, make: impl Fn() -> Vec<T>) {
        let (page, _) = Pool::<T>::place(index);
        if let Some(coming) = page.checked_sub(self.page_count) {
            self.coming[coming].get_or_init(make);
        }
    }

    /// The item at `index`.
    ///
    /// # Safety
    /// While the returned reference lives, no other reference to the same index may be obtained from this `Cells`.
    ///
    /// # Panics
    /// When `index` was never handed out by the pool.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn get(&self, index: u32) -> &mut T {
        let (page, place) = Pool::<T>::place(index);
        let Some(page) = self.page(page) else { panic!("item {index} was never handed out") };
        assert!(place < page.len());
        // SAFETY: `place` is initialised (below `len`), and `Vec::as_ptr` makes no reference to the items; the caller promises that this one is
        // not aliased.
        unsafe { &mut *page.as_ptr().cast_mut().add(place) }
    }
}

impl<T> Cells<'_, T> {
    /// Where the item at `index` lies; nowhere for an index never handed out.
    #[inline(always)]
    pub fn place(&self, index: u32) -> Place<T> {
        Place(self.address(index).cast_mut())
    }

    /// Where the item at `index` lies, for [`prefetch`]; null for an index never handed out.
    #[inline(always)]
    pub fn address(&self, index: u32) -> *const T {
        let (page, place) = Pool::<T>::place(index);
        self.page(page).map_or(std::ptr::null(), |page| page.as_ptr().wrapping_add(place))
    }
}

/// Where an item of a pool lies: it can be had again and again, for writes that no loop over the pool would make.
#[derive(Debug)]
pub struct Place<T>(*mut T);

impl<T> Clone for Place<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Place<T> {}

impl<T> PartialEq for Place<T> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl<T> Place<T> {
    /// No item.
    pub const NOWHERE: Self = Self(std::ptr::null_mut());
    /// No item either, for who has to tell one that does not exist from one that is elsewhere.
    pub const MISSING: Self = Self(std::ptr::dangling_mut());

    /// Whether it is that of an item: neither [nowhere](Self::NOWHERE) nor [missing](Self::MISSING).
    #[inline(always)]
    pub fn is_somewhere(self) -> bool {
        self.0.addr() > Self::MISSING.0.addr()
    }

    /// The item's address, for [`prefetch`].
    #[inline(always)]
    pub fn address(self) -> *const T {
        self.0
    }

    /// Where the part of it lies that begins `offset` bytes on; for [`get`](Place::get), a `U` has to be there.
    #[inline(always)]
    pub fn part<U>(self, offset: usize) -> Place<U> {
        debug_assert!(offset + size_of::<U>() <= size_of::<T>());
        Place(self.0.cast::<u8>().wrapping_add(offset).cast())
    }

    /// The item.
    ///
    /// # Safety
    /// The place is that of an item, the [`Cells`] that it is from still lives, and no other reference to the item does.
    #[inline(always)]
    pub unsafe fn get<'a>(self) -> &'a mut T {
        // SAFETY: the caller's promise; pointers to the items of a pool may be written through, see `Cells::get`.
        unsafe { &mut *self.0 }
    }
}

impl<T, const N: usize> Place<[T; N]> {
    /// Where item `i` of the array lies.
    #[inline(always)]
    pub fn item(self, i: usize) -> Place<T> {
        assert!(i < N);
        self.part(i * size_of::<T>())
    }
}

/// Asks for the cache line at `address` to be brought near, for use soon. Any address will do: it is never read.
#[inline(always)]
pub fn prefetch<T>(address: *const T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch never faults, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast::<i8>()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}

/// Bytes of a cache line.
const LINE: usize = 64;

/// Asks for all cache lines of the item at `item`, as [`prefetch`] does for one.
#[inline(always)]
pub fn ask_for_all<T>(item: *const T) {
    for line in (0..size_of::<T>()).step_by(LINE) {
        prefetch(item.cast::<u8>().wrapping_add(line));
    }
    prefetch(item.cast::<u8>().wrapping_add(size_of::<T>() - 1));
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
        let cells = Cells::new(&mut fast);
        (0..5000u32).into_par_iter().filter(|i| i % 3 != 1).for_each(|i| {
            // SAFETY: every index occurs once.
            let item = unsafe { cells.get(i) };
            item[(i % 64) as usize] = i * 7;
        });
        for i in (0..5000u32).filter(|i| i % 3 != 1) {
            slow[i][(i % 64) as usize] = i * 7;
        }
        assert!((0..5000).all(|i| fast[i] == slow[i]));
    }
}
