//! Where a robot that explores is to go, as messages: a path that moves with the map, and the frontier.

use crate::planner::Plan;
use crate::ros::messages::Shape;
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic_explore::FrontierCluster;
use voxelastic_plan::{Anchor, Point, resolve_anchors};

/// Colour and opacity of the frontier's boxes, and of its arrows.
const COLOURS: [[f32; 4]; 2] = [[1.0, 0.55, 0.1, 0.35], [1.0, 0.55, 0.1, 1.0]];
/// Length of the arrows, metres.
const ARROW: f64 = 1.0;
/// Least edge of the boxes, metres: clusters are often flat.
const THIN: f64 = 0.1;
/// A motion that is shorter than this along the floor has no direction, metres.
const SHORT: f64 = 1e-3;

/// The path that was published.
#[derive(Debug, Default)]
pub struct ShownPlan {
    path: Vec<Point>,
    anchors: Vec<Anchor>,
}

impl ShownPlan {
    /// The path of a new plan.
    pub fn set(&mut self, plan: &Plan) {
        (self.path, self.anchors) = (plan.path.clone(), plan.anchors.clone());
    }

    /// Moves the path with the map; returns whether it has moved. A waypoint whose scan the map does not have stays where it is.
    pub fn follow(&mut self, atlas: &Atlas) -> bool {
        let moved = resolve_anchors(atlas, &self.anchors);
        let mut has_moved = false;
        for (place, moved) in self.path.iter_mut().zip(moved) {
            if let Some(moved) = moved.filter(|moved| moved.iter().zip(&*place).any(|(a, b)| (a - b).abs() > 1e-6)) {
                (*place, has_moved) = (moved, true);
            }
        }
        has_moved
    }

    /// Its waypoints, each with x in the direction of the motion that leads to it along the floor; that of the first is the one that leads away.
    pub fn poses(&self) -> Vec<Pose> {
        let mut heading = self.path.windows(2).find_map(|motion| yaw(motion[0], motion[1])).unwrap_or(0.0);
        let mut before = self.path.first().copied();
        let pose = |place: &Point| {
            heading = before.replace(*place).and_then(|before| yaw(before, *place)).unwrap_or(heading);
            Pose::from_parts(Translation3::from(Vector3::from(*place)), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading))
        };
        self.path.iter().map(pose).collect()
    }
}

/// Direction of a motion along the floor, radians.
fn yaw(from: Point, to: Point) -> Option<f64> {
    let [x, y] = [to[0] - from[0], to[1] - from[1]];
    (x.hypot(y) > SHORT).then(|| y.atan2(x))
}

/// A box at the centre of each cluster, as large as that is, and an arrow from there towards what is unknown.
pub fn shapes(frontier: &[FrontierCluster]) -> Vec<Shape> {
    let boxes = frontier.iter().map(|cluster| {
        let [x, y, z] = cluster.centre;
        Shape::cuboid(Pose::translation(x, y, z), cluster.extent.map(|edge| edge.max(THIN)), COLOURS[0])
    });
    let arrows = frontier.iter().map(|cluster| {
        let rotation = Rotation3::rotation_between(&Vector3::x(), &Vector3::from(cluster.normal));
        // Opposite to x any half turn does.
        let rotation = rotation.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        let pose = Pose::from_parts(Translation3::from(Vector3::from(cluster.centre)), UnitQuaternion::from_rotation_matrix(&rotation));
        Shape::arrow(pose, ARROW, COLOURS[1])
    });
    boxes.chain(arrows).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn poses_look_along_the_path() {
        let plan = Plan { path: vec![[0.0; 3], [0.0, 2.0, 0.0], [0.0, 2.0, 1.0], [-1.0, 2.0, 1.0]], ..Plan::default() };
        let mut shown = ShownPlan::default();
        shown.set(&plan);
        let ahead: Vec<[f64; 3]> = shown.poses().iter().map(|pose| (pose.rotation * Vector3::x()).into()).collect();
        let expected = [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]];
        assert!(ahead.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9), "{ahead:?}");
        assert!(shown.poses().iter().zip(&plan.path).all(|(pose, place)| (pose * Point3::origin()) == Point3::from(*place)));
        assert!(ShownPlan::default().poses().is_empty());
    }
}
