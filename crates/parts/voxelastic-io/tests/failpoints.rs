//! Every operation on files fails in turn, writes with half of their bytes written; alone, and with all that follow, as if the process was killed there. The error names a file, the map or checkpoint of before is there, or the new one, and what follows works.
#![allow(clippy::print_stdout)]

#[path = "all/store/world.rs"]
#[allow(dead_code)]
mod world;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic_files::failpoint::{self, Failed};
use voxelastic_io::Result;
use voxelastic_io::store::{Checkpoints, MapEditor, MapStore, MapWriter, NewState, SessionEntry, StoredFrame, repair};
use world::{details, made_up_atlas, made_up_field, same_atlas, same_submap};

/// The atlas after so many steps: each changes a submap and moves another.
fn atlas(steps: u64) -> Atlas {
    let mut atlas = made_up_atlas(1, 3, 20);
    for step in 0..steps {
        *atlas.submap_mut((step % 3) as u32).unwrap().tsdf_mut() = made_up_field(100 + step, 40);
        atlas.submap_mut(((step + 1) % 3) as u32).unwrap().set_pose(Pose::translation(step as f64, 0.5, -1.0));
    }
    atlas
}

/// Begins the name of the folder where all that follows fails.
const KILLED: &str = "killed-";

/// Does `act` after `prepare` again and again, each time with the next operation failing, until none is left; first once, then with all that follow. `then`
/// looks at the outcome. `what` names it in the log.
fn each_fails<P, T>(what: &str, prepare: impl Fn(&Path) -> P, act: impl Fn(&mut P) -> Result<T>, mut then: impl FnMut(&Path, P, Result<T>)) {
    let mut failed = BTreeMap::<&str, usize>::new();
    for lasts in [false, true] {
        for after in 0.. {
            assert!(after < 500, "{what}: it never ends");
            let dir = tempfile::Builder::new().prefix(if lasts { KILLED } else { "" }).tempdir().unwrap();
            let path = dir.path().join("a.vox");
            let mut prepared = prepare(&path);
            failpoint::arm(after, lasts);
            let outcome = act(&mut prepared);
            let Some(Failed { operation, path: at }) = failpoint::disarm() else {
                outcome.unwrap();
                break;
            };
            if let Err(error) = &outcome {
                let (text, name) = (error.to_string(), at.file_name().unwrap().to_str().unwrap());
                assert!(text.contains(name) || lasts && text.contains("a.vox"), "{what}: {operation} {}: {text}", at.display());
            }
            *failed.entry(operation).or_default() += 1;
            then(&path, prepared, outcome);
        }
    }
    println!("{what}: {failed:?}");
    assert!(failed.values().sum::<usize>() > 2, "{what}: {failed:?}");
}

/// The map at `path`, all of which is undamaged.
fn map_at(path: &Path) -> Atlas {
    let store = MapStore::open(path).unwrap();
    assert!(store.check().is_empty());
    store.load_atlas().unwrap()
}

/// Names of files at `path` that are of no use to the map.
fn orphans(path: &Path) -> Vec<String> {
    let store = MapStore::open(path).unwrap();
    let mut names: Vec<String> = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| ![".lock", "manifest.json"].contains(&name.as_str()));
    names.retain(|name| store.manifest().submaps.iter().all(|submap| submap.file != *name));
    names
}

/// The writer of a map at `path` that was saved before.
fn saved(path: &Path, atlas: &Atlas) -> MapWriter {
    let mut writer = MapWriter::create(path).unwrap();
    writer.save(atlas, &details("before")).unwrap();
    writer
}

/// One test, as all threads of the process share the failpoints.
#[test]
fn whatever_fails_no_map_is_lost() {
    let [old, new, newer] = [2, 4, 5].map(atlas);
    saving(&old, &new);
    checkpoints(&old, &new, &newer);
    sessions(&old);
    editing(&old);
    reading(&new);
    repairing(&old);
    writing_another_file();
}

