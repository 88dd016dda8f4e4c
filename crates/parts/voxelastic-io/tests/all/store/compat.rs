//! A tiny map, kept as it was written: the format is what it was.
//!
//! After a change of the format, which has a new version then, write it anew with
//! `VOXELASTIC_WRITE_FIXTURE=1 cargo test -p voxelastic-io --test store compat`.

use crate::store::world::{details, made_up_atlas, same_atlas, same_submap};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic_io::store::{FORMAT_VERSION, MapDetails, MapStore, MapWriter, SessionEntry, StoredFrame};

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/map-v{FORMAT_VERSION}"))
}

/// What it holds.
fn content() -> (Atlas, MapDetails) {
    (made_up_atlas(20, 2, 4), details("compat"))
}

#[test]
fn compat_the_kept_map_is_read() {
    let (atlas, details) = content();
    let store = MapStore::open(fixture()).unwrap();
    assert_eq!(store.manifest().details, details);
    assert!(same_atlas(&store.load_atlas().unwrap(), &atlas));
}

/// It takes a session, which goes again; what was there is read as before, and so is what is left without it.
#[test]
fn compat_the_kept_map_takes_sessions() {
    let more = made_up_atlas(31, 2, 4);
    let dir = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture()).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), dir.path().join(entry.file_name())).unwrap();
    }
    let before = MapStore::open(dir.path()).unwrap();
    let (old, details) = (before.load_atlas().unwrap(), before.manifest().details.clone());
    let first = before.manifest().all_sessions().remove(0);
    let placed = |submap: &Submap| submap.clone().with_id(submap.id() + first.last_submap + 1);
    let second = SessionEntry {
        number: 2,
        scans: more.scan_count(),
        first_submap: first.last_submap + 1,
        last_submap: first.last_submap + more.submaps().len() as u32,
        t_map_session: Some(StoredFrame(Pose::identity())),
        ..first.clone()
    };
    let parts = |with_first: bool, with_second: bool| {
        let store = MapStore::open(dir.path()).unwrap();
        assert!(store.check().is_empty() && store.manifest().details == details);
        let found = store.load_atlas().unwrap();
        let first = old.submaps().iter().filter(|_| with_first).cloned();
        let expected: Vec<Submap> = first.chain(more.submaps().iter().filter(|_| with_second).map(placed)).collect();
        assert_eq!(found.submaps().len(), expected.len());
        assert!(found.submaps().iter().zip(&expected).all(|(a, b)| same_submap(a, b)));
    };
    let add = || MapWriter::open(dir.path()).unwrap().add_session(&more, placed, vec![first.clone(), second.clone()]).unwrap();
    add();
    parts(true, true);
    MapWriter::open(dir.path()).unwrap().remove_session(2).unwrap();
    parts(true, false);
    assert_eq!(MapStore::open(dir.path()).unwrap().manifest().submaps, before.manifest().submaps);
    add();
    MapWriter::open(dir.path()).unwrap().remove_session(1).unwrap();
    parts(false, true);
}

#[test]
fn compat_the_current_version_is_written() {
    let (atlas, details) = content();
    if std::env::var_os("VOXELASTIC_WRITE_FIXTURE").is_some() {
        let path = fixture();
        MapWriter::create(&path).unwrap().save(&atlas, &details).unwrap();
        std::fs::remove_file(path.join(".lock")).unwrap();
    }
    let dir = tempfile::tempdir().unwrap();
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details).unwrap();
    let (written, kept) = (MapStore::open(dir.path()).unwrap(), MapStore::open(fixture()).unwrap());
    // Sizes and checksums of files may change with the compressor; names may not, they are hashes of the content.
    let content = |store: &MapStore| {
        let mut manifest = store.manifest().clone();
        manifest.submaps.iter_mut().for_each(|entry| (entry.bytes, entry.crc32) = (0, 0));
        manifest
    };
    assert_eq!(content(&written), content(&kept));
}
