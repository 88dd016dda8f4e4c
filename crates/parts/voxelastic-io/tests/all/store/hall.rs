//! A real hall with both fields: `VOXELASTIC_DATA` says where the data is.

use crate::store::world::{details, image, occupancy_image, same_atlas};
use std::time::Instant;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{OccupancyIntegrator, OccupancySettings, ReturnsView, TsdfIntegrator, TsdfSettings};
use voxelastic::mapper::Frontend;
use voxelastic::settings::Settings;
use voxelastic::{Cloud, Pose};
use voxelastic_io::store::{MapStore, MapWriter};
use voxelastic_io::{clouds, poses};

/// The scans of the hall that are asked for, with their poses; none without the data.
fn scans(count: usize) -> Option<Vec<(Pose, Cloud)>> {
    let dir = voxelastic_testing::data("hall")?;
    let poses = poses::read(dir.join("poses.tum")).unwrap().poses;
    let cloud = |i: usize| clouds::read(dir.join(format!("scans/{i:06}.pcd"))).unwrap().cloud;
    Some(poses.into_iter().take(count).enumerate().map(|(i, pose)| (pose, cloud(i))).collect())
}

/// Which fields to integrate.
#[derive(Clone, Copy)]
struct Fields {
    tsdf: bool,
    occupancy: bool,
}

/// Integrates scans into submaps whose frame is the map's.
struct Scanner {
    front: Frontend,
    tsdf: TsdfIntegrator,
    occupancy: OccupancyIntegrator,
}

impl Scanner {
    fn new(voxel: f32, max_range: f32, first: &Cloud) -> Self {
        let front = Frontend::open(&Settings { voxel_size: voxel, max_range, ..Settings::default() }, None, first).unwrap();
        let occupancy = OccupancyIntegrator::new(OccupancySettings { voxel_size: voxel, max_range, ..OccupancySettings::default() }, front.model());
        Self { tsdf: TsdfIntegrator::new(TsdfSettings { voxel_size: voxel, max_range, ..TsdfSettings::default() }), occupancy, front }
    }

    fn scan_into(&mut self, submap: &mut Submap, fields: Fields, (pose, cloud): &(Pose, Cloud)) {
        let mut prepared = self.front.prepare(cloud);
        prepared.fit_planes();
        let (pose, scan) = (Rigid::from(pose), prepared.scan());
        let returns = ReturnsView { origins: &[], ..ReturnsView::new(&scan.returns) };
        if fields.tsdf {
            self.tsdf.integrate(submap.tsdf_mut(), &pose, &returns);
        }
        if fields.occupancy {
            self.occupancy.integrate(submap.occupancy_mut(), &pose, &scan.image, &returns, prepared.fills_gaps());
        }
    }
}

#[test]
fn a_hall_that_was_stored_on_the_way_ends_as_the_same_map() {
    let Some(scans) = scans(8) else { return };
    let both = Fields { tsdf: true, occupancy: true };
    let mut kept = Atlas::new(0.2);
    let id = kept.spawn(Pose::identity());
    let mut scanner = Scanner::new(0.2, 30.0, &scans[0].1);
    let dir = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    for scan in &scans {
        writer.save(&kept, &details("hall")).unwrap();
        let mut reopened = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
        scanner.scan_into(kept.submap_mut(id).unwrap(), both, scan);
        scanner.scan_into(reopened.submap_mut(id).unwrap(), both, scan);
        let (a, b) = (&kept.submaps()[0], &reopened.submaps()[0]);
        assert!(image(a.tsdf()) == image(b.tsdf()));
        assert!(occupancy_image(a.occupancy()) == occupancy_image(b.occupancy()));
    }
    let submap = &kept.submaps()[0];
    assert!(submap.tsdf().len() > 1000 && submap.occupancy().len() > 1000, "{} and {} blocks", submap.tsdf().len(), submap.occupancy().len());
}

/// `cargo test --release -p voxelastic-io --test store hall_speed -- --ignored --nocapture`
#[test]
#[ignore = "measures"]
fn hall_speed() {
    let Some(scans) = scans(usize::MAX) else { return };
    for (field, voxel, fields, submaps) in [
        ("tsdf", 0.03, Fields { tsdf: true, occupancy: false }, 1),
        ("tsdf", 0.05, Fields { tsdf: true, occupancy: false }, 3),
        ("occupancy", 0.05, Fields { tsdf: false, occupancy: true }, 1),
    ] {
        let mut scanner = Scanner::new(voxel, 60.0, &scans[0].1);
        let mut atlas = Atlas::new(voxel);
        let first = atlas.spawn(Pose::identity());
        scans.iter().for_each(|scan| scanner.scan_into(atlas.submap_mut(first).unwrap(), fields, scan));
        let submap = atlas.submaps()[0].clone();
        for _ in 1..submaps {
            let id = atlas.spawn(Pose::identity());
            let copy = atlas.submap_mut(id).unwrap();
            (*copy.tsdf_mut(), *copy.occupancy_mut()) = (submap.tsdf().clone(), submap.occupancy().clone());
        }
        measure(&format!("{field} of the hall at {voxel} m, submaps: {submaps}"), &atlas);
    }
}

/// Prints how long saving and loading take, the shortest of three times.
fn measure(name: &str, atlas: &Atlas) {
    let mut best = [f64::INFINITY; 3];
    let mut note = |i: usize, clock: Instant| best[i] = clock.elapsed().as_secs_f64().min(best[i]);
    let mut on_disk = 0;
    for _ in 0..3 {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = MapWriter::create(dir.path()).unwrap();
        let clock = Instant::now();
        on_disk = writer.save(atlas, &details("speed")).unwrap().bytes;
        note(0, clock);
        let clock = Instant::now();
        assert_eq!(writer.save(atlas, &details("speed")).unwrap().written, 0);
        note(1, clock);
        let clock = Instant::now();
        let loaded = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
        note(2, clock);
        assert!(same_atlas(&loaded, atlas));
    }
    let [save, again, load] = best;
    let (memory, disk) = (atlas.bytes() as f64 / 1e6, on_disk as f64 / 1e6);
    println!("{name}: {memory:.0} MB in memory, {disk:.1} MB on disk; save {save:.2} s, save unchanged {again:.2} s, load {load:.2} s");
}
