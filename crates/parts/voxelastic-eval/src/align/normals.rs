//! Normals of a cloud from the covariance of each point's neighbours.

use crate::cloud_distance::PointIndex;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// Neighbours per plane, the point itself included.
const NEIGHBOURS: NonZero<usize> = NonZero::new(16).unwrap();
/// Largest ratio of the smallest to the middle variance of a plane.
const MAX_THICKNESS: f64 = 0.25;

/// Unit normals (of either sign) of finite `points`, zero where the neighbourhood is not flat. `index` must be over the same points.
pub(super) fn estimate(points: &[[f32; 3]], index: &PointIndex) -> Vec<[f32; 3]> {
    points.par_iter().map(|p| normal(points, &index.nearest_k(*p, NEIGHBOURS))).collect()
}

fn normal(points: &[[f32; 3]], near: &[usize]) -> [f32; 3] {
    if near.len() < 4 {
        return [0.0; 3];
    }
    let origin = Vector3::from(points[near[0]]).cast::<f64>();
    let (mut sum, mut squares) = (Vector3::zeros(), Matrix3::zeros());
    for &i in near {
        let v = Vector3::from(points[i]).cast::<f64>() - origin;
        sum += v;
        squares += v * v.transpose();
    }
    let n = near.len() as f64;
    let covariance = squares / n - (sum / n) * (sum / n).transpose();
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let (thin, wide) = (eigen.eigenvalues[order[0]].max(0.0), eigen.eigenvalues[order[1]]);
    // Neighbours in a line are no plane either: its normal is not determined.
    if wide.is_nan() || wide <= 1e-12 || thin > MAX_THICKNESS * wide || wide < 1e-3 * eigen.eigenvalues[order[2]] {
        return [0.0; 3];
    }
    eigen.eigenvectors.column(order[0]).map(|c| c as f32).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_planes_have_normals() {
        let plane: Vec<[f32; 3]> = (0..100).map(|i| ((i % 10) as f32, (i / 10) as f32)).map(|(x, y)| [x, y, 0.5 * x]).collect();
        let n = estimate(&plane, &PointIndex::new(&plane, "a cloud").unwrap())[55];
        let expected = [-0.5f32 / 1.25f32.sqrt(), 0.0, 1.0 / 1.25f32.sqrt()];
        assert!((0..3).map(|k| n[k] * expected[k]).sum::<f32>().abs() > 0.9999, "{n:?}");
        let line: Vec<[f32; 3]> = (0..50).map(|i| [i as f32, 0.0, 0.0]).collect();
        assert_eq!(estimate(&line, &PointIndex::new(&line, "a cloud").unwrap())[20], [0.0; 3]);
        let lump: Vec<[f32; 3]> = (0..27).map(|i| [(i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32]).collect();
        assert_eq!(estimate(&lump, &PointIndex::new(&lump, "a cloud").unwrap())[13], [0.0; 3]);
    }
}
