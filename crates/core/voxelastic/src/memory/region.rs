//! Memory for pages of fields in a file that is mapped into memory.

use super::mapping::{CHUNK, Mapping};
use std::alloc::Layout;
use std::collections::HashMap;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Alignment of all memory: that of a cache line.
const ALIGN: usize = 64;

/// The file in memory, which grows by chunks.
#[derive(Debug)]
pub(super) struct Region {
    mapping: Mapping,
    used: Mutex<Used>,
}

/// What is allocated.
#[derive(Debug, Default)]
struct Used {
    /// Bytes from the start that were ever allocated.
    end: usize,
    /// Bytes from the start that have disk.
    on_disk: usize,
    /// Where memory is that was given back, by size.
    free: HashMap<usize, Vec<usize>>,
    /// Whether the disk was full.
    is_full: bool,
}

impl Region {
    /// A region over a file in `folder`, at most as large as the disk has room now.
    pub fn new(folder: &Path) -> io::Result<Self> {
        Mapping::new(folder).map(Self::over)
    }

    fn over(mapping: Mapping) -> Self {
        Self { mapping, used: Mutex::default() }
    }

    fn used(&self) -> MutexGuard<'_, Used> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Memory for `layout`, and whether its bytes are zero; none if there is no room.
    pub fn allocate(&self, layout: Layout) -> Option<(NonNull<[u8]>, bool)> {
        if layout.align() > ALIGN || !self.mapping.is_own() {
            return None;
        }
        let size = layout.size().next_multiple_of(ALIGN);
        let mut used = self.used();
        if let Some(start) = used.free.get_mut(&size).and_then(Vec::pop) {
            return Some((NonNull::slice_from_raw_parts(self.mapping.at(start), layout.size()), false));
        }
        let end = used.end.checked_add(size).filter(|&end| end <= self.mapping.capacity())?;
        if end > used.on_disk {
            let more = (end - used.on_disk).next_multiple_of(CHUNK);
            if used.is_full || !self.mapping.reserve(used.on_disk..used.on_disk + more) {
                used.is_full = true;
                return None;
            }
            used.on_disk += more;
        }
        let memory = self.mapping.at(used.end);
        used.end = end;
        Some((NonNull::slice_from_raw_parts(memory, layout.size()), true))
    }

    /// Takes `memory` back, which was allocated for `layout`. In a process that was forked off nothing happens: another thread may have had the lock.
    pub fn free(&self, memory: NonNull<u8>, layout: Layout) {
        if let (Some(start), true) = (self.mapping.offset_of(memory), self.mapping.is_own()) {
            self.used().free.entry(layout.size().next_multiple_of(ALIGN)).or_default().push(start);
        }
    }

    /// Whether `memory` is part of the region.
    pub fn contains(&self, memory: NonNull<u8>) -> bool {
        self.mapping.offset_of(memory).is_some()
    }

    /// Number of chunks that have been allocated from.
    pub fn chunks(&self) -> usize {
        self.used().end.div_ceil(CHUNK)
    }

    /// Whether the disk was full.
    pub fn is_full(&self) -> bool {
        self.used().is_full
    }

    /// Gives the memory of some chunks back to the system. Their content stays in the file.
    pub fn release(&self, chunks: Range<usize>) {
        self.mapping.release(chunks);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::super::mapping::{Piece, resident_bytes};
    use super::*;
    use proptest::prelude::*;

    /// A new piece of memory.
    fn filled(region: &Region, layout: Layout, byte: u8) -> Piece {
        let mut piece = Piece { memory: region.allocate(layout).unwrap().0.cast(), layout, byte };
        piece.fill(byte);
        piece
    }

    /// What a test does next.
    #[derive(Clone, Debug)]
    enum Step {
        Allocate { size: usize },
        Free { which: usize },
        Release,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            6 => prop_oneof![1usize..300, Just(65536), 1usize..3_000_000].prop_map(|size| Step::Allocate { size }),
            3 => any::<usize>().prop_map(|which| Step::Free { which }),
            1 => Just(Step::Release),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn pieces_are_apart_and_keep_what_was_written(steps in prop::collection::vec(step(), 1..120)) {
            let folder = tempfile::tempdir().unwrap();
            let region = Region::new(folder.path()).unwrap();
            let mut pieces: Vec<Piece> = Vec::new();
            for (i, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Allocate { size } => {
                        let layout = Layout::from_size_align(size, 8).unwrap();
                        let (memory, is_zero) = region.allocate(layout).unwrap();
                        prop_assert_eq!(memory.len(), size);
                        prop_assert!(region.contains(memory.cast()));
                        let mut piece = Piece { memory: memory.cast(), layout, byte: 0 };
                        prop_assert!(!is_zero || piece.is_whole());
                        piece.fill((i % 250 + 1) as u8);
                        pieces.push(piece);
                    }
                    Step::Free { which } if !pieces.is_empty() => {
                        let piece = pieces.swap_remove(which % pieces.len());
                        region.free(piece.memory, piece.layout);
                    }
                    Step::Free { .. } => {}
                    Step::Release => region.release(0..region.chunks()),
                }
            }
            prop_assert!(pieces.iter_mut().all(Piece::is_whole));
            prop_assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "the file has no name");
        }
    }

    #[test]
    fn a_region_without_room_refuses_and_keeps_what_it_has() {
        let region = Region::over(Mapping::over(tempfile::tempfile().unwrap(), 2 * CHUNK).unwrap());
        let layout = Layout::from_size_align(CHUNK / 2, 64).unwrap();
        let new = |byte| filled(&region, layout, byte);
        let mut pieces: Vec<Piece> = (1..=4).map(new).collect();
        assert!(region.allocate(layout).is_none() && !region.is_full());
        region.free(pieces.swap_remove(1).memory, layout);
        assert!(region.allocate(layout).is_some_and(|(_, is_zero)| !is_zero) && region.allocate(layout).is_none());
        assert!(pieces.iter_mut().all(Piece::is_whole));
    }

    #[test]
    fn a_region_whose_file_cannot_grow_is_full() {
        let region = Region::over(Mapping::over(tempfile::tempfile().unwrap(), 4 * CHUNK).unwrap());
        let layout = Layout::from_size_align(CHUNK, 64).unwrap();
        let mut piece = filled(&region, layout, 3);
        // A file that is open for reading only gets no disk either.
        let read_only = std::fs::File::open("/proc/self/exe").unwrap();
        let region = Region { mapping: region.mapping.with_file(read_only), ..region };
        assert!(region.allocate(layout).is_none() && region.is_full());
        assert!(piece.is_whole());
    }

    #[test]
    fn released_chunks_take_no_memory() {
        const SIZE: usize = 256 << 20;
        let folder = tempfile::tempdir().unwrap();
        let region = Region::new(folder.path()).unwrap();
        let layout = Layout::from_size_align(SIZE, 64).unwrap();
        let mut piece = filled(&region, layout, 7);
        // Other tests of this process take memory meanwhile, but not nearly as much.
        let before = resident_bytes().unwrap();
        region.release(0..region.chunks());
        let after = resident_bytes().unwrap();
        assert!(before > after + SIZE as u64 / 2, "{before} to {after} bytes");
        assert!(piece.is_whole());
    }
}
