//! Memory for large arrays in a file that is mapped into memory, each at an address of its own.

use super::mapping::{CHUNK, Mapping};
use std::alloc::Layout;
use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Arrays begin at multiples of this, a multiple of every system's page.
const STEP: usize = 64 << 10;

/// The file in memory, and what of it is free.
///
/// It asks for little memory itself while it is locked, so that a global allocator may use it for what is large.
#[derive(Debug)]
pub(super) struct Arrays {
    mapping: Mapping,
    free: Mutex<Free>,
}

/// What is not in use: pieces before `end`, and everything behind it.
#[derive(Debug, Default)]
struct Free {
    /// Length of the pieces by where they begin. None touches another one or `end`.
    pieces: BTreeMap<usize, usize>,
    end: usize,
    /// Whether the disk was full.
    is_full: bool,
}

impl Free {
    /// Takes the first piece of `size` bytes.
    fn take(&mut self, size: usize, capacity: usize) -> Option<Range<usize>> {
        if let Some((&start, &length)) = self.pieces.iter().find(|(_, length)| **length >= size) {
            self.take_from(start, length, size);
            return Some(start..start + size);
        }
        let start = self.end;
        self.end = start.checked_add(size).filter(|end| *end <= capacity)?;
        Some(start..self.end)
    }

    /// Takes the `more` bytes that begin at `start`, if they are free.
    fn take_at(&mut self, start: usize, more: usize, capacity: usize) -> bool {
        if start == self.end {
            let end = start.checked_add(more).filter(|end| *end <= capacity);
            self.end = end.unwrap_or(self.end);
            return end.is_some();
        }
        match self.pieces.get(&start) {
            Some(&length) if length >= more => {
                self.take_from(start, length, more);
                true
            }
            _ => false,
        }
    }

    /// Takes the first `size` bytes of a piece.
    fn take_from(&mut self, start: usize, length: usize, size: usize) {
        self.pieces.remove(&start);
        if length > size {
            self.pieces.insert(start + size, length - size);
        }
    }

    fn give(&mut self, mut range: Range<usize>) {
        if let Some((&start, &length)) = self.pieces.range(..range.start).next_back()
            && start + length == range.start
        {
            self.pieces.remove(&start);
            range.start = start;
        }
        if let Some(length) = self.pieces.remove(&range.end) {
            range.end += length;
        }
        if range.end == self.end {
            self.end = range.start;
        } else {
            self.pieces.insert(range.start, range.len());
        }
    }
}

impl Arrays {
    /// Memory over a file in `folder`, at most as large as the disk has room now.
    pub fn new(folder: &Path) -> io::Result<Self> {
        Mapping::new(folder).map(Self::over)
    }

    fn over(mapping: Mapping) -> Self {
        Self { mapping, free: Mutex::default() }
    }

    fn free_pieces(&self) -> MutexGuard<'_, Free> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Memory for `layout`, all of it zero; none if there is no room.
    pub fn allocate(&self, layout: Layout) -> Option<NonNull<u8>> {
        if layout.align() > STEP || layout.size() == 0 || !self.mapping.is_own() {
            return None;
        }
        let size = layout.size().checked_next_multiple_of(STEP)?;
        let range = self.free_pieces().take(size, self.mapping.capacity())?;
        let start = range.start;
        self.has_disk(range).then(|| self.mapping.at(start))
    }

    /// Makes `memory` of `layout` as large as `size` bytes where it is; whether that was possible. What is new is zero.
    ///
    /// `memory` must be from [`allocate`](Self::allocate), for `layout`.
    pub fn resize(&self, memory: NonNull<u8>, layout: Layout, size: usize) -> bool {
        let (Some(start), true) = (self.mapping.offset_of(memory), self.mapping.is_own()) else { return false };
        let (Some(old), Some(new)) = (layout.size().checked_next_multiple_of(STEP), size.checked_next_multiple_of(STEP)) else { return false };
        if new > old {
            let is_free = self.free_pieces().take_at(start + old, new - old, self.mapping.capacity());
            return is_free && self.has_disk(start + old..start + new);
        }
        if new < old {
            self.discard(start + new..start + old);
        }
        true
    }

    /// Takes `memory` back, which was allocated for `layout`. In a process that was forked off nothing happens.
    pub fn free(&self, memory: NonNull<u8>, layout: Layout) {
        if let (Some(start), true) = (self.mapping.offset_of(memory), self.mapping.is_own()) {
            self.discard(start..start + layout.size().next_multiple_of(STEP));
        }
    }

    // The system may take long over a large range, and whoever keeps the budget must not wait for that: nothing is locked meanwhile.

    /// Gets disk for a range that was taken, or gives it back.
    fn has_disk(&self, range: Range<usize>) -> bool {
        let has_disk = !self.is_full() && self.mapping.reserve(range.clone());
        if !has_disk {
            let mut free = self.free_pieces();
            free.is_full = true;
            free.give(range);
        }
        has_disk
    }

