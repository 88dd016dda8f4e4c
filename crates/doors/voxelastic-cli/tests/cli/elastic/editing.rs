//! Maps that are mended by hand: what edits do, and that they can be taken back byte for byte.

use crate::elastic::edited_maps::{
    assert_same, broken_street, corrected, files, largest_error, map_street, small_map, submaps_of_a_lap, vertices_near,
};
use crate::elastic::sessions::copy;
use crate::faults::resume::{Numbers, ends};
use crate::{fails, json, run, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapEditor, MapStore};

#[test]
fn a_broken_map_is_mended_from_metres_to_centimetres() {
    let dir = tempfile::tempdir().unwrap();
    let (at, (ghost, truth)) = (dir.path(), broken_street(dir.path(), 0.004));
    let map = at.join("street.vox");
    map_street(at, "street.vox");
    let before = (largest_error(&map, &truth), files(&map));
    assert!(before.0 > 1.5, "{}", before.0);
    let listed = json(at, "edit street.vox --list --json");
    assert_eq!((listed["edits"].as_array().unwrap().len(), &listed["closures"][0]["scans"]), (0, &serde_json::json!([40, 150])), "{listed}");
    assert!(vertices_near(at, "street.vox", ghost, 0.8) > 20);
    let [first, last] = submaps_of_a_lap(&map, &truth);
    let erase = format!("[[edit]]\nkind = \"erase\"\nsphere = {{ centre = {ghost:?}, radius = 0.9 }}\nthen = \"free\"\n");
    let mut edits =
        format!("{erase}[[edit]]\nkind = \"remove-closure\"\nscans = [40, 150]\n\n[[edit]]\nkind = \"closure\"\nsubmaps = [{first}, {last}]\n");
    // What the closure leaves between are heights, which somebody has levelled every 60 m.
    for scan in (30..230).step_by(40).chain([truth.len() - 1]) {
        edits += &format!("[[edit]]\nkind = \"pin\"\nscan = {scan}\nheight = {:?}\n", truth[scan].translation.z);
    }
    fs::write(at.join("edits.toml"), edits).unwrap();
    let clock = Instant::now();
    let done = json(at, "edit street.vox --apply edits.toml --json");
    let took = clock.elapsed();
    assert_eq!(done["edits"], 9, "{done}");
    let after = largest_error(&map, &truth);
    println!("largest error of a pose: {:.2} m before, {after:.3} m after, in {:.1} s: {done}", before.0, took.as_secs_f64());
    assert!(after <= 0.05, "{after}: {done}");
    assert!(done["applied"][2]["fit"]["edges"].as_u64().unwrap() > 0 && done["applied"][0]["surface_voxels"].as_u64().unwrap() > 100, "{done}");
    assert_eq!(vertices_near(at, "street.vox", ghost, 0.8), 0);
    // The list as it is kept, on a new map of the same data, and without looking for anything again: the same bytes.
    map_street(at, "again.vox");
    fs::copy(map.join("edits.toml"), at.join("kept.toml")).unwrap();
    works(at, "edit again.vox --apply kept.toml");
    let mut again = files(&at.join("again.vox"));
    // Times of runs differ.
    again.insert("run.json".to_owned(), files(&map)["run.json"].clone());
    assert_same(&map, &again, "the same list on a new map");
    works(at, "edit street.vox --undo all");
    assert_same(&map, &before.1, "all undone");
}

