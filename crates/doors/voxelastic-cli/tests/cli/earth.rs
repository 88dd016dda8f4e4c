//! Maps on Earth: fixes in, a cloud in the right system at the right place out, by other people's software; and fixes that are not what they seem.

use crate::{fails, json, room, run, works};
use nalgebra::{Point3, Vector3};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic_earth::{Geodetic, LocalPlane};

/// Where the room is: its frame in the plane at the anchor, turned by 130 degrees.
const ANCHOR: Geodetic = Geodetic { latitude: 48.137_154, longitude: 11.576_124, height: 519.3 };

fn t_plane_map() -> Pose {
    Pose::new(Vector3::new(100.0, -50.0, 2.0), Vector3::z() * 130f64.to_radians())
}

const LEVER: [f64; 3] = [0.1, -0.05, 0.2];

/// Places of the antenna, a fix for each scan.
fn fixes(count: usize) -> Vec<(f64, Geodetic)> {
    let plane = LocalPlane::at(ANCHOR);
    let place = |k: usize| plane.to_geodetic(&(t_plane_map() * room::pose(k) * Point3::from(LEVER)).coords);
    (0..count).map(|k| (0.1 * k as f64, place(k))).collect()
}

fn table(dir: &Path, name: &str, fixes: &[(f64, Geodetic)], sigma: f64) {
    let mut text = "time,latitude,longitude,ellipsoidal_height,sigma\n".to_owned();
    for (time, p) in fixes {
        writeln!(text, "{time:.3},{:.11},{:.11},{:.5},{sigma}", p.latitude, p.longitude, p.height).unwrap();
    }
    fs::write(dir.join(name), text).unwrap();
}

fn mapped(count: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), count);
    works(dir.path(), "map room --voxel-size 0.05 -o a.vox");
    dir
}

const LASPY: &str = "
import sys, json, laspy
out = []
for name in sys.argv[1:]:
    file = laspy.read(name)
    crs = file.header.parse_crs()
    out.append([crs.to_epsg(), list(file.header.mins), list(file.header.maxs), len(file.points)])
print(json.dumps(out))
";

#[test]
fn a_map_goes_to_its_place_and_laspy_finds_it_there_in_the_right_system() {
    let dir = mapped(30);
    let dir = dir.path();
    table(dir, "fixes.csv", &fixes(30), 0.01);
    let done = json(
        dir,
        "georeference a.vox --gnss fixes.csv --crs EPSG:25832 --lever 0.1,-0.05,0.2 --check-every 5 --time-offset 0 --trajectory a.geojson --json",
    );
    assert_eq!((done["used"].as_u64(), done["refused"].as_u64(), done["check"].as_u64()), (Some(24), Some(0), Some(6)), "{done}");
    assert!(done["now"]["check"]["max_m"].as_f64().unwrap() < 0.01, "{done}");
    assert_eq!(done["place"]["crs"].as_str(), Some("EPSG:25832"));
    assert!(works(dir, "info a.vox").contains("on Earth") && works(dir, "georeference a.vox --show").contains("EPSG:25832"));
    ["a.las", "a.laz", "a.copc.laz"].iter().for_each(|file| drop(works(dir, &format!("export a.vox -o {file}"))));
    let line: serde_json::Value = serde_json::from_str(&fs::read_to_string(dir.join("a.geojson")).unwrap()).unwrap();
    assert_eq!(line["features"][0]["geometry"]["coordinates"].as_array().unwrap().len(), 30);

    let files = ["a.las", "a.laz", "a.copc.laz"].map(|file| dir.join(file));
    let files: Vec<&Path> = files.iter().map(std::path::PathBuf::as_path).collect();
    let Some(read) = voxelastic_testing::run_python("laspy, lazrs, pyproj", LASPY, &files) else { return };
    let read: serde_json::Value = serde_json::from_str(&read).unwrap();
    // The corners of the room, by the slow way.
    let crs: voxelastic_earth::Crs = "EPSG:25832".parse().unwrap();
    let plane = LocalPlane::at(ANCHOR);
    let corner = |k: usize| {
        let corner: [f64; 3] = std::array::from_fn(|axis| if k >> axis & 1 == 0 { room::MIN[axis] } else { room::MAX[axis] });
        crs.of_geodetic(&plane.to_geodetic(&(t_plane_map() * Point3::from(corner)).coords)).unwrap()
    };
    let corners: Vec<[f64; 3]> = (0..8).map(corner).collect();
    for file in read.as_array().unwrap() {
        assert_eq!(file[0].as_u64(), Some(25832), "{file}");
        assert!(file[3].as_u64().unwrap() > 1000);
        for axis in 0..3 {
            let low = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
            let high = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
            let (min, max) = (file[1][axis].as_f64().unwrap(), file[2][axis].as_f64().unwrap());
            // Corners that scans hardly see are cut, by less than this.
            assert!((min - low).abs() < 0.3 && (max - high).abs() < 0.3, "axis {axis}: {min} to {max} for {low} to {high}");
        }
    }
}

