//! Slices, exports and surfaces of free and occupied space.
// Tests say when they skip.
#![allow(clippy::print_stdout)]

use crate::{fails, json, room, works};
use std::collections::BTreeSet;
use std::path::Path;
use voxelastic::field::occupancy::{State, Volumes};
use voxelastic_io::store::MapStore;

const QUICK: &str = "--voxel-size 0.1 --max-range 20 --lambda-odom 2 --min-overlap 1";

fn mapped(field: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 12);
    works(dir.path(), &format!("map room --field {field} {QUICK}"));
    dir
}

fn is_png(path: &Path) -> bool {
    std::fs::read(path).unwrap().starts_with(b"\x89PNG")
}

#[test]
fn slices_show_free_space_between_walls() {
    let dir = mapped("occupancy");
    let plan = json(dir.path(), "slice room.vox --z 1.2 -o plan.png --json");
    let (free, occupied, unknown) = (plan["free"].as_f64().unwrap(), plan["occupied"].as_f64().unwrap(), plan["unknown"].as_f64().unwrap());
    assert!(free > 0.3 && occupied > 0.01 && (free + occupied + unknown - 1.0).abs() < 1e-9, "{plan}");
    assert!((plan["pixel_m"].as_f64().unwrap() - 0.1).abs() < 1e-6 && plan["file"] == "plan.png", "{plan}");
    let thick = json(dir.path(), "slice room.vox --z 0.5 --thickness 1.5 -o thick.png --json");
    assert!(thick["occupied"].as_f64().unwrap() >= occupied, "a thick slice has more in it: {thick}");
    let part = json(dir.path(), "slice room.vox --x 2 --bounds -1,-2,0,9,2,2 --pixel 0.05 -o part.png --json");
    assert_eq!((part["width"].as_u64(), part["height"].as_u64()), (Some(80), Some(40)));
    works(dir.path(), "slice room.vox --y -0.5 -o side.png");
    assert!(["plan.png", "thick.png", "part.png", "side.png"].iter().all(|f| is_png(&dir.path().join(f))));
    let info = json(dir.path(), "info room.vox --check --json");
    for k in 0..3 {
        let bound = |end: &str| info["bounds_m"][end][k].as_f64().unwrap();
        assert!((bound("min") - room::MIN[k]).abs() < 2.0 && (bound("max") - room::MAX[k]).abs() < 2.0, "a map without TSDF has bounds: {info}");
    }
    fails(dir.path(), "slice room.vox -o none.png", 2, &["--z"]);
    fails(dir.path(), "slice room.vox --z 1 --x 2 -o none.png", 2, &["cannot be used with"]);
    fails(dir.path(), "slice room.vox --z 1 --bounds 1,2 -o none.png", 2, &["six numbers"]);
    for (surface, least) in [("occupied", 1000), ("free-hull", 1000), ("frontier", 1), ("measured", 1000)] {
        let mesh = json(dir.path(), &format!("mesh room.vox --surface {surface} -o {surface}.ply --json"));
        assert!(mesh["triangles"].as_u64().unwrap() >= least, "{surface}: {mesh}");
    }
}

