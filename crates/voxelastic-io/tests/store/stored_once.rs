//! Maps in which submaps have blocks of others.

use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::settings::Storage;
use voxelastic::{Cloud, Mapper, Pose, Settings};
use voxelastic_io::store::{MapDetails, MapStore, MapWriter};

const VOXEL: f32 = 0.1;

/// A hall of 24 x 12 x 6 m, seen from `x` metres along it.
fn hall(x: f64) -> Cloud {
    let mut points = Vec::new();
    for row in 0..48 {
        for column in 0..720 {
            let (elevation, azimuth) = ((f64::from(row) - 23.5) * 0.03, f64::from(column) * std::f64::consts::TAU / 720.0);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let along = |side: f64, c: f64| if c.abs() < 1e-9 { f64::INFINITY } else { side / c.abs() };
            let range = along(6.0, d[1]).min(along(3.0, d[2])).min(along(12.0 - x * d[0].signum(), d[0]));
            points.push(d.map(|c| (c * range) as f32));
        }
    }
    Cloud::from_points(points)
}

/// The hall in two submaps.
fn atlas() -> Atlas {
    let settings =
        Settings { voxel_size: VOXEL, lambda_odom: 3.0, lambda_cluster: 0.0, min_overlap: 1.0, storage: Storage::Once, ..Settings::default() };
    let mut mapper = Mapper::new(settings).unwrap();
    for node in 0..6 {
        let x = 1.2 * node as f64 - 3.0;
        mapper.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: hall(x) })).unwrap();
    }
    mapper.into_atlas()
}

fn details() -> MapDetails {
    let settings = [("voxel_size".to_owned(), VOXEL.to_string())].into();
    MapDetails { generator: "test".to_owned(), settings, ..MapDetails::default() }
}

#[test]
fn what_was_handed_over_comes_back_and_is_taken_back_where_poses_were_corrected() {
    let (dir, mut atlas) = (tempfile::tempdir().unwrap(), atlas());
    let count = |atlas: &Atlas| atlas.submaps().iter().flat_map(|submap| submap.handed_over()).map(|record| record.keys.len()).sum::<usize>();
    assert!(atlas.submaps().len() == 2 && count(&atlas) > 500, "{} blocks", count(&atlas));
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details()).unwrap();
    let loaded = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
    let blocks = |atlas: &Atlas| atlas.submaps().iter().map(|submap| submap.tsdf().len()).collect::<Vec<_>>();
    assert_eq!(blocks(&loaded), blocks(&atlas));
    for (a, b) in atlas.submaps().iter().zip(loaded.submaps()) {
        assert_eq!(a.handed_over(), b.handed_over());
    }
    // A map that was loaded is stored as the same files.
    let names = |dir: &std::path::Path| {
        let mut names: Vec<_> = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names(dir.path());
    MapWriter::create(dir.path()).unwrap().save(&loaded, &details()).unwrap();
    assert_eq!(names(dir.path()), before);

    let second = &mut atlas.submaps_mut()[1];
    second.set_pose(Pose::translation(0.0, 0.0, 0.5) * second.t_map_submap());
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details()).unwrap();
    let moved = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
    assert_eq!(count(&moved), 0);
    let (few, many) = (blocks(&atlas).iter().sum::<usize>(), blocks(&moved).iter().sum::<usize>());
    // Where both handed blocks over side by side, some are there already.
    assert!((few + count(&atlas) * 3 / 4..=few + count(&atlas)).contains(&many), "{few} + {} became {many} blocks", count(&atlas));

    // Numbers of submaps can be changed.
    let renumbered = atlas.submaps().iter().map(|submap| submap.clone().renumbered(|id| id + 7)).collect();
    let renumbered = Atlas::from_submaps(VOXEL, renumbered);
    assert!(renumbered.submaps().iter().flat_map(|submap| submap.handed_over()).all(|record| renumbered.submap(record.to).is_some()));
}
