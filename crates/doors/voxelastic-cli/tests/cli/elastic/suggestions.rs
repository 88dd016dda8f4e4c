//! What is least consistent in a map: `voxelastic check MAP` names it, with edits that mend it.

use crate::elastic::edited_maps::{assert_same, broken_street, corrected, files, largest_error, map_street, small_map, submaps_of_a_lap};
use crate::{fails, run, works};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// What is suggested; something is, or nothing, as the exit code says.
fn suggestions(dir: &Path, map: &str) -> Vec<Value> {
    let done = run(dir, &format!("check {map} --json"));
    let found: Value = serde_json::from_str(&done.out).unwrap_or_else(|_| panic!("{}", done.err));
    let all = found["suggestions"].as_array().unwrap().clone();
    assert_eq!(done.code, Some(if all.is_empty() { 0 } else { 3 }));
    all.iter().for_each(|one| println!("{one}"));
    all
}

fn apply(dir: &Path, map: &str, suggestion: &Value) {
    fs::write(dir.join("suggested.toml"), suggestion["edit"].as_str().unwrap()).unwrap();
    works(dir, &format!("edit {map} --apply suggested.toml"));
}

#[test]
fn what_is_suggested_mends_a_broken_street() {
    let dir = tempfile::tempdir().unwrap();
    let (at, (_, truth)) = (dir.path(), broken_street(dir.path(), 0.004));
    let map = at.join("street.vox");
    map_street(at, "street.vox");
    let (before, error) = (files(&map), largest_error(&map, &truth));
    let first = suggestions(at, "street.vox");
    assert_same(&map, &before, "looked at");
    // The wrong closure first: without it, most places agree.
    assert_eq!(serde_json::json!([first[0]["code"], first[0]["scans"]]), serde_json::json!(["closure", [40, 150]]), "{first:?}");
    let agree = |one: &Value| (one["places_agree"][0].as_u64().unwrap(), one["places_agree"][1].as_u64().unwrap());
    assert!(agree(&first[0]).1 > agree(&first[0]).0);
    apply(at, "street.vox", &first[0]);
    // Then the closure that nobody found, of submaps of one lap and the next.
    let second = suggestions(at, "street.vox");
    assert!(second.iter().all(|one| one["code"] != "closure"), "{second:?}");
    let pair = second.iter().find(|one| one["code"] == "pair").unwrap_or_else(|| panic!("{second:?}"));
    assert!(agree(pair).1 > agree(pair).0);
    let [early, late] = submaps_of_a_lap(&map, &truth);
    assert!(pair["submaps"][0].as_u64().unwrap() <= u64::from(early.max(4)) && pair["submaps"][1].as_u64().unwrap() + 4 >= u64::from(late), "{pair}");
    apply(at, "street.vox", pair);
    let after = largest_error(&map, &truth);
    println!("largest error of a pose: {error:.2} m before, {after:.3} m after what was suggested");
    assert!(after < 0.6 * error && after < 0.8, "{error} {after}");
    // As text it is a list of edits; what only words are is behind a #.
    let page = run(at, "check street.vox").out;
    fs::write(at.join("page.toml"), format!("{page}\n[[edit]]\nkind = \"none\"\n")).unwrap();
    fails(at, "edit street.vox --apply page.toml", 2, &["\"none\" is no edit", &format!("line {}", page.lines().count() + 3)]);
    fails(at, "check street.vox -o picture.png", 2, &["a map has no scans"]);
    fails(at, "check street.vox --every 2", 2, &["a map has no scans", "flags about the input"]);
}

#[test]
fn what_leans_is_named_by_its_walls_and_set_upright() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    assert!(suggestions(at, "room.vox").iter().all(|one| one["code"] != "tilt"));
    let before = corrected(&map);
    let angle = 4.0_f64.to_radians();
    fs::write(at.join("edits.toml"), format!("[[edit]]\nkind = \"pin\"\nsubmap = 0\nup = [{}, 0.0, {}]\n", angle.sin(), angle.cos())).unwrap();
    works(at, "edit room.vox --apply edits.toml");
    let found = suggestions(at, "room.vox");
    let tilt = found.iter().find(|one| one["code"] == "tilt").unwrap_or_else(|| panic!("{found:?}"));
    assert!(tilt["text"].as_str().unwrap().contains("4.0 degrees"), "{tilt}");
    apply(at, "room.vox", tilt);
    assert!(suggestions(at, "room.vox").iter().all(|one| one["code"] != "tilt"));
    let up = |node: u64| corrected(&map)[&node].rotation * before[&node].rotation.inverse() * nalgebra::Vector3::z();
    assert!(up(0).angle(&nalgebra::Vector3::z()) < 0.005 && up(20).angle(&nalgebra::Vector3::z()) < 0.005);
}

