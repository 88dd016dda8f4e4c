//! Chunks that are unpacked before their turn, each on a thread of its own: bzip2 takes longer to unpack a scan than it takes to map it.
//!
//! A scout goes through the file ahead of the reader and only finds chunks. What it found is a cache by place in the file: whether a chunk
//! is in it changes nothing but time.

use super::feed::{Feed, Packing, is_plausible, unpack};
use std::collections::VecDeque;
use std::io;
use std::thread::{self, JoinHandle};

/// Larger chunks are left to the reader.
const LARGEST: u64 = 1 << 26;
/// So many chunks are unpacked at a time at most, and no more than the machine has cores.
const MOST: usize = 8;

/// A chunk whose packed bytes come next.
pub(super) struct ChunkHead {
    pub(super) packing: Packing,
    pub(super) packed: u64,
    pub(super) unpacked: u64,
}

/// Finds the next chunk of the file that is worth unpacking ahead.
pub(super) type FindChunk = fn(&mut Feed) -> Option<ChunkHead>;

/// Bytes, and what went wrong, if something did.
type Unpacked = (Vec<u8>, Option<io::Error>);

/// Unpacks chunks ahead.
#[derive(Debug)]
pub(super) struct Ahead {
    scout: Feed,
    find: FindChunk,
    /// Places of the packed bytes, in the order of the file.
    waiting: VecDeque<(u64, JoinHandle<Unpacked>)>,
    most: usize,
}

impl Ahead {
    /// `scout` reads the same file.
    pub(super) fn new(scout: Feed, find: FindChunk) -> Self {
        let most = thread::available_parallelism().map_or(1, usize::from).min(MOST);
        Self { scout, find, waiting: VecDeque::new(), most }
    }

    /// The chunk whose `packed` bytes are at a place of the file, if it was unpacked ahead. Goes on with those that follow.
    pub(super) fn take(&mut self, at: u64, packed: u64) -> Option<Unpacked> {
        while self.waiting.pop_front_if(|(place, _)| *place < at).is_some() {}
        let found = self.waiting.pop_front_if(|(place, _)| *place == at);
        if self.waiting.is_empty() && self.scout.position() < at + packed {
            self.scout.seek(at + packed).ok()?;
        }
        self.go_on();
        found.and_then(|(_, thread)| thread.join().ok())
    }

    fn go_on(&mut self) {
        while self.waiting.len() < self.most {
            let Some(ChunkHead { packing, packed, unpacked }) = (self.find)(&mut self.scout) else { return };
            let at = self.scout.position();
            if unpacked > LARGEST || !is_plausible(packed, unpacked) {
                if self.scout.skip(packed).is_err() {
                    return;
                }
                continue;
            }
            // What is cut is left to the reader, who says so.
            let Ok(bytes) = self.scout.take(packed) else { return };
            let thread = thread::Builder::new().name("voxelastic-unpack".into());
            let Ok(thread) = thread.spawn(move || unpack(packing, &bytes, unpacked)) else { return };
            self.waiting.push_back((at, thread));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::container::Container;
    use super::super::records::Records;
    use super::super::ros1::Ros1;
    use std::path::Path;

    /// Everything that comes out of a bag.
    fn play(path: &Path, ahead: bool) -> Vec<String> {
        let Ok(mut bag) = Ros1::open(path) else { return Vec::new() };
        if !ahead {
            bag.feed().ahead = None;
        }
        let next = |_| Some(format!("{:?}", bag.next(&|_| true)?));
        (0..10_000).map_while(next).collect()
    }

    #[test]
    fn what_was_unpacked_ahead_is_what_is_unpacked_in_turn() {
        let whole = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/bags/fixtures/ouster_bz2.bag")).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bag");
        for k in 0..60 {
            // The first is whole; others are cut, or have bytes set to something else.
            let mut bytes = whole.clone();
            match k % 3 {
                _ if k == 0 => {}
                0 => bytes.truncate(whole.len() * k / 60),
                1 => bytes[whole.len() * k / 60..][..40].fill(k as u8),
                _ => bytes[whole.len() * k / 60] ^= 0x10,
            }
            std::fs::write(&path, &bytes).unwrap();
            let ahead = play(&path, true);
            assert_eq!(ahead, play(&path, false), "{k}");
            assert!(k > 0 || ahead.len() == 25, "{} messages of a whole bag", ahead.len());
        }
    }
}
