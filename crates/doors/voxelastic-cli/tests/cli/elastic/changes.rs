//! What `voxelastic changes` lists between two maps and between sessions.

use crate::{fails, json, works};
use serde_json::Value;
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::sensor::BeamModel;
use voxelastic_io::{pcd, ply, poses};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};

/// A yard of 20 x 12 m, with a pillar or a chest in it.
fn yard(has_pillar: bool) -> World {
    let mut builder = WorldBuilder::new("yard", 1);
    builder.ground(0.0, 0.4);
    builder.cuboid([-10.2, -6.2, 0.0], [10.2, -6.0, 3.0], 0.5);
    builder.cuboid([-10.2, 6.0, 0.0], [10.2, 6.2, 3.0], 0.5);
    builder.cuboid([-10.2, -6.0, 0.0], [-10.0, 6.0, 3.0], 0.5);
    builder.cuboid([-4.0, -4.4, 0.0], [-3.0, -3.6, 1.4], 0.5);
    if has_pillar {
        builder.cuboid([2.0, -3.0, 0.0], [2.6, -2.4, 2.2], 0.5);
    } else {
        builder.cuboid([-2.0, 2.0, 0.0], [-0.8, 3.0, 1.2], 0.5);
    }
    builder.build().unwrap()
}

/// Eight scans of the yard along x, as a folder; poses count from `origin`.
fn write_scans(dir: &Path, name: &str, world: &World, origin: [f64; 3]) {
    let lidar = Lidar::new(BeamModel::even(64, 1024, 0.39, -0.39).unwrap(), LidarSettings::default()).unwrap();
    fs::create_dir_all(dir.join(name).join("scans")).unwrap();
    let mut all = Vec::new();
    for node in 0..8u32 {
        let x = 1.5 * f64::from(node) - 5.25;
        let cloud = lidar.scan(world, |_| Pose::translation(x, 0.0, 1.5), &Stream::new(5, &[u64::from(node)]));
        pcd::write(dir.join(format!("{name}/scans/{node:06}.pcd")), &cloud).unwrap();
        all.push((f64::from(node), Pose::translation(origin[0] + x, origin[1], origin[2] + 1.5)));
    }
    poses::write_tum(dir.join(name).join("poses.tum"), &all).unwrap();
}

/// Fails unless one thing appeared, the chest, and one vanished, the pillar.
fn assert_found(found: &Value, origin: [f64; 3]) {
    for (key, centre) in [("appeared", [-1.4, 2.5]), ("vanished", [2.3, -2.7])] {
        let list = found[key].as_array().unwrap();
        assert_eq!(list.len(), 1, "{key}: {list:?}");
        for k in 0..2 {
            let at = list[0]["centre_m"][k].as_f64().unwrap() - origin[k];
            assert!((at - centre[k]).abs() < 0.3, "{key} at {at}, not {}", centre[k]);
        }
        assert!(list[0]["area_m2"].as_f64().unwrap() > 2.0);
    }
    assert!(found["compared_m2"].as_f64().unwrap() > 0.8 * found["newer_m2"].as_f64().unwrap());
}

