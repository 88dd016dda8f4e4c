//! Maps whose surfaces correct their poses.

use super::sessions::{copy, files};
use crate::{fails, json, run, works};
use std::path::Path;

const COARSE: &str = "--voxel-size 0.2 --max-range 30 --field tsdf";

/// Root mean square error of the positions of a map's scans after the best alignment, metres.
fn error(dir: &Path, map: &str) -> f64 {
    let found = json(dir, &format!("eval {map} --truth street --field tsdf --max-points 2000 --json"));
    found["trajectory"]["ate"]["translation_m"]["rmse"].as_f64().unwrap()
}

#[test]
fn surfaces_correct_the_poses_of_a_map() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    works(at, "simulate street -o street --laps 1.3 --spacing 4 --columns 256");
    works(at, &format!("map street -o map.vox --optimize {COARSE}"));
    let before = error(at, "map.vox");

    let whole = files(&at.join("map.vox"));
    let tried = json(at, "refine map.vox street --dry-run --json");
    assert!(tried["refined"] == true && tried["output"].is_null() && tried["submaps_rebuilt"] == 0, "{tried}");
    assert_eq!(files(&at.join("map.vox")), whole, "nothing is written");

    let found = json(at, "refine map.vox street -o refined.vox --threads 1 --json");
    assert_eq!(files(&at.join("map.vox")), whole, "with --output the map stays");
    assert!(
        found["submaps_rebuilt"].as_u64() > Some(0) && found["scans"] == tried["scans"] && found["warnings"].as_array().unwrap().is_empty(),
        "{found}"
    );
    for key in ["thickness_m", "distance_m", "score"] {
        assert!(found["after"][key].as_f64() < found["before"][key].as_f64(), "{key}: {found}");
    }
    let after = error(at, "refined.vox");
    // Between closures the drive drifts by decimetres that surfaces cannot tell: these stay, within some per cent.
    println!("poses: {before:.3} m before, {after:.3} m after");
    assert!(after < 1.05 * before, "{before} {after}");

    // In place, with other threads: the same map.
    copy(&at.join("map.vox"), &at.join("same.vox"));
    works(at, "refine same.vox street --threads 2");
    let (same, other) = (files(&at.join("same.vox")), files(&at.join("refined.vox")));
    let submaps =
        |files: &std::collections::BTreeMap<String, Vec<u8>>| files.values().filter(|bytes| bytes.len() > 10_000).cloned().collect::<Vec<_>>();
    assert_eq!(submaps(&same), submaps(&other));
}

#[test]
fn what_cannot_be_refined_is_said_and_left_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    works(at, "simulate room -o room --scans 6 --columns 128");
    works(at, "map room -o room.vox --poses groundtruth --voxel-size 0.1 --field tsdf --max-scans 1");
    let whole = files(&at.join("room.vox"));
    let one = run(at, "refine room.vox room --json");
    assert!(one.code == Some(0) && one.err.contains("no plane is seen by two"), "{:?} {}", one.code, one.err);
    assert!(one.out.contains("\"not-refined\"") && one.out.contains("\"refined\":false"), "{}", one.out);
    assert_eq!(files(&at.join("room.vox")), whole);

    works(at, "map room -o all.vox --poses groundtruth --voxel-size 0.1 --field tsdf");
    works(at, "simulate room -o fewer --scans 3 --columns 128");
    fails(at, "refine all.vox fewer --poses groundtruth", 1, &["scan 3 of the map", "the data that the map was made of"]);
    fails(at, "refine all.vox room --dry-run -o x.vox", 2, &["--dry-run"]);
    fails(at, "refine nothing.vox room", 1, &["nothing.vox"]);
}