fn saving(old: &Atlas, new: &Atlas) {
    let (mut kept, mut replaced) = (0, 0);
    let over_another = |path: &Path| saved(path, old);
    let save = |writer: &mut MapWriter| writer.save(new, &details("now"));
    each_fails("a map over another", over_another, save, |path, mut writer, outcome| {
        let is_new = same_atlas(&map_at(path), new);
        assert!(is_new || same_atlas(&map_at(path), old) && outcome.is_err());
        (kept, replaced) = (kept + usize::from(!is_new), replaced + usize::from(is_new));
        // The next save works, of this process and of another, and leaves nothing behind.
        save(&mut writer).unwrap();
        assert!(same_atlas(&map_at(path), new) && orphans(path).is_empty());
        drop(writer);
        saved(path, old);
        assert!(same_atlas(&map_at(path), old) && orphans(path).is_empty());
    });
    println!("the map that was there was kept {kept} times and replaced {replaced} times");
    assert!(kept > 20 && replaced > 2);
    let first = |path: &Path| path.to_owned();
    let create_and_save = |path: &mut PathBuf| MapWriter::create(path).and_then(|mut writer| save(&mut writer));
    each_fails("a first map", first, create_and_save, |path, mut again, outcome| {
        assert!(outcome.is_err() || same_atlas(&map_at(path), new));
        create_and_save(&mut again).unwrap();
        assert!(same_atlas(&map_at(path), new) && orphans(path).is_empty());
    });
}

/// What was added to a map as a session: submaps behind those of the map.
fn added(submap: &Submap, map: &Atlas) -> Submap {
    submap.clone().with_id(submap.id() + map.submaps().len() as u32)
}

/// The sessions of a map with a second one.
fn two_sessions(map: &Atlas, more: &Atlas) -> Vec<SessionEntry> {
    let session = |number: u32, atlas: &Atlas, first: usize| SessionEntry {
        number,
        input: None,
        added: None,
        scans: atlas.scan_count(),
        first_submap: first as u32,
        last_submap: (first + atlas.submaps().len()) as u32 - 1,
        node_offset: 0,
        t_map_session: (number > 1).then_some(StoredFrame(Pose::identity())),
        loop_edges: Vec::new(),
        run: None,
    };
    vec![session(1, map, 0), session(2, more, map.submaps().len())]
}

/// Sessions are added to a map, and taken out, as `map --into`, `merge` and `remove` do it.
fn sessions(map: &Atlas) {
    let more = made_up_atlas(9, 2, 20);
    let is_whole = |path: &Path, sessions: usize| {
        let found = map_at(path);
        let submaps = map.submaps().len() + if sessions == 2 { more.submaps().len() } else { 0 };
        let of_first = map.submaps().iter().all(|submap| found.submap(submap.id()).is_some_and(|there| same_submap(submap, there)));
        let of_second = |submap: &Submap| found.submap(added(submap, map).id()).is_some_and(|there| same_submap(&added(submap, map), there));
        let count = MapStore::open(path).unwrap().manifest().all_sessions().len();
        count == sessions && found.submaps().len() == submaps && of_first && (sessions == 1 || more.submaps().iter().all(of_second))
    };
    let log = |path: &Path| MapStore::open(path).unwrap().run_log().unwrap();
    let one = |path: &Path| {
        let mut writer = saved(path, map);
        writer.write_run_log("of the first").unwrap();
        writer
    };
    let add = |writer: &mut MapWriter| writer.add_session(&more, |submap| added(submap, map), two_sessions(map, &more));
    let (mut kept, mut joined) = (0, 0);
    each_fails("a session into a map", one, add, |path, mut writer, outcome| {
        let is_new = is_whole(path, 2);
        assert!(is_new || is_whole(path, 1) && outcome.is_err());
        assert_eq!(log(path).as_deref(), Some("of the first"));
        (kept, joined) = (kept + usize::from(!is_new), joined + usize::from(is_new));
        if !is_new {
            // It works afterwards, in this process, and what failed leaves nothing behind.
            add(&mut writer).unwrap();
        } else {
            drop(writer);
            MapWriter::open(path).unwrap().save(&map_at(path), &details("again")).unwrap();
            assert!(orphans(path).is_empty());
            return;
        }
        assert!(is_whole(path, 2) && orphans(path) == ["run.json"]);
    });
    println!("the map was the one before {kept} times, and had the session {joined} times");
    assert!(kept > 15 && joined > 2);
    let two = |path: &Path| {
        let mut writer = one(path);
        add(&mut writer).unwrap();
        writer
    };
    for number in [2, 1] {
        let remove = |writer: &mut MapWriter| writer.remove_session(number);
        each_fails("a session out of a map", two, remove, |path, writer, outcome| {
            drop(writer);
            let left = MapStore::open(path).unwrap().manifest().all_sessions().len();
            assert!(left == 1 || is_whole(path, 2) && outcome.is_err());
            if left == 2 {
                MapWriter::open(path).unwrap().remove_session(number).unwrap();
            }
            let found = map_at(path);
            assert_eq!(found.submaps().len(), if number == 2 { map } else { &more }.submaps().len());
            assert!(number == 1 || is_whole(path, 1) && log(path).as_deref() == Some("of the first"));
            // What could not be removed then goes with the next save.
            MapWriter::open(path).unwrap().save(&found, &details("again")).unwrap();
            assert!(same_atlas(&map_at(path), &found) && orphans(path).is_empty());
        });
    }
}