/// Edits of all kinds at random, as a list.
fn random_edits(numbers: &mut Numbers, count: usize, map: &Path) -> String {
    let mut number = |low: f64, high: f64| low + (high - low) * numbers.unit();
    let scans = corrected(map);
    let mut submaps: Vec<u32> = MapStore::open(map).unwrap().manifest().submaps.iter().map(|s| s.id).collect();
    let mut text = String::new();
    for k in 0..count {
        let at = [number(0.0, 8.0), number(-2.5, 2.5), number(0.2, 2.4)];
        // A wall is reached by every region.
        let wall = [at[0], 3.0, at[2]];
        let of = ["both", "surfaces", "occupancy"][k % 3];
        let scan = |share: f64| *scans.keys().nth((share * scans.len() as f64) as usize).unwrap();
        let edit = match (number(0.0, 12.0) as usize, submaps.len()) {
            (0, _) => format!("kind = \"erase\"\nof = \"{of}\"\nsphere = {{ centre = {wall:?}, radius = {} }}", number(0.3, 0.6)),
            (1, _) => {
                format!("kind = \"erase\"\nbox = {{ min = [{}, 2.6, 0.1], max = [{}, 3.4, 2.5], yaw = {} }}", at[0], at[0] + 0.5, number(-20.0, 20.0))
            }
            (2, _) => {
                let [x, y] = [at[0], 2.8];
                format!(
                    "kind = \"erase\"\nthen = \"free\"\nprism = {{ polygon = [[{x}, {y}], [{}, 3.3], [{}, 3.5]], z = [0.0, {}] }}",
                    x + 0.7,
                    x - 0.2,
                    number(1.0, 2.6)
                )
            }
            (3, _) => format!("kind = \"crop\"\nbox = {{ min = [-1.5, -3.5, {}], max = [9.5, 3.5, 3.0] }}", -0.5 + 0.02 * k as f64),
            (4, _) => format!("kind = \"pin\"\nsubmap = {}\nheight = {}", submaps[k % submaps.len()], number(1.15, 1.25)),
            (5, _) => format!("kind = \"pin\"\nsubmap = {}\nupright = true", submaps[k % submaps.len()]),
            (6, _) => {
                let node = scan(number(0.0, 1.0));
                let p = scans[&node].translation.vector;
                format!("kind = \"pin\"\nscan = {node}\nposition = [{}, {}, {}]", p.x + number(-0.05, 0.05), p.y + number(-0.05, 0.05), p.z)
            }
            (7, _) => {
                let (a, b) = (scan(number(0.0, 0.4)), scan(number(0.6, 1.0)));
                let t = scans[&a].inv_mul(&scans[&b]);
                let (p, q) = (t.translation.vector, t.rotation.coords);
                format!("kind = \"closure\"\nscans = [{a}, {b}]\nmeasured = [{}, {}, {}, {}, {}, {}, {}]", p.x + 0.02, p.y, p.z, q.x, q.y, q.z, q.w)
            }
            (8, 3..) => {
                let from = submaps.remove(1);
                format!("kind = \"merge\"\nsubmaps = [{}, {from}]", submaps[0])
            }
            _ => format!("kind = \"note\"\ntext = \"note \\\"{k}\\\"\"\nat = {at:?}"),
        };
        text += &format!("[[edit]]\n{edit}\n\n");
    }
    text
}

#[test]
fn fifty_random_edits_are_undone_byte_for_byte() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    let before = files(&map);
    let mut numbers = Numbers(7);
    let edits = random_edits(&mut numbers, 50, &map);
    let tables: Vec<&str> = edits.split_inclusive("\n\n").collect();
    assert_eq!(tables.len(), 50);
    // In five parts, of which all bytes are remembered; one erases what another has erased already, and is refused.
    let mut states = vec![(0, before)];
    for part in tables.chunks(10) {
        for table in part {
            fs::write(at.join("part.toml"), table).unwrap();
            let done = run(at, "edit room.vox --apply part.toml");
            assert!(done.code == Some(0) || done.err.contains("nothing of the map would be erased"), "{table}\n{}", done.err);
        }
        let count = json(at, "edit room.vox --list --json")["edits"].as_array().unwrap().len();
        assert_eq!(json(at, "info room.vox --check --json")["edits"], count);
        states.push((count, files(&map)));
    }
    let kinds: Vec<String> = json(at, "edit room.vox --list --json")["edits"].as_array().unwrap().iter().map(|e| e["kind"].to_string()).collect();
    println!("{} edits: {kinds:?}", states[5].0);
    assert!(states[5].0 >= 40);
    for kind in ["erase", "crop", "pin", "closure", "merge", "note"] {
        assert!(kinds.iter().any(|k| k.contains(kind)), "no {kind} among {kinds:?}");
    }
    // All at once on a copy, with another number of threads: the same bytes.
    let made = files(&map);
    copy(&map, &at.join("copy.vox"));
    fs::write(at.join("copy.vox/.lock"), "").unwrap();
    fs::copy(map.join("edits.toml"), at.join("kept.toml")).unwrap();
    works(at, "edit copy.vox --undo all");
    assert_same(&at.join("copy.vox"), &states[0].1, "all undone at once");
    works(at, "edit copy.vox --apply kept.toml --threads 1");
    assert_same(&at.join("copy.vox"), &made, "the same list at once");
    for pair in states.windows(2).rev() {
        let (left, state) = &pair[0];
        works(at, &format!("edit room.vox --undo {}", pair[1].0 - left));
        assert_same(&map, state, &format!("{left} edits left"));
    }
    fails(at, "edit room.vox --undo 1", 2, &["has 0 edits"]);
}

