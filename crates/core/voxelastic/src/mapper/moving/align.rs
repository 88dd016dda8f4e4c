//! Where a view was, as seen from a scan that is judged by it: poses are wrong by centimetres within metres, and surfaces at flat angles then look void.

use super::packed_plane::PackedPlane;
use super::view::{PlacedView, View};
use crate::geometry::{Pose, Rigid};
use crate::sensor::{BeamModel, OUTSIDE, PROJECT_CHUNK, project_chunk};
use nalgebra::{Matrix6, Vector3, Vector6};

/// Points farther from the plane where they fall are not on it, in each step, metres.
const ON_PLANE: [f32; 2] = [0.3, 0.15];
/// Nor are those that differ more in range from the return there: metres, and per metre of range.
const SAME_RANGE: [f32; 2] = [0.5, 0.05];
/// With fewer points on planes, the pose stays as it is.
const LEAST: usize = 100;
/// Weight of the pose as it is, in points.
const PRIOR: f64 = 0.01;
/// Larger corrections are none, metres and radians.
const LARGEST: [f64; 2] = [0.4, 0.02];

/// A view from where it was, by the planes that it saw and points of static surfaces, submap frame, metres.
pub(super) fn aligned<'a>(view: &'a View, points: &[[f32; 3]], model: &BeamModel) -> PlacedView<'a> {
    let as_known = view.t_submap_lidar.inverse();
    let mut t_lidar_submap = as_known;
    let mut distances = [0.0; ON_PLANE.len()];
    for (step, &gate) in ON_PLANE.iter().enumerate() {
        let sums = Sums::of(view, &Rigid::from(&t_lidar_submap), points, model, gate);
        if sums.count < LEAST {
            return view.as_known();
        }
        distances[step] = sums.distance / sums.count as f64;
        let matrix = sums.matrix + Matrix6::identity() * (PRIOR * sums.count as f64);
        let Some(x) = matrix.cholesky().map(|matrix| matrix.solve(&sums.right)) else { return view.as_known() };
        t_lidar_submap = Pose::new(Vector3::new(x[0], x[1], x[2]), Vector3::new(x[3], x[4], x[5])) * t_lidar_submap;
    }
    let by = t_lidar_submap * view.t_submap_lidar;
    if by.translation.vector.norm() > LARGEST[0] || by.rotation.angle() > LARGEST[1] {
        return view.as_known();
    }
    PlacedView { view, t_lidar_submap: Rigid::from(&t_lidar_submap), slip: 0.0, was_off: (distances[0] - distances[1]).max(0.0) as f32 }
}

/// The normal equations of points on planes.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    matrix: Matrix6<f64>,
    right: Vector6<f64>,
    /// Sum of distances to the planes, metres.
    distance: f64,
    count: usize,
}

impl Sums {
    fn of(view: &View, t_lidar_submap: &Rigid, points: &[[f32; 3]], model: &BeamModel, gate: f32) -> Self {
        let mut sums = Self::default();
        let (mut pixels, mut ranges) = ([0; PROJECT_CHUNK], [0.0; PROJECT_CHUNK]);
        for points in points.chunks(PROJECT_CHUNK) {
            let points: Vec<[f32; 3]> = points.iter().map(|p| t_lidar_submap.apply(*p)).collect();
            project_chunk(&points, model, &mut pixels[..points.len()], &mut ranges[..points.len()]);
            for ((point, &pixel), &range) in points.iter().zip(&pixels).zip(&ranges).filter(|((_, pixel), _)| **pixel < OUTSIDE) {
                let (plane, of_return) = view.at(pixel, model);
                if (of_return - range).abs() < SAME_RANGE[0] + SAME_RANGE[1] * range {
                    sums.add(plane, *point, gate);
                }
            }
        }
        sums
    }

    fn add(&mut self, plane: PackedPlane, point: [f32; 3], gate: f32) {
        let Some(height) = plane.height(point).filter(|height| height.abs() < gate) else { return };
        let (p, n) = (Vector3::from(point.map(f64::from)), Vector3::from(plane.normal().map(f64::from)));
        let lever = p.cross(&n);
        let row = Vector6::new(n.x, n.y, n.z, lever.x, lever.y, lever.z);
        self.matrix += row * row.transpose();
        self.right -= row * f64::from(height);
        self.distance += f64::from(height.abs());
        self.count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::super::cells::Cells;
    use super::super::view::Care;
    use super::*;
    use crate::Cloud;
    use crate::geometry::PoseExt;
    use crate::sensor::{CloudLayout, RangeLimits, ScanPreprocessor};
    use proptest::prelude::*;
    use std::sync::Arc;

    /// Points on the walls, the floor and the ceiling of a room around the sensor, in pixel order.
    fn room(model: &BeamModel, size: [f32; 3]) -> Cloud {
        let (rows, columns) = (model.rows(), model.columns());
        let points = (0..rows * columns).map(|pixel| {
            let d = model.direction((pixel / columns) as f32, (pixel % columns) as f32);
            let range = (0..3).map(|k| size[k] / d[k].abs()).fold(f32::MAX, f32::min);
            d.map(|c| c * range)
        });
        Cloud { width: columns, height: rows, ..Cloud::from_points(points.collect()) }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_wrong_pose_is_put_right(off in prop::array::uniform3(-0.12f64..0.12), turn in prop::array::uniform3(-0.005f64..0.005)) {
            let model = BeamModel::even(32, 360, 0.5, -0.5).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let cloud = room(&model, [6.0, 4.0, 1.8]);
            let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), RangeLimits { near: 0.1, max: 60.0 });
            let cells = Arc::new(Cells::new(preprocessor.prepare(&cloud)));
            let wrong = Pose::new(Vector3::from(off), Vector3::from(turn));
            let view = View::new(1, &wrong, &cells, &model, Care::NEAR);
            let points: Vec<[f32; 3]> = cloud.points.iter().step_by(7).copied().collect();
            let placed_view = aligned(&view, &points, &model);
            // The points are in the submap where they were measured: the view was at its origin.
            for p in points.iter().step_by(50) {
                let q = placed_view.t_lidar_submap.apply(*p);
                let error = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt();
                prop_assert!(error < 0.03, "{error} m off at {p:?}");
            }
            prop_assert!(wrong.translation_distance(&Pose::identity()) < 0.02 || placed_view.was_off > 0.0);
        }
    }

    #[test]
    fn a_view_of_little_stays_as_it_is_known() {
        let model = BeamModel::even(8, 36, 0.5, -0.5).unwrap();
        let cells = Arc::new(Cells::new(&crate::sensor::PreparedScan {
            image: crate::sensor::RangeImage { rows: 8, columns: 36, ranges: vec![0.0; 8 * 36], points: vec![u32::MAX; 8 * 36] },
            ..Default::default()
        }));
        let view = View::new(1, &Pose::translation(1.0, 0.0, 0.0), &cells, &model, Care::NEAR);
        assert_eq!(aligned(&view, &[[3.0, 0.0, 0.0]; 500], &model).t_lidar_submap.apply([1.0, 0.0, 0.0]), [0.0; 3]);
    }
}
