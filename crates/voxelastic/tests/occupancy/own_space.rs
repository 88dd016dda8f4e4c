//! The robot's own space: after every scan, against the rule applied voxel by voxel with straight lines tested against the boxes of occupied voxels.

use super::{Integration, Room, scans_of, voxels_of};
use proptest::prelude::*;
use voxelastic::field::occupancy::{LOG_ODDS_STEPS, OccupancyField, State, UNKNOWN, state_of};
use voxelastic::integrate::OccupancySettings;

/// What the own space of a sensor at `sensor` (voxels) makes of a voxel; none where rounding decides.
fn expected(field: &OccupancyField, c: [i32; 3], sensor: [f64; 3], radius: f64, once: i8) -> Option<i8> {
    let value = field.value_at(c);
    let centre = c.map(|v| f64::from(v) + 0.5);
    let off: f64 = (0..3).map(|k| (centre[k] - sensor[k]).powi(2)).sum::<f64>().sqrt();
    if off > radius + 1e-3 || value > 0 || (value != UNKNOWN && value <= once) {
        return Some(value);
    }
    if off > radius - 1e-3 {
        return None;
    }
    let own = sensor.map(|v| v.floor() as i32);
    let reach = radius.ceil() as i32 + 1;
    let mut sight = Some(true);
    for i in 0..(2 * reach + 1).pow(3) {
        let n = 2 * reach + 1;
        let o = [own[0] - reach + i % n, own[1] - reach + i / n % n, own[2] - reach + i / n / n];
        if o == own || field.value_at(o) <= 0 {
            continue;
        }
        match length_within(sensor, centre, o) {
            l if l > 1e-4 => sight = Some(false),
            // A line along an edge of the box.
            l if l > -1e-4 && sight == Some(true) => sight = None,
            _ => {}
        }
        if sight == Some(false) {
            break;
        }
    }
    sight.map(|is_seen| if is_seen { once } else { value })
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
    #![proptest_config(ProptestConfig::with_cases(2))]
    #[test]
    fn it_is_what_the_sensor_is_not_hidden_from(seed in any::<u64>(), voxel in 0.09f32..0.2, radius in 0.3f32..1.4) {
        let room = Room::random(seed);
        // Few enough voxels across for cells of one voxel, and one scale of blocks.
        let with = OccupancySettings { voxel_size: voxel, robot_radius: radius, ..OccupancySettings::default() };
        let without = OccupancySettings { robot_radius: 0.0, ..with.clone() };
        let once = (with.free * LOG_ODDS_STEPS).round() as i8;
        let (mut own, mut plain) = (Integration::new(&with, 1e-6), Integration::new(&without, 1e-6));
        let (mut freed, mut hidden) = (0, 0);
        for (pose, points) in scans_of(&room, 4) {
            plain.field = own.field.clone();
            plain.add(&pose, &points);
            own.add(&pose, &points);
            let sensor = pose.translation.map(|v| f64::from(v / voxel));
            for c in voxels_of(voxel) {
                let Some(value) = expected(&plain.field, c, sensor, f64::from(radius / voxel), once) else { continue };
                prop_assert_eq!(own.field.value_at(c), value, "{:?}, {} without", c, plain.field.value_at(c));
                freed += usize::from(value != plain.field.value_at(c));
                let off: f64 = (0..3).map(|k| (f64::from(c[k]) + 0.5 - sensor[k]).powi(2)).sum();
                hidden += usize::from(off < f64::from(radius / voxel).powi(2) && state_of(value) == State::Unknown);
            }
        }
        prop_assert!(freed > 20, "{freed} voxels freed, {hidden} hidden");
    }
}
