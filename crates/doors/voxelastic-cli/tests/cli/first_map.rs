//! What works.

use crate::{json, room, run, voxelastic, works};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use voxelastic::settings::{Settings, table};

const QUICK: &str = "--voxel-size 0.1 --max-range 20";

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

/// All files of a map, by name, with their content; not the lock, which names the process that wrote last, and not the log of the run.
pub fn content(map: &Path) -> Vec<(String, Vec<u8>)> {
    let files = std::fs::read_dir(map).unwrap().map(Result::unwrap);
    let named = files.map(|e| (e.file_name().into_string().unwrap(), e.path())).filter(|(name, _)| ![".lock", "run.json"].contains(&&**name));
    let mut files: Vec<_> = named.map(|(name, path)| (name, std::fs::read(path).unwrap())).collect();
    files.sort();
    files
}

#[test]
fn a_folder_is_mapped_meshed_rendered_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 20);
    let map = json(dir.path(), &format!("map room --json --hold-out 5 {QUICK} --lambda-odom 2"));
    let expected = "blocks checkpoints closures corrections field file_mb fused fusions groups_apart integrate_cpu_ms integrate_ms interrupted loops map_mb mapping_s \
                    max_range_m moving_points odometry output peak_rss_mb phases_ms scans scans_held_out scans_resumed scans_skipped sensor sensor_layout session submap_moves submaps \
                    submaps_rebuilt threads total_s voxel_m voxels_freed voxels_removed warnings";
    assert_eq!(keys(&map), expected.split_whitespace().collect());
    for spread in ["integrate_ms", "integrate_cpu_ms"] {
        assert_eq!(keys(&map[spread]), BTreeSet::from(["mean", "median", "p95"]));
        assert!(map[spread]["median"].as_f64().unwrap() > 0.0, "{map}");
    }
    assert!(keys(&map["phases_ms"]).is_superset(&BTreeSet::from(["prepare", "tsdf_update"])));
    assert_eq!((map["scans"].as_u64(), map["scans_skipped"].as_u64(), map["scans_held_out"].as_u64()), (Some(16), Some(0), Some(4)));
    assert_eq!((map["field"].as_str(), map["output"].as_str(), map["interrupted"].as_bool()), (Some("tsdf"), Some("room.vox"), Some(false)));
    assert!((1..=4).contains(&map["submaps"].as_u64().unwrap()), "{map}");
    assert!((map["voxel_m"].as_f64().unwrap() - 0.1).abs() < 1e-6);

    let mesh = json(dir.path(), "mesh room.vox -o room.ply --json");
    assert!(mesh["triangles"].as_u64().unwrap() > 5000, "{mesh}");
    assert!(std::fs::read(dir.path().join("room.ply")).unwrap().starts_with(b"ply"));
    let coarse = json(dir.path(), "mesh room.vox -o coarse.glb --lod 1 --colour intensity --json");
    assert!(std::fs::read(dir.path().join("coarse.glb")).unwrap().starts_with(b"glTF"));
    // The walls of this room lie on faces of the coarse cells, so that their vertices fall into cells on either side.
    assert!(coarse["triangles"].as_u64().unwrap() * 5 < 2 * mesh["triangles"].as_u64().unwrap(), "{coarse}");
    let unfused = json(dir.path(), "mesh room.vox -o unfused.ply --unfused --colour submap --json");
    let coarse_unfused = json(dir.path(), "mesh room.vox -o coarse.ply --unfused --lod 1 --json");
    assert!(coarse_unfused["triangles"].as_u64().unwrap() * 3 < unfused["triangles"].as_u64().unwrap(), "{coarse_unfused} {unfused}");
    assert!(unfused["fused"].is_null() && unfused["left_out"].is_null(), "{unfused}");
    let all = json(dir.path(), "mesh room.vox -o all.ply --keep-all --json");
    let left_out = mesh["left_out"]["triangles"].as_u64().unwrap();
    assert_eq!(mesh["triangles"].as_u64().unwrap() + left_out, all["triangles"].as_u64().unwrap(), "{mesh} {all}");
    assert_eq!((keys(&mesh["left_out"]), all["left_out"].is_null()), (BTreeSet::from(["area_m2", "pieces", "triangles"]), true));
    if map["submaps"].as_u64().unwrap() > 1 {
        assert!(mesh["fused"]["merged"].as_u64().unwrap() > 1000, "{mesh}");
        assert!(mesh["triangles"].as_u64().unwrap() < unfused["triangles"].as_u64().unwrap(), "{mesh} {unfused}");
    }
    let parts = json(dir.path(), "mesh room.vox -o parts.ply --separate --colour submap --json");
    assert_eq!(parts["files"].as_array().unwrap().len() as u64, map["submaps"].as_u64().unwrap());

    works(dir.path(), "render room.vox -o top.png --size 320x240 --path");
    works(dir.path(), "render room.ply -o inside.png --size 320x240 --eye 1,0,1.5 --target 8,0,1");
    assert!(["top.png", "inside.png"].iter().all(|f| std::fs::read(dir.path().join(f)).unwrap().starts_with(b"\x89PNG")));

    let held = json(dir.path(), "heldout room.vox room --hold-out 5 --json");
    assert_eq!(held["nodes"].as_array().unwrap().len(), 4);
    let median = held["distances"]["median"].as_f64().unwrap();
    assert!(median < 0.01, "walls are flat and poses exact, so held-out points lie on the mesh: {median} m");
}

