//! Closed forms of solids against marching along rays and sampling of surfaces.

use super::*;
use proptest::prelude::*;

fn vector(reach: f64) -> impl Strategy<Value = [f64; 3]> {
    [-reach..reach, -reach..reach, -reach..reach]
}

fn solid() -> impl Strategy<Value = Solid> {
    let size = [0.05..3.0f64, 0.05..3.0f64, 0.05..3.0f64];
    prop_oneof![
        (vector(3.0), size, -4.0..4.0f64).prop_map(|(c, s, yaw)| Solid::Cuboid(Cuboid::turned(c, s, yaw))),
        (vector(3.0), vector(3.0), 0.03..2.0f64).prop_map(|(a, b, r)| Solid::Cylinder(Cylinder::between(a, b, r))),
        (vector(3.0), 0.03..2.0f64).prop_map(|(a, r)| Solid::Cylinder(Cylinder::upright(a, 2.0, r))),
        (vector(3.0), 0.03..2.0f64).prop_map(|(c, r)| Solid::Sphere(Sphere::new(c, r))),
        (vector(3.0), vector(3.0), 0.03..2.0f64).prop_map(|(a, b, r)| Solid::Capsule(Capsule::between(a, b, r))),
        (-2.0..2.0f64).prop_map(|h| Solid::HalfSpace(HalfSpace::below(h))),
    ]
}

proptest! {
    #[test]
    fn distance_is_zero_at_the_ends_of_the_ray_interval(
        solid in solid(), origin in vector(100.0), target in vector(3.0), steps in prop::collection::vec(0.0..1.0f64, 20),
    ) {
        let origin = Vec3::from(origin);
        let direction = (Vec3::from(target) - origin).normalize();
        let (enter, exit) = solid.interval(&origin, &direction);
        for t in [enter, exit].into_iter().filter(|t| t.is_finite()) {
            let d = solid.distance(&(origin + direction * t));
            prop_assert!(d.abs() < 1e-7, "{d} at {t}");
        }
        for s in steps {
            let t = 300.0 * s;
            let d = solid.distance(&(origin + direction * t));
            prop_assert!(if t > enter && t < exit { d < 1e-7 } else { d > -1e-7 }, "{d} at {t} of {enter}..{exit}");
        }
    }

    #[test]
    fn interval_of_a_ray_from_inside_contains_zero(solid in solid(), p in vector(4.0), direction in vector(1.0)) {
        prop_assume!(Vec3::from(direction).norm() > 0.1);
        let (p, direction) = (Vec3::from(p), Vec3::from(direction).normalize());
        let (enter, exit) = solid.interval(&p, &direction);
        let d = solid.distance(&p);
        prop_assert_eq!(d < 0.0, enter < 0.0 && exit > 0.0, "{} in {}..{}", d, enter, exit);
    }

    #[test]
    fn distance_agrees_with_surface_samples(
        solid in solid().prop_filter("finite", |s| s.area().is_finite()), p in vector(4.0), seed in any::<u64>(),
    ) {
        let p = Vec3::from(p);
        let d = solid.distance(&p);
        let mut random = crate::random::Stream::new(seed, &[]);
        let mut nearest = f64::INFINITY;
        for _ in 0..2000 {
            let q = solid.surface_point(random.uniform(), random.uniform(), random.uniform());
            prop_assert!(solid.distance(&q).abs() < 1e-9);
            nearest = nearest.min((q - p).norm());
        }
        prop_assert!(nearest >= d.abs() - 1e-9, "{nearest} < {d}");
        // Samples lie a spacing of about sqrt(area / 2000) apart; edges and thin sides need a few times that.
        prop_assert!(nearest <= d.abs() + 6.0 * (solid.area() / 2000.0).sqrt(), "{nearest} > {d}");
    }

    #[test]
    fn normals_are_the_gradient_of_the_distance(
        solid in solid().prop_filter("finite", |s| s.area().is_finite()), u in 0.0..1.0f64, v in 0.0..1.0f64, w in 0.0..1.0f64,
    ) {
        let q = solid.surface_point(u, v, w);
        let n = solid.normal(&q);
        prop_assert!((n.norm() - 1.0).abs() < 1e-9);
        let rise = solid.distance(&(q + n * 1e-4));
        prop_assert!((rise - 1e-4).abs() < 1e-7, "{rise}");
    }

    #[test]
    fn bounds_hold_the_surface_and_touch_it(solid in solid().prop_filter("finite", |s| s.area().is_finite()), seed in any::<u64>()) {
        let (low, high) = solid.bounds();
        let mut random = crate::random::Stream::new(seed, &[]);
        for _ in 0..200 {
            let q = solid.surface_point(random.uniform(), random.uniform(), random.uniform());
            prop_assert!((0..3).all(|k| q[k] >= low[k] - 1e-9 && q[k] <= high[k] + 1e-9));
        }
        // A point beyond a side of the bounds by 1 m is at least 1 m away.
        prop_assert!(solid.distance(&Vec3::new(high.x + 1.0, low.y, low.z)) >= 1.0 - 1e-9);
    }
}
