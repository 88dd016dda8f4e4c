//! Bad scans: too near, empty, without returns, at wrong poses.

use super::{COLUMNS, Integration, ROWS, SPACING};
use crate::common::room::Room;
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::OccupancySettings;

fn settings() -> OccupancySettings {
    OccupancySettings { voxel_size: 0.1, max_range: 20.0, ..OccupancySettings::default() }
}

fn known(field: &OccupancyField) -> (u64, u64) {
    let volumes = field.volumes();
    (volumes.free.iter().sum(), volumes.occupied.iter().sum())
}

/// A sphere of points around the sensor, one for each pixel.
fn sphere(range: f32) -> Vec<[f32; 3]> {
    let rays = (0..ROWS * COLUMNS).map(|i| {
        let elevations = Room::elevations(ROWS);
        let (e, a) = (elevations[i / COLUMNS], ((i % COLUMNS) as f32 + 0.5) * SPACING);
        [e.cos() * a.cos(), e.cos() * a.sin(), e.sin()]
    });
    rays.map(|ray| ray.map(|c| c * range)).collect()
}

fn at_origin() -> Rigid {
    Rigid::from(&voxelastic::Pose::identity())
}

#[test]
fn points_within_the_near_limit_are_dropped() {
    let mut integration = Integration::with_near(&settings(), SPACING, 1.0);
    let mut points = sphere(5.0);
    // The operator's head covers a third of the field of view.
    points.iter_mut().take(ROWS * COLUMNS / 3).for_each(|p| *p = p.map(|c| c * 0.1));
    integration.add(&at_origin(), &points);
    let near = (-8..8).flat_map(|x| (-8..8).flat_map(move |y| (-8..8).map(move |z| [x, y, z])));
    assert!(near.into_iter().all(|c| integration.field.state_at(c) != State::Occupied));
    let (free, occupied) = known(&integration.field);
    assert!(free > 10_000 && occupied > 10_000, "{free} free, {occupied} occupied");
}

#[test]
fn a_scan_without_returns_changes_nothing() {
    for points in [Vec::new(), vec![[f32::NAN; 3]; ROWS * COLUMNS], vec![[0.0; 3]; ROWS * COLUMNS], vec![[f32::INFINITY; 3]; 100]] {
        let mut integration = Integration::new(&settings(), SPACING);
        integration.add(&at_origin(), &points);
        assert_eq!(known(&integration.field), (0, 0));
    }
}

#[test]
fn beams_without_return_clear_space_if_the_setting_says_so() {
    let mut integration = Integration::new(&OccupancySettings { clear_no_return: true, ..settings() }, SPACING);
    let mut points = sphere(5.0);
    points.truncate(ROWS * COLUMNS / 2);
    integration.add(&at_origin(), &points);
    // The upper half has returns at 5 m, the lower half has none.
    let at = |elevation: f32, range: f32| [range * elevation.cos(), 0.5, range * elevation.sin()].map(|c| (c / 0.1).floor() as i32);
    let elevations = Room::elevations(ROWS);
    let (up, down) = (elevations[ROWS / 4], elevations[3 * ROWS / 4]);
    assert_eq!(integration.field.state_at(at(up, 3.0)), State::Free);
    assert_eq!(integration.field.state_at(at(up, 12.0)), State::Unknown);
    assert_eq!(integration.field.state_at(at(down, 12.0)), State::Free);
}

#[test]
fn returns_beyond_the_maximum_range_clear_up_to_it() {
    let mut integration = Integration::new(&settings(), SPACING);
    integration.add(&at_origin(), &sphere(500.0));
    let (free, occupied) = known(&integration.field);
    assert!(free > 100_000 && occupied == 0, "{free} free, {occupied} occupied");
    assert_eq!(integration.field.state_at([100, 0, 0]), State::Free);
    assert_eq!(integration.field.state_at([201, 0, 0]), State::Unknown);
}

#[test]
fn good_scans_correct_what_a_scan_with_a_wrong_pose_changed() {
    let room = Room::random(5);
    let mut integration = Integration::new(&settings(), SPACING);
    let scans: Vec<_> = (0..6).map(|i| room.scan(i, ROWS, COLUMNS, 0.0)).collect();
    scans.iter().for_each(|(pose, points, _)| integration.add(pose, points));
    let before = known(&integration.field);
    // The same scan again at a pose 4 m to the left, which may be inside a wall, and at one a kilometre away.
    let (pose, points, _) = &scans[0];
    for step in [4.0, 1000.0] {
        let [x, y, z] = pose.translation;
        integration.add(&Rigid { translation: [x, y + step, z], ..*pose }, points);
    }
    let after = known(&integration.field);
    assert!(after.0 > before.0 && after.1 > before.1, "{before:?} {after:?}");
    // Good scans correct the map.
    (0..8).for_each(|_| scans.iter().for_each(|(pose, points, _)| integration.add(pose, points)));
    let clean = {
        let mut integration = Integration::new(&settings(), SPACING);
        (0..9).for_each(|_| scans.iter().for_each(|(pose, points, _)| integration.add(pose, points)));
        integration.field
    };
    let (mut same, mut all) = (0, 0);
    for c in super::voxels_of(0.1).filter(|&c| clean.state_at(c) != State::Unknown) {
        all += 1;
        same += usize::from(integration.field.state_at(c) == clean.state_at(c));
    }
    assert!(same as f64 > 0.99 * f64::from(all), "{same} of {all}");
}
