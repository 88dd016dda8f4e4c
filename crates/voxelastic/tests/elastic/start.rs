//! The robot's own space where a run starts: larger than later, and the same after a rebuild. In a saved map a run starts anew.

use crate::settings;
use crate::town::Town;
use std::error::Error;
use voxelastic::event::{Event, NodeId};
use voxelastic::field::occupancy::State;
use voxelastic::mapper::ScanSource;
use voxelastic::settings::{FieldKind, RobotRadius};
use voxelastic::{Cloud, Mapper, Pose, Settings};

fn pose(node: NodeId) -> Pose {
    Town::pose(4.0 * node as f64)
}

struct Scans(Town);

impl ScanSource for Scans {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        Ok(self.0.cloud(&pose(node), node + 1))
    }
}

/// Whether space 0.4 m and 1.2 m above the sensor at `node` is free; a field of view of 30 degrees shows neither.
fn free_above(mapper: &Mapper, node: NodeId) -> [bool; 2] {
    let map = mapper.atlas().query();
    let [x, y, z] = pose(node).translation.vector.into();
    [0.4, 1.2].map(|above| map.state([x, y, z + above]) == State::Free)
}

#[test]
fn a_run_starts_in_a_larger_space_than_it_goes_on_in() {
    let radius = |radius| RobotRadius::Metres(radius);
    let settings = Settings { field: FieldKind::Occupancy, robot_radius: radius(0.6), start_radius: radius(1.5), ..settings() };
    let mut scans = Scans(Town::new());
    let add = |mapper: &mut Mapper, node| mapper.handle(scans.0.scan(node, &pose(node), &pose(node))).map(drop);
    let mut mapper = Mapper::new(settings.clone()).unwrap();
    (0..4).for_each(|node| add(&mut mapper, node).unwrap());
    let larger_at_the_start = [[true, true], [true, false], [true, false], [true, false]];
    assert_eq!([0, 1, 2, 3].map(|node| free_above(&mapper, node)), larger_at_the_start);
    let in_map = Mapper::in_saved(settings.clone(), None, mapper.atlas().clone());
    let mut next_run = in_map.unwrap();
    (10..12).for_each(|node| add(&mut next_run, node).unwrap());
    assert_eq!([10, 11].map(|node| free_above(&next_run, node)), [[true, true], [true, false]]);

    let submap = mapper.atlas().submaps()[0].id();
    mapper.rebuild(submap, &mut scans).unwrap();
    assert_eq!([0, 1, 2, 3].map(|node| free_above(&mapper, node)), larger_at_the_start);

    // By itself, and where it is less, it is the radius of everywhere else.
    for start_radius in [RobotRadius::Auto, radius(0.3)] {
        let mut mapper = Mapper::new(Settings { start_radius, ..settings.clone() }).unwrap();
        mapper.handle(scans.0.scan(0, &pose(0), &pose(0))).unwrap();
        assert_eq!(free_above(&mapper, 0), [true, false], "{start_radius:?}");
    }
}
