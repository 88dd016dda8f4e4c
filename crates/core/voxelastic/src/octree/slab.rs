//! An arena in which several threads allocate at once, and whose pages can be passed on to another slab.
//!
//! The first use of fresh memory costs page faults, which is much when a scan needs tens of megabytes. So a slab whose items are being
//! compressed is emptied from its end and [releases](Slab::release_pages) the pages behind its last item, and a slab that grows
//! [adopts](Slab::adopt_pages) them.

use super::{DisjointMut, NONE, Pool, prefetch_item};
use crate::memory::{PageVec, zeroed_working_page};
use bytemuck::Zeroable;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

/// Items of one type in pages, addressed by slot; each has an owner, a number whose meaning is up to the user.
#[derive(Debug)]
pub(crate) struct Slab<T> {
    /// Each of [`Slab::PAGE`] items.
    pages: Vec<PageVec<T>>,
    /// The pages that an allocator may need. They are allocated on first use: it seldom needs them all, and zeroing memory that the system
    /// allocator recycles has a cost even if it stays unused.
    pending: Vec<OnceLock<PageVec<T>>>,
    /// Free slots below `len`.
    free: Vec<u32>,
    /// By slot; [`NONE`] for free slots.
    owners: Vec<AtomicU32>,
    len: u32,
}

impl<T> Default for Slab<T> {
    fn default() -> Self {
        Self { pages: Vec::new(), pending: Vec::new(), free: Vec::new(), owners: Vec::new(), len: 0 }
    }
}

impl<T: Clone> Clone for Slab<T> {
    fn clone(&self) -> Self {
        let owners = self.owners.iter().map(|owner| AtomicU32::new(owner.load(Ordering::Relaxed))).collect();
        Self { pages: self.pages.clone(), pending: Vec::new(), free: self.free.clone(), owners, len: self.len }
    }
}

impl<T: Zeroable> Slab<T> {
    const PAGE: usize = Pool::<T>::PAGE;

    /// A slab of copies of some items with their owners, in the slots from 0 on.
    pub fn of<'a>(items: impl Iterator<Item = (u32, &'a T)>) -> Self
    where
        T: Copy + 'a,
    {
        let mut slab = Self::default();
        for (owner, item) in items {
            let (page, offset) = Pool::<T>::page_and_offset(slab.len);
            if page == slab.pages.len() {
                slab.pages.push(zeroed_working_page(Self::PAGE));
            }
            slab.pages[page][offset] = *item;
            slab.owners.push(AtomicU32::new(owner));
            slab.len += 1;
        }
        slab
    }

    /// Makes room for `more` items.
    fn reserve(&mut self, more: usize) {
        let slots = self.len as usize + more.saturating_sub(self.free.len());
        assert!(slots < NONE as usize, "slab is full");
        self.pending.resize_with(slots.div_ceil(Self::PAGE).saturating_sub(self.pages.len()), OnceLock::new);
        if self.owners.len() < slots {
            self.owners.resize_with(slots, || AtomicU32::new(NONE));
        }
    }

    /// Lets threads write to items and allocate at most `more`, using at most `batches` batches. Afterwards call [`finish`](Self::finish).
    pub fn allocator(&mut self, more: usize, batches: usize) -> SlabAllocator<'_, T> {
        self.reserve(more + batches * BATCH as usize);
        let items = DisjointMut::over(&mut self.pages, &mut self.pending);
        SlabAllocator { items, free: &self.free, owners: &self.owners, fresh: self.len, allocated: AtomicU32::new(0) }
    }

    /// Ends an allocation pass in which `allocated` items were [allocated](SlabAllocator::allocated). Unused slots of `batches` become free.
    pub fn finish(&mut self, allocated: usize, batches: impl IntoIterator<Item = SlotBatch>) {
        let unused: Vec<u32> = batches.into_iter().flat_map(|batch| batch.numbers).map(|number| slot(&self.free, self.len, number)).collect();
        let reused = allocated.min(self.free.len());
        self.free.truncate(self.free.len() - reused);
        self.len += (allocated - reused) as u32;
        self.free.extend(unused);
        self.pages.extend(self.pending.drain(..).map_while(OnceLock::into_inner));
    }

    /// Frees `slot` for reuse.
    pub fn remove(&mut self, slot: u32) {
        *self.owners[slot as usize].get_mut() = NONE;
        self.free.push(slot);
    }

    /// Upper bound of the slots in use.
    pub fn capacity_used(&self) -> u32 {
        self.len
    }

    /// Number of items in use.
    pub fn live(&self) -> usize {
        self.len as usize - self.free.len()
    }

    /// Owner of the item in `slot`; none if the slot is free.
    pub fn owner(&self, slot: u32) -> Option<u32> {
        let owner = self.owners[slot as usize].load(Ordering::Relaxed);
        (owner != NONE).then_some(owner)
    }

    /// Moves the pages behind the last item in use to the end of `pages`.
    pub fn release_pages(&mut self, pages: &mut Vec<PageVec<T>>) {
        let free = |owner: &mut AtomicU32| *owner.get_mut() == NONE;
        while self.len > 0 && free(&mut self.owners[self.len as usize - 1]) {
            self.len -= 1;
        }
        let len = self.len;
        self.free.retain(|&slot| slot < len);
        self.owners.truncate(len as usize);
        if len == 0 {
            (self.free, self.owners) = (Vec::new(), Vec::new());
        }
        let kept = (len as usize).div_ceil(Self::PAGE);
        pages.extend(self.pages.drain(kept..));
    }

    /// Takes over [released](Self::release_pages) pages until there is room for `spare` further items; drops the others.
    pub fn adopt_pages(&mut self, pages: Vec<PageVec<T>>, spare: usize) {
        let limit = (self.len as usize + spare).div_ceil(Self::PAGE);
        let wanted = limit.saturating_sub(self.pages.len());
        self.pages.extend(pages.into_iter().take(wanted));
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.pages.len() * Self::PAGE * size_of::<T>() + 4 * (self.free.capacity() + self.owners.capacity())
    }
}