#[test]
fn a_kill_loses_at_most_the_edit_in_hand() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    let mut numbers = Numbers(11);
    let wall = |k: usize| format!("[[edit]]\nkind = \"erase\"\nsphere = {{ centre = [{}, 3.0, 1.2], radius = 0.4 }}\n", 0.5 + k as f64);
    let pin = |k: usize| format!("[[edit]]\nkind = \"pin\"\nscan = {}\nheight = {}\n", 3 * k, 1.2 + 0.01 * k as f64);
    fs::write(at.join("edits.toml"), (0..4).map(|k| wall(k) + &pin(k)).collect::<String>()).unwrap();
    copy(&map, &at.join("whole.vox"));
    fs::write(at.join("whole.vox/.lock"), "").unwrap();
    let mut states = vec![files(&at.join("whole.vox"))];
    for k in 0..4 {
        for table in [wall(k), pin(k)] {
            fs::write(at.join("one.toml"), table).unwrap();
            works(at, "edit whole.vox --apply one.toml");
            states.push(files(&at.join("whole.vox")));
        }
    }
    let clock = Instant::now();
    works(at, "edit room.vox --apply edits.toml");
    let takes = clock.elapsed();
    let (mut seen, mut kills) = (BTreeMap::<usize, usize>::new(), 0);
    for command in ["--apply edits.toml", "--undo 5"] {
        for _ in 0..12 {
            // The state of before.
            works(at, "edit room.vox --undo all");
            if command.starts_with("--undo") {
                works(at, "edit room.vox --apply edits.toml");
            }
            kills += usize::from(!ends(at, &format!("edit room.vox {command}"), takes, &mut numbers));
            let store = MapStore::open(&map).unwrap();
            let count = store.manifest().edits.map_or(0, |mark| mark.count);
            *seen.entry(count).or_default() += 1;
            assert!(store.check().is_empty() && store.edits().is_ok());
            // Every file that the state has is there; what a kill left goes with the next edit.
            let now = files(&map);
            for (name, bytes) in states[count].iter().filter(|(name, _)| !["edits.toml", ".lock"].contains(&&***name)) {
                assert!(now.get(name) == Some(bytes), "{command}: {count} edits, {name}");
            }
            if count > 0 {
                assert!(now["edits.toml"].starts_with(&states[count]["edits.toml"]));
            }
            fs::write(at.join("one.toml"), "[[edit]]\nkind = \"note\"\ntext = \"after\"\n").unwrap();
            works(at, "edit room.vox --apply one.toml");
            works(at, "edit room.vox --undo 1");
            assert_same(&map, &states[count], &format!("{command}: {count} edits"));
        }
    }
    println!("{kills} kills left so many edits, so often: {seen:?}");
    assert!(kills >= 6 && seen.len() >= 3, "{kills}: {seen:?}");
}

