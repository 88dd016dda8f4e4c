//! `report`, `map --report` and the log of the run in the map directory.

use crate::inputs::simulation::ROOM;
use crate::{fails, json, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::geometry::Rigid;

/// The data of a page.
pub fn data(page: &Path) -> serde_json::Value {
    let html = fs::read_to_string(page).unwrap();
    let json = html.split_once("id=\"data\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str(json).unwrap()
}

#[test]
fn a_report_can_be_written_with_the_map_or_later() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    works(dir.path(), "map room --voxel-size 0.1 --field both --report");
    let page = data(&dir.path().join("room.html"));
    assert_eq!(page["run"]["scans"]["wall_ms"].as_array().unwrap().len(), 6);
    assert!(page["run"]["phases_ms"]["tsdf_update"].is_array() && page["run"]["phases_ms"]["occupancy_descend"].is_array());
    assert!(page["distances"].as_array().unwrap().is_empty() && !page["surfaces"][0]["chunks"].as_array().unwrap().is_empty());

    works(dir.path(), "plan room.vox --start -1,-1,1.2 --goal 2,1,1.2 --radius 0.2 --unknown free --samples 200 --time 60 -o path.json");
    let summary = json(dir.path(), "report room.vox --truth room --plan path.json -o later.html --json");
    assert!(summary["has_run"] == true && summary["has_truth"] == true && summary["vertices"].as_u64().unwrap() > 1000, "{summary}");
    let later = data(&dir.path().join("later.html"));
    assert_eq!((&later["run"], &later["nodes"]), (&page["run"], &page["nodes"]));
    assert!(later["surfaces"][0]["has_errors"] == true && later["planned_path"]["start"] == serde_json::json!([-1.0, -1.0, 1.2]));
    assert!(later["planned_path"]["path"].as_array().unwrap().len() >= 2 && later["planned_path"]["tree"].as_array().unwrap().len() > 10);
    assert_eq!(later["distances"].as_array().unwrap().len(), 2);
}

#[test]
fn a_report_shows_one_surface_and_says_what_was_fused() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    let mapped = json(dir.path(), "map room --voxel-size 0.1 --lambda-odom 0.3 --report --json");
    let submaps = mapped["submaps"].as_u64().unwrap();
    assert!(submaps >= 2 && mapped["fused"]["merged"].as_u64().unwrap() > 1000, "{mapped}");
    let summary = json(dir.path(), "report room.vox -o later.html --json");
    let mesh = json(dir.path(), "mesh room.vox -o room.ply --json");
    assert!(summary["fused"] == mapped["fused"] && summary["submaps"] == submaps, "{summary}");
    assert_eq!((&summary["fused"], &summary["left_out"]), (&mesh["fused"], &mesh["left_out"]));
    for page in ["room.html", "later.html"] {
        let page = data(&dir.path().join(page));
        let surfaces = page["surfaces"].as_array().unwrap();
        let triangles =
            |surface: &serde_json::Value| surface["chunks"].as_array().unwrap().iter().map(|chunk| chunk["t"].as_u64().unwrap()).sum::<u64>();
        assert_eq!(surfaces.len() as u64, submaps);
        assert_eq!(surfaces.iter().map(triangles).sum::<u64>(), mesh["triangles"].as_u64().unwrap(), "one surface, not one for each submap");
        assert!(surfaces.iter().filter(|surface| triangles(surface) > 0).count() >= 2, "each moves with its part");
        let table = page["tables"].as_array().unwrap().iter().find(|table| table["title"] == "One surface of several submaps").unwrap();
        assert_eq!(table["rows"][1][1], mesh["fused"]["merged"].to_string());
        assert_eq!(table["rows"][2][1], mesh["fused"]["refused"].to_string());
    }
}

