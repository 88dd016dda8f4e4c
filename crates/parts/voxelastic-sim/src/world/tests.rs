//! Worlds against brute force over all solids.

use super::*;
use crate::random::Stream;
use crate::solid::{Capsule, Cuboid, Cylinder, HalfSpace, Solid, Sphere, Vec3};
use proptest::prelude::*;

/// A world of random overlapping solids.
fn random_world(seed: u64, count: usize, ground: bool) -> World {
    let mut random = Stream::new(seed, &[9]);
    let mut builder = WorldBuilder::new("random", seed);
    let position = |r: &mut Stream| [r.range(-3.0, 3.0), r.range(-3.0, 3.0), r.range(-1.0, 3.0)];
    for k in 0..count {
        let (a, b, size) = (position(&mut random), position(&mut random), random.range(0.1, 1.2));
        let solid = match k % 5 {
            0 => Solid::Cuboid(Cuboid::turned(a, [size, 2.0 * size, 1.5 * size], random.range(0.0, 3.0))),
            1 => Solid::Cylinder(Cylinder::upright(a, 2.0 * size, size / 2.0)),
            2 => Solid::Sphere(Sphere::new(a, size / 1.5)),
            3 => Solid::Capsule(Capsule::between(a, b, size / 4.0)),
            _ => Solid::Cuboid(Cuboid::between(a, b)),
        };
        builder.add(solid, 0.5);
    }
    if ground {
        builder.add(Solid::HalfSpace(HalfSpace::below(-0.5)), 0.3);
    }
    builder.build().unwrap_or_else(|e| unreachable!("{e}"))
}

/// Depth as the shortest exit along random directions: an upper bound that tightens with their number.
fn depth_by_rays(world: &World, p: &Vec3, seed: u64) -> f64 {
    let mut random = Stream::new(seed, &[1]);
    let mut best = f64::INFINITY;
    for _ in 0..3000 {
        let direction = Sphere::new([0.0; 3], 1.0).surface_point(random.uniform(), random.uniform(), 0.0);
        // Follow the ray out of every solid that contains the point.
        let mut t: f64 = 0.0;
        while t < best {
            let q = p + direction * (t + 1e-9);
            let exits = world.solids().iter().filter(|s| s.distance(&q) < 0.0).map(|s| s.interval(p, &direction).1);
            match exits.reduce(f64::max) {
                Some(exit) if exit > t => t = exit,
                _ => break,
            }
        }
        best = best.min(t);
    }
    best
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn distance_outside_is_the_least_distance_to_a_solid(seed in any::<u64>(), count in 1usize..60) {
        let world = random_world(seed, count, seed % 2 == 0);
        let mut random = Stream::new(seed, &[2]);
        for _ in 0..200 {
            let p = Vec3::new(random.range(-6.0, 6.0), random.range(-6.0, 6.0), random.range(-2.0, 6.0));
            let least = world.solids().iter().map(|s| s.distance(&p)).fold(f64::INFINITY, f64::min);
            let d = world.distance(p.into());
            if least > 1e-6 {
                prop_assert!((d - least).abs() < 1e-12, "{d} {least}");
            } else {
                prop_assert!(d <= (least + 3e-5).clamp(-World::DEPTH_LIMIT, 0.0) + 3e-5, "{d} is less deep than {least}");
            }
        }
    }

    #[test]
    fn rays_agree_with_brute_force(seed in any::<u64>(), count in 0usize..60) {
        let world = random_world(seed, count, seed % 2 == 0);
        let mut random = Stream::new(seed, &[3]);
        let rays: Vec<Ray> = (0..37)
            .map(|_| {
                let p = Vec3::new(random.range(-9.0, 9.0), random.range(-9.0, 9.0), random.range(-2.0, 9.0));
                let q = Vec3::new(random.range(-3.0, 3.0), random.range(-3.0, 3.0), random.range(-1.0, 3.0));
                (p, (q - p).normalize())
            })
            .collect();
        let mut hits = vec![None; rays.len()];
        world.cast_all(&rays, 15.0, &mut hits);
        for ((o, d), hit) in rays.iter().zip(hits) {
            let all = world.solids().iter().map(|s| s.interval(o, d)).filter(|i| i.1 > 0.0 && i.0 < 15.0).map(|i| i.0.max(0.0));
            let nearest = all.fold(f64::INFINITY, f64::min);
            prop_assert_eq!(hit.map_or(f64::INFINITY, |h| h.range), nearest);
            prop_assert_eq!(world.cast((*o).into(), (*d).into(), 15.0).map(|h| h.range), hit.map(|h| h.range), "single rays and packets agree");
            if let Some(h) = hit.filter(|h| h.range > 0.0) {
                prop_assert!(world.distance((o + d * h.range).into()).abs() < 1e-6);
                for k in 0..20 {
                    let before = o + d * (h.range * f64::from(k) / 20.0);
                    prop_assert!(world.distance(before.into()) > -1e-6, "passes through matter");
                }
            }
        }
    }

    #[test]
    fn depth_is_the_shortest_exit(seed in any::<u64>(), count in 2usize..14) {
        let world = random_world(seed, count, seed % 3 == 0);
        let mut random = Stream::new(seed, &[4]);
        let inside = (0..400)
            .map(|_| Vec3::new(random.range(-3.0, 3.0), random.range(-3.0, 3.0), random.range(-1.5, 3.0)))
            .filter(|p| world.nearest_solid(p).is_some_and(|n| n.0 < 0.0));
        for p in inside.take(6) {
            let depth = -world.distance(p.into());
            let found = depth_by_rays(&world, &p, seed);
            prop_assert!(depth <= found + 1e-4, "{depth} but a way out of {found} exists");
            if depth < World::DEPTH_LIMIT {
                prop_assert!(found <= depth * 1.1 + 0.03, "{depth} but no way out below {found}");
            }
            let deeper = -world.distance_within(p.into(), 6.0);
            prop_assert!(deeper <= found + 1e-4 && deeper >= depth - 1e-4, "{deeper} m to 6 m of depth, {depth} to 1 m, by rays {found}");
            prop_assert!(found <= deeper * 1.1 + 0.03 || found > 6.0, "{deeper} but no way out below {found}");
        }
    }

    #[test]
    fn distance_is_lipschitz(seed in any::<u64>(), count in 1usize..30) {
        let world = random_world(seed, count, true);
        let mut random = Stream::new(seed, &[5]);
        for _ in 0..100 {
            let p = Vec3::new(random.range(-4.0, 4.0), random.range(-4.0, 4.0), random.range(-2.0, 4.0));
            let step = Vec3::new(random.normal(), random.normal(), random.normal()) * random.range(0.001, 0.3);
            let rise = (world.distance((p + step).into()) - world.distance(p.into())).abs();
            prop_assert!(rise <= step.norm() + 5e-5, "{rise} over {}", step.norm());
        }
    }
}

