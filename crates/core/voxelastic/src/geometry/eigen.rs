//! Eigenvalues and the smallest eigenvector of a symmetric 3 x 3 matrix, in closed form.

/// Eigenvalues in ascending order and the unit eigenvector of the smallest, of the matrix `xx xy xz yy yz zz`.
/// The vector is `None` where the two smallest eigenvalues are (nearly) the same.
pub fn smallest_eigenvector([xx, xy, xz, yy, yz, zz]: [f64; 6]) -> ([f64; 3], Option<[f64; 3]>) {
    let mean = (xx + yy + zz) / 3.0;
    let off = xy * xy + xz * xz + yz * yz;
    let (dx, dy, dz) = (xx - mean, yy - mean, zz - mean);
    let p = ((dx * dx + dy * dy + dz * dz + 2.0 * off) / 6.0).sqrt();
    if p <= 1e-12 * mean.abs() || p == 0.0 {
        return ([mean; 3], None);
    }
    let determinant = dx * (dy * dz - yz * yz) - xy * (xy * dz - yz * xz) + xz * (xy * yz - dy * xz);
    let angle = (determinant / (2.0 * p * p * p)).clamp(-1.0, 1.0).acos() / 3.0;
    let high = mean + 2.0 * p * angle.cos();
    let low = mean + 2.0 * p * (angle + std::f64::consts::TAU / 3.0).cos();
    let values = [low, 3.0 * mean - low - high, high];
    // The vector is orthogonal to all rows of A - low I: the largest of their cross products.
    let rows = [[xx - low, xy, xz], [xy, yy - low, yz], [xz, yz, zz - low]];
    let products = [cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])];
    let norm2 = |v: &[f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let mut best = products[0];
    for product in &products[1..] {
        if norm2(product) > norm2(&best) {
            best = *product;
        }
    }
    let length = norm2(&best).sqrt();
    (values, (length > 1e-12 * p * p).then(|| best.map(|v| v / length)))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, SymmetricEigen};

    #[test]
    fn agrees_with_the_iterative_solution() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for _ in 0..1000 {
            let a = Matrix3::from_fn(|_, _| random());
            let m = a * a.transpose();
            let (values, vector) = smallest_eigenvector([m.m11, m.m12, m.m13, m.m22, m.m23, m.m33]);
            let mut reference: Vec<f64> = SymmetricEigen::new(m).eigenvalues.iter().copied().collect();
            reference.sort_by(f64::total_cmp);
            for (value, reference) in values.iter().zip(&reference) {
                assert!((value - reference).abs() < 1e-8, "{values:?} {reference:?}");
            }
            let v = nalgebra::Vector3::from(vector.unwrap());
            assert!((m * v - v * values[0]).norm() < 1e-5);
        }
        assert!(smallest_eigenvector([2.0, 0.0, 0.0, 2.0, 0.0, 2.0]).1.is_none());
    }
}
