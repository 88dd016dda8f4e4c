//! Points between neighbouring returns that lie on one plane.
//!
//! Returns that are farther apart than voxels are wide leave gaps in a surface although both sides and the plane through them are measured. Two returns are neighbours
//! if no other one is in the ball whose diameter is between them (edges of the Gabriel graph, which are edges of the Delaunay triangulation). Points are only
//! added between neighbours, never beyond the outermost ones, so edges of surfaces stay where they are.

use crate::sensor::returns::Returns;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;
use std::ops::Range;

/// Returns of one task.
const CHUNK: usize = 1024;
/// Neighbours of a return that are looked at together.
const LANES: usize = super::neighbours::MOST;
/// Least cosine of the angle between the planes of both returns.
const LEAST_COSINE: f32 = 0.94;
/// Largest distance of a return from the plane of the other, in standard deviations.
const ON_PLANE: f32 = 2.0;
/// Neighbours farther apart than this many times the usual distance there are on both sides of a gap.
const LONGEST: f32 = 2.5;
/// Most points between two returns.
const MOST: u32 = 16;

/// Adds points at most `step` metres apart between returns on one plane, after all measured ones. `spread` is the standard deviation of returns from their plane;
/// `neighbours` gives at most [`LANES`] of a return.
pub(super) fn add_between<'a>(returns: &mut Returns, neighbours: impl Fn(usize) -> &'a [u32] + Sync, spread: f32, step: f32) {
    let measured = returns.points.len();
    let all = &*returns;
    let chunks = (0..measured.div_ceil(CHUNK)).into_par_iter().map(|chunk| {
        let mut links = Vec::new();
        let range = chunk * CHUNK..measured.min((chunk + 1) * CHUNK);
        dispatch(LinkSearch { returns: all, neighbours: &neighbours, spread, step, range, links: &mut links });
        links
    });
    let links: Vec<Vec<Link>> = chunks.collect();
    returns.measured = measured;
    returns.reserve(links.iter().flatten().map(|link| link.steps as usize - 1).sum());
    for Link { from, to, steps } in links.into_iter().flatten() {
        (1..steps).for_each(|s| returns.push_between(from as usize, to as usize, s as f32 / steps as f32));
    }
}

/// Neighbours between which points are added, at the ends of `steps` - 1 equal steps.
struct Link {
    from: u32,
    to: u32,
    steps: u32,
}

/// A search for the links of a range of returns.
struct LinkSearch<'a, N> {
    returns: &'a Returns,
    neighbours: &'a N,
    spread: f32,
    step: f32,
    range: Range<usize>,
    links: &'a mut Vec<Link>,
}

impl<'a, N: Fn(usize) -> &'a [u32]> Kernel for LinkSearch<'_, N> {
    #[inline(always)]
    fn run(self) {
        let Self { returns: Returns { points, normals, spacing, .. }, neighbours, spread, step, range, links } = self;
        for i in range {
            let (p, m) = (points[i], normals[i]);
            if m == [0.0; 3] {
                continue;
            }
            let around = neighbours(i);
            let mut ways = [[f32::INFINITY; LANES]; 3];
            for (l, &j) in around.iter().take(LANES).enumerate() {
                (0..3).for_each(|k| ways[k][l] = points[j as usize][k] - p[k]);
            }
            let squares: [f32; LANES] = std::array::from_fn(|l| ways[0][l] * ways[0][l] + ways[1][l] * ways[1][l] + ways[2][l] * ways[2][l]);
            let is_needed: [bool; LANES] = std::array::from_fn(|l| (squares[l] > step * step) & (squares[l] < f32::INFINITY));
            for (l, &j) in around.iter().take(LANES).enumerate().filter(|(l, _)| is_needed[*l]) {
                let (j, n, way) = (j as usize, normals[j as usize], [ways[0][l], ways[1][l], ways[2][l]]);
                let apart = squares[l].sqrt();
                // Farther apart, planes may be a little more apart: noise of their direction. Zero normals have no cosine.
                let off = dot(way, m).abs().max(dot(way, n).abs());
                let is_on_plane = (dot(m, n) >= LEAST_COSINE) & (off <= ON_PLANE * spread + 0.03 * apart);
                if !is_on_plane || apart > LONGEST * spacing[i].max(spacing[j]) {
                    continue;
                }
                // Each pair once: from the lower index, if both are neighbours of each other, else from the one that has the other.
                if j < i && neighbours(j).contains(&(i as u32)) {
                    continue;
                }
                let (middle, radius) = (way.map(|c| 0.5 * c), 0.4999 * apart);
                let mut is_between = false;
                let [xs, ys, zs] = &ways;
                for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
                    let [x, y, z] = [x - middle[0], y - middle[1], z - middle[2]];
                    is_between |= x * x + y * y + z * z < radius * radius;
                }
                if !is_between {
                    links.push(Link { from: i as u32, to: j as u32, steps: ((apart / step).ceil() as u32).clamp(1, MOST) });
                }
            }
        }
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
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