/// The map as so many edits make it: each changes the fields of a submap and moves another.
fn edited(editor: &MapEditor, edits: u64) -> Result<NewState> {
    let manifest = editor.base().manifest();
    let mut state = NewState {
        entries: manifest.submaps.clone(),
        changed: Vec::new(),
        details: manifest.details.clone(),
        sessions: manifest.sessions.clone(),
        count: edits as usize,
        list: (0..edits).map(|k| format!("edit {k}\n")).collect(),
    };
    for k in 0..edits {
        state.entries[((k + 1) % 3) as usize].t_map_submap = Pose::translation(k as f64, 7.0, 1.0);
        if k < 3 {
            let mut changed = editor.base().load_submap(k as u32)?;
            *changed.tsdf_mut() = made_up_field(300 + k, 40);
            state.changed.push(Arc::new(changed));
        }
    }
    Ok(state)
}

/// All files of a map, also its lock, by name.
fn all_files(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(path).unwrap().map(|entry| entry.unwrap());
    entries.map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())).collect()
}

/// Edits of a map are made, taken back, all taken back, and made part of the map.
fn editing(map: &Atlas) {
    // Every state, by the number of its edits: all bytes of the folder.
    let whole = tempfile::tempdir().unwrap();
    let path = whole.path().join("a.vox");
    drop(saved(&path, map));
    let mut states = vec![all_files(&path)];
    for edits in 1..=4 {
        let mut editor = MapEditor::open(&path).unwrap();
        let state = edited(&editor, edits).unwrap();
        editor.save(state).unwrap();
        drop(editor);
        assert!(MapStore::open(&path).unwrap().check().is_empty());
        states.push(all_files(&path));
    }
    assert!(matches!(MapWriter::open(&path), Err(voxelastic_io::Error::Edited { .. })), "nobody else writes it");
    let with = |edits: u64| {
        move |path: &Path| {
            drop(saved(path, map));
            for count in 1..=edits {
                let mut editor = MapEditor::open(path).unwrap();
                let state = edited(&editor, count).unwrap();
                editor.save(state).unwrap();
            }
            path.to_owned()
        }
    };
    let save =
        |path: &Path, edits: u64| MapEditor::open(path).and_then(|mut editor| edited(&editor, edits).and_then(|state| editor.save(state)).map(drop));
    for (what, from, to) in [("a first edit", 0, 1), ("a further edit", 1, 2), ("an edit of what was edited", 3, 4), ("an edit taken back", 4, 2)] {
        let mut outcomes = [0, 0];
        each_fails(
            what,
            with(from),
            |path| save(path, to),
            |path, _, outcome| {
                let store = MapStore::open(path).unwrap();
                let count = store.manifest().edits.map_or(0, |mark| mark.count as u64);
                assert!(store.check().is_empty() && (count == to || count == from && outcome.is_err()), "{what}: {count} edits");
                assert_eq!(store.edits().unwrap(), (0..count).map(|k| format!("edit {k}\n")).collect::<String>());
                outcomes[usize::from(count == to)] += 1;
                // The next one works, and leaves what it would have left otherwise.
                save(path, to).unwrap();
                assert!(all_files(path) == states[to as usize], "{what}: {:?}", all_files(path).keys());
                MapEditor::restore(path).unwrap();
                assert!(all_files(path) == states[0], "{what}: {:?}", all_files(path).keys());
            },
        );
        assert!(outcomes[0] > 10 && outcomes[1] > 0, "{what}: {outcomes:?}");
    }
    each_fails(
        "all edits taken back",
        with(3),
        |path| MapEditor::restore(path),
        |path, _, _| {
            assert!(MapStore::open(path).unwrap().check().is_empty());
            MapEditor::restore(path).unwrap();
            // What could not be removed then goes with the next save.
            drop(saved(path, map));
            assert!(all_files(path).keys().eq(states[0].keys()), "{:?}", all_files(path).keys());
        },
    );
    let kept = |path: &Path| MapEditor::keep(path);
    each_fails(
        "edits that become part of the map",
        with(3),
        |path| kept(path),
        |path, _, _| {
            kept(path).unwrap();
            let found = map_at(path);
            assert!((0..3).all(|id| found.submap(id).unwrap().tsdf().len() == made_up_field(300 + u64::from(id), 40).len()));
            MapWriter::open(path).unwrap().save(&found, &details("again")).unwrap();
            assert!(orphans(path).is_empty(), "{:?}", orphans(path));
        },
    );
    // A manifest that is lost is the one of before the edits again.
    let path = with(2)(&whole.path().join("b.vox"));
    fs::write(path.join("manifest.json"), "lost").unwrap();
    assert!(matches!(repair(&path), Err(voxelastic_io::Error::Edited { .. })));
    MapEditor::restore(&path).unwrap();
    assert!(all_files(&path) == states[0]);
    // A list that somebody else has changed is not that of the map.
    let path = with(2)(&whole.path().join("c.vox"));
    fs::write(path.join("edits.toml"), "edit 7").unwrap();
    assert!(matches!(MapEditor::open(&path), Err(voxelastic_io::Error::Content { .. })));
    MapEditor::keep(&path).unwrap();
    assert!(MapStore::open(&path).unwrap().manifest().edits.is_none() && !path.join("edits.toml").exists());
    // And one of somebody else in the folder of a map without edits is not overwritten.
    fs::write(path.join("edits.toml"), "mine").unwrap();
    assert!(matches!(MapEditor::open(&path), Err(voxelastic_io::Error::Content { .. })));
    drop(MapWriter::open(&path).unwrap());
    assert_eq!(fs::read(path.join("edits.toml")).unwrap(), b"mine");
}

