//! Points between returns of neighbouring rows that lie on one plane.
//!
//! Far ahead on flat ground, rows are metres apart and columns centimetres: the surface is a set of rings with gaps between them. Where both sides of a gap lie on
//! one plane, and no return of the same column lies between them, the surface there is interpolated. It is not measured, so it counts less than any measurement
//! (`field/tsdf/voxel.rs`).

use super::range_image::{NO_POINT, RangeImage};
use super::returns::Returns;
use rayon::prelude::*;

/// Least cosine of the angle between the planes of both returns.
const LEAST_COSINE: f32 = 0.98;
/// Largest distance of a return from the plane of the other: noise, metres, and how much more for each metre between them.
const OFF_PLANE: [f32; 2] = [0.03, 0.02];
/// A return without a return in the next row is joined with one this many rows below it at most.
const MOST_ROWS: usize = 2;
/// Most points between two returns.
const MOST: usize = 64;
/// The usual edge of a voxel at a range, as a part of the distance between beams there.
const VOXEL_OF_BEAMS: f32 = 0.577;
/// The largest voxels have edges of this many finest voxels.
const LARGEST: f32 = 8.0;

/// Which gaps are closed.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowGaps {
    /// The longest distance between two returns that are joined, metres.
    pub longest: f32,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
}

/// Adds points between returns of neighbouring rows of `image`, after all measured ones, about as far apart as voxels there are wide.
pub(super) fn add_between_rows(returns: &mut Returns, image: &RangeImage, gaps: RowGaps) {
    let measured = returns.points.len();
    returns.measured = measured;
    // The return that each pixel shows.
    let mut shown = vec![NO_POINT; image.points.len()];
    for (i, (&pixel, &source)) in (0u32..).zip(returns.pixel.iter().zip(&returns.source)) {
        if image.points.get(pixel as usize) == Some(&source) {
            shown[pixel as usize] = i;
        }
    }
    let all = &*returns;
    let below = |row: usize, column: usize| {
        let rows = row + 1..image.rows.min(row + 1 + MOST_ROWS);
        rows.map(|row| shown[row * image.columns + column]).find(|&i| i != NO_POINT)
    };
    let pairs: Vec<Vec<(u32, u32, usize)>> = (0..image.rows)
        .into_par_iter()
        .map(|row| {
            let of = |column: usize| {
                let i = shown[row * image.columns + column];
                let j = (i != NO_POINT).then(|| below(row, column))??;
                let steps = steps_between(all, i as usize, j as usize, gaps)?;
                Some((i, j, steps))
            };
            (0..image.columns).filter_map(of).collect()
        })
        .collect();
    for (i, j, steps) in pairs.into_iter().flatten() {
        let (i, j) = (i as usize, j as usize);
        for step in 1..steps {
            returns.push_between(i, j, step as f32 / steps as f32);
        }
    }
}

