#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;
use voxelastic_fuzz::{check_memory, folder, maps};
use voxelastic_io::store::{MapStore, join_manifests};

/// A map that was kept, whose manifest is tried.
static MAP: LazyLock<PathBuf> = LazyLock::new(|| {
    let map = folder().join("map.vox");
    std::fs::create_dir_all(&map).expect("a folder to write to");
    for file in std::fs::read_dir(maps::KEPT).expect("the map that is kept").flatten().filter(|file| file.path().is_file()) {
        std::fs::copy(file.path(), map.join(file.file_name())).expect("space to write to");
    }
    map
});

/// What follows the checksum of a manifest.
fn read(data: &[u8]) {
    let text = maps::manifest(data);
    std::fs::write(MAP.join("manifest.json"), &text).expect("space to write to");
    if let Ok(store) = MapStore::open(&*MAP) {
        let manifest = store.manifest();
        let _ = (manifest.all_sessions(), manifest.next_node(), manifest.details.origin().is_ok(), manifest.details.stored_settings());
        let _ = (store.bytes(), store.check_sizes(), store.check());
        if let Ok((atlas, _)) = store.load_undamaged() {
            let _ = (atlas.scan_count(), atlas.newest_scan());
        }
        let _ = join_manifests(&[String::from_utf8_lossy(&text).into_owned()], &Default::default(), false, None);
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
