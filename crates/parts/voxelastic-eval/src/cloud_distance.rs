//! Distances between point clouds, and voxel downsampling.

use crate::morton_order::map_in_morton_order;
use crate::{EvalError, error::Result};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// An index of a cloud for nearest-neighbour queries.
pub struct PointIndex {
    tree: ImmutableKdTree<f32, 3>,
    /// Position in the input of each indexed point.
    original: Vec<u32>,
}

impl PointIndex {
    /// Indexes the finite points of a cloud.
    ///
    /// # Errors
    /// [`EvalError::Empty`] when there are none; `what` is the name of the cloud in the message.
    pub fn new(points: &[[f32; 3]], what: &'static str) -> Result<Self> {
        let finite = |p: &[f32; 3]| p.iter().all(|c| c.is_finite());
        let original: Vec<u32> = (0..points.len() as u32).filter(|&i| finite(&points[i as usize])).collect();
        let kept: Vec<[f32; 3]> = original.iter().map(|&i| points[i as usize]).collect();
        if kept.is_empty() {
            return Err(EvalError::Empty { what, of: "points" });
        }
        let tree = ImmutableKdTree::new_from_slice(&kept).map_err(|_| EvalError::TooFew {
            what: "points that a search tree can hold",
            found: 0,
            needed: 1,
        })?;
        Ok(Self { tree, original })
    }

    /// Position in the input and squared distance of the point nearest to a finite `p`.
    pub fn nearest(&self, p: [f32; 3]) -> (usize, f32) {
        let n = self.tree.query(&p).nearest_one::<SquaredEuclidean<f32>>().execute();
        (self.original[n.item as usize] as usize, n.distance)
    }

    /// Positions in the input of the `k` points nearest to a finite `p`, nearest first.
    pub fn nearest_k(&self, p: [f32; 3], k: NonZero<usize>) -> Vec<usize> {
        let found = self.tree.query(&p).nearest_n::<SquaredEuclidean<f32>>(k).execute();
        found.into_iter().map(|n| self.original[n.item as usize] as usize).collect()
    }

    /// Distance of each of `points` to its nearest neighbour in this cloud, metres: infinity beyond `cut_off`, NaN for a point that is not finite.
    pub fn distances(&self, points: &[[f32; 3]], cut_off: f32) -> Vec<f32> {
        let distance = |&i: &u32| {
            let p = points[i as usize];
            if !p.iter().all(|c| c.is_finite()) {
                return f32::NAN;
            }
            let d = self.nearest(p).1.sqrt();
            if d <= cut_off { d } else { f32::INFINITY }
        };
        map_in_morton_order(points, |run| run.iter().map(distance).collect())
    }
}

/// Nearest-neighbour distances of two clouds, both ways.
#[derive(Clone, Debug)]
pub struct BothWays {
    /// Of each point of the first cloud to the second, metres.
    pub forward: Vec<f32>,
    /// Of each point of the second cloud to the first, metres.
    pub backward: Vec<f32>,
}

/// Nearest-neighbour distances between two clouds, both ways, each cut off (infinite) beyond `cut_off` metres.
///
/// # Errors
/// [`EvalError::Empty`] when one has no finite point.
pub fn cloud_distances(a: &[[f32; 3]], b: &[[f32; 3]], cut_off: f32) -> Result<BothWays> {
    let (index_a, index_b) = (PointIndex::new(a, "the first cloud")?, PointIndex::new(b, "the second cloud")?);
    Ok(BothWays { forward: index_b.distances(a, cut_off), backward: index_a.distances(b, cut_off) })
}

/// Replaces the points of each voxel of a grid (edge `voxel` metres, aligned with the origin) by their mean. Points that are not finite are
/// dropped. The result is sorted by voxel and does not depend on the number of threads.
///
/// # Errors
/// [`EvalError::Setting`] when `voxel` is not a positive number, or so small that the grid does not fit 32-bit cell numbers.
pub fn downsample(points: &[[f32; 3]], voxel: f32) -> Result<Vec<[f32; 3]>> {
    let cells = voxel_groups(points, voxel)?;
    let mean = |group: &[(Cell, u32)]| {
        let mut sum = [0.0f64; 3];
        for (_, i) in group {
            (0..3).for_each(|k| sum[k] += f64::from(points[*i as usize][k]));
        }
        sum.map(|s| (s / group.len() as f64) as f32)
    };
    Ok(cells.par_chunk_by(|a, b| a.0 == b.0).map(mean).collect())
}

type Cell = [i32; 3];