/// A run that has one checkpoint, and a record since.
fn begun(path: &Path, atlas: &Atlas) -> (MapWriter, Checkpoints) {
    let writer = MapWriter::create(path).unwrap();
    let mut checkpoints = Checkpoints::begin(&writer).unwrap();
    checkpoints.record(b"first");
    checkpoints.write(atlas, &details("run"), b"old").unwrap();
    checkpoints.record(b"second");
    (writer, checkpoints)
}

/// The state of the run at `path` after the last process ended, and whether it has the atlas and so many records.
fn resumed(path: &Path, atlas: &Atlas, records: usize) -> Vec<u8> {
    let (found, _) = Checkpoints::resume(&MapWriter::create(path).unwrap()).unwrap().unwrap();
    assert!(same_atlas(&found.atlas, atlas) && found.records == [&b"first"[..], b"second"][..records]);
    found.state
}

fn checkpoints(old: &Atlas, new: &Atlas, newer: &Atlas) {
    type Run = (MapWriter, Checkpoints);
    let begun = |path: &Path| begun(path, old);
    let write = |(_, checkpoints): &mut Run| checkpoints.write(new, &details("run"), b"new");
    each_fails("a checkpoint, then a kill", begun, write, |path, run, outcome| {
        drop(run);
        let (found, mut next) = Checkpoints::resume(&MapWriter::create(path).unwrap()).unwrap().unwrap();
        let is_new = found.state == b"new";
        assert!(is_new || found.state == b"old" && outcome.is_err());
        next.write(&found.atlas, &details("run"), &found.state).unwrap();
        drop(next);
        resumed(path, if is_new { new } else { old }, 1 + usize::from(is_new));
    });
    each_fails("a checkpoint, then the next", begun, write, |path, (writer, mut checkpoints), _| {
        checkpoints.write(newer, &details("run"), b"newer").unwrap();
        drop((writer, checkpoints));
        assert_eq!(resumed(path, newer, 2), b"newer");
    });
    let killed = |path: &Path| begun(path).0;
    let go_on = |writer: &mut MapWriter| Checkpoints::resume(writer).map(|found| found.unwrap().0.state);
    each_fails("going on", killed, go_on, |path, writer, outcome| {
        assert!(outcome.is_err());
        drop(writer);
        assert_eq!(resumed(path, old, 1), b"old");
    });
    let save = |(writer, checkpoints): &mut Run| checkpoints.save_map(writer, old, &details("run"));
    each_fails("the map after checkpoints", begun, save, |path, mut run, outcome| {
        assert!(outcome.is_err() || same_atlas(&map_at(path), old));
        save(&mut run).unwrap();
        assert!(same_atlas(&map_at(path), old));
    });
}

