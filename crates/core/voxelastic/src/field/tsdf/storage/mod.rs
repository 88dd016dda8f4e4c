//! How bricks are stored: decoded while recent scans change them, compressed otherwise.

mod bitstream;
pub(crate) mod brick_codec;
pub(crate) mod change_log;
pub(crate) mod compaction;
pub(crate) mod compressed_store;
pub(crate) mod decompress;
