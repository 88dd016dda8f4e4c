//! The page of `voxelastic edit` by keys alone: suggestions, measures, comparison with the saved map; and its names, roles and contrasts.
//!
//! Skipped where neither Chromium nor Chrome is installed; axe is run where there are packages for Node.js.

use crate::elastic::edited_maps::{broken_street, largest_error, map_street, small_map};
use crate::elastic::editor_hand::{Hand, Served, files, pair};
use serde_json::{Value, json};
use voxelastic_testing::Page;

const THERE: &str = "window.voxelastic?.editor.figures !== undefined && voxelastic.editor.figures !== null";

fn open(served: &Served, profile: &std::path::Path) -> Option<Hand> {
    let mut hand = Hand(Page::open(&served.url, profile)?);
    size(&mut hand, 1280, 800);
    hand.0.wait(THERE);
    Some(hand)
}

fn size(hand: &mut Hand, width: u32, height: u32) {
    let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500 });
    hand.0.call("Emulation.setDeviceMetricsOverride", &metrics);
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
}

#[test]
fn suggestions_are_taken_by_keys_and_compared_with_the_saved_map() {
    let dir = tempfile::tempdir().unwrap();
    let (at, (_, truth)) = (dir.path(), broken_street(dir.path(), 0.0));
    let map = at.join("street.vox");
    map_street(at, "street.vox");
    let before = files(&map);
    let served = Served::start(at, "street.vox");
    let profile = tempfile::tempdir().unwrap();
    let Some(mut hand) = open(&served, profile.path()) else { return };
    let poses = "JSON.stringify([...voxelastic.view.serverPoses])";
    let saved = hand.0.value(poses);

    // The first suggestion is the wrong closure.
    hand.key("n", 78, false);
    hand.accept("remove-closure");
    assert_eq!(hand.0.value("voxelastic.editor.figures.suggestions_are_old"), true);

    // The saved map, and again that with the edits.
    let edited = hand.0.value(poses);
    assert_ne!(saved, edited);
    let changes = hand.0.value("voxelastic.editor.figures.changes.map((change) => change.moved_m)");
    assert!(numbers(&changes).iter().any(|m| *m > 0.5), "{changes}");
    hand.key("v", 86, false);
    hand.0.wait("voxelastic.editor.figures.shows_saved && document.getElementById('saved-map').getAttribute('aria-pressed') === 'true'");
    assert_eq!(hand.0.value(poses), saved);
    hand.key("v", 86, false);
    hand.0.wait("!voxelastic.editor.figures.shows_saved");
    assert_eq!(hand.0.value(poses), edited);
    hand.key("e", 69, false);
    // The first submap is where it was, which is seen from afar.
    hand.0.value("voxelastic.view.reset(true)");
    hand.settle(None);
    let colours = "JSON.stringify([...new Set([...voxelastic.view.surfaces()].map((s) => s.colour.join()))])";
    assert!(hand.0.value(&format!("JSON.parse({colours}).length")).as_u64().unwrap() > 1);
    hand.key("e", 69, false);
    assert!(files(&map) == before, "something is written before it is saved");
    hand.key("s", 83, true);
    hand.0.wait("voxelastic.editor.figures.is_saved && document.getElementById('words').textContent === 'saved'");
    assert!(hand.0.value("voxelastic.editor.figures.changes.length") == 0);
    assert!(largest_error(&map, &truth) <= 0.05);

    // A place over the road, of which the height is known, and two on it.
    hand.key("d", 68, false);
    let eye = truth[60].translation.vector;
    hand.settle(Some(&format!("{{ target: [{}, {}, {}], distance: 25, pitch: 1.2 }}", eye.x, eye.y, eye.z - 1.0)));
    hand.0.value(&format!("voxelastic.editor.measurePoint([{}, {}, {}])", eye.x, eye.y, eye.z));
    let shown = |hand: &mut Hand, name: &str| {
        let row = format!("[...document.querySelectorAll('#measures dt')].find((dt) => dt.textContent === '{name}').nextSibling.textContent");
        hand.0.value(&row).as_str().unwrap().split(' ').next().unwrap().trim_end_matches('°').parse::<f64>().unwrap()
    };
    let height = shown(&mut hand, "Above the ground");
    println!("{height} m above the road, {} m above zero", eye.z);
    assert!((height - eye.z).abs() < 0.1, "{height} {}", eye.z);
    hand.0.value("voxelastic.editor.measure.clear()");
    for shift in [-150.0, 150.0] {
        hand.click_at([640.0 + shift, 470.0]);
    }
    // By the keys, what is under the cross.
    hand.0.value("voxelastic.view.canvas.focus()");
    hand.key("Enter", 13, false);
    let points = hand.0.value("JSON.stringify(voxelastic.editor.measure.points)");
    let points: Vec<[f64; 3]> = serde_json::from_str(points.as_str().unwrap()).unwrap();
    let [a, b, c] = [0, 1, 2].map(|k| nalgebra::Vector3::from(points[k]));
    assert!((shown(&mut hand, "Distance") - (c - b).norm()).abs() < 1e-3);
    assert!((shown(&mut hand, "Length of all") - (c - b).norm() - (b - a).norm()).abs() < 2e-3);
    assert!((shown(&mut hand, "Angle") - (a - b).angle(&(c - b)).to_degrees()).abs() < 0.06);
    assert!((shown(&mut hand, "Area") - (b - a).cross(&(c - a)).norm() / 2.0).abs() < 6e-3);
    assert!(shown(&mut hand, "Above the ground").abs() < 0.1);
    hand.key("Backspace", 8, false);
    assert_eq!(hand.0.value("voxelastic.editor.measure.points.length"), 2);
    assert!(hand.0.value("voxelastic.editor.picture()").as_u64().unwrap() > 20_000);
}

