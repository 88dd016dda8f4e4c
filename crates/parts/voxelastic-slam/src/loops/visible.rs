//! Scans of a map: what of its surfaces can be seen from where its scans were taken.
//!
//! A saved map has no scans any more. These stand in for them, so that places of maps are compared as those of recordings are, with rays that end at the
//! first surface: the free-space veto needs that.

use super::place::Keyframe;
use crate::registration::{VoxelIndex, key};
use voxelastic::event::NodeId;
use voxelastic::geometry::{Pose, Rigid};

/// Surfaces farther than this are not looked at, in voxels.
const RADIUS: f64 = 90.0;
/// Points that a scan of a place looks for, at most.
const MOST_POINTS: usize = 4000;
/// Points of the surface that are kept, per voxel edge.
const DENSITY: f32 = 3.0;
/// Length of the mean of unit normals below which they point to more than one side.
const ONE_SIDED: f32 = 0.6;

/// The surfaces of a map, in its frame: of each point its position, metres, and its unit normal towards free space.
#[derive(Clone, Copy, Debug)]
pub struct MapSurface<'a> {
    /// Positions, metres.
    pub positions: &'a [[f32; 3]],
    /// Normals, as many.
    pub normals: &'a [[f32; 3]],
    /// Edge of the map's finest voxels, metres.
    pub voxel: f32,
}

/// Means of the surface points in cells of one size.
#[derive(Clone, Debug)]
struct Cells {
    edge: f32,
    index: VoxelIndex,
    /// Sum of positions, sum of normals, and number.
    sums: Vec<([f32; 3], [f32; 3], f32)>,
}

/// A piece of surface: its centre, and its normal, which is shorter than 1 where it is not flat.
#[derive(Clone, Copy, Debug)]
struct Facet {
    centre: [f32; 3],
    normal: [f32; 3],
}

/// The surfaces of a map, prepared for looking at them.
#[derive(Clone, Debug)]
pub(super) struct Visible {
    points: Vec<Facet>,
    /// What hides others.
    walls: Cells,
    voxel: f32,
}

impl Cells {
    fn new(surface: &MapSurface<'_>, edge: f32) -> Self {
        let mut cells = Self { edge, index: VoxelIndex::default(), sums: Vec::new() };
        for (p, n) in surface.positions.iter().zip(surface.normals) {
            let (at, is_new) = cells.index.get_or_insert(cells.key(*p), cells.sums.len() as u32);
            if is_new {
                cells.sums.push(([0.0; 3], [0.0; 3], 0.0));
            }
            let (sum, normal, count) = &mut cells.sums[at as usize];
            (0..3).for_each(|k| sum[k] += p[k]);
            (0..3).for_each(|k| normal[k] += n[k]);
            *count += 1.0;
        }
        cells
    }

    fn key(&self, p: [f32; 3]) -> u64 {
        key(p.map(|v| (v / self.edge).floor() as i32))
    }

    fn facet(&self, at: usize) -> Facet {
        let (sum, normal, count) = &self.sums[at];
        Facet { centre: sum.map(|v| v / count), normal: normal.map(|v| v / count) }
    }

    fn at(&self, p: [f32; 3]) -> Option<Facet> {
        self.index.get(self.key(p)).map(|at| self.facet(at as usize))
    }
}

impl Facet {
    fn is_one_sided(&self) -> bool {
        dot(self.normal, self.normal) > ONE_SIDED * ONE_SIDED
    }

    /// Distance of a point to its plane, positive in front.
    fn height(&self, p: [f32; 3]) -> f32 {
        dot(self.normal, minus(p, self.centre))
    }

    /// Whether it hides `target` from `eye`, if the line between them passes it: they are on different sides, or it has more sides than one.
    fn hides(&self, target: [f32; 3], eye: [f32; 3], tolerance: f32) -> bool {
        if !self.is_one_sided() {
            return true;
        }
        let (behind, before) = (self.height(target), self.height(eye));
        behind * before < 0.0 && behind.abs() > tolerance
    }
}

impl Visible {
    pub(super) fn new(surface: &MapSurface<'_>, voxel: f64) -> Self {
        let voxel = voxel as f32;
        let points = Cells::new(surface, voxel / DENSITY);
        Self { points: (0..points.sums.len()).map(|at| points.facet(at)).collect(), walls: Cells::new(surface, voxel), voxel }
    }

    /// What can be seen from a pose: points in the lidar frame.
    pub(super) fn scan(&self, t_map_lidar: &Pose) -> Vec<[f32; 3]> {
        self.scan_of(t_map_lidar, MOST_POINTS)
    }

