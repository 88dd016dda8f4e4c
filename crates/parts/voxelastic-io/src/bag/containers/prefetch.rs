//! Decompressing chunks ahead of the reader, on threads of their own: bzip2 takes longer to decompress a scan than mapping it takes.
//!
//! A second reader runs ahead in the file and only looks for chunks. The results are a cache by offset in the file: whether a chunk is in it
//! affects time only.

use super::chunk::{ChunkCache, Compression, Decompressed, decompress};
use super::chunk_reader::ChunkReader;
use crate::unpacking;
use std::collections::VecDeque;
use std::path::Path;
use std::thread::{self, JoinHandle};

/// Larger chunks are not prefetched, bytes.
const LARGEST: u64 = 1 << 26;
/// Most chunks that are decompressed at a time; also limited by the number of cores.
const MOST: usize = 8;

/// A chunk whose compressed bytes come next.
pub(crate) struct ChunkHeader {
    pub(crate) compression: Compression,
    pub(crate) compressed: u64,
    pub(crate) size: u64,
}

/// Finds the next chunk of the file that is worth prefetching.
pub(crate) type FindChunk = fn(&mut ChunkReader) -> Option<ChunkHeader>;

/// Decompresses chunks ahead.
#[derive(Debug)]
pub(crate) struct ChunkPrefetcher {
    /// Reads the same file, ahead.
    lookahead: ChunkReader,
    find: FindChunk,
    /// Offsets of the compressed bytes, in the order of the file, and the threads at work.
    pending: VecDeque<(u64, JoinHandle<Decompressed>)>,
    most: usize,
}

impl ChunkPrefetcher {
    /// Prefetches chunks of a file; `None` if it cannot be opened a second time.
    pub(crate) fn open(path: &Path, find: FindChunk) -> Option<Box<dyn ChunkCache>> {
        let lookahead = ChunkReader::open(path).ok()?;
        let most = thread::available_parallelism().map_or(1, usize::from).min(MOST);
        Some(Box::new(Self { lookahead, find, pending: VecDeque::new(), most }))
    }

    /// Starts threads for the next chunks.
    fn start_next(&mut self) {
        while self.pending.len() < self.most {
            let Some(ChunkHeader { compression, compressed, size }) = (self.find)(&mut self.lookahead) else { return };
            let at = self.lookahead.position();
            if size > LARGEST.min(unpacking::limit(compressed)) {
                if self.lookahead.skip(compressed).is_err() {
                    return;
                }
                continue;
            }
            // A truncated chunk is left to the reader, which reports it.
            let Ok(bytes) = self.lookahead.take(compressed) else { return };
            let thread = thread::Builder::new().name("voxelastic-unpack".into());
            let Ok(thread) = thread.spawn(move || decompress(compression, &bytes, size)) else { return };
            self.pending.push_back((at, thread));
        }
    }
}

impl ChunkCache for ChunkPrefetcher {
    fn take(&mut self, at: u64, compressed_size: u64) -> Option<Decompressed> {
        while self.pending.pop_front_if(|(offset, _)| *offset < at).is_some() {}
        let found = self.pending.pop_front_if(|(offset, _)| *offset == at);
        if self.pending.is_empty() && self.lookahead.position() < at + compressed_size {
            self.lookahead.seek(at + compressed_size).ok()?;
        }
        self.start_next();
        found.and_then(|(_, thread)| thread.join().ok())
    }
}

#[cfg(test)]
mod tests {
    use super::super::container::Container;
    use super::super::records::RecordFile;
    use super::super::ros1::Ros1;
    use std::path::Path;

    /// All messages of a bag.
    fn messages(path: &Path, prefetch: bool) -> Vec<String> {
        let Ok(mut bag) = Ros1::open(path) else { return Vec::new() };
        if !prefetch {
            bag.reader().cache = None;
        }
        let next = |_| Some(format!("{:?}", bag.next(&|_| true)?));
        (0..10_000).map_while(next).collect()
    }

    #[test]
    fn prefetching_changes_no_message() {
        let whole = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/bags/fixtures/ouster_bz2.bag")).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bag");
        for k in 0..60 {
            // The first is intact; the others are truncated or have overwritten bytes.
            let mut bytes = whole.clone();
            match k % 3 {
                _ if k == 0 => {}
                0 => bytes.truncate(whole.len() * k / 60),
                1 => bytes[whole.len() * k / 60..][..40].fill(k as u8),
                _ => bytes[whole.len() * k / 60] ^= 0x10,
            }
            std::fs::write(&path, &bytes).unwrap();
            let prefetched = messages(&path, true);
            assert_eq!(prefetched, messages(&path, false), "{k}");
            assert!(k > 0 || prefetched.len() == 25, "{} messages of a whole bag", prefetched.len());
        }
    }
}
