//! Stands in for the file in memory where there can be none.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::ptr::NonNull;

pub(super) const CHUNK: usize = 8 << 20;

/// Never made.
#[derive(Debug)]
pub(super) enum Mapping {}

impl Mapping {
    pub fn new(_: &Path) -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub fn capacity(&self) -> usize {
        match *self {}
    }

    pub fn is_own(&self) -> bool {
        match *self {}
    }

    pub fn at(&self, _: usize) -> NonNull<u8> {
        match *self {}
    }

    pub fn offset_of(&self, _: NonNull<u8>) -> Option<usize> {
        match *self {}
    }

    pub fn reserve(&self, _: Range<usize>) -> bool {
        match *self {}
    }

    pub fn discard(&self, _: Range<usize>) -> bool {
        match *self {}
    }

    pub fn release(&self, _: Range<usize>) {
        match *self {}
    }
}

/// Not asked: there is no mapping.
pub(super) fn is_in_memory(_: &Path) -> bool {
    false
}

/// Not known.
pub(super) fn resident_bytes() -> Option<u64> {
    None
}