    /// The same, of so many candidates at most.
    pub(super) fn scan_of(&self, t_map_lidar: &Pose, most: usize) -> Vec<[f32; 3]> {
        let (eye, radius) = (t_map_lidar.translation.vector.map(|v| v as f32).into(), RADIUS as f32 * self.voxel);
        let is_turned_to = |facet: &&Facet| !facet.is_one_sided() || facet.height(eye) > 0.0;
        let is_near = |facet: &&Facet| length(minus(facet.centre, eye)) < radius;
        let candidates: Vec<&Facet> = self.points.iter().filter(is_near).filter(is_turned_to).collect();
        let step = candidates.len().div_ceil(most).max(1);
        let t_lidar_map = Rigid::from(&t_map_lidar.inverse());
        let seen = candidates.into_iter().step_by(step).filter(|facet| self.is_seen(eye, facet.centre));
        seen.map(|facet| t_lidar_map.apply(facet.centre)).collect()
    }

    /// The scan at a node, as loop closures take it.
    pub(super) fn keyframe(&self, (node, t_map_lidar): (NodeId, Pose), piece: usize, path: f64) -> Keyframe {
        Keyframe { node, t_map_lidar, piece, path, points: self.scan(&t_map_lidar) }
    }

    /// Whether no surface is between the eye and a point.
    fn is_seen(&self, eye: [f32; 3], target: [f32; 3]) -> bool {
        let way = minus(target, eye);
        let far = length(way);
        let step = 0.5 * self.voxel;
        // What is next to either end hides nothing.
        let steps = ((far - 1.5 * self.voxel) / step).floor().max(0.0) as usize;
        (2..=steps).all(|k| {
            let at = k as f32 * step / far;
            let p = std::array::from_fn(|i| eye[i] + at * way[i]);
            self.walls.at(p).is_none_or(|wall| !wall.hides(target, eye, 0.5 * self.voxel))
        })
    }
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn length(a: [f32; 3]) -> f32 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_hide_what_is_behind_them_and_floors_do_not_hide_themselves() {
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        let mut add = |p: [f32; 3], n: [f32; 3]| {
            positions.push(p);
            normals.push(n);
        };
        let grid = |rows: u32, columns: u32| (0..rows).flat_map(move |i| (0..columns).map(move |j| (0.05 * i as f32, 0.05 * j as f32)));
        // A floor of 20 x 4 m, a wall of 2 m across half of it at 10 m, seen from both sides, and one across all of it at 16 m.
        grid(400, 80).for_each(|(u, v)| add([u, v - 2.0, 0.0], [0.0, 0.0, 1.0]));
        for (u, v) in grid(40, 40) {
            add([10.0, v, u], [-1.0, 0.0, 0.0]);
            add([10.2, v, u], [1.0, 0.0, 0.0]);
        }
        grid(80, 80).for_each(|(u, v)| add([16.0, v - 2.0, u], [-1.0, 0.0, 0.0]));
        let visible = Visible::new(&MapSurface { positions: &positions, normals: &normals, voxel: 0.05 }, 0.2);
        let pose = Pose::translation(1.0, 0.0, 1.0) * Pose::rotation(nalgebra::Vector3::new(0.0, 0.0, 0.5));
        let seen: Vec<[f32; 3]> = visible.scan(&pose).iter().map(|p| Rigid::from(&pose).apply(*p)).collect();
        let count = |is: &dyn Fn(&[f32; 3]) -> bool| seen.iter().filter(|p| is(p)).count();
        assert!(count(&|p| p[2] < 0.05 && p[0] > 13.0 && p[1] < -0.5) > 50, "the floor beside the wall, far away");
        let of_wall = |low: f32, high: f32| count(&|p| p[2] > 0.3 && p[0] > low && p[0] < high);
        assert!(of_wall(9.9, 10.1) > 100 && of_wall(10.15, 10.25) == 0, "the side that faces the sensor: {}", of_wall(9.9, 10.1));
        assert_eq!(count(&|p| p[2] < 0.05 && p[0] > 11.0 && p[0] < 17.0 && p[1] > 0.5), 0, "the floor behind the wall");
        let of_end = |low: f32, high: f32| count(&|p| p[0] > 15.9 && p[2] > low && p[2] < high && p[1] > 0.5);
        assert!(of_end(-1.0, 1.0) == 0 && of_end(2.9, 5.0) > 10, "the wall at the end: {} low, {} high", of_end(-1.0, 1.0), of_end(2.9, 5.0));
    }
}
