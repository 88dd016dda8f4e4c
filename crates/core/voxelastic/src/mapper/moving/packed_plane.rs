//! A plane in four bytes.

/// Steps of distances, metres.
const STEP: f32 = 0.02;
/// Bits of each of two coordinates of the normal; the others are the distance.
const BITS: u32 = 10;
const MOST: f32 = ((1 << BITS) - 1) as f32;
const FARTHEST: u32 = (1 << (32 - 2 * BITS)) - 2;
/// Steps behind the origin: the rounded normal of a plane that is seen at a grazing angle may face away from it.
const BEHIND: f32 = 15.0;

/// A plane that faces the origin, up to 80 m away; or none. The normal is a point of an octahedron, unfolded to a square.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::mapper) struct PackedPlane(u32);

impl PackedPlane {
    /// No plane.
    pub const NONE: Self = Self(u32::MAX);

    /// The plane through `point`, metres, with a unit normal; none for a zero normal.
    pub fn new(normal: [f32; 3], point: [f32; 3]) -> Self {
        let length: f32 = normal.iter().map(|n| n.abs()).sum();
        if length < 0.5 {
            return Self::NONE;
        }
        let [x, y, z] = normal.map(|n| n / length);
        let fold = |a: f32, b: f32| if z < 0.0 { (1.0 - b.abs()).copysign(a) } else { a };
        let [u, v] = [fold(x, y), fold(y, x)].map(|a| (0.5 * (a + 1.0) * MOST + 0.5) as u32);
        let normal = unfolded(u, v);
        // With the normal as it is stored, so that the plane goes through the point.
        let distance = -(0..3).map(|k| normal[k] * point[k]).sum::<f32>();
        let steps = ((distance / STEP).round() + BEHIND).max(0.0) as u32;
        if steps > FARTHEST { Self::NONE } else { Self(u | v << BITS | steps << (2 * BITS)) }
    }

    /// Its unit normal.
    pub fn normal(self) -> [f32; 3] {
        let low = (1 << BITS) - 1;
        unfolded(self.0 & low, self.0 >> BITS & low)
    }

    /// How far `point` is before the plane, metres; negative behind it.
    pub fn height(self, point: [f32; 3]) -> Option<f32> {
        let normal = self.normal();
        let distance = ((self.0 >> (2 * BITS)) as f32 - BEHIND) * STEP;
        (self != Self::NONE).then(|| (0..3).map(|k| normal[k] * point[k]).sum::<f32>() + distance)
    }
}

/// The unit normal of two coordinates on the square.
fn unfolded(u: u32, v: u32) -> [f32; 3] {
    let [a, b] = [u, v].map(|c| 2.0 * c as f32 / MOST - 1.0);
    let z = 1.0 - a.abs() - b.abs();
    let fold = |a: f32, b: f32| if z < 0.0 { (1.0 - b.abs()).copysign(a) } else { a };
    let (x, y) = (fold(a, b), fold(b, a));
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn heights_are_those_of_the_plane(
            direction in prop::array::uniform3(-1f32..1.0),
            to in prop::array::uniform3(-30f32..30.0),
            off in prop::array::uniform3(-2f32..2.0),
        ) {
            let length = direction.iter().map(|c| c * c).sum::<f32>().sqrt();
            prop_assume!(length > 0.01);
            let normal = direction.map(|c| c / length);
            let dot = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
            let normal = if dot(normal, to) > 0.0 { normal.map(|c| -c) } else { normal };
            let place: [f32; 3] = std::array::from_fn(|k| to[k] + off[k]);
            let height = PackedPlane::new(normal, to).height(place);
            prop_assert!(height.is_some_and(|height| (height - dot(normal, off)).abs() < 0.02 + 0.003 * dot(off, off).sqrt()), "{height:?}");
        }
    }

    #[test]
    fn a_plane_that_is_seen_at_a_grazing_angle_goes_through_its_point() {
        let (normal, to) = ([-0.823_284, 0.515_570_1, 0.237_467_7], [9.106_362, 26.473_98, -25.877_419]);
        let height = PackedPlane::new(normal, to).height(to);
        assert!(height.is_some_and(|height| height.abs() < 0.02), "{height:?}");
    }

    #[test]
    fn no_plane_has_no_height() {
        assert_eq!(PackedPlane::new([0.0; 3], [1.0; 3]).height([0.0; 3]), None);
        assert_eq!(PackedPlane::new([-1.0, 0.0, 0.0], [100.0, 0.0, 0.0]).height([0.0; 3]), None, "too far");
    }
}
