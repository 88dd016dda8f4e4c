//! Which plane a return lies on.

use super::super::prepare::Beams;
use super::grid::Grid;
use super::moments::WindowRule;
use super::plane::{Plane, Planes};
use rayon::prelude::*;

/// Returns that one task looks at.
const CHUNK: usize = 4096;

/// Gives every beam the plane of its pixel, or, where that is not believed or not met, the nearest fitting plane of the
/// pixels around: at an edge or a crease the windows of the neighbours on one side hold one surface only.
pub(crate) fn assign(planes: &Planes, grid: &Grid, rule: &WindowRule, noise: f32, beams: &mut Beams) {
    let count = beams.points.len();
    beams.normals.resize(count, [0.0; 3]);
    beams.roughness.resize(count, 0.0);
    let (points, pixels) = (&beams.points, &beams.pixel);
    let chunks = beams.normals.par_chunks_mut(CHUNK).zip(beams.roughness.par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(chunk, (normals, roughness))| {
        let first = chunk * CHUNK;
        for (i, (normal, roughness)) in normals.iter_mut().zip(roughness).enumerate() {
            let (p, pixel) = (points[first + i], pixels[first + i] as usize);
            let p = [p[0], p[1], p[2] - grid.height];
            let found = own(planes, grid, p, pixel, noise).or_else(|| around(planes, grid, rule, p, pixel, noise));
            (*normal, *roughness) = found.map_or(([0.0; 3], 0.0), |plane| (plane.normal(), plane.roughness));
        }
    });
}

impl Plane {
    /// Unit normal towards the sensor.
    #[inline(always)]
    fn normal(&self) -> [f32; 3] {
        let per_length = -1.0 / dot(self.a, self.a).sqrt();
        self.a.map(|c| c * per_length)
    }

    /// Distance of `p` from the plane, in units of what noise along the ray and the plane's roughness explain.
    #[inline(always)]
    fn misfit(&self, p: [f32; 3], noise: f32) -> f32 {
        let length = dot(self.a, self.a).sqrt();
        let distance = (dot(self.a, p) - 1.0).abs() / length;
        // 1 / (length |p|) is the cosine of the incidence.
        let along_normal = noise / (length * dot(p, p).sqrt());
        distance / along_normal.max(self.roughness).max(1e-4)
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Points within this many standard deviations are on the plane.
const ON_PLANE: f32 = 3.0;
/// A plane of a neighbour must fit better: it was not made from this point.
const ON_NEIGHBOUR: f32 = 2.0;

#[inline(always)]
fn own(planes: &Planes, grid: &Grid, p: [f32; 3], pixel: usize, noise: f32) -> Option<Plane> {
    planes.get(pixel / grid.columns, pixel % grid.columns).filter(|plane| plane.misfit(p, noise) <= ON_PLANE)
}

/// The best plane among the pixels half a window and a window away.
fn around(planes: &Planes, grid: &Grid, rule: &WindowRule, p: [f32; 3], pixel: usize, noise: f32) -> Option<Plane> {
    let (row, column) = ((pixel / grid.columns) as isize, (pixel % grid.columns) as isize);
    let inverse = 1.0 / (p[0] * p[0] + p[1] * p[1]).sqrt().max(1e-3);
    let reach = rule.reach(row as usize, inverse).map(|r| r.round() as isize);
    let mut best: Option<(f32, Plane)> = None;
    for (down, along) in [(0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)] {
        for halves in [1, 2] {
            let (r, c) = (row + down * ((reach[1] * halves + 1) / 2), column + along * ((reach[0] * halves + 1) / 2));
            if r < 0 || r >= grid.rows as isize {
                continue;
            }
            let c = c.rem_euclid(grid.columns as isize);
            let Some(plane) = planes.get(r as usize, c as usize) else { continue };
            let misfit = plane.misfit(p, noise);
            if misfit <= ON_NEIGHBOUR && best.is_none_or(|(least, _)| misfit < least) && is_near(grid, p, (r as usize, c as usize)) {
                best = Some((misfit, plane));
            }
        }
    }
    best.map(|(_, plane)| plane)
}

/// Whether a pixel's depth is like that of `p`: far beyond a gap a plane may pass by chance.
fn is_near(grid: &Grid, p: [f32; 3], (row, column): (usize, usize)) -> bool {
    let depth = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let inverse = grid.inverse[grid.at(row, column)];
    (depth * inverse - 1.0).abs() < 0.25
}
