//! An arena whose items several threads take at once, and whose memory can be handed on to another one.
//!
//! Memory that was never used costs page faults, which is much when a scan needs tens of megabytes at once. So a slab that is being
//! emptied is emptied from its end, and [gives away](Slab::give_away) the pages behind the last item to one that fills.

use super::{Cells, NONE, Pool, ask_for_all};
use bytemuck::Zeroable;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

/// Items of one size in pages, addressed by slot; each has an owner, a number that means something to the user.
#[derive(Debug)]
pub struct Slab<T> {
    /// Each of full length.
    pages: Vec<Vec<T>>,
    /// Places for the pages that an opened slab may need. They are made when first needed: it seldom needs them all, and a page whose memory the
    /// allocator had before costs its zeros even if nobody uses it.
    coming: Vec<OnceLock<Vec<T>>>,
    /// Free slots below `len`.
    free: Vec<u32>,
    /// By slot; [`NONE`] for the free ones.
    owners: Vec<AtomicU32>,
    len: u32,
}

impl<T> Default for Slab<T> {
    fn default() -> Self {
        Self { pages: Vec::new(), coming: Vec::new(), free: Vec::new(), owners: Vec::new(), len: 0 }
    }
}

impl<T: Clone> Clone for Slab<T> {
    fn clone(&self) -> Self {
        let owners = self.owners.iter().map(|owner| AtomicU32::new(owner.load(Ordering::Relaxed))).collect();
        Self { pages: self.pages.clone(), coming: Vec::new(), free: self.free.clone(), owners, len: self.len }
    }
}

impl<T: Zeroable> Slab<T> {
    const PAGE: usize = Pool::<T>::PAGE;

    /// Makes sure that `more` items can be taken.
    fn reserve(&mut self, more: usize) {
        let slots = self.len as usize + more.saturating_sub(self.free.len());
        assert!(slots < NONE as usize, "slab is full");
        self.coming.resize_with(slots.div_ceil(Self::PAGE).saturating_sub(self.pages.len()), OnceLock::new);
        if self.owners.len() < slots {
            self.owners.resize_with(slots, || AtomicU32::new(NONE));
        }
    }

    /// Opens the slab to threads that write to items and take `more` at most, with at most so many batches. To be [closed](Self::close).
    pub fn open(&mut self, more: usize, batches: usize) -> Taking<'_, T> {
        self.reserve(more + batches * BATCH as usize);
        let cells = Cells::over(&mut self.pages, &mut self.coming);
        Taking { cells, free: &self.free, owners: &self.owners, fresh: self.len, taken: AtomicU32::new(0) }
    }

    /// Closes the slab after so many items were [taken](Taking::taken); what batches have left is free again.
    pub fn close(&mut self, taken: usize, batches: impl IntoIterator<Item = Batch>) {
        let left: Vec<u32> = batches.into_iter().flat_map(|batch| batch.numbers).map(|number| slot(&self.free, self.len, number)).collect();
        let reused = taken.min(self.free.len());
        self.free.truncate(self.free.len() - reused);
        self.len += (taken - reused) as u32;
        self.free.extend(left);
        self.pages.extend(self.coming.drain(..).map_while(OnceLock::into_inner));
    }

    /// Gives an item back for reuse.
    pub fn remove(&mut self, slot: u32) {
        *self.owners[slot as usize].get_mut() = NONE;
        self.free.push(slot);
    }

    /// Slots ever handed out: those in use are below this.
    pub fn capacity_used(&self) -> u32 {
        self.len
    }

    /// Items in use.
    pub fn live(&self) -> usize {
        self.len as usize - self.free.len()
    }

    /// Whose the item in `slot` is; none if it is free.
    pub fn owner(&self, slot: u32) -> Option<u32> {
        let owner = self.owners[slot as usize].load(Ordering::Relaxed);
        (owner != NONE).then_some(owner)
    }

    /// Moves the pages behind the last item in use to the end of `pages`.
    pub fn give_away(&mut self, pages: &mut Vec<Vec<T>>) {
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

    /// Takes over pages that were given away, as far as room for no more than `spare` items is free then.
    pub fn adopt(&mut self, pages: Vec<Vec<T>>, spare: usize) {
        let most = (self.len as usize + spare).div_ceil(Self::PAGE);
        let wanted = most.saturating_sub(self.pages.len());
        self.pages.extend(pages.into_iter().take(wanted));
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.pages.len() * Self::PAGE * size_of::<T>() + 4 * (self.free.capacity() + self.owners.capacity())
    }
}

impl<T> std::ops::Index<u32> for Slab<T> {
    type Output = T;
    #[inline(always)]
    fn index(&self, slot: u32) -> &T {
        let (page, place) = Pool::<T>::place(slot);
        &self.pages[page][place]
    }
}

/// Items that a thread takes at a time: a counter that threads share is slow to count.
const BATCH: u32 = 16;