#[test]
fn changes_between_maps_and_sessions_are_listed_and_drawn() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    write_scans(dir, "monday", &yard(true), [0.0; 3]);
    write_scans(dir, "tuesday", &yard(false), [0.0; 3]);
    for name in ["monday", "tuesday"] {
        works(dir, &format!("map {name} --field both --voxel-size 0.1 -q"));
    }
    let found = json(dir, "changes monday.vox tuesday.vox --json --appeared new.ply --vanished gone.ply --picture changes.png -q");
    assert_found(&found, [0.0; 3]);
    let new = ply::read_mesh(dir.join("new.ply")).unwrap();
    assert_eq!(new.triangles.len() as u64, found["appeared"][0]["triangles"].as_u64().unwrap());
    assert!(new.positions.iter().all(|p| p[0] > -2.4 && p[0] < -0.5 && p[1] > 1.7 && p[1] < 3.3 && p[2] < 1.4));
    assert!(ply::read_mesh(dir.join("gone.ply")).unwrap().positions.iter().all(|p| p[0] > 1.7 && p[0] < 2.9));
    assert!(fs::read(dir.join("changes.png")).unwrap().starts_with(b"\x89PNG"));
    let text = works(dir, "changes monday.vox tuesday.vox -q");
    assert_eq!(text.lines().map(|line| &line[..8]).collect::<Vec<_>>(), ["appeared", "vanished"]);
    // Larger things than there are.
    let none = json(dir, "changes monday.vox tuesday.vox --json --least-area 50 -q");
    assert_eq!([&none["appeared"], &none["vanished"]].map(|list| list.as_array().unwrap().len()), [0, 0]);

    // As sessions of one map.
    fails(dir, "changes monday.vox", 2, &["nothing was there before session 1"]);
    works(dir, "map tuesday --into monday.vox -q");
    let sessions = json(dir, "changes monday.vox --json -q");
    assert_found(&sessions, [0.0; 3]);
    assert_eq!(json(dir, "changes monday.vox --session 2 --json -q")["appeared"], sessions["appeared"]);
    // The map shows what was there last (little was seen of the space above the pillar), and all of it where that is asked for.
    let pillar_in = |mesh: &str| {
        let is_pillar = |p: &&[f32; 3]| p[0] > 1.8 && p[0] < 2.8 && p[1] > -3.2 && p[1] < -2.2 && p[2] > 0.45 && p[2] < 1.9;
        ply::read_mesh(dir.join(mesh)).unwrap().positions.iter().filter(is_pillar).count()
    };
    works(dir, "mesh monday.vox -o newest.ply -q");
    works(dir, "mesh monday.vox -o all.ply --keep-vanished -q");
    assert_eq!(pillar_in("newest.ply"), 0);
    assert!(pillar_in("all.ply") > 100);
    works(dir, "remove monday.vox --session 2 -q");
    works(dir, "mesh monday.vox -o again.ply -q");
    assert!(pillar_in("again.ply") > 100);
    works(dir, "map tuesday --into monday.vox -q");
    fails(dir, "changes monday.vox --session 7", 2, &["there is no session 7"]);
    fails(dir, "changes monday.vox --session 1", 2, &["nothing was there before session 1"]);
}

#[test]
fn maps_with_other_origins_are_compared_and_those_without_free_space_are_refused() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    // Coordinates of a survey. The second map counts from another whole kilometre.
    let origin = [448_498.0, 5_411_000.0, 300.0];
    write_scans(dir, "first", &yard(true), origin);
    write_scans(dir, "second", &yard(false), origin);
    let all = fs::read_to_string(dir.join("second/poses.tum")).unwrap();
    let lines: Vec<&str> = all.lines().collect();
    let start = lines.iter().position(|line| !line.starts_with('#')).unwrap();
    // Scans in the other order begin in the next kilometre.
    let scans = lines.len() - start;
    let turned: Vec<String> = (0..scans)
        .map(|k| {
            let words: Vec<&str> = lines[lines.len() - 1 - k].split(' ').collect();
            format!("{k} {}", words[1..].join(" "))
        })
        .collect();
    fs::write(dir.join("second/poses.tum"), turned.join("\n") + "\n").unwrap();
    (0..scans)
        .for_each(|k| fs::rename(dir.join(format!("second/scans/{k:06}.pcd")), dir.join(format!("second/scans/{}.tmp", scans - 1 - k))).unwrap());
    (0..scans).for_each(|k| fs::rename(dir.join(format!("second/scans/{k}.tmp")), dir.join(format!("second/scans/{k:06}.pcd"))).unwrap());
    for name in ["first", "second"] {
        works(dir, &format!("map {name} --field both --voxel-size 0.1 -q"));
    }
    let origin_of = |map: &str| json(dir, &format!("info {map} --json"))["origin_m"].clone();
    assert_ne!(origin_of("first.vox"), origin_of("second.vox"));
    assert_found(&json(dir, "changes first.vox second.vox --json -q"), origin);

    works(dir, "map first --voxel-size 0.1 -o surfaces.vox -q");
    fails(dir, "changes first.vox surfaces.vox", 1, &["the newer map has no occupancy"]);
    fails(dir, "changes first.vox second.vox --margin 11", 1, &["a margin is 0 to 10 metres"]);
    fails(dir, "changes first.vox missing.vox", 1, &["missing.vox"]);
}

