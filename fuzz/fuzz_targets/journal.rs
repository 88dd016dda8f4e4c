#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;
use voxelastic_fuzz::{check_memory, folder, maps};
use voxelastic_io::store::{Checkpoints, MapWriter};

/// A map whose run did not end, without submaps.
static MAP: LazyLock<PathBuf> = LazyLock::new(|| {
    let map = folder().join("run.vox");
    std::fs::create_dir_all(map.join("unfinished")).expect("a folder to write to");
    std::fs::write(map.join("unfinished/manifest.json"), maps::empty_manifest()).expect("space to write to");
    map
});

/// Even first byte: a journal, of which the checkpoint says that it is whole; records that begin with `!` have their checksum made right. Odd: what the state is.
fn read(data: &[u8]) {
    let Some((kind, data)) = data.split_first() else { return };
    let unfinished = MAP.join("unfinished");
    let (state, journal) = if kind % 2 == 0 {
        let journal = maps::journal(data);
        let table = format!("{{\"submaps\":[],\"journal\":[\"journal-00000001.vxj\",{}]}}", journal.len());
        (maps::state(table.len() as u64, table.as_bytes()), journal)
    } else {
        let (length, table) = data.split_first_chunk().map_or((0, data), |(length, table)| (u64::from_le_bytes(*length), table));
        (maps::state(length, table), maps::journal(b"!\x03abc"))
    };
    std::fs::write(unfinished.join(maps::state_name()), state).expect("space to write to");
    std::fs::write(unfinished.join("journal-00000001.vxj"), journal).expect("space to write to");
    let writer = MapWriter::create(&*MAP).expect("a map to write to");
    if let Ok(Some((checkpoint, checkpoints))) = Checkpoints::resume(&writer) {
        assert!(checkpoint.records.iter().map(Vec::len).sum::<usize>() + checkpoint.state.len() <= data.len() + 100);
        assert!(checkpoints.has_any());
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
