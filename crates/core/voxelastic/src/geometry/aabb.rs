//! Axis-aligned boxes.

use super::Pose;
use nalgebra::Point3;

/// An axis-aligned box in metres; empty until a point is added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates, metres.
    pub min: [f32; 3],
    /// Corner with the largest coordinates, metres.
    pub max: [f32; 3],
}

impl Default for Aabb {
    fn default() -> Self {
        Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] }
    }
}

impl Aabb {
    /// Extends the box to contain point `p`, metres.
    pub fn add(&mut self, p: [f32; 3]) {
        self.min = std::array::from_fn(|i| self.min[i].min(p[i]));
        self.max = std::array::from_fn(|i| self.max[i].max(p[i]));
    }

    /// Whether no point was ever added.
    pub fn is_empty(&self) -> bool {
        self.min[0] > self.max[0]
    }

    /// Edge lengths, metres; zero for an empty box.
    pub fn size(&self) -> [f32; 3] {
        std::array::from_fn(|i| (self.max[i] - self.min[i]).max(0.0))
    }
}

/// Corners of a box in another frame around the box with the corners `low` and `high`, with a micrometre more for rounding; without limits where that has none. Metres.
pub fn box_around(t_frame_box: &Pose, [low, high]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
    if !low.iter().chain(&high).all(|c| c.is_finite()) {
        return [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
    }
    let middle = |a: f64, b: f64| 0.5 * (a + b);
    let centre = (t_frame_box * Point3::from(std::array::from_fn::<_, 3, _>(|k| middle(low[k], high[k])))).coords;
    let rotation = t_frame_box.rotation.to_rotation_matrix();
    let reach: [f64; 3] = std::array::from_fn(|k| (0..3).map(|j| 0.5 * rotation[(k, j)].abs() * (high[j] - low[j])).sum::<f64>() + 1e-6);
    [std::array::from_fn(|k| centre[k] - reach[k]), std::array::from_fn(|k| centre[k] + reach[k])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_box_around_a_turned_one_holds_all_of_it_and_touches_its_corners(
            low in prop::array::uniform3(-9.0..9.0f64), size in prop::array::uniform3(0.0..9.0f64), turn in prop::array::uniform3(-3.0..3.0f64),
        ) {
            let t = Pose::from_parts(Vector3::from(low).into(), UnitQuaternion::from_scaled_axis(Vector3::from(turn)));
            let [min, max] = box_around(&t, [low, std::array::from_fn(|k| low[k] + size[k])]);
            let corner = |i: usize| t * Point3::from(std::array::from_fn::<_, 3, _>(|k| low[k] + size[k] * (i >> k & 1) as f64));
            let corners: Vec<_> = (0..8).map(corner).collect();
            for k in 0..3 {
                let (least, most) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p[k]), b.max(p[k])));
                prop_assert!(min[k] <= least && least - min[k] < 1e-5 && max[k] >= most && max[k] - most < 1e-5);
            }
        }
    }

    #[test]
    fn a_box_without_limits_has_none_in_any_frame() {
        let everything = [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
        assert_eq!(box_around(&Pose::translation(1.0, 2.0, 3.0), everything), everything);
    }
}
