//! Carriers that stand, start and shake.

use voxelastic::geometry::PoseExt;
use voxelastic_sim::route::{Carrier, Route, Trajectory};

#[test]
fn a_carrier_stands_and_starts_without_a_jolt() {
    let route = Route::rounded(&[[0.0, 0.0], [30.0, 0.0], [30.0, 20.0]], 3.0);
    let moving = Trajectory { route: route.clone(), carrier: Carrier::HANDHELD, rest: 0.0 };
    let resting = Trajectory { rest: 2.0, ..moving.clone() };
    assert_eq!(resting.pose(0.0), resting.pose(2.0));
    assert!(resting.pose(2.0).translation_distance(&moving.pose(0.0)) < 1e-12);
    assert!(resting.pose(9.0).translation_distance(&moving.pose(9.0 - 2.0 - 0.75)) < 1e-12, "half of the start is lost");
    let speed = |t: f64| resting.pose(t).translation_distance(&resting.pose(t + 1e-4)) / 1e-4;
    assert!((0..4000).all(|k| (speed(1e-3 * f64::from(k + 1)) - speed(1e-3 * f64::from(k))).abs() < 0.02));
}

#[test]
fn a_hand_turns_at_ninety_degrees_per_second() {
    let trajectory = Trajectory { route: Route::rounded(&[], 20.0), carrier: Carrier::HANDHELD, rest: 0.0 };
    let rate = |k: u32| trajectory.pose(0.01 * f64::from(k)).rotation_distance(&trajectory.pose(0.01 * f64::from(k + 1))) / 0.01;
    let fastest = (0..2000).map(rate).fold(0.0, f64::max);
    assert!((80.0..150.0).contains(&fastest.to_degrees()), "{}", fastest.to_degrees());
    assert!(Carrier::names().all(|name| Carrier::named(name).is_some()) && Carrier::named("horse").is_none());
}