#[test]
fn touching_solids_have_no_surface_between_them() -> Result<(), crate::SimError> {
    let mut builder = WorldBuilder::new("wall", 0);
    builder.cuboid([0.0, 0.0, 0.0], [2.0, 0.6, 3.0], 0.5);
    builder.cuboid([2.0, 0.0, 0.0], [4.0, 0.6, 3.0], 0.5);
    builder.ground(0.0, 0.3);
    let world = builder.build()?;
    for (p, depth) in
        [([2.0, 0.2, 1.5], 0.2), ([2.001, 0.3, 1.5], 0.3), ([1.9, 0.05, 0.001], 0.05), ([1.0, 0.3, -0.3], 0.424_264), ([0.5, -0.5, -0.2], 0.2)]
    {
        assert!((world.distance(p) + depth).abs() < 1e-4, "{p:?}: {}", world.distance(p));
    }
    let samples = world.sample_surface(100.0, 1);
    let seam = samples.iter().filter(|s| (s.point[0] - 2.0).abs() < 1e-6).count();
    assert!(samples.len() > 2500 && samples.iter().all(|s| world.distance(s.point).abs() < 1e-4));
    assert!(seam < 3, "the two faces of the seam are not surface");
    Ok(())
}

#[test]
fn empty_worlds_and_bad_points_do_not_panic() -> Result<(), crate::SimError> {
    let world = WorldBuilder::new("void", 0).build()?;
    assert_eq!(world.distance([1.0, 2.0, 3.0]), f64::INFINITY);
    assert!(world.distance([f64::NAN, 0.0, 0.0]).is_nan());
    assert_eq!(world.cast([0.0; 3], [1.0, 0.0, 0.0], 10.0), None);
    assert!(world.bounds().is_none() && world.sample_surface(10.0, 0).is_empty());
    let mut broken = WorldBuilder::new("broken", 0);
    broken.sphere([0.0, f64::NAN, 0.0], 1.0, 0.5);
    assert!(matches!(broken.build(), Err(crate::SimError::Solid { index: 0 })));
    Ok(())
}