#[test]
fn submaps_that_are_kept_apart_are_not_joined_or_named() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("street.vox"));
    broken_street(at, 0.004);
    map_street(at, "street.vox");
    let found = suggestions(at, "street.vox");
    let pair = found.iter().find(|one| one["code"] == "pair").unwrap()["submaps"].clone();
    let before = files(&map);
    let text = format!("[[edit]]\nkind = \"keep-apart\"\nsubmaps = {pair}\n");
    fs::write(at.join("apart.toml"), &text).unwrap();
    works(at, "edit street.vox --apply apart.toml");
    assert!(suggestions(at, "street.vox").iter().all(|one| one["code"] != "pair" || one["submaps"] != pair));
    for kind in ["closure", "merge", "keep-apart"] {
        fs::write(at.join("joined.toml"), format!("[[edit]]\nkind = \"{kind}\"\nsubmaps = {pair}\n")).unwrap();
        fails(at, "edit street.vox --apply joined.toml", 1, &["kept apart"]);
    }
    works(at, "edit street.vox --undo 1");
    assert_same(&map, &before, "undone");
}

#[test]
fn a_point_of_a_submap_is_where_it_was_measured() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    let store = || voxelastic_io::store::MapStore::open(&map).unwrap();
    let last = store().manifest().submaps.last().unwrap().clone();
    let point = nalgebra::Point3::from(last.t_map_submap.translation.vector) + nalgebra::Vector3::new(4.0, 2.0, 0.5);
    let wanted = point + nalgebra::Vector3::new(0.2, -0.3, 0.1);
    let edit = format!(
        "[[edit]]\nkind = \"pin\"\nsubmap = {}\nat = [{}, {}, {}]\nposition = [{}, {}, {}]\n",
        last.id, point.x, point.y, point.z, wanted.x, wanted.y, wanted.z
    );
    fs::write(at.join("edits.toml"), edit).unwrap();
    works(at, "edit room.vox --apply edits.toml");
    let now = store().entry(last.id).unwrap().t_map_submap * (last.t_map_submap.inverse() * point);
    assert!((now - wanted).norm() < 5e-3, "{now} {wanted}");
    fs::write(at.join("edits.toml"), format!("[[edit]]\nkind = \"pin\"\nsubmap = {}\nat = [0, 0, 0]\nupright = true\n", last.id)).unwrap();
    fails(at, "edit room.vox --apply edits.toml", 2, &["line 1", "`at`", "`position`"]);
}

#[test]
fn a_map_gets_another_zero_and_follows_pins_there() {
    let dir = tempfile::tempdir().unwrap();
    let (at, map) = (dir.path(), dir.path().join("room.vox"));
    small_map(at, "room.vox");
    works(at, "map room --into room.vox --align 0.3,0,0");
    let (before, poses) = (files(&map), corrected(&map));
    let frame = || {
        let sessions = voxelastic_io::store::MapStore::open(&map).unwrap().manifest().sessions.clone();
        sessions[1].t_map_session.as_ref().unwrap().0.translation.vector
    };
    let first = frame();
    let pin = |node, p: &nalgebra::Vector3<f64>| format!("[[edit]]\nkind = \"pin\"\nscan = {node}\nposition = [{}, {}, {}]\n\n", p.x, p.y, p.z);
    let origin = "[[edit]]\nkind = \"origin\"\nat = [1.5, -2.0, 0.5]\nyaw = 90\n\n";
    let expected = |p: &nalgebra::Vector3<f64>| nalgebra::Vector3::new(p.y + 2.0, 1.5 - p.x, p.z - 0.5);
    let position = |node| &poses[&node].translation.vector;
    fs::write(at.join("edits.toml"), pin(12, position(12)) + origin + &pin(5, &expected(position(5)))).unwrap();
    works(at, "edit room.vox --apply edits.toml");
    // The pins, of before and after, say what is so already: nothing bends.
    for (node, pose) in corrected(&map) {
        assert!((pose.translation.vector - expected(&poses[&node].translation.vector)).norm() < 2e-3, "{node}");
    }
    assert!((frame() - expected(&first)).norm() < 1e-9, "{}", frame());
    works(at, "edit room.vox --undo all");
    assert_same(&map, &before, "undone");
}
