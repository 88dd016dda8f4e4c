//! Surfaces that several submaps saw, stored once: while the map grows, is corrected and rebuilt.

use crate::town::{LAP, Town};
use crate::{image, settings};
use std::error::Error;
use voxelastic::atlas::Submap;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::ScanSource;
use voxelastic::settings::Storage;
use voxelastic::{Cloud, Mapper, Pose, Settings};

const STEP: f64 = 2.0;

fn poses() -> Vec<Pose> {
    (0..(1.2 * LAP / STEP) as usize).map(|i| Town::pose(i as f64 * STEP)).collect()
}

/// A mapper that has mapped some scans.
fn mapped(town: &Town, poses: &[Pose], storage: Storage) -> Mapper {
    let mut mapper = Mapper::new(Settings { min_overlap: 1.0, storage, ..settings() }).unwrap();
    for (i, pose) in poses.iter().enumerate() {
        mapper.handle(town.scan(i as NodeId, pose, pose)).unwrap();
    }
    mapper
}

struct Scans<'a>(&'a Town, &'a [Pose]);

impl ScanSource for Scans<'_> {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        Ok(self.0.cloud(self.1.get(node as usize).ok_or("no such scan")?, node + 1))
    }
}

fn handed_over(mapper: &Mapper) -> usize {
    mapper.atlas().submaps().iter().flat_map(Submap::handed_over).map(|record| record.keys.len()).sum()
}

#[test]
fn a_map_that_is_stored_once_is_smaller_and_can_grow_and_be_corrected_and_rebuilt() {
    let (town, poses) = (Town::new(), poses());
    let (half, rest) = poses.split_at(poses.len() / 2);
    let [mut all, mut once] = [Storage::All, Storage::Once].map(|storage| mapped(&town, half, storage));
    [&mut all, &mut once].into_iter().for_each(Mapper::finish);
    let bytes = [&all, &once].map(|mapper| mapper.atlas().bytes());
    println!("{bytes:?} bytes, {} blocks handed over", handed_over(&once));
    assert!(handed_over(&all) == 0 && handed_over(&once) > 500 && bytes[1] * 100 < bytes[0] * 97, "{bytes:?}, {} blocks", handed_over(&once));
    // Finishing again changes nothing.
    let before = image(once.atlas());
    once.finish();
    assert!(image(once.atlas()) == before);

    // More scans, and a correction: submaps have their own again.
    for (i, pose) in rest.iter().enumerate().map(|(i, pose)| (i + half.len(), pose)) {
        for mapper in [&mut all, &mut once] {
            mapper.handle(town.scan(i as NodeId, pose, pose)).unwrap();
        }
        assert_eq!(handed_over(&once), 0);
    }
    let lifted = |pose: &Pose| Pose::translation(0.0, 0.0, 3.0) * pose;
    let moved: Vec<(NodeId, Pose)> = poses.iter().enumerate().skip(20).map(|(i, pose)| (i as NodeId, lifted(pose))).collect();
    once.finish();
    assert!(handed_over(&once) > 500);
    for mapper in [&mut all, &mut once] {
        mapper.handle(Event::PoseUpdate(moved.clone())).unwrap();
    }
    assert_eq!(handed_over(&once), 0);
    let blocks = |mapper: &Mapper| mapper.atlas().submaps().iter().map(|submap| submap.tsdf().len()).collect::<Vec<_>>();
    println!("{:?} and {:?} blocks", blocks(&all), blocks(&once));
    for (all, once) in blocks(&all).into_iter().zip(blocks(&once)) {
        assert!(once * 100 >= all * 98, "{once} instead of {all} blocks");
    }

    // What is rebuilt is the same as without.
    once.finish();
    for submap in [0, 2] {
        for mapper in [&mut all, &mut once] {
            mapper.rebuild(submap, &mut Scans(&town, &poses)).unwrap();
        }
        let of = |mapper: &Mapper| image(mapper.atlas()).into_iter().find(|(id, ..)| *id == submap);
        assert!(of(&all).is_some() && of(&all) == of(&once), "submap {submap}");
    }
    assert_eq!(handed_over(&once), 0);
}