impl<T> std::ops::Index<u32> for Slab<T> {
    type Output = T;
    #[inline(always)]
    fn index(&self, slot: u32) -> &T {
        let (page, offset) = Pool::<T>::page_and_offset(slot);
        &self.pages[page][offset]
    }
}

/// Slots that a thread reserves at a time, because a counter shared by threads is slow.
const BATCH: u32 = 16;

/// How many allocations ahead a slot is prefetched.
const AHEAD: u32 = 8;

/// Slots that a thread has reserved and not yet used.
#[derive(Clone, Debug, Default)]
pub(crate) struct SlotBatch {
    numbers: Range<u32>,
}

/// Slot of the allocation with number `number`: free slots first, in reverse order of being freed, then fresh ones.
#[inline(always)]
fn slot(free: &[u32], fresh: u32, number: u32) -> u32 {
    let reused = free.len() as u32;
    if number < reused { free[(reused - 1 - number) as usize] } else { fresh + (number - reused) }
}

/// Allocates items of a [`Slab`] from several threads.
pub(crate) struct SlabAllocator<'a, T> {
    items: DisjointMut<'a, T>,
    free: &'a [u32],
    owners: &'a [AtomicU32],
    fresh: u32,
    /// Slots reserved so far.
    allocated: AtomicU32,
}

impl<'a, T: Zeroable> SlabAllocator<'a, T> {
    /// Allocates an item for `owner` and returns its slot. The item's value is arbitrary, and the slot depends on the order in which
    /// threads reserve batches.
    ///
    /// # Panics
    /// If more items are allocated than were reserved by [`Slab::allocator`].
    #[inline]
    pub fn allocate(&self, owner: u32, batch: &mut SlotBatch) -> u32 {
        let number = batch.numbers.next().unwrap_or_else(|| {
            let first = self.allocated.fetch_add(BATCH, Ordering::Relaxed);
            batch.numbers = first + 1..first + BATCH;
            self.ensure_pages(first);
            first
        });
        // A slot is written to soon and hardly ever cached.
        prefetch_item(self.items.address(slot(self.free, self.fresh, number + AHEAD)));
        let slot = slot(self.free, self.fresh, number);
        self.owners[slot as usize].store(owner, Ordering::Relaxed);
        slot
    }