#[test]
fn a_second_editor_is_refused_and_nobody_loses_edits() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    small_map(at, "room.vox");
    fs::write(at.join("edits.toml"), "[[edit]]\nkind = \"note\"\ntext = \"mine\"\n").unwrap();
    works(at, "edit room.vox --apply edits.toml");
    let editor = MapEditor::open(at.join("room.vox")).unwrap();
    let pid = std::process::id().to_string();
    for command in ["--apply edits.toml", "--undo 1", "--undo all", "--keep"] {
        fails(at, &format!("edit room.vox {command}"), 1, &[&pid, "room.vox"]);
    }
    fails(at, "edit room.vox --apply edits.toml", 1, &["read-only", "--list", "remedy"]);
    assert!(works(at, "edit room.vox --list").contains("text = \"mine\""));
    drop(editor);
    // Whoever would write the map otherwise is refused.
    works(at, "map room -o other.vox --voxel-size 0.1 --max-range 20 --field both");
    let before = files(&at.join("room.vox"));
    let writers = [
        "map room -o room.vox --voxel-size 0.1",
        "map room --into room.vox",
        "merge other.vox --into room.vox",
        "remove room.vox --session 1",
        "refine room.vox room",
        "repair room.vox",
    ];
    for command in writers {
        fails(at, command, 1, &["has edits", "--undo all", "--keep"]);
        assert_same(&at.join("room.vox"), &before, command);
    }
    works(at, "edit room.vox --keep");
    assert!(!at.join("room.vox/edits.toml").exists() && !at.join("room.vox/base.json").exists());
    works(at, "repair room.vox");
    fails(at, "edit room.vox --json", 2, &["--apply"]);
    fails(at, "edit room.vox --list --keep", 2, &[]);
}

#[test]
fn pins_hold_what_they_name_and_the_map_bends() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    let before = corrected(&map);
    let apply = |text: &str| {
        fs::write(at.join("edits.toml"), text).unwrap();
        json(at, "edit room.vox --apply edits.toml --json")
    };
    let last = MapStore::open(&map).unwrap().manifest().submaps.last().unwrap().clone();
    let root = last.t_map_submap.translation.vector;
    let done = apply(&format!("[[edit]]\nkind = \"pin\"\nsubmap = {}\nposition = [{}, {}, {}]\n", last.id, root.x, root.y + 0.6, root.z + 0.3));
    assert!((done["applied"][0]["moved_most_m"].as_f64().unwrap() - 0.67).abs() < 0.15, "{done}");
    let entry = |id: u32| MapStore::open(&map).unwrap().entry(id).unwrap().t_map_submap;
    assert!((entry(last.id).translation.vector - root - nalgebra::Vector3::new(0.0, 0.6, 0.3)).norm() < 5e-3);
    // The first scan stays, and those between share what is between.
    let now = corrected(&map);
    assert!(now[&0].translation_distance(&before[&0]) < 5e-3);
    let steps = now.values().zip(now.values().skip(1)).zip(before.values().zip(before.values().skip(1)));
    let largest = steps.map(|((a, b), (c, d))| a.inv_mul(b).translation_distance(&c.inv_mul(d))).fold(0.0, f64::max);
    assert!(largest < 0.12, "{largest}");
    // Its height alone, and upright.
    apply(&format!("[[edit]]\nkind = \"pin\"\nsubmap = {}\nheight = 1.0\nupright = true\n", last.id));
    let pose = entry(last.id);
    assert!((pose.translation.z - 1.0).abs() < 5e-3 && (pose.translation.y - root.y - 0.6).abs() < 5e-3, "{pose}");
    assert!((pose.rotation * nalgebra::Vector3::z()).angle(&nalgebra::Vector3::z()) < 2e-3);
    // The first submap of all: it turns, and the map as a whole with it.
    works(at, "edit room.vox --undo all");
    let up = before[&0].rotation * nalgebra::Vector3::z();
    assert!(up.angle(&nalgebra::Vector3::z()) > 0.01);
    apply("[[edit]]\nkind = \"pin\"\nsubmap = 0\nupright = true\n");
    let now = corrected(&map);
    let change = now[&0] * before[&0].inverse();
    let rigid = before.iter().map(|(node, pose)| (change * pose).translation_distance(&now[node])).fold(0.0, f64::max);
    assert!((now[&0].rotation * nalgebra::Vector3::z()).angle(&nalgebra::Vector3::z()) < 2e-3 && rigid < 5e-3, "{rigid}");
    let pose = before[&5];
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    apply(&format!("[[edit]]\nkind = \"pin\"\nscan = 5\npose = [{}, {}, {}, {}, {}, {}, {}]\n", p.x + 0.1, p.y, p.z, q.x, q.y, q.z, q.w));
    let now = corrected(&map)[&5];
    assert!(now.translation_distance(&(Pose::translation(0.1, 0.0, 0.0) * pose)) < 5e-3 && now.rotation_distance(&pose) < 2e-3);
}

