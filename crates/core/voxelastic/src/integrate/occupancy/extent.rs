//! The extent of a cube as seen from the sensor: in depth, elevation and azimuth.

/// Half the extent of each of eight sibling cubes as seen from the sensor: an upper bound for all of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    /// Towards the sensor and away from it, metres.
    pub depth: [f32; 2],
    /// In elevation, radians.
    pub elevation: f32,
    /// In azimuth, radians; infinite above and below the sensor.
    pub azimuth: f32,
}

/// Half the width of a box with half edges `step` along `w`, times the length of `w`.
#[inline(always)]
fn half_width(step: &[[f32; 3]; 3], w: [f32; 3]) -> f32 {
    let mut reach = 0.0;
    for s in step {
        reach += (s[0] * w[0] + s[1] * w[1] + s[2] * w[2]).abs();
    }
    reach
}

impl Extent {
    /// Of boxes with half edges `step` (lidar frame) whose centres lie no farther than their half diagonal `radius` from
    /// `at` (lidar frame, metres), where `range` = |at| is at least four radii.
    ///
    /// Half the width of a box along a unit vector w is E(w) = sum |step_i . w|, which changes by at most `radius` times the change of w. So the directions at the
    /// centre of the siblings serve for all of them, with a margin for their offset from it.
    #[inline(always)]
    pub fn new(at: [f32; 3], range: f32, step: &[[f32; 3]; 3], radius: f32) -> Self {
        let flat = (at[0] * at[0] + at[1] * at[1]).sqrt();
        // Smallest distances of the boxes' centres and of their points.
        let (centres, points) = (range - radius, range - 2.0 * radius);
        let turn = radius / centres;
        let (away, flat_inverse) = (1.0 / range, 1.0 / flat.max(1e-6));
        let depth = half_width(step, at) * away + radius * turn;
        let outward = 0.5 * radius * radius / points;
        let (flat_centres, flat_points) = (flat - radius, flat - 2.0 * radius);
        // Nearly above or below the sensor the azimuth is undefined, and "up" may be any direction.
        let is_above = flat_points <= 2.0 * radius;
        let sideways = [-at[1] * flat_inverse, at[0] * flat_inverse, 0.0];
        let (cosine, sine) = (flat * away, at[2] * away);
        let upward = [-sine * at[0] * flat_inverse, -sine * at[1] * flat_inverse, cosine];
        let swing = radius / flat_centres;
        // Points off the vertical plane through the centre are a little farther from the axis than their projection into it.
        let elevation = (half_width(step, upward) + radius * (turn + swing)) / points + 0.5 * radius * radius / (flat_points * points);
        let azimuth = (half_width(step, sideways) + radius * swing) / flat_points;
        Self {
            depth: [depth, depth + outward],
            elevation: if is_above { radius / points * 1.1 } else { elevation },
            azimuth: if is_above { f32::INFINITY } else { azimuth },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn extents_contain_every_point_of_every_sibling(
            direction in prop::array::uniform3(-1f32..1.0), distance in 4.01f32..400.0, angles in prop::array::uniform3(-3.1f32..3.1),
            points in prop::collection::vec((0usize..8, prop::array::uniform3(prop_oneof![Just(-1f32), Just(1f32), -1f32..1.0])), 60),
        ) {
            let length = direction.iter().map(|c| c * c).sum::<f32>().sqrt();
            prop_assume!(length > 0.05);
            let half = 2.0 / 3f32.sqrt(); // the half diagonal is 1
            let rotation = nalgebra::Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let step: [[f32; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * half * rotation[(j, i)]));
            let at = direction.map(|c| c / length * distance);
            let extent = Extent::new(at, distance, &step, 1.0);
            let add = |p: [f32; 3], by: [f32; 3]| -> [f32; 3] { std::array::from_fn(|j| p[j] + (0..3).map(|i| by[i] * step[i][j]).sum::<f32>()) };
            let polar = |p: [f32; 3]| {
                let p = p.map(f64::from);
                let range = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
                (range, (p[2] / range).asin(), p[1].atan2(p[0]))
            };
            for (lane, inside) in points {
                let centre = add(at, [1, 2, 4].map(|bit| if lane & bit == 0 { -1.0 } else { 1.0 }));
                let (c, p) = (polar(centre), polar(add(centre, inside)));
                let close = 1e-5 * f64::from(distance);
                prop_assert!(p.0 >= c.0 - f64::from(extent.depth[0]) - close && p.0 <= c.0 + f64::from(extent.depth[1]) + close);
                prop_assert!((p.1 - c.1).abs() <= f64::from(extent.elevation) * (1.0 + 1e-4) + 1e-6, "{} {}", p.1 - c.1, extent.elevation);
                let turn = (p.2 - c.2 + 3.0 * std::f64::consts::PI).rem_euclid(2.0 * std::f64::consts::PI) - std::f64::consts::PI;
                prop_assert!(turn.abs() <= f64::from(extent.azimuth) * (1.0 + 1e-4) + 1e-6, "{turn} {}", extent.azimuth);
            }
            // And tight: far away, within the elevations of lidars, the extent is at most about the half diagonal.
            if distance > 100.0 && at[2].abs() < 0.7 * distance {
                prop_assert!(extent.elevation * distance < 1.07 && extent.depth[1] < 1.03);
            }
        }
    }
}
