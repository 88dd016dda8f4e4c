//! Where rays end in a map: what simulated sensors see.

use crate::crossing::Crossing;
use crate::map::{Map, number_of};
use crate::space::unknown_as;
use crate::{arrays, job};
use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::types::PyTuple;
use pyo3::{Bound, IntoPyObject, PyResult, Python, pyfunction};
use rayon::prelude::*;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, DistanceQuery, Ray, RayHit, UnknownAs};

/// Rays between two looks for Ctrl-C.
const AT_ONCE: usize = 1 << 17;

/// Rays that a thread takes at a time.
const PER_TASK: usize = 64;

/// Distances to where rays end, NaN where they do not; the normals there; the states of what they end in.
#[pyfunction]
pub fn ray_cast<'py>(
    py: Python<'py>,
    map: &Map,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    length: f64,
    unknown_blocks: bool,
) -> PyResult<Bound<'py, PyTuple>> {
    let (origins, directions) = (arrays::rows(&origins)?, arrays::rows(&directions)?);
    if origins.len() != directions.len() && origins.len() != 1 {
        return Err(PyValueError::new_err("origins: expected one, or as many as directions"));
    }
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let caster =
        RayCaster { space: AtlasQuery::new(&content.atlas), surfaces: DistanceQuery::new(&content.atlas), unknown: unknown_as(unknown_blocks) };
    let ray = |k: u32| normalised(Ray { origin: *origins.get(k as usize).unwrap_or(&origins[0]), direction: directions[k as usize], length });
    let order: Vec<(u64, u32)> = job::run_short(py, || pool.install(|| coherent_order(origins, directions)))?;
    let (mut distances, mut normals, mut states) = (vec![f64::NAN; order.len()], vec![[0.0; 3]; order.len()], vec![0; order.len()]);
    for part in order.chunks(AT_ONCE) {
        let hits = job::run_short(py, || pool.install(|| caster.cast(&part.par_iter().map(|(_, k)| ray(*k)).collect::<Vec<_>>())))?;
        for ((_, k), hit) in part.iter().zip(hits) {
            if let Some(hit) = hit {
                let k = *k as usize;
                (distances[k], normals[k], states[k]) = (hit.distance, hit.normal, number_of(hit.state));
            }
        }
        py.check_signals()?;
    }
    let arrays = (PyArray1::from_vec(py, distances), arrays::from_rows(py, normals)?, PyArray1::from_vec(py, states));
    arrays.into_pyobject(py)
}

/// The numbers of the rays, with what they are sorted by: those that start near each other and go the same way come one after the other, because they read the same
/// part of the map.
fn coherent_order(origins: &[[f64; 3]], directions: &[[f64; 3]]) -> Vec<(u64, u32)> {
    const CELL_M: f64 = 2.0;
    let key = |k: usize| {
        let direction = directions[k];
        let largest = direction.iter().fold(f64::MIN_POSITIVE, |largest, c| largest.max(c.abs()));
        // 64 steps from -1 to 1, on the surface of a cube.
        let way = interleaved(direction.map(|c| ((c / largest + 1.0) * 32.0) as u64));
        let place = if origins.len() == 1 { 0 } else { interleaved(origins[k].map(|c| (c / CELL_M).floor() as i64 as u64)) };
        place << 24 | way
    };
    let mut order: Vec<(u64, u32)> = (0..directions.len()).into_par_iter().with_min_len(1024).map(|k| (key(k), k as u32)).collect();
    order.par_sort_unstable();
    order
}

/// The lowest eight bits of three numbers, in turn.
fn interleaved(numbers: [u64; 3]) -> u64 {
    (0..8).fold(0, |all, bit| (0..3).fold(all, |all, axis| all | (numbers[axis] >> bit & 1) << (3 * bit + axis)))
}

/// Casts rays to voxels, and from there to the surface in them where the map has signed distances.
struct RayCaster<'a> {
    space: AtlasQuery<'a>,
    surfaces: DistanceQuery<'a>,
    unknown: UnknownAs,
}

impl RayCaster<'_> {
    /// What each of `rays`, of unit directions, ends in. Uses the threads of the current pool.
    fn cast(&self, rays: &[Ray]) -> Vec<Option<RayHit>> {
        let mut hits: Vec<_> = rays.par_iter().with_min_len(PER_TASK).map(|ray| self.space.ray_cast(ray, self.unknown)).collect();
        if !self.surfaces.is_empty() {
            self.go_to_surfaces(rays, &mut hits);
        }
        hits
    }

    /// Moves hits to the surface in the voxel, if there is one. All rays go on together: many samples at once are several times faster.
    fn go_to_surfaces(&self, rays: &[Ray], hits: &mut [Option<RayHit>]) {
        let occupied = hits.iter().enumerate().filter_map(|(k, hit)| hit.filter(|hit| hit.state == State::Occupied).map(|hit| (k, hit.distance)));
        let mut under_way: Vec<(usize, Crossing)> = occupied.map(|(k, near)| (k, Crossing::new(near, self.space.voxel_size()))).collect();
        let mut points = Vec::with_capacity(under_way.len());
        while !under_way.is_empty() {
            points.clear();
            for (k, crossing) in &under_way {
                let Ray { origin, direction, .. } = &rays[*k];
                points.extend(crossing.places().map(|place| -> [f64; 3] { std::array::from_fn(|axis| origin[axis] + direction[axis] * place) }));
            }
            let distances = self.surfaces.sample_distances(&points);
            let mut rest = &distances[..];
            under_way.retain_mut(|(k, crossing)| {
                let (values, after) = rest.split_at(crossing.count());
                rest = after;
                let found = crossing.take(values);
                if let (Some(Some(distance)), Some(hit)) = (found, &mut hits[*k]) {
                    hit.distance = distance;
                }
                found.is_none()
            });
        }
    }
}

/// A ray of unit direction; as it is, if it has none.
fn normalised(ray: Ray) -> Ray {
    let norm = ray.direction.iter().map(|c| c * c).sum::<f64>().sqrt();
    if norm > 0.0 { Ray { direction: ray.direction.map(|c| c / norm), ..ray } } else { ray }
}
