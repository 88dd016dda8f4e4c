//! Files of messages of every format, as one sequence of messages.

pub(super) mod chunk;
pub(super) mod chunk_reader;
pub(super) mod container;
pub(super) mod files;
pub(super) mod format;
pub(super) mod mcap;
pub(super) mod open;
pub(super) mod prefetch;
pub(super) mod records;
pub(super) mod ros1;
pub(super) mod sqlite;