/// Cell and index of each finite point, sorted by cell and then by index.
fn voxel_groups(points: &[[f32; 3]], voxel: f32) -> Result<Vec<(Cell, u32)>> {
    let bounds = crate::mesh::bounds(points);
    let reach = bounds.min.iter().chain(&bounds.max).filter(|c| c.is_finite()).fold(0.0f32, |m, c| m.max(c.abs()));
    if !(voxel > 0.0 && voxel.is_finite()) || f64::from(reach) / f64::from(voxel) > f64::from(i32::MAX) {
        return Err(EvalError::Setting { setting: "voxel size", value: f64::from(voxel), must: "positive, and not tiny against the extent" });
    }
    let inverse = 1.0 / f64::from(voxel);
    let cell = |p: &[f32; 3]| p.map(|c| (f64::from(c) * inverse).floor() as i32);
    let finite = |p: &[f32; 3]| p.iter().all(|c| c.is_finite());
    let mut cells: Vec<(Cell, u32)> = points.par_iter().enumerate().filter(|(_, p)| finite(p)).map(|(i, p)| (cell(p), i as u32)).collect();
    cells.par_sort_unstable();
    Ok(cells)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cloud(n: std::ops::Range<usize>) -> impl Strategy<Value = Vec<[f32; 3]>> {
        prop::collection::vec([-5.0f32..5.0, -5.0f32..5.0, -5.0f32..5.0], n)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn distances_agree_with_brute_force(a in cloud(1..200), b in cloud(1..200), cut_off in 0.5f32..9.0) {
            let both = cloud_distances(&a, &b, cut_off).unwrap();
            let check = |from: &[[f32; 3]], to: &[[f32; 3]], got: &[f32]| from.iter().zip(got).all(|(p, d)| {
                let brute = to.iter().map(|q| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt()).fold(f32::INFINITY, f32::min);
                (brute - cut_off).abs() < 1e-5 || if brute <= cut_off { (brute - d).abs() < 1e-5 } else { d.is_infinite() }
            });
            prop_assert!(check(&a, &b, &both.forward) && check(&b, &a, &both.backward));
        }

        #[test]
        fn downsampling_leaves_one_mean_per_occupied_voxel(points in cloud(0..300), voxel in 0.1f32..3.0) {
            let thin = downsample(&points, voxel).unwrap();
            let mut groups: std::collections::BTreeMap<Vec<i32>, Vec<[f32; 3]>> = Default::default();
            for p in &points {
                groups.entry(p.iter().map(|c| (f64::from(*c) / f64::from(voxel)).floor() as i32).collect()).or_default().push(*p);
            }
            prop_assert_eq!(thin.len(), groups.len());
            for (t, g) in thin.iter().zip(groups.values()) {
                for k in 0..3 {
                    prop_assert!((t[k] - g.iter().map(|p| p[k]).sum::<f32>() / g.len() as f32).abs() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn many_equal_points_and_planes_are_indexed() {
        let mut points = vec![[1.0, 2.0, 3.0]; 5000];
        points.extend((0..5000).map(|i| [(i % 70) as f32 * 0.05, (i / 70) as f32 * 0.05, 0.0]));
        points.push([f32::NAN, 0.0, 0.0]);
        let index = PointIndex::new(&points, "a cloud").unwrap();
        assert_eq!(index.nearest([1.0, 2.0, 3.5]).1, 0.25);
        assert_eq!(index.nearest([0.05, 0.05, -1.0]), (5071, 1.0));
        let d = index.distances(&[[f32::NAN; 3], [100.0, 0.0, 0.0]], 2.0);
        assert!(d[0].is_nan() && d[1].is_infinite());
    }

    #[test]
    fn huge_coordinates_do_not_panic() {
        let index = PointIndex::new(&[[1e30; 3], [-3e38, 0.0, 3e38]], "a cloud").unwrap();
        let d = index.distances(&[[0.0; 3], [1e30; 3], [3e38; 3]], 10.0);
        assert_eq!(d[1], 0.0);
        assert!(d[0].is_infinite() && d[2].is_infinite());
        assert!(!index.nearest_k([0.0; 3], NonZero::<usize>::MIN).iter().any(|i| *i > 1));
    }

    #[test]
    fn empty_clouds_and_bad_voxels_are_rejected() {
        assert!(matches!(cloud_distances(&[], &[[0.0; 3]], 1.0), Err(EvalError::Empty { what: "the first cloud", .. })));
        for voxel in [0.0, -1.0, f32::NAN, 1e-12] {
            assert!(matches!(downsample(&[[1.0; 3]], voxel), Err(EvalError::Setting { .. })));
        }
    }
}
