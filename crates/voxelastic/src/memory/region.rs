//! A file without a name, mapped into memory, from which pages of fields are allocated.
#![allow(unsafe_code)]

use std::alloc::Layout;
use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The file grows by this many bytes, and as many are given back to the system at a time: a multiple of every system's page.
const CHUNK: usize = 8 << 20;
/// Alignment of all memory: that of a cache line.
const ALIGN: usize = 64;
/// Disk that is left to others, bytes.
const LEFT_FREE: u64 = 64 << 20;
/// Largest size of a region, bytes: a small part of the addresses that a process has.
const MOST: usize = 1 << 42;
/// Signals that may interrupt the growth of the file before it counts as full.
const MOST_INTERRUPTIONS: usize = 10;

/// The file in memory.
#[derive(Debug)]
pub(super) struct Region {
    start: NonNull<u8>,
    capacity: usize,
    file: File,
    /// The process that made it. One that was forked shares the file, and must not take memory that its parent takes, too.
    process: u32,
    used: Mutex<Used>,
}

/// What is allocated.
#[derive(Debug, Default)]
struct Used {
    /// Bytes from the start that were ever allocated.
    end: usize,
    /// Bytes from the start that have disk.
    on_disk: usize,
    /// Memory that was given back, by size.
    free: HashMap<usize, Vec<NonNull<u8>>>,
    /// Whether the disk was full.
    is_full: bool,
}

// SAFETY: the pointers are to memory that lives as long as the process, and that the allocator gives to one owner at a time.
unsafe impl Send for Region {}
// SAFETY: as above; what is allocated is behind a lock.
unsafe impl Sync for Region {}

impl Region {
    /// A region over a file in `folder`, at most as large as the disk has room now.
    pub fn new(folder: &Path) -> io::Result<Self> {
        let file = tempfile::tempfile_in(folder)?;
        let disk = rustix::fs::fstatvfs(&file)?;
        let room = (disk.f_bavail * disk.f_frsize).saturating_sub(LEFT_FREE);
        Self::over(file, usize::try_from(room).unwrap_or(usize::MAX).min(MOST) / CHUNK * CHUNK)
    }

    /// A region over an empty file that may grow to `capacity` bytes, whole chunks.
    fn over(file: File, capacity: usize) -> io::Result<Self> {
        if capacity == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        file.set_len(capacity as u64)?;
        let (read_and_write, shared) = (rustix::mm::ProtFlags::READ | rustix::mm::ProtFlags::WRITE, rustix::mm::MapFlags::SHARED);
        // SAFETY: the system chooses an address where nothing is; nobody else has the file.
        let start = unsafe { rustix::mm::mmap(std::ptr::null_mut(), capacity, read_and_write, shared, &file, 0) }?;
        // Otherwise the system reads ahead, keeps the file in pieces of two megabytes, and each comes back whole when one byte of it is used.
        // SAFETY: the mapping that was just made.
        unsafe { rustix::mm::madvise(start, capacity, rustix::mm::Advice::Random) }?;
        let Some(start) = NonNull::new(start.cast::<u8>()) else { return Err(io::ErrorKind::OutOfMemory.into()) };
        Ok(Self { start, capacity, file, process: std::process::id(), used: Mutex::default() })
    }

    fn used(&self) -> MutexGuard<'_, Used> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Memory for `layout`, and whether its bytes are zero; none if there is no room.
    pub fn allocate(&self, layout: Layout) -> Option<(NonNull<[u8]>, bool)> {
        if layout.align() > ALIGN || self.process != std::process::id() {
            return None;
        }
        let size = layout.size().next_multiple_of(ALIGN);
        let mut used = self.used();
        if let Some(memory) = used.free.get_mut(&size).and_then(Vec::pop) {
            return Some((NonNull::slice_from_raw_parts(memory, layout.size()), false));
        }
        let end = used.end.checked_add(size).filter(|&end| end <= self.capacity)?;
        if end > used.on_disk {
            let more = (end - used.on_disk).next_multiple_of(CHUNK);
            // Without disk behind it, a write to memory would end the process.
            if used.is_full || !self.grow(used.on_disk, more) {
                used.is_full = true;
                return None;
            }
            used.on_disk += more;
        }
        // SAFETY: within the mapping.
        let memory = unsafe { self.start.add(used.end) };
        used.end = end;
        Some((NonNull::slice_from_raw_parts(memory, layout.size()), true))
    }

    /// Gets disk for `bytes` more bytes behind the first `on_disk` ones; whether there is as much.
    fn grow(&self, on_disk: usize, bytes: usize) -> bool {
        for _ in 0..MOST_INTERRUPTIONS {
            match rustix::fs::fallocate(&self.file, rustix::fs::FallocateFlags::KEEP_SIZE, on_disk as u64, bytes as u64) {
                Err(rustix::io::Errno::INTR) => {}
                grown => return grown.is_ok(),
            }
        }
        false
    }

    /// Takes `memory` back, which was allocated for `layout`. In a process that was forked off nothing happens: another thread may have had the lock.
    pub fn free(&self, memory: NonNull<u8>, layout: Layout) {
        if self.process != std::process::id() {
            return;
        }
        self.used().free.entry(layout.size().next_multiple_of(ALIGN)).or_default().push(memory);
    }

