//! LAS, LAZ and E57: read what laspy and pye57 write, and they read what we write (`VOXELASTIC_PYTHON`, default `python3`).

use crate::common::damage::soak;
use nalgebra::{Translation3, UnitQuaternion};
use std::path::Path;
use std::time::Duration;
use voxelastic::{Cloud, Pose};
use voxelastic_io::survey::{SurveyCloud, copc, e57, las};
use voxelastic_io::{Error, OpenOptions, clouds, dataset};
use voxelastic_testing::run_python;

/// 300 points with intensity and colour.
fn survey(offset: [f64; 3]) -> SurveyCloud {
    let points = (0..300).map(|k| [k as f32 * 0.25, (k as f32).sin(), -0.5 * k as f32 - 1.0]).collect();
    let intensity = Some((0..300).map(|k| (k % 50) as f32).collect());
    let colours = Some((0..300).map(|k| [(k % 256) as u8, 7, 200]).collect());
    SurveyCloud { offset, cloud: Cloud { intensity, colours, ..Cloud::from_points(points) }, crs_wkt: None }
}

fn scans() -> Vec<e57::E57Scan> {
    let pose = |k: f64| Pose::from_parts(Translation3::new(10.0 * k, 1.0, 2.0), UnitQuaternion::from_euler_angles(0.1, 0.0, k));
    let mut survey = survey([0.0; 3]);
    survey.cloud.intensity = Some((0..300).map(|k| k as f32 / 299.0).collect());
    (0..2).map(|k| e57::E57Scan { name: Some(format!("station {k}")), t_map_scan: pose(f64::from(k)), survey: survey.clone() }).collect()
}

fn nearest(a: &[f32; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (f64::from(a[k]) - b[k]).abs()).fold(0.0, f64::max)
}

#[test]
fn what_is_written_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    for (name, offset) in [("a.las", [0.0; 3]), ("a.laz", [0.0; 3]), ("utm.laz", [453_000.0, 5_421_000.0, 0.0])] {
        let path = dir.path().join(name);
        las::write(&path, &survey(offset)).unwrap();
        let read = las::read(&path).unwrap();
        assert_eq!(
            (read.offset, &read.cloud.colours, &read.cloud.intensity),
            (offset, &survey(offset).cloud.colours, &survey(offset).cloud.intensity),
            "{name}"
        );
        for (p, q) in read.cloud.points.iter().zip(&survey(offset).cloud.points) {
            assert!(nearest(p, q.map(f64::from)) < 1e-4, "{name}: {p:?} {q:?}");
        }
        assert_eq!(clouds::read(&path).unwrap().cloud.points, read.cloud.points);
    }
    let path = dir.path().join("a.e57");
    e57::write(&path, &scans()).unwrap();
    let read = e57::read(&path).unwrap();
    assert_eq!(read.len(), 2);
    for (a, b) in read.iter().zip(&scans()) {
        assert_eq!((&a.name, &a.survey), (&b.name, &b.survey));
        assert!(
            (a.t_map_scan.translation.vector - b.t_map_scan.translation.vector).norm() < 1e-12
                && a.t_map_scan.rotation.angle_to(&b.t_map_scan.rotation) < 1e-7
        );
    }
    let all = clouds::read(&path).unwrap().cloud;
    let last = scans()[1].t_map_scan * nalgebra::Point3::from(scans()[1].survey.cloud.points[299].map(f64::from));
    assert!(all.len() == 600 && nearest(&all.points[599], last.coords.into()) < 1e-4);

    let mut wrong = survey([0.0; 3]);
    wrong.cloud.intensity = Some(vec![1.0]);
    assert!(matches!(las::write(dir.path().join("b.las"), &wrong), Err(Error::Unwritable { .. })));
}

const WRITE: &str = r#"
import sys, laspy, pye57, numpy as np
folder = sys.argv[1]
k = np.arange(300)
xyz = np.stack([453000.0 + k * 0.25, 5421000.0 + np.sin(k), -0.5 * k - 1.0], axis=1)
for version, point_format in (("1.2", 1), ("1.2", 3), ("1.4", 6), ("1.4", 7)):
    las = laspy.LasData(laspy.LasHeader(version=version, point_format=point_format))
    las.header.offsets = [450000, 5420000, 0]; las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = xyz.T
    las.intensity = k % 50
    if point_format in (3, 7):
        las.red, las.green, las.blue = (k % 256) * 256, np.full(300, 7 * 256), np.full(300, 200 * 256)
    for extension in ("las", "laz"):
        las.write(f"{folder}/p{point_format}.{extension}")
