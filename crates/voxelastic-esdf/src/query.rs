//! Distances and gradients in the map frame.

use crate::atlas::{Esdf, submaps};
use crate::frame::{SubmapFrame, corner_below};
use crate::layer::{Distances, FAR, Layer};
use crate::submap::SubmapEsdf;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::octree::{BLOCK_EDGE, BLOCK_SHIFT, block_key};
use voxelastic::query::DistanceQuery;

/// Points that a thread takes at a time.
const PER_TASK: usize = 2048;
/// A surface is looked for this many voxels around where the field says that it is.
const SURFACE_WITHIN: f64 = 2.0;

/// The distance at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct EsdfSample {
    /// Distance to the nearest obstacle, or to the nearest space that is not free, metres; at most the field's largest distance.
    pub distance: f32,
    /// Its gradient in the map frame: away from the obstacle, about of unit length; zero where everything is farther than the largest distance.
    pub gradient: [f32; 3],
}

/// Queries of an [`Esdf`].
pub struct EsdfQuery<'a> {
    voxel: f64,
    max_distance: f32,
    /// Whether unknown space ends distances, too.
    with_unknown: bool,
    parts: Vec<Part<'a>>,
    surfaces: Option<DistanceQuery<'a>>,
    /// Distances in metres by squared distances in voxels.
    roots: Vec<f32>,
}

/// The field of a submap and where it is.
struct Part<'a> {
    esdf: &'a SubmapEsdf,
    occupancy: &'a OccupancyField,
    frame: SubmapFrame,
}

impl Part<'_> {
    fn in_map(&self, sample: EsdfSample) -> EsdfSample {
        EsdfSample { gradient: self.frame.to_map(sample.gradient), ..sample }
    }
}

/// Looks up voxels of a layer and remembers the last block.
struct Lookup<'a> {
    layer: &'a Layer,
    /// Where a block is missing, voxels that are not free are at distance zero; of a layer of distances to what is not free.
    not_free: Option<&'a OccupancyField>,
    last: Option<(u64, Option<&'a Distances>)>,
}

impl<'a> Lookup<'a> {
    fn new(layer: &'a Layer, not_free: Option<&'a OccupancyField>) -> Self {
        Self { layer, not_free, last: None }
    }

    #[inline]
    fn block(&mut self, key: u64) -> Option<&'a Distances> {
        match self.last {
            Some((last, block)) if last == key => block,
            _ => {
                let block = self.layer.get(key);
                self.last = Some((key, block));
                block
            }
        }
    }

    /// Squared distance of finest voxel `c`.
    #[inline]
    fn squared(&mut self, c: [i32; 3]) -> u16 {
        match self.block(block_key(c.map(|v| v >> BLOCK_SHIFT))) {
            Some(distances) => distances[index(c)],
            None if self.not_free.is_some_and(|field| field.state_at(c) != State::Free) => 0,
            None => FAR,
        }
    }

    /// The eight voxels at `base` and next above it, x fastest.
    #[inline]
    fn corners(&mut self, base: [i32; 3]) -> [u16; 8] {
        // Most often all of them are in one block.
        if base.iter().all(|c| c & 7 != 7)
            && let Some(distances) = self.block(block_key(base.map(|v| v >> BLOCK_SHIFT)))
        {
            let first = index(base);
            return std::array::from_fn(|i| distances[first + (i & 1) + (i >> 1 & 1) * BLOCK_EDGE + (i >> 2) * BLOCK_EDGE * BLOCK_EDGE]);
        }
        std::array::from_fn(|i| self.squared(std::array::from_fn(|k| base[k] + (i >> k & 1) as i32)))
    }
}

/// Index of a finest voxel in its block.
#[inline]
fn index(c: [i32; 3]) -> usize {
    let [x, y, z] = c.map(|v| (v & 7) as usize);
    x + BLOCK_EDGE * (y + BLOCK_EDGE * z)
}

impl Esdf {
    /// Queries in the map frame, with every submap of `atlas` at its current root pose. The field must be up to date.
    pub fn query<'a>(&'a self, atlas: &'a Atlas) -> EsdfQuery<'a> {
        EsdfQuery::new(self, atlas)
    }
}

impl<'a> EsdfQuery<'a> {
    fn new(esdf: &'a Esdf, atlas: &'a Atlas) -> Self {
        let voxel = esdf.voxel_size;
        let max_distance = esdf.settings().max_distance;
        let part = |(submap, t_map_submap): (&'a Submap, Pose)| {
            let frame = SubmapFrame::new(submap, &t_map_submap, voxel, max_distance);
            Some(Part { esdf: esdf.submaps.get(&submap.id())?, occupancy: submap.occupancy(), frame })
        };
        let surfaces = DistanceQuery::new(atlas);
        let farthest = (max_distance / voxel).ceil().powi(2) as usize;
        Self {
            voxel,
            max_distance: max_distance as f32,
            with_unknown: esdf.has_unknown(),
            parts: submaps(atlas).filter_map(part).collect(),
            surfaces: (!surfaces.is_empty()).then_some(surfaces),
            roots: (0..=farthest).map(|squared| ((squared as f64).sqrt() * voxel).min(max_distance) as f32).collect(),
        }
    }

