//! Reopening gives the same map, bit for bit, and the same future.

use crate::store::world::{Walk, details, image, made_up_atlas, same_atlas};
use proptest::prelude::*;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::OccupancyField;
use voxelastic::field::tsdf::TsdfField;
use voxelastic::surface::{MeshOptions, extract};
use voxelastic_io::Error;
use voxelastic_io::store::{MapStore, MapWriter};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_atlas_comes_back(seed in any::<u64>(), submaps in 0usize..5, blocks in 0usize..400) {
        let dir = tempfile::tempdir().unwrap();
        let mut atlas = made_up_atlas(seed, submaps, blocks);
        // Of some submaps scans were corrected.
        for id in (0..submaps as u32).step_by(2) {
            let submap = atlas.submap_mut(id).unwrap();
            let corrected = submap.scans().iter().rev().map(|scan| scan.t_submap_lidar).collect();
            *submap = submap.clone().with_corrected(corrected);
        }
        let mut writer = MapWriter::create(dir.path()).unwrap();
        let report = writer.save(&atlas, &details("roundtrip")).unwrap();
        prop_assert_eq!(report.written, submaps);
        let store = MapStore::open(dir.path()).unwrap();
        prop_assert_eq!(&store.manifest().details, &details("roundtrip"));
        prop_assert_eq!(store.manifest(), writer.store().manifest());
        let loaded = store.load_atlas().unwrap();
        prop_assert!(same_atlas(&loaded, &atlas));
        prop_assert!(loaded.submaps().iter().zip(atlas.submaps()).all(|(a, b)| a.corrected() == b.corrected()));
        prop_assert!(store.check().is_empty());
    }
}

#[test]
fn for_surfaces_occupancy_is_left_out_and_checked_all_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let made_up = made_up_atlas(3, 2, 40);
    let [both, surface] = made_up.submaps() else { panic!("two submaps") };
    assert!(!both.tsdf().is_empty() && !both.occupancy().is_empty() && surface.occupancy().is_empty());
    let space = both.clone().with_id(2).with_fields(TsdfField::default(), both.occupancy().clone());
    let without = both.clone().with_fields(both.tsdf().clone(), OccupancyField::default());
    let voxel = made_up.voxel_size();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    writer.save(&Atlas::from_submaps(voxel, vec![both.clone(), surface.clone(), space.clone()]), &details("surfaces")).unwrap();
    let store = MapStore::open(dir.path()).unwrap().for_surfaces();
    assert!(same_atlas(&store.load_atlas().unwrap(), &Atlas::from_submaps(voxel, vec![without, surface.clone(), space])));
    let file = dir.path().join(&store.manifest().submaps[0].file);
    let whole = std::fs::read(&file).unwrap();
    for at in (0..whole.len()).step_by(whole.len() / 50) {
        let mut damaged = whole.clone();
        damaged[at] ^= 4;
        std::fs::remove_file(&file).and_then(|()| std::fs::write(&file, damaged)).unwrap();
        assert!(matches!(store.load_submap(0), Err(Error::Damaged { .. } | Error::OtherVersion { .. })), "byte {at}");
    }
}

#[test]
fn a_field_of_many_pages_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let atlas = made_up_atlas(5, 1, 20_000);
    assert!(atlas.bytes() > 10 << 20);
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details("pages")).unwrap();
    for threads in [1, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (other, loaded) = pool.install(|| {
            let other = tempfile::tempdir().unwrap();
            MapWriter::create(other.path()).unwrap().save(&atlas, &details("pages")).unwrap();
            (other, MapStore::open(dir.path()).unwrap().load_atlas().unwrap())
        });
        assert!(same_atlas(&loaded, &atlas));
        // The files are the same too, whatever the number of threads.
        assert_eq!(MapStore::open(other.path()).unwrap().manifest(), MapStore::open(dir.path()).unwrap().manifest());
    }
}

#[test]
fn whatever_is_integrated_next_gives_the_same_map_and_mesh() {
    for has_intensity in [false, true] {
        let mut kept = Atlas::new(0.065);
        let id = kept.spawn(Pose::identity());
        let mut walk = Walk::new(has_intensity);
        let mut past_arrays = 0;
        for round in 0..8 {
            let dir = tempfile::tempdir().unwrap();
            MapWriter::create(dir.path()).unwrap().save(&kept, &details("future")).unwrap();
            let mut reopened = MapStore::open(dir.path()).unwrap().load_atlas().unwrap();
            assert!(same_atlas(&kept, &reopened), "round {round}");
            let mut other_walk = walk.again();
            for _ in 0..2 {
                walk.scan_into(kept.submap_mut(id).unwrap().tsdf_mut());
                other_walk.scan_into(reopened.submap_mut(id).unwrap().tsdf_mut());
            }
            let (a, b) = (kept.submaps()[0].tsdf(), reopened.submaps()[0].tsdf());
            assert!(image(a) == image(b), "round {round}");
            assert!(extract(a, 0.1, &MeshOptions::default()) == extract(b, 0.1, &MeshOptions::default()), "round {round}");
            past_arrays += a.arrays().iter().sum::<usize>() - a.len();
        }
        let field = kept.submaps()[0].tsdf();
        assert!(
            past_arrays > 100 && field.blocks_by_scale()[..3].iter().all(|&n| n > 10),
            "the walk must change scales: {:?}",
            field.blocks_by_scale()
        );
    }
}

#[test]
fn one_submap_is_loaded_alone() {
    let dir = tempfile::tempdir().unwrap();
    let atlas = made_up_atlas(9, 3, 20);
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details("one")).unwrap();
    let store = MapStore::open(dir.path()).unwrap();
    assert!(crate::store::world::same_submap(&store.load_submap(1).unwrap(), &atlas.submaps()[1]));
    assert!(matches!(store.load_submap(7), Err(Error::NoSuchSubmap { id: 7, .. })));
}
