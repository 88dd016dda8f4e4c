//! Eigenvalues of covariances in closed form.

/// A symmetric matrix: xx, xy, xz, yy, yz, zz.
pub(super) type Symmetric = [f64; 6];

/// The eigenvalues of a symmetric matrix, smallest first, and the unit eigenvector of the smallest; none if all vectors are.
pub(super) fn smallest(m: &Symmetric) -> Option<([f64; 3], [f64; 3])> {
    let [xx, xy, xz, yy, yz, zz] = *m;
    let mean = (xx + yy + zz) / 3.0;
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    let p = ((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0).sqrt();
    if p <= 1e-12 * mean.abs() || !p.is_finite() {
        return None;
    }
    let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    let angle = (determinant / (2.0 * p * p * p)).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * p * angle.cos();
    let least = mean + 2.0 * p * (angle + std::f64::consts::TAU / 3.0).cos();
    let values = [least, 3.0 * mean - largest - least, largest];
    // The eigenvector is perpendicular to all rows of the matrix minus the eigenvalue: the longest of their cross products is the most exact.
    let rows = [[xx - least, xy, xz], [xy, yy - least, yz], [xz, yz, zz - least]];
    let crosses = [cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])];
    let square = |v: &[f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
    let longest = crosses.into_iter().max_by(|a, b| square(a).total_cmp(&square(b)))?;
    let length = square(&longest).sqrt();
    (length > 1e-14 * p * p).then(|| (values, longest.map(|c| c / length)))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn they_are_those_of_the_iterative_solution(points in prop::collection::vec(prop::array::uniform3(-1f64..1.0), 4..12), flat in 1e-4f64..1.0) {
            let mut m = [0.0; 6];
            for p in &points {
                let [x, y, z] = [p[0], p[1] + 0.3 * p[0], flat * p[2] + 0.5 * p[0]];
                [x * x, x * y, x * z, y * y, y * z, z * z].into_iter().zip(&mut m).for_each(|(v, m)| *m += v);
            }
            let [xx, xy, xz, yy, yz, zz] = m;
            let expected = nalgebra::SymmetricEigen::new(nalgebra::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
            let mut order = [0, 1, 2];
            order.sort_by(|&a, &b| expected.eigenvalues[a].total_cmp(&expected.eigenvalues[b]));
            let (values, normal) = smallest(&m).unwrap();
            for k in 0..3 {
                prop_assert!((values[k] - expected.eigenvalues[order[k]]).abs() < 1e-9 * values[2], "{values:?}");
            }
            let vector = expected.eigenvectors.column(order[0]);
            let cosine: f64 = (0..3).map(|k| vector[k] * normal[k]).sum();
            prop_assert!(values[1] - values[0] < 1e-4 * values[2] || cosine.abs() > 1.0 - 1e-6, "{cosine}");
        }
    }
}
