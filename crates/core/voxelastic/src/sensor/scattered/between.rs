//! Points between neighbouring returns that lie on one plane.
//!
//! Returns that are farther apart than voxels are wide leave gaps in a surface although both sides and the plane through them are measured. Two returns are neighbours
//! if no other one is in the ball whose diameter is between them (edges of the Gabriel graph, which are edges of the Delaunay triangulation). Points are only
//! added between neighbours, never beyond the outermost ones, so edges of surfaces stay where they are.

use crate::sensor::returns::Returns;
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 256;
/// Least cosine of the angle between the planes of both returns.
const LEAST_COSINE: f32 = 0.94;
/// Largest distance of a return from the plane of the other, in standard deviations.
const ON_PLANE: f32 = 2.0;
/// Neighbours farther apart than this many times the usual distance there are on both sides of a gap.
const LONGEST: f32 = 2.5;
/// Most points between two returns.
const MOST: usize = 16;

/// A point between two returns.
struct Between {
    from: u32,
    to: u32,
    share: f32,
}

/// Adds points at most `step` metres apart between returns on one plane, after all measured ones. `spread` is the standard deviation of returns from their plane.
pub(super) fn add_between<'a>(returns: &mut Returns, neighbours: impl Fn(usize) -> &'a [u32] + Sync, spread: f32, step: f32) {
    let measured = returns.points.len();
    let (all, neighbours) = (&*returns, &neighbours);
    let of_one = |i: usize| {
        let links = neighbours(i).iter().map(|&j| j as usize).filter(move |&j| j != i);
        // Each pair once: from the lower index, if both are neighbours of each other, else from the one that has the other.
        links.filter(move |&j| (i < j || !neighbours(j).contains(&(i as u32))) && are_linked(all, i, j, neighbours(i), spread)).collect::<Vec<_>>()
    };
    let points: Vec<Vec<Between>> = (0..measured)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|i| {
            let mut points = Vec::new();
            for j in of_one(i) {
                let steps = ((distance(all.points[i], all.points[j]) / step).ceil() as usize).clamp(1, MOST);
                points.extend((1..steps).map(|s| Between { from: i as u32, to: j as u32, share: s as f32 / steps as f32 }));
            }
            points
        })
        .collect();
    returns.measured = measured;
    for Between { from, to, share } in points.into_iter().flatten() {
        let (i, j) = (from as usize, to as usize);
        returns.push_between(i, j, share);
    }
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
}

/// Whether returns `i` and `j` are neighbours on one plane; `around` are the returns around `i`.
fn are_linked(returns: &Returns, i: usize, j: usize, around: &[u32], spread: f32) -> bool {
    let (p, q) = (returns.points[i], returns.points[j]);
    let (m, n) = (returns.normals[i], returns.normals[j]);
    let dot = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
    // Zero normals have no cosine.
    if dot(m, n) < LEAST_COSINE {
        return false;
    }
    let way: [f32; 3] = std::array::from_fn(|k| q[k] - p[k]);
    let apart = dot(way, way).sqrt();
    let off = dot(way, m).abs().max(dot(way, n).abs());
    // Farther apart, planes may be a little more apart: noise of their direction.
    if off > ON_PLANE * spread + 0.03 * apart || apart > LONGEST * returns.spacing[i].max(returns.spacing[j]) {
        return false;
    }
    let middle: [f32; 3] = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
    let is_between = |&k: &u32| {
        let k = k as usize;
        k != i && k != j && distance(returns.points[k], middle) < 0.4999 * apart
    };
    !around.iter().any(is_between)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns on the plane z = -2 at these places, and one on a wall.
    fn returns(places: &[[f32; 2]]) -> Returns {
        let mut points: Vec<[f32; 3]> = places.iter().map(|p| [p[0], p[1], -2.0]).collect();
        let mut normals = vec![[0.0, 0.0, 1.0]; points.len()];
        points.push([1.0, 0.0, -1.5]);
        normals.push([-1.0, 0.0, 0.0]);
        let count = points.len();
        Returns {
            points,
            normals,
            roughness: vec![0.01; count],
            ranges: vec![2.0; count],
            source: (0..count as u32).collect(),
            pixel: vec![0; count],
            spacing: vec![0.5; count],
            ..Returns::default()
        }
    }

    #[test]
    fn points_are_added_on_the_plane_between_neighbours_only() {
        // A square with its centre, a return far away, and the wall.
        let mut returns = returns(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5], [3.0, 0.0]]);
        let measured = returns.len();
        let all: Vec<u32> = (0..measured as u32).collect();
        add_between(&mut returns, |_| &all[..], 0.01, 0.2);
        assert_eq!(returns.measured, measured);
        let added = &returns.points[measured..];
        assert!(added.iter().all(|p| p[2] == -2.0 && (0.0..=1.0).contains(&p[0]) && (0.0..=1.0).contains(&p[1])), "{added:?}");
        // From the centre to each corner, three points; the diagonals and the sides are not neighbours' (the centre is on their ball, or in it).
        let near_corner = |c: [f32; 2]| added.iter().filter(|p| (p[0] - c[0]).abs() <= 0.5 && (p[1] - c[1]).abs() <= 0.5).count();
        for corner in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
            assert!(near_corner(corner) >= 3, "{corner:?}: {added:?}");
        }
        let lengths = [returns.normals.len(), returns.ranges.len(), returns.source.len(), returns.pixel.len(), returns.spacing.len()];
        assert!(lengths.iter().all(|&l| l == returns.points.len()));
    }
}