    /// Whether `memory` is part of the region.
    pub fn contains(&self, memory: NonNull<u8>) -> bool {
        memory.addr().get().wrapping_sub(self.start.addr().get()) < self.capacity
    }

    /// Number of chunks that have been allocated from.
    pub fn chunks(&self) -> usize {
        self.used().end.div_ceil(CHUNK)
    }

    /// Whether the disk was full.
    pub fn is_full(&self) -> bool {
        self.used().is_full
    }

    /// Gives the memory of `chunks` back to the system. Their content stays in the file, and comes back when it is used.
    pub fn release(&self, chunks: Range<usize>) {
        let (first, count) = (chunks.start, chunks.len());
        if count > 0 && chunks.end <= self.capacity / CHUNK {
            // SAFETY: within the mapping, which is shared: nothing is lost.
            let released =
                unsafe { rustix::mm::madvise(self.start.add(first * CHUNK).as_ptr().cast(), count * CHUNK, rustix::mm::Advice::LinuxDontNeed) };
            debug_assert!(released.is_ok(), "{released:?}");
        }
    }
}

/// Whether `folder` is on a file system without a disk.
pub(super) fn is_in_memory(folder: &Path) -> bool {
    const TMPFS: i64 = 0x0102_1994;
    const RAMFS: i64 = 0x8584_58f6;
    rustix::fs::statfs(folder).is_ok_and(|system| [TMPFS, RAMFS].contains(&system.f_type))
}

/// Resident memory of the process, bytes; none where the system does not say.
pub(super) fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pieces of memory that are in use, each filled with bytes of its own.
    struct Piece {
        memory: NonNull<[u8]>,
        layout: Layout,
        byte: u8,
    }

    impl Piece {
        fn bytes(&mut self) -> &mut [u8] {
            // SAFETY: the piece was allocated and not freed, and only this test has it.
            unsafe { self.memory.as_mut() }
        }
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
                        let mut piece = Piece { memory, layout, byte: (i % 250 + 1) as u8 };
                        prop_assert!(!is_zero || piece.bytes().iter().all(|&byte| byte == 0));
                        let byte = piece.byte;
                        piece.bytes().fill(byte);
                        pieces.push(piece);
                    }
                    Step::Free { which } if !pieces.is_empty() => {
                        let piece = pieces.swap_remove(which % pieces.len());
                        region.free(piece.memory.cast(), piece.layout);
                    }
                    Step::Free { .. } => {}
                    Step::Release => region.release(0..region.chunks()),
                }
            }
            for piece in &mut pieces {
                let byte = piece.byte;
                prop_assert!(piece.bytes().iter().all(|&b| b == byte));
            }
            prop_assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "the file has no name");
        }
    }

    #[test]
    fn a_region_without_room_refuses_and_keeps_what_it_has() {
        let region = Region::over(tempfile::tempfile().unwrap(), 2 * CHUNK).unwrap();
        let layout = Layout::from_size_align(CHUNK / 2, 64).unwrap();
        let mut pieces: Vec<Piece> = (1..=4).map(|byte| Piece { memory: region.allocate(layout).unwrap().0, layout, byte }).collect();
        for piece in &mut pieces {
            let byte = piece.byte;
            piece.bytes().fill(byte);
        }
        assert!(region.allocate(layout).is_none() && !region.is_full());
        region.free(pieces.swap_remove(1).memory.cast(), layout);
        assert!(region.allocate(layout).is_some_and(|(_, is_zero)| !is_zero) && region.allocate(layout).is_none());
        for piece in &mut pieces {
            let byte = piece.byte;
            assert!(piece.bytes().iter().all(|&b| b == byte));
        }
    }

    #[test]
    fn a_region_whose_file_cannot_grow_is_full() {
        let region = Region::over(tempfile::tempfile().unwrap(), 4 * CHUNK).unwrap();
        let layout = Layout::from_size_align(CHUNK, 64).unwrap();
        let mut piece = Piece { memory: region.allocate(layout).unwrap().0, layout, byte: 3 };
        piece.bytes().fill(3);
        // A file that is open for reading only gets no disk either.
        let read_only = File::open("/proc/self/exe").unwrap();
        let region = Region { file: read_only, ..region };
        assert!(region.allocate(layout).is_none() && region.is_full());
        assert!(piece.bytes().iter().all(|&b| b == 3));
    }

    #[test]
    fn released_chunks_take_no_memory() {
        const SIZE: usize = 256 << 20;
        let folder = tempfile::tempdir().unwrap();
        let region = Region::new(folder.path()).unwrap();
        let layout = Layout::from_size_align(SIZE, 64).unwrap();
        let mut piece = Piece { memory: region.allocate(layout).unwrap().0, layout, byte: 7 };
        piece.bytes().fill(7);
        // Other tests of this process take memory meanwhile, but not nearly as much.
        let before = resident_bytes().unwrap();
        region.release(0..region.chunks());
        let after = resident_bytes().unwrap();
        assert!(before > after + SIZE as u64 / 2, "{before} to {after} bytes");
        assert!(piece.bytes().iter().all(|&byte| byte == 7));
    }

    #[test]
    fn a_folder_in_memory_is_told_from_one_on_a_disk() {
        assert!(!is_in_memory(Path::new("/")));
        let shared = Path::new("/dev/shm");
        if shared.is_dir() {
            assert!(is_in_memory(shared));
        }
    }
}