#[test]
fn info_reports_free_space_by_size_of_cubes() {
    let dir = mapped("occupancy");
    assert!(json(dir.path(), "info room.vox --json")["known_m3"].is_null(), "only with --check");
    let info = json(dir.path(), "info room.vox --check --json");
    let free: Vec<f64> = info["known_m3"]["free_by_edge_log2"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let mut expected = Volumes::default();
    let store = MapStore::open(dir.path().join("room.vox")).unwrap();
    store.manifest().submaps.iter().for_each(|s| expected.add(&store.load_submap(s.id).unwrap().occupancy().volumes()));
    assert_eq!(free.len(), expected.free.len());
    assert!(free.iter().zip(&expected.free).all(|(m3, voxels)| (m3 - *voxels as f64 * 0.001).abs() < 1e-3), "{free:?} {expected:?}");
    assert!(free.iter().sum::<f64>() > 20.0, "{info}");
}

#[test]
fn slices_of_maps_without_occupancy_show_distances() {
    let dir = mapped("tsdf");
    let plan = json(dir.path(), "slice room.vox --z 1.2 -o plan.png --json");
    assert!(is_png(&dir.path().join("plan.png")) && plan.get("free").is_none(), "{plan}");
    fails(dir.path(), "export room.vox -o room.bt", 1, &["no occupancy", "--field occupancy"]);
    fails(dir.path(), "export room.vox -o room.txt", 2, &["room.txt", ".bt, .ot or .yaml"]);
}

#[test]
fn octomap_reads_the_same_states_from_an_exported_map() {
    let dir = mapped("occupancy");
    let bt = json(dir.path(), "export room.vox -o room.bt --json");
    let ot = json(dir.path(), "export room.vox -o room.ot --json --threads 1");
    // Of states alone, leaves are joined.
    assert!(bt["occupied_leaves"].as_u64() <= ot["occupied_leaves"].as_u64());
    assert!(bt["leaves"].as_u64() <= ot["leaves"].as_u64() && bt["voxel_m"] == 0.1, "{bt} {ot}");
    let coarse = json(dir.path(), "export room.vox -o coarse.bt --voxel-size 0.25 --json");
    assert!(coarse["leaves"].as_u64() < bt["leaves"].as_u64(), "{coarse}");
    fails(dir.path(), "export room.vox -o room.bt --voxel-size 0.05", 2, &["the finest voxel of the map is 0.1 m"]);
    let read = [("room.bt", &bt["leaves"]), ("room.ot", &ot["leaves"])].map(|(file, leaves)| {
        let read = octomap_leaves(&dir.path().join(file))?;
        assert_eq!(Some(read.len() as u64), leaves.as_u64(), "{file}");
        compare(&dir.path().join("room.vox"), &read);
        Some(occupied_voxels(&read))
    });
    // The same voxels are occupied, whatever the leaves.
    assert_eq!(read[0], read[1]);
}

/// The smallest voxels of occupied leaves, in tenths of a metre.
fn occupied_voxels(leaves: &[[f64; 5]]) -> BTreeSet<[i64; 3]> {
    let voxels = |&[x, y, z, edge, _]: &[f64; 5]| {
        let n = (edge / 0.1).round() as i64;
        let low = [x, y, z].map(|c| ((c - 0.5 * edge) / 0.1).round() as i64);
        (0..n * n * n).map(move |i| [low[0] + i % n, low[1] + i / n % n, low[2] + i / (n * n)])
    };
    leaves.iter().filter(|leaf| leaf[4] > 0.0).flat_map(voxels).collect()
}

/// x y z of the centre, edge and log-odds of every leaf, as the real OctoMap reads them; none when it is not installed.
fn octomap_leaves(file: &Path) -> Option<Vec<[f64; 5]>> {
    let text = voxelastic_testing::run_python("pyoctomap", include_str!("../../../../../parts/voxelastic-io/src/octomap/leaves.py"), &[file])?;
    let row = |line: &str| line.split_whitespace().map(|n| n.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap();
    Some(text.lines().skip(1).map(row).collect())
}

/// Every free leaf is free here; an occupied one holds the middle of something occupied, so it is not unknown all over.
fn compare(map: &Path, leaves: &[[f64; 5]]) {
    let atlas = MapStore::open(map).unwrap().load_atlas().unwrap();
    assert!(atlas.submaps().len() > 1, "{} submaps", atlas.submaps().len());
    let query = atlas.query().unwrap();
    let (mut free, mut occupied, mut agree) = (0, 0, 0);
    for &[x, y, z, edge, log_odds] in leaves {
        let n = (edge / 0.1).round().max(1.0);
        // The middle of the first voxel of the leaf.
        let p = [x, y, z].map(|c| c - 0.5 * edge + 0.5 * edge / n);
        let state = query.state(p);
        if log_odds > 0.0 {
            occupied += 1;
            agree += usize::from(state == State::Occupied);
        } else {
            free += 1;
            assert_eq!(state, State::Free, "at {p:?}");
        }
    }
    assert!(free > 500 && occupied > 500 && agree * 2 > occupied, "{free} free, {occupied} occupied of which {agree} here");
}