/// How many items ahead one is asked for.
const AHEAD: u32 = 8;

/// What a thread has taken and not yet used.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    numbers: Range<u32>,
}

/// The slot of the item that is taken as number `number`: the free ones first, the last freed of them first.
#[inline(always)]
fn slot(free: &[u32], fresh: u32, number: u32) -> u32 {
    let reused = free.len() as u32;
    if number < reused { free[(reused - 1 - number) as usize] } else { fresh + (number - reused) }
}

/// A [`Slab`] opened to several threads.
pub struct Taking<'a, T> {
    cells: Cells<'a, T>,
    free: &'a [u32],
    owners: &'a [AtomicU32],
    fresh: u32,
    taken: AtomicU32,
}

impl<'a, T: Zeroable> Taking<'a, T> {
    /// Takes an item for `owner`; it holds anything. Which slot it is depends on who comes first.
    ///
    /// # Panics
    /// When more are taken than the slab was opened for.
    #[inline]
    pub fn take(&self, owner: u32, batch: &mut Batch) -> u32 {
        let number = batch.numbers.next().unwrap_or_else(|| {
            let first = self.taken.fetch_add(BATCH, Ordering::Relaxed);
            batch.numbers = first + 1..first + BATCH;
            self.bring(first);
            first
        });
        // What comes will be written to, and is as good as never near.
        ask_for_all(self.cells.address(slot(self.free, self.fresh, number + AHEAD)));
        let slot = slot(self.free, self.fresh, number);
        self.owners[slot as usize].store(owner, Ordering::Relaxed);
        slot
    }

    /// Sees to it that the pages of a batch are there.
    fn bring(&self, first: u32) {
        let last = slot(self.free, self.fresh, first + BATCH - 1);
        if last >= self.fresh {
            let make = || bytemuck::zeroed_vec(Slab::<T>::PAGE);
            let first = slot(self.free, self.fresh, first).clamp(self.fresh, last);
            (first..last).step_by(Slab::<T>::PAGE).chain([last]).for_each(|slot| self.cells.bring(slot, make));
        }
    }

    /// Items taken so far, also those that batches have left.
    pub fn taken(&self) -> usize {
        self.taken.load(Ordering::Relaxed) as usize
    }

    /// The items.
    #[inline(always)]
    pub fn cells(&self) -> &Cells<'a, T> {
        &self.cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::collections::BTreeMap;

    type Item = [u32; 1024];

    /// Fails unless exactly the items of `slow` are in use, each with its owner and what was written to it.
    fn assert_holds(slab: &Slab<Item>, slow: &BTreeMap<u32, u32>) {
        assert_eq!(slab.live(), slow.len());
        for slot in 0..slab.capacity_used() {
            assert_eq!(slab.owner(slot), slow.get(&slot).copied());
            assert!(slow.get(&slot).is_none_or(|owner| slab[slot] == [owner + 7; 1024]));
        }
    }

    /// Takes 150 items in five threads, for owners from `first` on, and writes to them.
    #[allow(unsafe_code)]
    fn fill(slab: &mut Slab<Item>, slow: &mut BTreeMap<u32, u32>, first: u32) {
        let taking = slab.open(150, 5);
        let share = |share: u32| {
            let mut batch = Batch::default();
            let take = |i| {
                let owner = first + 30 * share + i;
                let slot = taking.take(owner, &mut batch);
                // SAFETY: the slot was just taken, by nobody else.
                unsafe { *taking.cells().get(slot) = [owner + 7; 1024] };
                (slot, owner)
            };
            ((0..30).map(take).collect(), batch)
        };
        let (taken, batches): (Vec<Vec<(u32, u32)>>, Vec<Batch>) = (0..5).into_par_iter().map(share).unzip();
        let count = taking.taken();
        slab.close(count, batches);
        assert!(taken.into_iter().flatten().all(|(slot, owner)| slow.insert(slot, owner).is_none()), "a slot twice");
    }

    #[test]
    fn threads_take_items_and_pages_are_handed_on() {
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
        slab.give_away(&mut pages);
        assert_holds(&slab, &slow);
        assert!(pages.len() > before / 2 && slab.pages.len() + pages.len() == before, "{} of {before} pages", pages.len());
        let (mut modest, spare) = (slab.clone(), Slab::<Item>::PAGE);
        modest.adopt(pages.clone(), spare);
        let room = modest.pages.len() * Slab::<Item>::PAGE - modest.capacity_used() as usize;
        assert!((spare..2 * spare).contains(&room), "room for {room} more");
        slab.adopt(pages, usize::MAX / 2);
        assert!(slab.bytes() >= before * Slab::<Item>::PAGE * size_of::<Item>());
        (0..2).for_each(|round| fill(&mut slab, &mut slow, 150 * round));
        assert_holds(&slab, &slow);
        assert_eq!(slab.pages.len(), before, "what was given is used again");
        assert_holds(&slab.clone(), &slow);
    }
}
