//! Compressed chunks of recordings.

use std::fmt;
use std::io::{self, Read};

/// Compression of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compression {
    Bzip2,
    Lz4,
    Zstd,
}

/// Decompressed bytes, and the error that ended decompression early, if there was one.
pub(crate) type Decompressed = (Vec<u8>, Option<io::Error>);

/// Chunks that are decompressed before the reader gets to them.
pub(crate) trait ChunkCache: fmt::Debug + Send {
    /// The chunk whose `compressed_size` bytes are at offset `at` of the file, if it has been decompressed ahead.
    fn take(&mut self, at: u64, compressed_size: u64) -> Option<Decompressed>;
}

/// Decompresses up to `size` bytes.
pub(crate) fn decompress(compression: Compression, bytes: &[u8], size: u64) -> Decompressed {
    let mut out = Vec::new();
    let read = match compression {
        Compression::Bzip2 => bzip2::read::BzDecoder::new(bytes).take(size).read_to_end(&mut out),
        Compression::Lz4 => lz4_flex::frame::FrameDecoder::new(bytes).take(size).read_to_end(&mut out),
        Compression::Zstd => zstd::stream::read::Decoder::with_buffer(bytes).and_then(|d| d.take(size).read_to_end(&mut out)),
    };
    (out, read.err())
}
