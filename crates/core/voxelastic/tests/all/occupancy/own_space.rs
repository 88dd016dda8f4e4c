//! The robot's own space: after every scan, against the rule applied voxel by voxel with straight lines tested against the boxes of occupied voxels.

use super::{COLUMNS, Integration, NOISE, ROWS, Room, SPACING, scans_of, voxels_of};
use proptest::prelude::*;
use std::f32::consts::TAU;
use voxelastic::field::occupancy::{LOG_ODDS_STEPS, OccupancyField, State, UNKNOWN, state_of};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::OccupancySettings;

/// The rule for one scan, at `sensor` (voxels), on the map without the own space.
struct Rule<'a> {
    field: &'a OccupancyField,
    sensor: [f64; 3],
    /// The sensor's z axis.
    axis: [f64; 3],
    radius: f64,
    /// How far the space reaches along the axis.
    height: f64,
    /// Value after one observation of free space.
    once: i8,
    /// All occupied voxels that may hide others, without the sensor's own.
    occupied: Vec<[i32; 3]>,
}

impl<'a> Rule<'a> {
    fn new(field: &'a OccupancyField, pose: &Rigid, [radius, height]: [f64; 2], voxel: f32, once: i8) -> Self {
        let (sensor, axis) = (pose.translation.map(|v| f64::from(v / voxel)), pose.rotation.map(|row| f64::from(row[2])));
        let own = sensor.map(|v| v.floor() as i32);
        let occupied = around(sensor, radius + 1.0).filter(|c| *c != own && field.value_at(*c) > 0).collect();
        Self { field, sensor, axis, radius, height, once, occupied }
    }

    /// What becomes of a voxel; none where rounding decides.
    fn expected(&self, c: [i32; 3]) -> Option<i8> {
        let value = self.field.value_at(c);
        let centre = c.map(|v| f64::from(v) + 0.5);
        let off: f64 = (0..3).map(|k| (centre[k] - self.sensor[k]).powi(2)).sum::<f64>().sqrt();
        let along = (0..3).map(|k| (centre[k] - self.sensor[k]) * self.axis[k]).sum::<f64>().abs();
        if off > self.radius + 1e-3 || along > self.height + 1e-3 || value > 0 || (value != UNKNOWN && value <= self.once) {
            return Some(value);
        }
        let nearest_miss = self.occupied.iter().map(|o| length_within(self.sensor, centre, *o)).fold(f64::NEG_INFINITY, f64::max);
        match nearest_miss {
            // At the end of the own space, or along an edge of an occupied voxel.
            _ if off > self.radius - 1e-3 || along > self.height - 1e-3 => None,
            miss if miss.abs() <= 1e-4 => None,
            miss => Some(if miss > 0.0 { value } else { self.once }),
        }
    }
}

/// Voxels of a cube around a point, all in voxels.
fn around(p: [f64; 3], reach: f64) -> impl Iterator<Item = [i32; 3]> {
    let [xs, ys, zs] = p.map(|c| (c - reach).floor() as i32..=(c + reach).floor() as i32);
    zs.flat_map(move |z| ys.clone().map(move |y| (y, z))).flat_map(move |(y, z)| xs.clone().map(move |x| [x, y, z]))
}

