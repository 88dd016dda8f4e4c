//! `eval`: figures that are known beforehand, and bad input that is named.

use crate::inputs::simulation::ROOM;
use crate::{fails, json, voxelastic, works};
use std::path::Path;
use tempfile::TempDir;
use voxelastic_io::mesh_io::{MeshRef, write_ply};

/// A simulated `room` and a map of it with true poses and both fields, `room.vox`.
fn mapped() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} --columns 256 -o room").replace("--columns 128 ", ""));
    works(dir.path(), "map room --poses groundtruth --voxel-size 0.05 --field both");
    dir
}

/// A floor of 8 x 8 m with a wall along y, points every 4 cm.
fn corner(scale: f32, shift: f32) -> Vec<[f32; 3]> {
    let grid = (0..200 * 200).map(|i| ((i % 200) as f32 * 0.04, (i / 200) as f32 * 0.04));
    grid.flat_map(|(a, b)| [[a, b, 0.0], [a, 0.0, 0.4 * b], [0.0, a, 0.2 * b]]).map(|p| p.map(|c| (c + shift) * scale)).collect()
}

fn cloud(dir: &TempDir, name: &str, points: &[[f32; 3]]) {
    write_ply(dir.path().join(name), &MeshRef { positions: points, ..MeshRef::default() }).unwrap();
}

fn number(value: &serde_json::Value, path: &str) -> f64 {
    value.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or_else(|| panic!("no {path} in {value}"))
}

#[test]
fn a_map_with_true_poses_has_small_errors() {
    let dir = mapped();
    let found = json(dir.path(), "eval room.vox --truth room --thresholds 0.05,0.1 --error-ply errors.ply --json");
    assert_eq!((found["truth_kind"].as_str(), found["measured"].as_str()), (Some("world"), Some("vertices")));
    let mean = number(&found, "/surface/accuracy_exact/mean");
    assert!((1e-4..0.012).contains(&mean), "{mean} m");
    assert!(number(&found, "/surface/accuracy/mean") >= mean, "nearest points are no nearer than the surface");
    assert!(number(&found, "/surface/completeness/fraction_under_10cm") > 0.95, "{found}");
    assert_eq!(found["surface"]["f_scores"].as_array().unwrap().len(), 2);
    assert!(number(&found, "/occupancy/free/precision") > 0.999 && number(&found, "/occupancy/free/recall") > 0.9, "{}", found["occupancy"]);
    assert!(number(&found, "/occupancy/occupied/recall") > 0.8, "{}", found["occupancy"]);
    assert!(number(&found, "/trajectory/ate_in_place/translation_m/max") < 1e-6, "{}", found["trajectory"]);
    let errors = voxelastic_io::ply::read_mesh(dir.path().join("errors.ply")).unwrap();
    assert_eq!((errors.positions.len() as f64, errors.colours.is_some()), (number(&found, "/surface/map_points"), true));

    // The mesh as a file, and the world by its file, give the same distances; the world's file names the same world.
    works(dir.path(), "mesh room.vox -o room.ply --keep-all");
    let of_file = json(dir.path(), "eval room.ply --truth room/world.toml --json");
    let unfused = json(dir.path(), "eval room.vox --truth room --unfused --json");
    assert_eq!(of_file["surface"]["accuracy_exact"], unfused["surface"]["accuracy_exact"]);
    assert!(of_file["trajectory"].is_null() && of_file["occupancy"].is_null());
    let voxels = json(dir.path(), "eval room.vox --truth room --field occupancy --json");
    assert_eq!(voxels["measured"].as_str(), Some("voxels"));
    assert!(number(&voxels, "/surface/accuracy_exact/median") < 0.1, "{}", voxels["surface"]["accuracy_exact"]);

    let table = works(dir.path(), "eval room.vox --truth room");
    for word in ["to the truth", "truth to map", "F-score", "free", "occupied", "not aligned", "aligned"] {
        assert!(table.contains(word), "{word} in\n{table}");
    }
    let (one, two) = (works(dir.path(), "eval room.vox --truth room --threads 1"), works(dir.path(), "eval room.vox --truth room --threads 2"));
    assert_eq!(one, two);
    assert_eq!(one, table);
}