#[test]
fn fixes_that_are_not_what_they_seem_are_refused_with_the_reason() {
    let dir = mapped(30);
    let dir = dir.path();
    let right = fixes(30);
    let with = |change: &dyn Fn(usize, (f64, Geodetic)) -> (f64, Geodetic)| right.iter().enumerate().map(|(k, f)| change(k, *f)).collect::<Vec<_>>();
    let place = |f: &dyn Fn(&Geodetic) -> Geodetic| with(&|_, (time, p)| (time, f(&p)));

    table(dir, "swapped.csv", &place(&|p| Geodetic { latitude: p.longitude, longitude: p.latitude, ..*p }), 0.01);
    fails(dir, "georeference a.vox --gnss swapped.csv --time-offset 0", 1, &["swapped.csv", "swapped"]);
    table(dir, "west.csv", &place(&|p| Geodetic { longitude: -p.longitude, ..*p }), 0.01);
    fails(dir, "georeference a.vox --gnss west.csv --time-offset 0", 1, &["mirrored", "sign"]);
    table(dir, "nowhere.csv", &place(&|p| Geodetic { latitude: 116.0, ..*p }), 0.01);
    fails(dir, "georeference a.vox --gnss nowhere.csv", 1, &["no place on Earth"]);
    let feet: String = (0..30)
        .map(|k| (t_plane_map() * room::pose(k)).translation.vector / 0.3048)
        .enumerate()
        .fold("time,east,north,up,sigma\n".to_owned(), |text, (k, p)| text + &format!("{:.1},{},{},{},0.01\n", 0.1 * k as f64, p.x, p.y, p.z));
    fs::write(dir.join("feet.csv"), feet).unwrap();
    fails(dir, "georeference a.vox --gnss feet.csv --time-offset 0", 1, &["feet"]);
    fails(dir, "georeference a.vox --gnss feet.csv --crs EPSG:2263", 2, &["feet"]);
    fails(dir, "georeference a.vox --gnss feet.csv --crs EPSG:1", 2, &["EPSG:1"]);
    fails(dir, "georeference a.vox --show", 1, &["no place on Earth"]);
    fails(dir, "georeference a.vox --gnss none.csv", 1, &["none.csv"]);

    // Some that are no fixes are left out, which is said.
    let zero = Geodetic { latitude: 0.0, longitude: 0.0, height: 0.0 };
    table(
        dir,
        "zeros.csv",
        &with(&|k, f| {
            if k % 10 == 3 {
                (f.0, zero)
            } else if k == 7 {
                (f.0, Geodetic { height: f64::NAN, ..f.1 })
            } else {
                f
            }
        }),
        0.01,
    );
    let said = json(dir, "georeference a.vox --gnss zeros.csv --lever 0.1,-0.05,0.2 --time-offset 0 --rigid --json");
    assert_eq!(
        (said["used"].as_u64(), said["warnings"][0]["code"].as_str(), said["warnings"][0]["count"].as_u64()),
        (Some(26), Some("fixes-left-out"), Some(2))
    );
    // Of another clock: nothing to compare, and the offset is named.
    table(dir, "gps.csv", &with(&|_, (time, p)| (time + 18.0, p)), 0.01);
    let other = run(dir, "georeference a.vox --gnss gps.csv");
    assert!(
        other.code == Some(1) && other.err.contains("-18") && other.err.contains("GPS time") && other.err.contains("--time-offset auto"),
        "{}",
        other.err
    );
    let found = json(dir, "georeference a.vox --gnss gps.csv --lever 0.1,-0.05,0.2 --time-offset auto --rigid --json");
    assert!((found["time_offset_s"].as_f64().unwrap() + 18.0).abs() < 0.06, "{found}");
}
