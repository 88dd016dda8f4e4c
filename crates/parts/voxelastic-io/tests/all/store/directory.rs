//! What is in the directory after a save, and which directories are refused.

use crate::store::world::{details, made_up_atlas, made_up_field, same_atlas};
use std::fs;
use std::path::Path;
use voxelastic_io::Error;
use voxelastic_io::store::{MapStore, MapWriter};

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn only_what_changed_is_written_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut atlas = made_up_atlas(1, 4, 50);
    let mut writer = MapWriter::create(dir.path().join("new/hall.vox")).unwrap();
    let dir = dir.path().join("new/hall.vox");
    let first = writer.save(&atlas, &details("first")).unwrap();
    assert_eq!((first.written, first.kept, first.removed), (4, 0, 0));
    let on_disk: u64 = names(&dir).iter().filter(|n| *n != ".lock").map(|n| dir.join(n).metadata().unwrap().len()).sum();
    assert_eq!((first.bytes, first.bytes_written), (on_disk, on_disk));
    let before = names(&dir);

    *atlas.submap_mut(2).unwrap().tsdf_mut() = made_up_field(77, 60);
    let second = writer.save(&atlas, &details("second")).unwrap();
    assert_eq!((second.written, second.kept, second.removed), (1, 3, 1));
    let after = names(&dir);
    assert_eq!((after.len(), after.iter().filter(|n| before.contains(n)).count()), (before.len(), before.len() - 1));

    // A pose correction and another word in the settings change the manifest only.
    let moved = atlas.submap_mut(0).unwrap();
    moved.set_pose(voxelastic::Pose::translation(1.0, 0.0, 0.0) * moved.t_map_submap());
    let third = writer.save(&atlas, &details("third")).unwrap();
    assert_eq!((third.written, third.kept, third.removed), (0, 4, 0));
    assert!(third.bytes_written < 10_000);
    drop(writer);

    // Reopened for writing, unchanged content is recognised as well.
    let mut writer = MapWriter::open(&dir).unwrap();
    let mut loaded = writer.store().load_atlas().unwrap();
    assert!(same_atlas(&loaded, &atlas));
    assert_eq!(writer.save(&loaded, &details("fourth")).unwrap().written, 0);
    *loaded.submap_mut(1).unwrap().tsdf_mut() = made_up_field(78, 10);
    assert_eq!(writer.save(&loaded, &details("fifth")).unwrap().written, 1);
    assert!(same_atlas(&MapStore::open(&dir).unwrap().load_atlas().unwrap(), &loaded));

    // A file that went missing is written again.
    fs::remove_file(dir.join(&writer.store().manifest().submaps[3].file)).unwrap();
    assert_eq!(writer.save(&loaded, &details("sixth")).unwrap().written, 1);
    assert!(writer.store().check().is_empty());
}

#[test]
fn another_map_replaces_the_one_that_was_there() {
    let dir = tempfile::tempdir().unwrap();
    let (old, new) = (made_up_atlas(1, 3, 10), made_up_atlas(2, 2, 10));
    MapWriter::create(dir.path()).unwrap().save(&old, &details("old")).unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    assert!(same_atlas(&MapStore::open(dir.path()).unwrap().load_atlas().unwrap(), &old), "the old map stays until the first save");
    let report = writer.save(&new, &details("new")).unwrap();
    assert_eq!((report.written, report.removed), (2, 3));
    assert!(same_atlas(&MapStore::open(dir.path()).unwrap().load_atlas().unwrap(), &new));
}

#[test]
fn leftovers_of_a_killed_run_are_removed_and_other_files_never() {
    let dir = tempfile::tempdir().unwrap();
    let leftovers = ["submap-000009-00000000000000aa.vxs", ".submap-000009-00000000000000aa.vxs.tmp", ".manifest.json.tmp"];
    leftovers.iter().for_each(|name| fs::write(dir.path().join(name), "half").unwrap());
    // A directory that a run left before its first save is no map yet, and a new run may use it.
    assert!(matches!(MapStore::open(dir.path()), Err(Error::NotAMap { .. })));
    let mut writer = MapWriter::create(dir.path()).unwrap();
    let others = ["notes.txt", "submap-000009.vxs", "mesh.ply.tmp", ".hidden"];
    others.iter().for_each(|name| fs::write(dir.path().join(name), "mine").unwrap());
    fs::create_dir(dir.path().join("submap-000008-00000000000000aa.vxs")).unwrap();
    let report = writer.save(&made_up_atlas(1, 1, 5), &details("leftovers")).unwrap();
    assert_eq!(report.removed, leftovers.len() - 1, "all but the manifest's, which this save used itself");
    let now = names(dir.path());
    assert!(others.iter().all(|name| now.contains(&(*name).to_owned())), "{now:?}");
    assert_eq!(now.len(), others.len() + 4, "lock, manifest, submap, and the directory with a submap's name: {now:?}");
}

