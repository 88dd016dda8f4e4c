//! Checkpoints of a run: what comes back, what is refused, and what the map that is saved after them looks like.

use crate::store::world::{details, made_up_atlas, made_up_field, same_atlas};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic_io::Error;
use voxelastic_io::store::{Checkpoints, MapStore, MapWriter};

/// The atlas after so many steps, each of which changes a submap and moves another.
fn step(atlas: &mut Atlas, step: u64) {
    *atlas.submap_mut((step % 3) as u32).unwrap().tsdf_mut() = made_up_field(100 + step, 40);
    atlas.submap_mut(((step + 1) % 3) as u32).unwrap().set_pose(Pose::translation(step as f64, 0.5, -1.0));
}

fn content(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    files
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path).unwrap()))
        .filter(|(name, _)| name != ".lock")
        .collect()
}

#[test]
fn the_map_does_not_depend_on_its_checkpoints() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let mut atlas = made_up_atlas(1, 3, 20);
    let mut writer = MapWriter::create(at("with.vox")).unwrap();
    assert!(Checkpoints::resume(&writer).unwrap().is_none());
    let mut checkpoints = Checkpoints::begin(&writer).unwrap();
    for k in 0..4 {
        step(&mut atlas, k);
        let report = checkpoints.write(&atlas, &details("run"), &[k as u8; 5]).unwrap();
        assert_eq!((report.written, report.kept, report.removed > 0), if k == 0 { (3, 0, false) } else { (1, 2, true) }, "step {k}");
    }
    // Another process goes on, with submaps as they were stored.
    drop((checkpoints, writer));
    writer = MapWriter::create(at("with.vox")).unwrap();
    let (found, mut checkpoints) = Checkpoints::resume(&writer).unwrap().unwrap();
    assert!(same_atlas(&found.atlas, &atlas) && found.state == [3; 5] && found.details == details("run"));
    let mut resumed = found.atlas;
    for k in 4..6 {
        [&mut atlas, &mut resumed].into_iter().for_each(|atlas| step(atlas, k));
        checkpoints.write(&resumed, &details("run"), b"").unwrap();
    }
    let report = checkpoints.save_map(&mut writer, &resumed, &details("run")).unwrap();
    assert_eq!(report.written, 3);
    checkpoints.discard();
    assert!(!at("with.vox/unfinished").exists());
    MapWriter::create(at("without.vox")).unwrap().save(&atlas, &details("run")).unwrap();
    assert_eq!(content(&at("with.vox")).keys().collect::<Vec<_>>(), content(&at("without.vox")).keys().collect::<Vec<_>>());
    // Memory sizes in the manifest are those of the process.
    let submaps = |name: &str| content(&at(name)).into_iter().filter(|(name, _)| name.ends_with(".vxs")).collect::<BTreeMap<_, _>>();
    assert!(submaps("with.vox") == submaps("without.vox"), "root poses in the files are those of the last moment");
    assert!(MapStore::open(at("with.vox")).unwrap().check().is_empty());
}

#[test]
fn every_damaged_byte_of_a_state_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let writer = MapWriter::create(dir.path().join("a.vox")).unwrap();
    Checkpoints::begin(&writer).unwrap().write(&made_up_atlas(1, 2, 5), &details("run"), b"where the run is").unwrap();
    let unfinished = dir.path().join("a.vox/unfinished");
    let state = fs::read_dir(&unfinished).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().is_some_and(|e| e == "vxr")).unwrap();
    let whole = fs::read(&state).unwrap();
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        fs::write(&state, bytes).unwrap();
        let error = Checkpoints::resume(&writer).unwrap_err();
        assert!(matches!(&error, Error::Damaged { path, .. } if *path == state), "byte {at}: {error}");
    }
    for length in 0..whole.len() {
        fs::write(&state, &whole[..length]).unwrap();
        assert!(matches!(Checkpoints::resume(&writer), Err(Error::Damaged { .. })), "{length} bytes");
    }
    fs::remove_file(&state).unwrap();
    assert!(matches!(Checkpoints::resume(&writer), Err(Error::Missing { .. })));
    // The next run replaces it.
    Checkpoints::begin(&writer).unwrap().write(&made_up_atlas(2, 2, 5), &details("run"), b"new").unwrap();
    assert_eq!(Checkpoints::resume(&writer).unwrap().unwrap().0.state, b"new");
}

#[test]
fn a_journal_is_that_of_the_last_checkpoint_whatever_fails() {
    let dir = tempfile::tempdir().unwrap();
    let writer = MapWriter::create(dir.path().join("a.vox")).unwrap();
    let resumed = || {
        let (found, checkpoints) = Checkpoints::resume(&writer).unwrap().unwrap();
        let records: Vec<String> = found.records.into_iter().map(|record| String::from_utf8(record).unwrap()).collect();
        (String::from_utf8(found.state).unwrap(), records, checkpoints)
    };
    let mut atlas = made_up_atlas(1, 2, 5);
    let mut checkpoints = Checkpoints::begin(&writer).unwrap();
    checkpoints.record(b"first");
    checkpoints.record(b"");
    checkpoints.write(&atlas, &details("run"), b"one").unwrap();
    // One that cannot be written leaves state and journal of the one before; what came since belongs to the next.
    let pose = atlas.submap(0).unwrap().t_map_submap();
    atlas.submap_mut(0).unwrap().set_pose(Pose::translation(f64::NAN, 0.0, 0.0));
    checkpoints.record(b"second");
    checkpoints.write(&atlas, &details("run"), b"two").unwrap_err();
    drop(checkpoints);
    let (state, records, mut checkpoints) = resumed();
    assert_eq!((state.as_str(), records), ("one", vec!["first".to_owned(), String::new()]));
    checkpoints.record(b"again");
    checkpoints.write(&atlas, &details("run"), b"two").unwrap_err();
    atlas.submap_mut(0).unwrap().set_pose(pose);
    checkpoints.write(&atlas, &details("run"), b"two").unwrap();
    drop(checkpoints);
    let unfinished = dir.path().join("a.vox/unfinished");
    let journal = fs::read_dir(&unfinished).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().is_some_and(|e| e == "vxj")).unwrap();
    let whole = fs::read(&journal).unwrap();
    // What a process that died left behind is cut off.
    fs::write(&journal, [&whole[..], b"half of a record"].concat()).unwrap();
    let (state, records, mut checkpoints) = resumed();
    assert_eq!((state.as_str(), records.len(), records[2].as_str()), ("two", 3, "again"));
    checkpoints.record(b"last");
    checkpoints.write(&atlas, &details("run"), b"three").unwrap();
    drop(checkpoints);
    assert_eq!(resumed().1, ["first", "", "again", "last"]);
    let whole = fs::read(&journal).unwrap();
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        fs::write(&journal, bytes).unwrap();
        assert!(matches!(Checkpoints::resume(&writer), Err(Error::Damaged { path, .. }) if path == journal), "byte {at}");
        fs::write(&journal, &whole[..at]).unwrap();
        assert!(matches!(Checkpoints::resume(&writer), Err(Error::Damaged { path, .. }) if path == journal), "{at} bytes");
    }
    // A run that begins anew has a journal of its own.
    fs::write(&journal, &whole).unwrap();
    let mut checkpoints = Checkpoints::begin(&writer).unwrap();
    checkpoints.write(&atlas, &details("run"), b"new").unwrap();
    assert!(!journal.exists());
    drop(checkpoints);
    assert!(resumed().1.is_empty());
}
