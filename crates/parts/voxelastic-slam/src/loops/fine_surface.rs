//! The surfaces of a map in finer voxels than places are compared in: what a loop edge between maps is measured by in the end.
//!
//! Scans have noise and holes, so places are compared in coarse voxels. The surfaces of a map are means of many scans, complete, and can be registered more finely.

use super::visible::{MapSurface, Visible};
use crate::free_space::{View, contradiction};
use crate::graph::{symmetric, upper_triangle};
use crate::registration::{Downsampler, LocalMap, RegistrationSettings, register};
use nalgebra::{Matrix6, Vector6};
use voxelastic::event::Edge;
use voxelastic::geometry::{Pose, PoseExt, Rigid};

/// Edge of the fine voxels, in voxels of places, and at least in voxels of the map: fewer points make no plane.
const EDGE: (f64, f64) = (0.33, 2.5);
/// Points per fine voxel edge.
const DENSITY: f64 = 3.0;
/// Surfaces within this distance of the nodes are registered, in voxels of places.
const RADIUS: f64 = 40.0;
/// Points that are registered, at most.
const MOST_POINTS: usize = 40_000;
/// Error to expect before, and the farthest that an edge may move, in voxels of places.
const REFINED_BY: f64 = 0.3;
const MOST: f64 = 1.0;
/// Standard deviations of an edge beside those of its registration, as submaps are not rigid: of the position in fine voxels, and of the rotation in degrees.
const SIGMA: (f64, f64) = (0.05, 0.05);

/// Edges of the voxels in which maps are compared, in voxels of the map: for what hides what, and for free space.
const COMPARED: (f64, f32) = (4.0, 2.0);
/// Points that are looked for from a pose, at most.
const MOST_COMPARED: usize = 20_000;

/// Points on the surfaces of a map, in its frame.
#[derive(Clone, Debug)]
pub(super) struct FineSurface {
    edge: f64,
    points: Vec<[f32; 3]>,
    /// Edge of the map's own voxels, metres.
    voxel: f32,
    visible: Visible,
}

impl FineSurface {
    /// Of a map whose places are compared in voxels of edge `voxel`, metres.
    pub(super) fn new(surface: &MapSurface<'_>, voxel: f64) -> Self {
        let edge = (EDGE.0 * voxel).max(EDGE.1 * f64::from(surface.voxel));
        let mut points = Vec::new();
        Downsampler::default().means(surface.positions, (edge / DENSITY) as f32, &mut points);
        let visible = Visible::new(surface, COMPARED.0 * f64::from(surface.voxel));
        Self { edge, points, voxel: surface.voxel, visible }
    }

    /// The points around a node, in its frame.
    fn around(&self, t_map_node: &Pose, radius: f64) -> impl Iterator<Item = [f64; 3]> {
        let (t_node_map, radius) = (Rigid::from(&t_map_node.inverse()), (radius * radius) as f32);
        let near = self.points.iter().map(move |p| t_node_map.apply(*p)).filter(move |p| p.iter().map(|v| v * v).sum::<f32>() < radius);
        near.map(|p| p.map(f64::from))
    }

    /// Share of the surfaces of one map that lie in space that the other saw to be free, from some poses in each: the larger of the two ways.
    pub(super) fn contradiction(&self, second: &Self, poses: (&[Pose], &[Pose]), t_first_second: &Pose) -> Option<f64> {
        let voxel = COMPARED.1 * self.voxel.max(second.voxel);
        let scans = |map: &Self, poses: &[Pose]| {
            let scan = |pose: &Pose| {
                let moved = Rigid::from(pose);
                let points: Vec<[f32; 3]> = map.visible.scan_of(pose, MOST_COMPARED).iter().map(|p| moved.apply(*p)).collect();
                (<[f32; 3]>::from(pose.translation.vector.map(|v| v as f32)), points)
            };
            poses.iter().map(scan).collect::<Vec<_>>()
        };
        let (first, other) = (scans(self, poses.0), scans(second, poses.1));
        contradiction(&views(&first), &views(&other), t_first_second, voxel)
    }

    /// The edge once more, by the surfaces around its nodes, which have these poses in the maps of `self` and of `second`. None if they do not fit, or
    /// hold the pose in fewer than six directions.
    pub(super) fn refined(&self, second: &Self, edge: &Edge, poses: (&Pose, &Pose), voxel: f64) -> Option<Edge> {
        let radius = RADIUS * voxel;
        let size = self.edge.max(second.edge);
        let levels = [size, 2.0 * size].map(|size| {
            let mut level = LocalMap::new(size);
            level.insert(self.around(poses.0, radius));
            level
        });
        let mut own = LocalMap::new(size);
        own.insert(second.around(poses.1, radius));
        let mut points = Vec::new();
        own.surfels(&mut points);
        let step = points.len().div_ceil(MOST_POINTS).max(1);
        let points: Vec<_> = points.into_iter().step_by(step).collect();
        let settings = RegistrationSettings { max_iterations: 40, convergence: 1e-4, least_scale: 0.1 * size, point_weight: 0.2 };
        let found = register(&points, &edge.t_from_to, &levels, REFINED_BY * voxel, &settings)?;
        if found.t_map_lidar.translation_distance(&edge.t_from_to) > MOST * voxel || !found.degenerate.is_empty() {
            return None;
        }
        let (position, angle) = ((SIGMA.0 * size).powi(2), SIGMA.1.to_radians().powi(2));
        let submaps = Matrix6::from_diagonal(&Vector6::new(position, position, position, angle, angle, angle));
        let registration = symmetric(&upper_triangle(&found.information(&points, &levels))).cholesky()?.inverse();
        let information = Some(upper_triangle(&(submaps + registration).cholesky()?.inverse()));
        Some(Edge { t_from_to: found.t_map_lidar, information, ..edge.clone() })
    }
}

fn views(scans: &[([f32; 3], Vec<[f32; 3]>)]) -> Vec<View<'_>> {
    scans.iter().map(|(origin, points)| View { origin: *origin, points }).collect()
}
