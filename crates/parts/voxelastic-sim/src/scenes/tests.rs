//! Every scene has a collision-free trajectory, is reproducible, and has consistent distances and rays.

use super::*;
use crate::SimError;

#[test]
fn trajectories_keep_clear_of_solids() -> Result<(), SimError> {
    for name in names() {
        for seed in 0..6 {
            let Scene { world, trajectory, .. } = Scene::named(name, seed)?;
            let lap = trajectory.route.length() / trajectory.carrier.speed;
            // Two laps, a pose each 10 cm.
            let steps = (2.0 * trajectory.route.length() / 0.1) as usize;
            for k in 0..steps {
                let time = 2.0 * lap * k as f64 / steps as f64;
                let p = trajectory.pose(time).translation.vector;
                let d = world.distance(p.into());
                assert!(d >= 0.4, "{name} {seed}: {d:.3} m from a solid at {p:?}");
            }
        }
    }
    Ok(())
}

#[test]
fn scenes_are_reproducible_and_depend_on_the_seed() -> Result<(), SimError> {
    for name in ["campus", "mine", "street", "district"] {
        let build = |seed| World::named(name, seed).map(|w| w.fingerprint());
        assert_eq!(build(5)?, build(5)?);
        assert_ne!(build(5)?, build(6)?);
    }
    assert!(matches!(World::named("moon", 1), Err(SimError::UnknownWorld { known, .. }) if known.contains("campus")));
    Ok(())
}

#[test]
fn rays_agree_with_sphere_tracing() -> Result<(), SimError> {
    for name in ["campus", "mine", "street", "district"] {
        let Scene { world, trajectory, .. } = Scene::named(name, 1)?;
        let mut random = crate::random::Stream::new(8, &[]);
        for _ in 0..300 {
            let p = trajectory.pose(random.range(0.0, 300.0)).translation.vector;
            let direction = crate::solid::Sphere::new([0.0; 3], 1.0).surface_point(random.uniform(), random.uniform(), 0.0);
            let hit = world.cast(p.into(), direction.into(), 120.0);
            let range = hit.map_or(120.0, |h| h.range);
            if hit.is_some() {
                let d = world.distance((p + direction * range).into());
                assert!(d.abs() < 1e-4, "{name}: {d} at a hit");
            }
            // Sphere tracing uses only distances and must reach the same point.
            let mut t = 0.0;
            while t < range - 1e-3 {
                let d = world.distance((p + direction * t).into());
                assert!(d > 0.0, "{name}: inside of a solid at {t} of {range}");
                t += d.max(1e-4);
            }
            assert!(hit.is_none() || t < range + 1e-3, "{name}: sphere tracing passes the hit at {range}, {t}");
        }
    }
    Ok(())
}

#[test]
fn campus_doorway_is_one_metre_wide_and_tunnel_three() -> Result<(), SimError> {
    let world = World::named("campus", 1)?;
    let width = |at: [f64; 3]| {
        let side = |x: f64| world.cast(at, [x, 0.0, 0.0], 50.0).map_or(f64::INFINITY, |h| h.range);
        side(1.0) + side(-1.0)
    };
    assert!((width([101.5, 135.0, 1.2]) - 1.0).abs() < 1e-9);
    assert!((width([47.5, 99.0, 1.2]) - 3.0).abs() < 1e-9);
    Ok(())
}

#[test]
fn a_district_is_a_square_kilometre_that_can_be_reached() -> Result<(), SimError> {
    for seed in 1..4 {
        let Scene { world, trajectory, .. } = Scene::named("district", seed)?;
        let (low, high) = world.bounds().unwrap();
        assert!((0..2).all(|k| (1000.0..1050.0).contains(&(high[k] - low[k]))), "{low:?} {high:?}");
        // A slab around the start, without its yards' gates at the sides: most of what is not houses.
        let start: [f64; 3] = trajectory.pose(0.0).translation.vector.into();
        let bounds = [[start[0] - 130.0, start[1] - 130.0, start[2] - 0.4], [start[0] + 130.0, start[1] + 130.0, start[2] + 0.4]];
        let space = crate::ReachableSpace::new(&world, start, bounds);
        let share = space.volume() / (260.0 * 260.0 * 0.8);
        assert!((0.6..0.9).contains(&share), "{share} of the slab around {start:?}");
    }
    Ok(())
}