/// Share of the line from `a` to `b` that is within voxel `c`; negative if it passes by.
fn length_within(a: [f64; 3], b: [f64; 3], c: [i32; 3]) -> f64 {
    let (mut from, mut to) = (0f64, 1f64);
    for k in 0..3 {
        let [near, far] = [0.0, 1.0].map(|side| (f64::from(c[k]) + side - a[k]) / (b[k] - a[k]));
        (from, to) = (from.max(near.min(far)), to.min(near.max(far)));
    }
    to - from
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn it_is_what_the_sensor_is_not_hidden_from(seed in any::<u64>(), voxel in 0.09f32..0.2, radius in 0.3f32..1.4, height in 0.3f32..1.6) {
        let room = Room::random(seed);
        // Few enough voxels across for cells of one voxel, and one scale of blocks.
        let with = OccupancySettings { voxel_size: voxel, robot_radius: radius, robot_height: height, ..OccupancySettings::default() };
        let without = OccupancySettings { robot_radius: 0.0, ..with.clone() };
        let once = (with.free * LOG_ODDS_STEPS).round() as i8;
        let (mut own, mut plain) = (Integration::new(&with, 1e-6), Integration::new(&without, 1e-6));
        let (mut freed, mut hidden) = (0, 0);
        for (pose, points) in scans_of(&room, 4) {
            plain.field = own.field.clone();
            plain.add(&pose, &points);
            own.add(&pose, &points);
            let [radius, height] = [radius, height].map(|length| f64::from(length / voxel));
            let rule = Rule::new(&plain.field, &pose, [radius, height], voxel, once);
            let sensor = rule.sensor;
            for c in around(sensor, radius + 4.0) {
                let Some(value) = rule.expected(c) else { continue };
                prop_assert_eq!(own.field.value_at(c), value, "{:?}, {} without", c, plain.field.value_at(c));
                freed += usize::from(value != plain.field.value_at(c));
                let off: f64 = (0..3).map(|k| (f64::from(c[k]) + 0.5 - sensor[k]).powi(2)).sum();
                hidden += usize::from(off < radius.powi(2) && state_of(value) == State::Unknown);
            }
            // Nothing else changes.
            for c in voxels_of(voxel).step_by(7) {
                let off: f64 = (0..3).map(|k| (f64::from(c[k]) + 0.5 - sensor[k]).powi(2)).sum();
                prop_assert!(off < (radius + 1.0).powi(2) || own.field.value_at(c) == plain.field.value_at(c), "{:?}", c);
            }
        }
        prop_assert!(freed > 20, "{freed} voxels freed, {hidden} hidden");
    }
}

#[test]
fn a_wall_beside_the_robot_stays_and_hides_what_is_behind_it() {
    // A wall at x = 1.05 m, seen from 3 m away in a narrow field of view; then the robot stands 0.35 m in front of it, and its sensor measures nothing nearer
    // than half a metre.
    let scan = |distance: f32| -> Vec<[f32; 3]> {
        let elevations = Room::elevations(ROWS).into_iter().filter(|elevation| elevation.abs() < 0.1);
        let rays = elevations.flat_map(|elevation| {
            (0..COLUMNS).map(move |column| {
                let azimuth = (column as f32 + 0.5) * TAU / COLUMNS as f32;
                [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()]
            })
        });
        rays.filter(|ray| ray[0] > 0.2).map(|ray| ray.map(|c| c * distance / ray[0])).collect()
    };
    let settings = OccupancySettings { voxel_size: 0.1, robot_radius: 0.8, ..OccupancySettings::default() };
    let mut integration = Integration::with_near(&settings, SPACING, 0.5 + NOISE);
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let at = |x: f32| Rigid { rotation, translation: [x, 0.05, 0.05] };
    (0..3).for_each(|_| integration.add(&at(-2.05), &scan(3.1)));
    let state = |field: &OccupancyField, x: f32, z: f32| field.state_at([x, 0.05, z].map(|c| (c / 0.1).floor() as i32));
    assert_eq!(state(&integration.field, 1.05, 0.05), State::Occupied);
    assert_eq!(state(&integration.field, 0.65, 0.75), State::Unknown, "above the field of view");
    (0..30).for_each(|_| integration.add(&at(0.7), &scan(0.35)));
    let field = &integration.field;
    assert_eq!(state(field, 1.05, 0.05), State::Occupied, "never erased");
    assert_eq!(state(field, 1.35, 0.05), State::Unknown, "nobody knows what is behind the wall");
    assert_eq!(state(field, 0.65, 0.75), State::Free, "the robot's own space");
    assert_eq!(state(field, 0.65, 1.25), State::Unknown, "beyond the radius");
}

#[test]
fn the_height_is_along_the_axis_of_the_sensor() {
    // A sensor on its side: its z axis is along -y.
    let settings = OccupancySettings { voxel_size: 0.1, robot_radius: 0.8, robot_height: 0.3, ..OccupancySettings::default() };
    let mut integration = Integration::with_near(&settings, SPACING, NOISE);
    let pose = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], translation: [0.05; 3] };
    integration.add(&pose, &[[3.0, 0.0, 0.0]]);
    let is_free = |y: f32, z: f32| integration.field.state_at([0.05, 0.05 + y, 0.05 + z].map(|c| (c / 0.1).floor() as i32)) == State::Free;
    assert!(is_free(0.0, 0.7) && is_free(0.0, -0.7) && is_free(0.2, 0.6));
    assert!(!is_free(0.4, 0.0) && !is_free(-0.4, 0.0) && !is_free(0.7, 0.2) && !is_free(0.0, 0.9));
}