#[test]
fn a_session_is_aligned_as_a_whole() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    works(at, "map room --into room.vox --align 0.3,0,0");
    let (before, first) = (files(&map), corrected(&map));
    let session = MapStore::open(&map).unwrap().manifest().sessions[1].clone();
    let frame = session.t_map_session.unwrap().0;
    let moved = Pose::new(nalgebra::Vector3::new(0.5, -0.25, 0.1), nalgebra::Vector3::new(0.0, 0.0, 0.2)) * frame;
    let (p, q) = (moved.translation.vector, moved.rotation.coords);
    let pose = [p.x, p.y, p.z, q.x, q.y, q.z, q.w];
    for name in ["2".to_owned(), format!("{:?}", session.input.unwrap())] {
        // The second has the name of the first, too, as both are of the same data.
        fs::write(at.join("edits.toml"), format!("[[edit]]\nkind = \"align-session\"\nsession = {name}\npose = {pose:?}\n")).unwrap();
        if name != "2" {
            fails(at, "edit room.vox --apply edits.toml", 1, &["more than one", "by its number"]);
            continue;
        }
        works(at, "edit room.vox --apply edits.toml");
        let change = moved * frame.inverse();
        for (node, pose) in corrected(&map) {
            let expected = if node < session.node_offset { first[&node] } else { change * first[&node] };
            assert!(pose.translation_distance(&expected) < 1e-9, "{node}");
        }
        let now = MapStore::open(&map).unwrap().manifest().sessions[1].t_map_session.unwrap().0;
        assert!(now.translation_distance(&moved) < 1e-12);
        // What holds the session to the first is what it is now: nothing springs back.
        let held = corrected(&map);
        fs::write(at.join("pin.toml"), "[[edit]]\nkind = \"pin\"\nscan = 0\nheight = 1.2\n").unwrap();
        works(at, "edit room.vox --apply pin.toml");
        let most = corrected(&map).iter().map(|(node, pose)| pose.translation_distance(&held[node])).fold(0.0, f64::max);
        assert!(most < 2e-3, "{most}");
        works(at, "edit room.vox --undo 2");
        assert_same(&map, &before, "undone");
    }
}

/// The example of the guide, as it is there.
#[test]
fn the_example_of_the_guide_works() {
    let dir = tempfile::tempdir().unwrap();
    let (at, page) = (dir.path(), include_str!("../../../../../../docs/src/guide/editing.md"));
    let block = |language: &str, with: &str| {
        let blocks = page.split("```").filter_map(|block| block.strip_prefix(language));
        blocks.filter(|block| block.contains(with)).map(str::to_owned).next().unwrap()
    };
    fs::write(at.join("edits.toml"), block("toml\n", "[[edit]]")).unwrap();
    let mut before = None;
    let (commands, mut edited) = (block("sh\n", "simulate room"), 0);
    for command in commands.lines().filter_map(|line| line.strip_prefix("voxelastic ")) {
        before = before.or_else(|| command.starts_with("edit").then(|| files(&at.join("room.vox"))));
        let out = works(at, command);
        if command.ends_with("--list") {
            edited += out.matches("[[edit]]").count();
            assert!(out.contains("measured again in May"), "{out}");
        }
    }
    assert_eq!(edited, 4);
    assert_same(&at.join("room.vox"), &before.unwrap(), "all undone");
    // Every kind and every key of the tables is one that is read.
    fs::write(at.join("wrong.toml"), "[[edit]]\nkind = \"none\"\n").unwrap();
    let kinds = fails(at, "edit room.vox --apply wrong.toml", 2, &["it makes"]).err;
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `")).filter_map(|row| row.split('`').next());
    let listed: Vec<&str> = rows.filter(|kind| !["box", "sphere", "prism"].contains(kind)).collect();
    assert_eq!(listed.len(), 10);
    assert!(listed.iter().all(|kind| kinds.contains(kind)), "{listed:?} {kinds}");
}

