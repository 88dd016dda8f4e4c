//! Repairing: the manifest from the submap files.

use crate::store::world::{details, made_up_atlas, same_atlas};
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::Submap;
use voxelastic_io::Error;
use voxelastic_io::store::{ManifestState, MapStore, MapWriter, SessionEntry, StoredEdge, StoredFrame, repair};

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

/// Files of a session that was added say so; their times and loop edges are in the manifest alone.
#[test]
fn sessions_come_back_with_the_manifest() {
    let dir = tempfile::tempdir().unwrap();
    let map = saved(dir.path(), 1, 3);
    let more = made_up_atlas(9, 2, 20);
    let before = MapStore::open(dir.path()).unwrap().manifest().all_sessions();
    let edge = StoredEdge { from: 1, to: 2, t_from_to: Pose::identity(), information: Vec::new() };
    let second = SessionEntry {
        number: 2,
        input: Some("second".to_owned()),
        added: Some("2026-11-25T06:00:00Z".to_owned()),
        scans: more.scan_count(),
        first_submap: 3,
        last_submap: 4,
        node_offset: 7,
        t_map_session: Some(StoredFrame(Pose::translation(1.0, 2.0, 3.0))),
        loop_edges: vec![edge],
        ..before[0].clone()
    };
    let sessions = vec![before[0].clone(), second.clone()];
    let placed = |submap: &Submap| submap.clone().with_id(submap.id() + 3);
    MapWriter::open(dir.path()).unwrap().add_session(&more, placed, sessions).unwrap();
    fs::remove_file(dir.path().join("manifest.json")).unwrap();
    assert_eq!(repair(dir.path()).unwrap().submaps, 5);
    let found = MapStore::open(dir.path()).unwrap().manifest().all_sessions();
    assert_eq!(found, [before[0].clone(), SessionEntry { added: None, loop_edges: Vec::new(), ..second }]);
    // So the session can still be taken out.
    MapWriter::open(dir.path()).unwrap().remove_session(2).unwrap();
    let store = MapStore::open(dir.path()).unwrap();
    assert!(same_atlas(&store.load_atlas().unwrap(), &map) && store.manifest().sessions.is_empty());
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

/// A submap file without its last section, which says where the submap lies.
fn without_origin(bytes: &[u8]) -> Vec<u8> {
    /// Bytes of the head before the section table, and of one section in it.
    const HEAD: [usize; 2] = [20, 24];
    let count = usize::from(bytes[16]) - 1;
    let rows = &bytes[HEAD[0]..][..HEAD[1] * (count + 1)];
    let offset = |row: &[u8]| u64::from_le_bytes(row[8..16].try_into().unwrap());
    let last = &rows[HEAD[1] * count..];
    assert_eq!(&last[..4], b"orig");
    let mut changed = [&bytes[..16], &(count as u32).to_le_bytes()].concat();
    for row in rows.chunks(HEAD[1]).take(count) {
        changed.extend([&row[..8], &(offset(row) - HEAD[1] as u64).to_le_bytes(), &row[16..]].concat());
    }
    changed.extend(crc32fast::hash(&changed).to_le_bytes());
    changed.extend(&bytes[HEAD[0] + rows.len() + 4..offset(last) as usize]);
    changed
}

#[test]
fn nothing_is_repaired_where_nothing_says_where_submaps_lie() {
    let dir = tempfile::tempdir().unwrap();
    let atlas = made_up_atlas(20, 2, 4);
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details("repair")).unwrap();
    fs::remove_file(dir.path().join("manifest.json")).unwrap();
    for entry in fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some()) {
        fs::write(&entry, without_origin(&fs::read(&entry).unwrap())).unwrap();
    }
    let error = repair(dir.path()).unwrap_err();
    assert!(matches!(&error, Error::Damaged { what, .. } if what.contains("does not say where")), "{error}");
    assert!(MapStore::open(dir.path()).is_err() && fs::read_dir(dir.path()).unwrap().count() == 3, "two submaps and the lock");
}
