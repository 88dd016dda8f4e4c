//! A small analytic world: ground, walls, a cylinder, a sphere.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use voxelastic::Cloud;
use voxelastic::sensor::BeamModel;

/// Something that a ray can hit.
#[derive(Clone, Copy, Debug)]
pub enum Shape {
    /// Points p with normal . p = offset, hit from either side.
    Plane { normal: [f32; 3], offset: f32 },
    /// A part of the plane y = `y` or x = `x`: axis (0 or 1), position, and bounds of the other horizontal axis and of z.
    Panel { axis: usize, at: f32, along: [f32; 2], up: [f32; 2] },
    /// A vertical cylinder.
    Cylinder { centre: [f32; 2], radius: f32 },
    /// A sphere.
    Sphere { centre: [f32; 3], radius: f32 },
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub range: f32,
    pub normal: [f32; 3],
    /// Index of the shape.
    pub shape: usize,
}

pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Shape {
    fn cast(&self, o: [f32; 3], d: [f32; 3]) -> Option<(f32, [f32; 3])> {
        match *self {
            Self::Plane { normal, offset } => Some(((offset - dot(normal, o)) / dot(normal, d), normal)),
            Self::Panel { axis, at, along, up } => {
                let range = (at - o[axis]) / d[axis];
                let (other, z) = (o[1 - axis] + range * d[1 - axis], o[2] + range * d[2]);
                let mut normal = [0.0; 3];
                normal[axis] = 1.0;
                ((along[0]..along[1]).contains(&other) && (up[0]..up[1]).contains(&z)).then_some((range, normal))
            }
            Self::Cylinder { centre, radius } => {
                let (ox, oy) = (o[0] - centre[0], o[1] - centre[1]);
                let (a, b, c) = (d[0] * d[0] + d[1] * d[1], ox * d[0] + oy * d[1], ox * ox + oy * oy - radius * radius);
                let range = (-b - (b * b - a * c).sqrt()) / a;
                Some((range, [(ox + range * d[0]) / radius, (oy + range * d[1]) / radius, 0.0]))
            }
            Self::Sphere { centre, radius } => {
                let v: [f32; 3] = std::array::from_fn(|k| o[k] - centre[k]);
                let b = dot(v, d);
                let range = -b - (b * b - dot(v, v) + radius * radius).sqrt();
                Some((range, std::array::from_fn(|k| (v[k] + range * d[k]) / radius)))
            }
        }
    }
}

/// A scene and the noise of its sensor.
#[derive(Clone, Debug)]
pub struct Scene {
    pub shapes: Vec<Shape>,
    pub noise: f32,
    pub max: f32,
}

/// One scan with the true hit of each pixel.
pub struct Scan {
    /// Organised, in the model's own pixels.
    pub cloud: Cloud,
    pub truth: Vec<Option<Hit>>,
}

impl Scene {
    /// A hall 30 x 20 m and 8 m high, 1.7 m above the ground, with a pillar, a ball, a box and a kerb.
    pub fn room(noise: f32) -> Self {
        let plane = |normal, offset| Shape::Plane { normal, offset };
        let shapes = vec![
            plane([0.0, 0.0, 1.0], -1.7),
            plane([0.0, 0.0, -1.0], -6.3),
            plane([1.0, 0.0, 0.0], 18.0),
            plane([1.0, 0.0, 0.0], -12.0),
            plane([0.0, 1.0, 0.0], 9.0),
            plane([0.0, 1.0, 0.0], -11.0),
            Shape::Cylinder { centre: [6.0, 3.0], radius: 0.4 },
            Shape::Sphere { centre: [-5.0, -4.0, 0.5], radius: 1.2 },
            Shape::Panel { axis: 0, at: 4.0, along: [-5.0, -3.0], up: [-1.7, 0.8] },
            Shape::Panel { axis: 1, at: -3.0, along: [4.0, 6.0], up: [-1.7, 0.8] },
        ];
        Self { shapes, noise, max: 120.0 }
    }

    /// Open ground 1.7 m below the sensor, a facade, a pole and a tree trunk: a street.
    pub fn street(noise: f32) -> Self {
        let shapes = vec![
            Shape::Plane { normal: [0.0, 0.0, 1.0], offset: -1.7 },
            Shape::Panel { axis: 1, at: 7.0, along: [-60.0, 60.0], up: [-1.7, 9.0] },
            Shape::Panel { axis: 1, at: -15.0, along: [-40.0, 30.0], up: [-1.7, 12.0] },
            Shape::Cylinder { centre: [8.0, -4.0], radius: 0.08 },
            Shape::Cylinder { centre: [-6.0, -6.0], radius: 0.25 },
        ];
        Self { shapes, noise, max: 90.0 }
    }

    pub fn cast(&self, o: [f32; 3], d: [f32; 3]) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (shape, s) in self.shapes.iter().enumerate() {
            if let Some((range, n)) = s.cast(o, d)
                && range > 0.05
                && range < self.max
                && best.is_none_or(|b| range < b.range)
            {
                let facing = if dot(n, d) < 0.0 { 1.0 } else { -1.0 };
                best = Some(Hit { range, normal: n.map(|c| c * facing), shape });
            }
        }
        best
    }

    /// The scan of `model` here, in its own pixel order; NaN without return.
    pub fn scan(&self, model: &BeamModel, seed: u64) -> Scan {
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut points, mut truth) = (Vec::new(), Vec::new());
        for row in 0..model.rows() {
            for column in 0..model.columns() {
                let (o, d) = (model.origin(row as f32, column as f32), model.direction(row as f32, column as f32));
                let hit = self.cast(o, d);
                // Sum of uniforms: near enough to normal.
                let noise = (0..6).map(|_| rng.random::<f32>() - 0.5).sum::<f32>() * 2f32.sqrt() * self.noise;
                points.push(hit.map_or([f32::NAN; 3], |h| std::array::from_fn(|k| o[k] + (h.range + noise) * d[k])));
                truth.push(hit);
            }
        }
        Scan { cloud: Cloud { points, width: model.columns(), height: model.rows(), ..Cloud::default() }, truth }
    }
}

/// A generator for tests.
pub fn rng(seed: u64) -> StdRng {
    StdRng::seed_from_u64(seed)
}