e57 = pye57.E57(f"{folder}/stations.e57", mode="w")
for station in range(2):
    data = {"cartesianX": k * 0.25, "cartesianY": np.sin(k), "cartesianZ": -0.5 * k - 1.0, "intensity": k / 299.0,
            "colorRed": (k % 256).astype(np.uint8), "colorGreen": np.full(300, 7, np.uint8), "colorBlue": np.full(300, 200, np.uint8)}
    half = station / 2
    e57.write_scan_raw(data, rotation=np.array([np.cos(half), 0, 0, np.sin(half)]), translation=np.array([10.0 * station, 1.0, 2.0]))
e57.close()
"#;

#[test]
fn las_gets_an_offset_where_32_bits_do_not_reach() {
    let dir = tempfile::tempdir().unwrap();
    let points: Vec<[f32; 3]> = (0..50).map(|i| [448_000.0 + i as f32, 5_411_000.0 + 2.0 * i as f32, 3.0]).collect();
    for name in ["utm.las", "utm.laz"] {
        let path = dir.path().join(name);
        las::write(&path, &SurveyCloud { cloud: Cloud::from_points(points.clone()), ..SurveyCloud::default() }).unwrap();
        let read = las::read(&path).unwrap();
        for (there, here) in read.cloud.points.iter().zip(&points) {
            let off = (0..3).map(|k| (f64::from(there[k]) + read.offset[k] - f64::from(here[k])).abs()).fold(0.0, f64::max);
            assert!(off < 1e-3, "{there:?} and {:?} instead of {here:?}", read.offset);
        }
        // Farther apart than 32 bits reach.
        let apart = vec![[0.0; 3], [1.0, 1.0, 1.0], [-4e5, 0.0, 1.0], [4e5, 0.0, 1.0]];
        let error = las::write(&path, &SurveyCloud { cloud: Cloud::from_points(apart), ..SurveyCloud::default() }).unwrap_err();
        assert!(error.to_string().contains("800000 m apart"), "{error}");
    }
}

#[test]
fn files_of_laspy_and_pye57() {
    let dir = tempfile::tempdir().unwrap();
    if run_python("laspy, pye57, numpy", WRITE, &[dir.path()]).is_none() {
        return;
    }
    for format in [1, 3, 6, 7] {
        for extension in ["las", "laz"] {
            let read = las::read(dir.path().join(format!("p{format}.{extension}"))).unwrap();
            assert_eq!((read.offset, read.cloud.len()), ([453_000.0, 5_421_000.0, 0.0], 300));
            for (k, p) in read.cloud.points.iter().enumerate() {
                let k = k as f64;
                assert!(nearest(p, [0.25 * k, k.sin(), -0.5 * k - 1.0]) < 1e-3, "{format} {extension}: {p:?}");
            }
            assert_eq!(read.cloud.intensity.as_ref().unwrap()[123], 23.0);
            assert_eq!(read.cloud.colours.map(|c| c[299]), [3, 7].contains(&format).then_some([43, 7, 200]));
        }
    }
    let stations = e57::read(dir.path().join("stations.e57")).unwrap();
    assert_eq!(stations.len(), 2);
    let dataset = dataset::open(dir.path().join("stations.e57"), &OpenOptions::default()).unwrap();
    for (scan, station) in dataset.scans().iter().zip(&stations) {
        assert_eq!((scan.t_map_lidar, dataset.cloud(scan).unwrap()), (station.t_map_scan, station.survey.cloud.clone()));
    }
    for (k, station) in stations.iter().enumerate() {
        assert!(
            (station.t_map_scan.translation.x - 10.0 * k as f64).abs() < 1e-9
                && (station.t_map_scan.rotation.euler_angles().2 - k as f64).abs() < 1e-9
        );
        let p = station.survey.cloud.points[200];
        assert!(nearest(&p, [50.0, 200f64.sin(), -101.0]) < 1e-4, "{p:?}");
        assert_eq!(station.survey.cloud.colours.as_ref().unwrap()[200], [200, 7, 200]);
        assert!((station.survey.cloud.intensity.as_ref().unwrap()[299] - 1.0).abs() < 1e-4);
    }
}

