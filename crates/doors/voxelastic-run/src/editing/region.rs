//! Parts of space that somebody marks in a map.

/// A part of space, in coordinates of the map.
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// A box, turned about the vertical through its middle.
    Box {
        /// Its smallest corner before the turn, metres.
        min: [f64; 3],
        /// Its largest corner before the turn, metres.
        max: [f64; 3],
        /// The turn, degrees, from x to y.
        yaw: f64,
    },
    /// A sphere.
    Sphere {
        /// Its middle, metres.
        centre: [f64; 3],
        /// Its radius, metres.
        radius: f64,
    },
    /// What is above and below a polygon.
    Prism {
        /// The corners, x and y, metres. Where the outline crosses itself, what is enclosed an even number of times is outside.
        polygon: Vec<[f64; 2]>,
        /// From which height to which, metres.
        z: [f64; 2],
    },
}

impl Region {
    /// What is wrong with the numbers, if anything.
    pub(super) fn problem(&self) -> Option<&'static str> {
        match self {
            Self::Box { min, max, .. } if (0..3).any(|k| min[k] >= max[k]) => Some("`min` must be below `max` in all three directions"),
            Self::Sphere { radius, .. } if *radius <= 0.0 => Some("`radius` must be above 0"),
            Self::Prism { polygon, .. } if polygon.len() < 3 => Some("`polygon` needs three corners or more"),
            Self::Prism { z, .. } if z[0] >= z[1] => Some("`z` must be a lower and an upper height"),
            _ => None,
        }
    }

    /// Distance of a point to the border, metres, negative inside.
    pub fn distance(&self, point: [f64; 3]) -> f64 {
        match self {
            Self::Box { min, max, yaw } => {
                let (sin, cos) = yaw.to_radians().sin_cos();
                let from: [f64; 3] = std::array::from_fn(|k| point[k] - 0.5 * (min[k] + max[k]));
                let turned = [cos * from[0] + sin * from[1], cos * from[1] - sin * from[0], from[2]];
                combined(std::array::from_fn::<f64, 3, _>(|k| turned[k].abs() - 0.5 * (max[k] - min[k])))
            }
            Self::Sphere { centre, radius } => (0..3).map(|k| (point[k] - centre[k]).powi(2)).sum::<f64>().sqrt() - radius,
            Self::Prism { polygon, z } => {
                let height = (point[2] - 0.5 * (z[0] + z[1])).abs() - 0.5 * (z[1] - z[0]);
                combined([to_polygon(polygon, [point[0], point[1]]), height])
            }
        }
    }
}

/// The distance to what is common to slabs at right angles, from the distances to each.
fn combined<const N: usize>(slabs: [f64; N]) -> f64 {
    let outside = slabs.iter().map(|d| d.max(0.0).powi(2)).sum::<f64>().sqrt();
    if outside > 0.0 { outside } else { slabs.into_iter().fold(f64::NEG_INFINITY, f64::max) }
}

/// The distance of a point of the plane to the outline of a polygon, negative inside.
fn to_polygon(polygon: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let (mut nearest, mut is_inside) = (f64::INFINITY, false);
    for (k, a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        let (along, from) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
        let square = along[0] * along[0] + along[1] * along[1];
        let t = if square > 0.0 { ((from[0] * along[0] + from[1] * along[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
        nearest = nearest.min((from[0] - t * along[0]).hypot(from[1] - t * along[1]));
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * along[0] {
            is_inside = !is_inside;
        }
    }
    if is_inside { -nearest } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number from 0 to 1 by its place in a sequence.
    fn random(k: usize) -> f64 {
        (k as f64 * 0.618_033_988_75 + (k as f64 * 12.9898).sin() * 43_758.545_3).rem_euclid(1.0)
    }

    #[test]
    fn distances_are_right_in_sign_and_never_too_long() {
        let star = (0..10).map(|k| {
            let (sin, cos) = (k as f64 * 0.628_318).sin_cos();
            let r = if k % 2 == 0 { 3.0 } else { 1.2 };
            [r * cos, r * sin]
        });
        let star: Vec<[f64; 2]> = star.collect();
        let regions = [
            Region::Box { min: [-1.0, -2.0, -0.5], max: [2.0, 1.0, 0.5], yaw: 33.0 },
            Region::Sphere { centre: [0.5, 0.0, 0.2], radius: 1.7 },
            Region::Prism { polygon: star.clone(), z: [-1.0, 0.4] },
        ];
        let (sin, cos) = 33f64.to_radians().sin_cos();
        let contains = |region: usize, p: [f64; 3]| match region {
            0 => {
                let (x, y) = (p[0] - 0.5, p[1] + 0.5);
                let (u, v) = (x * cos + y * sin, y * cos - x * sin);
                u.abs() < 1.5 && v.abs() < 1.5 && p[2].abs() < 0.5
            }
            1 => (p[0] - 0.5).powi(2) + p[1].powi(2) + (p[2] - 0.2).powi(2) < 1.7f64.powi(2),
            _ => {
                // A star is what lies, from its middle, before the edge in that direction.
                let angle = p[1].atan2(p[0]).rem_euclid(std::f64::consts::TAU);
                let k = ((angle / 0.628_318) as usize).min(9);
                let (a, b) = (star[k], star[(k + 1) % 10]);
                let side = |q: [f64; 2]| (b[0] - a[0]) * (q[1] - a[1]) - (b[1] - a[1]) * (q[0] - a[0]);
                side([p[0], p[1]]) > 0.0 && p[2] > -1.0 && p[2] < 0.4
            }
        };
        for k in 0..3000 {
            let p = [3, 5, 7].map(|prime| 8.0 * random(k * prime + prime) - 4.0);
            let direction = [11, 13, 17].map(|prime| 2.0 * random(k * prime) - 1.0);
            let length = direction.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
            for (n, region) in regions.iter().enumerate() {
                let distance = region.distance(p);
                if distance.abs() > 1e-4 {
                    assert_eq!(distance < 0.0, contains(n, p), "{n} {p:?}");
                }
                // No border within the distance in any direction.
                let near = std::array::from_fn(|i| p[i] + 0.999 * distance.abs() * direction[i] / length);
                assert!(distance.abs() < 1e-4 || region.distance(near) * distance > -1e-9, "{n} {p:?}");
            }
        }
        assert!((regions[0].distance([0.5, -0.5, 2.5]) - 2.0).abs() < 1e-12);
    }
}