#[test]
fn a_report_has_the_points_that_moved_where_their_submaps_are() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street --traffic 24 --rate 10 --scans 14 --columns 512 --drift 0 -o street");
    let mapped = json(
        dir.path(),
        "map street --poses groundtruth --every scan --voxel-size 0.3 --max-range 30 --dynamic remove --dynamic-points moving.ply --json",
    );
    let summary = json(dir.path(), "report street.vox --json");
    assert!(mapped["moving_points"].as_u64().unwrap() > 400 && summary["moving_points"] == mapped["moving_points"], "{summary} {mapped}");
    let page = data(&dir.path().join("street.html"));
    assert_eq!(page["run"]["moving"]["total"], 0, "they are in the page once");
    let poses: BTreeMap<u64, Pose> = page["surfaces"].as_array().unwrap().iter().map(|s| (s["submap"].as_u64().unwrap(), pose(&s["pose"]))).collect();
    let of_scan = |scan: &serde_json::Value| {
        let t_map_submap = Rigid::from(&poses[&scan["submap"].as_u64().unwrap()]);
        let coordinates: Vec<f32> = serde_json::from_value(scan["coordinates"].clone()).unwrap();
        coordinates.as_chunks::<3>().0.iter().map(|p| t_map_submap.apply(*p)).collect::<Vec<_>>()
    };
    let of_page: Vec<[f32; 3]> = page["moving"].as_array().unwrap().iter().flat_map(of_scan).collect();
    let cloud = fs::read(dir.path().join("moving.ply")).unwrap();
    let header = cloud.windows(11).position(|words| words == b"end_header\n").unwrap() + 11;
    let of_cloud: Vec<[f32; 3]> =
        cloud[header..].as_chunks::<12>().0.iter().map(|p| std::array::from_fn(|k| f32::from_le_bytes(*p[4 * k..].first_chunk().unwrap()))).collect();
    assert_eq!(of_page.len(), of_cloud.len());
    let apart = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
    // Each was rounded to centimetres twice.
    assert!(of_page.iter().zip(&of_cloud).map(apart).all(|apart| apart < 0.02));
}

fn pose(numbers: &serde_json::Value) -> Pose {
    let [x, y, z, qx, qy, qz, qw]: [f64; 7] = serde_json::from_value(numbers.clone()).unwrap();
    Pose::from_parts(nalgebra::Translation3::new(x, y, z), nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(qw, qx, qy, qz)))
}

#[test]
fn a_missing_or_damaged_log_leaves_out_the_charts() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    works(dir.path(), "map room --voxel-size 0.1");
    let log = dir.path().join("room.vox/run.json");
    for text in [Some("{\"format\":99}"), Some("half a l"), None] {
        text.map_or_else(|| fs::remove_file(&log), |t| fs::write(&log, t)).unwrap();
        let summary = json(dir.path(), "report room.vox --json");
        assert!(summary["has_run"] == false && data(&dir.path().join("room.html"))["run"].is_null(), "{summary}");
    }
}

#[test]
fn wrong_arguments_of_reports_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    works(dir.path(), "map room --voxel-size 0.1");
    fails(dir.path(), "report nowhere.vox", 1, &["nowhere.vox"]);
    fails(dir.path(), "report room.vox --truth nowhere", 1, &["nowhere"]);
    fails(dir.path(), "report room.vox --error-max 0.1", 2, &["--truth"]);
    fails(dir.path(), "report room.vox --sensor-period 0", 2, &["above 0"]);
    fs::write(dir.path().join("path.json"), "[1, 2]").unwrap();
    fails(dir.path(), "report room.vox --plan path.json", 1, &["path.json", "not a planned path"]);
    fails(dir.path(), "report room.vox -o nowhere/x.html", 1, &["nowhere/x.html"]);
}

/// `cargo test --release -p voxelastic-cli -- --ignored demo`
#[test]
#[ignore = "takes a minute"]
fn the_demo_shows_that_corrections_help() {
    let dir = tempfile::tempdir().unwrap();
    let summary = json(dir.path(), "demo -o demo --scans 40 --json");
    let mean = |row: usize| summary["rows"][row]["accuracy_mean_m"].as_f64().unwrap();
    assert!(mean(1) < 0.7 * mean(0) && mean(2) < mean(0), "{summary}");
    assert!(summary["loop_closures"].as_u64().unwrap() > 0 && summary["rows"][2]["free_precision"].as_f64().unwrap() > 0.9, "{summary}");
    let again = json(dir.path(), "demo -o again --scans 40 --threads 1 --json");
    assert_eq!(summary["rows"], again["rows"], "the figures depend on the threads");
    assert!(data(&dir.path().join("demo/report.html"))["tables"][0]["rows"].as_array().unwrap().len() == 3);
    for picture in ["campus.png", "closures.png"] {
        assert_eq!(&fs::read(dir.path().join("demo").join(picture)).unwrap()[..8], b"\x89PNG\r\n\x1a\n");
    }
}