#[test]
fn drifting_poses_have_large_errors() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate room -o room --scans 12 --spacing 0.5 --columns 128 --drift 20 --loop-radius 0");
    works(dir.path(), "map room --voxel-size 0.1");
    let found = json(dir.path(), "eval room.vox --truth room --json");
    assert!(number(&found, "/trajectory/ate_in_place/translation_m/max") > 0.05, "{}", found["trajectory"]);
    assert!(number(&found, "/surface/accuracy_exact/mean") > 0.02, "{}", found["surface"]["accuracy_exact"]);
    assert!(found["occupancy"].is_null(), "the map has none");
    // Against the folder without its world, the poses alone are judged.
    std::fs::remove_file(dir.path().join("room/world.toml")).unwrap();
    let poses = json(dir.path(), "eval room.vox --truth room --json");
    assert!(poses["truth_kind"] == "poses" && poses["surface"].is_null() && poses["trajectory"]["ate_in_place"].is_null(), "{poses}");
    assert_eq!(poses["trajectory"]["ate"], found["trajectory"]["ate"]);
}

#[test]
fn true_poses_are_found_by_name_or_by_argument() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate room -o room --scans 8 --spacing 0.5 --columns 64 --drift 10 --loop-radius 0");
    works(dir.path(), "map room --voxel-size 0.2");
    let file = |name: &str| dir.path().join("room").join(name);
    std::fs::remove_file(file("world.toml")).unwrap();
    let by_name = json(dir.path(), "eval room.vox --truth room --json");
    assert!(number(&by_name, "/trajectory/ate/translation_m/rmse") > 1e-3, "{by_name}");

    // Further estimates do not matter; two files of ground truth are ambiguous without --poses; --poses can name any file.
    std::fs::copy(file("poses.tum"), file("slam.tum")).unwrap();
    assert_eq!(json(dir.path(), "eval room.vox --truth room --json")["trajectory"], by_name["trajectory"]);
    let own = json(dir.path(), "eval room.vox --truth room --poses slam --json");
    assert!(number(&own, "/trajectory/ate/translation_m/max") < 1e-6, "{own}");
    std::fs::copy(file("groundtruth.tum"), file("gt.tum")).unwrap();
    fails(dir.path(), "eval room.vox --truth room", 1, &["groundtruth.tum", "gt.tum", "--poses"]);
    assert_eq!(json(dir.path(), "eval room.vox --truth room --poses gt.tum --json")["trajectory"], by_name["trajectory"]);
    ["gt.tum", "groundtruth.tum"].iter().for_each(|f| std::fs::remove_file(file(f)).unwrap());
    fails(dir.path(), "eval room.vox --truth room", 1, &["ground truth", "--poses FILE"]);
    cloud(&dir, "survey.ply", &corner(1.0, 0.0));
    fails(dir.path(), "eval room.vox --truth survey.ply --poses slam", 2, &["survey.ply", "--poses"]);
}