/// The number of steps between returns `i` and `j`; `None` if nothing is to be added between them.
fn steps_between(returns: &Returns, i: usize, j: usize, gaps: RowGaps) -> Option<usize> {
    let (p, q) = (returns.points[i], returns.points[j]);
    let (m, n) = (returns.normals[i], returns.normals[j]);
    let dot = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
    let way: [f32; 3] = std::array::from_fn(|k| q[k] - p[k]);
    let apart = dot(way, way).sqrt();
    let range = 0.5 * (returns.ranges[i] + returns.ranges[j]);
    let step = (VOXEL_OF_BEAMS * range * returns.smallest_angle).clamp(gaps.voxel, LARGEST * gaps.voxel);
    let is_gap = apart > 1.5 * step && apart <= gaps.longest;
    // Zero normals have no cosine.
    let is_one_plane = dot(m, n) >= LEAST_COSINE && dot(way, m).abs().max(dot(way, n).abs()) <= OFF_PLANE[0] + OFF_PLANE[1] * apart;
    (is_gap && is_one_plane).then(|| ((apart / step).ceil() as usize).min(MOST))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A column of returns, one a row, at these places and with these normals.
    fn column(points: &[Option<[f32; 3]>], normal: impl Fn(usize) -> [f32; 3]) -> (Returns, RangeImage) {
        let image = RangeImage {
            rows: points.len(),
            columns: 1,
            ranges: points.iter().map(|p| if p.is_some() { 20.0 } else { 0.0 }).collect(),
            points: points.iter().enumerate().map(|(i, p)| if p.is_some() { i as u32 } else { NO_POINT }).collect(),
        };
        let there: Vec<usize> = (0..points.len()).filter(|&i| points[i].is_some()).collect();
        let returns = Returns {
            points: points.iter().flatten().copied().collect(),
            normals: there.iter().map(|&i| normal(i)).collect(),
            roughness: vec![0.01; there.len()],
            ranges: vec![20.0; there.len()],
            source: there.iter().map(|&i| i as u32).collect(),
            pixel: there.iter().map(|&i| i as u32).collect(),
            smallest_angle: 0.006,
            ..Returns::default()
        };
        (returns, image)
    }

    const UP: [f32; 3] = [0.0, 0.0, 1.0];
    const GAPS: RowGaps = RowGaps { longest: 3.0, voxel: 0.1 };

    fn ground(xs: &[f32]) -> Vec<Option<[f32; 3]>> {
        xs.iter().map(|&x| Some([x, 0.0, -2.0])).collect()
    }

    #[test]
    fn gaps_on_one_plane_are_filled_by_steps_of_a_voxel() {
        let (mut returns, image) = column(&ground(&[20.0, 18.0, 17.0]), |_| UP);
        add_between_rows(&mut returns, &image, GAPS);
        assert_eq!((returns.measured, returns.len()), (3, 3 + 19 + 9));
        let added = &returns.points[3..];
        assert!(added.iter().all(|p| p[2] == -2.0 && (17.0..20.0).contains(&p[0])), "{added:?}");
        let lengths = [returns.normals.len(), returns.roughness.len(), returns.ranges.len(), returns.source.len(), returns.pixel.len()];
        assert!(lengths.iter().all(|&l| l == returns.len()) && returns.spacing.is_empty());
    }

    #[test]
    fn nothing_is_added_over_long_gaps_steps_other_planes_and_missing_planes() {
        let mut step = ground(&[20.0, 18.0]);
        step[0] = Some([20.0, 0.0, -1.85]);
        let tilted = |i: usize| if i == 0 { [-0.3, 0.0, 0.954] } else { UP };
        let none = |i: usize| if i == 0 { [0.0; 3] } else { UP };
        let cases = [
            column(&ground(&[20.0, 16.9]), |_| UP),
            column(&step, |_| UP),
            column(&ground(&[20.0, 18.0]), tilted),
            column(&ground(&[20.0, 18.0]), none),
        ];
        for (case, (mut returns, image)) in cases.into_iter().enumerate() {
            add_between_rows(&mut returns, &image, GAPS);
            assert_eq!(returns.len(), 2, "case {case}");
        }
    }

    #[test]
    fn one_row_without_a_return_is_passed_over_and_a_return_in_between_is_not() {
        let mut places = ground(&[20.0, 19.0, 18.0, 17.0]);
        places[1] = None;
        places[2] = None;
        let (mut returns, image) = column(&places, |_| UP);
        add_between_rows(&mut returns, &image, GAPS);
        assert_eq!(returns.len(), 2, "two rows are missing");
        places[2] = Some([18.0, 0.0, -1.0]);
        let (mut returns, image) = column(&places, |_| UP);
        add_between_rows(&mut returns, &image, GAPS);
        assert_eq!(returns.len(), 3, "what stands between is on another plane");
        places[2] = Some([18.0, 0.0, -2.0]);
        let (mut returns, image) = column(&places, |_| UP);
        add_between_rows(&mut returns, &image, GAPS);
        assert_eq!(returns.len(), 3 + 19 + 9);
    }
}
