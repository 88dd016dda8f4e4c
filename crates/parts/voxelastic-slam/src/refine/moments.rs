//! What a scan knows of a plane: sums over its surfels there, which hold for any pose.

use nalgebra::{Matrix3, Matrix4, Matrix4x3, Matrix4x6, Matrix6, Matrix6x3, Point3, Vector3, Vector4, Vector6};
use voxelastic::Pose;
use voxelastic::geometry::smallest_eigenvector;

/// Weight, mean and scatter (sum of weighted squares about the mean) of points of one scan on one plane, in its lidar frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cluster {
    pub(super) scan: u32,
    pub(super) weight: f32,
    pub(super) mean: [f32; 3],
    /// xx xy xz yy yz zz.
    pub(super) scatter: [f32; 6],
}

/// A plane in the map frame that fits clusters best, with two directions in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    pub(super) centre: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    pub(super) within: [Vector3<f64>; 2],
    /// Sum of weighted squares of the distances to it.
    pub(super) cost: f64,
}

/// A cluster about a plane: distances are `d + a u + b v` with the plane's own three unknowns, and follow from the pose of the scan.
pub(super) struct Linear {
    /// Sums of weighted products of derivatives by the pose with each other, with those by the plane, and with the distances.
    pub(super) pose: Matrix6<f64>,
    pub(super) both: Matrix6x3<f64>,
    pub(super) pull: Vector6<f64>,
    /// The same for the plane.
    pub(super) plane: Matrix3<f64>,
    pub(super) plane_pull: Vector3<f64>,
}

impl Cluster {
    /// Sums over weighted points in the lidar frame.
    pub(super) fn of(scan: u32, points: impl Iterator<Item = (f64, Vector3<f64>)> + Clone) -> Self {
        let (weight, sum) = points.clone().fold((0.0, Vector3::zeros()), |(weight, sum), (w, p)| (weight + w, sum + w * p));
        let mean: Vector3<f64> = sum / weight;
        let mut s = Matrix3::zeros();
        points.for_each(|(w, p)| s += w * (p - mean) * (p - mean).transpose());
        let scatter = [s.m11, s.m12, s.m13, s.m22, s.m23, s.m33].map(|v| v as f32);
        Self { scan, weight: weight as f32, mean: std::array::from_fn(|i| mean[i] as f32), scatter }
    }

    fn mean(&self) -> Vector3<f64> {
        Vector3::from(self.mean.map(f64::from))
    }

    fn scatter(&self) -> Matrix3<f64> {
        let [xx, xy, xz, yy, yz, zz] = self.scatter.map(f64::from);
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// Sums of the products of `[point 1]` with itself.
    fn homogeneous(&self) -> Matrix4<f64> {
        let (w, m) = (f64::from(self.weight), self.mean());
        let mut out = Matrix4::zeros();
        out.fixed_view_mut::<3, 3>(0, 0).copy_from(&(self.scatter() + w * m * m.transpose()));
        out.fixed_view_mut::<3, 1>(0, 3).copy_from(&(w * m));
        out.fixed_view_mut::<1, 3>(3, 0).copy_from(&(w * m.transpose()));
        out[(3, 3)] = w;
        out
    }

    /// The cluster about a plane, its scan at a pose. Steps are those of `pose * exp(step)`, rotation first.
    pub(super) fn linear(&self, t_map_lidar: &Pose, plane: &Fitted) -> Linear {
        let to_lidar = t_map_lidar.rotation.inverse();
        let from_centre = t_map_lidar.translation.vector - plane.centre;
        // Distances and places on the plane are linear in [point 1].
        let along = |direction: &Vector3<f64>| {
            let q = to_lidar * direction;
            Vector4::new(q.x, q.y, q.z, direction.dot(&from_centre))
        };
        let (distance, u, v) = (along(&plane.normal), along(&plane.within[0]), along(&plane.within[1]));
        let places = Matrix4x3::from_columns(&[Vector4::new(0.0, 0.0, 0.0, 1.0), u, v]);
        // A turn w and a step t of the pose move a point p by q . (w x p + t) = w . (p x q) + t . q.
        let q = Vector3::new(distance.x, distance.y, distance.z);
        let mut derivative = Matrix4x6::zeros();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::new(0.0, -q.z, q.y, q.z, 0.0, -q.x, -q.y, q.x, 0.0));
        derivative.fixed_view_mut::<1, 3>(3, 3).copy_from(&q.transpose());
        let moments = self.homogeneous();
        let (by_pose, by_plane) = (moments * derivative, moments * places);
        Linear {
            pose: derivative.tr_mul(&by_pose),
            both: by_pose.tr_mul(&places),
            pull: by_pose.tr_mul(&distance),
            plane: places.tr_mul(&by_plane),
            plane_pull: by_plane.tr_mul(&distance),
        }
    }
}

/// The plane that fits clusters best where poses put them. None if they are a line.
pub(super) fn fit(clusters: &[Cluster], poses: &[Pose]) -> Option<Fitted> {
    let first = clusters.first()?;
    let place = |cluster: &Cluster| (poses[cluster.scan as usize] * Point3::from(cluster.mean())).coords;
    let near = place(first);
    let (mut weight, mut sum, mut squares) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for cluster in clusters {
        let rotation = poses[cluster.scan as usize].rotation.to_rotation_matrix();
        let (w, mean) = (f64::from(cluster.weight), place(cluster) - near);
        weight += w;
        sum += w * mean;
        squares += rotation * cluster.scatter() * rotation.transpose() + w * mean * mean.transpose();
    }
    let mean = sum / weight;
    let s = squares - weight * mean * mean.transpose();
    let normal = Vector3::from(smallest_eigenvector([s.m11, s.m12, s.m13, s.m22, s.m23, s.m33]).1?);
    let u = normal.cross(&if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() }).normalize();
    Some(Fitted { centre: near + mean, normal, within: [u, normal.cross(&u)], cost: normal.dot(&(s * normal)).max(0.0) })
}