#[test]
fn clouds_are_aligned_by_default() {
    let dir = tempfile::tempdir().unwrap();
    cloud(&dir, "truth.ply", &corner(1.0, 0.0));
    cloud(&dir, "moved.ply", &corner(1.0, 0.1));
    let aligned = json(dir.path(), "eval moved.ply --truth truth.ply --json");
    let lying = json(dir.path(), "eval moved.ply --truth truth.ply --no-align --json");
    assert_eq!(aligned["truth_kind"].as_str(), Some("cloud"));
    assert!(
        number(&aligned, "/surface/completeness/p90") < 0.04 && (number(&aligned, "/surface/alignment/translation/2") + 0.1).abs() < 0.01,
        "{aligned}"
    );
    assert!(lying["surface"]["alignment"].is_null() && number(&lying, "/surface/completeness/mean") > 0.05, "{lying}");
    assert!(works(dir.path(), "eval moved.ply --truth truth.ply").contains("aligned: translation"));

    let square = [[0.0, 0.0, 0.02], [8.0, 0.0, 0.02], [8.0, 8.0, 0.02], [0.0, 8.0, 0.02]];
    let mesh = MeshRef { positions: &square, triangles: &[[0, 1, 2], [0, 2, 3]], ..MeshRef::default() };
    write_ply(dir.path().join("floor.ply"), &mesh).unwrap();
    let floor: Vec<[f32; 3]> = corner(1.0, 0.0).into_iter().filter(|p| p[2] == 0.0).collect();
    cloud(&dir, "floor_points.ply", &floor);
    let to_mesh = json(dir.path(), "eval floor_points.ply --truth floor.ply --no-align --json");
    assert_eq!(to_mesh["truth_kind"].as_str(), Some("mesh"));
    assert!((number(&to_mesh, "/surface/accuracy_exact/mean") - 0.02).abs() < 1e-5, "{to_mesh}");
}

#[test]
fn errors_name_the_input_and_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    cloud(&dir, "map.ply", &corner(1.0, 0.0));
    cloud(&dir, "empty.ply", &[]);
    cloud(&dir, "far.ply", &corner(1.0, 500.0));
    cloud(&dir, "mm.ply", &corner(1000.0, 0.0));
    for align in ["", " --no-align"] {
        fails(dir.path(), &format!("eval map.ply --truth empty.ply{align}"), 1, &["empty.ply"]);
        fails(dir.path(), &format!("eval map.ply --truth far.ply{align}"), 1, &["map.ply", "far.ply", "disjoint", "same map frame"]);
        fails(dir.path(), &format!("eval map.ply --truth mm.ply{align}"), 1, &["mm.ply", "target", "millimetres", "0.001"]);
    }
    fails(dir.path(), "eval map.ply --truth nowhere.ply", 1, &["nowhere.ply"]);
    fails(dir.path(), "eval nowhere.vox --truth map.ply", 1, &["nowhere.vox"]);
    fails(dir.path(), "eval map.ply --truth map.ply --thresholds 0.1,-2", 2, &["metres"]);
    fails(dir.path(), "eval map.ply --truth map.ply --field tsdf", 2, &["map.ply", "not a map"]);
    std::fs::create_dir(dir.path().join("folder")).unwrap();
    fails(dir.path(), "eval map.ply --truth folder", 1, &["folder", "cannot be used as truth"]);
}

#[test]
fn a_missing_field_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    for (field, lacking) in [("tsdf", "occupancy"), ("occupancy", "tsdf")] {
        works(dir.path(), &format!("map room -o {field}.vox --field {field} --voxel-size 0.1"));
        let words = ["has no", lacking, "--field both"];
        fails(dir.path(), &format!("eval {field}.vox --truth room --field {lacking}"), 1, &words);
    }
    fails(dir.path(), "eval tsdf.vox --truth occupancy.vox", 1, &["occupancy.vox", "a map", "voxelastic mesh"]);
    std::fs::remove_file(dir.path().join("room/world.toml")).unwrap();
    fails(dir.path(), "eval tsdf.vox --truth room --error-ply e.ply", 2, &["--error-ply"]);
    damaged_world(dir.path());
}

fn damaged_world(dir: &Path) {
    std::fs::write(dir.join("room/world.toml"), "format = 1\nfingerprint = \"0\"\n[simulation]\nworld = \"room\"\n").unwrap();
    fails(dir, "eval tsdf.vox --truth room", 1, &["world.toml", "has changed"]);
    std::fs::write(dir.join("room/world.toml"), "format = 1\nfingerprint = ").unwrap();
    fails(dir, "eval tsdf.vox --truth room", 1, &["world.toml", "line 2"]);
    assert!(voxelastic(dir).args(["eval", "tsdf.vox"]).output().unwrap().status.code() == Some(2), "--truth is required");
}