/// Two laps around a house in a yard of 26 x 26 m, 37 scans each, as a folder. During the first a car is parked there, during the second a chest stands elsewhere.
fn write_laps(dir: &Path) {
    let world = |lap: u32| {
        let mut builder = WorldBuilder::new("around", 1);
        builder.ground(0.0, 0.4);
        builder.cuboid([-4.0, -4.0, 0.0], [4.0, 4.0, 3.0], 0.5);
        builder.cuboid([-13.2, -13.2, 0.0], [13.2, -13.0, 3.0], 0.5);
        builder.cuboid([-13.2, 13.0, 0.0], [13.2, 13.2, 3.0], 0.5);
        builder.cuboid([-13.2, -13.0, 0.0], [-13.0, 13.0, 3.0], 0.5);
        builder.cuboid([13.0, -13.0, 0.0], [13.2, 13.0, 3.0], 0.5);
        if lap == 0 {
            builder.cuboid([9.5, -2.0, 0.0], [11.3, 2.0, 1.5], 0.5);
        } else {
            builder.cuboid([-11.5, -3.0, 0.0], [-10.3, -1.8, 1.2], 0.5);
        }
        builder.build().unwrap()
    };
    let (worlds, lidar) = ([world(0), world(1)], Lidar::new(BeamModel::even(64, 1024, 0.39, -0.39).unwrap(), LidarSettings::default()).unwrap());
    fs::create_dir_all(dir.join("laps/scans")).unwrap();
    let mut all = Vec::new();
    for node in 0..74u32 {
        let (way, lap) = (1.6 * f64::from(node), usize::from(node >= 37));
        let (side, along) = ((way / 16.0) as usize % 4, way % 16.0 - 8.0);
        let [x, y] = [[8.0, along], [-along, 8.0], [-8.0, -along], [along, -8.0]][side];
        let cloud = lidar.scan(&worlds[lap], |_| Pose::translation(x, y, 1.5), &Stream::new(5, &[u64::from(node)]));
        pcd::write(dir.join(format!("laps/scans/{node:06}.pcd")), &cloud).unwrap();
        // The second lap lies 11 cm beside the first.
        let [dx, dy] = if lap == 0 { [0.0; 2] } else { [0.09, -0.07] };
        all.push((f64::from(node), Pose::translation(x + dx, y + dy, 1.5)));
    }
    poses::write_tum(dir.join("laps/poses.tum"), &all).unwrap();
}

#[test]
fn changes_between_laps_of_one_run_are_listed_and_drawn() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    write_laps(dir);
    let mapped = "map laps --field both --voxel-size 0.1 --max-range 30 --lambda-odom 12 -q";
    works(dir, &format!("{mapped} --laps apart -o laps.vox"));
    let found = json(dir, "changes laps.vox --json --appeared new.ply --vanished gone.ply --picture changes.png -q");
    for (key, centre) in [("appeared", [-10.9, -2.4]), ("vanished", [10.4, 0.0])] {
        let list = found[key].as_array().unwrap();
        assert_eq!((list.len(), &list[0]["lap"]), (1, &2.into()), "{key}: {list:?}");
        let at = [0, 1].map(|k| list[0]["centre_m"][k].as_f64().unwrap());
        assert!((0..2).all(|k| (at[k] - centre[k]).abs() < 0.6), "{key} at {at:?}");
    }
    assert!(found["widest_margin_m"].as_f64().unwrap() < 0.5);
    assert!(ply::read_mesh(dir.join("gone.ply")).unwrap().positions.iter().all(|p| p[0] > 9.0 && p[1].abs() < 2.5));
    assert!(fs::read(dir.join("changes.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(json(dir, "changes laps.vox --lap 2 --json -q")["vanished"], found["vanished"]);
    let text = works(dir, "changes laps.vox -q");
    assert_eq!(text.lines().map(|line| &line[..18]).collect::<Vec<_>>(), ["appeared  in lap 2", "vanished  in lap 2"]);
    fails(dir, "changes laps.vox --lap 1", 2, &["nothing was there before lap 1"]);
    fails(dir, "changes laps.vox --lap 3", 2, &["it has 2 lap(s)"]);

    // The map shows the last lap, and everything where that is asked for.
    let car_in = |mesh: &str| {
        let is_car = |p: &&[f32; 3]| p[0] > 9.2 && p[0] < 11.6 && p[1].abs() < 2.3 && p[2] > 0.45;
        ply::read_mesh(dir.join(mesh)).unwrap().positions.iter().filter(is_car).count()
    };
    works(dir, "mesh laps.vox -o newest.ply -q");
    works(dir, "mesh laps.vox -o all.ply --keep-vanished -q");
    assert_eq!(car_in("newest.ply"), 0);
    assert!(car_in("all.ply") > 300);

    // In a map of several sessions, those are compared.
    fs::rename(dir.join("laps"), dir.join("again")).unwrap();
    works(dir, "map again --into laps.vox -q");
    fails(dir, "changes laps.vox --lap 2", 2, &["it has 2 sessions"]);

    works(dir, &format!("{} -o fused.vox", mapped.replace("laps", "again")));
    fails(dir, "changes fused.vox --lap 2", 2, &["its laps were not kept apart", "--laps apart"]);
    fails(dir, "changes fused.vox", 2, &["--laps apart"]);
}