#[test]
fn a_run_log_stays_with_its_map_until_the_next_save() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    writer.save(&made_up_atlas(1, 1, 5), &details("one")).unwrap();
    let log = |dir: &Path| MapStore::open(dir).unwrap().run_log();
    assert_eq!(log(dir.path()).unwrap(), None);
    writer.write_run_log("{\"scans\": 3}").unwrap();
    assert_eq!(log(dir.path()).unwrap().as_deref(), Some("{\"scans\": 3}"));
    assert!(MapStore::open(dir.path()).unwrap().check().is_empty());
    writer.save(&made_up_atlas(1, 1, 6), &details("two")).unwrap();
    assert_eq!(log(dir.path()).unwrap(), None, "it is of another map");
    fs::write(dir.path().join("run.json"), [0xff, 0xfe]).unwrap();
    assert!(matches!(log(dir.path()), Err(Error::Damaged { .. })));
}

#[test]
fn directories_that_hold_something_else_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("thesis.tex"), "years of work").unwrap();
    let error = MapWriter::create(dir.path()).unwrap_err();
    assert!(matches!(&error, Error::WouldOverwrite { found, .. } if found == "thesis.tex"), "{error}");
    assert_eq!(names(dir.path()), ["thesis.tex"]);

    let web = tempfile::tempdir().unwrap();
    fs::write(web.path().join("manifest.json"), "{\"name\": \"a web page\"}").unwrap();
    for error in [MapWriter::create(web.path()).unwrap_err(), MapStore::open(web.path()).unwrap_err()] {
        assert!(matches!(error, Error::NotAMap { .. }), "{error}");
    }
    assert_eq!(names(web.path()), ["manifest.json"]);

    let file = dir.path().join("thesis.tex");
    for error in [MapWriter::create(&file).unwrap_err(), MapStore::open(&file).unwrap_err(), MapStore::open(dir.path().join("gone")).unwrap_err()] {
        assert!(matches!(error, Error::NotAMap { .. }), "{error}");
    }
    assert!(MapWriter::open(dir.path()).is_err() && MapWriter::create(file.join("map")).is_err());
}

#[test]
fn a_second_writer_is_refused_while_the_first_lives() {
    let dir = tempfile::tempdir().unwrap();
    let mut first = MapWriter::create(dir.path()).unwrap();
    first.save(&made_up_atlas(1, 1, 5), &details("lock")).unwrap();
    for error in [MapWriter::create(dir.path()).unwrap_err(), MapWriter::open(dir.path()).unwrap_err()] {
        assert!(matches!(&error, Error::Locked { pid, .. } if *pid == std::process::id().to_string()), "{error}");
    }
    assert!(MapStore::open(dir.path()).is_ok(), "reading needs no lock");
    drop(first);
    assert!(MapWriter::open(dir.path()).is_ok());
    // What a process that is gone wrote into the file locks nobody out.
    fs::write(dir.path().join(".lock"), "1\n").unwrap();
    assert!(MapWriter::open(dir.path()).is_ok());
}

#[test]
fn poses_that_are_no_poses_are_not_saved() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    let good = made_up_atlas(1, 2, 5);
    writer.save(&good, &details("good")).unwrap();
    let mut bad = good.clone();
    bad.submap_mut(1).unwrap().set_pose(voxelastic::Pose::translation(0.0, f64::NAN, 0.0));
    let error = writer.save(&bad, &details("bad")).unwrap_err();
    assert!(matches!(&error, Error::Unwritable { problem, .. } if problem.contains("submap 1: ")), "{error}");
    let mut bad = good.clone();
    let submap = bad.submap_mut(0).unwrap();
    let mut scans = submap.scans().to_vec();
    scans[1].t_submap_lidar.rotation.as_mut_unchecked().coords *= 2.0;
    *submap = submap.clone().with_scans(scans, submap.travelled());
    assert!(matches!(writer.save(&bad, &details("bad")), Err(Error::Unwritable { problem, .. }) if problem.contains("submap 0: ")));
    assert!(same_atlas(&MapStore::open(dir.path()).unwrap().load_atlas().unwrap(), &good));
}

#[cfg(unix)]
#[test]
fn a_file_system_that_refuses_is_named_and_the_old_map_stays() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let good = made_up_atlas(1, 1, 5);
    let mut writer = MapWriter::create(dir.path()).unwrap();
    writer.save(&good, &details("good")).unwrap();
    fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o555)).unwrap();
    if fs::write(dir.path().join("probe"), "").is_ok() {
        voxelastic_testing::skip(voxelastic_testing::Need::System, "this user may write anywhere");
    } else {
        let error = writer.save(&made_up_atlas(2, 1, 5), &details("refused")).unwrap_err();
        assert!(matches!(&error, Error::Io { doing: "write", source, .. } if source.kind() == std::io::ErrorKind::PermissionDenied), "{error}");
    }
    fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o755)).unwrap();
    // A directory in the place where the manifest must go refuses every user.
    fs::create_dir(dir.path().join(".manifest.json.tmp")).unwrap();
    let error = writer.save(&made_up_atlas(3, 1, 5), &details("refused")).unwrap_err();
    assert!(matches!(&error, Error::Io { path, .. } if path.ends_with("manifest.json")), "{error}");
    let store = MapStore::open(dir.path()).unwrap();
    assert!(same_atlas(&store.load_atlas().unwrap(), &good));
}