#[test]
fn info_describes_maps_folders_and_clouds() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 6);
    let map = json(dir.path(), &format!("map room --json {QUICK}"));
    let info = json(dir.path(), "info room.vox --check --json");
    assert_eq!((info["kind"].as_str(), info["scans"].as_u64(), &info["blocks"]), (Some("map"), Some(6), &map["blocks"]));
    assert_eq!(info["settings"]["voxel_size"].as_str(), Some("0.1"));
    let (low, high) = (&info["bounds_m"]["min"], &info["bounds_m"]["max"]);
    for k in 0..3 {
        assert!((low[k].as_f64().unwrap() - room::MIN[k]).abs() < 2.0 && (high[k].as_f64().unwrap() - room::MAX[k]).abs() < 2.0, "{info}");
    }
    let data = json(dir.path(), "info room --json");
    assert_eq!((data["kind"].as_str(), data["scans"].as_u64()), (Some("dataset"), Some(6)));
    let cloud = json(dir.path(), "info room/scans/000003.pcd --json");
    assert_eq!((cloud["kind"].as_str(), cloud["width"].as_u64(), cloud["height"].as_u64()), (Some("cloud"), Some(240), Some(24)));
    for what in ["room.vox", "room", "room/scans/000003.pcd"] {
        assert!(works(dir.path(), &format!("info {what}")).lines().count() >= 4);
    }
}

#[test]
fn the_map_does_not_depend_on_the_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 8);
    works(dir.path(), &format!("map room -o one.vox --threads 1 {QUICK}"));
    works(dir.path(), &format!("map room -o two.vox --threads 2 {QUICK}"));
    let (one, two) = (content(&dir.path().join("one.vox")), content(&dir.path().join("two.vox")));
    assert!(one.len() >= 2 && one.iter().any(|(name, _)| name.ends_with(".vxs")));
    assert!(one == two, "the files of the two maps differ");
}

#[test]
fn settings_from_a_file_equal_those_from_flags() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 4);
    let toml = works(dir.path(), "config --voxel-size 0.15 --max-range 12 --lambda-odom 0.5 --truncation 2.5");
    std::fs::write(dir.path().join("own.toml"), toml).unwrap();
    works(dir.path(), "map room -o file.vox --config own.toml");
    works(dir.path(), "map room -o flags.vox --voxel-size 0.15 --max-range 12 --lambda-odom 0.5 --truncation 2.5");
    assert!(content(&dir.path().join("file.vox")) == content(&dir.path().join("flags.vox")));
    let both = json(dir.path(), "map room -o both.vox --config own.toml --voxel-size 0.2 --json");
    assert!((both["voxel_m"].as_f64().unwrap() - 0.2).abs() < 1e-6, "flags win");
    assert_eq!(both["max_range_m"].as_f64(), Some(12.0));
}

#[test]
fn help_has_examples_and_all_settings() {
    let dir = tempfile::tempdir().unwrap();
    for command in ["map", "live", "view", "mesh", "info", "render", "heldout", "eval", "simulate", "config"] {
        for flag in ["-h", "--help"] {
            let help = works(dir.path(), &format!("{command} {flag}"));
            assert!(help.contains(&format!("voxelastic {command}")) && help.contains("Examples:"), "{help}");
        }
    }
    let (short, long) = (works(dir.path(), "map -h"), works(dir.path(), "map --help"));
    let toml = works(dir.path(), "config");
    for setting in table() {
        let flag = format!("--{} ", setting.key.replace('_', "-"));
        assert!(long.contains(&flag) && long.contains(&setting.default), "{flag}");
        assert_eq!(short.contains(&flag), ["field", "voxel_size", "max_range"].contains(&setting.key), "{flag} in the short help");
        assert!(toml.contains(&format!("\n{} = ", setting.key)) && toml.contains(&setting.range()));
    }
    assert_eq!(Settings::default().pairs().len(), table().len());
    assert!(works(dir.path(), "--help").contains("Exit codes"));
}

#[test]
fn a_closed_pipe_is_not_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let mut child = voxelastic(dir.path()).arg("config").stdout(std::process::Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[cfg(unix)]
#[test]
fn ctrl_c_saves_a_valid_map_of_the_scans_so_far() {
    use std::io::{BufRead, BufReader};
    const SCANS: usize = 3000;
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("room");
    room::write(&data, 1);
    // Thousands of scans at no cost: all are the same file.
    for i in 1..SCANS {
        std::fs::hard_link(data.join("scans/000000.pcd"), data.join(format!("scans/{i:06}.pcd"))).unwrap();
    }
    room::write_poses(&data, SCANS);

    let arguments = ["map", "room", "--json", "--voxel-size", "0.03"];
    let mut child = voxelastic(dir.path()).args(arguments).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    // The sensor is named when the first scan is in the map.
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.by_ref().any(|line| line.contains("sensor:")));
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT).unwrap();
    let log: String = lines.collect::<Vec<_>>().join("\n");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{log}");
    assert!(log.contains("interrupted") && log.contains("saved"), "{log}");

    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let scans = summary["scans"].as_u64().unwrap();
    assert!(scans >= 1 && scans < SCANS as u64 && summary["interrupted"] == true, "{summary}");
    assert_eq!(json(dir.path(), "info room.vox --check --json")["scans"].as_u64(), Some(scans));
    assert_eq!(run(dir.path(), "mesh room.vox -o room.ply").code, Some(0));
}