    /// Allocates the pages of the batch that begins with number `first`.
    fn ensure_pages(&self, first: u32) {
        let last = slot(self.free, self.fresh, first + BATCH - 1);
        if last >= self.fresh {
            let make = || zeroed_working_page(Slab::<T>::PAGE);
            let first = slot(self.free, self.fresh, first).clamp(self.fresh, last);
            (first..last).step_by(Slab::<T>::PAGE).chain([last]).for_each(|slot| self.items.ensure_page(slot, make));
        }
    }

    /// Slots reserved so far, including unused ones of batches.
    pub fn allocated(&self) -> usize {
        self.allocated.load(Ordering::Relaxed) as usize
    }

    /// The slab's items.
    #[inline(always)]
    pub fn items(&self) -> &DisjointMut<'a, T> {
        &self.items
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::collections::BTreeMap;

    type Item = [u32; 1024];

    /// Fails unless exactly the items of `slow` are in use, each with its owner and the value written to it.
    fn assert_holds(slab: &Slab<Item>, slow: &BTreeMap<u32, u32>) {
        assert_eq!(slab.live(), slow.len());
        for slot in 0..slab.capacity_used() {
            assert_eq!(slab.owner(slot), slow.get(&slot).copied());
            assert!(slow.get(&slot).is_none_or(|owner| slab[slot] == [owner + 7; 1024]));
        }
    }

    /// Allocates 150 items in five tasks, for owners from `first` on, and writes to them.
    #[allow(unsafe_code)]
    fn fill(slab: &mut Slab<Item>, slow: &mut BTreeMap<u32, u32>, first: u32) {
        let allocator = slab.allocator(150, 5);
        let share = |share: u32| {
            let mut batch = SlotBatch::default();
            let allocate = |i| {
                let owner = first + 30 * share + i;
                let slot = allocator.allocate(owner, &mut batch);
                // SAFETY: the slot was just allocated, and only here.
                unsafe { *allocator.items().get(slot) = [owner + 7; 1024] };
                (slot, owner)
            };
            ((0..30).map(allocate).collect(), batch)
        };
        let (slots, batches): (Vec<Vec<(u32, u32)>>, Vec<SlotBatch>) = (0..5).into_par_iter().map(share).unzip();
        let count = allocator.allocated();
        slab.finish(count, batches);
        assert!(slots.into_iter().flatten().all(|(slot, owner)| slow.insert(slot, owner).is_none()), "a slot was allocated twice");
    }

    #[test]
    fn threads_allocate_distinct_slots_and_pages_are_passed_on() {
        let (mut slab, mut slow) = (Slab::<Item>::default(), BTreeMap::new());
        for round in 0..6u32 {
            fill(&mut slab, &mut slow, 1000 * round);
            for slot in (0..slab.capacity_used()).filter(|slot| slot % 3 == round % 3) {
                if slow.remove(&slot).is_some() {
                    slab.remove(slot);
                }
            }
            assert_holds(&slab, &slow);
        }
        let before = slab.pages.len();
        for slot in slab.capacity_used() / 3..slab.capacity_used() {
            if slow.remove(&slot).is_some() {
                slab.remove(slot);
            }
        }
        let mut pages = Vec::new();
        slab.release_pages(&mut pages);
        assert_holds(&slab, &slow);
        assert!(pages.len() > before / 2 && slab.pages.len() + pages.len() == before, "{} of {before} pages", pages.len());
        let (mut other, spare) = (slab.clone(), Slab::<Item>::PAGE);
        other.adopt_pages(pages.clone(), spare);
        let room = other.pages.len() * Slab::<Item>::PAGE - other.capacity_used() as usize;
        assert!((spare..2 * spare).contains(&room), "room for {room} more");
        slab.adopt_pages(pages, usize::MAX / 2);
        assert!(slab.bytes() >= before * Slab::<Item>::PAGE * size_of::<Item>());
        (0..2).for_each(|round| fill(&mut slab, &mut slow, 150 * round));
        assert_holds(&slab, &slow);
        assert_eq!(slab.pages.len(), before, "adopted pages are used");
        assert_holds(&slab.clone(), &slow);
    }
}
