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

/// The two smallest eigenvalues, and the unit eigenvector of the smallest, of one positive semidefinite matrix a lane, written as for [`smallest_eigenvector`]: branch-free,
/// for loops that the compiler vectorises. The vector is zero where there is none. Where the two smallest values are nearly the same, they may be wrong by a
/// hundredth of the largest.
#[inline(always)]
pub(crate) fn smallest_eigenvectors<const N: usize>([xx, xy, xz, yy, yz, zz]: &[[f64; N]; 6]) -> ([[f64; N]; 2], [[f64; N]; 3]) {
    /// Newton's method from below converges at once where the smallest value is far from the others, else by halves.
    const STEPS: usize = 9;
    let (mut values, mut vector) = ([[0.0; N]; 2], [[0.0; N]; 3]);
    for l in 0..N {
        let [xx, xy, xz, yy, yz, zz] = [xx[l], xy[l], xz[l], yy[l], yz[l], zz[l]];
        let trace = xx + yy + zz;
        let minors = (xx * yy - xy * xy) + (xx * zz - xz * xz) + (yy * zz - yz * yz);
        let determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
        let mut low = 0.0;
        for _ in 0..STEPS {
            let value = determinant - low * (minors - low * (trace - low));
            let slope = minors - low * (2.0 * trace - 3.0 * low);
            // Past the root, or at a double one, rounding decides: no step.
            let step = value / if slope > 0.0 { slope } else { 1.0 };
            low += if (slope > 0.0) & (value > 0.0) { step } else { 0.0 };
        }
        // The other two solve x² - (trace - low) x + product = 0.
        let (sum, product) = (trace - low, minors - low * (trace - low));
        let root = sum * sum - 4.0 * product;
        values[0][l] = low;
        values[1][l] = 0.5 * (sum - if root > 0.0 { root } else { 0.0 }.sqrt());
        let rows = [[xx - low, xy, xz], [xy, yy - low, yz], [xz, yz, zz - low]];
        let products = [cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])];
        let norms = products.map(|v| v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        let (mut best, mut norm) = (products[0], norms[0]);
        for i in 1..3 {
            let is_longer = norms[i] > norm;
            norm = if is_longer { norms[i] } else { norm };
            best = [0, 1, 2].map(|k| if is_longer { products[i][k] } else { best[k] });
        }
        let length = norm.sqrt();
        let is_vector = length > 1e-12 * trace * trace;
        let per_length = if is_vector { 1.0 / if is_vector { length } else { 1.0 } } else { 0.0 };
        (0..3).for_each(|k| vector[k][l] = best[k] * per_length);
    }
    (values, vector)
}

#[inline(always)]
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
        let mut flat = [[0.0; 500]; 6];
        (0..500).for_each(|l| {
            let scale = nalgebra::Vector3::new(random() * 1e-2, random(), 2.0 * random());
            let a = Matrix3::from_fn(|_, _| random()) * Matrix3::from_diagonal(&scale);
            let m = a * a.transpose();
            [m.m11, m.m12, m.m13, m.m22, m.m23, m.m33].into_iter().enumerate().for_each(|(i, v)| flat[i][l] = v);
        });
        let ([low, middle], vectors) = smallest_eigenvectors(&flat);
        for l in 0..500 {
            let (values, vector) = smallest_eigenvector(std::array::from_fn(|i| flat[i][l]));
            let close = if values[0] < 0.5 * values[1] { 1e-9 } else { 0.01 * values[2] };
            assert!((low[l] - values[0]).abs() < close && (middle[l] - values[1]).abs() < close, "{values:?}, not {} {}", low[l], middle[l]);
            if let (Some(v), true) = (vector, values[0] < 0.5 * values[1] && values[1] > 1e-4) {
                assert!((0..3).map(|k| v[k] * vectors[k][l]).sum::<f64>().abs() > 1.0 - 1e-6, "{values:?}");
            }
        }
        assert!(smallest_eigenvector([2.0, 0.0, 0.0, 2.0, 0.0, 2.0]).1.is_none());
    }
}
