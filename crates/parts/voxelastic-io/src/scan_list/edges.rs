//! Odometry and loop edges between scans.

use super::scan_entry::ScanEntry;
use crate::PoseGraph;
use nalgebra::{Matrix3, Matrix6};
use std::collections::{HashMap, HashSet};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// Edges between scans, in lidar frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScanEdges {
    /// Measured odometry by its two nodes, the smaller first.
    odometry: HashMap<(NodeId, NodeId), Vec<Edge>>,
    /// Loop edges whose both ends are scans, in the order of the graph's file.
    pub(crate) loops: Vec<Edge>,
    /// Loop edges of the graph that join nodes without a scan.
    pub(crate) loops_without_scan: usize,
}

impl ScanEdges {
    pub(crate) fn of(graph: Option<&PoseGraph>, scans: &[ScanEntry], t_base_lidar: Option<&Pose>) -> Self {
        let mut edges = Self::default();
        let Some(graph) = graph else { return edges };
        let (odometry, loops) = graph.split_edges();
        for edge in odometry {
            let key = (edge.from.min(edge.to), edge.from.max(edge.to));
            edges.odometry.entry(key).or_default().push(in_lidar_frame(edge, t_base_lidar));
        }
        edges.loops = loops.into_iter().map(|e| in_lidar_frame(e, t_base_lidar)).collect();
        edges.loops_without_scan = edges.retain(scans);
        edges
    }

    /// Drops loop edges that join nodes without a scan and returns their number.
    pub(crate) fn retain(&mut self, scans: &[ScanEntry]) -> usize {
        let nodes: HashSet<NodeId> = scans.iter().map(|s| s.node).collect();
        let before = self.loops.len();
        self.loops.retain(|e| nodes.contains(&e.from) && nodes.contains(&e.to));
        before - self.loops.len()
    }

    /// Whether there is none.
    pub(crate) fn is_empty(&self) -> bool {
        self.odometry.is_empty() && self.loops.is_empty()
    }

    /// The measured motion from one scan to the next, if there is one.
    pub(crate) fn measured(&self, from: &ScanEntry, to: &ScanEntry) -> Option<Pose> {
        let edge = self.odometry.get(&(from.node.min(to.node), from.node.max(to.node)))?.first()?;
        Some(if edge.from == from.node { edge.t_from_to } else { edge.t_from_to.inverse() })
    }

    /// Odometry edges from one scan to the next: as measured, else from their poses.
    pub(crate) fn odometry(&self, from: &ScanEntry, to: &ScanEntry) -> Vec<Edge> {
        let measured = self.odometry.get(&(from.node.min(to.node), from.node.max(to.node)));
        measured.cloned().unwrap_or_else(|| {
            let t_from_to = from.t_map_lidar.inv_mul(&to.t_map_lidar);
            vec![Edge { from: from.node, to: to.node, t_from_to, information: None }]
        })
    }
}

/// Converts an edge between base frames into one between lidar frames.
fn in_lidar_frame(edge: &Edge, t_base_lidar: Option<&Pose>) -> Edge {
    let Some(x) = t_base_lidar else { return edge.clone() };
    let information = edge.information.map(|upper| upper_of(&moved_information(&symmetric(&upper), x)));
    Edge { t_from_to: x.inv_mul(&(edge.t_from_to * x)), information, ..*edge }
}

/// Converts information about a small motion of the base (metres, then radians) into information about the lidar's: the adjoint of
/// `t_base_lidar` maps small motions of the lidar to those of the base.
fn moved_information(information: &Matrix6<f64>, t_base_lidar: &Pose) -> Matrix6<f64> {
    let rotation: Matrix3<f64> = *t_base_lidar.rotation.to_rotation_matrix().matrix();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(t_base_lidar.translation.vector.cross_matrix() * rotation));
    adjoint.transpose() * information * adjoint
}

fn symmetric(upper: &[f64; 21]) -> Matrix6<f64> {
    let mut values = upper.iter();
    let mut matrix = Matrix6::zeros();
    for row in 0..6 {
        for column in row..6 {
            let value = values.next().copied().unwrap_or(0.0);
            (matrix[(row, column)], matrix[(column, row)]) = (value, value);
        }
    }
    matrix
}

fn upper_of(matrix: &Matrix6<f64>) -> [f64; 21] {
    let mut upper = [0.0; 21];
    let places = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    upper.iter_mut().zip(places).for_each(|(slot, place)| *slot = matrix[place]);
    upper
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3, Vector6};

    fn pose(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Pose {
        Pose::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }

    /// A small motion, to first order.
    fn small(d: &Vector6<f64>) -> Pose {
        Pose::from_parts(Vector3::new(d[0], d[1], d[2]).into(), UnitQuaternion::from_scaled_axis(Vector3::new(d[3], d[4], d[5])))
    }

    #[test]
    fn edges_follow_the_lidar_poses() {
        let t_base_lidar = pose(0.3, -0.1, 0.8, 0.1, 0.2, 1.5);
        let (a, b) = (pose(1.0, 2.0, 3.0, 0.0, 0.1, 0.2), pose(4.0, 1.0, 3.5, 0.1, -0.1, 2.0));
        let base = Edge { from: 0, to: 1, t_from_to: a.inv_mul(&b), information: None };
        let lidar = in_lidar_frame(&base, Some(&t_base_lidar));
        let expected = (a * t_base_lidar).inv_mul(&(b * t_base_lidar));
        assert!((lidar.t_from_to.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-12);
    }

    #[test]
    fn information_measures_the_same_motion() {
        let x = pose(0.3, -0.1, 0.8, 0.1, 0.2, 1.5);
        let mut upper = [0.0; 21];
        upper.iter_mut().enumerate().for_each(|(k, v)| *v = 1.0 + k as f64 * 0.1);
        let base = symmetric(&upper);
        assert_eq!(upper_of(&base), upper);
        let lidar = moved_information(&base, &x);
        let d = Vector6::new(1.0, -2.0, 0.5, 0.7, 0.2, -0.4) * 1e-6;
        // The base moves by x d x^-1 when the lidar moves by d.
        let moved = x * small(&d) * x.inverse();
        let mut base_motion = Vector6::zeros();
        base_motion.fixed_rows_mut::<3>(0).copy_from(&moved.translation.vector);
        base_motion.fixed_rows_mut::<3>(3).copy_from(&moved.rotation.scaled_axis());
        let (lhs, rhs) = ((d.transpose() * lidar * d)[0], (base_motion.transpose() * base * base_motion)[0]);
        assert!((lhs - rhs).abs() < 1e-5 * rhs.abs(), "{lhs} {rhs}");
    }
}
