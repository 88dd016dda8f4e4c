//! How fast large maps are saved and loaded: `cargo test --release -p voxelastic-io --test store speed -- --ignored --nocapture`.

use crate::world::{Walk, details};
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic_io::store::{MapStore, MapWriter};

#[test]
#[ignore = "measures"]
fn speed() {
    for submaps in [1, 8] {
        let mut atlas = Atlas::default();
        // A room of 28 x 12 x 4 m at 2 cm voxels: shallow pages of real distances. Copies fill the atlas up.
        let mut walk = Walk::fine();
        let first = atlas.spawn(Pose::identity());
        let field = &mut atlas.submap_mut(first).unwrap().tsdf;
        while field.bytes() < (300 << 20) / submaps {
            walk.scan_into(field);
        }
        let field = field.clone();
        for _ in 1..submaps {
            let id = atlas.spawn(Pose::identity());
            atlas.submap_mut(id).unwrap().tsdf = field.clone();
        }
        let dir = tempfile::tempdir().unwrap();
        let mut writer = MapWriter::create(dir.path()).unwrap();
        let clock = Instant::now();
        let report = writer.save(&atlas, &details("speed")).unwrap();
        let save = clock.elapsed();
        let clock = Instant::now();
        assert_eq!(writer.save(&atlas, &details("speed")).unwrap().written, 0);
        let again = clock.elapsed();
        let clock = Instant::now();
        let loaded = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
        let load = clock.elapsed();
        assert!(crate::world::same_atlas(&loaded, &atlas));
        println!(
            "{submaps} submaps, {:.0} MB in memory, {:.1} MB on disk: save {save:.2?}, save unchanged {again:.2?}, load {load:.2?}",
            atlas.bytes() as f64 / 1e6,
            report.bytes as f64 / 1e6,
        );
    }
}