const READ: &str = r#"
import sys, laspy, pye57, numpy as np
folder = sys.argv[1]
for name in ("ours.las", "ours.laz"):
    las = laspy.read(f"{folder}/{name}")
    print(len(las.points), las.x[299], las.y[299], las.z[299], las.intensity[123], las.red[299] // 257, las.blue[299] // 257)
e57 = pye57.E57(f"{folder}/ours.e57")
scan = e57.read_scan(1, intensity=True, colors=True)
print(e57.scan_count, scan["cartesianX"][299], scan["cartesianY"][299], scan["cartesianZ"][299], scan["intensity"][299], scan["colorRed"][200], scan["colorBlue"][0])
"#;

#[test]
fn files_of_ours_read_by_laspy_and_pye57() {
    let dir = tempfile::tempdir().unwrap();
    las::write(dir.path().join("ours.las"), &survey([453_000.0, 0.0, 0.0])).unwrap();
    las::write(dir.path().join("ours.laz"), &survey([453_000.0, 0.0, 0.0])).unwrap();
    e57::write(dir.path().join("ours.e57"), &scans()).unwrap();
    let Some(said) = run_python("laspy, pye57, numpy", READ, &[dir.path()]) else { return };
    let rows: Vec<Vec<f64>> = said.lines().map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect()).collect();
    let y = f64::from(299f32.sin());
    for row in &rows[..2] {
        let expected = [300.0, 453_074.75, y, -150.5, 23.0, 43.0, 200.0];
        assert!(row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{row:?}");
    }
    let last = scans()[1].t_map_scan * nalgebra::Point3::new(74.75, y, -150.5);
    let expected = [2.0, last.x, last.y, last.z, 1.0, 200.0, 200.0];
    assert!(rows[2].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{:?} {expected:?}", rows[2]);
}

const READ_OCTREE: &str = r#"
import sys, laspy, numpy as np
from laspy import Bounds, CopcReader
path = sys.argv[1]
with CopcReader.open(path) as reader:
    everything, coarse = reader.query(), reader.query(level=0)
    part = reader.query(bounds=Bounds(mins=np.array([452990.0, -60.0, -5.0]), maxs=np.array([453010.0, -20.0, 5.0])))
    print(len(everything), len(coarse), len(part), reader.header.point_format.id, everything.red.max() // 257)
    order = np.lexsort((everything.z, everything.y, everything.x))
    for dimension in ("x", "y", "z", "intensity"):
        print(*np.asarray(everything[dimension], dtype=float)[order])
print(len(laspy.read(path)))
"#;

#[test]
fn laspy_reads_the_octree_of_ours_by_level_and_box() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("deep/ours.copc.laz");
    // More than one node of the octree holds; one point is none.
    let points: Vec<[f32; 3]> = (0..250_001).map(|i| [(i % 500) as f32 * 0.2 - 50.0, (i / 500) as f32 * 0.2 - 50.0, (i % 7) as f32 * 0.1]).collect();
    let mut cloud = Cloud { intensity: Some((0..250_001).map(|i| (i % 999) as f32).collect()), ..Cloud::from_points(points) };
    cloud.colours = Some(vec![[200, 100, 50]; 250_001]);
    cloud.points[77] = [f32::NAN; 3];
    let survey = SurveyCloud { offset: [453_000.0, 0.0, 0.0], cloud, crs_wkt: None };
    copc::write(&path, &survey).unwrap();
    assert_eq!(std::fs::read_dir(dir.path().join("deep")).unwrap().count(), 1, "no litter");
    let Some(said) = run_python("laspy, numpy", READ_OCTREE, &[&path]) else { return };
    let rows: Vec<Vec<f64>> = said.lines().map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect()).collect();
    let inside = |p: &&[f32; 3]| p[0].abs() <= 10.0 && (-60.0..=-20.0).contains(&p[1]);
    let part = survey.cloud.points.iter().filter(inside).count() as f64;
    let counts = &rows[0];
    assert!(counts[0] == 250_000.0 && counts[1] < 150_000.0 && (counts[2] - part).abs() < 200.0 && counts[3..] == [7.0, 200.0], "{counts:?}, {part}");
    let mut expected: Vec<(f64, f64, f64, f64)> = survey
        .cloud
        .points
        .iter()
        .zip(survey.cloud.intensity.as_ref().unwrap())
        .filter(|(p, _)| p[0].is_finite())
        .map(|(p, i)| (f64::from(p[0]) + 453_000.0, f64::from(p[1]), f64::from(p[2]), f64::from(*i)))
        .collect();
    expected.sort_by(|a, b| (a.0, a.1).partial_cmp(&(b.0, b.1)).unwrap());
    for (k, (x, y, z, i)) in expected.iter().enumerate() {
        assert!((rows[1][k] - x).abs() < 1e-3 && (rows[2][k] - y).abs() < 1e-3 && (rows[3][k] - z).abs() < 1e-3 && rows[4][k] == *i, "{k}");
    }
    assert_eq!(rows[5], [250_000.0]);
    let empty = SurveyCloud { cloud: Cloud::from_points(vec![[f32::NAN; 3]]), ..SurveyCloud::default() };
    assert!(matches!(copc::write(dir.path().join("no.copc.laz"), &empty), Err(Error::NoReturn { .. })));
}

#[test]
fn damaged_surveys_are_refused_calmly() {
    let dir = tempfile::tempdir().unwrap();
    las::write(dir.path().join("a.las"), &survey([0.0; 3])).unwrap();
    las::write(dir.path().join("a.laz"), &survey([0.0; 3])).unwrap();
    e57::write(dir.path().join("a.e57"), &scans()).unwrap();
    for name in ["a.las", "a.laz", "a.e57"] {
        let good = std::fs::read(dir.path().join(name)).unwrap();
        let (path, format) = (Path::new(name), clouds::CloudFormat::of(Path::new(name)).unwrap());
        soak(name, &good, 300, Duration::from_secs(5), |bad| clouds::parse(bad, path, format).is_ok());
    }
}

/// Layers of four gigabytes in a file of a kilobyte kept the decoder busy for a minute.
#[test]
fn layers_larger_than_the_file_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    las::write(dir.path().join("a.laz"), &survey([0.0; 3])).unwrap();
    let good = std::fs::read(dir.path().join("a.laz")).unwrap();
    // Points begin where the header says, with the table's place (8), the first point (36: 30 and 6 of colour) and the number of points (4).
    let sizes = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize + 8 + 36 + 4;
    for layer in 0..10 {
        let mut bad = good.clone();
        bad[sizes + 4 * layer..][..4].fill(0xff);
        let refused = las::parse(bad, Path::new("a.laz")).unwrap_err().to_string();
        assert!(refused.contains("layers of 42949"), "{refused}");
    }
    let record = good.windows(14).position(|w| w == b"laszip encoded").unwrap() + 52;
    let refused = |bad: Vec<u8>| las::parse(bad, Path::new("a.laz")).unwrap_err().to_string();
    // Packed by the first LASzip.
    let mut bad = good.clone();
    bad[record..][..2].copy_from_slice(&[1, 0]);
    assert!(refused(bad).contains("unpack it with laszip or PDAL"));
    // Chunks of one point: the second begins where the table of chunks lies.
    let mut bad = [good.as_slice(), &[0xff; 200]].concat();
    bad[record + 12..][..4].copy_from_slice(&1u32.to_le_bytes());
    assert!(refused(bad).contains("layers of"));
    // Points of 32 kB, not packed: more than the file has.
    las::write(dir.path().join("a.las"), &survey([0.0; 3])).unwrap();
    let mut bad = std::fs::read(dir.path().join("a.las")).unwrap();
    bad[105..107].copy_from_slice(&[0, 0x80]);
    assert!(refused(bad).contains("cannot hold more than"));
    // 60,000 bytes of something at each point, for each of which the decoder keeps tables.
    let mut bad = good;
    bad[record + 40..][..4].copy_from_slice(&[14, 0, 0x60, 0xea]);
    assert!(refused(bad).contains("points of 60030 bytes"));
}
