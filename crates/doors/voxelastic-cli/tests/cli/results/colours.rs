//! Colours and intensities, from scans through a map to meshes and clouds as other software reads them.

use crate::{fails, json, room, works};
use voxelastic_io::{clouds, pcd, ply};

/// The colour at a place of the room.
fn colour_at(p: [f64; 3]) -> [u8; 3] {
    p.map(|c| (128.0 + 110.0 * (0.4 * c).sin()) as u8)
}

/// A map of the room, scanned with colours.
fn mapped() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(dir.path().join("room/scans")).unwrap();
    for i in 0..12 {
        let pose = room::pose(i);
        let mut scan = room::scan(&pose);
        let place = |p: &[f32; 3]| (pose * nalgebra::Point3::from(p.map(f64::from))).coords.into();
        scan.colours = Some(scan.points.iter().map(|p| colour_at(place(p))).collect());
        pcd::write(dir.path().join(format!("room/scans/{i:06}.pcd")), &scan).unwrap();
    }
    room::write_poses(&dir.path().join("room"), 12);
    works(dir.path(), "map room -o room.vox --voxel-size 0.1 --max-range 20");
    dir
}

#[test]
fn meshes_and_clouds_have_the_colours_of_the_scans() {
    let dir = mapped();
    let path = |name: &str| dir.path().join(name);
    works(dir.path(), "mesh room.vox -o room.ply --keep-all");
    let mesh = ply::read_mesh(path("room.ply")).unwrap();
    let colours = mesh.colours.unwrap();
    let right = |(p, colour): &(&[f32; 3], &[u8; 3])| colour_at(p.map(f64::from)).iter().zip(*colour).all(|(a, b)| a.abs_diff(*b) < 20);
    let good = mesh.positions.iter().zip(&colours).filter(right).count();
    assert!(good * 100 > 98 * colours.len() && colours.len() > 2000, "{good} of {}", colours.len());
    assert_eq!(mesh.intensity.map(|i| i.len()), Some(colours.len()));
    works(dir.path(), "mesh room.vox -o height.ply --colour height");
    assert_ne!(ply::read_mesh(path("height.ply")).unwrap().colours.unwrap(), colours, "coloured by height");
    works(dir.path(), "render room.vox -o room.png --size 320x240");
    for name in ["cloud.ply", "cloud.pcd", "cloud.las", "cloud.laz", "cloud.e57"] {
        let summary = json(dir.path(), &format!("export room.vox -o {name} --keep-all --json"));
        assert_eq!(
            (summary["points"].as_u64(), &summary["colours"], &summary["intensity"]),
            (Some(colours.len() as u64), &true.into(), &true.into()),
            "{name}"
        );
        let cloud = clouds::read(path(name)).unwrap().cloud;
        assert_eq!(cloud.colours.as_ref(), Some(&colours), "{name}");
        let off = cloud.points.iter().zip(&mesh.positions).flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs())).fold(0.0, f32::max);
        assert!(off < 1e-4 && cloud.intensity.is_some_and(|i| i.iter().any(|v| *v > 0.0)), "{name}: {off} m");
    }
    let thin = json(dir.path(), "export room.vox -o thin.pcd --lod 2 --json");
    assert!(thin["points"].as_u64().unwrap() * 4 < colours.len() as u64, "{thin}");
    fails(dir.path(), "export room.vox -o cloud.ply --voxel-size 0.2", 2, &["--voxel-size is for OctoMaps", "--lod"]);
    read_by_others(dir.path(), &colours);
}

#[test]
fn colours_of_scans_without_colours_are_an_error() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 4);
    works(dir.path(), "map room -o room.vox --voxel-size 0.2 --max-range 20");
    fails(dir.path(), "mesh room.vox -o room.ply --colour scans", 1, &["no colours", "--colour"]);
    let summary = json(dir.path(), "export room.vox -o room.laz --json");
    assert!(summary["colours"] == false && summary["intensity"] == true, "{summary}");
    assert!(clouds::read(dir.path().join("room.laz")).unwrap().cloud.colours.is_none());
}

/// Begins each script: prints the number of points of a file and the sum of their colours.
const BEGIN: &str = r#"
import sys
import numpy as np
folder = sys.argv[1]
def say(name, points, colours):
    print(name, len(points), int(np.asarray(colours).round().astype(np.int64).sum()))
"#;

/// What each library reads in the exported files: the modules, and the script. Of formats with normals, points with a unit normal count.
const READERS: [(&str, &str); 3] = [
    (
        "numpy, open3d",
        r#"
import open3d as o3d
for name in ("cloud.ply", "cloud.pcd"):
    cloud = o3d.io.read_point_cloud(f"{folder}/{name}")
    unit = np.abs(np.linalg.norm(np.asarray(cloud.normals), axis=1) - 1) < 1e-3
    say(name, np.asarray(cloud.points)[unit], np.asarray(cloud.colors) * 255)
"#,
    ),
    (
        "numpy, laspy, lazrs",
        r#"
import laspy
for name in ("cloud.las", "cloud.laz"):
    cloud = laspy.read(f"{folder}/{name}")
    say(name, cloud.x, np.stack([cloud.red, cloud.green, cloud.blue]) // 257)
"#,
    ),
    (
        "numpy, pye57",
        r#"
import pye57
file = pye57.E57(f"{folder}/cloud.e57")
scans = [file.read_scan(k, intensity=True, colors=True, ignore_missing_fields=True) for k in range(file.scan_count)]
points = np.concatenate([s["cartesianX"] for s in scans])
say("cloud.e57", points, np.concatenate([s[c] for s in scans for c in ("colorRed", "colorGreen", "colorBlue")]))
"#,
    ),
];

/// Compares the exported files with what Open3D, laspy and pye57 read in them.
fn read_by_others(folder: &std::path::Path, colours: &[[u8; 3]]) {
    let sum: u64 = colours.iter().flatten().map(|c| u64::from(*c)).sum();
    for (modules, script) in READERS {
        let Some(text) = voxelastic_testing::run_python(modules, &[BEGIN, script].concat(), &[folder]) else { continue };
        assert!(!text.is_empty(), "{modules}");
        for line in text.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            assert_eq!(words[1..], [colours.len().to_string(), sum.to_string()], "{line}");
        }
    }
}
