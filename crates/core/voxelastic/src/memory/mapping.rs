//! A file without a name, mapped into memory: its content may leave memory and comes back when it is used.
#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::ptr::NonNull;

/// Disk that is left to others, bytes.
const LEFT_FREE: u64 = 64 << 20;
/// Largest size of a mapping, bytes: a small part of the addresses that a process has.
const MOST: usize = 1 << 42;
/// Sizes of mappings are multiples of this, which is one of every system's page.
pub(super) const CHUNK: usize = 8 << 20;
/// Signals that may interrupt a request for disk before the file counts as full.
const MOST_INTERRUPTIONS: usize = 10;

/// The file in memory.
#[derive(Debug)]
pub(super) struct Mapping {
    start: NonNull<u8>,
    capacity: usize,
    file: File,
    /// The process that made it. One that was forked off shares the file, and must not take memory that its parent takes, too.
    process: u32,
}

// SAFETY: the pointer is to memory that lives as long as the process, and that its users give to one owner at a time.
unsafe impl Send for Mapping {}
// SAFETY: as above; nothing of it changes.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// A mapping of a file in `folder`, at most as large as the disk has room now.
    pub fn new(folder: &Path) -> io::Result<Self> {
        let file = tempfile::tempfile_in(folder)?;
        let disk = rustix::fs::fstatvfs(&file)?;
        let room = (disk.f_bavail * disk.f_frsize).saturating_sub(LEFT_FREE);
        Self::over(file, usize::try_from(room).unwrap_or(usize::MAX).min(MOST) / CHUNK * CHUNK)
    }

    /// A mapping of an empty file that may grow to `capacity` bytes, whole chunks.
    pub fn over(file: File, capacity: usize) -> io::Result<Self> {
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
        Ok(Self { start, capacity, file, process: std::process::id() })
    }

    /// The same memory with another file, for tests of requests for disk.
    #[cfg(test)]
    pub fn with_file(self, file: File) -> Self {
        Self { file, ..self }
    }

    /// Bytes of the mapping.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Whether this process made it.
    pub fn is_own(&self) -> bool {
        self.process == std::process::id()
    }

    /// The memory at `offset`, which must be less than the capacity.
    pub fn at(&self, offset: usize) -> NonNull<u8> {
        assert!(offset < self.capacity);
        // SAFETY: within the mapping.
        unsafe { self.start.add(offset) }
    }

    /// Where `memory` is in the mapping; none if it is elsewhere.
    pub fn offset_of(&self, memory: NonNull<u8>) -> Option<usize> {
        let offset = memory.addr().get().wrapping_sub(self.start.addr().get());
        (offset < self.capacity).then_some(offset)
    }

    /// Gets disk for a range of bytes; whether there is as much. Without disk behind it, a write to memory would end the process.
    pub fn reserve(&self, range: Range<usize>) -> bool {
        for _ in 0..MOST_INTERRUPTIONS {
            match rustix::fs::fallocate(&self.file, rustix::fs::FallocateFlags::KEEP_SIZE, range.start as u64, range.len() as u64) {
                Err(rustix::io::Errno::INTR) => {}
                grown => return grown.is_ok(),
            }
        }
        false
    }

    /// Gives memory and disk of a range of bytes, whole pages, back to the system: they are zero when they are used again. Whether it could be done.
    pub fn discard(&self, range: Range<usize>) -> bool {
        use rustix::fs::FallocateFlags;
        let how = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        rustix::fs::fallocate(&self.file, how, range.start as u64, range.len() as u64).is_ok()
    }

    /// Gives the memory of some chunks back to the system. Their content stays in the file.
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

/// Memory that a test has in use, filled with bytes of its own.
#[cfg(test)]
pub(super) struct Piece {
    pub memory: NonNull<u8>,
    pub layout: std::alloc::Layout,
    pub byte: u8,
}

#[cfg(test)]
impl Piece {
    pub fn bytes(&mut self) -> &mut [u8] {
        // SAFETY: the piece was allocated and not freed, and only its test has it.
        unsafe { std::slice::from_raw_parts_mut(self.memory.as_ptr(), self.layout.size()) }
    }

    pub fn fill(&mut self, byte: u8) {
        self.byte = byte;
        self.bytes().fill(byte);
    }

    pub fn is_whole(&mut self) -> bool {
        let byte = self.byte;
        self.bytes().iter().all(|&b| b == byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_in_memory_is_told_from_one_on_a_disk() {
        assert!(!is_in_memory(Path::new("/")));
        let shared = Path::new("/dev/shm");
        if shared.is_dir() {
            assert!(is_in_memory(shared));
        }
    }
}
