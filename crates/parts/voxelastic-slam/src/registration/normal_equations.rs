//! The normal equations of a registration: which surface each point belongs to, and what its distance says about the pose.

use super::larger_planes::Surfaces;
use super::local_map::Surfel;
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;
use voxelastic::geometry::Pose;

/// Points of one task. Sums over tasks are added in order, so that results do not depend on the number of threads.
const CHUNK: usize = 512;

/// How distances count.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kernel {
    /// A point farther from its surface than this has none, metres.
    pub(crate) gate: f64,
    /// Scale of the kernel (Geman-McClure): a distance of this counts a quarter, metres.
    pub(crate) scale: f64,
    /// Weight of a distance to a surface that is no plane, relative to that of its spread.
    pub(crate) point_weight: f64,
}

/// Sums over all points: `information * step = gradient`, for a small step of the pose: translation in the map frame, then rotation
/// about the sensor, around the map's axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NormalEquations {
    pub(crate) information: Matrix6<f64>,
    pub(crate) gradient: Vector6<f64>,
    /// Sum of the weights of all distances.
    pub(crate) weight: f64,
    /// Sum of squares of distances, weighted.
    pub(crate) squares: f64,
    /// Sum of what the kernel leaves of each point: how many points fit.
    pub(crate) fit: f64,
    /// Points that have a surface within the gate.
    pub(crate) matched: usize,
}

impl NormalEquations {
    fn zero() -> Self {
        Self { information: Matrix6::zeros(), gradient: Vector6::zeros(), weight: 0.0, squares: 0.0, fit: 0.0, matched: 0 }
    }

    /// Sums over points in the sensor's frame, at a pose of the sensor in the map.
    pub(crate) fn of(points: &[Surfel], t_map_lidar: &Pose, map: &impl Surfaces, kernel: &Kernel) -> Self {
        let partial = |chunk: &[Surfel]| chunk_sums(chunk, t_map_lidar, map, kernel);
        let partials: Vec<Sums> = if points.len() <= CHUNK || rayon::current_num_threads() == 1 {
            points.chunks(CHUNK).map(partial).collect()
        } else {
            points.par_chunks(CHUNK).map(partial).collect()
        };
        let mut total = Sums::default();
        partials.iter().for_each(|sums| total.add(sums));
        total.equations()
    }
}

/// The upper triangle of the information, row by row, and the rest.
#[derive(Clone, Copy, Default)]
struct Sums {
    upper: [f64; 21],
    gradient: [f64; 6],
    weight: f64,
    squares: f64,
    fit: f64,
    matched: usize,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.upper.iter_mut().zip(&other.upper).for_each(|(a, b)| *a += b);
        self.gradient.iter_mut().zip(&other.gradient).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
        self.squares += other.squares;
        self.fit += other.fit;
        self.matched += other.matched;
    }

    /// Adds a distance `r` with its derivative `j` and its weight.
    #[inline(always)]
    fn add_row(&mut self, j: [f64; 6], r: f64, weight: f64) {
        let mut k = 0;
        for (a, ja) in j.iter().enumerate() {
            let wj = weight * ja;
            for jb in &j[a..] {
                self.upper[k] += wj * jb;
                k += 1;
            }
            self.gradient[a] -= wj * r;
        }
        self.weight += weight;
        self.squares += weight * r * r;
    }

    fn equations(&self) -> NormalEquations {
        let mut equations = NormalEquations::zero();
        let mut k = 0;
        for a in 0..6 {
            for b in a..6 {
                equations.information[(a, b)] = self.upper[k];
                equations.information[(b, a)] = self.upper[k];
                k += 1;
            }
        }
        equations.gradient = Vector6::from(self.gradient);
        NormalEquations { weight: self.weight, squares: self.squares, fit: self.fit, matched: self.matched, ..equations }
    }
}

fn chunk_sums(points: &[Surfel], t_map_lidar: &Pose, map: &impl Surfaces, kernel: &Kernel) -> Sums {
    let mut sums = Sums::default();
    for_each_match(points, t_map_lidar, map, kernel, &mut sums);
    sums
}

/// What is done with the points that have a surface.
pub(super) trait Matches {
    /// A point with its surface, at a place in the map; `fit` is what the kernel leaves of it. Its distances follow.
    fn point(&mut self, at: [f64; 3], fit: f64);

    /// A distance `r` with its derivative `j` and its weight.
    fn row(&mut self, j: [f64; 6], r: f64, weight: f64);
}

impl Matches for Sums {
    #[inline(always)]
    fn point(&mut self, _: [f64; 3], fit: f64) {
        self.fit += fit;
        self.matched += 1;
    }

    #[inline(always)]
    fn row(&mut self, j: [f64; 6], r: f64, weight: f64) {
        self.add_row(j, r, weight);
    }
}

/// Finds the surface of each point, and what its distance says about the pose.
#[inline(always)]
pub(super) fn for_each_match(points: &[Surfel], t_map_lidar: &Pose, map: &impl Surfaces, kernel: &Kernel, matches: &mut impl Matches) {
    let rotation = t_map_lidar.rotation.to_rotation_matrix();
    let translation = t_map_lidar.translation.vector;
    let (scale2, gate2) = (kernel.scale * kernel.scale, kernel.gate * kernel.gate);
    for Surfel { point: p, normal } in points {
        let normal = rotation * nalgebra::Vector3::new(f64::from(normal[0]), f64::from(normal[1]), f64::from(normal[2]));
        let arm = rotation * nalgebra::Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]));
        let at = [arm.x + translation.x, arm.y + translation.y, arm.z + translation.z];
        let Some((d, surface)) = map.nearest(at, [normal.x as f32, normal.y as f32, normal.z as f32]) else { continue };
        let d = d.map(f64::from);
        if surface.is_plane() {
            let n = surface.normal.map(f64::from);
            let r = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
            if r * r > gate2 {
                continue;
            }
            let robust = scale2 / (scale2 + r * r);
            let j = [n[0], n[1], n[2], arm.y * n[2] - arm.z * n[1], arm.z * n[0] - arm.x * n[2], arm.x * n[1] - arm.y * n[0]];
            matches.point(at, robust * robust);
            matches.row(j, r, f64::from(surface.weight) * robust * robust);
        } else {
            let r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            if r2 > gate2 {
                continue;
            }
            let robust = scale2 / (scale2 + r2);
            let weight = kernel.point_weight * f64::from(surface.weight) * robust * robust;
            matches.point(at, robust * robust);
            matches.row([1.0, 0.0, 0.0, 0.0, arm.z, -arm.y], d[0], weight);
            matches.row([0.0, 1.0, 0.0, -arm.z, 0.0, arm.x], d[1], weight);
            matches.row([0.0, 0.0, 1.0, arm.y, -arm.x, 0.0], d[2], weight);
        }
    }
}