    fn discard(&self, range: Range<usize>) {
        // What could not be discarded has old content, and is not given to anybody else.
        if self.mapping.discard(range.clone()) {
            self.free_pieces().give(range);
        }
    }

    /// Whether `memory` is part of this.
    pub fn contains(&self, memory: NonNull<u8>) -> bool {
        self.mapping.offset_of(memory).is_some()
    }

    /// Number of chunks that may have memory.
    pub fn chunks(&self) -> usize {
        self.free_pieces().end.div_ceil(CHUNK)
    }

    /// Whether the disk was full.
    pub fn is_full(&self) -> bool {
        self.free_pieces().is_full
    }

    /// Gives the memory of some chunks back to the system. Their content stays in the file.
    pub fn release(&self, chunks: Range<usize>) {
        self.mapping.release(chunks);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::super::mapping::Piece;
    use super::*;
    use proptest::prelude::*;

    /// What a test does next.
    #[derive(Clone, Debug)]
    enum Step {
        Allocate { size: usize },
        Resize { which: usize, size: usize },
        Free { which: usize },
        Release,
    }

    fn step() -> impl Strategy<Value = Step> {
        let size = || prop_oneof![1usize..300, Just(STEP), Just(3 * STEP), 1usize..3_000_000];
        prop_oneof![
            5 => size().prop_map(|size| Step::Allocate { size }),
            3 => (any::<usize>(), size()).prop_map(|(which, size)| Step::Resize { which, size }),
            3 => any::<usize>().prop_map(|which| Step::Free { which }),
            1 => Just(Step::Release),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn arrays_are_apart_begin_as_zeros_and_keep_what_was_written(steps in prop::collection::vec(step(), 1..120)) {
            let folder = tempfile::tempdir().unwrap();
            let arrays = Arrays::new(folder.path()).unwrap();
            let mut pieces: Vec<Piece> = Vec::new();
            for (i, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Allocate { size } => {
                        let layout = Layout::from_size_align(size, 8).unwrap();
                        let memory = arrays.allocate(layout).unwrap();
                        prop_assert!(arrays.contains(memory));
                        let mut piece = Piece { memory, layout, byte: 0 };
                        prop_assert!(piece.is_whole());
                        piece.fill((i % 250 + 1) as u8);
                        pieces.push(piece);
                    }
                    Step::Resize { which, size } if !pieces.is_empty() => {
                        let which = which % pieces.len();
                        let piece = &mut pieces[which];
                        let before = piece.layout.size();
                        if arrays.resize(piece.memory, piece.layout, size) {
                            piece.layout = Layout::from_size_align(size, 8).unwrap();
                            let byte = piece.byte;
                            prop_assert!(piece.bytes()[..size.min(before)].iter().all(|&b| b == byte));
                            piece.fill(byte);
                        } else {
                            prop_assert!(size > before);
                        }
                    }
                    Step::Free { which } if !pieces.is_empty() => {
                        let piece = pieces.swap_remove(which % pieces.len());
                        arrays.free(piece.memory, piece.layout);
                    }
                    Step::Resize { .. } | Step::Free { .. } => {}
                    Step::Release => arrays.release(0..arrays.chunks()),
                }
            }
            prop_assert!(pieces.iter_mut().all(Piece::is_whole));
            pieces.drain(..).for_each(|piece| arrays.free(piece.memory, piece.layout));
            let free = arrays.free_pieces();
            prop_assert!(free.end == 0 && free.pieces.is_empty(), "{:?}", free);
        }
    }

    #[test]
    fn arrays_without_room_or_disk_are_refused_and_others_kept() {
        let arrays = Arrays::over(Mapping::over(tempfile::tempfile().unwrap(), CHUNK).unwrap());
        let layout = Layout::from_size_align(CHUNK / 2, 64).unwrap();
        let mut pieces: Vec<Piece> = (0..2).map(|_| Piece { memory: arrays.allocate(layout).unwrap(), layout, byte: 0 }).collect();
        pieces.iter_mut().zip(1..).for_each(|(piece, byte)| piece.fill(byte));
        assert!(arrays.allocate(layout).is_none() && !arrays.is_full());
        assert!(!arrays.resize(pieces[0].memory, layout, CHUNK), "another one is there");
        assert!(pieces.iter_mut().all(Piece::is_whole));
        // A file that is open for reading only gets no disk.
        let last = pieces.swap_remove(1);
        arrays.free(last.memory, layout);
        let arrays = Arrays { mapping: arrays.mapping.with_file(std::fs::File::open("/proc/self/exe").unwrap()), ..arrays };
        assert!(arrays.allocate(layout).is_none() && arrays.is_full());
        assert!(pieces.iter_mut().all(Piece::is_whole));
    }
}