    /// The distance at `p` (metres, map frame), interpolated between the eight voxels around it. To obstacles it is the least of all submaps. To space that is not
    /// free it is never too large: everything nearer is free in one submap and occupied in none.
    pub fn sample(&self, p: [f64; 3]) -> EsdfSample {
        let mut answer = [EsdfSample { distance: 0.0, gradient: [0.0; 3] }];
        self.look_up(&[p], &mut answer);
        answer[0]
    }

    /// The distance at each of `points` (metres, map frame), as [`sample`](Self::sample) gives it. Uses the threads of the current pool.
    pub fn sample_many<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<EsdfSample> {
        let mut samples = vec![EsdfSample { distance: 0.0, gradient: [0.0; 3] }; points.len()];
        samples.par_chunks_mut(PER_TASK).zip(points.par_chunks(PER_TASK)).for_each(|(samples, points)| {
            let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(Into::into)).collect();
            self.look_up(&points, samples);
        });
        samples
    }

    /// As [`sample_many`](Self::sample_many), corrected by the surfaces of the map where it has them: voxels say where a surface is to half a voxel only. For
    /// distances to obstacles.
    pub fn sample_many_to_surfaces<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<EsdfSample> {
        let samples = self.sample_many(points);
        let Some(surfaces) = &self.surfaces else { return samples };
        let correct = |(p, sample): (&[T; 3], EsdfSample)| self.corrected(surfaces, p.map(Into::into), sample);
        points.par_iter().zip(samples).with_min_len(PER_TASK).map(correct).collect()
    }

    /// Samples the surface where the field says that it is; what is missing is the distance that is left.
    fn corrected(&self, surfaces: &DistanceQuery<'_>, p: [f64; 3], sample: EsdfSample) -> EsdfSample {
        let gradient = Vector3::from(sample.gradient.map(f64::from));
        let distance = f64::from(sample.distance);
        if distance < SURFACE_WITHIN * self.voxel
            && let Some(at) = surfaces.sample(p).filter(|at| at.gradient != [0.0; 3])
        {
            let side = if at.distance < 0.0 { -1.0 } else { 1.0 };
            return EsdfSample { distance: at.distance.abs(), gradient: at.gradient.map(|c| side * c) };
        }
        if gradient.norm() < 0.1 {
            return sample;
        }
        let foot = Point3::from(p) - gradient.normalize() * distance;
        let left = surfaces.sample(foot.coords.into()).map_or(0.0, |at| f64::from(at.distance));
        if left.abs() > SURFACE_WITHIN * self.voxel {
            return sample;
        }
        EsdfSample { distance: ((distance + left).max(0.0) as f32).min(self.max_distance), ..sample }
    }

    fn look_up(&self, points: &[[f64; 3]], answers: &mut [EsdfSample]) {
        let far = EsdfSample { distance: self.max_distance, gradient: [0.0; 3] };
        let nothing = EsdfSample { distance: 0.0, gradient: [0.0; 3] };
        let mut known = vec![nothing; if self.with_unknown { points.len() } else { 0 }];
        answers.fill(far);
        for part in &self.parts {
            let mut obstacles = Lookup::new(&part.esdf.obstacles, None);
            let mut not_free = part.esdf.not_free.as_ref().filter(|_| self.with_unknown).map(|layer| Lookup::new(layer, Some(part.occupancy)));
            for (i, (answer, p)) in answers.iter_mut().zip(points).enumerate() {
                let local = part.frame.to_submap(*p);
                if !part.frame.reaches(&local) {
                    continue;
                }
                let sample = self.interpolate(&mut obstacles, local);
                // The first of equals stays.
                if sample.distance < answer.distance {
                    *answer = part.in_map(sample);
                }
                if let Some(not_free) = &mut not_free {
                    let sample = self.interpolate(not_free, local);
                    if sample.distance > known[i].distance {
                        known[i] = part.in_map(sample);
                    }
                }
            }
        }
        // Also for a point that is not finite, which is in no submap.
        for (answer, known) in answers.iter_mut().zip(known) {
            if known.distance < answer.distance {
                *answer = known;
            }
        }
    }

    /// Interpolates between the eight voxels around `p`, submap frame.
    #[inline]
    fn interpolate(&self, lookup: &mut Lookup<'_>, p: [f64; 3]) -> EsdfSample {
        let Some((base, [fx, fy, fz])) = corner_below(p, self.voxel) else {
            return EsdfSample { distance: if lookup.not_free.is_some() { 0.0 } else { self.max_distance }, gradient: [0.0; 3] };
        };
        let squared = lookup.corners(base);
        if squared == [FAR; 8] {
            return EsdfSample { distance: self.max_distance, gradient: [0.0; 3] };
        }
        let corners = squared.map(|squared| self.roots.get(usize::from(squared)).copied().unwrap_or(self.max_distance));
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let steps: [f32; 4] = std::array::from_fn(|i| corners[2 * i + 1] - corners[2 * i]);
        let rows: [f32; 4] = std::array::from_fn(|i| corners[2 * i] + steps[i] * fx);
        let [low, high] = [mix(rows[0], rows[1], fy), mix(rows[2], rows[3], fy)];
        let differences =
            [mix(mix(steps[0], steps[1], fy), mix(steps[2], steps[3], fy), fz), mix(rows[1] - rows[0], rows[3] - rows[2], fz), high - low];
        EsdfSample { distance: mix(low, high, fz), gradient: differences.map(|difference| difference / self.voxel as f32) }
    }
}