#[test]
fn what_is_no_edit_is_refused_by_line_and_key() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    small_map(at, "room.vox");
    let before = files(&at.join("room.vox"));
    let wrong = [
        ("[[edit]]\nkind = \"storey\"\n", 2, vec!["line 2", "`kind`", "storey", "remove-closure"]),
        ("\n[[edit]]\n", 2, vec!["line 2", "`kind`", "needs it"]),
        ("[[edit]]\nkind = \"erase\"\n", 2, vec!["line 1", "box", "sphere", "prism"]),
        ("[[edit]]\nkind = \"erase\"\nsphere = { centre = [0, 1], radius = 1 }\n", 2, vec!["line 3", "`centre`", "2 numbers", "3"]),
        ("[[edit]]\nkind = \"erase\"\nsphere = { centre = [0, 1, 2], radius = -1 }\n", 2, vec!["line 3", "`radius` must be above 0"]),
        ("[[edit]]\nkind = \"erase\"\nsphere = { centre = [0, 1, 2], radius = 1, colour = 3 }\n", 2, vec!["line 3", "`colour`", "not known"]),
        ("[[edit]]\nkind = \"crop\"\nbox = { min = [0, 0, 0], max = [1, 0, 1] }\n", 2, vec!["line 3", "`box`", "below"]),
        ("[[edit]]\nkind = \"note\"\ntext = 3\n", 2, vec!["line 3", "`text`"]),
        ("[[edit]]\nkind = \"pin\"\nsubmap = 0\n", 2, vec!["line 1", "how it is held"]),
        ("[[edit]]\nkind = \"pin\"\nsubmap = 0\npose = [0, 0, 0, 0, 0, 0, 2]\n", 2, vec!["line 4", "`pose`", "norm"]),
        ("[[edit]]\nkind = \"closure\"\nscans = [3, 3]\n", 2, vec!["line 3", "`scans`", "differ"]),
        ("[[edit]\nkind = 3\n", 2, vec!["line 1"]),
        ("[[edits]]\nkind = \"note\"\ntext = \"a\"\n", 2, vec!["line 1", "`edits`"]),
        ("[[edit]]\nkind = \"pin\"\nsubmap = 77\nheight = 1\n", 1, vec!["line 1", "no submap 77", "nothing was changed"]),
        ("[[edit]]\nkind = \"remove-closure\"\nscans = [1, 9]\n", 1, vec!["no closure", "has none"]),
        ("[[edit]]\nkind = \"align-session\"\nsession = 1\npose = [0, 0, 0, 0]\n", 1, vec!["one session only"]),
        ("[[edit]]\nkind = \"erase\"\nsphere = { centre = [500, 0, 0], radius = 1 }\n", 1, vec!["nothing of the map would be erased"]),
        ("[[edit]]\nkind = \"closure\"\nscans = [0, 1]\n", 1, vec!["rigid"]),
    ];
    for (text, code, words) in wrong {
        fs::write(at.join("wrong.toml"), text).unwrap();
        let done = fails(at, "edit room.vox --apply wrong.toml", code, &words);
        assert!(done.err.contains("wrong.toml") && done.err.contains("remedy") || code == 1, "{}", done.err);
        assert_same(&at.join("room.vox"), &before, text);
    }
    // What was done before one that is refused stays, and is said.
    fs::write(at.join("wrong.toml"), "[[edit]]\nkind = \"note\"\ntext = \"kept\"\n[[edit]]\nkind = \"pin\"\nscan = 999\nheight = 1\n").unwrap();
    fails(at, "edit room.vox --apply wrong.toml", 1, &["line 4", "edit 2 (pin)", "no scan 999", "--undo 1"]);
    fails(at, "edit room.vox --apply room.vox/edits.toml", 2, &["its own list"]);
    works(at, "edit room.vox --undo 1");
    assert_same(&at.join("room.vox"), &before, "undone");
    // Without what odometry and loops measured, a pin would bend the map in another way: that is not passed over.
    let log = at.join("room.vox/run.json");
    fs::write(&log, "{\"scans\": [").unwrap();
    fs::write(at.join("pin.toml"), "[[edit]]\nkind = \"pin\"\nscan = 1\nheight = 1\n").unwrap();
    for command in ["edit room.vox --apply pin.toml", "edit room.vox --list"] {
        fails(at, command, 1, &["run.json", "the log of the run is damaged", "remedy", "backup"]);
    }
    fs::remove_file(&log).unwrap();
    works(at, "edit room.vox --apply pin.toml");
}