fn reading(atlas: &Atlas) {
    let there = |path: &Path| drop(saved(path, atlas));
    let path_of = |path: &Path| {
        there(path);
        path.to_owned()
    };
    each_fails("reading", path_of, |path| MapStore::open(path)?.load_atlas(), |_, _, outcome| assert!(outcome.is_err()));
    let whole = |path: &mut PathBuf| MapStore::open(path)?.load_undamaged();
    each_fails("reading what is whole", path_of, whole, |_, _, outcome| {
        let Ok((found, damage)) = outcome else { return };
        assert!(!damage.is_empty() && found.submaps().len() + damage.len() == atlas.submaps().len());
    });
}

/// A lost manifest is made again, also after that has failed.
fn repairing(atlas: &Atlas) {
    let without_manifest = |path: &Path| {
        drop(saved(path, atlas));
        let manifest = path.join("manifest.json");
        fs::write(manifest, "lost").unwrap();
        path.to_owned()
    };
    each_fails(
        "repairing",
        without_manifest,
        |path| repair(path),
        |path, _, outcome| {
            let mended = outcome.or_else(|_| repair(path)).unwrap();
            // A submap that could not be read then may be in its file only.
            assert!(mended.submaps <= atlas.submaps().len());
            if mended.submaps == atlas.submaps().len() {
                assert!(same_atlas(&map_at(path), atlas));
            }
        },
    );
}

fn writing_another_file() {
    let before = |path: &Path| {
        fs::write(path, "before").unwrap();
        path.to_owned()
    };
    let write = |path: &mut PathBuf| voxelastic_io::poses::write_tum(path, &[(0.0, Pose::identity())]);
    let whole = {
        let dir = tempfile::tempdir().unwrap();
        write(&mut dir.path().join("a.vox")).unwrap();
        fs::read(dir.path().join("a.vox")).unwrap()
    };
    each_fails("another file", before, write, |path, mut again, outcome| {
        let (found, outcome_is_err) = (fs::read(path).unwrap(), outcome.is_err());
        assert!(found == if outcome.is_ok() { whole.clone() } else { b"before".to_vec() });
        write(&mut again).unwrap();
        assert!(fs::read(path).unwrap() == whole);
        // What a killed process left goes when another process writes there, which a test of the crate of files shows.
        let folder = path.parent().unwrap();
        let is_killed = folder.file_name().unwrap().to_str().unwrap().starts_with(KILLED) && outcome_is_err;
        let litter = fs::read_dir(folder).unwrap().count() - 1;
        assert!(litter == 0 || is_killed && litter == 1, "{litter} files");
    });
}