#[test]
fn every_control_has_a_name_is_reached_by_keys_and_can_be_read() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    small_map(at, "room.vox");
    let served = Served::start(at, "room.vox");
    let profile = tempfile::tempdir().unwrap();
    let Some(mut hand) = open(&served, profile.path()) else { return };
    hand.0.value("voxelastic.editor.attempt('kind = \"note\"\\ntext = \"a\"').then(() => true)");
    hand.0.wait("voxelastic.editor.figures.trial !== null");
    // Every control is reached by the tabulator.
    let visible = "[...document.querySelectorAll('button, input, select, canvas')].filter((e) => !e.disabled && e.checkVisibility())";
    hand.0.value(&format!("{visible}.forEach((e, k) => {{ e.dataset.stop = k; }}); document.activeElement.blur()"));
    let count = hand.0.value(&format!("{visible}.length")).as_u64().unwrap();
    let mut reached = std::collections::BTreeSet::new();
    for _ in 0..count + 5 {
        hand.key("Tab", 9, false);
        reached.extend(hand.0.value("document.activeElement.dataset?.stop ?? null").as_str().map(str::to_owned));
    }
    assert!(count > 20 && reached.len() as u64 == count, "{} of {count} controls", reached.len());
    let Some(modules) = voxelastic_testing::node_modules() else { return };
    let axe = std::fs::read_to_string(modules.join("axe-core/axe.min.js")).expect("the packages of .ci/npm are not all there");
    hand.0.value(&format!("{axe}; true"));
    for theme in ["light", "dark"] {
        for (width, height) in [(390, 844), (1280, 800), (2560, 1440)] {
            size(&mut hand, width, height);
            for tool in ["move", "box", "measure"] {
                hand.0.value(&format!("document.documentElement.dataset.theme = '{theme}'; voxelastic.editor.tools.choose('{tool}')"));
                let found = hand.0.value(
                    "axe.run().then(({ violations, passes }) => JSON.stringify([passes.length, ...violations.map((v) => [v.id, v.nodes.map((n) => n.html + n.failureSummary)])]))",
                );
                let found: Vec<Value> = serde_json::from_str(found.as_str().unwrap()).unwrap();
                assert!(found[0].as_u64().unwrap() > 15 && found.len() == 1, "{theme}, {width}, {tool}: {found:?}");
            }
            let wide = hand.0.value("[document.documentElement.scrollWidth, innerWidth]");
            assert!(pair(&wide)[0] <= pair(&wide)[1], "{width}: something is wider than the screen, {wide}");
        }
    }
}
