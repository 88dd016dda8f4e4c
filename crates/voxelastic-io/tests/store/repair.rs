//! Repairing: the manifest from the submap files.

use crate::world::{details, made_up_atlas, same_atlas};
use std::fs;
use std::path::Path;
use voxelastic_io::Error;
use voxelastic_io::store::{ManifestState, MapStore, MapWriter, repair};

fn saved(dir: &Path, seed: u64, submaps: usize) -> voxelastic::atlas::Atlas {
    let atlas = made_up_atlas(seed, submaps, 20);
    MapWriter::create(dir).unwrap().save(&atlas, &details("repair")).unwrap();
    atlas
}

#[test]
fn the_manifest_comes_back_from_the_submap_files() {
    let dir = tempfile::tempdir().unwrap();
    let atlas = saved(dir.path(), 1, 4);
    let before = MapStore::open(dir.path()).unwrap().manifest().clone();
    fs::remove_file(dir.path().join("manifest.json")).unwrap();
    let report = repair(dir.path()).unwrap();
    assert_eq!((report.manifest, report.submaps, report.damage.len()), (ManifestState::Rebuilt, 4, 0));
    let store = MapStore::open(dir.path()).unwrap();
    assert_eq!(store.manifest().details, before.details);
    assert!(same_atlas(&store.load_atlas().unwrap(), &atlas));
}

#[test]
fn what_a_killed_save_left_does_not_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let mut atlas = saved(dir.path(), 1, 3);
    let old = MapStore::open(dir.path()).unwrap().manifest().clone();
    let kept = old.submaps.iter().map(|entry| (entry.file.clone(), fs::read(dir.path().join(&entry.file)).unwrap())).collect::<Vec<_>>();
    // Submap 2 was fused into submap 1, whose file is new; the old files of both are there still.
    let scans = [1, 2].map(|id| atlas.submap(id).unwrap().scans().to_vec()).concat();
    let all = scans.len();
    let submap = atlas.submap_mut(1).unwrap();
    *submap = submap.clone().with_scans(scans, submap.travelled() + 1.0);
    let fused = voxelastic::atlas::Atlas::from_submaps(atlas.voxel_size(), atlas.submaps().iter().filter(|s| s.id() != 2).cloned().collect());
    MapWriter::open(dir.path()).unwrap().save(&fused, &details("repair")).unwrap();
    kept.iter().for_each(|(name, bytes)| fs::write(dir.path().join(name), bytes).unwrap());
    fs::remove_file(dir.path().join("manifest.json")).unwrap();
    assert_eq!(repair(dir.path()).unwrap().submaps, 2);
    let again = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
    assert!(same_atlas(&again, &fused));
    assert_eq!(again.submap(1).unwrap().scans().len(), all);
}

#[test]
fn nothing_is_repaired_where_nothing_says_where_submaps_lie() {
    let dir = tempfile::tempdir().unwrap();
    // Files of version 2 do not.
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/map-v2");
    for entry in fs::read_dir(fixture).unwrap().map(|entry| entry.unwrap()).filter(|entry| entry.file_name() != "manifest.json") {
        fs::copy(entry.path(), dir.path().join(entry.file_name())).unwrap();
    }
    let error = repair(dir.path()).unwrap_err();
    assert!(matches!(&error, Error::Damaged { what, .. } if what.contains("does not say where")), "{error}");
    assert!(MapStore::open(dir.path()).is_err() && fs::read_dir(dir.path()).unwrap().count() == 3, "two submaps and the lock");
}
