//! A box-shaped room with a ball in it: exact distance, exact rays, exact normals.

use voxelastic::geometry::Rigid;

#[allow(dead_code)]
pub struct Room {
    half: [f32; 3],
    ball: [f32; 3],
    radius: f32,
    seed: u64,
}

/// A number in 0..1 from a counter.
fn random(state: &mut u64) -> f32 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f32 / (1u64 << 24) as f32
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Room {
    pub fn random(seed: u64) -> Self {
        let mut s = seed;
        let mut within = |a: f32, b: f32| a + (b - a) * random(&mut s);
        Self {
            half: [within(5.0, 9.0), within(4.0, 7.0), within(1.5, 2.5)],
            ball: [within(1.5, 3.5), within(1.5, 3.0), 0.0],
            radius: within(0.5, 1.0),
            seed,
        }
    }

    /// Distance to the nearest surface, positive in the room's air.
    pub fn distance(&self, p: [f32; 3]) -> f32 {
        let wall = (0..3).map(|k| self.half[k] - p[k].abs()).fold(f32::INFINITY, f32::min);
        let offset: [f32; 3] = std::array::from_fn(|k| p[k] - self.ball[k]);
        wall.min(dot(offset, offset).sqrt() - self.radius)
    }

    /// First surface along a ray from inside: range and normal facing the ray's origin.
    fn cast(&self, origin: [f32; 3], ray: [f32; 3]) -> (f32, [f32; 3]) {
        let mut best = (f32::INFINITY, [0.0; 3]);
        for k in 0..3 {
            let t = (self.half[k].copysign(ray[k]) - origin[k]) / ray[k];
            if t < best.0 {
                let mut normal = [0.0; 3];
                normal[k] = -1f32.copysign(ray[k]);
                best = (t, normal);
            }
        }
        let offset: [f32; 3] = std::array::from_fn(|k| origin[k] - self.ball[k]);
        let (b, c) = (dot(offset, ray), dot(offset, offset) - self.radius * self.radius);
        if b * b > c && b < 0.0 {
            let t = -b - (b * b - c).sqrt();
            if t < best.0 {
                best = (t, std::array::from_fn(|k| (offset[k] + t * ray[k]) / self.radius));
            }
        }
        best
    }

    /// Elevations of the rows of [`Room::scan`], top to bottom.
    pub fn elevations(rows: usize) -> Vec<f32> {
        (0..rows).map(|row| 0.6 - 1.2 * (row as f32 + 0.37) / rows as f32).collect()
    }

    /// Scan `index` of a walk through the room: pose, points and normals in the lidar frame.
    pub fn scan(&self, index: usize, rows: usize, columns: usize, noise: f32) -> (Rigid, Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let mut s = self.seed ^ (index as u64 + 1) << 32;
        let yaw = 0.4 * index as f32;
        let (sin, cos) = yaw.sin_cos();
        let pose = Rigid {
            rotation: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
            translation: [-2.0 + 0.5 * index as f32, -1.5 - 0.1 * index as f32, 0.2],
        };
        let back = |v: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| (0..3).map(|i| pose.rotation[i][k] * v[i]).sum()) };
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        for elevation in Self::elevations(rows) {
            for column in 0..columns {
                let azimuth = std::f32::consts::TAU * (column as f32 + 0.21) / columns as f32;
                let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
                let (range, normal) = self.cast(pose.translation, pose.rotate(direction));
                let range = range + noise * (random(&mut s) + random(&mut s) + random(&mut s) - 1.5);
                points.push(direction.map(|c| c * range));
                normals.push(back(normal));
            }
        }
        (pose, points, normals)
    }
}
