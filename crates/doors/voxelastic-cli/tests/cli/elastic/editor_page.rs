//! The page of `voxelastic edit`, in a browser: a map that is broken on purpose is mended with the pointer and the keys alone.
//!
//! Skipped where neither Chromium nor Chrome is installed.

use crate::elastic::edited_maps::{broken_street, largest_error, map_street, submap_of, submaps_of_a_lap, vertices_near};
use crate::elastic::editor_hand::{Hand, Served, files, pair};
use crate::fails;
use serde_json::json;
use std::time::{Duration, Instant};
use voxelastic_io::store::MapStore;
use voxelastic_testing::Page;

#[test]
fn a_broken_map_is_mended_on_the_page() {
    let dir = tempfile::tempdir().unwrap();
    let (at, (ghost, truth)) = (dir.path(), broken_street(dir.path(), 0.0));
    let map = at.join("street.vox");
    map_street(at, "street.vox");
    let (before, error) = (files(&map), largest_error(&map, &truth));
    assert!(error > 1.0 && vertices_near(at, "street.vox", ghost, 0.8) > 20, "{error}");
    let [first, last] = submaps_of_a_lap(&map, &truth);
    let submaps = MapStore::open(&map).unwrap().manifest().submaps.len();

    let served = Served::start(at, "street.vox");
    // Others look, and change nothing: with another token, in another process, by the command.
    assert!(served.ask("/edit/save", "a-guess-of-the-token").starts_with("HTTP/1.1 401"));
    fails(at, "edit street.vox --undo 1", 1, &["edits or writes this map"]);
    let second = Served::start(at, "street.vox");
    let refused = second.ask("/edit/undo", second.token());
    assert!(refused.contains("there is nothing to do"), "{refused}");
    let refused = second.ask("/edit/save", second.token());
    assert!(refused.starts_with("HTTP/1.1 409") && refused.contains("read-only"), "{refused}");
    drop(second);

    let profile = tempfile::tempdir().unwrap();
    let clock = Instant::now();
    let Some(page) = Page::open(&served.url, profile.path()) else { return };
    let mut hand = Hand(page);
    hand.0.call("Emulation.setDeviceMetricsOverride", &json!({ "width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": false }));
    hand.0.wait("window.voxelastic?.editor.figures !== undefined && voxelastic.editor.figures !== null");
    hand.0.wait(&format!("new Set([...voxelastic.view.tiles.values()].map((tile) => tile.submap)).size === {}", submaps));
    println!("page with {} submaps after {:.1} s", submaps, clock.elapsed().as_secs_f64());
    let clock = Instant::now();

    // A submap is selected and dragged by a handle; the graph follows, and the picture comes soon.
    let middle = submap_of(&map, truth.len() / 3);
    let camera = format!("{{ target: voxelastic.view.submaps.get({middle}).slice(0, 3), distance: 40, yaw: -0.9, pitch: 1.2 }}");
    hand.settle(Some(&camera));
    let place = hand.place_of(middle);
    hand.click_at(place);
    hand.0.wait(&format!("voxelastic.view.gizmo?.submap === {middle} && document.getElementById('which').textContent === 'Submap {middle}'"));
    let handle = "(() => {
        const { view } = voxelastic, { gizmo } = view;
        return view.project(gizmo.pose().slice(0, 3).map((c, k) => c + (k ? 0 : 0.6 * gizmo.length())));
    })()";
    let handle = pair(&hand.0.value(handle));
    let others = "JSON.stringify([...voxelastic.view.serverPoses].map(([id, pose]) => [id, ...pose.slice(0, 3)]))";
    let before_drag: Vec<[f64; 4]> = serde_json::from_str(hand.0.value(others).as_str().unwrap()).unwrap();
    // In three parts, each of which is waited for, however long pictures take on this machine.
    hand.mouse("mousePressed", handle);
    for part in 0..3 {
        for k in 1..=8 {
            hand.mouse("mouseMoved", [handle[0] + 2.0 * f64::from(8 * part + k), handle[1]]);
            std::thread::sleep(Duration::from_millis(40));
        }
        hand.0.wait(&format!("voxelastic.editor.seen.drags.length > {part} && !voxelastic.editor.running && !voxelastic.view.unfinished"));
    }
    hand.mouse("mouseReleased", [handle[0] + 48.0, handle[1]]);
    hand.0.wait("voxelastic.editor.figures.trial?.kind === 'pin' && !voxelastic.editor.running && !voxelastic.view.unfinished");
    let after_drag: Vec<[f64; 4]> = serde_json::from_str(hand.0.value(others).as_str().unwrap()).unwrap();
    let moved = |id: u32| {
        let of = |all: &[[f64; 4]]| *all.iter().find(|row| row[0] == f64::from(id)).unwrap();
        let (a, b) = (of(&before_drag), of(&after_drag));
        (1..4).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
    };
    assert!(moved(middle) > 0.5 && moved(last) > 0.02 && moved(first) < 1e-3, "{} {} {}", moved(middle), moved(last), moved(first));
    let drags = hand.0.value("[...voxelastic.editor.seen.drags].sort((a, b) => a - b)");
    let drags: Vec<f64> = drags.as_array().unwrap().iter().map(|ms| ms.as_f64().unwrap()).collect();
    println!("from drag to picture: {} times, {:.0} ms in the middle, at most {:.0} ms", drags.len(), drags[drags.len() / 2], drags[drags.len() - 1]);
    assert!(drags.len() >= 3);
    hand.key("Escape", 27, false);
    hand.0.wait("voxelastic.editor.figures.trial === null");
    assert!(files(&map) == before, "something is written before it is saved");

    // The most suspicious closure goes.
    assert_eq!(hand.0.value("document.querySelector('#closures [data-scans]').dataset.scans"), "40 150");
    hand.click("#closures [data-scans]");
    hand.accept("remove-closure");

    // Two submaps at the same place are clicked, and lie on each other.
    hand.click("[data-tool=closure]");
    let camera = |id: u32| format!("{{ target: voxelastic.view.submaps.get({id}).slice(0, 3), distance: 60, yaw: -0.9, pitch: 1.2 }}");
    for submap in [first, last] {
        hand.settle(Some(&camera(submap)));
        let place = hand.place_of(submap);
        hand.click_at(place);
        hand.0.wait(&format!("voxelastic.view.selected.includes({submap})"));
    }
    hand.0.wait("voxelastic.editor.figures.trial?.fits?.length === 2");
    println!("{}", hand.0.value("JSON.stringify(voxelastic.editor.figures.trial.fits)").as_str().unwrap());
    hand.accept("closure");

    // The ghost goes in a box that is drawn from above.
    hand.click("[data-tool=box]");
    for (id, height) in [("low", ghost[2] - 0.9), ("high", ghost[2] + 0.9)] {
        hand.0.value(&format!("document.getElementById('{id}').value = {height:.2}"));
    }
    hand.settle(None);
    hand.settle(Some(&format!("{{ target: [{}, {}, {}], distance: 30 }}", ghost[0], ghost[1], ghost[2])));
    let corner = |hand: &mut Hand, side: f64| {
        pair(&hand.0.value(&format!("voxelastic.view.project([{}, {}, {}])", ghost[0] + 0.9 * side, ghost[1] + 0.9 * side, ghost[2])))
    };
    let (from, to) = (corner(&mut hand, -1.0), corner(&mut hand, 1.0));
    hand.mouse("mousePressed", from);
    hand.mouse("mouseMoved", [(from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0]);
    hand.mouse("mouseMoved", to);
    hand.mouse("mouseReleased", to);
    hand.accept("erase");

    // Written when it is saved; undone and done again on the page, and the same bytes then.
    assert!(files(&map) == before, "something is written before it is saved");
    let save = |hand: &mut Hand| {
        hand.key("s", 83, true);
        hand.0.wait("voxelastic.editor.figures.is_saved && document.getElementById('words').textContent === 'saved'");
    };
    save(&mut hand);
    let took = clock.elapsed();
    let (saved, after) = (files(&map), largest_error(&map, &truth));
    println!("largest error of a pose: {error:.2} m before, {after:.3} m after, in {:.1} s on the page", took.as_secs_f64());
    assert!(after <= 0.05, "{after}");
    assert_eq!(vertices_near(at, "street.vox", ghost, 0.8), 0);
    for left in (0..3).rev() {
        hand.key("z", 90, true);
        hand.0.wait(&format!("voxelastic.editor.figures.edits.length === {left}"));
    }
    save(&mut hand);
    assert!(files(&map) == before, "not all is undone");
    for count in 1..=3 {
        hand.key("y", 89, true);
        hand.0.wait(&format!("voxelastic.editor.figures.edits.length === {count}"));
    }
    save(&mut hand);
    assert!(files(&map) == saved, "not all is done again");
}
