//! A paged arena with `u32` handles: growing never moves items, and memory grows by a page, not by doubling.

use super::NONE;
use crate::memory::{FieldMemory, PageVec};

/// Target size of a page, bytes.
const PAGE_BYTES: usize = 1 << 16;

/// Items of one type in pages, addressed by index; freed slots are reused, the last freed first.
#[derive(Clone, Debug)]
pub(crate) struct Pool<T> {
    pages: Vec<PageVec<T>>,
    free: Vec<u32>,
    len: u32,
}

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self { pages: Vec::new(), free: Vec::new(), len: 0 }
    }
}

impl<T> Pool<T> {
    const SHIFT: u32 = {
        let size = if size_of::<T>() == 0 { 1 } else { size_of::<T>() };
        let items = PAGE_BYTES / size;
        if items <= 1 { 0 } else { items.ilog2() }
    };
    pub(super) const PAGE: usize = 1 << Self::SHIFT;

    /// Number of the page that holds item `index`, and the item's offset in it.
    #[inline(always)]
    pub(super) const fn page_and_offset(index: u32) -> (usize, usize) {
        ((index >> Self::SHIFT) as usize, index as usize & (Self::PAGE - 1))
    }

    /// Stores `item` and returns its index.
    ///
    /// # Panics
    /// If 2^32 - 1 items are stored.
    pub fn insert(&mut self, item: T) -> u32 {
        if let Some(index) = self.free.pop() {
            self[index] = item;
            return index;
        }
        let index = self.len;
        assert!(index < NONE, "pool is full");
        let (page, _) = Self::page_and_offset(index);
        if page == self.pages.len() {
            self.pages.push(PageVec::with_capacity_in(Self::PAGE, FieldMemory));
        }
        self.pages[page].push(item);
        self.len += 1;
        index
    }

    /// Frees the slot of item `index` for reuse. The item itself is kept until it is overwritten.
    pub fn remove(&mut self, index: u32) {
        debug_assert!(index < self.len);
        self.free.push(index);
    }

    /// Upper bound of all valid indices.
    pub fn capacity_used(&self) -> u32 {
        self.len
    }

    /// Number of items in use.
    pub fn live(&self) -> usize {
        self.len as usize - self.free.len()
    }

    /// Memory held, bytes: pages and free list.
    pub fn bytes(&self) -> usize {
        self.pages.len() * Self::PAGE * size_of::<T>() + self.pages.capacity() * size_of::<PageVec<T>>() + self.free.capacity() * 4
    }

    pub(super) fn pages_mut(&mut self) -> &mut [PageVec<T>] {
        &mut self.pages
    }
}

impl<T> std::ops::Index<u32> for Pool<T> {
    type Output = T;
    #[inline(always)]
    fn index(&self, index: u32) -> &T {
        let (page, offset) = Self::page_and_offset(index);
        &self.pages[page][offset]
    }
}

impl<T> std::ops::IndexMut<u32> for Pool<T> {
    #[inline(always)]
    fn index_mut(&mut self, index: u32) -> &mut T {
        let (page, offset) = Self::page_and_offset(index);
        &mut self.pages[page][offset]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn freed_slots_are_reused_and_other_items_are_kept() {
        let mut pool = Pool::<[u8; 4096]>::default();
        let ids: Vec<u32> = (0..100u8).map(|i| pool.insert([i; 4096])).collect();
        pool.remove(ids[7]);
        assert_eq!(pool.live(), 99);
        assert_eq!(pool.insert([200; 4096]), ids[7]);
        for (i, &id) in ids.iter().enumerate() {
            assert_eq!(pool[id][0], if i == 7 { 200 } else { i as u8 });
        }
        assert!(pool.bytes() >= 100 * 4096 && pool.bytes() < 120 * 4096);
    }
}
