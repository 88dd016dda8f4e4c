//! A square street around a building, with pillars along it: exact rays, so that maps can be judged.

use nalgebra::{Translation3, UnitQuaternion};
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::{Cloud, Pose};

/// Half the side of the square that the path follows.
pub const SIDE: f64 = 22.0;
/// Length of one lap, metres.
pub const LAP: f64 = 8.0 * SIDE;
/// Height of the sensor above the ground.
const HEIGHT: f64 = 1.5;

pub struct Town {
    boxes: Vec<([f64; 3], [f64; 3])>,
}

pub fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
}

impl Town {
    pub fn new() -> Self {
        let mut boxes = vec![([-15.0, -15.0, 0.0], [15.0, 15.0, 8.0])];
        for (low, high) in [(-32.0, -30.0), (30.0, 32.0)] {
            boxes.push(([low, -32.0, 0.0], [high, 32.0, 6.0]));
            boxes.push(([-32.0, low, 0.0], [32.0, high, 6.0]));
        }
        let mut seed = 7;
        for i in 0..24 {
            let along = -28.0 + 56.0 * random(&mut seed);
            let across = if i % 2 == 0 { 15.0 + 2.0 * random(&mut seed) } else { 27.0 + 3.0 * random(&mut seed) };
            let (x, y) = [(along, across), (across, along), (along, -across), (-across, along)][i / 2 % 4];
            let (w, h) = (0.3 + random(&mut seed), 1.0 + 4.0 * random(&mut seed));
            boxes.push(([x - w, y - w, 0.0], [x + w, y + w, h]));
        }
        Self { boxes }
    }

    /// The same town with another box from `low` to `high`.
    pub fn with_box(mut self, low: [f64; 3], high: [f64; 3]) -> Self {
        self.boxes.push((low, high));
        self
    }

    /// Pose of the lidar in the map frame after `s` metres of path.
    pub fn pose(s: f64) -> Pose {
        let s = s.rem_euclid(LAP);
        let (side, along) = ((s / (2.0 * SIDE)) as usize, s % (2.0 * SIDE) - SIDE);
        let (x, y) = [(SIDE, along), (-along, SIDE), (-SIDE, -along), (along, -SIDE)][side];
        let yaw = std::f64::consts::FRAC_PI_2 * (side as f64 + 1.0);
        Pose::from_parts(Translation3::new(x, y, HEIGHT), UnitQuaternion::from_euler_angles(0.0, 0.0, yaw))
    }

    /// A scan of 16 rings of a sensor at `t_map_lidar`, with noise of 1 cm.
    pub fn cloud(&self, t_map_lidar: &Pose, seed: u64) -> Cloud {
        let mut seed = seed.wrapping_mul(0x1234_5677);
        let origin = t_map_lidar.translation.vector;
        let mut points = Vec::new();
        for ring in 0..16 {
            let elevation = (-15.0 + 2.0 * f64::from(ring)).to_radians();
            for column in 0..360 {
                let azimuth = (f64::from(column) + 0.5) / 360.0 * std::f64::consts::TAU;
                let ray = nalgebra::Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
                let range = self.range(origin.into(), (t_map_lidar.rotation * ray).into());
                let noise = 0.02 * (random(&mut seed) - 0.5);
                if range < 45.0 {
                    points.push((ray * (range + noise)).map(|c| c as f32).into());
                }
            }
        }
        Cloud::from_points(points)
    }

    fn range(&self, origin: [f64; 3], ray: [f64; 3]) -> f64 {
        let ground = if ray[2] < 0.0 { -origin[2] / ray[2] } else { f64::INFINITY };
        self.boxes.iter().fold(ground, |nearest, (low, high)| {
            let (mut enter, mut leave) = (0.0f64, nearest);
            for k in 0..3 {
                let (a, b) = ((low[k] - origin[k]) / ray[k], (high[k] - origin[k]) / ray[k]);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
            if enter < leave && enter > 0.0 { enter } else { nearest }
        })
    }

    /// The scan taken at `true_pose` and reported at `reported_pose`.
    pub fn scan(&self, node: NodeId, true_pose: &Pose, reported_pose: &Pose) -> Event {
        Event::Scan(Scan { node, time: node as f64, t_map_lidar: *reported_pose, cloud: self.cloud(true_pose, node + 1) })
    }
}
