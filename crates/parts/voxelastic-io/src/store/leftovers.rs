//! What an editor that died may have left.

use super::files::{self, BASE, EDITS, EDITS_HEADER};
use super::reader::MapStore;
use std::fs;

/// Removes what an editor that died has left in the directory of a map without edits. What cannot be removed only takes space.
pub(super) fn remove_leftovers(store: &MapStore) {
    let dir = store.dir();
    if store.manifest().edits.is_some() {
        return;
    }
    if dir.join(BASE).is_file() && MapStore::open_base(dir).is_ok() {
        let _ = fs::remove_file(dir.join(BASE));
    }
    let list = dir.join(EDITS);
    if list.is_file() && files::read(&list, None).is_ok_and(|text| text.starts_with(EDITS_HEADER.as_bytes())) {
        let _ = fs::remove_file(list);
    }
}
